//! Files of the studies `modes`, `delay` and `range`: records of finished trials, and rows, figures, table and page of
//! the report.

use crate::recording::Recorded;
use anyhow::Result;
use murmurate::scenario::judge::Verdict;
use murmurate_record::identity::StudyJob;
use murmurate_study::record::TrialRecord;
use murmurate_study::results::{Results, Row};
use murmurate_study::{Job, Study, pages, table};
use serde::Serialize;

use super::folder::Folder;

/// Name of the subfolder with records of finished trials.
const TRIALS: &str = "trials";

/// Row of `episodes.csv`; `docs/study.md` describes the columns.
#[derive(Serialize)]
struct Line<'a> {
    column: &'a str,
    policy: &'a str,
    handling: &'a str,
    repeat: u32,
    episode: u32,
    verdict: Verdict,
    makespan_s: Option<f64>,
    reset_s: f64,
    min_separation_m: Option<f32>,
    cost: Option<f64>,
}

/// Opens or creates the output folder of a study. Fails if it belongs to another study.
pub fn open(path: &std::path::Path, study: &Study) -> Result<Folder> {
    let identity = study.identity();
    Folder::open(path, TRIALS, &identity, |theirs| {
        let (field, ours, theirs) = identity.difference(theirs)?;
        Some(format!("{field} is {theirs} there and {ours} here"))
    })
}

/// Returns the name of a trial's column without the characters that a file name may not have.
fn column(study: &Study, job: Job) -> String {
    study.columns[job.column].name.replace(['/', '%'], "")
}

/// Returns the description of a trial of a study for its recording: name of its record, policy, and place in the study.
pub fn recorded(study: &Study, job: Job) -> Recorded {
    let name = format!("{}-{}-{:04}", column(study, job), job.policy + 1, job.repeat);
    let place = StudyJob { column: job.column, policy: job.policy };
    Recorded { name, policy: study.policies[job.policy].digest.clone(), job: Some(place) }
}

/// Returns the name of the file in the study's folder with the results of a trial (JSON).
fn name(study: &Study, job: Job) -> String {
    let column = column(study, job);
    format!("{TRIALS}/{column}.{}.{:03}.json", job.policy + 1, job.repeat)
}

/// Reads the results of the trial `job` from the study's folder; `None` if they are missing, damaged or found under
/// other conditions.
pub fn read(folder: &Folder, study: &Study, job: Job) -> Option<TrialRecord> {
    folder.kept(&name(study, job)).filter(|record: &TrialRecord| record.belongs_to(study, job))
}

/// Writes the results of the finished trial `job` into the study's folder.
pub fn write(folder: &Folder, study: &Study, job: Job, record: &TrialRecord) -> Result<()> {
    folder.keep(&name(study, job), record)
}

/// Writes the report of a study into its folder: rows of all episodes, results of the columns, table, figures and page.
pub fn write_report(folder: &Folder, study: &Study, results: &Results, records: &[(Job, TrialRecord)]) -> Result<()> {
    folder.write_csv("episodes.csv", records.iter().flat_map(|(_, record)| lines(record)))?;
    folder.write_json("columns.json", &results.rows().collect::<Vec<&Row>>())?;
    folder.write("table.txt", (table::text(study, results) + "\n").as_bytes())?;
    let figures = pages::figures(study, results)?;
    folder.write_page(&figures, &pages::page(study, results, &figures))
}

fn lines(record: &TrialRecord) -> impl Iterator<Item = Line<'_>> {
    record.episodes.iter().map(|episode| Line {
        column: &record.column,
        policy: &record.policy,
        handling: &record.handling,
        repeat: episode.repeat,
        episode: episode.episode,
        verdict: episode.verdict,
        makespan_s: episode.makespan_s,
        reset_s: episode.reset_s,
        min_separation_m: Some(episode.min_separation_m).filter(|distance| distance.is_finite()),
        cost: episode.cost,
    })
}
