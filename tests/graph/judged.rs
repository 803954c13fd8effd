//! Verdicts from readings, where no World has the whole team: compared with those from true states, with readings that
//! are lost, out of order, or end.

use murmurate::deploy::{Deployment, Host};
use murmurate::faults::{ActorFault, ActorFaultKind, FaultPlan, LinkFault, LinkFaultKind, Role};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{Kind, Phase};
use murmurate::report::TrialReport;
use murmurate::results::episode::{Episode, Judged};
use murmurate::results::totals::Step;
use murmurate::scenario::judge::{Judge, JudgedRobot, Judgement, Verdict};
use murmurate::scenario::sightings::SIGHT;
use murmurate::time::Span;
use murmurate::trial::Trial;
use murmurate::world::{ContactRule, Placement, Sensor};

const EPISODES: u32 = 6;

/// Returns a team of five in which no move is blocked, so that it does not matter which World a robot is in.
fn trial(mode: &str, seed: u64) -> Trial {
    let mut trial = Trial::preset(mode, "passage").expect("a preset").seed(seed).episodes(EPISODES).keeping_steps();
    (trial.physics.contacts, trial.physics.wall_radius_m) = (ContactRule::Judge, 0.16);
    trial
}

/// Returns the same team with its bodies on two hosts.
fn apart(mut trial: Trial) -> Trial {
    let hosts = &mut trial.deployment.hosts;
    let world = hosts.iter_mut().find(|host| !host.simulates.is_empty()).expect("one simulates");
    world.simulates = vec![0, 1];
    hosts.push(Host { name: "other-world".to_owned(), simulates: vec![2, 3, 4], ..Host::default() });
    trial.deployment.check().expect("two worlds are sound");
    trial
}

/// Loses a share of all readings, and nothing else.
fn losing(mut trial: Trial, loss: f64) -> Trial {
    let carries = |link: &&mut murmurate::deploy::Link| link.carries.contains(&Kind::Reading);
    let link = trial.deployment.links.iter_mut().find(carries).expect("one carries readings");
    (link.loss, link.impairs) = (loss, vec![Kind::Reading]);
    trial
}

/// Returns the results of an episode that do not depend on how it was judged.
fn result(episode: &Episode) -> Episode {
    Episode { judged: Judged::Truth, ..*episode }
}

/// Returns the results from true states of the same run, from the first step after the start to the verdict.
fn truth(trial: &Trial, report: &TrialReport, episode: u32) -> Option<Judgement> {
    let of = |step: &&Step| step.episode == episode && step.phase == Phase::Running;
    let goals = trial.layouts.episode(episode).iter().map(|task| task.goal).collect();
    let mut judge = Judge::new(trial.scenario.rules(), goals);
    let begun = report.steps.iter().find(of)?.samples[0].time;
    report.steps.iter().filter(of).find_map(|step| {
        let seen = step.samples.iter().map(|s| {
            let position = s.motion.position;
            JudgedRobot { position, point: position, velocity: s.motion.velocity, contacts: s.contacts }
        });
        judge.update(step.samples[0].time.since(begun), &seen.collect::<Vec<_>>())
    })
}

#[test]
fn exact_readings_of_two_worlds_give_the_verdicts_of_one_world() {
    for (mode, placement) in
        [("offboard", Placement::Drive), ("onboard-adhoc", Placement::Drive), ("onboard-infra", Placement::Exact)]
    {
        let mut whole = trial(mode, 12);
        whole.deployment.placement = placement;
        let parts = apart(whole.clone());
        assert_eq!((whole.deployment.judged(), parts.deployment.judged()), (Judged::Truth, Judged::Readings));
        let (whole, parts) = (whole.run(), parts.run());
        assert_eq!(whole.episodes.len(), EPISODES as usize);
        assert!(whole.successes() > 0 && parts.episodes.iter().all(|episode| episode.judged == Judged::Readings));
        let results = |report: &TrialReport| report.episodes.iter().map(result).collect::<Vec<_>>();
        assert_eq!(results(&whole), results(&parts), "{mode}");
        assert_eq!(whole.totals.oldest_command, parts.totals.oldest_command, "true states are told here all the same");
    }
}

#[test]
fn lost_and_late_readings_of_robots_that_succeed_still_show_that_they_do() {
    let (kind, by) = (LinkFaultKind::Reorder, Span::from_millis(120));
    let late = LinkFault { kind, by, kinds: vec![Kind::Reading], ..LinkFault::always("infra") };
    let plan = FaultPlan { actors: Vec::new(), links: vec![late] };
    for trial in [losing(apart(trial("onboard-infra", 5)), 0.2), apart(trial("onboard-infra", 5)).faults(plan)] {
        let report = trial.run();
        assert_eq!(report.episodes.len(), EPISODES as usize);
        for found in &report.episodes {
            let Some(true_one) = truth(&trial, &report, found.episode) else {
                assert_eq!(found.verdict, Verdict::Aborted, "the state server gave it up");
                continue;
            };
            assert_eq!(found.verdict, true_one.verdict, "{found:?}, {true_one:?}");
            assert!(found.min_separation_m > true_one.min_separation_m - 0.15, "{found:?}, {true_one:?}");
            if let Some(makespan_s) = found.makespan_s {
                let later_s = makespan_s - true_one.after.as_secs();
                assert!((-0.051..0.5).contains(&later_s), "seen {later_s} s after it was there");
            }
        }
        assert!(report.successes() > 0);
    }
}

#[test]
fn a_robot_whose_readings_end_is_no_success() {
    let trial = apart(trial("onboard-infra", 12));
    let report = trial.run();
    let of = |step: &&Step| step.episode == 0 && step.phase == Phase::Running;
    let begun = report.steps.iter().find(of).expect("it has run").samples[0].time;
    let first = report.episodes[0];
    assert_eq!(first.verdict, Verdict::Success);
    let end = begun + Span::from_secs(first.makespan_s.expect("it is a success"));
    // The first robot to arrive has no readings from then on, and all others arrive.
    let tasks = trial.layouts.episode(0);
    let there = |at: Vec2, robot: usize| (tasks[robot].goal - at).norm() < 0.2;
    let (at, robot) = report
        .steps
        .iter()
        .filter(of)
        .find_map(|step| {
            let arrived = step.samples.iter().position(|s| there(s.motion.position, s.robot.index()));
            arrived.map(|robot| (step.samples[robot].time, RobotId(robot as u16)))
        })
        .expect("somebody arrives");
    assert!(end.since(at) > SIGHT + Span::from_millis(300), "the others go on for long");
    for (role, kind) in [(Role::Body, ActorFaultKind::Mute), (Role::Body, ActorFaultKind::Crash)] {
        let fault = ActorFault { role, robot, kind, at, lasts: Span::from_secs(1000.0), by: Span::ZERO, episode: None };
        let blind = trial.clone().episodes(1).faults(FaultPlan { actors: vec![fault], links: Vec::new() }).run();
        let found = blind.episodes[0];
        assert_eq!((found.verdict, found.makespan_s), (Verdict::Unseen, None), "{kind:?}");
    }
    // The same with a World of the whole team: no robot is unseen.
    let mut whole = trial.clone().episodes(1);
    whole.deployment = Deployment::preset("onboard-infra", 5).expect("a preset");
    let (role, kind) = (Role::Body, ActorFaultKind::Mute);
    let fault = ActorFault { role, robot, kind, at, lasts: Span::from_secs(1000.0), by: Span::ZERO, episode: None };
    let seen = whole.faults(FaultPlan { actors: vec![fault], links: Vec::new() }).run();
    assert_ne!(seen.episodes[0].verdict, Verdict::Unseen);
}

#[test]
fn noisy_readings_of_a_slow_sensor_give_the_true_verdicts_except_for_what_they_miss() {
    let mut trial = apart(trial("onboard-infra", 3));
    trial.physics.sensor = Sensor { period: Span::from_millis(100), ..Sensor::MOTION_CAPTURE };
    let report = trial.run();
    for found in &report.episodes {
        let true_one = truth(&trial, &report, found.episode).expect("it was not given up");
        let off_m = found.min_separation_m - true_one.min_separation_m;
        assert!((-0.002..0.1).contains(&off_m), "seen from {off_m} m farther away");
        assert!(found.verdict == true_one.verdict || true_one.verdict == Verdict::RobotCollision);
    }
}
