//! Faults in whole trials: motors stop in time, and the next episode runs.
//!
//! The first test is an example to copy for a system of your own.

use murmurate::faults::{ActorFault, ActorFaultKind, FaultPlan, LinkFault, LinkFaultKind, Role};
use murmurate::graph::COMMAND_VALIDITY;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{MAX_VALIDITY, Phase};
use murmurate::report::TrialReport;
use murmurate::safety::Safety;
use murmurate::scenario::judge::Verdict;
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;
use murmurate::world::kinematic;

/// Example: the controller of robot 2 crashes in the middle of the first episode, for three seconds.
#[test]
fn example_a_crashed_controller_stops_its_robot_and_the_next_episode_runs() {
    let plan = r#"
        [[actor]]
        actor = "controller"
        robot = 2
        fault = "crash"
        at_s = 4.0
        for_s = 3.0
    "#;
    let trial = Trial::preset("offboard", "passage").expect("a preset mode and scenario");
    let trial = trial.seed(1).episodes(2).faults(FaultPlan::from_toml(plan).expect("the plan is sound"));
    let report = trial.keeping_steps().run();

    // Its motors stand still once its last command has expired.
    let stopped_at = 4.0 + COMMAND_VALIDITY.as_secs() + kinematic::PERIOD.as_secs();
    for step in &report.steps {
        let robot = &step.samples[2];
        if (stopped_at..7.0).contains(&robot.time.as_secs()) {
            assert_eq!(robot.command, Vec2::zeros(), "at {}", robot.time);
        }
    }
    // The state server misses its heartbeats, aborts the episode, and starts the next.
    assert_eq!(report.episodes[0].verdict, Verdict::Aborted);
    assert_eq!(report.episodes[1].verdict, Verdict::Success);
}

const MODES: [&str; 3] = ["offboard", "onboard-infra", "onboard-adhoc"];

fn trial(mode: &str, seed: u64) -> Trial {
    Trial::preset(mode, "passage").expect("a preset").seed(seed).episodes(3).keeping_steps()
}

/// Returns the command that reproduces the run.
fn replay(mode: &str, seed: u64, faults: u64) -> String {
    format!(
        "replay with: cargo run --release -- sim --mode {mode} --seed {seed} --episodes 5 --repeats 1 \
         --faults {faults} --trajectories replay.csv"
    )
}

/// Returns plan and command that reproduce a run whose plan was not drawn from a seed.
fn replay_plan(mode: &str, seed: u64, plan: &FaultPlan) -> String {
    format!(
        "replay with the plan\n{}\nin plan.toml: cargo run --release -- sim --mode {mode} --seed {seed} --episodes 3 \
         --repeats 1 --faults plan.toml --trajectories replay.csv",
        plan.to_toml()
    )
}

/// A time in the middle of the first episode.
fn midst(mode: &str, seed: u64) -> Time {
    let report = trial(mode, seed).run();
    let running: Vec<Time> = report
        .steps
        .iter()
        .filter(|step| step.episode == 0 && step.phase == Phase::Running)
        .map(|step| step.samples[0].time)
        .collect();
    running[running.len() / 3]
}

/// Returns the first time between two times at which the robot was driven; `None` if it never was.
fn driven(report: &TrialReport, robot: RobotId, from: Time, until: Time) -> Option<Time> {
    let samples = report.steps.iter().map(|step| &step.samples[robot.index()]);
    samples.filter(|s| s.time >= from && s.time < until).find(|s| s.command != Vec2::zeros()).map(|s| s.time)
}

#[test]
fn a_crash_of_any_actor_stops_the_motors_in_time_and_the_next_episode_runs() {
    let in_time = COMMAND_VALIDITY + kinematic::PERIOD;
    let robot = RobotId(3);
    for mode in MODES {
        for role in [Role::Cache, Role::Agent, Role::Controller, Role::Body, Role::StateServer] {
            let at = midst(mode, 5);
            let lasts = Span::from_millis(4000);
            let fault =
                ActorFault { role, robot, kind: ActorFaultKind::Crash, at, lasts, by: Span::ZERO, episode: None };
            let plan = FaultPlan { actors: vec![fault], links: Vec::new() };
            let replay = replay_plan(mode, 5, &plan);
            let report = trial(mode, 5).faults(plan).run();

            // A dead state server is detected by its silence, any other actor by the messages that it no longer sends.
            let silence =
                if role == Role::StateServer { Span::from_secs(Safety::emulated().silence_s) } else { Span::ZERO };
            let robots = if role == Role::StateServer { RobotId::team(5).collect() } else { vec![robot] };
            for robot in robots {
                let late = driven(&report, robot, at + silence + in_time, at + lasts);
                assert_eq!(late, None, "{mode}: {role:?} crashed at {at}; {robot} was still driven; {replay}");
            }
            assert_eq!(report.episodes.len(), 3, "{mode}: {role:?}: every episode has a result; {replay}");
            let last = report.episodes[2].verdict;
            let episodes = &report.episodes;
            assert_eq!(last, Verdict::Success, "{mode}: {role:?}: the team is back: {episodes:?}; {replay}");
        }
    }
}

#[test]
fn a_robot_whose_agent_was_away_for_a_moment_rejoins_the_running_episode() {
    let at = midst("onboard-adhoc", 6);
    let lasts = Span::from_millis(700);
    let (role, robot, kind) = (Role::Agent, RobotId(0), ActorFaultKind::Crash);
    let fault = ActorFault { role, robot, kind, at, lasts, by: Span::ZERO, episode: None };
    let plan = FaultPlan { actors: vec![fault], links: Vec::new() };
    let report = trial("onboard-adhoc", 6).faults(plan).run();
    assert_eq!(report.episodes[0].verdict, Verdict::Success, "{:?}", report.episodes[0]);
    let back = at + lasts + Span::from_millis(300);
    assert!(driven(&report, robot, at + lasts, back).is_some(), "it drives again");
}

#[test]
fn a_stalled_or_mute_actor_is_missed_and_rejoins() {
    for kind in [ActorFaultKind::Stall, ActorFaultKind::Mute] {
        let at = midst("onboard-infra", 7);
        let (role, robot, lasts) = (Role::Controller, RobotId(1), Span::from_millis(2500));
        let fault = ActorFault { role, robot, kind, at, lasts, by: Span::ZERO, episode: None };
        let plan = FaultPlan { actors: vec![fault], links: Vec::new() };
        let report = trial("onboard-infra", 7).faults(plan).run();
        let late = driven(&report, robot, at + COMMAND_VALIDITY + kinematic::PERIOD, at + lasts);
        assert_eq!(late, None, "{kind:?}: still driven");
        assert_eq!(report.episodes[0].verdict, Verdict::Aborted, "{kind:?}");
        assert_eq!(report.episodes[2].verdict, Verdict::Success, "{kind:?}");
    }
}

#[test]
fn a_slow_actor_only_adds_delay() {
    let slow = |by| {
        let (role, robot, kind) = (Role::Agent, RobotId(1), ActorFaultKind::Slow);
        let fault = ActorFault { role, robot, kind, at: Time::ZERO, lasts: Span::from_secs(1000.0), by, episode: None };
        trial("offboard", 8).faults(FaultPlan { actors: vec![fault], links: Vec::new() }).run()
    };
    let (report, quick) = (slow(Span::from_millis(30)), trial("offboard", 8).run());
    assert_eq!(report.episodes.len(), 3);
    assert_ne!(report.totals, quick.totals, "the fault has an effect");
    assert_eq!(report.episodes[2].verdict, Verdict::Success);
}

#[test]
fn a_partitioned_network_stops_the_team_and_heals() {
    let from = midst("onboard-infra", 9);
    let until = from + Span::from_millis(3000);
    // Host 0 is robot 0's; on infra travel its readings, heartbeats and instructions.
    let hosts = vec![murmurate::messages::ids::HostId(0)];
    let fault = LinkFault { kind: LinkFaultKind::Partition, hosts, from, until, ..LinkFault::always("infra") };
    let report = trial("onboard-infra", 9).faults(FaultPlan { actors: Vec::new(), links: vec![fault] }).run();
    // Without own readings: 100 ms until they are stale, one tick, and the validity of the last command.
    let in_time = Span::from_millis(100) + kinematic::PERIOD + COMMAND_VALIDITY + kinematic::PERIOD;
    assert_eq!(driven(&report, RobotId(0), from + in_time, until), None);
    assert_eq!(report.episodes[0].verdict, Verdict::Aborted);
    assert_eq!(report.episodes[2].verdict, Verdict::Success);
}

#[test]
fn seeded_plans_are_always_safe_and_make_progress_once_they_are_over() {
    for seed in 0..24 {
        let mode = MODES[seed as usize % MODES.len()];
        let trial = trial(mode, seed).episodes(5).random_faults(seed);
        let plan = trial.faults.clone();
        // Commands of a stalled or slow actor may be executed that late.
        let late = plan.actors.iter().map(|fault| match fault.kind {
            ActorFaultKind::Stall => fault.lasts,
            ActorFaultKind::Slow => fault.by,
            ActorFaultKind::Crash | ActorFaultKind::Mute | ActorFaultKind::Flat => Span::ZERO,
        });
        // A frame that is slowed down arrives that much later, and a garbled one may claim the longest validity.
        let links = plan.links.iter().map(|fault| match fault.kind {
            LinkFaultKind::Delay | LinkFaultKind::Reorder => fault.by,
            LinkFaultKind::Corrupt => MAX_VALIDITY,
            _ => Span::ZERO,
        });
        let late = late.max().unwrap_or(Span::ZERO) + links.max().unwrap_or(Span::ZERO);
        let bound = COMMAND_VALIDITY + kinematic::PERIOD + late;
        let over = plan.over();
        let report = trial.run();
        let replay = replay(mode, seed, seed);

        let totals = report.totals;
        assert!(report.finished, "the trial ends; {replay}");
        let oldest = totals.oldest_command.expect("all true states were told");
        assert!(oldest <= bound, "driven by a command {oldest} old; {replay}");
        assert_eq!(report.episodes.len(), 5, "every episode has a result; {replay}");
        assert!(totals.end > over, "the faults were over before the end; {replay}");
        assert_eq!(report.episodes[4].verdict, Verdict::Success, "{:?}; {replay}", report.episodes);
    }
}

#[test]
fn an_episode_has_one_result_whatever_crashes_together() {
    let everyone = [Role::Cache, Role::Agent, Role::Controller, Role::Body];
    for mode in ["sim", "offboard", "onboard-infra"] {
        let at = Time::ZERO + Span::from_millis(12_000);
        let (kind, lasts, by) = (ActorFaultKind::Crash, Span::from_millis(2000), Span::ZERO);
        let of = |role| move |robot| ActorFault { role, robot, kind, at, lasts, by, episode: None };
        let mut actors: Vec<ActorFault> = everyone.iter().flat_map(|&role| RobotId::team(5).map(of(role))).collect();
        actors.push(of(Role::StateServer)(RobotId(0)));
        let report = trial(mode, 3).episodes(4).faults(FaultPlan { actors, links: Vec::new() }).run();
        let numbers: Vec<u32> = report.episodes.iter().map(|episode| episode.episode).collect();
        assert_eq!(numbers, [0, 1, 2, 3], "{mode}: {:?}", report.episodes);
    }
}

#[test]
fn a_trial_ends_even_if_the_state_server_never_restarts() {
    let (role, robot, kind) = (Role::StateServer, RobotId(0), ActorFaultKind::Crash);
    let (at, lasts) = (midst("sim", 5), Span::from_secs(100_000.0));
    let fault = ActorFault { role, robot, kind, at, lasts, by: Span::ZERO, episode: None };
    let report = trial("sim", 5).faults(FaultPlan { actors: vec![fault], links: Vec::new() }).run();
    assert!(report.finished && report.simulated < Span::from_secs(1000.0), "{}", report.simulated);
    let verdicts: Vec<Verdict> = report.episodes.iter().map(|episode| episode.verdict).collect();
    assert_eq!(verdicts.len(), 3);
    assert_eq!(verdicts[2], Verdict::Aborted);
}

#[test]
fn a_fault_timed_from_an_episode_acts_in_that_episode() {
    let (role, robot, kind) = (Role::Controller, RobotId(2), ActorFaultKind::Crash);
    let (at, lasts) = (Time::ZERO + Span::from_millis(2000), Span::from_millis(1500));
    let crash = ActorFault { role, robot, kind, at, lasts, by: Span::ZERO, episode: Some(1) };
    let (from, until) = (Time::ZERO + Span::from_millis(1000), Time::ZERO + Span::from_millis(4000));
    let silence = LinkFault { from, until, episode: Some(1), ..LinkFault::always("infra") };
    let plans =
        [FaultPlan { actors: vec![crash], links: Vec::new() }, FaultPlan { actors: Vec::new(), links: vec![silence] }];
    for plan in plans {
        let verdicts = |plan: FaultPlan| {
            let report = trial("onboard-infra", 3).faults(plan).run();
            report.episodes.iter().map(|episode| episode.verdict).collect::<Vec<_>>()
        };
        assert_eq!(verdicts(FaultPlan::default()), [Verdict::Success; 3]);
        let expected = [Verdict::Success, Verdict::Aborted, Verdict::Success];
        assert_eq!(verdicts(plan.clone()), expected, "{:?}", plan.describe());
    }
}

#[test]
fn a_restarted_world_finds_its_robots_where_they_were() {
    let at = midst("offboard", 4);
    let (role, robot, kind, lasts) = (Role::World, RobotId(0), ActorFaultKind::Crash, Span::from_millis(300));
    let fault = ActorFault { role, robot, kind, at, lasts, by: Span::ZERO, episode: None };
    let report = trial("offboard", 4).faults(FaultPlan { actors: vec![fault], links: Vec::new() }).run();
    for pair in report.steps.windows(2) {
        for (before, after) in pair[0].samples.iter().zip(&pair[1].samples) {
            let moved = (after.motion.position - before.motion.position).norm();
            assert!(moved < 0.15, "{} moved {moved} m in one step at {}", after.robot, after.time);
        }
    }
    assert_eq!(report.episodes[2].verdict, Verdict::Success);
}

#[test]
fn two_worlds_share_a_team_even_if_one_is_slow() {
    let slow = (Role::World, RobotId(3), ActorFaultKind::Slow, Span::from_millis(10));
    let (at, lasts) = (Time::ZERO + Span::from_millis(500), Span::from_secs(1000.0));
    let fault = ActorFault { role: slow.0, robot: slow.1, kind: slow.2, at, lasts, by: slow.3, episode: None };
    let mut trial = trial("onboard-adhoc", 10).faults(FaultPlan { actors: vec![fault], links: Vec::new() });
    let hosts = &mut trial.deployment.hosts;
    let world = hosts.last_mut().expect("the last host is the world's");
    world.simulates = vec![0, 1];
    let other = murmurate::deploy::Host {
        name: "other-world".to_owned(),
        simulates: vec![2, 3, 4],
        state_server: false,
        ..world.clone()
    };
    hosts.push(other);
    trial.deployment.check().expect("two worlds are sound");
    let report = trial.run();
    assert_eq!(report.successes(), 3, "{:?}", report.episodes);
    assert!(report.steps.iter().all(|step| step.samples.len() == 5), "the recorder sees both worlds as one");
}
