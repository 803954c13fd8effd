//! Files that are written whole or not at all.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::program::BadInput;
use crate::program::temporary::Temporary;

/// A file that replaces the one of its name only once it is whole. What is no regular file (a pipe, a device) is
/// written to as it is.
pub enum WholeFile {
    /// Beside its place, until it is kept.
    Beside {
        /// Its place, links resolved.
        path: PathBuf,
        /// What is written.
        file: Temporary,
    },
    /// Straight into what is there.
    Straight(File),
}

impl WholeFile {
    /// Opens a place for it, so that a wrong path is known before any work is done.
    pub fn create(path: &Path) -> Result<WholeFile> {
        let refuse = |why: String| BadInput(format!("cannot write '{}': {why}", path.display()));
        let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if path.is_dir() {
            return Err(refuse("it is a folder; name a file in it".to_owned()).into());
        }
        if path.exists() && !path.is_file() {
            let file = OpenOptions::new().write(true).open(&path).map_err(|e| refuse(e.to_string()))?;
            return Ok(WholeFile::Straight(file));
        }
        let folder = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let file = Temporary::new_in(folder, 0o666)
            .map_err(|e| refuse(format!("{e}; choose a folder that can be written")))?;
        Ok(WholeFile::Beside { path, file })
    }

    /// Where to write.
    pub fn writer(&mut self) -> &mut dyn Write {
        match self {
            WholeFile::Beside { file, .. } => file,
            WholeFile::Straight(file) => file,
        }
    }

    /// Puts the whole file in its place.
    pub fn keep(self) -> Result<()> {
        if let WholeFile::Beside { path, file } = self {
            file.sync()
                .and_then(|()| file.replace(&path))
                .with_context(|| format!("cannot write '{}'", path.display()))?;
        }
        Ok(())
    }
}
