//! Policies of format 2 that keep a state: robots compute and remember what a computation in numpy does, and a step
//! that counts as none changes nothing.
//!
//! `tests/data/export_memory.py` generated the file and the answers.

use std::path::Path;

use murmurate::deploy::senses_of;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::observation::Observation;
use murmurate::policy::hops::file;
use murmurate::policy::hops::manifest::Manifest;
use murmurate::policy::{Broadcast, Model, Neighbour, Policy};
use murmurate::random::Seed;
use murmurate::results::totals::Steps;
use murmurate::scenario::judge::Verdict;
use murmurate::scenario::{self, Settings};
use murmurate::time::Span;
use murmurate::trial::Trial;
use serde::Deserialize;

/// Inputs and answers of all robots of a team in one step.
#[derive(Deserialize)]
struct Step {
    position: Vec<[f32; 2]>,
    velocity: Vec<[f32; 2]>,
    goal: Vec<[f32; 2]>,
    heading: Vec<[f32; 1]>,
    latent: Vec<Vec<f32>>,
    output: Vec<[f32; 4]>,
}

impl Step {
    fn motion(&self, robot: usize) -> Motion {
        Motion { position: self.position[robot].into(), velocity: self.velocity[robot].into() }
    }

    fn observation(&self, robot: usize) -> Observation<'_> {
        Observation { values: &self.heading[robot], ..Observation::new(self.motion(robot), self.goal[robot].into()) }
    }

    /// Returns the messages of all others, who all have said what `latents` has.
    fn heard<'a>(&self, robot: usize, latents: &'a [Vec<f32>]) -> Vec<Neighbour<'a>> {
        let others = (0..latents.len()).filter(|other| *other != robot);
        let neighbour =
            |other| Neighbour { motion: self.motion(other), features: &latents[other], age: Span::from_millis(50) };
        others.map(neighbour).collect()
    }
}

fn data(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn model() -> Model {
    Model::from_file(&data("memory.safetensors"), "passage").expect("its probe matches")
}

/// Robots with the policy, and the steps of the record.
fn team() -> (Vec<Box<dyn Policy>>, Vec<Step>) {
    let steps: Vec<Step> = serde_json::from_slice(&data("memory_expected.json")).expect("it is a record");
    let passage = scenario::build("passage", &Settings::default()).expect("the default is sound");
    let model = model();
    ((0..3).map(|robot| model.instance(passage.arena(), RobotId(robot))).collect(), steps)
}

/// Computes a step of the team, and returns the latents and the velocities.
fn stepped(robots: &mut [Box<dyn Policy>], step: &Step) -> (Vec<Vec<f32>>, Vec<Vec2>) {
    let mut latents = vec![vec![0.0; robots[0].interface().features]; robots.len()];
    for (at, robot) in robots.iter_mut().enumerate() {
        robot.encode(&step.observation(at), &mut latents[at]);
        assert_eq!(robot.broadcast(), Broadcast::Encoded);
    }
    let before = latents.clone();
    for (at, robot) in robots.iter_mut().enumerate() {
        robot.relay(1, &step.observation(at), &mut latents[at], &step.heard(at, &before));
    }
    let mut stream = Seed::of_run(1).stream("none");
    let mut act = |(at, robot): (usize, &mut Box<dyn Policy>)| {
        robot.act(&step.observation(at), &latents[at], &step.heard(at, &latents), &mut stream)
    };
    let velocities = robots.iter_mut().enumerate().map(&mut act).collect();
    (latents, velocities)
}

#[test]
fn a_team_with_memories_answers_as_the_computation_in_numpy() {
    let (mut robots, steps) = team();
    let mut worst = 0.0_f32;
    for step in &steps {
        let (latents, velocities) = stepped(&mut robots, step);
        for (found, expected) in latents.concat().iter().zip(step.latent.concat()) {
            worst = worst.max((found - expected).abs());
        }
        for (found, expected) in velocities.iter().zip(&step.output) {
            worst = worst.max((found - Vec2::new(expected[0], expected[1])).norm());
        }
        for (robot, latent) in robots.iter().zip(&latents) {
            assert_eq!(robot.memory(), Some(&latent[..6]), "the state is what the first hop takes");
        }
    }
    println!("largest difference over {} steps: {worst:.1e}", steps.len());
    assert!(worst < 2e-5, "{worst}");
}

#[test]
fn a_memory_begins_at_zero_and_a_step_is_taken_back_or_counts_as_none() {
    let (mut robots, steps) = team();
    let start: Vec<_> = stepped(&mut robots, &steps[0]).0;
    let robot = &mut robots[0];
    assert_eq!(robot.forgets_after(), Some(Span::from_millis(300)));
    let first = robot.memory().expect("it has a state").to_vec();
    let mut features = vec![0.0; robot.interface().features];
    robot.encode(&steps[1].observation(0), &mut features);
    assert_ne!(robot.memory(), Some(&*first));
    robot.undo();
    assert_eq!(robot.memory(), Some(&*first), "the state before the step");
    let unknown = Observation { values: &[f32::NAN], ..steps[1].observation(0) };
    robot.encode(&unknown, &mut features);
    assert_eq!((robot.broadcast(), robot.memory()), (Broadcast::Failed, Some(&*first)), "its heading is not known");
    robot.undo();
    assert_eq!(robot.memory(), Some(&*first));
    robot.encode(&steps[1].observation(0), &mut features);
    assert_eq!(robot.broadcast(), Broadcast::Encoded);
    robots.iter_mut().for_each(|robot| robot.reset(9));
    assert_eq!(robots[0].memory(), Some(&[0.0; 6][..]));
    assert_eq!(stepped(&mut robots, &steps[0]).0, start, "a new episode is as the first one");
}

#[test]
fn teams_with_memories_run_in_every_mode_and_repeat_bit_for_bit() {
    for mode in ["sim", "centralized", "offboard", "onboard-adhoc"] {
        let run = || {
            let trial = Trial::preset(mode, "passage").expect("it is a mode");
            trial.model(model()).seed(3).episodes(1).run().totals.trace
        };
        assert_eq!(run(), run(), "mode {mode}");
    }
}

/// Policy of format 2 whose actions are scans: the decoder takes the ray ahead and the ray to the left of a lidar.
fn looking(entry: serde_json::Value) -> Vec<u8> {
    let manifest = serde_json::json!({
        "format": 2, "scenario": "passage", "observation": ["velocity", entry],
        "encoder": {"widths": [6, 2]},
        "hops": [{"aggregation": "sum", "update": {"inputs": ["own"], "widths": [2, 2]}}],
        "decoder": {"widths": [2, 4]}, "distribution": "diagonal-normal", "draw": "mean", "radius_m": 2.0,
        "rate_hz": 20.0, "limit_m_s": 1.5, "hold_s": 0.2, "sha256": ""
    });
    let manifest: Manifest = serde_json::from_value(manifest).expect("it is a manifest");
    // The rays are behind, to the right, ahead and to the left.
    let rays = vec![0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1];
    let unchanged = vec![1.0, 0.0, 0.0, 1.0];
    let velocity = vec![1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0];
    let layer = |weight: Vec<f32>, outputs: usize| vec![(weight, vec![0.0; outputs])];
    file::write(&manifest, &vec![layer(rays, 2), layer(unchanged, 2), layer(velocity, 4)])
}

#[test]
fn policies_of_format_2_take_a_lidar_and_a_team_without_it_is_refused() {
    let eyes = serde_json::json!({"name": "eyes", "shape": [4], "unit": "m", "frame": "body", "stale_after_s": 0.12});
    let model = Model::from_file(&looking(eyes), "passage").expect("it is sound");
    let trial = |mode: &str, senses: &str| {
        let mut trial = Trial::of_team(mode, "passage", 3).expect("a preset").episodes(1).seed(3);
        trial = trial.model(model.clone());
        if !senses.is_empty() {
            trial.deployment = trial.deployment.with_senses(senses_of(senses).expect("they are senses"));
        }
        trial.steps = Steps::Reported;
        trial
    };
    let lidar = "[senses.eyes]\nkind = \"lidar\"\nrays = 4\nrange_m = 3.0\n";
    for mode in ["sim", "offboard", "onboard-adhoc"] {
        let (once, again) = (trial(mode, lidar).run(), trial(mode, lidar).run());
        assert_eq!(once.totals.trace, again.totals.trace, "{mode}");
        let speeds = once.steps.iter().flat_map(|step| &step.samples).map(|sample| sample.motion.velocity);
        assert!(speeds.fold(0.0_f32, |most, velocity| most.max(velocity.x)) > 0.05, "{mode}: they go where nothing is");
    }
    let refused = trial("sim", "").check().expect_err("there is no lidar").to_string();
    assert!(refused.contains("observation 'eyes': there is no channel 'eyes' here"), "{refused}");
    let blind = trial("sim", "[senses.eyes]\nkind = \"lidar\"\nrays = 4\nrange_m = 3.0\nrate_hz = 1.0\n").run();
    assert!(
        blind.episodes.iter().all(|episode| episode.verdict != Verdict::Aborted),
        "steps without a scan count as none"
    );
}
