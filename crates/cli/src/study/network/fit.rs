//! Runs `study network --fit`: reads rows of results, fits a radio to them, and writes the radio file. The fit itself
//! is in another module of the library.

use std::fmt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use murmurate::config;
use murmurate_study::network::fit::{Observed, fit};
use murmurate_study::network::{Case, Medium, Outcome, Sweep, emulate};
use serde::Serialize;

use super::Args;
use crate::jobs;
use murmurate_robot::BadInput;
use murmurate_robot::bad;
use murmurate_robot::output::{read_text, talk};
use murmurate_robot::whole_file::WholeFile;

/// Result of `study network --fit`, as it is printed: the fitted parameters of a radio, and how well they fit.
#[derive(Serialize)]
pub struct Report {
    noise_loss: f64,
    background: f64,
    rate: String,
    basic_rate: String,
    /// Root mean squares of the differences between fitted and given rows: of shares of messages (this field), and of
    /// natural logarithms of delays (the next field).
    residual_shares: f64,
    residual_log_delays: f64,
    /// Other pairs of unicast and multicast rate that fit almost as well.
    rivals: Vec<String>,
    rows: usize,
}

/// Reads the rows of a network study to which a radio is to be fitted from a JSON file: a list, or an object with a
/// field `rows`. If some rows were measured, returns only those; otherwise all. Fails if a row cannot belong to the
/// study `sweep`, or if there is none.
pub fn read(path: &Path, sweep: &Sweep) -> Result<Vec<Observed>> {
    let wrong = |why: String| {
        let expected = "it has to be what 'study network --json' printed, or rows.json of its report";
        BadInput(format!("--rows: '{}': {why}; {expected}", path.display()))
    };
    let text = read_text(path, "rows")?;
    let mut value: serde_json::Value = serde_json::from_str(&text).map_err(|e| wrong(config::json(&e)))?;
    if let Some(rows) = value.get_mut("rows") {
        value = rows.take();
    }
    let mut rows: Vec<Observed> = serde_json::from_value(value).map_err(|e| wrong(config::json(&e)))?;
    for (at, row) in rows.iter().enumerate() {
        row.check(sweep).map_err(|why| wrong(format!("row {}: {why}", at + 1)))?;
    }
    if rows.iter().any(Observed::is_live) {
        rows.retain(Observed::is_live);
    }
    if rows.is_empty() { Err(wrong("it has no rows".to_owned()).into()) } else { Ok(rows) }
}

/// Opens the radio file `file` for writing, before the work begins. Fails if the study's medium is no radio, or if the
/// file cannot be written.
pub fn prepare(file: &Path, sweep: &Sweep) -> Result<WholeFile> {
    match &sweep.medium {
        Medium::Radio(_) => WholeFile::create(file),
        Medium::Shaped(_) => bad("--fit: only a radio can be fitted; give --medium one to start from".to_owned()),
    }
}

/// Fits the radio of the study's medium to the rows `observed`, writes it to `out`, and returns the result. After
/// Ctrl-C, returns `None` and writes nothing.
pub fn run(
    sweep: &Sweep,
    observed: &[Observed],
    mut out: WholeFile,
    args: &Args,
    stop: &AtomicBool,
) -> Result<Option<Report>> {
    let Medium::Radio(base) = &sweep.medium else { unreachable!("a file is prepared for radios alone") };
    let runner = |runs: &[(Sweep, Case)]| -> Vec<Option<Outcome>> {
        let work = |at: usize| emulate::run(&runs[at].0, &runs[at].1, &|| !stop.load(Ordering::Relaxed));
        let mut outcomes = vec![None; runs.len()];
        for (at, outcome) in jobs::run(runs.len(), jobs::threads(args.run.jobs, runs.len()), stop, work) {
            outcomes[at] = outcome;
        }
        outcomes
    };
    if !args.run.quiet {
        let measured = if observed.iter().all(Observed::is_live) { "measured " } else { "" };
        talk(&format!("fitting to {} {measured}rows", observed.len()));
    }
    let Some(fitted) = fit(base, sweep, observed, &runner) else {
        talk("interrupted; no radio was written");
        return Ok(None);
    };
    out.writer().write_all(fitted.to_toml(&args.command()).as_bytes()).context("cannot write the radio file")?;
    out.keep()?;
    let radio = &fitted.radio;
    Ok(Some(Report {
        noise_loss: radio.noise_loss,
        background: radio.background,
        rate: radio.rate.to_string(),
        basic_rate: radio.basic_rate.to_string(),
        residual_shares: fitted.shares,
        residual_log_delays: fitted.delays,
        rivals: fitted.alternatives.iter().map(ToString::to_string).collect(),
        rows: fitted.rows.len(),
    }))
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "noise loss {:.3}, background {:.3}, rate {}, multicast rate {}\nresiduals: {:.1} points of the shares, \
             {:.0} % of the delays (root mean square over {} rows)",
            self.noise_loss,
            self.background,
            self.rate,
            self.basic_rate,
            100.0 * self.residual_shares,
            100.0 * (self.residual_log_delays.exp() - 1.0),
            self.rows
        )?;
        if !self.rivals.is_empty() {
            let rivals = self.rivals.join(", ");
            write!(
                f,
                "\nnot certain: {rivals} fit almost as well; rows by multicast, and of more rates, distinguish them"
            )?;
        }
        Ok(())
    }
}
