//! The command `murmurate study commbench`: the benchmark of communication, with policies of the user's own. The
//! benchmark itself is in the library of studies.

mod entered;
mod entries;
mod files;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::builder::PossibleValuesParser;
use indicatif::ProgressBar;
use murmurate::config::shown::counted;
use murmurate::registry::Registry;
use murmurate_study::commbench::matrix::{self, CHANNELS, Channel, Empty, KINDS, TASKS, Task};
use murmurate_study::commbench::results::{Comparison, Results, Row};
use murmurate_study::commbench::verdict::LEVEL;
use murmurate_study::commbench::{Bench, Job, NAME, Record, seeds, table};
use serde::Serialize;

use super::flags::build;
use super::folder::Folder;
use super::part;
use super::run::{CommandLine, Run, check_unique};
use super::shard::Shard;
use crate::progress::watched;
use entered::Entered;
use murmurate_robot::output::{print, talk};
use murmurate_robot::{Ended, bad, own_name};

/// Flags of `murmurate study commbench`.
#[derive(clap::Args)]
pub struct Args {
    /// Tasks, separated by commas [default: all]
    #[arg(long, value_name = "TASK,...", value_delimiter = ',',
        value_parser = PossibleValuesParser::new(TASKS.map(|task| task.name)))]
    tasks: Vec<String>,
    /// Channels, separated by commas; 'perfect' is always among them [default: all]
    #[arg(long, value_name = "CHANNEL,...", value_delimiter = ',',
        value_parser = PossibleValuesParser::new(CHANNELS.map(|channel| channel.name)))]
    channels: Vec<String>,
    /// Kinds of policies, separated by commas: 'scripted', 'without' (trained on perfect messages) and 'trained' (on
    /// messages that are late or lost) [default: all]
    #[arg(long, value_name = "KIND,...", value_delimiter = ',', value_parser = PossibleValuesParser::new(KINDS))]
    policies: Vec<String>,
    /// Enters a policy under a name of yours: a policy file, or the name of a policy, for one task or for all that it
    /// fits; may be given several times
    #[arg(long, value_name = "NAME=POLICY[:TASK]")]
    enter: Vec<Entered>,
    /// Number of episodes of each policy in each cell [default: 200 to 12, fewer where they take long]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(seeds::MOST_EPISODES)))]
    episodes: Option<u32>,
    /// Runs the K-th of N parts of the jobs, each part on a machine of its own, into the folder of --out. The same
    /// command without this flag then writes the report (docs/study.md)
    #[arg(long, value_name = "K/N", requires = "out")]
    shard: Option<Shard>,
    /// Flags that all studies share.
    #[command(flatten)]
    run: Run,
}

/// Output of the benchmark with `--json`.
#[derive(Serialize)]
struct Report<'a> {
    study: &'static str,
    rows: Vec<&'a Row>,
    comparisons: &'a [Comparison],
    empty: &'a [Empty],
    /// Confidence of the intervals of `comparisons`.
    level: f64,
    wall_s: f64,
    seed: u64,
    /// Number of finished jobs, and number of all jobs.
    trials: [usize; 2],
    interrupted: bool,
}

/// Runs `study commbench`: runs the episodes of all policies in all cells, prints the tables and writes the report.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let bench = args.bench(registry)?;
    let folder = args.run.out.as_deref().map(|path| files::open(path, &bench)).transpose()?;
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;

    let began = Instant::now();
    let records = args.run_all(&bench, folder.as_ref(), &stop)?;
    let (all, done) = (bench.jobs(), records.len());
    if let (Some(shard), Some(folder)) = (args.shard, &folder) {
        let finished: BTreeSet<Job> = records.iter().map(|(job, _)| *job).collect();
        return part::is_done((NAME, shard), &all, &finished, (folder, &args.run));
    }
    let interrupted = done < all.len();
    let results = Results::of(&bench, &records);
    if let (Some(folder), false) = (&folder, interrupted) {
        files::write_report(folder, &bench, &results, &records)?;
    }
    let wall_s = began.elapsed().as_secs_f64();
    print(&if args.run.json {
        let report = Report {
            study: NAME,
            rows: results.rows.iter().flatten().collect(),
            comparisons: &results.comparisons,
            empty: &bench.empty,
            level: LEVEL,
            wall_s,
            seed: bench.seed,
            trials: [done, all.len()],
            interrupted,
        };
        serde_json::to_string(&report).context("a report is JSON")?
    } else {
        format!("{}\n\n{done} of {}; {wall_s:.1} s", table::text(&bench, &results), counted(all.len(), "job"))
    })?;
    args.run.print_location(folder.as_ref(), "jobs", done, all.len());
    Ok(if interrupted { Ended::Interrupted } else { Ended::Done })
}

impl Args {
    /// Returns the benchmark as the flags define it. An error names the flag.
    fn bench(&self, registry: &Registry) -> Result<Bench> {
        for (flag, names) in [("--tasks", &self.tasks), ("--channels", &self.channels), ("--policies", &self.policies)]
        {
            check_unique(flag, names)?;
        }
        if self.run.seed > seeds::MOST_SEED {
            return bad(format!("--seed: {} is more than {}", self.run.seed, seeds::MOST_SEED));
        }
        let chosen = |names: &[String], name: &str| names.is_empty() || names.iter().any(|other| other == name);
        let tasks: Vec<&'static Task> = TASKS.iter().filter(|task| chosen(&self.tasks, task.name)).collect();
        let channels: Vec<&'static Channel> =
            CHANNELS.iter().filter(|channel| chosen(&self.channels, channel.name)).collect();
        let (cells, mut empty) = matrix::cells(&tasks, &channels);
        let kinds = KINDS.into_iter().filter(|kind| chosen(&self.policies, kind)).map(str::to_owned);
        empty.retain(|empty| empty.policy.as_ref().is_none_or(|kind| chosen(&self.policies, kind)));
        entered::check(&self.enter, &tasks)?;
        let mut entrants: Vec<String> = kinds.collect();
        entrants.extend(entered::names(&self.enter));
        let made = entries::of((&cells, &entrants), &self.enter, self.episodes, registry)?;
        empty.extend(made.empty);
        if !self.run.quiet {
            made.warnings.iter().for_each(|warning| talk(&format!("warning: {warning}")));
        }
        Ok(Bench {
            cells,
            entries: made.entries,
            entrants,
            empty,
            seed: self.run.seed,
            command: self.command(),
            build: build(registry)?,
        })
    }

    /// Returns the command line that reproduces the benchmark, without flags that do not affect the results.
    fn command(&self) -> String {
        let mut command = CommandLine(format!("{} study commbench", own_name()));
        command.add_all("tasks", &self.tasks);
        command.add_all("channels", &self.channels);
        command.add_all("policies", &self.policies);
        self.enter.iter().for_each(|entered| command.add("enter", Some(entered.to_string())));
        command.add("episodes", self.episodes.map(|episodes| episodes.to_string()));
        command.add("seed", Some(self.run.seed.to_string()));
        command.0
    }

    /// Returns the records of all jobs, in order: reads those of finished jobs from the folder, and runs the others.
    /// After Ctrl-C, or with `--shard`, some are missing.
    fn run_all(&self, bench: &Bench, folder: Option<&Folder>, stop: &AtomicBool) -> Result<Vec<(Job, Record)>> {
        let all = bench.jobs();
        let found: Vec<Option<Record>> =
            all.iter().map(|job| folder.and_then(|folder| files::read(folder, bench, *job))).collect();
        let episodes = |job: Job| bench.episodes(job).len() as u64;
        let work = |job: Job, bar: &ProgressBar| -> Result<Option<Record>> {
            let mut record = Record::new(bench, job);
            for episode in bench.episodes(job) {
                let report = bench.trial(job.entry, episode).run_while(watched(bar, stop));
                let Some(result) = report.episodes.first().filter(|_| report.finished) else { return Ok(None) };
                record.add(*result, &report.totals.listening);
            }
            folder.map_or(Ok(()), |folder| files::write(folder, bench, job, &record))?;
            let entry = &bench.entries[job.entry];
            tracing::info!("kept part {} of {}, {}", job.part, entry.entrant, bench.cell(entry).words());
            Ok(Some(record))
        };
        part::finish((all, found), (&self.run, self.shard), ("job", episodes), stop, work)
    }
}
