//! `murmurate study network`: flags, threads, clock and files of the network study. What is emulated lives in the
//! library.

mod cases;
mod fit;
mod flags;
mod live;
mod room;
mod teams;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result};
use murmurate::study::network::fit::Observed;
use murmurate::study::network::growth::Growth;
use murmurate::study::network::pages::{Findings, Found};
use murmurate::study::network::{Row, Sweep, emulate, table};
use serde::Serialize;

use super::folder::Folder;
use crate::output::{print, talk};
use crate::sim::progress;
use crate::{Ended, jobs};
pub use flags::{Args, medium};

/// What a study came to, for `--json`.
#[derive(Serialize)]
struct Report<'a> {
    study: &'static str,
    rows: Vec<Row>,
    growth: &'a [Growth],
    /// How far off one-way delays may be that were measured \[s\]; null where none were.
    uncertainty_s: Option<f64>,
    /// The radio that was fitted to what was measured, if that was asked for.
    fit: Option<&'a fit::Report>,
    wall_s: f64,
    seed: u64,
    interrupted: bool,
}

/// Runs the study.
pub fn run(args: &Args) -> Result<Ended> {
    let mut sweep = args.sweep()?;
    let sizes = teams::of_sizes(&args.teams()?, sweep.seed)?;
    let team = args.live.as_ref().map(|file| room::Room::of(file, args)).transpose()?;
    if let (Some(room), Some(name)) = (&team, &args.host) {
        return live::participate(room.part(name)?, name, args.coordinator, args.run.quiet);
    }
    if let Some(room) = &team {
        room.restrict(&mut sweep, args)?;
    }
    let link = team.as_ref().map(room::Room::link).transpose()?;
    let folder = args.run.out.as_deref().map(|path| cases::open(path, &sweep, link)).transpose()?;
    let stop = Arc::new(AtomicBool::new(false));
    let (signal, measuring) = (Arc::clone(&stop), team.is_some());
    let told = move || {
        if !signal.swap(true, Ordering::Relaxed) && measuring {
            talk("stopping; a case that is under way is measured to its end");
        }
    };
    ctrlc::set_handler(told).context("cannot listen for Ctrl-C")?;
    let mut radio_file = args.fit.as_deref().map(|file| fit::prepare(file, &sweep)).transpose()?;
    if let (Some(rows), Some(out)) = (&args.rows, radio_file.take_if(|_| args.rows.is_some())) {
        let Some(fitted) = fit::run(&sweep, &fit::read(rows)?, out, args, &stop)? else {
            return Ok(Ended::Interrupted);
        };
        print(&if args.run.json { json(&fitted)? } else { fitted.to_string() })?;
        args.farewell();
        return Ok(Ended::Done);
    }
    let began = Instant::now();
    let (mut notes, mut measured, mut uncertainty_s) = (Vec::new(), Vec::new(), 0.0);
    if let Some(room) = &team {
        let line = (args.coordinator, room.key()?);
        let live = live::measure(&sweep, &room.names(), line, folder.as_ref(), (&stop, args.run.quiet))?;
        notes.push(format!(
            "Measured between the hosts of '{}'. One-way delays are differences of two hosts' clocks, which were \
             compared before each case; they are this much off at the most: {:.3} ms.",
            room.file().display(),
            1000.0 * live.uncertainty_s
        ));
        uncertainty_s = live.uncertainty_s;
        measured = live.results;
    }
    // Ahead of the sweep, which leaves memory in pieces.
    let grown = teams::run(&sizes, &sweep, folder.as_ref(), args.run.quiet, &stop)?;
    let mut results = emulated(&sweep, folder.as_ref(), (args.run.jobs, args.run.quiet), &stop)?;
    let cases = sweep.cases().len() * if team.is_some() { 2 } else { 1 };
    let (done, all) = (results.len() + measured.len() + grown.len(), cases + sizes.len());
    let interrupted = done < all;
    results.append(&mut measured);
    let command = args.command();
    let findings = Findings { sweep: &sweep, results: &results, grown: &grown, command: &command, notes: &notes };
    if let (Some(folder), false) = (&folder, interrupted) {
        cases::write_report(folder, &findings)?;
    }
    let rows = findings.rows();
    // Whatever comes of the fit, what was measured is printed first.
    let wanted = radio_file.filter(|_| !interrupted);
    let fits = wanted.is_some();
    let fitted = wanted.map_or(Ok(None), |out| {
        let live = results.iter().filter(|(source, ..)| source == "live");
        let live: Vec<Row> = live.map(|(source, case, outcome)| Row::of(source, case, outcome)).collect();
        let live = serde_json::to_value(live).and_then(serde_json::from_value::<Vec<Observed>>);
        fit::run(&sweep, &live.context("rows are plain data")?, out, args, &stop)
    });
    let (wall_s, fit) = (began.elapsed().as_secs_f64(), fitted.as_ref().ok().and_then(Option::as_ref));
    print(&if args.run.json {
        let uncertainty_s = team.is_some().then_some(uncertainty_s);
        json(&Report {
            study: "network",
            rows,
            growth: &grown,
            uncertainty_s,
            fit,
            wall_s,
            seed: sweep.seed,
            interrupted,
        })?
    } else {
        let fit = fit.map_or(String::new(), |fit| format!("\n\n{fit}"));
        format!("{}{fit}\n\n{done} of {all} cases; {wall_s:.1} s", table::text(&sweep, &rows, &grown))
    })?;
    args.run.farewell(folder.as_ref(), "cases", done, all);
    let unfitted = fits && fitted?.is_none();
    if fits && !unfitted {
        args.farewell();
    }
    Ok(if interrupted || unfitted { Ended::Interrupted } else { Ended::Done })
}

fn json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string(value).context("a report is JSON")
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
        let kept = folder.and_then(|folder| cases::read(folder, SOURCE, at, &cases[at]));
        let record = match kept {
            Some(record) => record,
            None => {
                let Some(outcome) = emulate::run(sweep, &cases[at], &|| !stop.load(Ordering::Relaxed)) else {
                    return Ok(None);
                };
                // A disk that is full ends the study; what was written stays.
                cases::keep(folder, SOURCE, (at, &cases[at]), outcome, 0.0)
                    .inspect_err(|_| stop.store(true, Ordering::Relaxed))?
            }
        };
        bar.inc(1);
        Ok(Some((SOURCE.to_owned(), cases[at], record.outcome)))
    };
    let done = jobs::run(cases.len(), jobs::threads(threads, cases.len()), stop, work);
    bar.finish_and_clear();
    done.into_iter().filter_map(|(_, found)| found.transpose()).collect()
}
