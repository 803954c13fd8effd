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
use murmurate::net::media::radio::Powers;
use murmurate::registry::Registry;
use murmurate::trial::Trial;
use murmurate_import::mapping;
use murmurate_robot::output::{print, talk};
use murmurate_robot::{BadInput, Ended, bad, own_name};
use murmurate_study::twin::comparison::{self, Row};
use murmurate_study::twin::lag::Limits;
use murmurate_study::twin::missing::{self, Held, Missing};
use murmurate_study::twin::model::{self, Basis, Fitted, Given};
use murmurate_study::twin::pages::Words;
use murmurate_study::twin::path::PathLoss;
use murmurate_study::twin::predict::{self, Predicted};
use run_of::{Origin, Recorded};

/// Least number of episodes of a recorded run: two to fit and two to predict, so that both have confidence intervals.
const LEAST: usize = 4;

/// Flags of `murmurate study twin`.
#[derive(clap::Args)]
#[command(
    after_help = "Exit codes: 0 every measurement agrees with its prediction; 1 at least one lies outside its bar: the \
    table says which; or nothing could be fitted, and so nothing was compared; 2 a flag or a record is wrong; 130 \
    interrupted, nothing was compared."
)]
pub struct Args {
    /// Records of the hosts of one run, or their folder: what 'launch --record DIR' or 'host --record DIR' wrote; or
    /// the record of a run from elsewhere, which 'record import' wrote
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
    /// Quantities that were not fitted, because the records do not hold them.
    not_fitted: &'a [Missing],
    notes: &'a [String],
}

/// Runs `study twin`: fits a model to the first half of a recorded run's episodes, predicts the second half by
/// simulation, compares both, and prints and writes the report.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let given = given(args)?;
    let Recorded { run, origin, mut notes, digests } = run_of::read(&args.records, registry)?;
    let count = run.count();
    if count < LEAST {
        return bad(too_few(count, &origin));
    }
    let first = count / 2;
    let (half, end) = (u32::try_from(first).context("episodes")?, u32::try_from(count).context("episodes")?);
    let basis = basis(&origin);
    let (found, later) = (model::fit(&run, &basis, 0..half), model::fit(&run, &basis, half..end));
    let (missing, more) = said_of(&found, &origin);
    notes.extend(more);
    let fitted = given.over(found);
    let twin = twin_of(&origin, &fitted, (half, end), args.run.seed)?;
    let simulated = twin.as_ref().filter(|twin| twin.deployment.check_simulated().is_ok());
    let folder = args.run.out.as_deref().map(|path| files::open(path, &digests, &command(args))).transpose()?;
    let repeats = simulated.map_or(0, |_| args.repeats);
    let predicted = simulated.map_or(Ok(Some(Vec::new())), |twin| predict(args, twin, repeats))?;
    let Some(predicted) = predicted else { return Ok(Ended::Interrupted) };
    let rows = comparison::rows(&run, first, &predicted, (&fitted, &later), (&basis.links, args.run.seed));
    let agrees = !rows.is_empty() && rows.iter().all(|row| row.agrees);
    let report = Report {
        study: "twin",
        scenario: scenario_of(&origin),
        robots: basis.robots,
        episodes: [first, count - first],
        repeats,
        given: &args.given,
        rows: &rows,
        agrees,
        not_fitted: &missing,
        notes: &notes,
    };
    let title = title(&origin, basis.robots);
    let text = in_words(&title, &report);
    if let Some(folder) = &folder {
        let notes = missing.iter().map(Missing::to_string).chain(notes.iter().cloned()).collect();
        let (episodes, command) = (report.episodes, command(args));
        let words = Words { title, command, episodes, repeats: repeats as usize, notes };
        let conditions = match &origin {
            Origin::Team(..) => files::of_team(&fitted, twin.as_ref().expect("a team has a twin")),
            Origin::Elsewhere(mapping, _) => files::of_import(&fitted, mapping.hull_m),
        };
        let model = (&conditions, twin.as_ref().map(|twin| &twin.deployment));
        files::write(folder, &words, (&run, first, &predicted), (&rows, &text), model)?;
    }
    print(&if args.run.json { serde_json::to_string(&report).context("a report is JSON")? } else { text })?;
    args.run.print_location(folder.as_ref(), "repeats", predicted.len(), predicted.len());
    Ok(if agrees { Ended::Done } else { Ended::Unfit })
}

/// Returns why `count` episodes of a run are too few, and what to do.
fn too_few(count: usize, origin: &Origin) -> String {
    let count = counted(count, "episode");
    let needs = format!("a twin needs at least {LEAST}: half to fit and half to compare");
    match origin {
        Origin::Team(..) => format!("the records have {count} with a result, from the first on; {needs}"),
        Origin::Elsewhere(..) => format!(
            "the run has {count}, and {needs}; a length in the mapping, such as episodes = 10.0, cuts it into as many \
             as it has room for"
        ),
    }
}

/// Returns what the fit of a run takes as given.
fn basis(origin: &Origin) -> Basis {
    match origin {
        Origin::Team(trial, _) => Basis::of(trial),
        Origin::Elsewhere(mapping, made) => {
            let mapping::Limits { speed_m_s, axis_m_s2, total_m_s2 } = mapping.limits;
            let most = |limit: Option<f64>| limit.unwrap_or(f64::INFINITY);
            let limits = Limits {
                step_s: mapping.period_s,
                speed_m_s: most(speed_m_s),
                axis_m_s2: most(axis_m_s2),
                total_m_s2: most(total_m_s2),
            };
            let (period_ns, robots) = (mapping.period_ns(), mapping.names.len());
            Basis { period_ns, limits, slips: !made.derived, matches: true, robots, links: Vec::new(), seed: 0 }
        }
    }
}

/// Returns the trial that predicts the episodes from `half` to `end` of a team's run, with the fitted model; `None` for
/// an imported run, whose goals and policies are not known.
fn twin_of(origin: &Origin, fitted: &Fitted, (half, end): (u32, u32), seed: u64) -> Result<Option<Trial>> {
    let Origin::Team(trial, _) = origin else { return Ok(None) };
    let mut twin = model::simulation(fitted, trial, half);
    twin.seed = seed;
    twin.layouts = twin.layouts.first(end - half);
    twin.check().map_err(|error| BadInput(format!("the model of this run cannot be simulated: {error}")))?;
    Ok(Some(twin))
}

fn scenario_of(origin: &Origin) -> &str {
    match origin {
        Origin::Team(trial, _) => trial.scenario.name(),
        Origin::Elsewhere(mapping, _) => mapping.task.as_deref().unwrap_or("none"),
    }
}

fn title(origin: &Origin, robots: usize) -> String {
    let (robots, scenario) = (counted(robots, "robot"), scenario_of(origin));
    match origin {
        Origin::Team(trial, policy) => {
            let mode = &trial.deployment.mode;
            format!("Twin of a run: {robots}, scenario {scenario}, mode {mode}, policy {policy}")
        }
        Origin::Elsewhere(..) => format!("Twin of a run from elsewhere: {robots}, task {scenario}"),
    }
}

/// Returns the report as text: its head, the table, what was not fitted, and the notes.
fn in_words(title: &str, report: &Report) -> String {
    let [fitted, other] = report.episodes;
    let predicting = match report.repeats {
        0 => "compared with the other".to_owned(),
        repeats => format!("the other {other} predicted in {}", counted(repeats, "repeat")),
    };
    let given = if report.given.is_empty() { String::new() } else { format!("; given: {}", report.given.join(", ")) };
    let head = format!("{title}\nfitted to {}; {predicting}{given}", counted(fitted, "episode"));
    let lines = report.not_fitted.iter().map(|missing| format!("\n{missing}"));
    let lines = lines.chain(report.notes.iter().map(|note| format!("\nnote: {note}")));
    let table = match report.rows {
        [] => "Nothing was fitted, so nothing is compared.".to_owned(),
        rows => comparison::text(rows),
    };
    format!("{head}\n\n{table}\n") + &lines.collect::<String>()
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

/// Returns what was not fitted to a run, and notes on how the rest was.
fn said_of(found: &Fitted, origin: &Origin) -> (Vec<Missing>, Vec<String>) {
    let mut notes: Vec<String> = found.path.iter().map(powers_of).collect();
    match origin {
        Origin::Team(trial, _) => {
            notes.extend(found.late_s.map(|late_s| {
                format!(
                    "the records have no true states: the lag was fitted to the robots' own estimates, in which a \
                     command shows after {:.0} ms",
                    1e3 * late_s
                )
            }));
            (missing::of_team(found, trial), notes)
        }
        Origin::Elsewhere(mapping, made) => {
            notes.extend(found.late_s.map(|late_s| {
                let (late_ms, period_ms) = (1e3 * late_s, 1e3 * mapping.period_s);
                format!(
                    "a command shows in the poses after {late_ms:.0} ms, to {period_ms:.0} ms; the lag is what comes \
                     after that"
                )
            }));
            notes.extend(found.slip.map(|_| "slip contains the noise of the velocities".to_owned()));
            let (commands, receipts) = (mapping.command_frame.is_some(), mapping.receipts.is_some());
            let held = Held { commands, receipts, velocities: !made.derived };
            (missing::of_import(found, held), notes)
        }
    }
}

/// Returns the table of a radio file that has a path loss.
fn powers_of(path: &PathLoss) -> String {
    let Powers { exponent, detect_dbm, sense_dbm, .. } = path.powers();
    format!(
        "fewer messages arrive over longer distances, as with a radio of these powers ({:.0} % are lost at all \
         distances): [powers] exponent = {exponent:.1}, fading = \"rayleigh\", detect_dbm = {detect_dbm:.1}, \
         sense_dbm = {sense_dbm:.1}",
        100.0 * path.loss.value
    )
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
