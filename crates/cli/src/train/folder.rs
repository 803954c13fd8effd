//! Output folder of a training. Each file in it is replaced atomically, so that a complete version always exists.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use serde::Serialize;

use anyhow::{Context, Result};
use murmurate_robot::destination::check_folder;
use murmurate_robot::temporary;
use murmurate_robot::whole_file::WholeFile;
use murmurate_robot::{BadInput, output};

/// Name of the file of the policy that all robots share.
pub const POLICY: &str = "policy.safetensors";
/// Name of the file that names the policies of roles, as `sim --roles` takes it.
pub const ROLES: &str = "roles.toml";

/// Output folder of a training, with its policies, checkpoint, learning curve and configuration.
pub struct Folder {
    path: PathBuf,
    /// Iteration of the last complete checkpoint; `None` if there is none.
    saved: Option<u64>,
}

impl Folder {
    /// Opens or creates the output folder of a training, and checks that it is writable. Fails if it contains a
    /// training and `resume` is false.
    pub fn open(path: &Path, resume: bool) -> Result<Folder> {
        let refuse = |why: String| BadInput(format!("--out: '{}': {why}", path.display()));
        check_folder(path).map_err(refuse)?;
        std::fs::create_dir_all(path).map_err(|e| refuse(format!("cannot make this folder: {e}")))?;
        let folder = Folder { path: path.to_owned(), saved: None };
        if !resume && folder.checkpoint().exists() {
            let why = "it holds a training already; add --resume to continue it, or choose another folder";
            return Err(refuse(why.to_owned()).into());
        }
        temporary::file_in(path, 0o600)
            .map_err(|e| refuse(format!("cannot write there: {e}; choose a writable folder")))?;
        Ok(folder)
    }

    /// Returns the path of a file in the folder, such as of the policy.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Returns the path of the checkpoint in the folder.
    pub fn checkpoint(&self) -> PathBuf {
        self.path.join("checkpoint.bin")
    }

    /// Writes the configuration of the training as `config.toml`, from which other trainings can start.
    pub fn write_config(&self, config: &impl Serialize) -> Result<()> {
        let text = toml::to_string(config).context("a configuration is TOML")?;
        self.write("config.toml", text.as_bytes())
    }

    /// Reads the learning curve in the folder up to `iterations`, the iteration of the checkpoint, by `read`.
    pub fn curve<C, E: Display>(&mut self, iterations: u64, read: impl FnOnce(&str, u64) -> Result<C, E>) -> Result<C> {
        self.saved = Some(iterations);
        let path = self.path.join("curve.csv");
        let wrong = |e: String| BadInput(format!("cannot read the curve '{}': {e}", path.display()));
        let text = output::read_own(&path).map_err(|e| wrong(e.to_string()))?;
        Ok(read(&text, iterations).map_err(|e| wrong(e.to_string()))?)
    }

    /// Saves the policies with their names, the learning curve (CSV and SVG) and the checkpoint of this iteration. The
    /// checkpoint is written last, so that the other files are never older.
    pub fn save(
        &mut self,
        iteration: u64,
        (policies, csv, svg): (Vec<(String, Vec<u8>)>, String, String),
        checkpoint: &[u8],
    ) -> Result<()> {
        let files = || -> Result<()> {
            policies.iter().try_for_each(|(name, bytes)| self.write(name, bytes))?;
            self.write("curve.csv", csv.as_bytes())?;
            self.write("curve.svg", svg.as_bytes())?;
            self.write("checkpoint.bin", checkpoint)
        };
        files().with_context(|| self.last_saved())?;
        self.saved = Some(iteration);
        Ok(())
    }

    /// Returns a text for error messages that says which checkpoint was saved last.
    pub fn last_saved(&self) -> String {
        match self.saved {
            Some(iteration) => format!("the checkpoint of iteration {iteration} in '{}' is kept", self.path.display()),
            None => "nothing had been saved yet".to_owned(),
        }
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.path.join(name);
        let mut file = WholeFile::create(&path)?;
        file.writer().write_all(bytes).with_context(|| format!("cannot write '{}'", path.display()))?;
        file.keep()
    }
}
