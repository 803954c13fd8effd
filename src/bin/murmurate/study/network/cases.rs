//! What a network study keeps in its folder: a file for each finished case, and rows, figures, table and page.

use std::path::Path;

use anyhow::Result;
use murmurate::study::network::pages::Findings;
use murmurate::study::network::{Case, Outcome, Sweep, table};
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
}

/// A finished case.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    case: Case,
    outcome: Outcome,
}

/// The folder of this sweep.
pub fn open(path: &Path, sweep: &Sweep) -> Result<Folder> {
    let version = env!("CARGO_PKG_VERSION").to_owned();
    let ours = Identity { study: "network".to_owned(), version, sweep: sweep.clone() };
    Folder::open(path, CASES, &ours, |theirs| (*theirs != ours).then(|| "another sweep, medium or version".to_owned()))
}

fn name(source: &str, at: usize) -> String {
    format!("{CASES}/{source}-{at:04}.json")
}

/// The file of a team that was simulated.
pub fn team(mode: &str, robots: usize) -> String {
    format!("{CASES}/team-{mode}-{robots:04}.json")
}

/// What came of a case, if that is there and whole.
pub fn read(folder: &Folder, source: &str, at: usize, case: &Case) -> Option<Outcome> {
    let record: Record = folder.kept(&name(source, at))?;
    (record.case == *case).then_some(record.outcome)
}

/// Keeps what came of a case.
pub fn keep(folder: &Folder, source: &str, at: usize, case: &Case, outcome: &Outcome) -> Result<()> {
    folder.keep(&name(source, at), &Record { case: *case, outcome: outcome.clone() })
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
