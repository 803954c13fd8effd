//! Data to stdout, talk to stderr; and the files that a user has named, read.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::path::Path;
use std::sync::OnceLock;
use std::time::Duration;

use crate::config::{is_key, redacted};
use anyhow::{Context, Result};

use crate::program::BadInput;
use crate::program::background_writer::{BackgroundWriter, Target};

/// How long the end of a process waits for what is still to be written to a pipe or a disk.
pub const FAREWELL: Duration = Duration::from_millis(500);

/// The background writer to stderr, in commands that must not wait for it.
static LOG: OnceLock<BackgroundWriter> = OnceLock::new();

/// Has everything for stderr written by a thread of its own from now on, the message of a panic included.
pub fn open_log_lane() -> io::Result<()> {
    let writer = BackgroundWriter::open(Target::copy_of(io::stderr())?, Some(missing))?;
    if LOG.set(writer).is_ok() {
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
    LOG.get().map_or(0, BackgroundWriter::dropped)
}

/// Waits a little for the last lines to reach stderr.
pub fn flush_log() {
    if let Some(writer) = LOG.get() {
        writer.flush(FAREWELL);
    }
}

/// Says something to the person, on stderr.
pub fn talk(text: &str) {
    say(redacted(text).into_owned() + "\n");
}

fn say(lines: String) {
    match LOG.get() {
        Some(writer) => {
            writer.push(lines.into_bytes());
            // What follows a panic is the end of the process.
            if std::thread::panicking() {
                writer.flush(FAREWELL);
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
