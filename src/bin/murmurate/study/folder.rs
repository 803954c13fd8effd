//! The folder of a study: which study it is of, its journal, and the report. Every file in it is replaced whole.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use murmurate::study::record::Record;
use murmurate::study::results::{Results, Row};
use murmurate::study::{Identity, Job, Study, pages, table};
use serde::Serialize;

use super::journal::Journal;
use crate::BadInput;
use crate::output::WholeFile;

/// The file that says which study a folder is of.
const IDENTITY: &str = "study.json";

/// A folder that a study writes to.
pub struct Folder {
    path: PathBuf,
}

/// One line of `episodes.csv`.
#[derive(Serialize)]
struct Line<'a> {
    column: &'a str,
    policy: &'a str,
    handling: &'a str,
    repeat: u32,
    episode: u32,
    verdict: murmurate::scenario::judge::Verdict,
    makespan_s: Option<f64>,
    reset_s: f64,
    min_separation_m: Option<f32>,
}

impl Folder {
    /// Makes the folder if need be, finds out whether it can be written, and whether it is of this study or of none.
    pub fn open(path: &Path, study: &Study) -> Result<Folder> {
        let refuse = |why: String| BadInput(format!("--out: '{}': {why}", path.display()));
        let identity = study.identity();
        let trials = path.join("trials");
        let theirs = match std::fs::read_to_string(path.join(IDENTITY)) {
            Ok(text) => Some(text),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
            Err(error) => return Err(refuse(format!("cannot read '{IDENTITY}': {error}")).into()),
        };
        if let Some(text) = &theirs {
            let theirs: Identity = serde_json::from_str(text).map_err(|e| {
                refuse(format!("its '{IDENTITY}' is of another program or version ({e}); choose another folder"))
            })?;
            if let Some((field, ours, theirs)) = identity.difference(&theirs) {
                let why =
                    format!("it is of another study: {field} is {theirs} there and {ours} here; choose another folder");
                return Err(refuse(why).into());
            }
        } else if trials.exists() || path.join("report.html").exists() {
            let why = format!("it holds files of something else and no '{IDENTITY}'; choose another folder");
            return Err(refuse(why).into());
        }
        for folder in [path, &trials, &path.join("figures")] {
            std::fs::create_dir_all(folder).map_err(|e| refuse(format!("cannot make this folder: {e}")))?;
            tempfile::tempfile_in(folder)
                .map_err(|e| refuse(format!("cannot write there: {e}; choose a folder that can be written")))?;
        }
        let folder = Folder { path: path.to_owned() };
        if theirs.is_none() {
            folder.write_json(IDENTITY, &identity)?;
        }
        Ok(folder)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The report's file.
    pub fn page(&self) -> PathBuf {
        self.path.join("report.html")
    }

    /// Its finished trials.
    pub fn journal(&self) -> Journal {
        Journal(self.path.join("trials"))
    }

    /// Writes rows, figures, table and page. The page goes last: what it is of is then there.
    pub fn write_report(&self, study: &Study, results: &Results, records: &[(Job, Record)]) -> Result<()> {
        self.write("episodes.csv", &episodes(records)?)?;
        let rows: Vec<&Row> = results.rows().collect();
        self.write_json("columns.json", &rows)?;
        self.write("table.txt", (table::text(study, results) + "\n").as_bytes())?;
        let figures = pages::figures(study, results)?;
        for figure in &figures {
            self.write(&format!("figures/{}.svg", figure.name), figure.svg.as_bytes())?;
            #[cfg(feature = "png")]
            self.write(&format!("figures/{}.png", figure.name), &murmurate::report::png::render(&figure.svg)?)?;
        }
        self.write("report.html", pages::page(study, results, &figures).as_bytes())
    }

    fn write_json(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let text = serde_json::to_string_pretty(value).context("plain data is JSON")? + "\n";
        self.write(name, text.as_bytes())
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.path.join(name);
        let mut file = WholeFile::create(&path)?;
        file.writer().write_all(bytes).with_context(|| format!("cannot write '{}'", path.display()))?;
        file.keep()
    }
}

/// Every episode of every trial as CSV; `docs/study.md` has the schema.
fn episodes(records: &[(Job, Record)]) -> Result<Vec<u8>> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    for (_, record) in records {
        for episode in &record.episodes {
            let line = Line {
                column: &record.column,
                policy: &record.policy,
                handling: &record.handling,
                repeat: episode.repeat,
                episode: episode.episode,
                verdict: episode.verdict,
                makespan_s: episode.makespan_s,
                reset_s: episode.reset_s,
                min_separation_m: Some(episode.min_separation_m).filter(|distance| distance.is_finite()),
            };
            csv.serialize(line).context("a row is plain data")?;
        }
    }
    csv.into_inner().context("memory takes everything")
}
