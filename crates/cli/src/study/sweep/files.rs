//! Files of a sweep: records of finished trials, and rows, table, figure and page of the report.

use std::path::Path;

use anyhow::{Context, Result};
use murmurate_study::sweep::results::{Results, Row};
use murmurate_study::sweep::{Job, PointRecord, Sweep, pages, table};
use serde_json::{Map, Value, json};

use crate::study::folder::Folder;

/// Name of the subfolder with records of finished trials.
const TRIALS: &str = "trials";

/// Opens or creates the output folder of a sweep. Fails if it belongs to another study.
pub fn open(path: &Path, sweep: &Sweep) -> Result<Folder> {
    let identity = sweep.identity();
    Folder::open(path, TRIALS, &identity, |theirs| {
        let (field, ours, theirs) = identity.difference(theirs)?;
        Some(format!("{field} is {theirs} there and {ours} here"))
    })
}

/// Returns the name of the file in the folder with the results of a trial (JSON).
fn name(job: Job) -> String {
    format!("{TRIALS}/{:04}.{:04}.json", job.point + 1, job.repeat)
}

/// Reads the results of the trial `job` from the folder; `None` if they are missing, damaged or found under other
/// conditions.
pub fn read(folder: &Folder, sweep: &Sweep, job: Job) -> Option<PointRecord> {
    folder.kept(&name(job)).filter(|record: &PointRecord| record.belongs_to(sweep, job))
}

/// Writes the results of the finished trial `job` into the folder.
pub fn write(folder: &Folder, job: Job, record: &PointRecord) -> Result<()> {
    folder.keep(&name(job), record)
}

/// Writes the report of a sweep into its folder: rows of all points and of all episodes, table, figure and page.
pub fn write_report(folder: &Folder, sweep: &Sweep, results: &Results, records: &[(Job, PointRecord)]) -> Result<()> {
    let rows: Vec<&Row> = results.rows().collect();
    folder.write("episodes.csv", &csv(sweep, &EPISODE, records.iter().flat_map(|(_, record)| lines(record)))?)?;
    let there = sweep.points.iter().zip(&results.0).filter_map(|(point, row)| Some((&point.at, flat(row.as_ref()?))));
    folder.write("points.csv", &csv(sweep, &POINT, there)?)?;
    folder.write_json("points.json", &rows)?;
    folder.write("table.txt", (table::text(sweep, results) + "\n").as_bytes())?;
    let figure = pages::figure(sweep, results)?;
    let page = pages::page(sweep, results, &figure);
    folder.write_page(&[figure], &page)
}

/// Fields of a line of `episodes.csv` after the axes; `docs/study.md` describes them.
const EPISODE: [&str; 7] = ["repeat", "episode", "verdict", "makespan_s", "reset_s", "min_separation_m", "cost"];

/// Fields of a line of `points.csv` after the axes, in their order; an interval is two fields.
const POINT: [&str; 24] = [
    "policy",
    "robots",
    "episodes",
    "success_rate",
    "success_ci95_low",
    "success_ci95_high",
    "makespan_median_s",
    "makespan_quartiles_s_low",
    "makespan_quartiles_s_high",
    "robot_collisions",
    "wall_collisions",
    "timeouts",
    "aborted",
    "unseen",
    "completed",
    "cost_mean",
    "cost_ci95_low",
    "cost_ci95_high",
    "cost_median",
    "delivered",
    "within_20ms",
    "within_50ms",
    "neighbours",
    "age_p50_ms",
];

/// Returns the values on the axes, and the results, of each episode of a trial.
fn lines(record: &PointRecord) -> impl Iterator<Item = (&Vec<String>, Map<String, Value>)> {
    record.episodes.iter().map(move |episode| {
        let result = json!({
            "repeat": episode.repeat,
            "episode": episode.episode,
            "verdict": episode.verdict,
            "makespan_s": episode.makespan_s,
            "reset_s": episode.reset_s,
            "min_separation_m": Some(episode.min_separation_m).filter(|distance| distance.is_finite()),
            "cost": episode.cost,
        });
        let Value::Object(fields) = result else { unreachable!("it is an object") };
        (&record.at, fields)
    })
}

/// Returns the fields of a row as single values.
fn flat(row: &Row) -> Map<String, Value> {
    let Ok(Value::Object(fields)) = serde_json::to_value(row) else { unreachable!("a row is plain data") };
    let mut flat = Map::new();
    for (name, value) in fields {
        match value {
            Value::Array(ends) => {
                let named = ["low", "high"].map(|end| format!("{name}_{end}"));
                flat.extend(named.into_iter().zip(ends));
            }
            value => drop(flat.insert(name, value)),
        }
    }
    flat
}

/// Returns rows as CSV with a header: the axes, and those of `fields` that are not an axis.
fn csv<'a>(
    sweep: &Sweep,
    fields: &[&str],
    rows: impl Iterator<Item = (&'a Vec<String>, Map<String, Value>)>,
) -> Result<Vec<u8>> {
    let axes: Vec<&str> = sweep.axes.iter().map(|axis| axis.name.as_str()).collect();
    let fields: Vec<&str> = fields.iter().copied().filter(|field| !axes.contains(field)).collect();
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(axes.iter().chain(&fields)).context("memory takes everything")?;
    for (at, row) in rows {
        let cell = |field: &&str| match row.get(*field) {
            None | Some(Value::Null) => String::new(),
            Some(Value::String(text)) => text.clone(),
            Some(value) => value.to_string(),
        };
        csv.write_record(at.iter().cloned().chain(fields.iter().map(cell))).context("memory takes everything")?;
    }
    csv.into_inner().context("memory takes everything")
}
