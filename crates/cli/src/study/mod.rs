//! The command `murmurate study`: flags, threads, time and files of the studies. The studies themselves are in other
//! modules of the library.

mod commbench;
mod flags;
mod folder;
mod network;
mod part;
mod run;
mod shard;
mod sweep;
mod trials;
mod twin;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{FromArgMatches, Subcommand};
use murmurate::config::shown::counted;
use murmurate::registry::Registry;
use murmurate::trial::Trial;
use murmurate_record::identity::StudyJob;
use murmurate_study::record::TrialRecord;
use murmurate_study::results::{Results, Row};
use murmurate_study::{Job, Study, table};
use serde::Serialize;

use crate::jobs;
use crate::progress::{progress, watched};
use crate::recording::Simulated;
use folder::Folder;
use murmurate_robot::BadInput;
use murmurate_robot::Ended;
use murmurate_robot::output::{print, talk};
pub use network::medium;

/// Runs a whole study: the same policies in several columns of conditions, with a report.
#[derive(clap::Subcommand)]
pub enum Args {
    /// The paper's Table I: four modes and two variations, against the conditions of training
    Modes(Box<flags::Modes>),
    /// Success over delay and loss of the messages between robots (mode onboard-adhoc)
    Delay(Box<flags::Delay>),
    /// Success over the communication radius (mode onboard-adhoc)
    Range(Box<flags::Range>),
    /// Simulations over the values of one or two flags of 'sim', or of fields in its files
    Sweep(Box<sweep::Args>),
    /// The benchmark of communication: tasks, channels and policies, compared in pairs
    Commbench(Box<commbench::Args>),
    /// Delivery of a team's messages by addressing, reliability and message rate
    Network(Box<network::Args>),
    /// A model of a recorded run: fitted to half of its episodes, compared with the other half
    Twin(Box<twin::Args>),
}

/// Output of a study with `--json`: its rows, and how many trials are finished.
#[derive(Serialize)]
struct Report<'a> {
    study: &'a str,
    scenario: String,
    columns: Vec<&'a Row>,
    wall_s: f64,
    seed: u64,
    /// Number of finished trials of the study, and number of all its trials.
    trials: [usize; 2],
    interrupted: bool,
}

/// Runs `study`: runs the trials of a study, prints its table and writes its report.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let (study, shared) = match args {
        Args::Modes(flags) => (flags.study(registry)?, &flags.shared),
        Args::Delay(flags) => (flags.study(registry)?, &flags.shared),
        Args::Range(flags) => (flags.study(registry)?, &flags.shared),
        Args::Sweep(flags) => return sweep::run(flags, registry),
        Args::Commbench(flags) => return commbench::run(flags, registry),
        Args::Network(flags) => return network::run(flags, registry),
        Args::Twin(flags) => return twin::run(flags, registry),
    };
    let folder = shared.run.out.as_deref().map(|path| trials::open(path, &study)).transpose()?;
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;

    let began = Instant::now();
    let records = run_all(&study, folder.as_ref(), &stop, shared)?;
    let trials = [records.len(), study.jobs().len()];
    if let (Some(shard), Some(folder)) = (shared.shard, &folder) {
        let finished: BTreeSet<Job> = records.iter().map(|(job, _)| *job).collect();
        return part::is_done((study.name, shard), &study.jobs(), &finished, (folder, &shared.run));
    }
    let interrupted = trials[0] < trials[1];
    let results = Results::of(&study, &records);
    if let (Some(folder), false) = (&folder, interrupted) {
        trials::write_report(folder, &study, &results, &records)?;
    }
    let report = Report {
        study: study.name,
        scenario: study.scenario_text(),
        columns: results.rows().collect(),
        wall_s: began.elapsed().as_secs_f64(),
        seed: study.seed,
        trials,
        interrupted,
    };
    let (wall_s, [done, all]) = (report.wall_s, trials);
    print(&if shared.run.json {
        serde_json::to_string(&report).context("a report is JSON")?
    } else {
        format!("{}\n\n{done} of {}; {wall_s:.1} s", table::text(&study, &results), counted(all, "trial"))
    })?;
    shared.run.print_location(folder.as_ref(), "trials", done, all);
    Ok(if interrupted { Ended::Interrupted } else { Ended::Done })
}

/// Returns the trial of a recorded simulation, from the recorded arguments of `study`, its column and policy in the
/// study, and the index of its repeat.
pub fn of_record(arguments: &[String], (job, repeat): (StudyJob, u32), registry: &Registry) -> Result<Trial> {
    let wrong = |why: String| BadInput(format!("the record's arguments are not understood: {why}"));
    let command = Args::augment_subcommands(clap::Command::new("study"));
    let found = command.try_get_matches_from(arguments).map_err(|error| wrong(error.to_string()))?;
    let study = match Args::from_arg_matches(&found).map_err(|error| wrong(error.to_string()))? {
        Args::Modes(flags) => flags.study(registry)?,
        Args::Delay(flags) => flags.study(registry)?,
        Args::Range(flags) => flags.study(registry)?,
        Args::Sweep(_) | Args::Commbench(_) | Args::Network(_) | Args::Twin(_) => {
            return Err(wrong("this study records nothing".to_owned()).into());
        }
    };
    let StudyJob { column, policy } = job;
    if column >= study.columns.len() || policy >= study.policies.len() {
        return Err(wrong(format!("the study has no column {column} with policy {policy}")).into());
    }
    Ok(study.trial(Job { column, policy, repeat }))
}

/// Returns the results of all trials of a study, in order: reads those of finished trials from the folder, and runs the
/// other trials. After Ctrl-C, or with `--shard`, some are missing.
fn run_all(
    study: &Study,
    folder: Option<&Folder>,
    stop: &AtomicBool,
    shared: &flags::Shared,
) -> Result<Vec<(Job, TrialRecord)>> {
    let (all, threads, quiet) = (study.jobs(), shared.run.jobs, shared.run.quiet);
    let found: Vec<Option<TrialRecord>> =
        all.iter().map(|job| folder.and_then(|folder| trials::read(folder, study, *job))).collect();
    let there = found.iter().flatten().count();
    let mine = |at: usize| shared.shard.is_none_or(|shard| shard.has(at));
    let left: Vec<usize> = (0..all.len()).filter(|at| found[*at].is_none() && mine(*at)).collect();
    let names = left.iter().map(|at| trials::recorded(study, all[*at]).name);
    let recording = Simulated::open(&shared.record, shared.files(), names)?;
    let bar = progress(u64::from(study.layouts.len()) * left.len() as u64, quiet);
    if there > 0 && !quiet {
        let are = if all.len() == 1 { "is" } else { "are" };
        talk(&format!("{there} of {} {are} finished already", counted(all.len(), "trial")));
    }
    let work = |at: usize| -> Result<Option<TrialRecord>> {
        let job = all[at];
        let (trial, recorded) = (study.trial(job), trials::recorded(study, job));
        let report = match &recording {
            Some(recording) => recording.run((&recorded, &trial), watched(&bar, stop)),
            None => trial.run_while(watched(&bar, stop)),
        };
        if !report.finished {
            recording.iter().for_each(|recording| recording.discard(&recorded));
            return Ok(None);
        }
        let record = TrialRecord::of(study, job, &report);
        if let Some(folder) = folder {
            trials::write(folder, study, job, &record)?;
            tracing::info!("kept repeat {} of '{}', {}", job.repeat, record.column, study.policies[job.policy].name());
        }
        Ok(Some(record))
    };
    let records = jobs::finish((found, left), threads, stop, work)?;
    bar.finish_and_clear();
    recording.map_or(Ok(()), |recording| recording.finish())?;
    Ok(all.into_iter().zip(records).filter_map(|(job, record)| Some((job, record?))).collect())
}
