//! The process of a policy in Python, as a child of this one: its start, its socket, and what it prints.

use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::os::fd::AsFd;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::process::{ChildStderr, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

use murmurate::edge::{Group, Pipes};
use nix::poll::{PollFd, PollFlags, poll};
use tempfile::TempDir;

/// Longest time for the start of a process, in which it imports what it needs.
pub const START: Duration = Duration::from_secs(60);
/// Time between two looks at whether a process that starts has ended \[ms\].
const LOOK_MS: u8 = 50;
/// Longest wait for another line of a process that has ended.
const LAST_LINE: Duration = Duration::from_millis(500);
/// Longest line of the process's output that is shown \[bytes\].
const MAX_LINE: u64 = 4096;
/// Number of lines that a process may print before it is connected, of which the last one is shown if it ends.
const KEPT_LINES: usize = 1000;
/// Variable that names the interpreter.
const INTERPRETER: &str = "PYTHON_OF_MURMURATE";

/// Process of a policy, with all that it has started.
pub struct Child {
    /// The process and what it has forked; ended when this is dropped.
    pub group: Group,
    /// Its input, upon the end of which it ends, also in the middle of a step.
    _input: Option<ChildStdin>,
}

/// Starts the process of the class `class`, `module:Class`, whose module is in `folder` or installed, with at most
/// `memory_mb` \[MB\] of memory. It connects to a socket in a folder that only this user may enter.
pub fn start(class: &str, folder: &Path, memory_mb: u32) -> Result<(UnixStream, Child), String> {
    let interpreter = std::env::var_os(INTERPRETER).unwrap_or_else(|| "python3".into());
    let place = TempDir::new().map_err(|error| format!("cannot make a folder for its socket: {error}"))?;
    let socket = place.path().join("policy");
    let listener = UnixListener::bind(&socket).map_err(|error| format!("cannot make its socket: {error}"))?;
    listener.set_nonblocking(true).map_err(|error| error.to_string())?;
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let mut command = Command::new(&interpreter);
    command.args(["-m", "murmurate.serve", class]).arg(&socket).arg(folder).arg(memory_mb.to_string());
    // Sums in one order, and no thread that competes with the robot's.
    for threads in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"] {
        command.env(threads, "1");
    }
    command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
    let shown = interpreter.to_string_lossy();
    let (group, Pipes { stdin, stderr, .. }) = Group::of(command)
        .map_err(|error| format!("cannot start '{shown}': {error}; {INTERPRETER} names another interpreter"))?;
    let said = pass_on(stderr.expect("its output is a pipe"));
    let until = Instant::now() + START;
    loop {
        match listener.accept() {
            Ok((stream, _)) => {
                stream.set_nonblocking(false).map_err(|error| error.to_string())?;
                return Ok((stream, Child { group, _input: stdin }));
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => return Err(error.to_string()),
        }
        if group.has_ended() {
            // Its last line is there soon, unless something that it has started keeps its output open.
            let mut last = String::new();
            while let Ok(line) = said.recv_timeout(LAST_LINE) {
                last = line;
            }
            let status = group.finish().map_or_else(String::new, |status| format!(" ({status})"));
            return Err(format!("'{class}' has ended{status}: {last}"));
        }
        if Instant::now() > until {
            return Err(format!("'{class}' did not start within {} s", START.as_secs()));
        }
        let mut waits = [PollFd::new(listener.as_fd(), PollFlags::POLLIN)];
        poll(&mut waits, LOOK_MS).map_err(|error| error.to_string())?;
    }
}

/// Passes what the process prints on stderr on to the log, from a thread that waits for nothing else. The newest lines
/// are in the channel, until the output ends.
fn pass_on(stderr: ChildStderr) -> Receiver<String> {
    let (sender, lines) = sync_channel(KEPT_LINES);
    std::thread::spawn(move || {
        let mut reader = BufReader::new(stderr);
        loop {
            let mut line = Vec::new();
            let read = reader.by_ref().take(MAX_LINE).read_until(b'\n', &mut line);
            if read.is_err() || line.is_empty() {
                return;
            }
            let line = shortened(&String::from_utf8_lossy(&line));
            if !line.trim().is_empty() {
                tracing::warn!("the policy in Python: {line}");
                // A process that runs has no reader of it.
                let _ = sender.try_send(line);
            }
        }
    });
    lines
}

/// Returns the first line of `text` for a log, without control characters.
pub fn shortened(text: &str) -> String {
    let line = text.lines().next().unwrap_or_default();
    line.chars().filter(|c| !c.is_control()).take(300).collect()
}
