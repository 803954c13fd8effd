//! The folder of a training: every file in it is replaced whole or not at all, so the last good one is always there.

use std::path::{Path, PathBuf};

use crate::train::config::Config;
use crate::train::trainer::Trainer;
use anyhow::{Context, Result};

use super::curve::Curve;
use crate::program::BadInput;
use crate::program::temporary::Temporary;
use crate::program::whole_file::WholeFile;

/// A folder that a training writes to.
pub struct Folder {
    path: PathBuf,
    /// The iteration of the last checkpoint that is whole.
    kept: Option<u64>,
}

impl Folder {
    /// Makes the folder if need be, and finds out whether it can be written. One that holds a training is only
    /// opened to resume it.
    pub fn open(path: &Path, resume: bool) -> Result<Folder> {
        let refuse = |why: String| BadInput(format!("--out: '{}': {why}", path.display()));
        std::fs::create_dir_all(path).map_err(|e| refuse(format!("cannot make this folder: {e}")))?;
        let folder = Folder { path: path.to_owned(), kept: None };
        if !resume && folder.checkpoint().exists() {
            let why = "it holds a training already; add --resume to go on with it, or choose another folder";
            return Err(refuse(why.to_owned()).into());
        }
        Temporary::new_in(path, 0o600)
            .map_err(|e| refuse(format!("cannot write there: {e}; choose a folder that can be written")))?;
        Ok(folder)
    }

    /// The policy's file.
    pub fn policy(&self) -> PathBuf {
        self.path.join("policy.safetensors")
    }

    /// The checkpoint's file.
    pub fn checkpoint(&self) -> PathBuf {
        self.path.join("checkpoint.bin")
    }

    /// Writes the configuration, to be looked at and to start others from.
    pub fn write_config(&self, config: &Config) -> Result<()> {
        let text = toml::to_string(config).context("a configuration is TOML")?;
        self.write("config.toml", text.as_bytes())
    }

    /// The curve until an iteration, as it was saved.
    pub fn curve(&mut self, iterations: u64) -> Result<Curve> {
        self.kept = Some(iterations);
        let path = self.path.join("curve.csv");
        let wrong = |e: String| BadInput(format!("cannot read the curve '{}': {e}", path.display()));
        let text = std::fs::read_to_string(&path).map_err(|e| wrong(e.to_string()))?;
        Ok(Curve::from_csv(&text, iterations).map_err(|e| wrong(e.to_string()))?)
    }

    /// Saves everything. The checkpoint goes last: what it is of is then there.
    pub fn save(&mut self, trainer: &Trainer, curve: &Curve) -> Result<()> {
        let files = || -> Result<()> {
            self.write("policy.safetensors", &trainer.policy_file())?;
            self.write("curve.csv", curve.to_csv()?.as_bytes())?;
            self.write("curve.svg", curve.plot(&trainer.plan().scenario)?.as_bytes())?;
            self.write("checkpoint.bin", &trainer.checkpoint())
        };
        files().with_context(|| self.what_is_kept())?;
        self.kept = Some(trainer.iterations());
        Ok(())
    }

    /// Says which checkpoint a failure leaves.
    pub fn what_is_kept(&self) -> String {
        match self.kept {
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
