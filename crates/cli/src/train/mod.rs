//! The command `murmurate train`: flags, time, progress bar and files of a training. The training itself is in
//! `murmurate_train`; `imitation` is the command for scenarios without goals.

mod budget;
mod curve;
mod folder;
mod imitation;
mod plan;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::builder::PossibleValuesParser;
use indicatif::{ProgressBar, ProgressStyle};
use murmurate::config::shown::counted;
use murmurate::registry::Registry;
use murmurate_train::config::{Config, PRESETS};
use murmurate_train::evaluate::{Scores, quick_evaluation};
use murmurate_train::expectation;
use murmurate_train::imitation::config::PRESET as PRESET_WITHOUT_GOALS;
use murmurate_train::reward::has_reward;
use murmurate_train::trainer::Trainer;
use serde::Serialize;

use crate::drive;
use crate::size::SizeFlags;
use budget::{Budget, Clock, Timed};
use curve::{Curve, Row};
use folder::Folder;
use murmurate_robot::Ended;
use murmurate_robot::output::{print, talk};
pub use plan::with_radio;

/// Interval at which a training saves its files, and prints progress lines if there is no progress bar.
const SAVE_EVERY: Duration = Duration::from_secs(30);
/// Interval of quick evaluations during a training, as a share of the whole training.
const EVALUATE_EVERY: f64 = 0.05;
/// Number of layouts of a quick evaluation.
const EPISODES: u32 = 128;
/// Share of these layouts, one in so many, by which a training of minutes finds out how long an evaluation takes.
const EVALUATION_PART: u32 = 16;
/// Name of the preset of the training's configuration that is used without `--preset` and `--config`.
const PRESET: &str = "robust";

/// Trains a policy.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("budget").args(["minutes", "steps"]))]
pub struct Args {
    /// Scenario to train for: a name, or a task file
    #[arg(value_name = "SCENARIO|FILE.toml")]
    scenario: String,
    /// Preset of the configuration: 'published' for lock step and perfect messages, 'robust' for delay, loss and lag,
    /// 'any-size' for these, teams of two to twelve and the safety filter, 'imitation' of a scripted policy in a
    /// scenario without goals [default: robust, or imitation without goals]
    #[arg(
        long,
        conflicts_with = "config",
        value_parser = PossibleValuesParser::new(PRESETS.iter().map(|(name, _)| *name).chain([PRESET_WITHOUT_GOALS]))
    )]
    preset: Option<String>,
    /// A configuration of your own; --print-config prints one to start from
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Sets a field of the configuration, such as ppo.clip=0.1 or 'conditions.lag_s=[0.2, 0.4]'; may be given several
    /// times
    #[arg(long, value_name = "FIELD=VALUE")]
    set: Vec<String>,
    /// Size of the team; a preset's groups scale with it [default: the preset's, or else the scenario's own]
    #[arg(long, conflicts_with = "config")]
    robots: Option<usize>,
    #[command(flatten)]
    size: SizeFlags,
    /// Trains with the delay and loss of a medium instead of the configuration's: a preset (PRESETS) or a radio
    /// file, such as 'study network --fit' writes
    #[arg(long, value_name = "NAME|FILE.toml")]
    radio: Option<String>,
    /// Trains with the lag, and the delay and loss of messages between robots, of a file, such as 'study twin' fits
    /// them (docs/twin.md)
    #[arg(long, value_name = "FILE.toml")]
    conditions: Option<PathBuf>,
    #[command(flatten)]
    drive: drive::DriveFlags,
    /// Duration of the command [min], with all evaluations and files, but at least one iteration and one evaluation;
    /// schedules follow the clock, so two such runs differ slightly
    #[arg(long)]
    minutes: Option<f64>,
    /// Number of decisions to train on, one per environment and step of the policy; the same number and seed give the
    /// same weights
    #[arg(long)]
    steps: Option<u64>,
    /// Seed of all random numbers [default: 0]
    #[arg(long)]
    seed: Option<u64>,
    /// Folder for all output: policy.safetensors, checkpoint.bin, curve.csv, curve.svg, config.toml
    #[arg(long, value_name = "FOLDER", required_unless_present = "print_config")]
    out: Option<PathBuf>,
    /// Prints the configuration as TOML, for the scenario's team, and trains nothing
    #[arg(long, conflicts_with_all = ["out", "budget", "from", "resume", "json"])]
    print_config: bool,
    /// Starts with the weights of another training, to continue it with another configuration
    #[arg(long, value_name = "CHECKPOINT.bin", conflicts_with = "resume")]
    from: Option<PathBuf>,
    /// Continues the training in the output folder from its checkpoint; '--resume=if-there' begins one if there is no
    /// checkpoint
    #[arg(long, value_name = "WHEN", num_args = 0..=1, require_equals = true, default_missing_value = "always")]
    resume: Option<Resume>,
    /// Threads [default: one per core]; the weights do not depend on it
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Prints one JSON object instead of the table
    #[arg(long)]
    json: bool,
    /// Prints nothing on stderr except errors
    #[arg(long)]
    quiet: bool,
}

/// When a training is continued from the checkpoint in its output folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Resume {
    /// Always: without a checkpoint the program ends with an error.
    Always,
    /// If there is a checkpoint; otherwise a training begins.
    IfThere,
}

/// Result of a training, as it is printed.
#[derive(Serialize)]
struct Report<'a> {
    policy: String,
    scenario: &'a str,
    preset: &'a str,
    seed: u64,
    decisions: u64,
    iterations: u64,
    wall_s: f64,
    /// Success rates and makespans of the policy at the end of the training; `None` after an interruption, because the
    /// program then ends without an evaluation.
    evaluation: Option<&'a Scores>,
    interrupted: bool,
}

/// Runs `train`: trains a policy until the budget is used or the run is interrupted, saves it, and prints the result.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    if imitation::is_meant(args, registry)? {
        return imitation::run(args, registry);
    }
    if args.print_config {
        print(plan::config_text(args, registry)?.trim_end())?;
        return Ok(Ended::Done);
    }
    let (budget, began) = (Budget::of(args)?, Instant::now());
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = args.threads.map_or(cores, usize::from);
    let out = args.out.as_deref().expect("the parser requires it unless the configuration is printed");
    let (mut folder, mut trainer, mut curve) = begin(args, out, registry)?;
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;

    tracing::info!("training; Ctrl-C saves everything");
    if !args.quiet {
        announce(&trainer, budget);
    }
    let spent_s = curve.elapsed_s();
    let elapsed_s = || spent_s + began.elapsed().as_secs_f64();
    let mut clock = Clock::new(budget);
    if clock.counts_minutes() {
        estimate_evaluation(&mut clock, &trainer, threads);
    }
    let mut last = None;
    let bar = bar(args.quiet);
    let mut saved = Instant::now();
    let mut interrupted = false;
    loop {
        let progress = clock.progress(elapsed_s(), trainer.decisions());
        if progress >= 1.0 {
            break;
        }
        interrupted = stop.load(Ordering::Relaxed);
        if interrupted {
            break;
        }
        let metrics = match clock.time(Timed::Iteration, || trainer.iterate(progress, threads)) {
            Ok(metrics) => metrics,
            Err(diverged) => {
                bar.abandon();
                return Err(anyhow::anyhow!("{diverged}; {}", folder.last_saved()));
            }
        };
        let due = (progress / EVALUATE_EVERY) as u64 > (curve.evaluated_at() / EVALUATE_EVERY) as u64;
        let scores = due.then(|| clock.time(Timed::Evaluation, || quick_evaluation(&trainer, EPISODES, threads)));
        curve.push(Row::new(elapsed_s(), progress, &metrics, scores.as_ref()));
        last = scores;
        let summary = curve.summary(trainer.decisions(), trainer.plan().config.curriculum.len());
        bar.set_position((progress * 1000.0) as u64);
        bar.set_message(summary.clone());
        if saved.elapsed() >= SAVE_EVERY {
            saved = Instant::now();
            clock.time(Timed::Save, || folder.save(&trainer, &curve))?;
            if bar.is_hidden() && !args.quiet {
                talk(&format!("{:3.0} %  {summary}", 100.0 * progress));
            }
        }
    }
    // The last iteration may have been evaluated already.
    let scores = (!interrupted).then(|| last.unwrap_or_else(|| quick_evaluation(&trainer, EPISODES, threads)));
    scores.iter().for_each(|scores| curve.set_last_scores(scores));
    folder.save(&trainer, &curve)?;
    bar.finish_and_clear();
    let report = report(&folder, &trainer, (elapsed_s(), scores.as_ref(), interrupted));
    finish(args, &report, table, interrupted)
}

/// Says when the stages of the curriculum begin, and if the scenario has a reward of its own which the training does
/// not use.
fn announce(trainer: &Trainer, budget: Budget) {
    schedule(&trainer.plan().config, budget).iter().for_each(|stages| talk(stages));
    if !trainer.uses_scenario_reward() && has_reward(&**trainer.scenario()) {
        let name = &trainer.plan().scenario;
        talk(&format!("note: the reward of scenario '{name}' itself has weight 0 (reward.scenario) and is not used"));
    }
}

/// Returns a line about when the stages of the curriculum begin; `None` if there is only one.
fn schedule(config: &Config, budget: Budget) -> Option<String> {
    let (_, before) = config.curriculum.split_last()?;
    let begins = |share: f64| match budget {
        Budget::Minutes(minutes) => format!("{:.1} min", share * minutes),
        Budget::Decisions(decisions) => format!("{:.2} M decisions", share * decisions as f64 / 1e6),
    };
    let ends: Vec<String> = before.iter().map(|stage| begins(stage.until)).collect();
    let stages = config.curriculum.len();
    (!ends.is_empty())
        .then(|| format!("{stages} stages, the later ones from {} on; success drops as one begins", ends.join(", ")))
}

/// Notes how long an evaluation takes, from a part of one: a short training may have only the one at its end.
fn estimate_evaluation(clock: &mut Clock, trainer: &Trainer, threads: usize) {
    let part = Instant::now();
    quick_evaluation(trainer, EPISODES / EVALUATION_PART, threads);
    clock.took(Timed::Evaluation, f64::from(EVALUATION_PART) * part.elapsed().as_secs_f64());
}

/// Opens the output folder `out`, and returns it with the trainer and the learning curve: those of the training in the
/// folder, or of a new one, which is saved there.
fn begin(args: &Args, out: &Path, registry: &Registry) -> Result<(Folder, Trainer, Curve)> {
    let mut folder = Folder::open(out, args.resume.is_some())?;
    if resumes(args, &folder) {
        let trainer = plan::resume(args, &folder, registry)?;
        let curve = folder.curve(trainer.iterations())?;
        return Ok((folder, trainer, curve));
    }
    let (trainer, curve) = (plan::begin(args, registry)?, Curve::default());
    folder.write_config(&trainer.plan().config)?;
    folder.save(&trainer, &curve)?;
    Ok((folder, trainer, curve))
}

/// Returns whether the training in the output folder is continued.
fn resumes(args: &Args, folder: &Folder) -> bool {
    match args.resume {
        None => false,
        Some(Resume::Always) => true,
        Some(Resume::IfThere) => folder.checkpoint().exists(),
    }
}

/// Returns the result of the training.
fn report<'a>(
    folder: &Folder,
    trainer: &'a Trainer,
    (wall_s, evaluation, interrupted): (f64, Option<&'a Scores>, bool),
) -> Report<'a> {
    let plan = trainer.plan();
    Report {
        policy: folder.policy().display().to_string(),
        scenario: trainer.scenario().name(),
        preset: &plan.preset,
        seed: plan.seed,
        decisions: trainer.decisions(),
        iterations: trainer.iterations(),
        wall_s,
        evaluation,
        interrupted,
    }
}

/// Prints the result of a training: as JSON, or by `table`. Returns how the command ends.
fn finish<R: Serialize>(args: &Args, report: &R, table: impl Fn(&R) -> String, interrupted: bool) -> Result<Ended> {
    print(&if args.json { serde_json::to_string(report).context("a report is JSON")? } else { table(report) })?;
    if interrupted && !args.quiet {
        talk("interrupted; everything is saved: the same command with --resume continues from here");
    }
    Ok(if interrupted { Ended::Interrupted } else { Ended::Done })
}

/// Returns a text on the success that trainings with this preset have reached after more decisions; `None` if none was
/// better than this one, or if nothing is known of the preset.
fn expectation(report: &Report, decisions_per_s: f64) -> Option<String> {
    let measured = expectation::measured(report.preset)?;
    let success = report.evaluation?.with_default_draw("perfect")?.success;
    let better = measured.iter().find(|known| known.decisions > report.decisions && known.success > success)?;
    let known: Vec<String> = measured
        .iter()
        .map(|known| format!("{:.0} % after {:.1} M", 100.0 * known.success, known.decisions as f64 / 1e6))
        .collect();
    Some(format!(
        "{:.2} M decisions; on '{}' trainings with this preset reached {}; {:.1} M take about {:.0} minutes here",
        report.decisions as f64 / 1e6,
        expectation::SCENARIO,
        known.join(", "),
        better.decisions as f64 / 1e6,
        better.decisions as f64 / decisions_per_s / 60.0,
    ))
}

fn bar(quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    // If stderr is not a terminal, the bar draws nothing, and progress lines are printed.
    let bar = ProgressBar::new(1000);
    let template = "{bar:24} {percent:>3} %  {msg}, {eta} left";
    bar.set_style(ProgressStyle::with_template(template).expect("the template is valid"));
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

fn table(report: &Report) -> String {
    let mut lines = vec![format!(
        "{} in {:.0} s; {} for '{}', seed {}",
        counted(report.decisions, "decision"),
        report.wall_s,
        report.preset,
        report.scenario,
        report.seed
    )];
    for score in report.evaluation.iter().flat_map(|scores| &scores.0) {
        let makespan = score.makespan_s.map_or("-".to_owned(), |makespan| format!("{makespan:.2} s"));
        lines.push(format!(
            "{:<10} {:<7} success {:5.1} %  median makespan {makespan}  ({EPISODES} layouts)",
            score.conditions,
            score.action,
            100.0 * score.success
        ));
    }
    lines.extend(expectation(report, report.decisions as f64 / report.wall_s.max(1e-9)));
    lines.push(format!("policy {}", report.policy));
    lines.join("\n")
}
