//! Behaviours of tasks beyond their files: layouts, ends of episodes and observations, in runs of the whole graph.

use std::sync::{Arc, Mutex};

use murmurate::deploy::{Deployment, senses_of};
use murmurate::messages::geometry::{Task, Vec2};
use murmurate::observation::{IfStale, Observation, Request, Taking, Unit};
use murmurate::policy::{Interface, Model, Neighbour, Origin, Policy};
use murmurate::random::{RngExt, Seed, Stream};
use murmurate::registry::Registry;
use murmurate::scenario::task_file::{Behaviour, EpisodeStep};
use murmurate::scenario::{Settings, TaskFile, contract};
use murmurate::trial::Trial;

use crate::common::INTERFACE;

const YARD: &str = "name = \"yard\"\nrobots = { default = 3, least = 2, most = 4 }\nhalf_extent_m = [2.0, 2.0]\n\
                    rules = { arrival_m = 0.25, limit_s = 20.0 }\nscripted_success = 0.0\n";

/// Behaviour with layouts of its own; it ends episodes after a time \[ms\], and observes time and progress.
#[derive(Debug, Default)]
struct Own {
    end_ms: Option<u64>,
    /// Steps that were judged: episode, time \[ms\], and whether it was the first.
    judged: Mutex<Vec<(u32, u64, bool)>>,
}

impl Behaviour for Own {
    fn draws(&self) -> bool {
        true
    }

    fn tasks(&self, robots: usize, seed: u64, episode: u32) -> Vec<Task> {
        let mut stream = Seed::of_run(seed).stream(&format!("own/{episode}"));
        let mut y = || stream.random_range(1.0..1.8);
        let task = |robot: usize| {
            let x = robot as f32 - 1.5;
            Task { start: Vec2::new(x, -y()), goal: Vec2::new(x, y()) }
        };
        (0..robots).map(task).collect()
    }

    fn judges(&self) -> bool {
        true
    }

    fn judge(&self, step: &EpisodeStep) -> bool {
        assert_eq!((step.robots.len(), step.tasks.len(), step.arrived.len()), (3, 3, 3));
        let ms = step.after.as_nanos() / 1_000_000;
        self.judged.lock().expect("no test has failed").push((step.episode, ms, step.is_first));
        self.end_ms.is_some_and(|end_ms| ms >= end_ms)
    }

    fn observes(&self) -> bool {
        true
    }

    fn observe(&self, step: &EpisodeStep) -> Vec<f32> {
        step.to_go_m.iter().flat_map(|to_go_m| [*to_go_m, step.after.as_secs() as f32]).collect()
    }
}

fn file(behaviour: &Arc<Own>) -> TaskFile {
    TaskFile::with_behaviour(YARD, Arc::clone(behaviour) as Arc<dyn Behaviour>).expect("it is sound")
}

fn trial(mode: &str, behaviour: &Arc<Own>, model: Model) -> Trial {
    let scenario = file(behaviour).scenario(&Settings::default()).expect("it is sound");
    let deployment = Deployment::preset(mode, 3).expect("a preset");
    Trial::with_registry(&Registry::builtin(), deployment, scenario, model).seed(5).episodes(3)
}

#[test]
fn a_behaviour_draws_layouts_and_the_contract_of_scenarios_holds() {
    let behaviour = Arc::new(Own::default());
    contract::check_file(&file(&behaviour)).expect("it has all properties");
    assert!(TaskFile::read(YARD).is_err(), "without a behaviour a file has areas");
    let scaled = Settings { scale: Some(0.5), ..Settings::default() };
    let error = file(&behaviour).scenario(&scaled).expect_err("its places have one scale").to_string();
    assert!(error.contains("scale: leave it out") || error.contains("one scale"), "{error}");
    let report = trial("offboard", &behaviour, Model::Orca).run();
    assert_eq!(report.successes(), 3);
}

#[test]
fn a_behaviour_judges_each_step_and_ends_episodes() {
    for mode in ["sim", "onboard-adhoc"] {
        let (whole, short) = (Arc::default(), Arc::new(Own { end_ms: Some(1000), ..Own::default() }));
        let reports = [&whole, &short].map(|behaviour| trial(mode, behaviour, Model::Orca).run());
        let makespans =
            reports.each_ref().map(|report| report.episodes.iter().filter_map(|one| one.makespan_s).sum::<f64>());
        assert!(makespans[1] <= 3.0 * 1.05 && makespans[0] > makespans[1], "{mode}: {makespans:?}");
        let judged = short.judged.lock().expect("no test has failed");
        let first: Vec<u32> = judged.iter().filter(|(.., is_first)| *is_first).map(|(episode, ..)| *episode).collect();
        assert_eq!(first, [0, 1, 2], "{mode}");
        for steps in judged.chunk_by(|one, next| one.0 == next.0) {
            assert!(steps.windows(2).all(|pair| pair[1].1 == pair[0].1 + 50), "{mode}: one call a period");
            assert!((1000..1050).contains(&steps.last().expect("there are steps").1), "{mode}: {steps:?}");
        }
    }
}

/// Policy that keeps what it observes, and drives to the other side.
struct Keeping(Arc<Mutex<Vec<Vec<f32>>>>);

impl Policy for Keeping {
    fn interface(&self) -> Interface {
        INTERFACE
    }
    fn encode(&mut self, own: &Observation, _: &mut [f32]) {
        let distance_m = (own.goal - own.motion.position).norm();
        self.0.lock().expect("no test has failed").push([&[distance_m], own.values].concat());
    }
    fn act(&mut self, own: &Observation, _: &[f32], _: &[Neighbour], _: &mut Stream) -> Vec2 {
        (own.goal - own.motion.position).map(|axis| axis.clamp(-1.0, 1.0))
    }
}

#[test]
fn a_policy_takes_what_a_behaviour_observes_as_a_sense() {
    let runs = [(), ()].map(|()| {
        let seen: Arc<Mutex<Vec<Vec<f32>>>> = Arc::default();
        let taking = Taking { stale_after_s: Some(0.12), if_stale: Some(IfStale::Stop), ..Taking::default() };
        let (input, channel) = ("seen".to_owned(), "observed".to_owned());
        let request = Request { input, channel, shape: vec![2], unit: Unit::One, frame: None, taking };
        let origin = Origin { requests: vec![request], ..Origin::default() };
        let kept = Arc::clone(&seen);
        let instance = move |_: &_, _, _| Box::new(Keeping(Arc::clone(&kept))) as Box<dyn Policy>;
        let model = Model::of_file(("keeping", INTERFACE), origin, None, instance).expect("a sound interface");
        let mut trial = trial("sim", &Arc::default(), model);
        let senses = senses_of("[senses.observed]\nkind = \"task\"\nfloats = 2\n").expect("they are senses");
        trial.deployment = trial.deployment.with_senses(senses);
        assert_eq!(trial.check(), Ok(()));
        let report = trial.run();
        assert_eq!((report.refused, report.successes()), (0, 3));
        let seen = seen.lock().expect("no test has failed").clone();
        (report.totals.trace, seen)
    });
    assert!(runs[0] == runs[1], "twice alike");
    let known: Vec<&Vec<f32>> = runs[0].1.iter().filter(|seen| seen[1].is_finite()).collect();
    assert!(known.len() > 150 && known.len() * 100 >= runs[0].1.len() * 95, "{} of {}", known.len(), runs[0].1.len());
    for seen in known {
        assert!((seen[0] - seen[1]).abs() < 0.06, "on open ground the way to go is the distance: {seen:?}");
    }
}
