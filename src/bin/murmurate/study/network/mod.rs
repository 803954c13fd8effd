//! `murmurate study network`: flags, threads, clock and files of the network study. What is emulated lives in the
//! library.

mod flags;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result};
use murmurate::study::network::{Case, Outcome, Row, Sweep, emulate};
use serde::Serialize;

use crate::output::print;
use crate::sim::progress;
use crate::{Ended, jobs};
pub use flags::Args;

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
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;
    let began = Instant::now();
    let done = emulated(&sweep, args, &stop)?;
    let interrupted = done.len() < sweep.cases().len();
    let rows: Vec<Row> = done.iter().map(|(case, outcome)| Row::of("emulated", case, outcome)).collect();
    let wall_s = began.elapsed().as_secs_f64();
    let report = Report { study: "network", rows, wall_s, seed: sweep.seed, interrupted };
    print(&serde_json::to_string(&report).context("a report is JSON")?)?;
    Ok(if interrupted { Ended::Interrupted } else { Ended::Done })
}

/// All cases, emulated; fewer after a Ctrl-C.
fn emulated(sweep: &Sweep, args: &Args, stop: &AtomicBool) -> Result<Vec<(Case, Outcome)>> {
    let cases = sweep.cases();
    let bar = progress(cases.len() as u64, args.quiet);
    let work = |at: usize| {
        let outcome = emulate::run(sweep, &cases[at], &|| !stop.load(Ordering::Relaxed));
        bar.inc(1);
        outcome
    };
    let done = jobs::run(cases.len(), jobs::threads(args.jobs, cases.len()), stop, work);
    bar.finish_and_clear();
    Ok(done.into_iter().filter_map(|(at, outcome)| Some((cases[at], outcome?))).collect())
}
