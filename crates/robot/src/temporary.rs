//! Temporary files with a random name, which get their final name once they are complete.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// Largest number of random file names to try.
const DRAWS: usize = 16;

/// Temporary file with a random name. It is removed at the end, unless it got its final name.
pub struct Temporary {
    path: PathBuf,
    file: File,
    /// Whether the file was renamed to its final name, so that it is not removed on drop.
    done: bool,
}

impl Temporary {
    /// Creates an empty file in the folder `folder`. `mode` are its permissions, which the umask may reduce.
    pub fn new_in(folder: &Path, mode: u32) -> io::Result<Temporary> {
        let mut taken = None;
        for _ in 0..DRAWS {
            let mut number = [0; 8];
            getrandom::fill(&mut number).map_err(io::Error::other)?;
            let path = folder.join(format!(".murmurate-{:016x}.tmp", u64::from_le_bytes(number)));
            match OpenOptions::new().read(true).write(true).create_new(true).mode(mode).open(&path) {
                Ok(file) => return Ok(Temporary { path, file, done: false }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => taken = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(taken.expect("names were drawn"))
    }

    /// Returns the path of the temporary file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the open file, for a writer that moves its position.
    #[cfg(feature = "record")]
    pub fn seekable(&mut self) -> &mut File {
        &mut self.file
    }

    /// Writes the file's content to the disk (fsync).
    pub fn sync(&self) -> io::Result<()> {
        self.file.sync_all()
    }

    /// Renames the temporary file to `path` in the same folder, replacing an existing file.
    pub fn replace(mut self, path: &Path) -> io::Result<()> {
        fs::rename(&self.path, path)?;
        self.done = true;
        Ok(())
    }

    /// Renames the temporary file to `path` in the same folder, replacing an existing file, and returns it open, for
    /// output that is to be seen while it is written.
    pub fn named(self, path: &Path) -> io::Result<File> {
        let open = self.file.try_clone()?;
        self.replace(path)?;
        Ok(open)
    }

    /// Gives the temporary file the name `path` in the same folder. Fails with `AlreadyExists` if there is such a file.
    pub fn place(self, path: &Path) -> io::Result<()> {
        // Unlike a rename, a hard link fails if the name exists.
        fs::hard_link(&self.path, path)
    }
}

impl Write for Temporary {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if !self.done {
            // An error is ignored, since nothing depends on the removal.
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_gets_its_name_once_complete_and_is_removed_otherwise() {
        let folder = tempfile::TempDir::new().unwrap();
        let names = || {
            let entries = fs::read_dir(folder.path()).unwrap();
            let mut names: Vec<String> =
                entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
            names.sort();
            names
        };
        let path = folder.path().join("whole");
        let written = |text: &str| {
            let mut file = Temporary::new_in(folder.path(), 0o600).unwrap();
            file.write_all(text.as_bytes()).and_then(|()| file.sync()).unwrap();
            file
        };
        drop(written("dropped"));
        assert_eq!(names(), Vec::<String>::new());
        written("first").place(&path).unwrap();
        assert_eq!(written("second").place(&path).unwrap_err().kind(), ErrorKind::AlreadyExists);
        assert_eq!(fs::read_to_string(&path).unwrap(), "first");
        written("third").replace(&path).unwrap();
        assert_eq!((fs::read_to_string(&path).unwrap(), names()), ("third".to_owned(), vec!["whole".to_owned()]));
    }
}
