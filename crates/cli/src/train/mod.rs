//! The command `murmurate train`: flags, time, progress bar and files of a training. The training itself is in
//! `murmurate_train`; `rewards` is the command for scenarios with goals, and `imitation` that for those without.

mod budget;
mod curve;
mod folder;
mod imitation;
mod plan;
mod rewards;
mod training;

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::builder::PossibleValuesParser;
use murmurate::config::shown::counted;
use murmurate::registry::Registry;
use murmurate_train::config::PRESETS;
use murmurate_train::imitation::config::PRESETS as PRESETS_WITHOUT_GOALS;
use serde::Serialize;

use crate::drive;
use crate::size::SizeFlags;
use folder::Folder;
use murmurate_robot::Ended;
use murmurate_robot::output::{print, talk};
pub use plan::with_radio;
use training::{End, Training};

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
    /// scenario without goals, 'coverage' of the one that knows the whole density [default: robust, or without goals
    /// the one that is named as the scenario, or imitation]
    #[arg(
        long,
        conflicts_with = "config",
        value_parser = PossibleValuesParser::new(PRESETS.iter().chain(&PRESETS_WITHOUT_GOALS).map(|(name, _)| *name))
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
    /// Folder for all output: policy.safetensors, checkpoint.bin, curve.csv, curve.svg, config.toml; of roles that are
    /// trained together ROLE.safetensors each, and roles.toml for 'sim --roles'
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

/// Result of a training, as it is printed. `E` is that of the evaluation at its end.
#[derive(Serialize)]
struct Report<'a, E: Serialize + ?Sized> {
    policy: String,
    scenario: &'a str,
    preset: &'a str,
    seed: u64,
    decisions: u64,
    iterations: u64,
    wall_s: f64,
    /// Unit of the costs of the evaluation; none where it has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    unit: Option<&'a str>,
    /// Null after an interruption, because the program then ends without an evaluation.
    evaluation: Option<&'a E>,
    interrupted: bool,
}

impl<'a, E: Serialize + ?Sized> Report<'a, E> {
    /// Returns the result of a training in `folder`, and of the `evaluation` at its end, which has no unit.
    fn of(training: &'a impl Training, (folder, end): (&Folder, End), evaluation: Option<&'a E>) -> Report<'a, E> {
        let (scenario, preset, seed) = training.origin();
        Report {
            policy: folder.file(training.result()).display().to_string(),
            scenario,
            preset,
            seed,
            decisions: training.decisions(),
            iterations: training.iterations(),
            wall_s: end.elapsed_s,
            unit: None,
            evaluation,
            interrupted: end.interrupted,
        }
    }

    /// Returns the report as lines of text. `evaluation` are those of the evaluation, `hints` those about it.
    fn text(&self, evaluation: impl IntoIterator<Item = String>, hints: Option<String>) -> String {
        let Report { policy, scenario, preset, seed, decisions, wall_s, .. } = self;
        let decisions = counted(*decisions, "decision");
        let head = format!("{decisions} in {wall_s:.0} s; {preset} for '{scenario}', seed {seed}");
        let lines: Vec<String> =
            [head].into_iter().chain(evaluation).chain(hints).chain([format!("policy {policy}")]).collect();
        lines.join("\n")
    }
}

/// Runs `train`: trains a policy until the budget is used or the run is interrupted, saves it, and prints the result.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    if imitation::is_meant(args, registry)? { imitation::run(args, registry) } else { rewards::run(args, registry) }
}

/// Opens the output folder of a new or a resumed training; returns whether it is resumed, too.
fn open_folder(args: &Args) -> Result<(Folder, bool)> {
    let out = args.out.as_deref().expect("the parser requires it unless the configuration is printed");
    let folder = Folder::open(out, args.resume.is_some())?;
    let resumes = match args.resume {
        None => false,
        Some(Resume::Always) => true,
        Some(Resume::IfThere) => folder.checkpoint().exists(),
    };
    Ok((folder, resumes))
}

/// Prints the result of a training: as JSON, or by `table`. Returns how the command ends.
fn finish<'a, E: Serialize + ?Sized>(
    args: &Args,
    report: &Report<'a, E>,
    table: impl Fn(&Report<'a, E>) -> String,
) -> Result<Ended> {
    print(&if args.json { serde_json::to_string(report).context("a report is JSON")? } else { table(report) })?;
    if report.interrupted && !args.quiet {
        talk("interrupted; everything is saved: the same command with --resume continues from here");
    }
    Ok(if report.interrupted { Ended::Interrupted } else { Ended::Done })
}
