//! Fitting a radio to rows: their file, and the radio file that comes of it. How it is fitted lives in the library.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use murmurate::study::network::fit::{Fitted, Observed, fit};
use murmurate::study::network::{Case, Medium, Outcome, Sweep, emulate};
use serde::Serialize;

use super::Args;
use crate::output::{WholeFile, print, read_text, talk};
use crate::{BadInput, Ended, jobs};

/// What a fit came to, for `--json`.
#[derive(Serialize)]
struct Report {
    noise_loss: f64,
    background: f64,
    rate: String,
    basic_rate: String,
    /// Root mean square of what is left: of shares, and of the logarithms of delays.
    residual_shares: f64,
    residual_log_delays: f64,
    rows: usize,
}

/// Reads rows: a list of them, or an object that has one.
pub fn read(path: &Path) -> Result<Vec<Observed>> {
    let wrong = |why: String| BadInput(format!("--rows: '{}': {why}", path.display()));
    let text = read_text(path, "rows")?;
    let mut value: serde_json::Value = serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
    if let Some(rows) = value.get_mut("rows") {
        value = rows.take();
    }
    let rows: Vec<Observed> = serde_json::from_value(value).map_err(|e| wrong(e.to_string()))?;
    Ok(rows)
}

/// Fits, says how well, and writes the radio file.
pub fn run(sweep: &Sweep, observed: Vec<Observed>, (file, args): (&Path, &Args), stop: &AtomicBool) -> Result<Ended> {
    let Medium::Radio(base) = &sweep.medium else {
        return Err(BadInput("--fit: only a radio can be fitted; give --medium one to start from".to_owned()).into());
    };
    if observed.is_empty() || !observed.iter().all(Observed::is_of_radio) {
        return Err(BadInput("--fit: it needs rows, and all of them of a radio".to_owned()).into());
    }
    // A wrong path is known before the work.
    let mut out = WholeFile::create(file)?;
    let runner = |runs: &[(Sweep, Case)]| -> Vec<Option<Outcome>> {
        let work = |at: usize| emulate::run(&runs[at].0, &runs[at].1, &|| !stop.load(Ordering::Relaxed));
        let mut outcomes = vec![None; runs.len()];
        for (at, outcome) in jobs::run(runs.len(), jobs::threads(args.run.jobs, runs.len()), stop, work) {
            outcomes[at] = outcome;
        }
        outcomes
    };
    if !args.run.quiet {
        talk(&format!("fitting to {} rows", observed.len()));
    }
    let Some(fitted) = fit(base, sweep, &observed, &runner) else {
        talk("interrupted; nothing was written");
        return Ok(Ended::Interrupted);
    };
    let command = format!("{} --fit {}", args.command(), file.display());
    out.writer().write_all(fitted.to_toml(&command).as_bytes()).context("cannot write the radio file")?;
    out.keep()?;
    // Beside the rows of a measurement, which are the data then.
    if args.live.is_some() {
        talk(&told(&fitted, false)?)
    } else {
        print(&told(&fitted, args.run.json)?)?
    }
    if !args.run.quiet {
        talk(&format!("radio in '{0}': use it with 'sim --radio {0}' or 'train --radio {0}'", file.display()));
    }
    Ok(Ended::Done)
}

fn told(fitted: &Fitted, json: bool) -> Result<String> {
    let radio = &fitted.radio;
    let report = Report {
        noise_loss: radio.noise_loss,
        background: radio.background,
        rate: radio.rate.to_string(),
        basic_rate: radio.basic_rate.to_string(),
        residual_shares: fitted.shares,
        residual_log_delays: fitted.delays,
        rows: fitted.rows.len(),
    };
    if json {
        return serde_json::to_string(&report).context("a report is JSON");
    }
    Ok(format!(
        "noise loss {:.3}, background {:.3}, rate {}, multicast rate {}\nleft: {:.1} points of the shares, {:.0} % of \
         the delays (root mean square over {} rows)",
        report.noise_loss,
        report.background,
        report.rate,
        report.basic_rate,
        100.0 * fitted.shares,
        100.0 * (fitted.delays.exp() - 1.0),
        report.rows
    ))
}
