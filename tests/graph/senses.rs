//! Senses of robots, from the simulated world to the policy.

use std::f32::consts::TAU;
use std::path::Path;
use std::sync::{Arc, Mutex};

use murmurate::deploy::team::TeamFile;
use murmurate::deploy::{Deployment, MODES, Routes, senses_of};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::wire::Kind;
use murmurate::observation::{Frame, IfStale, Observation, Request, Taking, Unit};
use murmurate::policy::{Interface, Model, Neighbour, Origin, Policy};
use murmurate::random::Stream;
use murmurate::registry::Registry;
use murmurate::report::TrialReport;
use murmurate::results::totals::Steps;
use murmurate::trial::Trial;
use murmurate::world;

use crate::common::INTERFACE;

const LIDAR: &str = "[senses.eyes]\nkind = \"lidar\"\nrays = 16\nrange_m = 3.0\n";

/// Policy that drives ahead at 0.2 m/s as long as its sense says something, and keeps what it was given.
struct Looking(Arc<Mutex<Vec<Vec<f32>>>>, bool);

impl Policy for Looking {
    fn interface(&self) -> Interface {
        INTERFACE
    }
    fn encode(&mut self, own: &Observation, _: &mut [f32]) {
        self.1 = own.values.iter().all(|value| value.is_finite());
        self.0.lock().expect("no test has failed").push(own.values.to_vec());
    }
    fn act(&mut self, _: &Observation, _: &[f32], _: &[Neighbour], _: &mut Stream) -> Vec2 {
        if self.1 { Vec2::new(0.0, 0.2) } else { Vec2::zeros() }
    }
}

fn taking(if_stale: IfStale) -> Taking {
    Taking { stale_after_s: Some(0.12), if_stale: Some(if_stale), ..Taking::default() }
}

/// Model that takes `eyes`, and what its robots were given.
fn model(taking: Taking) -> (Model, Arc<Mutex<Vec<Vec<f32>>>>) {
    let seen: Arc<Mutex<Vec<Vec<f32>>>> = Arc::default();
    let (input, shape, frame) = ("lidar".to_owned(), vec![16], Some(Frame::World));
    let request = Request { input, channel: "eyes".to_owned(), shape, unit: Unit::Metre, frame, taking };
    let origin = Origin { requests: vec![request], ..Origin::default() };
    let kept = Arc::clone(&seen);
    let instance = move |_: &_, _, _| Box::new(Looking(Arc::clone(&kept), false)) as Box<dyn Policy>;
    (Model::of_file(("looking", INTERFACE), origin, None, instance).expect("a sound interface"), seen)
}

fn trial(mode: &str, senses: &str, model: Model) -> Trial {
    let mut trial = Trial::of_team(mode, "passage", 3).expect("a preset").episodes(1).seed(3).model(model);
    trial.deployment = trial.deployment.with_senses(senses_of(senses).expect("they are tables of senses"));
    trial
}

fn run(trial: &Trial) -> TrialReport {
    assert_eq!(trial.check(), Ok(()));
    let report = trial.run();
    assert_eq!(report.refused, 0, "no mailbox overflows");
    report
}

#[test]
fn robots_see_in_every_mode_and_plant_and_twice_alike() {
    for plant in world::REGISTRY {
        for mode in MODES {
            let runs = [(), ()].map(|()| {
                let (model, seen) = model(taking(IfStale::Stop));
                let noisy = format!("{LIDAR}noise_m = 0.01\ndropouts = 0.05\n");
                let report = run(&trial(mode, &noisy, model).plant(plant.name));
                let seen = seen.lock().expect("no test has failed").clone();
                (report.totals.trace, seen)
            });
            assert_eq!(runs[0].0, runs[1].0, "{mode} {}", plant.name);
            assert!(runs[0].1 == runs[1].1, "{mode} {}", plant.name);
            let seen = &runs[0].1;
            let sound = seen.iter().filter(|values| values.iter().all(|value| (0.0..=3.0).contains(value)));
            assert!(sound.count() * 100 >= seen.len() * 95, "{mode} {}: scans come in time", plant.name);
            let near = seen.iter().filter(|values| values.iter().any(|value| *value < 2.9));
            assert!(near.count() > seen.len() / 2, "{mode} {}: walls, rails or robots are seen", plant.name);
        }
    }
}

#[test]
fn what_is_seen_is_what_is_there() {
    let (model, seen) = model(taking(IfStale::Stop));
    let mut trial = trial("sim", LIDAR, model);
    trial.steps = Steps::Reported;
    let report = run(&trial);
    let arena = trial.scenario.arena();
    let seen = seen.lock().expect("no test has failed");
    // In mode `sim` a step of the policies is after each step of the World, for its three robots in their order.
    let step = report.steps.iter().find(|step| step.samples.iter().all(|sample| sample.motion.velocity.y > 0.1));
    let at: Vec<Vec2> = step.expect("they move").samples.iter().map(|sample| sample.motion.position).collect();
    let walked = |own: usize, ray: usize| {
        let angle = -TAU / 2.0 + TAU / 16.0 * ray as f32;
        let along = |step: u32| at[own] + Vec2::new(angle.cos(), angle.sin()) * (step as f32 * 1e-3);
        let solid = |point: Vec2| {
            let others =
                at.iter().enumerate().any(|(other, centre)| other != own && (point - centre).norm() <= arena.hull_m());
            let outside = (point.abs() - arena.half_extent).max() >= arena.hull_m();
            others || outside || arena.clearance(point) == 0.0
        };
        (0..3000).find(|step| solid(along(*step))).map_or(3.0, |step| step as f32 * 1e-3)
    };
    let expected: Vec<Vec<f32>> = (0..3).map(|own| (0..16).map(|ray| walked(own, ray)).collect()).collect();
    let agrees = |values: &[Vec<f32>]| {
        let pairs = values.concat().into_iter().zip(expected.concat());
        pairs.filter(|(one, other)| (one - other).abs() > 2e-3).count() <= 1
    };
    assert!(seen.chunks_exact(3).any(agrees), "no step has seen {expected:?}");
}

#[test]
fn robots_with_old_scans_do_as_their_policy_says() {
    let slow = format!("{LIDAR}rate_hz = 1.0\n");
    let known = |if_stale| {
        let (model, seen) = model(taking(if_stale));
        run(&trial("onboard-infra", &slow, model));
        let seen = seen.lock().expect("no test has failed");
        let share = |is: fn(f32) -> bool| {
            let all = seen.iter().filter(|values| values.iter().all(|value| is(*value))).count();
            all as f32 / seen.len() as f32
        };
        (share(f32::is_nan), share(|value| value == 3.0))
    };
    let (nothing, no_echo) = known(IfStale::Stop);
    assert!((0.75..0.95).contains(&nothing) && no_echo == 0.0, "three of twenty steps have a scan: {nothing}");
    let (nothing, no_echo) = known(IfStale::Last);
    assert!(nothing < 0.05 && no_echo == 0.0, "{nothing}");
    let (nothing, no_echo) = known(IfStale::Miss);
    assert!(nothing == 0.0 && no_echo > 0.75, "{no_echo}");
}

#[test]
fn a_policy_without_its_sense_and_a_wrong_sense_are_refused_by_name() {
    let refused = |senses: &str| {
        let (model, _) = model(taking(IfStale::Stop));
        trial("sim", senses, model).check().expect_err("it does not fit").to_string()
    };
    let none = refused("[senses.ears]\nkind = \"lidar\"\nrays = 16\nrange_m = 3.0");
    assert!(none.contains("'lidar'") && none.contains("no channel 'eyes' here; there are: position"), "{none}");
    assert!(none.contains("ears") && none.contains("[senses.eyes]"), "{none}");
    let rays = refused("[senses.eyes]\nkind = \"lidar\"\nrays = 8\nrange_m = 3.0");
    assert!(rays.contains("takes an array [16], and the channel 'eyes' is [8]"), "{rays}");
    assert!(
        refused("[senses.eyes]\nkind = \"nose\"").starts_with("senses.eyes.kind: there is no kind of sense 'nose'")
    );
    assert!(refused("[senses.eyes]\nkind = \"lidar\"\nrays = 8").starts_with("senses.eyes: missing field `range_m`"));
    assert!(refused("[senses.goal]\nkind = \"lidar\"\nrays = 8\nrange_m = 1.0").starts_with("senses.goal: a channel"));
    assert!(refused("[senses.\"a b\"]\nkind = \"lidar\"\nrays = 8\nrange_m = 1.0").starts_with("senses.a b: a name"));
    assert!(senses_of("[senses.eyes]\nkind = \"lidar\"\n[other]\nx = 1").is_err());
}

#[test]
fn a_sense_travels_with_the_readings_unless_a_link_is_said_to_carry_it() {
    let senses = || senses_of(LIDAR).expect("tables of senses");
    for mode in MODES {
        let bare = Deployment::preset(mode, 3).expect("a preset");
        assert!(!Routes::of(&bare).crosses(Kind::Sensed), "{mode}: without senses");
        let team = bare.clone().with_senses(senses());
        assert_eq!(team.check(), Ok(()), "{mode}");
        assert_eq!(Deployment::from_toml(&team.to_toml()), Ok(team.clone()), "{mode}");
        let routes = Routes::of(&team);
        assert_eq!(routes.crosses(Kind::Sensed), mode != "sim", "{mode}");
        let both = |link: &&murmurate::deploy::Link| link.carries.contains(&Kind::Sensed);
        let carrier = team.links.iter().find(both);
        assert_eq!(carrier.is_some_and(|link| link.carries.contains(&Kind::Reading)), mode != "sim", "{mode}");
        let world =
            HostId(u16::try_from(team.hosts.iter().position(|h| !h.simulates.is_empty()).unwrap_or(0)).expect("few"));
        for host in (0..team.hosts.len()).map(|host| HostId(host as u16)) {
            let route = routes.router(host).route(Kind::Sensed, RobotId(1));
            assert_eq!(route.local, host == routes.agent_host(RobotId(1)), "{mode} {host:?}");
            assert_eq!(route.leaves.is_some(), host == world && mode != "sim", "{mode} {host:?}");
        }
        if mode != "sim" {
            let mut lost = team.clone();
            lost.links.iter_mut().for_each(|link| link.carries.retain(|kind| *kind != Kind::Sensed));
            let why = lost.check().expect_err("nothing carries it").to_string();
            assert!(why.contains("Sensed must cross hosts, and no link carries it"), "{mode}: {why}");
        }
    }
}

#[test]
fn a_team_file_has_senses_for_all_its_robots() {
    let read = |text: &str| {
        let text = format!("team = 1\nmode = \"onboard-infra\"\nrobots = 2\n{text}");
        TeamFile::read(&Registry::builtin(), &text, Path::new("."), &[], &[])
    };
    let file = read(LIDAR).expect("it is valid");
    assert_eq!(file.deployment().senses, senses_of(LIDAR).expect("tables of senses"));
    assert!(file.deployment().links.iter().any(|link| link.carries.contains(&Kind::Sensed)));
    let refused = |text: &str| read(text).expect_err("it is wrong").to_string();
    let rays = refused("[senses.eyes]\nkind = \"lidar\"\nrays = 0\nrange_m = 1.0");
    assert!(rays.starts_with("senses.eyes.rays: 0 is not 1 to 256"), "{rays}");
    assert!(refused("[sense.eyes]\nkind = \"lidar\"").contains("senses"), "its table has another name");
}

#[test]
fn senses_survive_faults_of_their_actors() {
    let (model, seen) = model(taking(IfStale::Stop));
    let trial = trial("onboard-adhoc", LIDAR, model).random_faults(11);
    assert_eq!(trial.check(), Ok(()));
    trial.run();
    let seen = seen.lock().expect("no test has failed");
    assert!(seen.last().is_some_and(|values| values.iter().all(|value| value.is_finite())), "they recover");
}
