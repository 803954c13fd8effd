//! The command `murmurate sim`: runs episodes in one process under virtual time.

mod trial;

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args as _, FromArgMatches};
use murmurate::config::shown::counted;
use murmurate::deploy::Stepping;
use murmurate::hearing::Handling;
use murmurate::policy::Draw;
use murmurate::registry::Registry;
use murmurate::report::TrialReport;
use murmurate::safety::{Clamp, Safety};
use murmurate::scenario::layout::Layouts;
use murmurate::trial::Trial;
use murmurate::world::{ContactRule, Placement, Sensor};
use murmurate_report::comparison::Comparison;
use murmurate_report::summary::{CostName, Run, Summary};
use serde::Serialize;

use crate::deployment;
use crate::deployment::ModeParser;
use crate::drive;
use crate::jobs;
use crate::picture;
use crate::picture::Pictures;
use crate::progress::{progress, watched};
use crate::recording::{Recorded, Simulated};
use crate::size::SizeFlags;
use crate::watch;
use murmurate_robot::BadInput;
use murmurate_robot::Ended;
use murmurate_robot::bad;
use murmurate_robot::output::{print, read_text};
use murmurate_robot::paths;
use murmurate_robot::recording::RecordFlags;
use murmurate_robot::whole_file::WholeFile;

/// Runs episodes in one process, faster than real time, and prints success rate and makespan.
#[derive(clap::Args)]
pub struct Args {
    /// Mode of the paper, which sets what each host runs
    #[arg(long, default_value = "sim", value_parser = ModeParser)]
    mode: String,
    /// Deployment file, which replaces --mode (see 'murmurate deployment')
    #[arg(long, value_name = "FILE.toml", conflicts_with = "mode")]
    deployment: Option<PathBuf>,
    /// Task of the team: a name, or a task file (docs/tasks.md)
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "passage")]
    scenario: String,
    /// Policy of the robots: a name in the registry (shipped, robust, published, orca or another, also of your crate)
    /// or a policy file (safetensors). Several policies are compared on the same episodes [default: the better one of
    /// shipped and orca: shipped for passage and flocking]
    #[arg(long, value_name = "NAME|FILE")]
    policy: Vec<PathBuf>,
    /// Action of a trained policy: the mean of its distribution or a sample from it [default: as its file says]
    #[arg(long, value_parser = choice([("mean", Draw::Mean), ("sample", Draw::Sample)]))]
    action: Option<Draw>,
    /// Size of the team [default: that of the deployment file, or else the scenario's own]
    #[arg(long)]
    robots: Option<usize>,
    /// Width of the scenario's bottleneck [m] [default: that of the deployment file, or else the scenario's own]
    #[arg(long)]
    gap_m: Option<f32>,
    #[command(flatten)]
    size: SizeFlags,
    /// Number of episodes of a trial, each with its own layout (starts and goals) and a reset before it [default: those
    /// of --episodes-file, or else 200, or 16 with --watch, which shows them in real time]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    episodes: Option<u32>,
    /// Number of episodes without the flag, once it is known.
    #[arg(skip)]
    usual_episodes: OnceLock<u32>,
    /// Number of trials: the same layouts with other random numbers
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    repeats: Option<u32>,
    /// File with starts and goals: {"episodes": [[{"start": [x, y], "goal": [x, y]}, ...], ...]}
    #[arg(long, value_name = "FILE.json")]
    episodes_file: Option<PathBuf>,
    /// Placement of robots at their starts: put there exactly, or driven there [default: as the deployment says]
    #[arg(long, value_parser = choice([("exact", Placement::Exact), ("drive", Placement::Drive)]))]
    placement: Option<Placement>,
    /// Plant: the dynamics of simulated robots (docs/world.md) [default: as the deployment says, or else kinematic]
    #[arg(long)]
    plant: Option<String>,
    /// Time constant of simulated robots' drivetrains: the lag of their true velocity behind commands [s] [default:
    /// that of the plant: kinematic 0, rigid 0.5]
    #[arg(long)]
    lag_s: Option<f32>,
    /// Effect of a contact: 'block' does not make the move, as in training; 'judge' makes it and reports the contact to
    /// the judge [default: block; not for plant rigid]
    #[arg(long, value_parser = choice([("block", ContactRule::Block), ("judge", ContactRule::Judge)]))]
    contacts: Option<ContactRule>,
    /// Distance from a wall at which a robot's centre touches it [m] [default: the scenario's robot radius, 0.25; not
    /// for plant rigid]
    #[arg(long)]
    wall_radius_m: Option<f32>,
    /// Sensor of robots' states: exact, or with noise and latency [default: that of the plant: kinematic exact, rigid
    /// motion-capture]
    #[arg(long, value_parser = choice(Sensor::NAMED))]
    sensor: Option<Sensor>,
    /// Limit of acceleration: 'training' is a limit of the world, 1 m/s^2; 'deployed' is only that of the robots'
    /// controllers, commands within 0.25 m/s of the measured velocity, as on the published robots
    #[arg(long, default_value = "training",
        value_parser = choice([("training", Clamp::Training), ("deployed", Clamp::Deployed)]))]
    clamp: Clamp,
    /// Safety functions between policy and motor commands: 'emulated' are those of the published robots; 'deployed' are
    /// those of real hosts, with stops on late ticks and stale state, a geofence and a minimum distance [default:
    /// emulated in lock step, the conditions of training, as in mode 'sim'; else deployed]
    #[arg(long, value_parser = choice([("emulated", Safety::emulated()), ("deployed", Safety::deployed())]))]
    safety: Option<Safety>,
    /// Handling of a neighbour's message after the step that used it: 'as-published' drops it; 'hold' keeps it until a
    /// newer one arrives or the policy's hold time is over
    #[arg(long, default_value = "hold",
        value_parser = choice([("as-published", Handling::AsPublished), ("hold", Handling::Hold)]))]
    handling: Handling,
    /// Time that a step of the policy takes [ms]; one that takes more than half of its period is late, and its robots
    /// stand, as on real hosts
    #[arg(long, default_value_t = 0.0)]
    step_ms: f64,
    /// Estimator of a robot's state between its readings
    #[arg(long, default_value = "none")]
    estimator: String,
    /// Senses of the robots, such as a lidar: a file with the tables [senses.NAME] of a team file (docs/senses.md)
    #[arg(long, value_name = "FILE.toml")]
    senses: Option<PathBuf>,
    /// Roles of the robots, with a policy, a radius, a drive or senses of their own: a file with the tables
    /// [roles.NAME] of a team file (docs/roles.md)
    #[arg(long, value_name = "FILE.toml")]
    roles: Option<PathBuf>,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Delay of a message on a link [ms]
    #[arg(long, default_value_t = 0.0)]
    delay_ms: f64,
    /// Share of messages that a receiver loses, 0 to 1
    #[arg(long, default_value_t = 0.0)]
    loss: f64,
    /// Messages that --delay-ms and --loss act on: latents, or all on every link but cables [default: latent]
    #[arg(long, value_parser = PossibleValuesParser::new(["latent", "all"]))]
    impair: Option<String>,
    /// Radio of the links: 'none' (ideal links, or those of the deployment file), a preset (PRESETS), or a radio file
    /// (docs/radio.md)
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "none")]
    radio: String,
    /// World, and delay and loss of messages between robots, such as 'study twin' fits them (docs/twin.md); other flags
    /// count before it
    #[arg(long, value_name = "FILE.toml")]
    conditions: Option<PathBuf>,
    /// Transmission range of the links that carry latents [m]: with one, a large team is simulated much faster;
    /// docs/simulate.md says by how much it should exceed the communication range [default: unlimited]
    #[arg(long)]
    link_range_m: Option<f32>,
    /// Communication range of a robot [m], 'inf' for unlimited [default: as the policy's file says]
    #[arg(long)]
    comm_range_m: Option<f32>,
    /// Standard deviation of the communication range, which is drawn anew for every message [m]
    #[arg(long, default_value_t = 0.0)]
    comm_range_std_m: f32,
    /// Fault plan: a seed to draw it from, or a file (docs/faults.md)
    #[arg(long, value_name = "SEED|FILE.toml")]
    faults: Option<String>,
    /// Number of trials that run concurrently; the results do not depend on it [default: one per core]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// CSV file for every robot's trajectory
    #[arg(long, value_name = "FILE.csv")]
    trajectories: Option<PathBuf>,
    #[command(flatten)]
    record: RecordFlags,
    #[command(flatten)]
    drive: drive::DriveFlags,
    #[command(flatten)]
    pictures: picture::Flags,
    #[command(flatten)]
    page: watch::trial::PacedPage,
    /// Prints one JSON object instead of the table
    #[arg(long)]
    json: bool,
    /// Prints only errors and interruptions on stderr
    #[arg(long)]
    quiet: bool,
}

/// Number of episodes without a flag: each with a layout of its own, so that they are as good as independent, and
/// enough for an interval of two points.
const EPISODES: u32 = 200;
/// Number of episodes without a flag if they are shown in real time.
const EPISODES_SHOWN: u32 = 16;

impl Args {
    fn episodes(&self) -> u32 {
        let usual = || {
            // A file that cannot be read is reported where its layouts are.
            let text = self.episodes_file.as_deref().and_then(|path| read_text(path, "episodes file").ok());
            if let Some(held) = text.as_deref().and_then(Layouts::held_in) {
                return held;
            }
            if self.page.is_on() {
                return EPISODES_SHOWN;
            }
            EPISODES
        };
        self.episodes.unwrap_or_else(|| *self.usual_episodes.get_or_init(usual))
    }

    fn repeats(&self) -> u32 {
        self.repeats.unwrap_or(1)
    }

    /// Returns the safety functions of a trial whose agents act by the rule `stepping`.
    fn safety(&self, stepping: Stepping) -> Safety {
        self.safety.unwrap_or(match stepping {
            Stepping::Lockstep => Safety::emulated(),
            Stepping::Seeded => Safety::deployed(),
        })
    }
}

/// Returns the parser of a flag whose value is one of the names in `all`, with the value beside the name.
fn choice<T: Copy + Send + Sync + 'static, const N: usize>(
    all: [(&'static str, T); N],
) -> impl TypedValueParser<Value = T> {
    let named = move |name: String| all.iter().find(|(other, _)| *other == name).map(|(_, value)| *value);
    PossibleValuesParser::new(all.map(|(name, _)| name))
        .map(move |name| named(name).expect("the parser lets only these names through"))
}

/// Runs `sim`: runs the trials of every policy, and prints their results. An error names the flag or the file.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let named: Vec<Option<&Path>> =
        if args.policy.is_empty() { vec![None] } else { args.policy.iter().map(|policy| Some(&**policy)).collect() };
    // All policies are loaded first, so that errors show before the first trial runs.
    let trials: Vec<(Trial, String)> =
        named.iter().map(|policy| trial::of_flags(args, *policy, registry, &|_| None)).collect::<Result<_>>()?;
    args.page.check(trials.len(), args.repeats)?;
    let pictures = Pictures::open(&args.pictures, args.episodes())?;
    if trials.len() > 1 && (args.trajectories.is_some() || pictures.any() || args.record.record.is_some()) {
        return bad("--policy: trajectories, pictures and records are of one policy; name one".to_owned());
    }
    let mut paths = args.trajectories.as_deref().map(WholeFile::create).transpose()?;
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;
    let (repeats, episodes) = (counted(args.repeats(), "repeat"), counted(args.episodes(), "episode"));
    tracing::info!("{repeats} of {episodes}; Ctrl-C prints the results so far");

    let records = records(args, &trials)?;
    let mut results = Vec::new();
    for (trial, policy) in &trials {
        let began = Instant::now();
        let reports = run_all(args, (trial, policy), &pictures, &stop, records.as_ref())?;
        let summary = summary(args, trial, policy, &reports, began.elapsed());
        results.push((summary, reports));
        if stop.load(Ordering::Relaxed) {
            break;
        }
    }
    let interrupted = results.len() < trials.len() || results.iter().any(|(summary, _)| summary.interrupted);
    if let [(trial, policy)] = &trials[..] {
        let (summary, reports) = results.swap_remove(0);
        show(args, &summary)?;
        if let Some(mut file) = paths.take() {
            paths::write_all(&mut file, &reports)?;
            file.keep()?;
        }
        pictures.draw(trial, policy, &reports)?;
    } else {
        show(args, &Comparison::of(results))?;
    }
    Ok(if interrupted { Ended::Interrupted } else { Ended::Done })
}

/// Runs `murmurate sim` with these arguments (without the program's name), and returns its results as JSON without
/// printing them. Ends early once `stop` is set.
pub fn results_of(arguments: &[String], registry: &Registry, stop: &AtomicBool) -> Result<String> {
    let words = ["sim", "--quiet", "--json"].into_iter().map(str::to_owned).chain(arguments.iter().cloned());
    let found = Args::augment_args(clap::Command::new("sim")).try_get_matches_from(words);
    let args = found.and_then(|found| Args::from_arg_matches(&found)).map_err(|error| BadInput(error.to_string()))?;
    let ([] | [_]) = &args.policy[..] else { return bad("--policy: name one policy".to_owned()) };
    args.page.check(1, args.repeats)?;
    let (trial, policy) = trial::of_flags(&args, args.policy.first().map(|policy| &**policy), registry, &|_| None)?;
    let pictures = Pictures::open(&args.pictures, args.episodes())?;
    let mut paths = args.trajectories.as_deref().map(WholeFile::create).transpose()?;
    let trials = [(trial, policy)];
    let records = records(&args, &trials)?;
    let [(trial, policy)] = trials;
    let began = Instant::now();
    let reports = run_all(&args, (&trial, &policy), &pictures, stop, records.as_ref())?;
    let summary = summary(&args, &trial, &policy, &reports, began.elapsed());
    if let Some(mut file) = paths.take() {
        paths::write_all(&mut file, &reports)?;
        file.keep()?;
    }
    pictures.draw(&trial, &policy, &reports)?;
    serde_json::to_string(&summary).context("a result is JSON")
}

/// Prints a result, as a table or as one JSON object.
fn show(args: &Args, result: &(impl Serialize + Display)) -> Result<()> {
    print(&if args.json { serde_json::to_string(result).context("a result is JSON")? } else { result.to_string() })
}

fn summary(args: &Args, trial: &Trial, policy: &str, reports: &[TrialReport], took: Duration) -> Summary {
    let run = Run {
        mode: trial.deployment.mode.clone(),
        scenario: trial.scenario.name().to_owned(),
        policy: policy.to_owned(),
        robots: trial.scenario.robots(),
        cost: CostName::of(&*trial.scenario),
        judged: trial.deployment.judged(),
        seed: args.seed,
        wall_s: took.as_secs_f64(),
        network: deployment::conditions(args.delay_ms, args.loss, args.impair.as_deref() == Some("all"), &args.radio),
        faults: trial.faults.describe(),
        // Ctrl-C after the last episode does not count as an interruption.
        interrupted: reports.len() < args.repeats() as usize || reports.iter().any(|report| !report.finished),
    };
    Summary::of(run, reports)
}

fn run_all(
    args: &Args,
    (trial, _policy): (&Trial, &str),
    pictures: &Pictures,
    stop: &AtomicBool,
    records: Option<&Simulated>,
) -> Result<Vec<TrialReport>> {
    if args.page.is_on() {
        let trial = Trial { steps: pictures.steps(0, trial.steps), ..trial.clone() };
        let report = watch::trial::run(&trial, _policy, &args.page, stop, records)?;
        return records.map_or(Ok(()), Simulated::finish).map(|()| vec![report]);
    }
    let bar = progress(u64::from(args.episodes()) * u64::from(args.repeats()), args.quiet);
    let repeats = args.repeats() as usize;
    let work = |repeat: usize| {
        let repeat = u32::try_from(repeat).expect("repeats were counted in u32");
        let steps = pictures.steps(repeat, trial.steps);
        let trial = Trial { repeat, steps, ..trial.clone() };
        match records {
            Some(records) => records.run((&Recorded::repeat(&trial), &trial), watched(&bar, stop)),
            None => trial.run_while(watched(&bar, stop)),
        }
    };
    let reports = jobs::run(repeats, jobs::threads(args.jobs, repeats), stop, work);
    bar.finish_and_clear();
    records.map_or(Ok(()), Simulated::finish)?;
    Ok(reports.into_iter().map(|(_, report)| report).collect())
}

/// Prepares the records of all repeats of a trial; `None` if the flag `--record` is not given.
fn records(args: &Args, trials: &[(Trial, String)]) -> Result<Option<Simulated>> {
    let [(trial, _), ..] = trials else { return Ok(None) };
    let repeats = (0..args.repeats()).map(|repeat| Recorded::repeat(&Trial { repeat, ..trial.clone() }).name);
    let of_roles = trial.deployment.roles.values().filter_map(|role| role.policy.as_ref());
    let named = [&args.deployment, &args.episodes_file, &args.conditions, &args.senses, &args.roles]
        .into_iter()
        .flatten()
        .chain(&args.policy)
        .chain(of_roles)
        .cloned();
    let texts = args.faults.iter().chain([&args.radio, &args.scenario]).map(PathBuf::from);
    let files = named.chain(texts).collect();
    Simulated::open(&args.record, files, repeats)
}

/// Returns the trial of a recorded simulation, from the recorded arguments of `sim` and the index of its repeat.
/// `place` returns the place of a file that the record has under another path.
pub fn of_record(
    arguments: &[String],
    repeat: u32,
    registry: &Registry,
    place: &dyn Fn(&Path) -> Option<PathBuf>,
) -> Result<Trial> {
    let wrong = |error: clap::Error| BadInput(format!("the record's arguments are not understood: {error}"));
    let command = Args::augment_args(clap::Command::new("sim"));
    let found = command.try_get_matches_from(arguments).map_err(wrong)?;
    let args = Args::from_arg_matches(&found).map_err(wrong)?;
    let (trial, _) = trial::of_flags(&args, args.policy.first().map(|policy| &**policy), registry, place)?;
    Ok(Trial { repeat, ..trial })
}
