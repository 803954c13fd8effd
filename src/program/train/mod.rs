//! The command `murmurate train`: flags, clock, progress bar and files of a training. The training itself is in
//! `train`.

mod curve;
mod folder;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::config::unquoted;
use crate::registry::Registry;
use crate::study::network::conditions;
use crate::train::config::{Config, PRESETS};
use crate::train::evaluate::{Scores, quick_evaluation};
use crate::train::trainer::{Plan, Trainer};
use anyhow::{Context, Result};
use clap::builder::PossibleValuesParser;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::program::BadInput;
use crate::program::Ended;
use crate::program::output::{print, read_bytes, read_text, talk};
use crate::program::study;
use curve::{Curve, Row};
use folder::Folder;

/// Time between two saves of the state, and between two lines of progress if there is no progress bar.
const SAVE_EVERY: Duration = Duration::from_secs(30);
/// Difference in progress between two quick evaluations, of 1 for the whole training.
const EVALUATE_EVERY: f64 = 0.05;
/// Number of layouts of a quick evaluation.
const EPISODES: u32 = 128;
/// Name of the default preset.
const PRESET: &str = "robust";
/// Number of senders on the medium of --radio if the configuration has no team size: the paper's team.
const TEAM: usize = 5;

/// Flags of `murmurate train`.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("budget").args(["minutes", "steps"]))]
pub struct Args {
    /// Scenario to train for
    scenario: String,
    /// Preset of the configuration: 'published' for lock step and perfect messages, 'robust' for delay, loss and lag
    /// [default: robust]
    #[arg(
        long,
        conflicts_with = "config",
        value_parser = PossibleValuesParser::new(PRESETS.iter().map(|(name, _)| *name))
    )]
    preset: Option<String>,
    /// A configuration of your own; every training writes its own as OUT/config.toml to start from
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Trains with the delay and loss of a medium instead of the configuration's: a preset (paper, wifi, wifi-n,
    /// wifi-slow) or a radio file, such as 'study network --fit' writes
    #[arg(long, value_name = "NAME|FILE.toml", conflicts_with = "resume")]
    radio: Option<String>,
    /// Duration of the training [min]; schedules follow the clock, so two such runs differ slightly
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
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Starts with the weights of another training, to continue it with another configuration
    #[arg(long, value_name = "CHECKPOINT.bin", conflicts_with = "resume")]
    from: Option<PathBuf>,
    /// Continues the training in the output folder from its checkpoint
    #[arg(long)]
    resume: bool,
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

/// Length of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Budget {
    Minutes(f64),
    Decisions(u64),
}

impl Budget {
    /// Fraction of the budget that is used; 1 and above at the end.
    fn progress(self, elapsed_s: f64, trained: u64) -> f64 {
        match self {
            Budget::Minutes(minutes) => elapsed_s / (60.0 * minutes),
            Budget::Decisions(decisions) => trained as f64 / decisions as f64,
        }
    }

    fn of(args: &Args) -> Result<Budget> {
        match (args.minutes, args.steps) {
            (Some(minutes), _) if (1e-3..=1e6).contains(&minutes) => Ok(Budget::Minutes(minutes)),
            (Some(minutes), _) => Err(BadInput(format!("--minutes: {minutes} is not 0.001 to 1000000")).into()),
            (_, Some(0)) => Err(BadInput("--steps: 0 is not above 0".to_owned()).into()),
            (_, Some(decisions)) => Ok(Budget::Decisions(decisions)),
            _ => Err(BadInput("the length of the training is missing; give --minutes or --steps".to_owned()).into()),
        }
    }
}

/// Result of a training, for the output.
#[derive(Serialize)]
struct Report<'a> {
    policy: String,
    scenario: &'a str,
    preset: &'a str,
    seed: u64,
    decisions: u64,
    iterations: u64,
    wall_s: f64,
    /// `None` after an interruption, so that the program ends at once.
    evaluation: Option<&'a Scores>,
    interrupted: bool,
}

/// Runs the command until the training is complete or interrupted.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let budget = Budget::of(args)?;
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = args.threads.map_or(cores, usize::from);
    let mut folder = Folder::open(&args.out, args.resume)?;
    let (mut trainer, mut curve) = if args.resume {
        let trainer = resume(args, &folder, registry)?;
        let curve = folder.curve(trainer.iterations())?;
        (trainer, curve)
    } else {
        let trainer = begin(args, registry)?;
        folder.write_config(&trainer.plan().config)?;
        (trainer, Curve::default())
    };
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;

    tracing::info!("training; Ctrl-C saves everything");
    if !args.resume {
        folder.save(&trainer, &curve)?;
    }

    let (began, spent_s) = (Instant::now(), curve.elapsed_s());
    let elapsed_s = || spent_s + began.elapsed().as_secs_f64();
    let bar = bar(args.quiet);
    let mut saved = Instant::now();
    let mut interrupted = false;
    loop {
        let progress = budget.progress(elapsed_s(), trainer.decisions());
        if progress >= 1.0 {
            break;
        }
        interrupted = stop.load(Ordering::Relaxed);
        if interrupted {
            break;
        }
        let metrics = match trainer.iterate(progress, threads) {
            Ok(metrics) => metrics,
            Err(diverged) => {
                bar.abandon();
                return Err(anyhow::anyhow!("{diverged}; {}", folder.last_saved()));
            }
        };
        let due = (progress / EVALUATE_EVERY) as u64 > (curve.evaluated_at() / EVALUATE_EVERY) as u64;
        let scores = due.then(|| quick_evaluation(&trainer, EPISODES, threads));
        curve.push(Row::new(elapsed_s(), progress, &metrics, scores.as_ref()));
        let summary = curve.summary(trainer.decisions());
        bar.set_position((progress * 1000.0) as u64);
        bar.set_message(summary.clone());
        if saved.elapsed() >= SAVE_EVERY {
            saved = Instant::now();
            folder.save(&trainer, &curve)?;
            if bar.is_hidden() && !args.quiet {
                talk(&format!("{:3.0} %  {summary}", 100.0 * progress));
            }
        }
    }
    let scores = (!interrupted).then(|| quick_evaluation(&trainer, EPISODES, threads));
    scores.iter().for_each(|scores| curve.set_last_scores(scores));
    folder.save(&trainer, &curve)?;
    bar.finish_and_clear();
    print_report(args, &folder, &trainer, (elapsed_s(), scores.as_ref(), interrupted))?;
    Ok(if interrupted { Ended::Interrupted } else { Ended::Done })
}

/// Prints the result of the training.
fn print_report(
    args: &Args,
    folder: &Folder,
    trainer: &Trainer,
    (wall_s, evaluation, interrupted): (f64, Option<&Scores>, bool),
) -> Result<()> {
    let plan = trainer.plan();
    let report = Report {
        policy: folder.policy().display().to_string(),
        scenario: &plan.scenario,
        preset: &plan.preset,
        seed: plan.seed,
        decisions: trainer.decisions(),
        iterations: trainer.iterations(),
        wall_s,
        evaluation,
        interrupted,
    };
    print(&if args.json { serde_json::to_string(&report).context("a report is JSON")? } else { table(&report) })?;
    if interrupted && !args.quiet {
        talk("interrupted; everything is saved: the same command with --resume continues from here");
    }
    Ok(())
}

fn plan(args: &Args) -> Result<Plan> {
    let preset = args.preset.as_deref().unwrap_or(PRESET);
    let (mut config, preset) = match &args.config {
        Some(path) => {
            let text = read_text(path, "training configuration")?;
            let config = Config::from_toml(&text);
            let wrong = |e| BadInput(format!("the training configuration '{}': {e}", path.display()));
            (config.map_err(wrong)?, "a configuration of the user's")
        }
        None => (Config::preset(preset).expect("the parser accepts presets only"), preset),
    };
    if let Some(radio) = &args.radio {
        let medium = study::medium("--radio", radio)?;
        conditions::apply(&medium, config.robots.unwrap_or(TEAM), &mut config.conditions)
            .ok_or_else(|| BadInput(format!("--radio: none of a team's messages arrives on '{radio}'")))?;
    }
    let (scenario, preset) = (args.scenario.clone(), preset.to_owned());
    Ok(Plan { scenario, preset, config, seed: args.seed.unwrap_or(0) })
}

/// Starts a new training.
fn begin(args: &Args, registry: &Registry) -> Result<Trainer> {
    let plan = plan(args)?;
    let mut trainer = Trainer::new(plan, registry).map_err(|e| match &args.config {
        Some(path) => BadInput(format!("the training configuration '{}': {e}", path.display())),
        None => BadInput(e.to_string()),
    })?;
    if let Some(path) = &args.from {
        let wrong = |why: String| BadInput(format!("cannot begin with '{}': {why}", path.display()));
        let bytes = read_bytes(path, "policy file")?;
        trainer.initialize_from(&bytes).map_err(|e| wrong(e.to_string()))?;
    }
    Ok(trainer)
}

/// Resumes the training in the folder; refused if it does not match the flags.
fn resume(args: &Args, folder: &Folder, registry: &Registry) -> Result<Trainer> {
    let wrong = |why: String| BadInput(format!("cannot resume '{}': {why}", folder.checkpoint().display()));
    let bytes = std::fs::read(folder.checkpoint())
        .map_err(|e| wrong(format!("{e}; leave out --resume to start a training")))?;
    let trainer = Trainer::resume(&bytes, registry).map_err(|e| wrong(unquoted(&e.to_string())))?;
    let theirs = trainer.plan();
    let ours = plan(args)?;
    let other = |what: &str, theirs: &str, ours: &str| {
        Err(wrong(format!("it is of another training: {what} is {theirs} there and {ours} here")))
    };
    if theirs.scenario != ours.scenario {
        other("the scenario", &theirs.scenario, &ours.scenario)?;
    }
    if args.seed.is_some_and(|seed| seed != theirs.seed) {
        other("the seed", &theirs.seed.to_string(), &ours.seed.to_string())?;
    }
    if args.preset.is_some() && theirs.preset != ours.preset {
        other("the preset", &theirs.preset, &ours.preset)?;
    }
    if (args.preset.is_some() || args.config.is_some()) && theirs.config != ours.config {
        return Err(wrong("its configuration differs; see config.toml beside it".to_owned()).into());
    }
    Ok(trainer)
}

fn bar(quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    // If stderr is not a terminal the bar draws nothing, and lines are printed instead.
    let bar = ProgressBar::new(1000);
    let template = "{bar:24} {percent:>3} %  {msg}, {eta} left";
    bar.set_style(ProgressStyle::with_template(template).expect("the template is valid"));
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

fn table(report: &Report) -> String {
    let mut lines = vec![format!(
        "{} decisions in {:.0} s; {} for '{}', seed {}",
        report.decisions, report.wall_s, report.preset, report.scenario, report.seed
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
    lines.push(format!("policy {}", report.policy));
    lines.join("\n")
}
