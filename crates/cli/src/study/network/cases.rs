//! Files of a network study: records of finished cases, and rows, figures, table and page of the report.

use std::path::Path;

use anyhow::Result;
use murmurate_study::network::pages::Findings;
use murmurate_study::network::{Case, Outcome, Source, Sweep, table};
use murmurate_study::origin::{self, Origin};
use serde::{Deserialize, Serialize};

use crate::study::folder::Folder;

/// Name of the subfolder of the study's folder that has the records of finished cases.
const CASES: &str = "cases";
/// Name of the network study in the records of its cases.
const STUDY: &str = "network";

/// What identifies a network study, stored in its folder: a folder with another identity is refused.
#[derive(PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Identity {
    study: String,
    version: String,
    build: String,
    sweep: Sweep,
    /// Names of the participants and a digest of their link; `None` without a measurement.
    link: Option<String>,
}

/// Stored result of a finished case of a network study, with the conditions under which it was found.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaseRecord {
    /// Origin of the record: study, program, seed and conditions.
    origin: Origin,
    case: Case,
    /// Outcome of the case: delivery and delay of messages, ages at control steps, and other counts.
    pub outcome: Outcome,
    /// Bound on the error of the measured one-way delays \[s\], as the clocks of hosts differ; 0 in an emulation.
    pub uncertainty_s: f64,
}

/// Results of the finished cases of a network study, stored in its folder if it has one.
pub struct Journal {
    /// Parameters of the study, whose cases are all combinations of the lists in them.
    pub sweep: Sweep,
    /// Output folder of the study; `None` if nothing is stored.
    pub folder: Option<Folder>,
    link: Option<String>,
}

impl Journal {
    /// Opens the stored results of a network study in the folder `path`, if one is given. `link` describes the link
    /// that is measured; `None` in an emulation alone. Fails if the folder belongs to another study.
    pub fn open(path: Option<&Path>, sweep: Sweep, link: Option<String>) -> Result<Journal> {
        let (version, build) = (origin::VERSION.to_owned(), murmurate_robot::build::digest().to_owned());
        let study = STUDY.to_owned();
        let ours = Identity { study, version, build, sweep: sweep.clone(), link: link.clone() };
        let differs =
            |theirs: &Identity| (*theirs != ours).then(|| "another sweep, medium, team, version or build".to_owned());
        let folder = path.map(|path| Folder::open(path, CASES, &ours, differs)).transpose()?;
        Ok(Journal { sweep, folder, link })
    }

    /// Returns the origin of a case's record: study, program, seed and conditions. It is independent of the study's
    /// other cases.
    fn origin(&self, source: Source, case: &Case) -> Origin {
        let Sweep { stations, bytes, medium, places, history, seconds, seed, .. } = &self.sweep;
        let link = self.link.as_ref().filter(|_| source == Source::Live);
        Origin::here(
            murmurate_robot::build::digest(),
            STUDY,
            *seed,
            "",
            &(source, case, stations, bytes, (medium, places), history, seconds, link),
        )
    }

    /// Returns the stored result of each case, from emulation or measurement as `source` says; `None` for a result that
    /// is missing, damaged or found under other conditions.
    pub fn kept(&self, source: Source, cases: &[Case]) -> Vec<Option<CaseRecord>> {
        let one = |(at, case): (usize, &Case)| {
            let record: CaseRecord = self.folder.as_ref()?.kept(&name(source, at))?;
            (record.case == *case && record.origin == self.origin(source, case)).then_some(record)
        };
        cases.iter().enumerate().map(one).collect()
    }

    /// Stores the outcome of a case, if there is a folder, and returns the result with its conditions. `source` says
    /// whether the case was emulated or measured; `at` is the index of the case in the study.
    pub fn keep(
        &self,
        source: Source,
        (at, case): (usize, &Case),
        outcome: Outcome,
        uncertainty_s: f64,
    ) -> Result<CaseRecord> {
        let record = CaseRecord { origin: self.origin(source, case), case: *case, outcome, uncertainty_s };
        self.folder.as_ref().map_or(Ok(()), |folder| folder.keep(&name(source, at), &record))?;
        Ok(record)
    }
}

fn name(source: Source, at: usize) -> String {
    format!("{CASES}/{source}-{at:04}.json")
}

/// Returns the name of the file with the cost of a simulated team of `robots` robots in the mode `mode`.
pub fn team(mode: &str, robots: usize) -> String {
    format!("{CASES}/team-{mode}-{robots:04}.json")
}

/// Writes the report of a network study into its folder: rows of the cases, cost of growing teams, figures, table and
/// page.
pub fn write_report(folder: &Folder, findings: &Findings) -> Result<()> {
    let rows = findings.rows();
    folder.write_csv("rows.csv", &rows)?;
    folder.write_json("rows.json", &rows)?;
    folder.write_json("growth.json", &findings.grown)?;
    folder.write("table.txt", (table::text(findings.sweep, &rows, findings.grown) + "\n").as_bytes())?;
    let figures = findings.figures()?;
    folder.write_page(&figures, &findings.page(&figures))
}
