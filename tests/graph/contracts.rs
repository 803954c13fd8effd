//! Requirements on every registered scenario, policy and plant, and on every preset mode. A new entry in a registry
//! is tested here without new test code.

use murmurate::chassis::{self, DriveKind};
use murmurate::deploy::{Deployment, MODES};
use murmurate::messages::geometry::{Motion, Vec2, is_finite};
use murmurate::messages::ids::RobotId;
use murmurate::observation::Observation;
use murmurate::policy::{self, Model, Neighbour};
use murmurate::random::Seed;
use murmurate::scenario::judge::Verdict;
use murmurate::scenario::layout::Layouts;
use murmurate::scenario::{self, Settings, TaskFile};
use murmurate::senses;
use murmurate::time::Span;
use murmurate::trial::Trial;
use murmurate::world::{self, Plant};

#[test]
fn scenarios_keep_their_contract() {
    for entry in scenario::REGISTRY {
        scenario::contract::check(entry).unwrap();
    }
}

#[test]
fn kinds_of_senses_keep_their_contract() {
    for entry in senses::REGISTRY {
        senses::contract::check(entry).unwrap_or_else(|why| panic!("{}: {why}", entry.name));
    }
}

#[test]
fn the_scripted_baseline_solves_every_scenario_with_goals() {
    for entry in scenario::REGISTRY {
        let trial = Trial::preset("sim", entry.name).expect("a preset").episodes(12);
        if trial.scenario.cost().is_some() {
            continue;
        }
        let bar = trial.scenario.scripted_success();
        let (mut successes, mut failed) = (0, Vec::new());
        for seed in 1..=5 {
            let report = trial.clone().seed(seed).run();
            assert_eq!(report.episodes.len(), 12);
            successes += report.successes();
            let wrong = report.episodes.iter().filter(|episode| episode.verdict != Verdict::Success);
            failed.extend(wrong.map(|episode| (seed, episode.episode, episode.verdict)));
        }
        assert!(successes as f64 >= 60.0 * bar, "{}: {successes} of 60, bar {bar}: {failed:?}", entry.name);
    }
}

#[test]
fn episodes_without_goals_last_their_time_and_have_a_cost_in_every_mode() {
    let scenarios = scenario::REGISTRY.iter().map(|entry| (entry.build)(&Settings::default()).expect("the default"));
    for scenario in scenarios.filter(|scenario| scenario.cost().is_some()) {
        let limit_s = scenario.rules().limit.as_secs();
        for mode in ["sim", "onboard-adhoc"] {
            let trial = Trial::preset(mode, scenario.name()).expect("a preset").seed(2).episodes(2);
            let report = trial.run();
            assert_eq!(report.episodes.len(), 2);
            for episode in &report.episodes {
                assert!(episode.verdict != Verdict::Aborted && episode.verdict != Verdict::Success, "{episode:?}");
                assert_eq!((episode.makespan_s, episode.reset_s), (None, 0.0), "{mode}");
                let tasks = trial.layouts.episode(episode.episode);
                let goals: Vec<Vec2> = tasks.iter().map(|task| task.goal).collect();
                let team: Vec<Motion> = tasks
                    .iter()
                    .map(|task| Motion { position: task.start, velocity: scenario.start_velocity(task) })
                    .collect();
                let at_first = (scenario.cost().expect("it has one").of)(&team, &goals);
                let cost = episode.cost.expect("it has a cost");
                assert!(cost > 0.0 && cost < 0.3 * at_first, "{mode}: {cost}, {at_first} at first");
            }
            let took_s = report.simulated.as_secs();
            assert!((2.0 * limit_s..2.0 * limit_s + 2.0).contains(&took_s), "{mode}: {took_s} s");
        }
    }
}

#[test]
fn every_mode_runs_episodes_with_resets() {
    for mode in MODES {
        let report = Trial::preset(mode, "passage").expect("a preset").seed(2).episodes(3).run();
        let verdicts: Vec<Verdict> = report.episodes.iter().map(|episode| episode.verdict).collect();
        assert_eq!(verdicts, [Verdict::Success; 3], "{mode}");
        assert_eq!(report.refused, 0, "{mode}: no mailbox overflows");
        let drives = Deployment::preset(mode, 5).expect("a preset").hosts.len() > 1;
        assert_eq!(report.episodes[1].reset_s > 0.0, drives, "{mode}: robots drive to their starts");
    }
}

#[test]
fn layouts_that_do_not_chain_are_placed_exactly_in_every_mode() {
    // The same episode three times: its goals are not the starts of the next.
    let episode = r#"[{"start": [0.3, -1.5], "goal": [-0.4, 1.5]}, {"start": [-0.5, -1.5], "goal": [0.6, 1.5]}]"#;
    let text = format!("{{\"episodes\": [{episode}, {episode}, {episode}]}}");
    let scenario = scenario::build("passage", &Settings::of(2)).expect("two robots can pass");
    let layouts = Layouts::from_json(&text, &*scenario, 3).expect("the layouts are sound");
    for mode in MODES {
        for repeat in 0..6 {
            let deployment = Deployment::preset(mode, 2).expect("a preset");
            let trial = Trial::new(deployment, scenario.clone(), Model::Orca);
            let report = Trial { layouts: layouts.clone(), repeat, ..trial }.run();
            let verdicts: Vec<Verdict> = report.episodes.iter().map(|episode| episode.verdict).collect();
            assert_eq!(verdicts, [Verdict::Success; 3], "{mode}, repeat {repeat}");
            assert!(report.episodes.iter().all(|episode| episode.reset_s == 0.0), "{mode}: there is no reset");
        }
    }
}

/// Observation of a robot, and its neighbours' messages.
type Situation = (Observation<'static>, Vec<(Motion, Vec<f32>)>);

/// Returns a few observations, with messages of two neighbours.
fn situations(model: &Model) -> Vec<Situation> {
    let width = model.interface().features;
    let at = |x: f32, y: f32| Motion { position: Vec2::new(x, y), velocity: Vec2::new(0.2, 0.5) };
    let said = |k: usize| (0..width).map(|i| 0.3 + ((i + k) as f32 * 0.37).sin() * 0.2).collect::<Vec<f32>>();
    let neighbours = vec![(at(0.8, -1.2), said(0)), (at(-0.9, -1.1), said(3))];
    let goal = Vec2::new(0.4, 1.6);
    vec![
        (Observation::new(at(0.0, -1.5), goal), neighbours.clone()),
        (Observation::new(at(0.0, -1.5), goal), Vec::new()),
        (Observation::new(at(0.1, 0.0), goal), neighbours[..1].to_vec()),
        (Observation::new(Motion::at_rest(goal), goal), neighbours),
    ]
}

#[test]
fn a_policy_is_a_function_of_its_inputs_and_random_numbers() {
    let passage = scenario::build("passage", &Settings::default()).expect("the default is sound");
    let flocking = scenario::build("flocking", &Settings::default()).expect("the default is sound");
    let unlabelled = TaskFile::read(include_str!("../../examples/tasks/unlabelled.toml")).expect("it is sound");
    let unlabelled = unlabelled.scenario(&Settings::default()).expect("the default is sound");
    let scenarios = [&passage, &flocking, &unlabelled];
    let of = |entry: &policy::Entry| scenarios.into_iter().find_map(|scenario| (entry.build)(&**scenario).ok());
    let named = policy::REGISTRY.iter().map(|entry| of(entry).expect("one of them has the policy"));
    for model in named.chain([policy::untrained(1), policy::untrained_full(1)]) {
        let name = model.name();
        let interface = model.interface();
        assert!(interface.period > Span::ZERO && interface.hold >= interface.period);
        let act = |situation: &Situation, seed| {
            let mut policy = model.instance(passage.arena(), RobotId(0));
            let mut features = vec![f32::NAN; interface.features];
            policy.encode(&situation.0, &mut features);
            let heard = situation.1.iter().map(|(motion, features)| Neighbour {
                motion: *motion,
                features,
                age: Span::from_millis(20),
            });
            let heard: Vec<Neighbour> = heard.collect();
            let velocity = policy.act(&situation.0, &features, &heard, &mut Seed::of_run(seed).stream("draw"));
            assert!(features.iter().all(|float| float.is_finite()), "{name}: it writes all features");
            assert!(is_finite(velocity), "{name}: {velocity:?}");
            (features, velocity)
        };
        for situation in situations(&model) {
            assert_eq!(act(&situation, 1), act(&situation, 1), "{name}: two instances agree");
        }
    }
}

/// Checks that robot 0 of a plant, once it has a differential drive, is placed with a heading, and turns until it
/// drives straight where it is told to.
fn turns_to_where_it_is_driven(name: &str, plant: &mut dyn Plant, start: Vec2) {
    let drive =
        chassis::Settings { drive: Some(DriveKind::Differential), point_ahead_m: Some(0.1), ..Default::default() };
    plant.equip(0, drive.chassis().expect("it is sound"), 0.5);
    assert_eq!((plant.states()[0].motion, plant.states()[0].heading), (Motion::at_rest(start), 0.5), "{name}");
    plant.place(0, start, 0.0);
    plant.drive(0, Vec2::new(0.0, -0.5));
    let mut fastest: f32 = 0.0;
    for _ in 0..40 {
        plant.advance();
        fastest = fastest.max(plant.states()[0].yaw_rate.abs());
    }
    let state = plant.states()[0];
    let down = -std::f32::consts::FRAC_PI_2;
    assert!((state.heading - down).abs() < 0.1 && fastest > 0.5, "{name}: {fastest} rad/s, {state:?}");
    assert!(state.motion.velocity.y < -0.3 && state.motion.velocity.x.abs() < 0.1, "{name}: {state:?}");
    assert!(state.motion.position.y < start.y - 0.2, "{name}: {state:?}");
    plant.place(0, start, 1.0);
    assert_eq!((plant.states()[0].motion, plant.states()[0].heading), (Motion::at_rest(start), 1.0), "{name}");
}

#[test]
fn a_plant_follows_commands_and_is_deterministic() {
    let scenario = scenario::build("passage", &Settings::default()).expect("the default is sound");
    let starts: Vec<Vec2> = scenario.tasks(1, 0).iter().map(|task| task.start).collect();
    for entry in world::REGISTRY {
        let plant = |starts: &[Vec2]| {
            (entry.build)(scenario.arena(), &(entry.physics)(scenario.arena()), starts, Seed::of_run(1))
        };
        let run = || {
            let mut plant = plant(&starts);
            assert!(plant.period() > Span::ZERO);
            for (robot, start) in starts.iter().enumerate() {
                assert_eq!(plant.states()[robot].motion, Motion::at_rest(*start), "{}: at rest at first", entry.name);
                plant.drive(robot, Vec2::new(0.0, -1.0));
            }
            (0..40).for_each(|_| plant.advance());
            let moved = plant.states().to_vec();
            (0..starts.len()).for_each(|robot| plant.drive(robot, Vec2::zeros()));
            (0..100).for_each(|_| plant.advance());
            (moved, plant.states().to_vec())
        };
        let (moved, stopped) = run();
        assert_eq!((moved.clone(), stopped.clone()), run(), "{}: the same twice, bit for bit", entry.name);
        for robot in 0..starts.len() {
            assert!(moved[robot].motion.position.y < starts[robot].y, "{}: robot {robot} moves", entry.name);
            assert!(
                moved[robot].motion.position.y >= -scenario.arena().half_extent.y,
                "{}: within the arena",
                entry.name
            );
            assert!(stopped[robot].motion.velocity.norm() < 1e-3, "{}: robot {robot} stops", entry.name);
        }
        if entry.drives.contains(&DriveKind::Differential) {
            turns_to_where_it_is_driven(entry.name, &mut *plant(&starts[..1]), starts[0]);
        }
    }
}

#[test]
fn a_plant_holds_a_robot_that_is_carried_and_lets_the_others_touch_it() {
    let scenario = scenario::build("passage", &Settings::of(2)).expect("two may");
    let (own, carried) = (Vec2::new(0.0, -2.2), Vec2::new(0.0, -1.0));
    for entry in world::REGISTRY {
        let physics = (entry.physics)(scenario.arena());
        let mut plant = (entry.build)(scenario.arena(), &physics, &[own, Vec2::new(1.5, -2.5)], Seed::of_run(1));
        let mut touched = false;
        for step in 0..200_u16 {
            // It comes down slowly, whatever it is told, and the other drives up into it.
            let at = carried - Vec2::new(0.0, 0.001) * f32::from(step);
            plant.carry(1, Motion { position: at, velocity: Vec2::new(0.0, -0.02) }, 0.5);
            plant.drive(0, Vec2::new(0.0, 0.5));
            plant.drive(1, Vec2::new(0.0, 1.0));
            plant.advance();
            let states = plant.states();
            touched |= states[0].contacts.robot;
            assert!((states[1].motion.position - at).norm() < 0.002, "{}: {:?}", entry.name, states[1]);
            let apart = (states[0].motion.position - states[1].motion.position).norm();
            assert!(apart > 0.25, "{}: {apart} m apart", entry.name);
        }
        assert!(touched, "{}: the contact is told", entry.name);
        let reached = plant.states()[0].motion.position;
        assert!(reached.y > own.y + 0.3 || (reached - own).norm() > 0.3, "{}: it has driven: {reached:?}", entry.name);
    }
}
