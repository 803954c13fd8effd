//! Output folder of a study, with a file that identifies the study; all files in it are replaced atomically.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use murmurate::config;
use murmurate_report::figures::Figure;
use serde::Serialize;
use serde::de::DeserializeOwned;

use murmurate_robot::destination::check_folder;
use murmurate_robot::temporary;
use murmurate_robot::whole_file::WholeFile;
use murmurate_robot::{BadInput, output};

/// Name of the file that identifies the study of the folder: its settings and the program's version.
const IDENTITY: &str = "study.json";

/// Output folder of a study, with the results of finished jobs (trials or cases), figures and the report.
pub struct Folder(PathBuf);

impl Folder {
    /// Opens or creates the output folder of a study, with a subfolder `pieces` for the results of finished jobs.
    /// `identity` is stored in it; `difference` returns as text how the identity that is found there differs from it,
    /// and `None` if both are equal. Fails if the folder belongs to another study or cannot be written.
    pub fn open<I: Serialize + DeserializeOwned>(
        path: &Path,
        pieces: &str,
        identity: &I,
        difference: impl Fn(&I) -> Option<String>,
    ) -> Result<Folder> {
        let refuse = |why: String| BadInput(format!("--out: '{}': {why}; choose another folder", path.display()));
        check_folder(path).map_err(refuse)?;
        // Processes may open one folder at a time, so that other files count only if they were there before the
        // identity was looked for, and nothing else is made before the identity is in its place.
        let holds_others = path.join(pieces).exists() || path.join("report.html").exists();
        if !path.join(IDENTITY).exists() {
            if holds_others {
                return Err(refuse(format!("it holds files of something else and no '{IDENTITY}'")).into());
            }
            std::fs::create_dir_all(path).map_err(|e| refuse(format!("cannot make this folder: {e}")))?;
            identify(path, identity).map_err(|e| refuse(format!("cannot write '{IDENTITY}': {e}")))?;
        }
        let text =
            output::read_own(&path.join(IDENTITY)).map_err(|e| refuse(format!("cannot read '{IDENTITY}': {e}")))?;
        let theirs: I = serde_json::from_str(&text).map_err(|e| {
            refuse(format!("its '{IDENTITY}' is of another study, program or version ({})", config::json(&e)))
        })?;
        if let Some(how) = difference(&theirs) {
            return Err(refuse(format!("it is of another study: {how}")).into());
        }
        for folder in [path, &path.join(pieces), &path.join("figures")] {
            std::fs::create_dir_all(folder).map_err(|e| refuse(format!("cannot make this folder: {e}")))?;
            temporary::file_in(folder, 0o600).map_err(|e| refuse(format!("cannot write there: {e}")))?;
        }
        Ok(Folder(path.to_owned()))
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Returns the path of the report, `report.html`.
    pub fn page(&self) -> PathBuf {
        self.0.join("report.html")
    }

    /// Reads the results of a finished job from the file `name` of the folder; `None` if the file is missing or
    /// damaged.
    pub fn kept<R: DeserializeOwned>(&self, name: &str) -> Option<R> {
        serde_json::from_str(&output::read_own(&self.0.join(name)).ok()?).ok()
    }

    /// Writes the results of a finished job to the file `name` of the folder, atomically, so that an interruption loses
    /// only unfinished jobs.
    pub fn keep(&self, name: &str, record: &impl Serialize) -> Result<()> {
        self.write(name, serde_json::to_string(record).context("a record is JSON")?.as_bytes())
    }

    /// Writes the figures of the report, and then its HTML page, which shows them.
    pub fn write_page(&self, figures: &[Figure], page: &str) -> Result<()> {
        for figure in figures {
            self.write(&format!("figures/{}.svg", figure.name), figure.svg.as_bytes())?;
            #[cfg(feature = "png")]
            self.write(&format!("figures/{}.png", figure.name), &murmurate_report::figures::png::render(&figure.svg)?)?;
        }
        self.write("report.html", page.as_bytes())
    }

    /// Writes a value to the file `name` of the folder as indented JSON.
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<()> {
        let text = serde_json::to_string_pretty(value).context("plain data is JSON")? + "\n";
        self.write(name, text.as_bytes())
    }

    /// Writes rows to the file `name` of the folder as CSV with a header.
    pub fn write_csv(&self, name: &str, rows: impl IntoIterator<Item = impl Serialize>) -> Result<()> {
        let mut csv = csv::Writer::from_writer(Vec::new());
        for row in rows {
            csv.serialize(row).context("a row is plain data")?;
        }
        self.write(name, &csv.into_inner().context("memory takes everything")?)
    }

    /// Writes bytes to the file `name` of the folder, replacing it atomically.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.0.join(name);
        let wrong = || format!("cannot write '{}'; what was finished before is kept", path.display());
        let mut file = WholeFile::create(&path)?;
        file.writer().write_all(bytes).with_context(wrong)?;
        file.keep().with_context(wrong)
    }
}

/// Writes the identity of a study to its folder, whole or not at all, unless another process did so meanwhile.
fn identify(folder: &Path, identity: &impl Serialize) -> std::io::Result<()> {
    let mut file = temporary::file_in(folder, 0o666)?;
    file.as_file_mut().write_all((serde_json::to_string_pretty(identity)? + "\n").as_bytes())?;
    file.as_file().sync_all()?;
    match file.persist_noclobber(folder.join(IDENTITY)) {
        Err(failed) if failed.error.kind() != std::io::ErrorKind::AlreadyExists => Err(failed.error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Barrier;

    #[test]
    fn processes_that_open_one_folder_at_a_time_share_it_and_another_study_is_refused() {
        let other = |theirs: &u32| (*theirs != 7).then(|| "another number".to_owned());
        for _ in 0..50 {
            let folder = tempfile::TempDir::new().unwrap();
            let (path, start) = (folder.path().join("out"), Barrier::new(4));
            std::thread::scope(|scope| {
                let opened = [(); 4].map(|()| {
                    scope.spawn(|| {
                        start.wait();
                        Folder::open(&path, "pieces", &7, other).map(drop)
                    })
                });
                for opened in opened {
                    opened.join().unwrap().unwrap();
                }
            });
            std::fs::write(path.join(IDENTITY), "8").unwrap();
            assert!(Folder::open(&path, "pieces", &7, other).is_err());
            std::fs::remove_file(path.join(IDENTITY)).unwrap();
            assert!(Folder::open(&path, "pieces", &7, other).is_err());
        }
    }
}
