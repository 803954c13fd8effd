//! Writing: data to stdout, talk to stderr, files whole or not at all.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use crate::config::{is_key, redacted};
use anyhow::{Context, Result};
use tempfile::NamedTempFile;

use crate::program::BadInput;
use crate::program::lane::{Lane, Target};

/// How long the end of a process waits for what is still to be written to a pipe or a disk.
pub const FAREWELL: Duration = Duration::from_millis(500);

/// The lane to stderr, in commands that must not wait for it.
static LOG: OnceLock<Lane> = OnceLock::new();

/// Has everything for stderr written by a thread of its own from now on, the message of a panic included.
pub fn open_log_lane() -> io::Result<()> {
    let lane = Lane::open(Target::copy_of(io::stderr())?, Some(missing))?;
    if LOG.set(lane).is_ok() {
        std::panic::set_hook(Box::new(|panic| {
            let trace = Backtrace::capture();
            let traced = trace.status() == BacktraceStatus::Captured;
            talk(&if traced { format!("{panic}\n{trace}") } else { panic.to_string() });
        }));
    }
    Ok(())
}

fn missing(lines: u64) -> String {
    format!("warning: {lines} log lines were dropped here: nobody read them in time\n")
}

/// Log lines that were dropped so far.
pub fn log_lines_dropped() -> u64 {
    LOG.get().map_or(0, Lane::dropped)
}

/// Waits a little for the last lines to reach stderr.
pub fn flush_log() {
    if let Some(lane) = LOG.get() {
        lane.flush(FAREWELL);
    }
}

/// Says something to the person, on stderr.
pub fn talk(text: &str) {
    say(redacted(text).into_owned() + "\n");
}

fn say(lines: String) {
    match LOG.get() {
        Some(lane) => {
            lane.push(lines.into_bytes());
            // What follows a panic is the end of the process.
            if std::thread::panicking() {
                lane.flush(FAREWELL);
            }
        }
        // Nobody is there to be told that stderr is closed.
        None => drop(io::stderr().write_all(lines.as_bytes())),
    }
}

/// Where log lines go, one at each write: to stderr, without anything that could be a key.
pub struct LogLines;

impl Write for LogLines {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        say(redacted(&String::from_utf8_lossy(line)).into_owned());
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Whether stderr may have colours: only on a terminal, and never against the person's will (<https://no-color.org>).
pub fn colour() -> bool {
    io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Prints data, on stdout. A reader that has closed the pipe has seen enough.
pub fn print(text: &str) -> Result<()> {
    match writeln!(io::stdout(), "{text}") {
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

/// Reads a text file that the user has named; a key, which would be named by mistake, is refused as what it is.
pub fn read_text(path: &Path, what: &str) -> Result<String> {
    let refuse = |why: String| BadInput(format!("cannot read the {what} '{}': {why}", path.display()));
    let bytes = read_bytes(path, what)?;
    String::from_utf8(bytes).map_err(|_| refuse("it is no text in UTF-8".to_owned()).into())
}

/// Reads a file that the user has named, likewise.
pub fn read_bytes(path: &Path, what: &str) -> Result<Vec<u8>> {
    let bytes =
        std::fs::read(path).map_err(|e| BadInput(format!("cannot read the {what} '{}': {e}", path.display())))?;
    if is_key(&bytes) {
        let name = what.split(" (").next().unwrap_or(what);
        return Err(BadInput(format!("'{}' is a key file, no {name}", path.display())).into());
    }
    Ok(bytes)
}
