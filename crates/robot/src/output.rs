//! Output to stdout and stderr, and reading of files that the user names.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::cell::RefCell;
use std::fmt;
use std::io::{self, BufRead, ErrorKind, IsTerminal, Write};
use std::path::Path;
use std::path::{Component, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::{Context, Result};
use murmurate::config::shown::{Layout, printable};
use murmurate::config::{is_key, redacted, regular};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::{FormatTime, SystemTime};

use crate::BadInput;
use crate::background_writer::{BackgroundWriter, Target};

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
            talk_lines(&if traced { format!("{panic}\n{trace}") } else { panic.to_string() });
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

/// Prints a message on stderr as one line. A team key in it is replaced, and control characters are escaped: parts of
/// the message may come from outside.
pub fn talk(text: &str) {
    write_stderr(printable(&redacted(text), Layout::Line).into_owned() + "\n");
}

/// Asks a question on the terminal, on stderr. Returns true if the answer is yes. The caller has checked that stdin is
/// a terminal.
pub fn confirmed(question: &str) -> io::Result<bool> {
    talk(&format!("{question} [y/N]"));
    let mut answer = String::new();
    io::stdin().lock().read_line(&mut answer)?;
    Ok(matches!(answer.trim(), "y" | "Y" | "yes"))
}

/// Prints text of several lines on stderr, in which only the line ends are this program's own. Otherwise like [`talk`].
pub fn talk_lines(text: &str) {
    write_stderr(printable(&redacted(text), Layout::Lines).into_owned() + "\n");
}

fn write_stderr(lines: String) {
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

/// Time of a record to which the lines belong that are logged now \[ns\]; `u64::MAX` while nothing is replayed.
static RECORDED_AT: AtomicU64 = AtomicU64::new(u64::MAX);

/// Marks the lines that are logged from now on as of a record, at the time `at` of its run; `None` ends that.
pub fn stamp_as_recorded(at: Option<murmurate::time::Time>) {
    RECORDED_AT.store(at.map_or(u64::MAX, murmurate::time::Time::as_nanos), Ordering::Relaxed);
}

/// Stamp at the beginning of a log line: the wall clock, or while a record is replayed the time of its run, so that old
/// lines are not taken for those of today.
pub struct Stamp;

impl FormatTime for Stamp {
    fn format_time(&self, w: &mut Writer<'_>) -> fmt::Result {
        match RECORDED_AT.load(Ordering::Relaxed) {
            u64::MAX => SystemTime.format_time(w),
            at => write!(w, "of the record, at {:.3} s:", at as f64 / 1e9),
        }
    }
}

/// Writer that prints log lines on stderr, one per write. A team key in a line is replaced, and control characters are
/// escaped, but for the logger's own colours.
pub struct LogLines;

impl Write for LogLines {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        write_stderr(log_line(&String::from_utf8_lossy(line)));
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns a line of the log as it is printed. What is logged has no escape character left: the logger escapes those,
/// so what remains are its colours. Other control characters, such as line ends within the line, are escaped here.
fn log_line(line: &str) -> String {
    let redacted = redacted(line);
    let mut parts = redacted.strip_suffix('\n').unwrap_or(&redacted).split('\x1b');
    let mut shown = printable(parts.next().unwrap_or_default(), Layout::Line).into_owned();
    for part in parts {
        let sequence = part.strip_prefix('[').and_then(|rest| rest.split_once('m'));
        let is_colour = sequence.is_some_and(|(codes, _)| codes.chars().all(|c| c.is_ascii_digit() || c == ';'));
        shown += if is_colour { "\x1b" } else { "\\u001b" };
        shown += &printable(part, Layout::Line);
    }
    shown + "\n"
}

/// Returns true if text on stderr may have colours: stderr is a terminal, and the environment variable `NO_COLOR` is
/// not set (<https://no-color.org>).
pub fn colour() -> bool {
    io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Prints a text and a line end on stdout. Control characters are escaped, but for tabs and line ends: parts of the
/// text may come from outside, and their own line ends are escaped where they are put into it (`config::shown`). A pipe
/// that its reader closed is no error.
pub fn print(text: &str) -> Result<()> {
    match writeln!(io::stdout(), "{}", printable(text, Layout::Lines)) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write to stdout"),
    }
}

/// Largest file that is read whole \[bytes\]: policies, team files, faults, conditions, tokens. The largest policies
/// have a tenth of it.
const MAX_FILE: u64 = 1 << 26;

/// Largest checkpoint of a training that is read \[bytes\].
pub const MAX_CHECKPOINT: u64 = 1 << 30;

/// Reads a text file that this program has written itself, in a folder that the user has named.
pub fn read_own(path: &Path) -> io::Result<String> {
    let bytes = regular::read(path, MAX_FILE)?;
    String::from_utf8(bytes).map_err(|_| io::Error::new(ErrorKind::InvalidData, "it is no text in UTF-8"))
}

thread_local! {
    /// While a record is replayed: the files and folders that may be read; `None` if all may.
    static CONFINED: RefCell<Option<Vec<PathBuf>>> = const { RefCell::new(None) };
}

/// Limit of what this thread reads, as long as it lives: for work on a record that somebody else may have made, which
/// must open no other file by naming it.
pub struct Confined(());

impl Confined {
    /// Lets this thread read the files and folders `allowed` and nothing else of what is named to it.
    pub fn to(allowed: Vec<PathBuf>) -> Confined {
        CONFINED.set(Some(allowed));
        Confined(())
    }
}

impl Drop for Confined {
    fn drop(&mut self) {
        CONFINED.set(None);
    }
}

/// Fails if this thread may not read the file `path`, because a record has named it.
fn check_confined(path: &Path) -> Result<(), String> {
    let climbs = path.components().any(|part| part == Component::ParentDir);
    let inside = |allowed: &PathBuf| path == allowed || (path.starts_with(allowed) && !climbs);
    CONFINED.with_borrow(|all| match all {
        Some(all) if !all.iter().any(inside) => {
            Err("a record names it and does not have it; a replay opens the files in the record alone".to_owned())
        }
        _ => Ok(()),
    })
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
    let read = check_confined(path).and_then(|()| regular::read(path, MAX_FILE).map_err(|error| error.to_string()));
    let bytes = read.map_err(|why| BadInput(format!("cannot read the {what} '{}': {why}", path.display())))?;
    if is_key(&bytes) {
        let name = what.split(" (").next().unwrap_or(what);
        return Err(BadInput(format!("'{}' is a key file, no {name}", path.display())).into());
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_line_keeps_the_logger_s_colours_and_nothing_else_that_a_terminal_obeys() {
        let plain = " WARN driver 2: \"moved\"\n";
        assert_eq!(log_line(plain), plain);
        let coloured = "\x1b[33m WARN\x1b[0m \x1b[1;2mdriver\x1b[0m moved\n";
        assert_eq!(log_line(coloured), coloured);
        assert_eq!(
            log_line("a\nERROR forged\r\x1b[2J\x1b]0;title\x07\u{202e}\n"),
            "a\\nERROR forged\\r\\u001b[2J\\u001b]0;title\\u0007\\u202e\n"
        );
    }

    #[test]
    fn lines_of_a_replay_have_the_time_of_the_record_and_not_that_of_today() {
        let stamp = || {
            let mut text = String::new();
            Stamp.format_time(&mut Writer::new(&mut text)).unwrap();
            text
        };
        stamp_as_recorded(Some(murmurate::time::Time::from_nanos(1_500_000_000)));
        assert_eq!(stamp(), "of the record, at 1.500 s:");
        stamp_as_recorded(None);
        assert!(stamp().starts_with("20") && stamp().contains('T'), "{}", stamp());
    }
}
