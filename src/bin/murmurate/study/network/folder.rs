//! The folder of a network study: which sweep it is of, its finished cases, the report. Each file is replaced whole.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use murmurate::study::network::pages::Findings;
use murmurate::study::network::{Case, Outcome, Sweep, table};
use serde::{Deserialize, Serialize};

use crate::BadInput;
use crate::output::WholeFile;

/// The file that says which study a folder is of.
const IDENTITY: &str = "study.json";

/// A folder that a network study writes to.
pub struct Folder(PathBuf);

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

impl Folder {
    /// Makes the folder if need be, finds out whether it can be written, and whether it is of this sweep or of none.
    pub fn open(path: &Path, sweep: &Sweep) -> Result<Folder> {
        let refuse = |why: String| BadInput(format!("--out: '{}': {why}", path.display()));
        let version = env!("CARGO_PKG_VERSION").to_owned();
        let ours = Identity { study: "network".to_owned(), version, sweep: sweep.clone() };
        match std::fs::read_to_string(path.join(IDENTITY)) {
            Ok(text) => {
                let same = serde_json::from_str::<Identity>(&text).is_ok_and(|theirs| theirs == ours);
                if !same {
                    let why = format!("its '{IDENTITY}' is of another study or version; choose another folder");
                    return Err(refuse(why).into());
                }
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                if path.join("report.html").exists() {
                    let why = format!("it holds a report of something else and no '{IDENTITY}'; choose another folder");
                    return Err(refuse(why).into());
                }
            }
            Err(error) => return Err(refuse(format!("cannot read '{IDENTITY}': {error}")).into()),
        }
        for folder in [path, &path.join("cases"), &path.join("figures")] {
            std::fs::create_dir_all(folder).map_err(|e| refuse(format!("cannot make this folder: {e}")))?;
            tempfile::tempfile_in(folder)
                .map_err(|e| refuse(format!("cannot write there: {e}; choose a folder that can be written")))?;
        }
        let folder = Folder(path.to_owned());
        folder.write_json(IDENTITY, &ours)?;
        Ok(folder)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The report's file.
    pub fn page(&self) -> PathBuf {
        self.0.join("report.html")
    }

    fn case_file(source: &str, at: usize) -> String {
        format!("cases/{source}-{at:04}.json")
    }

    /// What came of a case, if that is there and whole.
    pub fn read(&self, source: &str, at: usize, case: &Case) -> Option<Outcome> {
        let text = std::fs::read_to_string(self.0.join(Folder::case_file(source, at))).ok()?;
        let record: Record = serde_json::from_str(&text).ok()?;
        (record.case == *case).then_some(record.outcome)
    }

    /// Keeps what came of a case.
    pub fn keep(&self, source: &str, at: usize, case: &Case, outcome: &Outcome) -> Result<()> {
        let record = Record { case: *case, outcome: outcome.clone() };
        let text = serde_json::to_string(&record).context("a record is JSON")?;
        self.write(&Folder::case_file(source, at), text.as_bytes())
    }

    /// Writes rows, figures, table and page. The page goes last: what it is of is then there.
    pub fn write_report(&self, findings: &Findings) -> Result<()> {
        let rows = findings.rows();
        let mut csv = csv::Writer::from_writer(Vec::new());
        for row in &rows {
            csv.serialize(row).context("a row is plain data")?;
        }
        self.write("rows.csv", &csv.into_inner().context("memory takes everything")?)?;
        self.write_json("rows.json", &rows)?;
        self.write("table.txt", (table::text(findings.sweep, &rows) + "\n").as_bytes())?;
        let figures = findings.figures()?;
        for figure in &figures {
            self.write(&format!("figures/{}.svg", figure.name), figure.svg.as_bytes())?;
            #[cfg(feature = "png")]
            self.write(&format!("figures/{}.png", figure.name), &murmurate::report::png::render(&figure.svg)?)?;
        }
        self.write("report.html", findings.page(&figures).as_bytes())
    }

    fn write_json(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let text = serde_json::to_string_pretty(value).context("plain data is JSON")? + "\n";
        self.write(name, text.as_bytes())
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.0.join(name);
        let mut file = WholeFile::create(&path)?;
        let wrong = || format!("cannot write '{}'; what was finished before is kept", path.display());
        file.writer().write_all(bytes).with_context(wrong)?;
        file.keep().with_context(wrong)
    }
}
