//! Physics of simulated robots, sensors, and handling of messages, tested in whole trials.

use murmurate::deploy::{Impair, MODES};
use murmurate::hearing::Handling;
use murmurate::report::TrialReport;
use murmurate::safety::Clamp;
use murmurate::scenario::judge::Verdict;
use murmurate::trial::Trial;
use murmurate::world::{ContactRule, Placement, Sensor};

fn trial(mode: &str) -> Trial {
    Trial::preset(mode, "passage").expect("a preset").seed(3)
}

#[test]
fn a_lagging_drivetrain_takes_longer_on_the_same_path() {
    let run = |lag_s: f32| {
        let mut trial = trial("sim").episodes(8);
        trial.physics.lag_s = lag_s;
        trial.run().episodes
    };
    let [prompt, lagging] = [0.0, 0.4].map(|lag_s| run(lag_s).into_iter().map(|episode| episode.makespan_s));
    let both: Vec<(f64, f64)> = prompt.zip(lagging).filter_map(|(prompt, lagging)| prompt.zip(lagging)).collect();
    let later = both.iter().map(|(prompt, lagging)| lagging - prompt).sum::<f64>() / both.len() as f64;
    assert!(both.len() >= 4 && later > 0.3, "{later} s later: {both:?}");
}

#[test]
fn a_contact_with_a_wall_blocks_or_is_only_judged() {
    let run = |contacts: ContactRule| {
        let mut trial = trial("sim").keeping_steps();
        // Nearly as wide as the gap.
        (trial.physics.contacts, trial.physics.wall_radius_m) = (contacts, 0.49);
        trial.run()
    };
    let crossed = |report: &TrialReport| {
        let last = report.steps.last().expect("there are steps");
        last.samples.iter().filter(|sample| sample.motion.position.y > 0.0).count()
    };
    let (blocked, judged) = (run(ContactRule::Block), run(ContactRule::Judge));
    assert_eq!([&blocked, &judged].map(|report| report.episodes[0].verdict), [Verdict::WallCollision; 2]);
    assert_eq!((crossed(&blocked), crossed(&judged)), (0, 5));
}

/// Nothing is late here, so a command is computed from the velocity after the previous step.
#[test]
fn under_the_deployed_clamp_commands_stay_near_the_measured_velocity_in_every_mode() {
    let farthest = |mode: &str, clamp: Clamp| {
        let report = trial(mode).episodes(2).clamp(clamp).keeping_steps().run();
        assert_eq!(report.episodes.len(), 2);
        let pairs = report.steps.windows(2).filter(|pair| pair[0].episode == pair[1].episode);
        let robots = pairs.flat_map(|pair| pair[0].samples.iter().zip(&pair[1].samples));
        let moving = robots.filter(|(_, after)| after.command.norm() > 0.0);
        let far = moving.map(|(before, after)| (after.command - before.motion.velocity).abs().max());
        far.fold(0.0, f32::max)
    };
    for mode in MODES {
        let (training, deployed) = (farthest(mode, Clamp::Training), farthest(mode, Clamp::Deployed));
        assert!(deployed > 0.2 && deployed < 0.2501, "{mode}: {deployed} m/s");
        assert!(training > 0.3, "{mode}: {training} m/s");
    }
}

#[test]
fn dropping_messages_after_use_matters_when_some_are_lost() {
    let trace = |trial: &Trial, handling: Handling| Trial { handling, ..trial.clone() }.run().totals.trace;
    let mut lossy = trial("onboard-adhoc");
    lossy.deployment = lossy.deployment.impaired(None, Some(0.5), Impair::Latent).expect("latents cross hosts");
    assert_ne!(trace(&lossy, Handling::Hold), trace(&lossy, Handling::AsPublished));
    // Robots of one agent hear each other within its step.
    let joint = trial("sim");
    assert_eq!(trace(&joint, Handling::Hold), trace(&joint, Handling::AsPublished));
}

#[test]
fn robots_can_be_placed_in_a_mode_in_which_they_would_drive() {
    let mut trial = trial("onboard-adhoc").episodes(3).clamp(Clamp::Deployed).keeping_steps();
    trial.deployment.placement = Placement::Exact;
    (trial.physics.contacts, trial.physics.lag_s) = (ContactRule::Judge, 0.5);
    let report = trial.run();
    for (episode, tasks) in (0..3).map(|episode| (episode, trial.layouts.episode(episode))) {
        let found = &report.episodes[episode as usize];
        assert!(found.verdict != Verdict::Aborted && found.reset_s == 0.0, "{found:?}");
        let first = report.steps.iter().find(|step| step.episode == episode).expect("it has steps");
        for (sample, task) in first.samples.iter().zip(tasks) {
            let moved = (sample.motion.position - task.start).norm();
            assert!(moved < 2e-3, "episode {episode}, {}: {moved} m from its start", sample.robot);
        }
    }
}

/// Returns a trial with rigid bodies and the limits of the published robots.
fn rigid(mode: &str) -> Trial {
    trial(mode).plant("rigid").clamp(Clamp::Deployed)
}

#[test]
fn resets_succeed_among_rigid_bodies_in_every_mode_and_repeat_themselves_bit_for_bit() {
    for mode in MODES {
        let trial = rigid(mode).episodes(4);
        let report = trial.run();
        assert_eq!((report.episodes.len(), report.refused), (4, 0), "{mode}");
        assert!(report.episodes.iter().all(|found| found.verdict != Verdict::Aborted), "{mode}: {:?}", report.episodes);
        assert!(report.episodes.iter().all(|found| found.reset_s < 20.0), "{mode}: {:?}", report.episodes);
        let again = trial.run().totals.trace;
        assert_eq!(report.totals.trace, again, "{mode}: the same seed, the same bytes");
        assert_ne!(Trial { repeat: 1, ..trial }.run().totals.trace, again, "{mode}: slip and noise are drawn anew");
    }
}

/// Checks robots with a radius of 0.16 m.
#[test]
fn rigid_robots_never_overlap_deeply_nor_enter_a_wall() {
    for mode in ["centralized", "onboard-adhoc"] {
        let report = rigid(mode).episodes(6).keeping_steps().run();
        let trial = rigid(mode);
        let arena = trial.scenario.arena();
        for step in &report.steps {
            for (robot, sample) in step.samples.iter().enumerate() {
                let at = sample.motion.position;
                assert!(arena.clearance(at) > 0.15, "{mode}, episode {}: {at:?}", step.episode);
                assert_eq!(sample.contacts.wall, arena.clearance(at) <= 0.16);
                for other in &step.samples[..robot] {
                    let apart = (other.motion.position - at).norm();
                    assert!(apart > 0.30, "{mode}: {apart} m");
                    assert!(apart > 0.32 || sample.contacts.robot && other.contacts.robot, "a touch is flagged");
                }
            }
        }
    }
}

#[test]
fn motion_capture_changes_a_run_and_an_exact_sensor_does_not() {
    let trace = |plant: &str, sensor: Sensor| {
        let mut trial = trial("offboard").plant(plant).episodes(2);
        trial.physics.sensor = sensor;
        trial.run().totals.trace
    };
    for plant in ["kinematic", "rigid"] {
        assert_ne!(trace(plant, Sensor::EXACT), trace(plant, Sensor::MOTION_CAPTURE), "{plant}");
    }
    assert_eq!(trace("kinematic", Sensor::EXACT), trial("offboard").episodes(2).run().totals.trace);
}
