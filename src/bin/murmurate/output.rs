//! Writing: data to stdout, talk to stderr, files whole or not at all.

use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use tempfile::NamedTempFile;

use crate::BadInput;

/// Says something to the person, on stderr.
pub fn talk(text: &str) {
    // Nobody is there to be told that stderr is closed.
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Prints data, on stdout. A reader that has closed the pipe has seen enough.
pub fn print(text: &str) -> Result<()> {
    match writeln!(std::io::stdout(), "{text}") {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write to stdout"),
    }
}

/// A file that replaces the one of its name only once it is whole.
pub struct WholeFile {
    path: PathBuf,
    file: NamedTempFile,
}

impl WholeFile {
    /// Opens a place for it, so that a wrong path is known before any work is done.
    pub fn create(path: &Path) -> Result<WholeFile> {
        let folder = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        if path.is_dir() {
            return Err(
                BadInput(format!("cannot write '{}': it is a folder; name a file in it", path.display())).into()
            );
        }
        let file = NamedTempFile::new_in(folder).map_err(|e| {
            BadInput(format!("cannot write '{}': {e}; choose a folder that can be written", path.display()))
        })?;
        Ok(WholeFile { path: path.to_owned(), file })
    }

    /// Where to write.
    pub fn writer(&mut self) -> &mut impl Write {
        &mut self.file
    }

    /// Puts the whole file in its place.
    pub fn keep(self) -> Result<()> {
        let WholeFile { path, file } = self;
        file.as_file().sync_all().with_context(|| format!("cannot write '{}'", path.display()))?;
        file.persist(&path).with_context(|| format!("cannot write '{}'", path.display()))?;
        Ok(())
    }
}

/// Reads a text file that the user has named.
pub fn read_text(path: &Path, what: &str) -> Result<String> {
    std::fs::read_to_string(path)
        .map_err(|e| BadInput(format!("cannot read the {what} '{}': {e}", path.display())).into())
}
