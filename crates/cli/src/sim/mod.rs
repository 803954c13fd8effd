//! The command `murmurate sim`: runs episodes in one process under virtual time.

pub mod changes;
pub mod setup;
pub mod trial;

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::{Args as _, FromArgMatches};
use murmurate::config::shown::counted;
use murmurate::registry::Registry;
use murmurate::report::TrialReport;
use murmurate::results::totals::Steps;
use murmurate::trial::Trial;
use murmurate_report::comparison::Comparison;
use murmurate_report::summary::{CostName, Run, Summary};
use serde::Serialize;

use self::setup::Setup;
use self::trial::{Defined, Elsewhere};
use crate::jobs;
use crate::picture;
use crate::picture::Pictures;
use crate::progress::{progress, watched};
use crate::recording::{Recorded, Simulated};
use crate::watch;
use murmurate_robot::BadInput;
use murmurate_robot::Ended;
use murmurate_robot::bad;
use murmurate_robot::output::{print, talk};
use murmurate_robot::paths;
use murmurate_robot::recording::RecordFlags;
use murmurate_robot::whole_file::WholeFile;

/// Runs episodes in one process, faster than real time, and prints success rate and makespan.
#[derive(clap::Args)]
pub struct Args {
    /// Flags that define the trials.
    #[command(flatten)]
    setup: Setup,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Number of trials that run concurrently; the results do not depend on it [default: one per core]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// CSV file for every robot's trajectory
    #[arg(long, value_name = "FILE.csv")]
    trajectories: Option<PathBuf>,
    #[command(flatten)]
    record: RecordFlags,
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
pub const EPISODES: u32 = 200;
/// Number of episodes without a flag if they are shown in real time.
const EPISODES_SHOWN: u32 = 16;

impl Args {
    /// Returns the number of episodes of a trial.
    fn episodes(&self) -> u32 {
        self.setup.episodes(self.usual_episodes())
    }

    /// Returns the trial of `policy` (`None` for the scenario's default policy), and the policy's name in reports.
    fn trial(&self, policy: Option<&Path>, registry: &Registry, place: Elsewhere) -> Result<(Trial, String)> {
        let Defined { mut trial, policy, warnings } =
            trial::of_flags(&self.setup, (self.seed, self.episodes()), policy, (registry, place))?;
        for warning in warnings.iter().filter(|_| !self.quiet) {
            talk(&format!("warning: {warning}"));
        }
        if self.trajectories.is_some() {
            trial.steps = Steps::Reported;
        }
        Ok((trial, policy))
    }

    fn usual_episodes(&self) -> u32 {
        if self.page.is_on() { EPISODES_SHOWN } else { EPISODES }
    }
}

/// Runs `sim`: runs the trials of every policy, and prints their results. An error names the flag or the file.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let policies = &args.setup.policy;
    let named: Vec<Option<&Path>> =
        if policies.is_empty() { vec![None] } else { policies.iter().map(|policy| Some(&**policy)).collect() };
    // All policies are loaded first, so that errors show before the first trial runs.
    let trials: Vec<(Trial, String)> =
        named.iter().map(|policy| args.trial(*policy, registry, &|_| None)).collect::<Result<_>>()?;
    args.page.check(trials.len(), args.setup.repeats)?;
    let pictures = Pictures::open(&args.pictures, args.episodes())?;
    if trials.len() > 1 && (args.trajectories.is_some() || pictures.any() || args.record.record.is_some()) {
        return bad("--policy: trajectories, pictures and records are of one policy; name one".to_owned());
    }
    let mut paths = args.trajectories.as_deref().map(WholeFile::create).transpose()?;
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;
    let (repeats, episodes) = (counted(args.setup.repeats(), "repeat"), counted(args.episodes(), "episode"));
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
    let ([] | [_]) = &args.setup.policy[..] else { return bad("--policy: name one policy".to_owned()) };
    args.page.check(1, args.setup.repeats)?;
    let (trial, policy) = args.trial(args.setup.policy.first().map(|policy| &**policy), registry, &|_| None)?;
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
        network: args.setup.network(),
        faults: trial.faults.describe(),
        // Ctrl-C after the last episode does not count as an interruption.
        interrupted: reports.len() < args.setup.repeats() as usize || reports.iter().any(|report| !report.finished),
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
    let bar = progress(u64::from(args.episodes()) * u64::from(args.setup.repeats()), args.quiet);
    let repeats = args.setup.repeats() as usize;
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
    let repeats = (0..args.setup.repeats()).map(|repeat| Recorded::repeat(&Trial { repeat, ..trial.clone() }).name);
    let of_roles = trial.deployment.roles.values().filter_map(|role| role.policy.as_ref());
    let files = args.setup.files().into_iter().chain(of_roles.cloned()).collect();
    Simulated::open(&args.record, files, repeats)
}

/// Returns the trial of a recorded simulation, from the recorded arguments of `sim` and the index of its repeat.
/// `place` returns the place of a file that the record has under another path.
pub fn of_record(arguments: &[String], repeat: u32, registry: &Registry, place: Elsewhere) -> Result<Trial> {
    let wrong = |error: clap::Error| BadInput(format!("the record's arguments are not understood: {error}"));
    let command = Args::augment_args(clap::Command::new("sim"));
    let found = command.try_get_matches_from(arguments).map_err(wrong)?;
    let args = Args::from_arg_matches(&found).map_err(wrong)?;
    let (trial, _) = args.trial(args.setup.policy.first().map(|policy| &**policy), registry, place)?;
    Ok(Trial { repeat, ..trial })
}
