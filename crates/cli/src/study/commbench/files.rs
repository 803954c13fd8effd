//! Files of the benchmark: records of finished jobs, and rows, comparisons, table, figures and page of the report.

use std::path::Path;

use anyhow::Result;
use murmurate::scenario::judge::Verdict;
use murmurate_study::commbench::results::{Results, Row};
use murmurate_study::commbench::{Bench, EPISODES_OF_A_PART, Job, Record, pages, table};
use serde::Serialize;

use crate::study::folder::Folder;

/// Name of the subfolder with records of finished jobs.
const TRIALS: &str = "trials";

/// Row of `episodes.csv`.
#[derive(Serialize)]
struct Line<'a> {
    task: &'a str,
    channel: &'a str,
    robots: usize,
    entrant: &'a str,
    episode: u32,
    verdict: Verdict,
    makespan_s: Option<f64>,
    min_separation_m: Option<f32>,
    cost: Option<f64>,
}

/// Opens or creates the output folder of a benchmark. Fails if it belongs to another study.
pub fn open(path: &Path, bench: &Bench) -> Result<Folder> {
    let identity = bench.identity();
    Folder::open(path, TRIALS, &identity, |theirs| {
        let (field, ours, theirs) = identity.difference(theirs)?;
        Some(format!("{field} is {theirs} there and {ours} here"))
    })
}

/// Returns the name of the file in the folder with the results of a job (JSON).
fn name(bench: &Bench, job: Job) -> String {
    let entry = &bench.entries[job.entry];
    let cell = bench.cell(entry);
    format!("{TRIALS}/{}.{}.{}.{}.{:04}.json", cell.task.name, cell.channel.name, cell.robots, entry.entrant, job.part)
}

/// Reads the results of a job from the folder; `None` if they are missing, damaged or found under other conditions.
pub fn read(folder: &Folder, bench: &Bench, job: Job) -> Option<Record> {
    folder.kept(&name(bench, job)).filter(|record: &Record| record.belongs_to(bench, job))
}

/// Writes the results of a finished job into the folder.
pub fn write(folder: &Folder, bench: &Bench, job: Job, record: &Record) -> Result<()> {
    folder.keep(&name(bench, job), record)
}

/// Writes the report of a benchmark into its folder.
pub fn write_report(folder: &Folder, bench: &Bench, results: &Results, records: &[(Job, Record)]) -> Result<()> {
    folder.write_csv("episodes.csv", records.iter().flat_map(|(job, record)| lines(bench, *job, record)))?;
    folder.write_json("rows.json", &results.rows.iter().flatten().collect::<Vec<&Row>>())?;
    folder.write_json("comparisons.json", &results.comparisons)?;
    folder.write_json("empty.json", &bench.empty)?;
    folder.write("table.txt", (table::text(bench, results) + "\n").as_bytes())?;
    let figures = pages::figures(bench, results)?;
    folder.write_page(&figures, &pages::page(bench, results, &figures))
}

fn lines<'a>(bench: &'a Bench, job: Job, record: &'a Record) -> impl Iterator<Item = Line<'a>> {
    let entry = &bench.entries[job.entry];
    let cell = bench.cell(entry);
    record.episodes.iter().map(move |episode| Line {
        task: cell.task.name,
        channel: cell.channel.name,
        robots: cell.robots,
        entrant: &entry.entrant,
        episode: job.part * EPISODES_OF_A_PART + episode.episode,
        verdict: episode.verdict,
        makespan_s: episode.makespan_s,
        min_separation_m: Some(episode.min_separation_m).filter(|distance| distance.is_finite()),
        cost: episode.cost,
    })
}
