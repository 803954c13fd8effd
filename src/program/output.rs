//! Output to stdout and stderr, and reading of files that the user names.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::path::Path;
use std::sync::OnceLock;
use std::time::Duration;

use crate::config::{is_key, redacted};
use anyhow::{Context, Result};

use crate::program::BadInput;
use crate::program::background_writer::{BackgroundWriter, Target};

/// Longest time that this program waits at its end for an output to be written.
pub const FLUSH_TIMEOUT: Duration = Duration::from_millis(500);

/// Background writer to stderr, for commands that must not wait for it.
static LOG: OnceLock<BackgroundWriter> = OnceLock::new();

/// Makes this program write to stderr through a background writer from now on, so that it never waits for a terminal or
/// a pipe. Messages of panics go there, too.
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
    format!("warning: {lines} log lines were dropped here: they were not read in time\n")
}

/// Returns the number of log lines that were dropped so far, because stderr did not take them in time.
pub fn log_lines_dropped() -> u64 {
    LOG.get().map_or(0, BackgroundWriter::dropped)
}

/// Waits until queued lines are written to stderr, at most half a second.
pub fn flush_log() {
    if let Some(writer) = LOG.get() {
        writer.flush(FLUSH_TIMEOUT);
    }
}

/// Prints a message on stderr as one line. A team key in it is replaced.
pub fn talk(text: &str) {
    say(redacted(text).into_owned() + "\n");
}

fn say(lines: String) {
    match LOG.get() {
        Some(writer) => {
            writer.push(lines.into_bytes());
            // After a panic the process ends, so the message must be written now.
            if std::thread::panicking() {
                writer.flush(FLUSH_TIMEOUT);
            }
        }
        // An error of stderr cannot be reported anywhere.
        None => drop(io::stderr().write_all(lines.as_bytes())),
    }
}

/// Writer that prints log lines on stderr, one per write. A team key in a line is replaced.
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

/// Returns true if text on stderr may have colours: stderr is a terminal, and the environment variable `NO_COLOR` is
/// not set (<https://no-color.org>).
pub fn colour() -> bool {
    io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Prints a text and a line end on stdout. A pipe that its reader closed is no error.
pub fn print(text: &str) -> Result<()> {
    match writeln!(io::stdout(), "{text}") {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write to stdout"),
    }
}

/// Reads a text file that the user has named. `what` is the noun for the file in errors. A file that contains a team
/// key is refused.
pub fn read_text(path: &Path, what: &str) -> Result<String> {
    let refuse = |why: String| BadInput(format!("cannot read the {what} '{}': {why}", path.display()));
    let bytes = read_bytes(path, what)?;
    String::from_utf8(bytes).map_err(|_| refuse("it is no text in UTF-8".to_owned()).into())
}

/// Reads a file that the user has named. `what` is the noun for the file in errors. A file that contains a team key is
/// refused.
pub fn read_bytes(path: &Path, what: &str) -> Result<Vec<u8>> {
    let bytes =
        std::fs::read(path).map_err(|e| BadInput(format!("cannot read the {what} '{}': {e}", path.display())))?;
    if is_key(&bytes) {
        let name = what.split(" (").next().unwrap_or(what);
        return Err(BadInput(format!("'{}' is a key file, no {name}", path.display())).into());
    }
    Ok(bytes)
}
