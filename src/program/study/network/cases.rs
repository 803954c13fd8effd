//! What a network study keeps in its folder: a file for each finished case, and rows, figures, table and page.

use std::path::Path;

use crate::study::network::pages::Findings;
use crate::study::network::{Case, Outcome, Source, Sweep, table};
use crate::study::origin::{self, Origin};
use anyhow::Result;
use serde::{Deserialize, Serialize};

use crate::program::study::folder::Folder;

/// The folder of finished cases.
const CASES: &str = "cases";
/// The name of the study in its records.
const STUDY: &str = "network";

/// What makes it this study and no other.
#[derive(PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Identity {
    study: String,
    version: String,
    build: String,
    sweep: Sweep,
    /// What was measured on, if anything is: who takes part, and a digest of their link.
    link: Option<String>,
}

/// A finished case.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// Its origin.
    origin: Origin,
    case: Case,
    /// What came of it.
    pub outcome: Outcome,
    /// How far off its delays may be \[s\]: zero where nothing was measured.
    pub uncertainty_s: f64,
}

/// The finished cases of a sweep, in a folder if there is one.
pub struct Journal {
    /// The sweep.
    pub sweep: Sweep,
    /// Where they are kept.
    pub folder: Option<Folder>,
    link: Option<String>,
}

impl Journal {
    /// The journal of a sweep, which is measured on this link if it is.
    pub fn open(path: Option<&Path>, sweep: Sweep, link: Option<String>) -> Result<Journal> {
        let (version, build) = (origin::VERSION.to_owned(), origin::BUILD.to_owned());
        let study = STUDY.to_owned();
        let ours = Identity { study, version, build, sweep: sweep.clone(), link: link.clone() };
        let differs =
            |theirs: &Identity| (*theirs != ours).then(|| "another sweep, medium, team, version or build".to_owned());
        let folder = path.map(|path| Folder::open(path, CASES, &ours, differs)).transpose()?;
        Ok(Journal { sweep, folder, link })
    }

    /// The origin of a case's record. Nothing else that is varied decides it.
    fn origin(&self, source: Source, case: &Case) -> Origin {
        let Sweep { stations, bytes, medium, history, seconds, seed, .. } = &self.sweep;
        let link = self.link.as_ref().filter(|_| source == Source::Live);
        Origin::here(STUDY, *seed, "", &(source, case, stations, bytes, medium, history, seconds, link))
    }

    /// The outcome of each case, as far as it is there and whole.
    pub fn kept(&self, source: Source, cases: &[Case]) -> Vec<Option<Record>> {
        let one = |(at, case): (usize, &Case)| {
            let record: Record = self.folder.as_ref()?.kept(&name(source, at))?;
            (record.case == *case && record.origin == self.origin(source, case)).then_some(record)
        };
        cases.iter().enumerate().map(one).collect()
    }

    /// Keeps what came of a case, if there is a folder.
    pub fn keep(
        &self,
        source: Source,
        (at, case): (usize, &Case),
        outcome: Outcome,
        uncertainty_s: f64,
    ) -> Result<Record> {
        let record = Record { origin: self.origin(source, case), case: *case, outcome, uncertainty_s };
        self.folder.as_ref().map_or(Ok(()), |folder| folder.keep(&name(source, at), &record))?;
        Ok(record)
    }
}

fn name(source: Source, at: usize) -> String {
    format!("{CASES}/{source}-{at:04}.json")
}

/// The file of a team that was simulated.
pub fn team(mode: &str, robots: usize) -> String {
    format!("{CASES}/team-{mode}-{robots:04}.json")
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
