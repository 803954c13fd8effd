//! The folder of a study: whose it is, and files that are replaced whole. What is in them is each study's own matter.

use std::path::{Path, PathBuf};

use crate::config;
use crate::report::figures::Figure;
use anyhow::{Context, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::program::BadInput;
use crate::program::temporary::Temporary;
use crate::program::whole_file::WholeFile;

/// The file that says which study a folder is of.
const IDENTITY: &str = "study.json";

/// A folder that a study writes to.
pub struct Folder(PathBuf);

impl Folder {
    /// Makes the folder and the one of its finished `pieces` if need be, and finds out whether both can be written and
    /// are of this study or of none. `difference` says in which way another identity is another one.
    pub fn open<I: Serialize + DeserializeOwned>(
        path: &Path,
        pieces: &str,
        identity: &I,
        difference: impl Fn(&I) -> Option<String>,
    ) -> Result<Folder> {
        let refuse = |why: String| BadInput(format!("--out: '{}': {why}; choose another folder", path.display()));
        let theirs = match std::fs::read_to_string(path.join(IDENTITY)) {
            Ok(text) => Some(text),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
            Err(error) => return Err(refuse(format!("cannot read '{IDENTITY}': {error}")).into()),
        };
        if let Some(text) = &theirs {
            let theirs: I = serde_json::from_str(text).map_err(|e| {
                refuse(format!("its '{IDENTITY}' is of another study, program or version ({})", config::json(&e)))
            })?;
            if let Some(how) = difference(&theirs) {
                return Err(refuse(format!("it is of another study: {how}")).into());
            }
        } else if path.join(pieces).exists() || path.join("report.html").exists() {
            return Err(refuse(format!("it holds files of something else and no '{IDENTITY}'")).into());
        }
        for folder in [path, &path.join(pieces), &path.join("figures")] {
            std::fs::create_dir_all(folder).map_err(|e| refuse(format!("cannot make this folder: {e}")))?;
            Temporary::new_in(folder, 0o600).map_err(|e| refuse(format!("cannot write there: {e}")))?;
        }
        let folder = Folder(path.to_owned());
        if theirs.is_none() {
            folder.write_json(IDENTITY, identity)?;
        }
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

    /// What was kept of a finished piece, if that is there and whole; else the piece is done again.
    pub fn kept<R: DeserializeOwned>(&self, name: &str) -> Option<R> {
        serde_json::from_str(&std::fs::read_to_string(self.0.join(name)).ok()?).ok()
    }

    /// Keeps what came of a piece: one file a piece, each whole or not there, so that no moment of an interruption
    /// loses more than what was under way.
    pub fn keep(&self, name: &str, record: &impl Serialize) -> Result<()> {
        self.write(name, serde_json::to_string(record).context("a record is JSON")?.as_bytes())
    }

    /// Writes figures and page. The page goes last of all: what it is of is then there.
    pub fn write_page(&self, figures: &[Figure], page: &str) -> Result<()> {
        for figure in figures {
            self.write(&format!("figures/{}.svg", figure.name), figure.svg.as_bytes())?;
            #[cfg(feature = "png")]
            self.write(&format!("figures/{}.png", figure.name), &crate::report::png::render(&figure.svg)?)?;
        }
        self.write("report.html", page.as_bytes())
    }

    /// Writes plain data for people and programs.
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let text = serde_json::to_string_pretty(value).context("plain data is JSON")? + "\n";
        self.write(name, text.as_bytes())
    }

    /// Writes rows, one a line below their names.
    pub fn write_csv(&self, name: &str, rows: impl IntoIterator<Item = impl Serialize>) -> Result<()> {
        let mut csv = csv::Writer::from_writer(Vec::new());
        for row in rows {
            csv.serialize(row).context("a row is plain data")?;
        }
        self.write(name, &csv.into_inner().context("memory takes everything")?)
    }

    /// Writes a file.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.0.join(name);
        let wrong = || format!("cannot write '{}'; what was finished before is kept", path.display());
        let mut file = WholeFile::create(&path)?;
        file.writer().write_all(bytes).with_context(wrong)?;
        file.keep().with_context(wrong)
    }
}
