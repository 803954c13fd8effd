//! Writes files that appear under their name only once they are complete.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use tempfile::NamedTempFile;

use crate::BadInput;
use crate::destination::{Destination, folder};
use crate::output::talk;
use crate::temporary;

/// File that is being written, and replaces an existing file atomically once it is complete. A pipe or a device is
/// written to directly.
pub enum WholeFile {
    /// Temporary file in the same folder, which gets the final name once it is complete.
    Beside {
        /// Final path of the file, after the links that may be followed.
        path: PathBuf,
        /// Temporary file with the content so far.
        file: NamedTempFile,
    },
    /// Open pipe or device.
    Straight(File),
}

impl WholeFile {
    /// Opens the file `path` for writing, so that a wrong path is an error before any work is done. An existing file is
    /// not changed yet.
    pub fn create(path: &Path) -> Result<WholeFile> {
        let refuse = |why: String| BadInput(format!("cannot write '{}': {why}", path.display()));
        let path = match Destination::of(path).map_err(refuse)? {
            Destination::File(path, note) => {
                note.iter().for_each(|note| talk(&format!("note: {note}")));
                path
            }
            Destination::Stream(path) => {
                let file = Destination::open_stream(&path, 0).map_err(|e| refuse(e.to_string()))?;
                return Ok(WholeFile::Straight(file));
            }
        };
        let file = temporary::file_in(folder(&path), 0o666)
            .map_err(|e| refuse(format!("{e}; choose a folder that can be written")))?;
        Ok(WholeFile::Beside { path, file })
    }

    /// Returns the writer for the content of the file.
    pub fn writer(&mut self) -> &mut dyn Write {
        match self {
            WholeFile::Beside { file, .. } => file.as_file_mut(),
            WholeFile::Straight(file) => file,
        }
    }

    /// Completes the file: syncs its content to the disk and gives it its final name. Without this call, an existing
    /// file stays as it was.
    pub fn keep(self) -> Result<()> {
        if let WholeFile::Beside { path, file } = self {
            file.as_file()
                .sync_all()
                .and_then(|()| file.persist(&path).map_err(|failed| failed.error))
                .with_context(|| format!("cannot write '{}'", path.display()))?;
        }
        Ok(())
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer().flush()
    }
}
