//! The jobs of a study: runs those that are left, in this process or in the part that the flag `--shard` selects.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use indicatif::ProgressBar;
use murmurate::config::shown::counted;
use murmurate_robot::Ended;
use murmurate_robot::output::{print, talk};
use serde::Serialize;

use super::folder::Folder;
use super::run::Run;
use super::shard::Shard;
use crate::jobs;
use crate::progress::progress;

/// Output with `--json` of one part of a study.
#[derive(Serialize)]
struct Part<'a> {
    study: &'a str,
    shard: String,
    /// Number of finished trials of this part, and number of all its trials.
    trials: [usize; 2],
    interrupted: bool,
}

/// Prints how many trials of the part `shard` of the study `study` are finished. `all` are the trials of the study in
/// their order. Without `--json` nothing goes to stdout.
pub fn is_done<J: Copy + Ord>(
    (study, shard): (&str, Shard),
    all: &[J],
    finished: &BTreeSet<J>,
    (folder, run): (&Folder, &Run),
) -> Result<Ended> {
    let mine: Vec<J> = (0..all.len()).filter(|at| shard.has(*at)).map(|at| all[at]).collect();
    let done = mine.iter().filter(|job| finished.contains(job)).count();
    let interrupted = done < mine.len();
    if run.json {
        let part = Part { study, shard: shard.to_string(), trials: [done, mine.len()], interrupted };
        print(&serde_json::to_string(&part).context("a report is JSON")?)?;
    }
    if interrupted || !run.quiet {
        let next = match (interrupted, all.len() - finished.len()) {
            (true, _) => "interrupted; the same command goes on from there".to_owned(),
            (false, 0) => "all trials are there: the same command without --shard writes the report".to_owned(),
            (false, left) => format!("missing here: {} of other shards", counted(left, "trial")),
        };
        talk(&format!(
            "shard {shard}: {done} of {} kept in '{}'; {next}",
            counted(mine.len(), "trial"),
            folder.path().display()
        ));
    }
    Ok(if interrupted { Ended::Interrupted } else { Ended::Done })
}

/// Returns the records of all `jobs` of a study, in order: those that were `found`, one entry a job, and those that
/// `work` gives for the others, or for those of the part `shard`. After Ctrl-C, or with a part, some are missing.
/// `noun` is the word for a job, and `episodes` returns how many episodes it has, for the progress bar.
pub fn finish<J: Copy + Sync, R: Send>(
    (jobs, found): (Vec<J>, Vec<Option<R>>),
    (run, shard): (&Run, Option<Shard>),
    (noun, episodes): (&str, impl Fn(J) -> u64),
    stop: &AtomicBool,
    work: impl Fn(J, &ProgressBar) -> Result<Option<R>> + Sync,
) -> Result<Vec<(J, R)>> {
    let mine = |at: &usize| shard.is_none_or(|shard| shard.has(*at));
    let left: Vec<usize> = (0..jobs.len()).filter(|at| found[*at].is_none()).filter(mine).collect();
    let bar = progress(left.iter().map(|at| episodes(jobs[*at])).sum(), run.quiet);
    let there = found.iter().flatten().count();
    if there > 0 && !run.quiet {
        talk(&format!("finished already: {there} of {}", counted(jobs.len(), noun)));
    }
    let records = jobs::finish((found, left), run.jobs, stop, |at| work(jobs[at], &bar))?;
    bar.finish_and_clear();
    Ok(jobs.into_iter().zip(records).filter_map(|(job, record)| Some((job, record?))).collect())
}
