//! Process group of a user's program: started and ended as a whole, so that what the program has forked does not drive
//! on. A second process, a shell, kills the group if this process is killed and so cannot.

use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

use nix::sys::signal::{Signal, kill, killpg};
use nix::unistd::{Pid, getpgid, getsid};
#[cfg(target_os = "linux")]
use rustix::process::{PidfdFlags, pidfd_open};
use rustix::process::{WaitId, WaitIdOptions, waitid};
#[cfg(target_os = "linux")]
use tokio::io::{Interest, unix::AsyncFd};

use crate::config::shown;

/// Variable of the program's environment by which what it has started is found.
const MARK: &str = "MURMURATE_STARTED_BY";
/// Script of the shell that kills the group after the end of this process, which is the end of the shell's stdin. The
/// program has half a second to stop its robot; a second if `sleep` accepts no fractions.
const GUARD: &str = "read -r _; sleep 0.5 || sleep 1; kill -KILL -- \"-$1\"";

/// Script that prints the numbers and names of all processes with a variable in their environment, except those of
/// other users, whose environment cannot be read.
const SEARCH: &str = "for file in $(grep -lsaF \"$1\" /proc/[0-9]*/environ); do pid=${file#/proc/}; \
                      pid=${pid%/environ}; read -r name <\"/proc/$pid/comm\" && echo \"$pid $name\"; done";

/// Number of programs that this process has started.
static STARTED: AtomicU32 = AtomicU32::new(0);

/// Running program with a process group of its own. The group is killed when this is dropped.
#[derive(Debug)]
pub struct Group {
    child: Child,
    /// Number of the group, which is that of the program.
    id: Pid,
    /// Value of the variable by which processes of the program are found.
    mark: String,
    /// The shell that kills the group if this process is killed.
    guard: Option<Child>,
    over: bool,
}

/// Ends of the pipes of a program, of those that it was started with.
#[derive(Debug)]
pub struct Pipes {
    /// Pipe to its stdin.
    pub stdin: Option<ChildStdin>,
    /// Pipe from its stdout.
    pub stdout: Option<ChildStdout>,
    /// Pipe from its stderr.
    pub stderr: Option<ChildStderr>,
}

impl Group {
    /// Starts the program with its arguments, and returns it with its stdin, stdout and stderr.
    pub(super) fn start(command: &[String]) -> io::Result<(Group, [OwnedFd; 3])> {
        let Some((program, arguments)) = command.split_first() else { return Err(io::ErrorKind::InvalidInput.into()) };
        let mut command = Command::new(program);
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let (group, Pipes { stdin, stdout, stderr }) = Group::of(command)?;
        let (Some(stdin), Some(stdout), Some(stderr)) = (stdin, stdout, stderr) else {
            unreachable!("all three were asked for")
        };
        Ok((group, [stdin.into(), stdout.into(), stderr.into()]))
    }

    /// Starts the program of `command`, and returns it with the pipes that the command asks for.
    pub fn of(mut command: Command) -> io::Result<(Group, Pipes)> {
        let program = command.get_program().to_string_lossy().into_owned();
        let mark = format!("{}.{}.", std::process::id(), STARTED.fetch_add(1, Ordering::Relaxed));
        let mut child = command.env(MARK, &mark).process_group(0).spawn()?;
        let id = Pid::from_raw(i32::try_from(child.id()).expect("process numbers are small"));
        let pipes = Pipes { stdin: child.stdin.take(), stdout: child.stdout.take(), stderr: child.stderr.take() };
        let guard = guard(id, &program);
        Ok((Group { child, id, mark, guard, over: false }, pipes))
    }

    /// Returns whether the program has ended. What it has forked may still run, until the group is ended.
    pub fn has_ended(&self) -> bool {
        // The program is not waited for: until then no other group can have its number.
        let id = rustix::process::Pid::from_raw(self.id.as_raw()).expect("a process has a number above zero");
        let looks = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        waitid(WaitId::Pid(id), looks).is_ok_and(|status| status.is_some())
    }

    /// Kills the program's group if it is not over, and returns how the program has ended.
    pub fn finish(mut self) -> Option<ExitStatus> {
        self.kill()
    }

    /// Returns a future that is ready when the program has ended. Its group has to be ended all the same.
    pub(super) fn ended(&self) -> impl Future<Output = ()> + 'static {
        end_of(self.id)
    }

    /// Kills the program's group: the program if it has not ended, and what it has forked. Returns the numbers and
    /// names of processes of the program that have a session of their own, such as a daemon: they may be meant to stay.
    pub(super) fn end(mut self) -> Vec<String> {
        self.kill();
        escaped(&self.mark, self.id)
    }

    fn kill(&mut self) -> Option<ExitStatus> {
        if std::mem::replace(&mut self.over, true) {
            return None;
        }
        // An error says that nobody of the group is left. The program is not waited for before: until then no other
        // group can have its number.
        let _ = killpg(self.id, Signal::SIGKILL);
        let status = self.child.wait().ok();
        if let Some(mut guard) = self.guard.take() {
            // It still waits for the end of this process.
            let _ = guard.kill();
            let _ = guard.wait();
        }
        status
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Waits until the process has ended; its exit status is left to be read. (By a descriptor of the process and not by
/// the signal of its end: a signal would interrupt the waits of all other threads.)
#[cfg(target_os = "linux")]
#[expect(deprecated, reason = "its replacement asks for a promise, which an owned descriptor keeps")]
async fn end_of(id: Pid) {
    let process = rustix::process::Pid::from_raw(id.as_raw()).expect("a process has a number above zero");
    let watched = pidfd_open(process, PidfdFlags::NONBLOCK)
        .map_err(io::Error::from)
        .and_then(|process| AsyncFd::with_interest(process, Interest::READABLE));
    match watched {
        Ok(process) => drop(process.readable().await),
        // A kernel before 5.3: the end is noticed when the program's input is closed.
        Err(_) => std::future::pending().await,
    }
}

/// Stands for a question that is not asked here: the end is noticed when the program's input is closed.
#[cfg(not(target_os = "linux"))]
async fn end_of(_: Pid) {
    std::future::pending().await
}

/// Starts the shell that kills the group if this process is killed. Without a shell that is not done.
fn guard(group: Pid, program: &str) -> Option<Child> {
    let mut shell = Command::new("/bin/sh");
    shell.args(["-c", GUARD, "guard", &group.to_string()]);
    shell.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
    // What kills this process with its group, such as a supervisor, must not kill the guard.
    let started = shell.process_group(0).spawn();
    started
        .inspect_err(|error| tracing::warn!("'{program}' lives on if this process is killed: no /bin/sh ({error})"))
        .ok()
}

/// Kills processes of the program that have left its group, and returns the numbers and names of those with a session
/// of their own.
fn escaped(mark: &str, group: Pid) -> Vec<String> {
    let mut shell = Command::new("/bin/sh");
    let found = shell.args(["-c", SEARCH, "search", &format!("{MARK}={mark}")]).stdin(Stdio::null()).output();
    let found = found.map(|output| String::from_utf8_lossy(&output.stdout).into_owned()).unwrap_or_default();
    let session = getsid(None).ok();
    let mut escaped = Vec::new();
    for line in found.lines() {
        let Some((number, name)) = line.split_once(' ') else { continue };
        let Ok(pid) = number.parse().map(Pid::from_raw) else { continue };
        let theirs = getsid(Some(pid)).ok();
        if theirs.is_none() || getpgid(Some(pid)) == Ok(group) {
            // It has just ended, or was killed with the group and is about to end.
        } else if theirs == session {
            let _ = kill(pid, Signal::SIGKILL);
        } else {
            escaped.push(format!("{pid} ({})", shown::value(name)));
        }
    }
    escaped
}
