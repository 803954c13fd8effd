//! Unlabelled goals: episodes end when every goal has a robot, in every mode, and robots share the goals out.

use murmurate::messages::geometry::Vec2;
use murmurate::messages::wire::Phase;
use murmurate::registry::Registry;
use murmurate::results::totals::{Step, Steps};
use murmurate::scenario::judge::Verdict;
use murmurate::scenario::{Scenario, Settings, TaskFile, goals};
use murmurate::trial::Trial;
use std::sync::Arc;

const UNLABELLED: &str = include_str!("../../examples/tasks/unlabelled.toml");

fn scenario(robots: usize) -> Arc<dyn Scenario> {
    let task = TaskFile::read(UNLABELLED).expect("it is sound");
    task.scenario(&Settings::of(robots)).expect("it is sound")
}

fn trial(mode: &str, policy: &str) -> Trial {
    let (registry, scenario) = (Registry::builtin(), scenario(6));
    let deployment = murmurate::deploy::Deployment::preset(mode, 6).expect("it is a mode");
    let entry = registry.policy(policy).expect("it is registered");
    let model = (entry.build)(&*scenario).expect("it is for unlabelled goals");
    let mut trial = Trial::with_registry(&registry, deployment, scenario, model).seed(4).episodes(5);
    trial.steps = Steps::Reported;
    trial.check().expect("it is sound");
    trial
}

/// Returns the goal of the team at which each robot is in a step.
fn at(trial: &Trial, step: &Step) -> Vec<Option<usize>> {
    let goals = || trial.layouts.episode(step.episode).iter().map(|task| task.goal);
    step.samples.iter().map(|sample| goals::goal_at(goals(), sample.motion.position, 0.25)).collect()
}

#[test]
fn an_episode_succeeds_when_every_goal_has_a_robot_and_the_next_one_begins() {
    for mode in ["sim", "offboard", "onboard-adhoc"] {
        let trial = trial(mode, "claim");
        let report = trial.run();
        let mut exchanged = 0;
        for episode in &report.episodes {
            assert_eq!(episode.verdict, Verdict::Success, "{mode}: {episode:?}");
            let runs = |step: &&Step| step.episode == episode.episode && step.phase == Phase::Running;
            let last = report.steps.iter().rfind(runs).expect("it has run");
            let at = at(&trial, last);
            assert!((0..6).all(|goal| at.contains(&Some(goal))), "{mode}: {at:?}");
            exchanged += at.iter().enumerate().filter(|(robot, at)| **at != Some(*robot)).count();
        }
        assert!(exchanged > 10, "{mode}: the robots do not go to the goals of their tasks");
        let simulated_s = report.simulated.as_secs();
        assert!(simulated_s < 5.0 * 40.0, "{mode}: {simulated_s} s, no episode lasts its limit of 60 s");
        assert_eq!(trial.run().totals.trace, report.totals.trace);
    }
}

#[test]
fn a_fixed_assignment_succeeds_too_and_takes_longer() {
    let median_s = |policy: &str| {
        let report = trial("offboard", policy).run();
        assert_eq!(report.successes(), 5, "{policy}");
        let mut makespans: Vec<f64> = report.episodes.iter().filter_map(|episode| episode.makespan_s).collect();
        makespans.sort_by(f64::total_cmp);
        makespans[2]
    };
    let (shared, fixed) = (median_s("claim"), median_s("orca"));
    assert!(shared < fixed, "{shared} s, {fixed} s");
}

#[test]
fn what_is_to_go_is_that_of_the_cheapest_assignment_and_all_arrive_at_once() {
    let scenario = scenario(6);
    let tasks = scenario.tasks(7, 0);
    let lengths = |places: &[Vec2]| {
        let mut to_go_m = vec![f32::NAN; 6];
        scenario.distances_to_go(&tasks, places, &mut to_go_m);
        to_go_m
    };
    let reached = |places: &[Vec2]| {
        let mut reached = [false; 6];
        scenario.arrivals(&tasks, places, &mut reached);
        reached
    };
    // Each robot is at the goal of the next one.
    let mut places: Vec<Vec2> = (0..6).map(|robot| tasks[(robot + 1) % 6].goal).collect();
    assert_eq!((lengths(&places), reached(&places)), (vec![0.0; 6], [true; 6]));
    places[2] -= Vec2::new(0.0, 0.4);
    assert_eq!(reached(&places), [false; 6]);
    let to_go_m = lengths(&places);
    assert!((to_go_m.iter().sum::<f32>() - 0.4).abs() < 1e-5, "{to_go_m:?}");
    let starts: Vec<Vec2> = tasks.iter().map(|task| task.start).collect();
    let own: f32 = tasks.iter().map(|task| (task.goal - task.start).norm_squared()).sum();
    let shared: f32 = lengths(&starts).iter().map(|length_m| length_m * length_m).sum();
    assert!(shared < own, "{shared} of the assignment, {own} of the tasks");
}

#[test]
fn policies_for_other_goals_are_refused_by_name() {
    let registry = Registry::builtin();
    let claim = registry.policy("claim").expect("it is registered");
    let swap = registry.scenario("swap", &Settings::default()).expect("it is sound");
    let error = (claim.build)(&*swap).expect_err("its goals have labels").to_string();
    assert!(error.contains("'swap' has a goal of its own; use 'orca'"), "{error}");
}
