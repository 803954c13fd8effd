//! A fault test: a robot's controller crashes in mid-episode. Its motors stop in time, the episode is aborted, and the
//! next one succeeds. Copy it into a test of your own.
//!
//!     cargo run --release --example faults

use murmurate::faults::FaultPlan;
use murmurate::graph::COMMAND_VALIDITY;
use murmurate::messages::geometry::Vec2;
use murmurate::scenario::judge::Verdict;
use murmurate::trial::Trial;

/// Fault plan, as in a file for `sim --faults`.
const PLAN: &str = r#"
    [[actor]]
    actor = "controller"
    robot = 2
    fault = "crash"
    at_s = 4.0
    for_s = 3.0
"#;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let trial = Trial::preset("offboard", "passage")?.seed(1).episodes(2).faults(FaultPlan::from_toml(PLAN)?);
    trial.check()?;
    let report = trial.keeping_steps().run();

    // Its motors stand still one step of the world after its last command has expired.
    let stopped_s = 4.0 + COMMAND_VALIDITY.as_secs() + 0.05;
    let during = |time_s: f64| (stopped_s..7.0).contains(&time_s);
    let samples = report.steps.iter().map(|step| &step.samples[2]).filter(|sample| during(sample.time.as_secs()));
    let mut seen = 0;
    for sample in samples {
        assert_eq!(sample.command, Vec2::zeros(), "at {}", sample.time);
        seen += 1;
    }
    assert!(seen > 50, "only {seen} samples");

    // The state server misses its heartbeats, aborts the episode, and starts the next.
    let verdicts: Vec<Verdict> = report.episodes.iter().map(|episode| episode.verdict).collect();
    assert_eq!(verdicts, [Verdict::Aborted, Verdict::Success]);
    println!("robot 2 stood still from {stopped_s:.2} s to 7 s; the episodes: {verdicts:?}");
    Ok(())
}
