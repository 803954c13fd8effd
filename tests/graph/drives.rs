//! Teams of differential robots: scripted navigation with resets, in every plant; the judge sees the centres of hulls;
//! robots of one team may differ.

use murmurate::chassis::{DriveKind, Settings};
use murmurate::deploy::Host;
use murmurate::messages::geometry::wrapped;
use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::report::TrialReport;
use murmurate::results::episode::{Episode, Judged};
use murmurate::safety::Safety;
use murmurate::trial::Trial;
use murmurate::world::{ContactRule, Entry, Placement};

/// Drive of a robot like a TurtleBot, whose point is 0.1 m ahead of its axle.
fn differential() -> Settings {
    Settings { drive: Some(DriveKind::Differential), point_ahead_m: Some(0.1), ..Settings::default() }
}

fn trial(mode: &str, seed: u64, episodes: u32) -> Trial {
    let mut trial = Trial::preset(mode, "passage").expect("a preset").seed(seed).episodes(episodes).keeping_steps();
    trial.deployment.body = differential();
    trial.check().expect("it is sound");
    trial
}

/// Least distance between the centres of two robots, and between a centre and a wall, over all steps \[m\].
fn least(trial: &Trial, report: &TrialReport) -> (f32, f32) {
    let mut least = (f32::INFINITY, f32::INFINITY);
    for step in &report.steps {
        for (index, sample) in step.samples.iter().enumerate() {
            let at = sample.motion.position;
            least.1 = least.1.min(trial.scenario.arena().clearance(at));
            for other in &step.samples[..index] {
                least.0 = least.0.min((other.motion.position - at).norm());
            }
        }
    }
    least
}

/// Checks that robots only move along their headings, and that they turn.
fn assert_no_slip(report: &TrialReport) {
    let mut farthest: f32 = 0.0;
    for step in &report.steps {
        for sample in &step.samples {
            let (sin, cos) = sample.heading.sin_cos();
            let velocity = sample.motion.velocity;
            let blocked = sample.contacts.wall || sample.contacts.robot;
            // On the border of the ground a robot is held, and slides along it.
            let inside = sample.motion.position.x.abs() < 2.0 && sample.motion.position.y.abs() < 3.0;
            let sideways = (cos * velocity.y - sin * velocity.x).abs();
            assert!(blocked || !inside || sideways < 1e-3, "{sample:?} slides at {sideways} m/s");
            farthest = farthest.max(sample.yaw_rate.abs());
        }
    }
    assert!(farthest > 0.5, "they turn: {farthest} rad/s");
}

#[test]
fn scripted_navigation_brings_differential_robots_through_the_passage() {
    for (mode, seed) in [("sim", 3), ("offboard", 4), ("onboard-adhoc", 5)] {
        let trial = trial(mode, seed, 12);
        let report = trial.run();
        assert!(report.successes() >= 11, "{mode}: {} of 12", report.successes());
        assert_no_slip(&report);
    }
}

#[cfg(feature = "rigid")]
#[test]
fn a_world_of_rigid_bodies_has_differential_robots_too() {
    let trial = trial("offboard", 6, 6).plant("rigid");
    let report = trial.run();
    assert!(report.successes() >= 5, "{} of 6", report.successes());
    let (apart, clear) = least(&trial, &report);
    assert!(apart > 0.30 && clear > 0.15, "{apart} m apart, {clear} m from a wall");
}

#[test]
fn robots_of_one_team_differ_and_holonomic_ones_keep_their_heading() {
    let mut trial = trial("offboard", 7, 6);
    trial.deployment.body = Settings::default();
    trial.deployment.bodies.insert("1".to_owned(), differential());
    trial.deployment.bodies.insert("3".to_owned(), Settings { point_ahead_m: Some(0.2), ..differential() });
    trial.check().expect("it is sound");
    let report = trial.run();
    assert!(report.successes() >= 5, "{} of 6", report.successes());
    for step in &report.steps {
        for sample in &step.samples {
            let turns = [1, 3].contains(&sample.robot.0);
            assert!(turns || (sample.heading, sample.yaw_rate) == (0.0, 0.0), "{sample:?}");
        }
    }
}

#[test]
fn exact_readings_of_points_give_the_verdicts_of_true_centres() {
    for (mode, placement) in [("offboard", Placement::Drive), ("onboard-infra", Placement::Exact)] {
        let mut whole = trial(mode, 12, 6);
        (whole.physics.contacts, whole.physics.wall_radius_m) = (ContactRule::Judge, 0.16);
        whole.deployment.placement = placement;
        let mut parts = whole.clone();
        let hosts = &mut parts.deployment.hosts;
        hosts.iter_mut().find(|host| !host.simulates.is_empty()).expect("one simulates").simulates = vec![0, 1];
        hosts.push(Host { name: "other-world".to_owned(), simulates: vec![2, 3, 4], ..Host::default() });
        parts.deployment.check().expect("two worlds are sound");
        let (whole, parts) = (whole.run(), parts.run());
        assert!(whole.successes() > 0 && parts.episodes.iter().all(|episode| episode.judged == Judged::Readings));
        for (truth, read) in whole.episodes.iter().zip(&parts.episodes) {
            let least_m = truth.min_separation_m;
            // A centre is found from a point and a heading, with rounding errors.
            assert!((read.min_separation_m - least_m).abs() < 1e-4, "{mode}: {read:?}, {truth:?}");
            let same = Episode { judged: Judged::Truth, min_separation_m: least_m, ..*read };
            assert_eq!(same, *truth, "{mode}");
        }
    }
}

#[test]
fn a_placed_robot_heads_for_its_goal_and_one_that_drove_there_keeps_its_heading() {
    let placed = trial("sim", 8, 2);
    let report = placed.run();
    let first = |report: &TrialReport, episode: u32| {
        let step = report.steps.iter().find(|step| step.episode == episode && step.samples[0].time.as_nanos() > 0);
        step.expect("there are steps").samples.clone()
    };
    for (sample, task) in first(&report, 0).iter().zip(placed.layouts.episode(0)) {
        assert!((sample.heading - task.heading()).abs() < 0.4, "{} for {}", sample.heading, task.heading());
        assert!((sample.motion.position - task.start).norm() < 0.05, "the centre is at the start");
    }
    let driven = trial("offboard", 8, 2);
    let report = driven.run();
    let steps: Vec<_> = report.steps.iter().filter(|step| step.episode <= 1).collect();
    for pair in steps.windows(2) {
        for (before, after) in pair[0].samples.iter().zip(&pair[1].samples) {
            let turned = wrapped(f64::from(after.heading - before.heading)).abs();
            assert!(turned < 1.5, "it is not turned by hand: {before:?}, {after:?}");
        }
    }
}

#[test]
fn the_safety_filter_keeps_hulls_apart() {
    let mut trial = trial("offboard", 9, 8).model(Model::built_in("robust", "passage").expect("it is built in"));
    // Contacts block nothing, so that the filter alone keeps the robots apart.
    (trial.physics.contacts, trial.physics.wall_radius_m) = (ContactRule::Judge, 0.16);
    trial.safety = Safety::deployed();
    let report = trial.run();
    let (apart, _) = least(&trial, &report);
    assert!(report.totals.safety.distance > 100, "it has acted: {:?}", report.totals.safety);
    // Its limits are of velocities, so a robot may come somewhat nearer before it has braked.
    assert!(apart > 0.4 - 0.05, "the least distance of the filter is that of the centres: {apart} m");
    assert!(report.successes() >= 6, "{} of 8", report.successes());
}

#[test]
fn a_plant_that_does_not_simulate_a_drive_is_refused() {
    let holonomic = Entry {
        name: "tracks",
        drives: &[DriveKind::Holonomic],
        ..*Registry::builtin().plants().first().expect("there is a plant")
    };
    let mut trial = trial("sim", 1, 1);
    trial.registry = Registry::builtin().with_plant(holonomic);
    trial.deployment.plant = "tracks".to_owned();
    let error = trial.check().unwrap_err().to_string();
    assert!(error.starts_with("plant") && error.contains("tracks") && error.contains("robot 0"), "{error}");
    trial.deployment.body = Settings::default();
    assert_eq!(trial.check(), Ok(()));
}

#[test]
fn a_trace_shows_the_drive_and_repeats() {
    let trace = |point_ahead_m: f32| {
        let mut trial = trial("offboard", 2, 1);
        trial.deployment.body.point_ahead_m = Some(point_ahead_m);
        trial.run().totals.trace
    };
    assert_eq!(trace(0.1), trace(0.1));
    assert_ne!(trace(0.1), trace(0.15));
}
