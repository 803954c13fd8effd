//! Obstacles that are drawn for each episode: plant, policy, filter, senses, training and results have those of the
//! episode that runs.

use std::collections::BTreeMap;

use murmurate::deploy::Deployment;
use murmurate::messages::geometry::{Planar, Vec2};
use murmurate::messages::local::Sample;
use murmurate::messages::wire::Phase;
use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::results::totals::Steps;
use murmurate::safety::Safety;
use murmurate::scenario::layout::Layouts;
use murmurate::scenario::{Arena, Settings, TaskFile};
use murmurate::senses;
use murmurate::time::Span;
use murmurate::trial::Trial;
use murmurate::world::{self, KINEMATIC, Plant, PlantState};

const NAVIGATION: &str = include_str!("../../examples/tasks/navigation.toml");

fn trial(mode: &str, plant: &str) -> Trial {
    let task = TaskFile::read(NAVIGATION).expect("it is sound");
    let scenario = task.scenario(&Settings::default()).expect("it is sound");
    let mut deployment = Deployment::preset(mode, scenario.robots()).expect("it is a mode");
    deployment.plant = plant.to_owned();
    let mut trial = Trial::new(deployment, scenario, Model::Orca).seed(3).episodes(6);
    trial.steps = Steps::Reported;
    trial
}

/// Least distance of a robot from a block \[m\].
fn nearest_m(samples: &[Sample], arena: &Arena) -> f32 {
    samples.iter().map(|sample| arena.clearance(sample.motion.position)).fold(f32::INFINITY, f32::min)
}

#[test]
fn every_robot_goes_around_the_obstacles_of_its_episode_and_through_those_of_others() {
    let mut cases = vec![("sim", KINEMATIC, 5), ("onboard-adhoc", KINEMATIC, 5)];
    if cfg!(feature = "rigid") {
        // Its robots slide, which scripted navigation does not model.
        cases.push(("offboard", "rigid", 3));
    }
    for (mode, plant, least) in cases {
        let trial = trial(mode, plant);
        trial.check().unwrap_or_else(|error| panic!("{mode}: {error}"));
        let report = trial.run();
        assert!(report.successes() >= least, "{mode}, {plant}: {} of 6", report.successes());
        let running = || report.steps.iter().filter(|step| step.phase == Phase::Running);
        let in_obstacles = |shift: u32| {
            let arena = |episode: u32| trial.layouts.arena((episode + shift) % 6).expect("each has one");
            running().filter(|step| nearest_m(&step.samples, arena(step.episode)) < 0.15).count()
        };
        assert_eq!(in_obstacles(0), 0, "{mode}, {plant}");
        assert!(in_obstacles(1) > 20, "{mode}, {plant}: what stood in the next episode is no obstacle in this one");
    }
}

#[test]
fn the_safety_filter_keeps_from_the_obstacles_of_the_episode_and_the_trace_repeats() {
    let filtered = || {
        let trial = trial("offboard", KINEMATIC);
        trial.safety(Safety::filter())
    };
    let report = filtered().run();
    assert!(report.totals.safety.walls > 0, "it has limited commands near obstacles");
    assert_eq!(report.totals.trace, filtered().run().totals.trace);
}

#[test]
fn a_lidar_sees_the_obstacles_of_the_episode() {
    let mut trial = trial("offboard", KINEMATIC);
    let table = "rays = 16\nrange_m = 1.0\nrails = false".parse().expect("it is TOML");
    let eyes = senses::Settings { kind: "lidar".to_owned(), table };
    trial.deployment = trial.deployment.with_senses(BTreeMap::from([("eyes".to_owned(), eyes)]));
    trial.steps = Steps::WithHearing;
    trial.check().expect("it is sound");
    let report = trial.run();
    let (mut near, mut wrong) = (0, 0);
    for step in report.steps.iter().filter(|step| step.phase == Phase::Running) {
        let arena = trial.layouts.arena(step.episode).expect("each has one");
        for sensing in &step.sensed {
            let (robot, at) = (sensing.sensed.robot, sensing.position);
            let apart = |other: &Sample| other.robot == robot || (other.motion.position - at).norm() > 1.4;
            let alone = step.samples.iter().all(apart);
            let seen = sensing.sensed.values.0.iter().copied().fold(f32::INFINITY, f32::min);
            let room_m = arena.clearance(at);
            // The nearest of 16 rays may miss the nearest point of a block, and the scan is up to a step old.
            near += usize::from(alone && room_m < 0.6);
            wrong += usize::from(alone && room_m < 0.6 && !(seen > room_m - 0.12 && seen < room_m + 0.35));
        }
    }
    assert!(near > 50 && wrong == 0, "{wrong} of {near}");
}

/// Plant whose arena cannot change, and in which nothing but robots moves.
pub struct Fixed(pub Box<dyn Plant>);

impl Plant for Fixed {
    fn period(&self) -> Span {
        self.0.period()
    }
    fn place(&mut self, robot: usize, position: Vec2, heading: f32) {
        self.0.place(robot, position, heading);
    }
    fn drive(&mut self, robot: usize, velocity: Vec2) {
        self.0.drive(robot, velocity);
    }
    fn advance(&mut self) {
        self.0.advance();
    }
    fn states(&self) -> &[PlantState] {
        self.0.states()
    }
}

#[test]
fn a_plant_that_cannot_take_them_and_a_file_of_starts_and_goals_are_refused_by_name() {
    let entry = world::Entry {
        name: "fixed",
        about: "an arena for all episodes",
        build: |arena, physics, starts, seed| Box::new(Fixed(world::kinematic::build(arena, physics, starts, seed))),
        ..world::REGISTRY[0]
    };
    let mut trial = trial("sim", KINEMATIC);
    trial.registry = Registry::builtin().with_plant(entry);
    trial.deployment.plant = "fixed".to_owned();
    let error = trial.check().expect_err("it cannot").to_string();
    assert!(error.starts_with("plant: 'fixed' has one arena for all episodes"), "{error}");
    let file = Layouts::from_json("{\"episodes\":[]}", &*trial.scenario, 1);
    let error = file.expect_err("it has no obstacles").to_string();
    assert!(error.starts_with("the obstacles of 'navigation' are drawn"), "{error}");
}

#[test]
fn obstacles_depend_on_seed_and_episode_and_leave_starts_and_goals_free() {
    let task = TaskFile::read(NAVIGATION).expect("it is sound");
    for robots in [2, 8, 12] {
        let scenario = task.scenario(&Settings::of(robots)).expect("it is sound");
        let layouts = Layouts::of_scenario(&*scenario, 11, 40);
        let arena = |episode: u32| layouts.arena(episode).expect("each has one");
        let all = (0..40).filter(|&episode| arena(episode).keep_outs.len() == 8).count();
        assert!(all >= 36, "{robots} robots: all obstacles had room in {all} of 40 episodes");
        for episode in 0..40 {
            for task in layouts.episode(episode) {
                for place in [task.start, task.goal] {
                    assert!(arena(episode).clearance(place) > scenario.arena().robot_radius_m, "{}", place.shown());
                }
                assert!((task.goal - task.start).norm() > 0.25);
            }
        }
        assert_ne!(arena(0), arena(1));
        assert_eq!(**arena(5), scenario.drawn_arena(11, 5).expect("it has one"));
        assert_ne!(scenario.drawn_arena(12, 5), scenario.drawn_arena(11, 5));
        assert_eq!(layouts.since(3).arena(0), layouts.arena(3));
    }
}
