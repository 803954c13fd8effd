//! Moving obstacles: plants, navigation, filter, lidars and results have them where they are while an episode runs.

use murmurate::deploy::Deployment;
use murmurate::messages::geometry::{Planar, Vec2};
use murmurate::messages::local::Sample;
use murmurate::messages::wire::Phase;
use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::results::totals::{Step, Steps};
use murmurate::safety::Safety;
use murmurate::scenario::{Settings, TaskFile};
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;
use murmurate::world::{self, KINEMATIC};

use crate::drawn::Fixed;

const CROSSING: &str = include_str!("../../examples/tasks/crossing.toml");

fn trial(text: &str, mode: &str, plant: &str) -> Trial {
    let task = TaskFile::read(text).expect("it is sound");
    let scenario = task.scenario(&Settings::default()).expect("it is sound");
    let mut deployment = Deployment::preset(mode, scenario.robots()).expect("it is a mode");
    deployment.plant = plant.to_owned();
    let mut trial = Trial::new(deployment, scenario, Model::Orca).seed(3).episodes(6);
    trial.steps = Steps::WithHearing;
    trial.check().unwrap_or_else(|error| panic!("{mode}, {plant}: {error}"));
    trial
}

/// The running steps of each episode, with the time since its first one.
fn running(steps: &[Step]) -> Vec<(&Step, Span)> {
    let mut began: Option<(u32, Time)> = None;
    let mut all = Vec::new();
    for step in steps.iter().filter(|step| step.phase == Phase::Running) {
        let now = step.samples[0].time;
        if began.is_none_or(|(episode, _)| episode != step.episode) {
            began = Some((step.episode, now));
        }
        all.extend(began.map(|(_, since)| (step, now.since(since))));
    }
    all
}

#[test]
fn robots_go_around_them_where_they_are_and_through_where_they_were() {
    let mut cases = vec![("sim", KINEMATIC), ("onboard-adhoc", KINEMATIC)];
    if cfg!(feature = "rigid") {
        cases.push(("offboard", "rigid"));
    }
    for (mode, plant) in cases {
        let trial = trial(CROSSING, mode, plant);
        let report = trial.run();
        assert!(report.successes() >= 4, "{mode}, {plant}: {} of 6", report.successes());
        let (mut touched, mut beside) = (0, 0);
        for (step, elapsed) in running(&report.steps) {
            let arena = trial.layouts.arena(step.episode).expect("each has one");
            let room_m = |elapsed: Span, sample: &Sample| arena.at(Some(elapsed)).clearance(sample.motion.position);
            let is_free = |sample: &&Sample| !sample.contacts.wall;
            // The first step may be late by one, in which an obstacle moves 15 mm.
            touched += step.samples.iter().filter(is_free).filter(|sample| room_m(elapsed, sample) < 0.14).count();
            let other = elapsed + Span::from_secs(6.0);
            beside += step.samples.iter().filter(|sample| room_m(other, sample) < 0.14).count();
        }
        assert_eq!(touched, 0, "{mode}, {plant}");
        assert!(beside > 10, "{mode}, {plant}: where they are 6 s later, robots pass");
    }
}

/// A hall in which a cart comes to a robot that stands on its way, where it was put.
const HEAD_ON: &str = "name = \"mine\"\nrobots = { default = 1, least = 1, most = 1 }\nhalf_extent_m = [3.0, 3.0]\n\
    movers = [{ radius_m = 0.3, path = [[-2.0, 0.0], [2.0, 0.0]], speed_m_s = 0.4 }]\n\
    places = [[0.0, -2.0], [0.0, 2.0]]\nrules = { arrival_m = 0.25, limit_s = 60.0 }\n";

#[test]
fn a_plant_flags_a_robot_that_is_run_over_and_only_while_an_episode_runs() {
    let task = TaskFile::read(HEAD_ON).expect("it is sound");
    let scenario = task.scenario(&Settings::default()).expect("it is sound");
    for entry in world::REGISTRY {
        let physics = (entry.physics)(scenario.arena());
        let seed = murmurate::random::Seed::of_run(1);
        let mut plant = (entry.build)(scenario.arena(), &physics, &[Vec2::zeros()], seed);
        let mut step = |elapsed: Option<Span>| {
            assert!(plant.elapse(elapsed), "{}", entry.name);
            plant.advance();
            plant.states()[0]
        };
        assert!((0..100).all(|_| !step(None).contacts.wall), "{}: none is there in a reset", entry.name);
        let touched: Vec<u64> = (1..200).filter(|at| step(Some(Span::from_millis(50) * *at)).contacts.wall).collect();
        // The disc comes from 2 m away at 0.4 m/s, and touches at 0.3 m and the radius of the robot.
        let first_s = *touched.first().expect("it is run over") as f32 * 0.05;
        let expected_s = (2.0 - 0.3 - physics.wall_radius_m) / 0.4;
        assert!((first_s - expected_s).abs() < 0.15, "{}: {first_s} s, {expected_s} s", entry.name);
        assert!(!step(None).contacts.wall, "{}: it is gone after the episode", entry.name);
    }
}

#[test]
fn a_lidar_sees_them_where_they_are() {
    let report_of = trial(CROSSING, "offboard", KINEMATIC);
    let report = report_of.run();
    let (mut near, mut wrong) = (0, 0);
    for (step, elapsed) in running(&report.steps) {
        let arena = report_of.layouts.arena(step.episode).expect("each has one").at(Some(elapsed)).into_owned();
        for sensing in &step.sensed {
            let (robot, at) = (sensing.sensed.robot, sensing.position);
            let apart = |other: &Sample| other.robot == robot || (other.motion.position - at).norm() > 1.2;
            let room_m = arena.clearance(at);
            if room_m < 0.6 && step.samples.iter().all(apart) {
                let seen = sensing.sensed.values.0.iter().copied().fold(f32::INFINITY, f32::min);
                near += 1;
                wrong += usize::from(!(seen > room_m - 0.12 && seen < room_m + 0.3));
            }
        }
    }
    // Where a corner is nearest, the rays on both sides of it may pass it: once in some hundred scans.
    assert!(near > 20 && wrong * 50 < near, "{wrong} of {near}");
}

#[test]
fn the_filter_gets_a_robot_out_of_the_way_of_one_that_comes() {
    use murmurate::messages::geometry::Motion;
    use murmurate::safety::filter::{Filter, Settings as Guarded};
    let task = TaskFile::read(HEAD_ON).expect("it is sound");
    let scenario = task.scenario(&Settings::default()).expect("it is sound");
    let arena = scenario.arena();
    let least_m = |moving: bool| {
        let movers = if moving { arena.movers.as_slice().into() } else { Default::default() };
        let mut filter = Filter::new(Guarded {
            safety: Safety::filter().driving(0.3, 1.0),
            half_extent: arena.half_extent,
            walls: Default::default(),
            movers,
            limit_m_s: 1.05,
            clamp: murmurate::safety::Clamp::Training,
            period: Span::from_millis(50),
        });
        let (mut robot, mut least_m) = (Motion::at_rest(Vec2::new(0.5, 0.05)), f32::INFINITY);
        for step in 0..200 {
            let elapsed = Span::from_millis(50) * step;
            filter.elapse(Some(elapsed));
            let command = filter.apply(&robot, [].into_iter(), Vec2::zeros()).velocity;
            for _ in 0..50 {
                robot.velocity += ((command - robot.velocity) / 0.3).map(|axis| axis.clamp(-1.0, 1.0)) * 1e-3;
                robot.position += robot.velocity * 1e-3;
            }
            let now = arena.at(Some(elapsed + Span::from_millis(50))).into_owned();
            least_m = least_m.min(now.clearance(robot.position));
        }
        least_m
    };
    assert!(least_m(true) > 0.16, "it stays a hull away: {} m", least_m(true));
    assert!(least_m(false) < 0.05, "without, it is run over: {} m", least_m(false));
}

#[test]
fn places_are_apart_from_their_ways_and_the_trace_of_a_run_repeats() {
    let task = TaskFile::read(CROSSING).expect("it is sound");
    let scenario = task.scenario(&Settings::of(8)).expect("it is sound");
    for (seed, episode) in (0..10).flat_map(|seed| (0..4).map(move |episode| (seed, episode))) {
        let arena = scenario.drawn_arena(seed, episode).expect("each has one");
        for task in scenario.tasks(seed, episode) {
            for (place, s) in [task.start, task.goal].into_iter().flat_map(|at| (0..60).map(move |s| (at, s))) {
                let now = arena.at(Some(Span::from_secs(f64::from(s)))).into_owned();
                assert!(now.clearance(place) > arena.robot_radius_m, "{}", place.shown());
            }
        }
    }
    let begin = |seed, episode| scenario.drawn_arena(seed, episode).expect("it has one").movers;
    assert!(begin(1, 0) == begin(1, 0) && begin(1, 0) != begin(1, 1) && begin(1, 0) != begin(2, 0));
    let run = || trial(CROSSING, "onboard-adhoc", KINEMATIC).safety(Safety::filter()).run().totals.trace;
    assert_eq!(run(), run());
}

#[test]
fn a_plant_that_has_none_is_refused_by_name() {
    let entry = world::Entry {
        name: "still",
        about: "nothing but robots moves",
        build: |arena, physics, starts, seed| Box::new(Fixed(world::kinematic::build(arena, physics, starts, seed))),
        ..world::REGISTRY[0]
    };
    let mut trial = trial(CROSSING, "sim", KINEMATIC);
    trial.registry = Registry::builtin().with_plant(entry);
    trial.deployment.plant = "still".to_owned();
    let error = trial.check().expect_err("it has none").to_string();
    assert!(error.starts_with("plant: 'still' has no moving obstacles"), "{error}");
}
