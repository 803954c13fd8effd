//! What a network study keeps in its folder: a file for each finished case, and rows, figures, table and page.

use std::path::Path;

use anyhow::Result;
use murmurate::study::network::pages::Findings;
use murmurate::study::network::{Case, Outcome, Source, Sweep, table};
use serde::{Deserialize, Serialize};

use crate::study::folder::Folder;

/// The folder of finished cases.
const CASES: &str = "cases";

/// What makes it this study and no other.
#[derive(PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Identity {
    study: String,
    version: String,
    sweep: Sweep,
    /// What was measured on, if anything is: who takes part, and a digest of their link.
    link: Option<String>,
}

/// A finished case.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    case: Case,
    /// What came of it.
    pub outcome: Outcome,
    /// How far off its delays may be \[s\]: zero where nothing was measured.
    pub uncertainty_s: f64,
}

/// The folder of this sweep.
pub fn open(path: &Path, sweep: &Sweep, link: Option<String>) -> Result<Folder> {
    let version = env!("CARGO_PKG_VERSION").to_owned();
    let ours = Identity { study: "network".to_owned(), version, sweep: sweep.clone(), link };
    Folder::open(path, CASES, &ours, |theirs| {
        (*theirs != ours).then(|| "another sweep, medium, team or version".to_owned())
    })
}

fn name(source: Source, at: usize) -> String {
    format!("{CASES}/{source}-{at:04}.json")
}

/// The file of a team that was simulated.
pub fn team(mode: &str, robots: usize) -> String {
    format!("{CASES}/team-{mode}-{robots:04}.json")
}

/// What came of a case, if that is there and whole.
fn read(folder: &Folder, source: Source, at: usize, case: &Case) -> Option<Record> {
    folder.kept(&name(source, at)).filter(|record: &Record| record.case == *case)
}

/// What came of each case of a sweep, as far as it is there.
pub fn kept(folder: Option<&Folder>, source: Source, cases: &[Case]) -> Vec<Option<Record>> {
    let one = |(at, case)| folder.and_then(|folder| read(folder, source, at, case));
    cases.iter().enumerate().map(one).collect()
}

/// Keeps what came of a case, if there is a folder.
pub fn keep(
    folder: Option<&Folder>,
    source: Source,
    (at, case): (usize, &Case),
    outcome: Outcome,
    uncertainty_s: f64,
) -> Result<Record> {
    let record = Record { case: *case, outcome, uncertainty_s };
    folder.map_or(Ok(()), |folder| folder.keep(&name(source, at), &record))?;
    Ok(record)
}

/// Writes rows, what teams cost, figures, table and page.
pub fn write_report(folder: &Folder, findings: &Findings) -> Result<()> {
    let rows = findings.rows();
    folder.write_csv("rows.csv", &rows)?;
    folder.write_json("rows.json", &rows)?;
    folder.write_json("growth.json", &findings.grown)?;
    folder.write("table.txt", (table::text(findings.sweep, &rows, findings.grown) + "\n").as_bytes())?;
    let figures = findings.figures()?;
    folder.write_page(&figures, &findings.page(&figures))
}
