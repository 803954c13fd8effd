//! A fault test: a robot's controller crashes in mid-episode. Its motors stop in time, the episode is aborted, and the
//! next one succeeds. Copy it into a test of your own.
//!
//!     cargo run --release --example faults

use murmurate::faults::FaultPlan;
use murmurate::graph::COMMAND_VALIDITY;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::phase::Phase;
use murmurate::policy::Model;
use murmurate::scenario::judge::Verdict;
use murmurate::trial::Trial;

/// Fault plan, as in a file for `sim --faults`.
const PLAN: &str = r#"
    [[actor]]
    actor = "controller"
    robot = 2
    fault = "crash"
    episode = 1
    at_s = 2.0
    for_s = 3.0
"#;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let trained = Model::shipped("passage")?;
    let trial = Trial::preset("offboard", "passage")?.model(trained).seed(1).episodes(3);
    let trial = trial.faults(FaultPlan::from_toml(PLAN)?);
    trial.check()?;
    let report = trial.keeping_steps().run();

    // Its motors are told to stand one step of the world after its last command has expired.
    let begins = report.steps.iter().find(|step| step.episode == 1 && step.phase == Phase::Running);
    let began_s = begins.expect("the second episode runs").samples[2].time.as_secs();
    let stopped_s = began_s + 2.0 + COMMAND_VALIDITY.as_secs() + 0.05;
    let during = |time_s: f64| (stopped_s..began_s + 5.0).contains(&time_s);
    let samples = report.steps.iter().map(|step| &step.samples[2]).filter(|sample| during(sample.time.as_secs()));
    let mut seen = 0;
    for sample in samples {
        assert_eq!(sample.command, Vec2::zeros(), "at {}", sample.time);
        seen += 1;
    }
    assert!(seen > 50, "only {seen} samples");

    // The state server misses its heartbeats, aborts the episode, and starts the next.
    let verdicts: Vec<Verdict> = report.episodes.iter().map(|episode| episode.verdict).collect();
    assert_eq!(verdicts, [Verdict::Success, Verdict::Aborted, Verdict::Success]);
    println!(
        "robot 2 was commanded to stand from {:.2} s of episode 1; the episodes: {verdicts:?}",
        stopped_s - began_s
    );
    Ok(())
}
