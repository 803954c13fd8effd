//! Safety functions of the robots, in whole trials: after any trigger the motors stop in time, and the team recovers.

use std::sync::Arc;

use murmurate::deploy::MODES;
use murmurate::deploy::Routes;
use murmurate::faults::{ActorFault, ActorFaultKind, FaultPlan, LinkFault, Role};
use murmurate::hearing::CommRange;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Kind, Phase, Stop};
use murmurate::policy::gnn::GnnWeights;
use murmurate::policy::manifest::Manifest;
use murmurate::policy::shipped::built_in;
use murmurate::policy::{Draw, Model, file, weights};
use murmurate::report::TrialReport;
use murmurate::results::totals::Step;
use murmurate::safety::guard::SafetyCounts;
use murmurate::safety::{Safety, Switch};
use murmurate::scenario::judge::Verdict;
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;
use murmurate::world::{ContactRule, kinematic};

fn ms(ms: u64) -> Span {
    Span::from_millis(ms)
}

fn trial(mode: &str, seed: u64) -> Trial {
    let trial = Trial::preset(mode, "passage").expect("a preset").seed(seed).episodes(3).keeping_steps();
    Trial { safety: Safety::deployed(), ..trial }
}

/// A time in the middle of the first episode.
fn midst(trial: &Trial) -> Time {
    let report = trial.run();
    let running = report.steps.iter().filter(|step| step.episode == 0 && step.phase == Phase::Running);
    let running: Vec<Time> = running.map(|step| step.samples[0].time).collect();
    running[running.len() / 3]
}

/// Returns the robots that are driven at any time between two times.
fn driven(report: &TrialReport, from: Time, until: Time) -> Vec<(RobotId, Time)> {
    let samples = report.steps.iter().flat_map(|step| &step.samples);
    let moving = samples.filter(|s| s.time >= from && s.time < until && s.command != Vec2::zeros());
    moving.map(|s| (s.robot, s.time)).collect()
}

fn actor(role: Role, robot: u16, kind: ActorFaultKind, at: Time, lasts: Span) -> FaultPlan {
    let fault = ActorFault { role, robot: RobotId(robot), kind, at, lasts, by: Span::ZERO, episode: None };
    FaultPlan { actors: vec![fault], links: Vec::new() }
}

#[test]
fn nothing_triggers_in_a_healthy_team() {
    for mode in MODES {
        let report = trial(mode, 3).run();
        let stopped = SafetyCounts { fence: 0, distance: 0, walls: 0, ..report.totals.safety };
        assert_eq!(stopped, SafetyCounts::default(), "{mode}");
        assert_eq!(report.successes(), 3, "{mode}: {:?}", report.episodes);
    }
}

#[test]
fn without_own_readings_a_robot_stops_within_the_age_of_the_last() {
    let trial = trial("offboard", 1);
    let (from, lasts) = (midst(&trial), ms(700));
    let fault = LinkFault { kinds: vec![Kind::Reading], from, until: from + lasts, ..LinkFault::always("loopback") };
    let plan = FaultPlan { actors: Vec::new(), links: vec![fault] };
    let report = trial.clone().faults(plan.clone()).run();
    assert_eq!(driven(&report, from + ms(100) + kinematic::PERIOD, from + lasts), []);
    assert_eq!(report.totals.safety.own_state, 5, "each robot once");
    assert_eq!(report.successes(), 3, "and it drives on: {:?}", report.episodes);

    let published = Trial { safety: Safety::emulated(), ..trial }.faults(plan).run();
    assert!(!driven(&published, from + ms(100) + kinematic::PERIOD, from + lasts).is_empty(), "commands lapse later");
    assert_eq!(published.totals.safety, SafetyCounts::default());
}

#[test]
fn a_policy_with_invalid_outputs_moves_no_robot_and_the_episodes_are_aborted() {
    let mut manifest = Manifest::published();
    (manifest.encoder, manifest.message, manifest.update) = (vec![6, 4, 3], vec![3, 5, 4], vec![4, 4]);
    let huge = |widths: &[usize]| -> Vec<(Vec<f32>, Vec<f32>)> {
        widths.windows(2).map(|pair| (vec![1e30; pair[0] * pair[1]], vec![1e30; pair[1]])).collect()
    };
    let tensors = [huge(&manifest.encoder), huge(&manifest.message), huge(&manifest.update)];
    let file = file::read(&weights::write(&manifest, &tensors)).expect("large numbers are numbers");
    let model = Model::Gnn(Arc::new(GnnWeights::new(file)), Draw::Mean);
    for mode in ["sim", "offboard"] {
        for safety in [Safety::deployed(), Safety::emulated()] {
            let report = Trial { models: model.clone().into(), safety, ..trial(mode, 2) }.run();
            assert!(report.finished && report.episodes.iter().all(|episode| episode.verdict == Verdict::Aborted));
            assert!(report.totals.safety.output > 0, "{mode}: {:?}", report.totals.safety);
            // A step of a reset may still be executed as the episode begins.
            assert!(report.steps.iter().any(|step| step.phase == Phase::Running), "{mode}: episodes do begin");
            let later = |steps: &&[Step]| steps.iter().all(|step| step.phase != Phase::Resetting);
            let begun: Vec<&[Step]> = report.steps.windows(3).filter(later).collect();
            assert!(!begun.is_empty(), "{mode}");
            assert!(begun.iter().flat_map(|steps| &steps[2].samples).all(|s| s.command == Vec2::zeros()), "{mode}");
        }
    }
}

#[test]
fn late_ticks_stop_a_robot_and_no_burst_of_old_actions_follows() {
    for role in [Role::Agent, Role::Cache] {
        let trial = trial("onboard-adhoc", 4);
        let (at, lasts) = (midst(&trial), ms(600));
        let report = trial.faults(actor(role, 2, ActorFaultKind::Stall, at, lasts)).run();
        // The last tick on time, the missed tick, and its allowed lateness.
        let stopped = at + ms(50) + ms(50) + kinematic::PERIOD;
        let late: Vec<_> = driven(&report, stopped, at + lasts).into_iter().filter(|(r, _)| r.0 == 2).collect();
        assert_eq!(late, [], "{role:?}");
        let counts = report.totals.safety;
        assert!(counts.late_tick + counts.own_state >= 1, "{role:?}: {counts:?}");
        let again = driven(&report, at + lasts, at + lasts + ms(300));
        assert!(again.iter().any(|(robot, _)| robot.0 == 2), "{role:?}: it drives again");
        assert_eq!(report.episodes[2].verdict, Verdict::Success, "{role:?}");
    }
}

#[test]
fn a_silent_state_server_stops_everyone() {
    let trial = trial("onboard-infra", 5);
    let (at, lasts) = (midst(&trial), ms(3000));
    let report = trial.faults(actor(Role::StateServer, 0, ActorFaultKind::Mute, at, lasts)).run();
    assert_eq!(driven(&report, at + ms(1000) + kinematic::PERIOD, at + lasts), []);
    assert_eq!(report.totals.safety.silence, 5);
    assert_eq!(report.episodes[2].verdict, Verdict::Success);
}

#[test]
fn an_emergency_stop_stops_everyone_within_100_ms_and_holds_until_a_later_re_arm_and_a_resume() {
    for mode in MODES {
        for safety in [Safety::deployed(), Safety::emulated()] {
            let trial = Trial { safety, ..trial(mode, 6) };
            let (at, by) = (midst(&trial), Routes::of(&trial.deployment).server_host());
            let resumed = at + ms(6000);
            let stops = vec![
                (at, Stop::engage(by, Latch::default())),
                (at + ms(2000), Stop::rearm(by, Latch::default())),
                (at + ms(4000), Stop::rearm(by, Latch::engaged(1))),
                (at + ms(5000), Stop::resume(by, Latch::held(1))),
                (resumed, Stop::resume(by, Latch::held(2))),
            ];
            // A host that restarts during the stop has to learn of it.
            let crashed = actor(Role::Controller, 1, ActorFaultKind::Crash, at + ms(1000), ms(500));
            let report = Trial { stops, ..trial }.faults(crashed).run();
            assert_eq!(driven(&report, at + ms(100), resumed), [], "{mode}");
            let verdicts: Vec<Verdict> = report.episodes.iter().map(|episode| episode.verdict).collect();
            assert_eq!(verdicts[0], Verdict::Aborted, "{mode}");
            assert_eq!(verdicts[1..], [Verdict::Success; 2], "{mode}: the next episodes run");
        }
    }
}

#[test]
fn a_host_that_misses_the_stop_or_the_re_arm_gets_it_from_the_state_server() {
    let trial = trial("onboard-infra", 7);
    let (at, by) = (midst(&trial), HostId(3));
    let rearmed = at + ms(2000);
    let server = Trial::preset("onboard-infra", "passage").expect("a preset").deployment.hosts.len() as u16 - 1;
    let stops = vec![
        (at, Stop::engage(by, Latch::default())),
        (rearmed, Stop::rearm(HostId(server), Latch::engaged(1))),
        (rearmed + ms(500), Stop::resume(HostId(server), Latch::held(2))),
    ];
    // The stop reaches no other host: only its sender has it.
    let links = vec![LinkFault { kinds: vec![Kind::Stop], ..LinkFault::always("infra") }];
    let report = Trial { stops, ..trial }.faults(FaultPlan { actors: Vec::new(), links }).run();
    // A heartbeat at once, the state server's next decision, and a World step.
    assert_eq!(driven(&report, at + ms(50) + kinematic::PERIOD, rearmed + ms(500)), []);
    assert_eq!(report.totals.safety.stop, 5);
    assert_eq!(report.successes(), 2, "{:?}", report.episodes);
}

#[test]
fn a_geofence_keeps_commands_inside() {
    let mut trial = trial("offboard", 8);
    (trial.safety.geofence_margin_m, trial.safety.geofence_horizon_s) = (0.0, 2.0);
    let half = trial.scenario.arena().half_extent;
    let report = trial.run();
    assert!(report.totals.safety.fence > 0, "robots come near the edge");
    for sample in report.steps.iter().flat_map(|step| &step.samples) {
        let reached = sample.motion.position + sample.command * 2.0;
        // The estimate that a command was made from is up to two steps old.
        let slack = 0.25;
        assert!(reached.x.abs() <= half.x + slack && reached.y.abs() <= half.y + slack, "{sample:?}");
    }
}

#[test]
fn a_minimum_distance_reduces_collisions_of_a_policy_without_messages() {
    let model = file::read(built_in("robust", "passage").expect("it is built in")).expect("and it can be read");
    let model = Model::Gnn(Arc::new(GnnWeights::new(model)), Draw::Mean);
    let collisions = |distance: Switch| {
        let mut trial = Trial { models: model.clone().into(), ..trial("centralized", 9) }.episodes(24);
        trial.range = Some(CommRange::fixed(0.0));
        (trial.physics.contacts, trial.physics.wall_radius_m) = (ContactRule::Judge, 0.16);
        trial.safety = Safety { distance, ..Safety::deployed() };
        let report = trial.run();
        let hit = report.episodes.iter().filter(|episode| episode.verdict == Verdict::RobotCollision).count();
        (hit, report.totals.safety.distance)
    };
    let ((without, unfiltered), (with, filtered)) = (collisions(Switch::Off), collisions(Switch::On));
    println!("robots too near in {without} of 24 episodes without the filter, {with} with it ({filtered} times)");
    assert!(unfiltered == 0 && filtered > 0);
    assert!(without >= 6 && with * 3 <= without, "{with} in place of {without}");
}
