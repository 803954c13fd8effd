//! Worker that runs a user's program: the program reads packets from stdin and writes packets to stdout, one packet a
//! line.
//!
//! So a driver or a source of readings can be written in any language. Lines that the program writes to its stderr go
//! to that of this process, with control characters escaped.
//!
//! The program gets a process group of its own, which is killed when the program has ended or must end, so that what it
//! has forked does not drive on. A second process, a shell, kills the group if this process is killed and so cannot.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use nix::errno::Errno;
use nix::sys::signal::{Signal, kill, killpg};
use nix::sys::wait::{Id, WaitPidFlag, waitid};
use nix::unistd::{Pid, getpgid, getsid};

use super::{Packet, PacketSender, Port, Worker};
use crate::config::shown;

/// Longest line of the program's output \[bytes\]. A longer line is split, so its reader refuses the parts.
const LONGEST: u64 = 4096;
/// Longest time for a program to end once its stdin is closed; then it is killed.
const END: Duration = Duration::from_millis(500);
/// Longest time for the program's last lines to arrive after its end.
const LAST_LINES: Duration = Duration::from_millis(100);
/// Variable of the program's environment by which what it has started is found.
const MARK: &str = "MURMURATE_STARTED_BY";
/// What the shell runs that outlives this process: the end of its stdin is this process's end. The program may then
/// stop its robot for half a second, as ever; a shell whose `sleep` knows no fractions gives it a second.
const GUARD: &str = "read -r _; sleep 0.5 || sleep 1; kill -KILL -- \"-$1\"";

/// What a shell runs to print the numbers and names of all processes with a variable in their environment. Those of
/// other users cannot be read.
const SEARCH: &str = "for file in $(grep -lsaF \"$1\" /proc/[0-9]*/environ); do pid=${file#/proc/}; \
                      pid=${pid%/environ}; read -r name <\"/proc/$pid/comm\" && echo \"$pid $name\"; done";

/// Number of programs that this process has started.
static STARTED: AtomicU32 = AtomicU32::new(0);

/// Worker that runs a user's program as a child process and exchanges packets with it, one a line, over stdin and
/// stdout.
#[derive(Clone, Debug)]
pub struct Program {
    /// The program file, followed by its arguments.
    pub command: Vec<String>,
}

impl Worker for Program {
    fn run(self: Box<Self>, mut port: Port) {
        let Some((program, arguments)) = self.command.split_first() else { return };
        let mark = format!("{}.{}.", std::process::id(), STARTED.fetch_add(1, Ordering::Relaxed));
        let mut command = Command::new(program);
        command.args(arguments).env(MARK, &mark).process_group(0);
        let mut child = match command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn() {
            Ok(child) => child,
            Err(error) => {
                tracing::error!("'{program}' cannot be started: {error}");
                return;
            }
        };
        let guard = guard(&child, program);
        let (sender, stdout, stderr) = (port.sender(), child.stdout.take(), child.stderr.take());
        let (reads, last_lines) = channel::<()>();
        let reads_too = reads.clone();
        thread::spawn(move || {
            stdout.into_iter().for_each(|stdout| read(stdout, &sender));
            drop(reads);
        });
        thread::spawn(move || {
            stderr.into_iter().for_each(pass_on);
            drop(reads_too);
        });
        let mut stdin = child.stdin.take();
        while let Some(line) = port.wait() {
            let written = stdin.as_mut().map(|stdin| stdin.write_all(&line).and_then(|()| stdin.flush()));
            if let Some(Err(error)) = written {
                tracing::error!("'{program}' does not read its input: {error}");
                break;
            }
        }
        // The program has to end when its stdin is closed.
        drop(stdin);
        end(&mut child, program);
        for process in escaped(&mark, group(&child)) {
            tracing::warn!(
                "'{program}' has left a process with a session of its own, which runs on: {process}; end it if it can \
                 move a robot"
            );
        }
        if let Some(mut guard) = guard {
            // It still waits for the end of this process.
            let _ = guard.kill();
            let _ = guard.wait();
        }
        // What has escaped may hold its stdout and stderr open for ever.
        let _ = last_lines.recv_timeout(LAST_LINES);
    }

    fn runs(&self) -> Option<Vec<String>> {
        Some(self.command.clone())
    }
}

/// Reads lines from the program's stdout and sends each as a packet, until the program closes it.
fn read(stdout: impl Read, sender: &PacketSender) {
    let mut stdout = BufReader::new(stdout);
    loop {
        let mut line = Vec::new();
        match stdout.by_ref().take(LONGEST).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => sender.send(Packet::from(line)),
        }
    }
}

/// Writes the lines of the program's stderr to that of this process, until the program closes it.
fn pass_on(stderr: impl Read) {
    let mut stderr = BufReader::new(stderr);
    let mut line = Vec::new();
    while let Ok(1..) = stderr.by_ref().take(LONGEST).read_until(b'\n', &mut line) {
        let shown = shown::value(String::from_utf8_lossy(line.strip_suffix(b"\n").unwrap_or(&line))) + "\n";
        line.clear();
        // An error of stderr cannot be reported anywhere.
        let _ = std::io::stderr().write_all(shown.as_bytes());
    }
}

/// Starts the shell that kills the program's group if this process is killed. Without a shell that is not done.
fn guard(child: &Child, program: &str) -> Option<Child> {
    let mut shell = Command::new("/bin/sh");
    shell.args(["-c", GUARD, "guard", &child.id().to_string()]);
    shell.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
    // What kills this process with its group, such as a supervisor, must not kill the guard.
    let started = shell.process_group(0).spawn();
    started
        .inspect_err(|error| tracing::warn!("'{program}' lives on if this process is killed: no /bin/sh ({error})"))
        .ok()
}

/// The program's process group, which has the number of the program.
fn group(child: &Child) -> Pid {
    Pid::from_raw(i32::try_from(child.id()).expect("process numbers are small"))
}

/// Waits up to 0.5 s for the program to end, and kills its group: the program if it has not ended, and what it has
/// forked.
fn end(child: &mut Child, program: &str) {
    let group = group(child);
    // The program is not waited for before its group is killed: until then no other group can have its number.
    let (runs, ended) = channel::<()>();
    let watch = thread::spawn(move || {
        while waitid(Id::Pid(group), WaitPidFlag::WEXITED | WaitPidFlag::WNOWAIT) == Err(Errno::EINTR) {}
        drop(runs);
    });
    if ended.recv_timeout(END) == Err(RecvTimeoutError::Timeout) {
        tracing::warn!("'{program}' does not end, and is killed");
    }
    // An error says that nobody of the group is left.
    let _ = killpg(group, Signal::SIGKILL);
    let _ = watch.join();
    let _ = child.wait();
}

/// Kills processes of the program that have left its group, and returns the numbers and names of those with a session
/// of their own, such as a daemon: they may be meant to stay.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edge::channel;
    use std::fs;

    /// Period at which the files of processes are read.
    const LOOK: Duration = Duration::from_millis(5);

    /// Waits until the file has as many lines, and returns them as numbers of processes.
    fn pids(file: &std::path::Path, count: usize) -> Vec<Pid> {
        loop {
            let text = fs::read_to_string(file).unwrap_or_default();
            if text.ends_with('\n') && text.lines().count() >= count {
                return text.lines().map(|line| Pid::from_raw(line.trim().parse().unwrap())).collect();
            }
            thread::park_timeout(LOOK);
        }
    }

    /// Whether a process runs; one that has ended and was not waited for does not.
    fn runs(pid: Pid) -> bool {
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        stat.rsplit_once(") ").is_some_and(|(_, rest)| !rest.starts_with(['Z', 'X']))
    }

    #[test]
    fn what_a_program_has_forked_ends_with_it_whether_it_ends_by_itself_or_not() {
        for ending in ["while read -r line; do :; done", "tail -f /dev/null", "exit 0"] {
            let folder = tempfile::TempDir::new().unwrap();
            let file = folder.path().join("pids");
            let script =
                format!("echo $$ > {0}; tail -f /dev/null & echo $! >> {0}; echo up; {ending}", file.display());
            let command = ["sh", "-c", &script].map(str::to_owned).to_vec();
            let (gate, port) = channel().unwrap();
            let worker = thread::spawn(move || Box::new(Program { command }).run(port));
            let started = pids(&file, 2);
            assert!(runs(started[1]), "{ending}");
            drop(gate);
            worker.join().unwrap();
            while started.iter().any(|pid| runs(*pid)) {
                thread::park_timeout(LOOK);
            }
        }
    }

    #[test]
    fn what_has_a_session_of_its_own_is_named_and_what_has_only_another_group_is_ended() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("pids");
        let mark = format!("{}.test.", std::process::id());
        let other = "python3 -c 'import os, time; os.setpgid(0, 0); print(os.getpid(), flush=True); time.sleep(600)'";
        let script =
            format!("setsid sh -c 'echo $$ >> {0}; exec tail -f /dev/null' & {other} >> {0} & wait", file.display());
        let mut command = Command::new("sh");
        let mut child = command.args(["-c", &script]).env(MARK, &mark).process_group(0).spawn().unwrap();
        let started = pids(&file, 2);
        let is_daemon = |pid: &Pid| getsid(Some(*pid)) == Ok(*pid);
        let daemon = *started.iter().find(|pid| is_daemon(pid)).expect("one has a session of its own");
        let group = group(&child);
        end(&mut child, "sh");
        assert_eq!(escaped(&mark, group), [format!("{daemon} (tail)")]);
        for pid in &started {
            while runs(*pid) && *pid != daemon {
                thread::park_timeout(LOOK);
            }
        }
        assert!(runs(daemon), "it may be meant to stay");
        kill(daemon, Signal::SIGKILL).unwrap();
    }
}
