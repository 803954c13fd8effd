//! Writing: data to stdout, talk to stderr, files whole or not at all.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use tempfile::NamedTempFile;

use crate::BadInput;

/// Says something to the person, on stderr.
pub fn talk(text: &str) {
    // Nobody is there to be told that stderr is closed.
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Whether stderr may have colours: only on a terminal, and never against the person's will (<https://no-color.org>).
pub fn colour() -> bool {
    std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Prints data, on stdout. A reader that has closed the pipe has seen enough.
pub fn print(text: &str) -> Result<()> {
    match writeln!(std::io::stdout(), "{text}") {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write to stdout"),
    }
}

/// A file that replaces the one of its name only once it is whole. What is no regular file (a pipe, a device) is
/// written to as it is.
pub enum WholeFile {
    /// Beside its place, until it is kept.
    Beside {
        /// Its place, links resolved.
        path: PathBuf,
        /// What is written.
        file: NamedTempFile,
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
        let mut builder = tempfile::Builder::new();
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // As any file that is made: the user's mask takes its part away.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let file =
            builder.tempfile_in(folder).map_err(|e| refuse(format!("{e}; choose a folder that can be written")))?;
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
            file.as_file().sync_all().with_context(|| format!("cannot write '{}'", path.display()))?;
            file.persist(&path).with_context(|| format!("cannot write '{}'", path.display()))?;
        }
        Ok(())
    }
}

/// Reads a text file that the user has named.
pub fn read_text(path: &Path, what: &str) -> Result<String> {
    std::fs::read_to_string(path)
        .map_err(|e| BadInput(format!("cannot read the {what} '{}': {e}", path.display())).into())
}
