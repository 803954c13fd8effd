//! `murmurate study network`: flags, threads, clock and files of the network study. What is emulated lives in the
//! library.

mod fit;
mod flags;
mod folder;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result};
use murmurate::study::network::pages::{Findings, Found};
use murmurate::study::network::{Row, Sweep, emulate, table};
use serde::Serialize;

use crate::output::{print, talk};
use crate::sim::progress;
use crate::{Ended, jobs};
pub use flags::Args;
use folder::Folder;

/// What a study came to, for `--json`.
#[derive(Serialize)]
struct Report {
    study: &'static str,
    rows: Vec<Row>,
    wall_s: f64,
    seed: u64,
    interrupted: bool,
}

/// Runs the study.
pub fn run(args: &Args) -> Result<Ended> {
    let sweep = args.sweep()?;
    let folder = args.out.as_deref().map(|path| Folder::open(path, &sweep)).transpose()?;
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;
    if let (Some(file), Some(rows)) = (&args.fit, &args.rows) {
        return fit::run(&sweep, fit::read(rows)?, (file, args), &stop);
    }
    let began = Instant::now();
    let results = emulated(&sweep, folder.as_ref(), (args.jobs, args.quiet), &stop)?;
    let (done, all) = (results.len(), sweep.cases().len());
    let interrupted = done < all;
    let command = args.command();
    let findings = Findings { sweep: &sweep, results: &results, command: &command, notes: &[] };
    if let (Some(folder), false) = (&folder, interrupted) {
        folder.write_report(&findings)?;
    }
    let rows = findings.rows();
    let wall_s = began.elapsed().as_secs_f64();
    print(&if args.json {
        let report = Report { study: "network", rows, wall_s, seed: sweep.seed, interrupted };
        serde_json::to_string(&report).context("a report is JSON")?
    } else {
        format!("{}\n\n{done} of {all} cases; {wall_s:.1} s", table::text(&sweep, &rows))
    })?;
    match (&folder, interrupted) {
        (Some(folder), true) => {
            let kept = folder.path().display();
            talk(&format!(
                "interrupted; {done} of {all} cases are kept in '{kept}': the same command goes on from there"
            ));
        }
        (None, true) => talk(&format!("interrupted after {done} of {all} cases; with --out DIR they would be kept")),
        (Some(folder), false) if !args.quiet => talk(&format!("report in '{}'", folder.page().display())),
        _ => {}
    }
    Ok(if interrupted { Ended::Interrupted } else { Ended::Done })
}

/// All cases, emulated: those that are kept, and the rest now. Fewer after a Ctrl-C.
fn emulated(
    sweep: &Sweep,
    folder: Option<&Folder>,
    (threads, quiet): (Option<u16>, bool),
    stop: &AtomicBool,
) -> Result<Vec<Found>> {
    const SOURCE: &str = "emulated";
    let cases = sweep.cases();
    let bar = progress(cases.len() as u64, quiet);
    let work = |at: usize| -> Result<Option<Found>> {
        let kept = folder.and_then(|folder| folder.read(SOURCE, at, &cases[at]));
        let outcome = match kept {
            Some(outcome) => outcome,
            None => {
                let Some(outcome) = emulate::run(sweep, &cases[at], &|| !stop.load(Ordering::Relaxed)) else {
                    return Ok(None);
                };
                if let Some(folder) = folder {
                    // A disk that is full ends the study; what was written stays.
                    let kept = folder.keep(SOURCE, at, &cases[at], &outcome);
                    kept.inspect_err(|_| stop.store(true, Ordering::Relaxed))?;
                }
                outcome
            }
        };
        bar.inc(1);
        Ok(Some((SOURCE.to_owned(), cases[at], outcome)))
    };
    let done = jobs::run(cases.len(), jobs::threads(threads, cases.len()), stop, work);
    bar.finish_and_clear();
    done.into_iter().filter_map(|(_, found)| found.transpose()).collect()
}
