//! The command `murmurate study twin`: fits a model of a recorded run to half of its episodes, and compares it with the
//! other half.

mod files;
mod run_of;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use serde::Serialize;

use super::run::{CommandLine, Run};
use crate::jobs;
use crate::progress::{progress, watched};
use murmurate::config::shown::counted;
use murmurate::registry::Registry;
use murmurate::trial::Trial;
use murmurate_robot::output::{print, talk};
use murmurate_robot::{BadInput, Ended, bad, own_name};
use murmurate_study::twin::comparison::{self, Row};
use murmurate_study::twin::model::{self, Fitted, Given};
use murmurate_study::twin::pages::Words;
use murmurate_study::twin::predict::{self, Predicted};
use run_of::Recorded;

/// Least number of episodes of a recorded run: two to fit and two to predict, so that both have confidence intervals.
const LEAST: usize = 4;

/// Flags of `murmurate study twin`.
#[derive(clap::Args)]
#[command(
    after_help = "Exit codes: 0 every measurement agrees with its prediction; 1 at least one lies outside its bar: the \
    table says which; 2 a flag or a record is wrong; 130 interrupted, nothing was compared."
)]
pub struct Args {
    /// Records of the hosts of one run, or their folder: what 'launch --record DIR' or 'host --record DIR' wrote
    #[arg(required = true, value_name = "FILE|DIR")]
    records: Vec<PathBuf>,
    /// Number of times that the second half of the episodes is simulated
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    repeats: u32,
    /// Predicts with a value of yours in place of the fitted one: lag_s, slip, delay_s or loss; may be given several
    /// times
    #[arg(long, value_name = "NAME=VALUE")]
    given: Vec<String>,
    #[command(flatten)]
    run: Run,
}

/// Output of `study twin` with `--json`.
#[derive(Serialize)]
struct Report<'a> {
    study: &'a str,
    scenario: &'a str,
    robots: usize,
    /// Numbers of episodes: to which the model was fitted, and with which it was compared.
    episodes: [usize; 2],
    repeats: u32,
    given: &'a [String],
    rows: &'a [Row],
    agrees: bool,
    notes: &'a [String],
}

/// Runs `study twin`: fits a model to the first half of a recorded run's episodes, predicts the second half by
/// simulation, compares both, and prints and writes the report.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let given = given(args)?;
    let Recorded { run, trial, policy, mut notes, digests } = run_of::read(&args.records, registry)?;
    let count = run.episodes.len();
    if count < LEAST {
        return bad(format!(
            "the records have {} with a result, from the first on; a twin needs at least {LEAST}: half to fit and half \
             to compare",
            counted(count, "episode")
        ));
    }
    let first = count / 2;
    let (half, end) = (u32::try_from(first).context("episodes")?, u32::try_from(count).context("episodes")?);
    let (found, later) = (model::fit(&run, &trial, 0..half), model::fit(&run, &trial, half..end));
    notes.extend(missing(&found, &trial));
    let fitted = given.over(found);
    let mut twin = model::simulation(&fitted, &trial, half);
    twin.seed = args.run.seed;
    twin.layouts = twin.layouts.first(end - half);
    let simulated = trial.deployment.check_simulated().is_ok();
    let repeats = if simulated { args.repeats } else { 0 };
    twin.check().map_err(|error| BadInput(format!("the model of this run cannot be simulated: {error}")))?;
    let folder = args.run.out.as_deref().map(|path| files::open(path, &digests, &command(args))).transpose()?;
    let Some(predicted) = predict(args, &twin, repeats)? else { return Ok(Ended::Interrupted) };
    let names: Vec<String> = trial.deployment.links.iter().map(|link| link.name.clone()).collect();
    let rows = comparison::rows(&run, first, &predicted, (&fitted, &later), (&names, args.run.seed));
    let agrees = rows.iter().all(|row| row.agrees);
    let report = Report {
        study: "twin",
        scenario: trial.scenario.name(),
        robots: trial.scenario.robots(),
        episodes: [first, count - first],
        repeats,
        given: &args.given,
        rows: &rows,
        agrees,
        notes: &notes,
    };
    let title = format!(
        "Twin of a run: {}, scenario {}, mode {}, policy {policy}",
        counted(report.robots, "robot"),
        report.scenario,
        trial.deployment.mode
    );
    let predicting = match repeats {
        0 => "compared with the other".to_owned(),
        repeats => format!("the other {} predicted in {}", count - first, counted(repeats, "repeat")),
    };
    let replaced = if args.given.is_empty() { String::new() } else { format!("; given: {}", args.given.join(", ")) };
    let head = format!("{title}\nfitted to {}; {predicting}{replaced}", counted(first, "episode"));
    let text = format!("{head}\n\n{}\n", comparison::text(&rows))
        + &notes.iter().map(|note| format!("\nnote: {note}")).collect::<String>();
    if let Some(folder) = &folder {
        let words = Words {
            title,
            command: command(args),
            episodes: report.episodes,
            repeats: repeats as usize,
            notes: notes.clone(),
        };
        files::write(folder, &words, (&run, first, &predicted), (&rows, &text), (&fitted, &twin))?;
    }
    print(&if args.run.json { serde_json::to_string(&report).context("a report is JSON")? } else { text })?;
    args.run.print_location(folder.as_ref(), "repeats", predicted.len(), predicted.len());
    Ok(if agrees { Ended::Done } else { Ended::Unfit })
}

fn given(args: &Args) -> Result<Given> {
    let mut given = Given::default();
    for text in &args.given {
        let Some((name, value)) = text.split_once('=') else {
            return bad(format!("--given {text}: write NAME=VALUE, such as --given lag_s=0"));
        };
        let value: f64 =
            value.trim().parse().map_err(|_| BadInput(format!("--given {text}: '{value}' is no number")))?;
        given.set(name.trim(), value).map_err(|why| BadInput(format!("--given {text}: {why}")))?;
    }
    Ok(given)
}

/// Returns the command line that reproduces the report, without flags that do not affect it.
fn command(args: &Args) -> String {
    let mut command = CommandLine(format!("{} study twin", own_name()));
    for path in &args.records {
        command.0 += &format!(" {}", path.display());
    }
    command.add("repeats", Some(args.repeats.to_string()));
    args.given.iter().for_each(|given| command.add("given", Some(given.clone())));
    command.add("seed", Some(args.run.seed.to_string()));
    command.0
}

/// Returns notes on what could not be fitted, because the records lack the data.
fn missing(found: &Fitted, trial: &Trial) -> Vec<String> {
    let mut notes = Vec::new();
    if trial.deployment.check_simulated().is_err() {
        notes.push(
            "the robots are real, and a simulation has no part for their drivers and trackers: the model was fitted, \
             and nothing was predicted with it"
                .to_owned(),
        );
    }
    if let Some(late_s) = found.late_s {
        notes.push(format!(
            "the records have no true states: the lag was fitted to the robots' own estimates, in which a command \
             shows after {:.0} ms; slip was not fitted",
            1e3 * late_s
        ));
    } else if found.lag_s.is_none() {
        notes.push(format!(
            "nothing moved without contact: lag and slip were not fitted, and the lag is that of the team file \
             ({} s)",
            trial.physics.lag_s
        ));
    }
    for (link, entry) in found.links.iter().zip(&trial.deployment.links) {
        if link.is_none() {
            notes.push(format!("no data crossed the link '{}': it is predicted as ideal", entry.name));
        }
    }
    if found.offsets_s.iter().any(Option::is_none) {
        notes.push(
            "ticks of the robots drift against each other: their offsets are drawn anew for each repeat".to_owned(),
        );
    }
    notes
}

/// Simulates the second half of the episodes `repeats` times with the fitted model. Returns the results of the repeats;
/// `None` after Ctrl-C.
fn predict(args: &Args, twin: &Trial, repeats: u32) -> Result<Option<Vec<Predicted>>> {
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;
    let bar = progress(u64::from(twin.layouts.len()) * u64::from(repeats), args.run.quiet);
    let repeats = repeats as usize;
    let work = |at: usize| {
        // The run itself was the repeat 0 of its seed.
        let repeat = u32::try_from(at).expect("repeats were counted in u32") + 1;
        predict::run(&Trial { repeat, ..twin.clone() }, watched(&bar, &stop))
    };
    let done = jobs::run(repeats, jobs::threads(args.run.jobs, repeats), &stop, work);
    bar.finish_and_clear();
    let predicted: Vec<Predicted> = done.into_iter().filter_map(|(_, one)| one).collect();
    if predicted.len() < repeats {
        talk("interrupted; nothing was compared");
        return Ok(None);
    }
    Ok(Some(predicted))
}
