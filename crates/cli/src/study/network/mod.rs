//! The command `murmurate study network`: flags, threads, time and files of the network study. The emulation is in
//! other modules of the library.

mod cases;
mod fit;
mod flags;
mod live;
mod live_team;
mod teams;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result};
use murmurate::registry::Registry;
use murmurate_study::network::fit::Observed;
use murmurate_study::network::growth::Growth;
use murmurate_study::network::pages::{Findings, Found};
use murmurate_study::network::{Row, Source, emulate, table};
use serde::Serialize;

use crate::jobs;
use crate::progress::progress;
use cases::Journal;
pub use flags::Args;
pub use flags::medium;
use live::Measured;
use live_team::LiveTeam;
use murmurate_robot::Ended;
use murmurate_robot::output::{print, talk};
use murmurate_robot::whole_file::WholeFile;
use teams::SizedTeam;

/// Output of a network study with `--json`.
#[derive(Serialize)]
struct Report<'a> {
    study: &'static str,
    rows: Vec<Row>,
    growth: &'a [Growth],
    /// Largest error of measured one-way delays, from the hosts' clocks \[s\]; null without a measurement.
    uncertainty_s: Option<f64>,
    /// Radio fitted to the measured rows; null without `--fit`.
    fit: Option<&'a fit::Report>,
    wall_s: f64,
    seed: u64,
    interrupted: bool,
}

/// A network study that is ready to run.
struct Study<'a> {
    args: &'a Args,
    journal: Journal,
    /// Team whose hosts measure the network; `None` without `--live`.
    live_team: Option<LiveTeam>,
    /// Teams of growing size that are simulated to find the cost per robot (airtime, processor time).
    teams: Vec<SizedTeam>,
    stop: Arc<AtomicBool>,
}

/// Runs `study network`: emulates its cases, measures them with `--live`, fits a radio with `--fit`, and prints the
/// results. With `--host`, takes part in a measurement instead.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let mut sweep = args.sweep()?;
    let teams = teams::of_sizes(&args.teams()?, sweep.seed)?;
    let live_team = args.live.as_ref().map(|file| LiveTeam::of(file, args, registry)).transpose()?;
    if let (Some(live_team), Some(name)) = (&live_team, &args.host) {
        return live::participate(live_team.participation(name)?, name, args.coordinator, args.run.quiet);
    }
    if let Some(live_team) = &live_team {
        live_team.restrict(&mut sweep, args)?;
    }
    let link = live_team.as_ref().map(LiveTeam::link).transpose()?;
    let journal = Journal::open(args.run.out.as_deref(), sweep, link)?;
    let stop = Arc::new(AtomicBool::new(false));
    let (signal, measuring) = (Arc::clone(&stop), live_team.is_some());
    let interrupt = move || {
        if !signal.swap(true, Ordering::Relaxed) && measuring {
            talk("stopping; the running case is measured to its end");
        }
    };
    ctrlc::set_handler(interrupt).context("cannot listen for Ctrl-C")?;
    let radio_file = args.fit.as_deref().map(|file| fit::prepare(file, &journal.sweep)).transpose()?;
    let study = Study { args, journal, live_team, teams, stop };
    match (radio_file, &args.rows) {
        (Some(file), Some(rows)) => study.fit_rows(rows, file),
        (file, _) => study.sweep(file),
    }
}

impl Study<'_> {
    /// Fits a radio to the rows in a file of earlier results, writes it to `file`, and prints it.
    fn fit_rows(&self, rows: &Path, file: WholeFile) -> Result<Ended> {
        let sweep = &self.journal.sweep;
        let observed = fit::read(rows, sweep)?;
        let Some(fitted) = fit::run(sweep, &observed, file, self.args, &self.stop)? else {
            return Ok(Ended::Interrupted);
        };
        print(&if self.args.run.json { json(&fitted)? } else { fitted.to_string() })?;
        self.args.print_location();
        Ok(Ended::Done)
    }

    /// Measures (with `--live`) and emulates all cases, prints the results, and writes the report. Fits a radio to the
    /// measured rows if `file` is given.
    fn sweep(&self, file: Option<WholeFile>) -> Result<Ended> {
        let Study { args, journal, live_team, teams, stop } = self;
        let Journal { sweep, folder, .. } = journal;
        let began = Instant::now();
        let measured = live_team.as_ref().map(|live_team| self.measured(live_team)).transpose()?;
        // Runs first, since the sweep fragments memory.
        let grown = teams::run(teams, sweep, folder.as_ref(), args.run.quiet, stop)?;
        let mut results = self.emulated()?;
        let observed: Vec<Observed> = measured.iter().flat_map(|measured| &measured.results).map(observed).collect();
        let uncertainty_s = measured.as_ref().map(|measured| measured.uncertainty_s);
        results.extend(measured.into_iter().flat_map(|measured| measured.results));
        let done = results.len() + grown.len();
        let all = sweep.cases().len() * if live_team.is_some() { 2 } else { 1 } + teams.len();
        let interrupted = done < all;

        let notes: Vec<String> =
            live_team.iter().zip(uncertainty_s).map(|(live_team, off)| clocks(live_team, off)).collect();
        let command = args.command();
        let findings = Findings { sweep, results: &results, grown: &grown, command: &command, notes: &notes };
        if let (Some(folder), false) = (folder, interrupted) {
            cases::write_report(folder, &findings)?;
        }
        let rows = findings.rows();
        // Measured rows are printed even if the fit fails.
        let fitted = file.filter(|_| !interrupted).map(|file| fit::run(sweep, &observed, file, args, stop));
        let fit = fitted.as_ref().and_then(|fitted| fitted.as_ref().ok()?.as_ref());
        let wall_s = began.elapsed().as_secs_f64();
        print(&if args.run.json {
            let (study, growth, seed) = ("network", &grown[..], sweep.seed);
            json(&Report { study, rows, growth, uncertainty_s, fit, wall_s, seed, interrupted })?
        } else {
            let fit = fit.map_or(String::new(), |fit| format!("\n\n{fit}"));
            format!("{}{fit}\n\n{done} of {all} cases; {wall_s:.1} s", table::text(sweep, &rows, &grown))
        })?;
        args.run.print_location(folder.as_ref(), "cases", done, all);
        match fitted.transpose()? {
            Some(None) => Ok(Ended::Interrupted),
            Some(Some(_)) => {
                args.print_location();
                Ok(Ended::Done)
            }
            None => Ok(if interrupted { Ended::Interrupted } else { Ended::Done }),
        }
    }

    fn measured(&self, live_team: &LiveTeam) -> Result<Measured> {
        let line = (self.args.coordinator, live_team.key()?);
        live::measure(&self.journal, &live_team.names(), line, (&self.stop, self.args.run.quiet))
    }

    /// Returns the outcomes of all emulated cases: reads those that are finished from the folder, and runs the others.
    /// After Ctrl-C some are missing.
    fn emulated(&self) -> Result<Vec<Found>> {
        let Study { args, journal, stop, .. } = self;
        let (source, sweep, cases) = (Source::Emulated, &journal.sweep, journal.sweep.cases());
        let found = journal.kept(source, &cases);
        let open: Vec<usize> = (0..found.len()).filter(|at| found[*at].is_none()).collect();
        let bar = progress(open.len() as u64, args.run.quiet);
        let work = |at: usize| -> Result<Option<cases::CaseRecord>> {
            let case = &cases[at];
            let Some(outcome) = emulate::run(sweep, case, &|| !stop.load(Ordering::Relaxed)) else { return Ok(None) };
            bar.inc(1);
            journal.keep(source, (at, case), outcome, 0.0).map(Some)
        };
        let found = jobs::finish((found, open), args.run.jobs, stop, work)?;
        bar.finish_and_clear();
        Ok(cases.into_iter().zip(found).filter_map(|(case, found)| Some((source, case, found?.outcome))).collect())
    }
}

fn observed((source, case, outcome): &Found) -> Observed {
    Observed::from(&Row::of(*source, case, outcome))
}

/// Returns the report's note on the accuracy of the clocks in a measurement.
fn clocks(live_team: &LiveTeam, uncertainty_s: f64) -> String {
    format!(
        "Measured between the hosts of '{}'. One-way delays are differences of two hosts' clocks, which were compared \
         before and after each case; their uncertainty is at most {:.3} ms.",
        live_team.file().display(),
        1000.0 * uncertainty_s
    )
}

fn json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string(value).context("a report is JSON")
}
