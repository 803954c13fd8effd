//! The end of one part of a study, which the flag `--shard` selects.

use std::collections::BTreeSet;

use anyhow::{Context, Result};
use murmurate::config::shown::counted;
use murmurate_robot::Ended;
use murmurate_robot::output::{print, talk};
use serde::Serialize;

use super::folder::Folder;
use super::run::Run;
use super::shard::Shard;

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
