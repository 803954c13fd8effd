//! Worker that runs a user's program: the program reads packets from stdin and writes packets to stdout, one packet a
//! line.
//!
//! So a driver or a source of readings can be written in any language. Lines that the program writes to its stderr go
//! to that of this process, with control characters escaped. A program that ends is started again.

use std::io::{ErrorKind, PipeWriter, Write};
use std::time::{Duration, Instant};

use actix::{
    Actor, ActorContext, ActorFutureExt, AsyncContext, Context, Handler, Recipient, SpawnHandle, Supervised, WrapFuture,
};
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, BufReader};
use tokio::net::unix::pipe;
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::group::Group;
use super::lines::Lines;
use super::{Input, Port, Seat, Worker};
use crate::config::shown;

/// Longest line of the program's stderr \[bytes\]. A longer line is split.
const LONGEST: u64 = 4096;
/// Longest time for a program to end once its stdin is closed; then it is killed.
const END: Duration = Duration::from_millis(500);
/// Longest time for the program's last lines to arrive after its end.
const LAST_LINES: Duration = Duration::from_millis(100);
/// Pauses before a program that has ended is started again: the first, and the longest. The pause doubles each time.
const PAUSES: [Duration; 2] = [Duration::from_millis(200), Duration::from_millis(6400)];
/// Time for which a program has to run so that the next pause is the first again.
const STEADY: Duration = Duration::from_secs(10);
/// Period of the looks at a program's stdin while lines wait there.
const LOOK: Duration = Duration::from_millis(100);
/// Number of looks in succession at which a program that has begun to read has read nothing, after which it counts as
/// halted. Looks are counted and not their time: while this process is halted itself, or has no processor, it makes
/// none.
const LOOKS: u32 = 10;

/// Worker that runs a user's program as a child process and exchanges packets with it, one a line, over stdin and
/// stdout.
#[derive(Clone, Debug)]
pub struct Program {
    /// The program file, followed by its arguments.
    command: Vec<String>,
    /// Longest line of its stdout \[bytes\]. A longer line is split, so that its reader refuses the parts.
    longest: usize,
}

impl Program {
    /// Makes the worker of a program file, followed by its arguments. Its lines have at most 4096 bytes.
    pub fn new(command: Vec<String>) -> Program {
        Program { command, longest: 4096 }
    }

    /// Returns the worker with so much room for a line at least \[bytes\].
    #[must_use]
    pub fn with_lines_of(self, longest: usize) -> Program {
        Program { longest: longest.max(self.longest), ..self }
    }
}

impl Worker for Program {
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        let program = *self;
        seat.start(move |port| Runner {
            program,
            port,
            life: None,
            ends: false,
            pause: Duration::ZERO,
            lives: 0,
            refused: 0,
            look: None,
        })
    }

    fn runs(&self) -> Option<Vec<String>> {
        Some(self.command.clone())
    }
}

/// Actor that runs a user's program, and starts it again when it has ended.
struct Runner {
    program: Program,
    port: Port,
    /// The running program; `None` while it is ended or waits to be started again.
    life: Option<Life>,
    /// Whether the program is being ended.
    ends: bool,
    /// Pause before the program is started; zero before the first start and after one that was steady.
    pause: Duration,
    /// Number of starts so far.
    lives: u64,
    /// Number of packets for which the program's stdin had no room.
    refused: u64,
    /// Timer of the next look at the program's stdin; `None` while nothing waits there.
    look: Option<SpawnHandle>,
}

/// A running program, its stdin, and what reads its output.
struct Life {
    began: Instant,
    group: Group,
    stdin: PipeWriter,
    lines: Lines,
    stderr: JoinSet<()>,
    progress: Progress,
}

/// Amount of its stdin that a program has read.
#[derive(Debug, Default)]
struct Progress {
    /// Number of bytes that were written.
    written: u64,
    /// Number of bytes that it had read at the last look.
    read: u64,
    /// Number of looks since it has read something.
    looks: u32,
}

impl Progress {
    /// Takes a look at which so many bytes were unread. Returns whether the program counts as halted. One that has not
    /// begun to read does not: it may take long to start, or need no commands.
    fn look(&mut self, unread: u64) -> bool {
        let read = self.written.saturating_sub(unread);
        self.looks = if read > self.read || unread == 0 { 0 } else { self.looks + 1 };
        self.read = read;
        read > 0 && self.looks >= LOOKS
    }
}

impl Actor for Runner {
    type Context = Context<Self>;

    fn started(&mut self, context: &mut Context<Self>) {
        if self.pause.is_zero() {
            self.begin(context);
        } else {
            self.port.resume(self.pause, context, Runner::begin);
        }
    }
}

impl Supervised for Runner {
    fn restarting(&mut self, _: &mut Context<Self>) {
        // Timers of the life before are gone.
        (self.ends, self.look) = (false, None);
        // What the program has reported of its robot or of itself is no longer known.
        self.port.begin_again();
        self.pause = (2 * self.pause).clamp(PAUSES[0], PAUSES[1]);
    }
}

impl Handler<Input> for Runner {
    type Result = ();

    fn handle(&mut self, input: Input, context: &mut Context<Self>) {
        match input {
            Input::Packet(line) => self.write(&line, context),
            Input::Close => self.end(context),
        }
    }
}

impl Runner {
    fn program(&self) -> &str {
        self.program.command.first().map_or("", String::as_str)
    }

    /// Starts the program; if that is not possible, this life of the actor is over.
    fn begin(&mut self, context: &mut Context<Self>) {
        self.lives += 1;
        match self.launch() {
            Ok(life) => {
                let ended = life.group.ended();
                self.life = Some(life);
                context.spawn(ended.into_actor(self).map(|(), runner, context| {
                    if runner.life.is_some() {
                        runner.report("has ended by itself");
                        runner.end(context);
                    }
                }));
            }
            Err(error) => {
                self.report(&format!("cannot be started: {error}"));
                context.stop();
            }
        }
    }

    fn launch(&self) -> std::io::Result<Life> {
        let (group, [stdin, stdout, stderr]) = Group::start(&self.program.command)?;
        let lines = Lines::start(stdout, self.port.sender(), (self.port.name(), self.program.longest))?;
        let stdin = PipeWriter::from(pipe::Sender::from_owned_fd(stdin)?.into_nonblocking_fd()?);
        let mut stderr_reader = JoinSet::new();
        stderr_reader.spawn_local(pass_on(pipe::Receiver::from_owned_fd(stderr)?));
        let (began, progress) = (Instant::now(), Progress::default());
        Ok(Life { began, group, stdin, lines, stderr: stderr_reader, progress })
    }

    /// Writes a packet to the program's stdin. One for which it has no room is dropped and counted: the program does
    /// not read, and what waits there is old. A pipe takes the whole of a short packet or nothing of it.
    fn write(&mut self, line: &[u8], context: &mut Context<Self>) {
        let Some(life) = &mut self.life else { return };
        match life.stdin.write(line) {
            Ok(length) => {
                life.progress.written += length as u64;
                self.look.get_or_insert_with(|| context.run_later(LOOK, Runner::look));
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                self.refused += 1;
                if self.refused.is_power_of_two() {
                    tracing::warn!(refused = self.refused, "'{}' does not read its input", self.program());
                }
            }
            Err(error) => {
                self.report(&format!("does not read its input: {error}"));
                self.end(context);
            }
        }
    }

    /// Looks whether the program reads, for as long as lines wait. One that is halted is killed at once: when it went
    /// on it would carry out what has waited, such as the commands before an emergency stop, and until then it does not
    /// notice the end of its input.
    fn look(&mut self, context: &mut Context<Self>) {
        self.look = None;
        let Some(life) = &mut self.life else { return };
        let unread = unread(&life.stdin);
        if life.progress.look(unread) {
            self.report("does not read its input any more, and is killed");
            self.finish(Duration::ZERO, context);
        } else if unread > 0 {
            self.look = Some(context.run_later(LOOK, Runner::look));
        }
    }

    /// Closes the program's stdin, upon which it has to end, and ends it and all of its group. Then the actor stops.
    fn end(&mut self, context: &mut Context<Self>) {
        self.finish(END, context);
    }

    /// Does what `end` does, and gives the program this long to end by itself.
    fn finish(&mut self, longest: Duration, context: &mut Context<Self>) {
        let Some(Life { began, group, stdin, mut lines, mut stderr, .. }) = self.life.take() else {
            if !self.ends {
                context.stop();
            }
            return;
        };
        self.ends = true;
        if began.elapsed() >= STEADY {
            self.pause = Duration::ZERO;
        }
        drop(stdin);
        let program = self.program().to_owned();
        let ending = async move {
            if !longest.is_zero() && timeout(longest, group.ended()).await.is_err() {
                tracing::warn!("'{program}' does not end, and is killed");
            }
            for process in group.end() {
                tracing::warn!(
                    "'{program}' has left a process with a session of its own, which runs on: {process}; end it if it \
                     can move a robot"
                );
            }
            // What has escaped may hold its stdout and stderr open for ever.
            let last = async {
                lines.ended().await;
                while stderr.join_next().await.is_some() {}
            };
            let _ = timeout(LAST_LINES, last).await;
        };
        context.spawn(ending.into_actor(self).map(|(), _, context| context.stop()));
    }

    /// Logs that the program fails: the starts 1, 2, 4, 8 and so on.
    fn report(&self, how: &str) {
        if self.lives.is_power_of_two() {
            let (program, starts) = (self.program(), self.lives);
            tracing::error!(starts, "'{program}' of {} {how}; it is started again", self.port.name());
        }
    }
}

/// Returns the number of bytes that wait in a pipe to be read.
#[cfg(target_os = "linux")]
fn unread(pipe: &PipeWriter) -> u64 {
    rustix::io::ioctl_fionread(pipe).unwrap_or(0)
}

/// Stands for a question that only Linux answers at this end of a pipe: no program counts as halted.
#[cfg(not(target_os = "linux"))]
fn unread(_: &PipeWriter) -> u64 {
    0
}

/// Writes the lines of the program's stderr to that of this process, until the program closes it.
async fn pass_on(stderr: impl AsyncRead + Unpin) {
    let mut stderr = BufReader::new(stderr);
    let mut line = Vec::new();
    while let Ok(1..) = (&mut stderr).take(LONGEST).read_until(b'\n', &mut line).await {
        let shown = shown::value(String::from_utf8_lossy(line.strip_suffix(b"\n").unwrap_or(&line))) + "\n";
        line.clear();
        // An error of stderr cannot be reported anywhere.
        let _ = std::io::stderr().write_all(shown.as_bytes());
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::fd::AsFd;
    use std::os::unix::fs::PermissionsExt;
    use std::thread;

    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
    use nix::sys::signal::{Signal, kill};
    use nix::unistd::{Pid, getsid};

    use super::*;
    use crate::edge::{Gate, Packet, WorkerState, start};

    /// Longest wait for a worker to end: only one that hangs takes so long.
    const HANGS: Duration = Duration::from_secs(60);

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
            let (gate, running) = start(Box::new(Program::new(command)), "a program").expect("it starts");
            let started = pids(&file, 2);
            // One that ends by itself takes with it at once what it has forked.
            assert!(runs(started[1]) || ending == "exit 0", "{ending}");
            drop(gate);
            assert!(running.join(HANGS), "{ending}");
            while started.iter().any(|pid| runs(*pid)) {
                thread::park_timeout(LOOK);
            }
        }
    }

    /// Waits until the worker has sent so many packets or begins again, and returns them and its state.
    fn next(gate: &mut Gate, count: usize) -> (Vec<Packet>, WorkerState) {
        let mut packets = Vec::new();
        loop {
            let bell = gate.bell();
            poll(&mut [PollFd::new(bell.as_fd(), PollFlags::POLLIN)], PollTimeout::NONE).unwrap();
            let state = gate.take(|packet| packets.push(packet));
            if state != WorkerState::Running || packets.len() >= count {
                return (packets, state);
            }
        }
    }

    #[test]
    fn a_program_that_ends_is_started_again_and_what_it_said_before_is_known_to_be_old() {
        let command = ["sh", "-c", "echo $$; read -r line; echo \"$line\""].map(str::to_owned).to_vec();
        let (mut gate, running) = start(Box::new(Program::new(command)), "a program").expect("it starts");
        let (first, state) = next(&mut gate, 1);
        assert_eq!((first.len(), state), (1, WorkerState::Running));
        gate.send(Packet::from(*b"over\n"));
        assert_eq!(next(&mut gate, 1), (vec![Packet::from(*b"over\n")], WorkerState::Running));
        assert_eq!(next(&mut gate, 1), (vec![], WorkerState::Restarted));
        let (second, state) = next(&mut gate, 1);
        assert_eq!((second.len(), state, gate.restarts()), (1, WorkerState::Running, 1));
        assert_ne!(first, second, "it is another process");
        drop(gate);
        assert!(running.join(HANGS));
    }

    #[test]
    fn a_host_that_ends_between_two_starts_of_a_program_does_not_start_it_again() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("pids");
        // It ends at its first start, and never at another.
        let script = format!("echo $$ >> {0}; [ $(wc -l < {0}) = 1 ] || exec tail -f /dev/null", file.display());
        let command = ["sh", "-c", &script].map(str::to_owned).to_vec();
        let (mut gate, running) = start(Box::new(Program::new(command)), "a program").expect("it starts");
        assert_eq!(next(&mut gate, 1), (vec![], WorkerState::Restarted));
        drop(gate);
        assert!(running.join(HANGS), "it ends");
        assert_eq!(pids(&file, 1).len(), 1, "{}", fs::read_to_string(&file).unwrap());
    }

    #[test]
    fn a_program_that_cannot_be_started_is_tried_again_until_the_host_ends() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("late");
        let command = vec![file.display().to_string()];
        let (mut gate, running) = start(Box::new(Program::new(command)), "a program").expect("it starts");
        assert_eq!(next(&mut gate, 1), (vec![], WorkerState::Restarted));
        let other = folder.path().join("new");
        fs::write(&other, "#!/bin/sh\necho here\nread -r line\n").unwrap();
        fs::set_permissions(&other, fs::Permissions::from_mode(0o700)).unwrap();
        fs::rename(other, file).unwrap();
        let here = std::iter::repeat_with(|| next(&mut gate, 1)).find_map(|(packets, _)| packets.into_iter().next());
        assert_eq!(here, Some(Packet::from(*b"here\n")));
        drop(gate);
        assert!(running.join(HANGS));
    }

    #[test]
    fn what_has_a_session_of_its_own_is_named_and_what_has_only_another_group_is_ended() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("pids");
        let other = "python3 -c 'import os, time; os.setpgid(0, 0); print(os.getpid(), flush=True); time.sleep(600)'";
        let script =
            format!("setsid sh -c 'echo $$ >> {0}; exec tail -f /dev/null' & {other} >> {0} & wait", file.display());
        let (group, _pipes) = Group::start(&["sh", "-c", &script].map(str::to_owned)).unwrap();
        let started = pids(&file, 2);
        let is_daemon = |pid: &Pid| getsid(Some(*pid)) == Ok(*pid);
        let daemon = *started.iter().find(|pid| is_daemon(pid)).expect("one has a session of its own");
        assert_eq!(group.end(), [format!("{daemon} (tail)")]);
        for pid in &started {
            while runs(*pid) && *pid != daemon {
                thread::park_timeout(LOOK);
            }
        }
        assert!(runs(daemon), "it may be meant to stay");
        kill(daemon, Signal::SIGKILL).unwrap();
    }

    #[test]
    fn a_program_that_is_halted_is_killed_and_started_again_without_what_has_waited() {
        let command = ["sh", "-c", "echo $$; while read -r line; do echo \"$line\"; done"].map(str::to_owned).to_vec();
        let (mut gate, running) = start(Box::new(Program::new(command)), "a program").expect("it starts");
        let number = |packet: &Packet| Pid::from_raw(String::from_utf8_lossy(packet).trim().parse().unwrap());
        let halted = number(&next(&mut gate, 1).0[0]);
        gate.send(Packet::from(*b"drive\n"));
        assert_eq!(next(&mut gate, 1), (vec![Packet::from(*b"drive\n")], WorkerState::Running));
        kill(halted, Signal::SIGSTOP).unwrap();
        let since = Instant::now();
        gate.send(Packet::from(*b"drive on\n"));
        assert_eq!(next(&mut gate, 1), (vec![], WorkerState::Restarted));
        // Looks may be late, and are never early.
        assert!(since.elapsed() >= LOOKS * LOOK, "{:?}", since.elapsed());
        assert!(!runs(halted), "it never reads what has waited");
        let (second, state) = next(&mut gate, 1);
        assert_eq!((second.len(), state, gate.restarts()), (1, WorkerState::Running, 1));
        assert_ne!(number(&second[0]), halted);
        gate.send(Packet::from(*b"stand\n"));
        assert_eq!(next(&mut gate, 1), (vec![Packet::from(*b"stand\n")], WorkerState::Running));
        drop(gate);
        assert!(running.join(HANGS));
    }

    #[test]
    fn a_program_that_has_read_something_and_leaves_the_rest_for_ten_looks_is_halted() {
        let mut all = Progress { written: 100, ..Progress::default() };
        assert!(!(0..100).any(|_| all.look(100)), "it may take long to start");
        assert!(!(0..100).any(|at| all.look(99 - at)), "it is slow");
        all.written += 100;
        assert!(!(0..100).any(|_| all.look(0)), "nothing waits");
        all.written += 50;
        assert_eq!((1..100).find(|_| all.look(50)), Some(LOOKS));
    }

    #[test]
    fn a_program_that_never_reads_costs_what_has_no_room_and_ends_with_its_host() {
        let command = ["sh", "-c", "echo up; exec tail -f /dev/null"].map(str::to_owned).to_vec();
        let (mut gate, running) = start(Box::new(Program::new(command)), "a program").expect("it starts");
        assert_eq!(next(&mut gate, 1), (vec![Packet::from(*b"up\n")], WorkerState::Running));
        let mut sent = 0;
        // More than its mailbox and a pipe of 64 KiB hold.
        while sent < 200_000 {
            sent += 100;
            gate.send(Packet::from([b'x'; 100]));
        }
        assert_eq!(gate.take(|_| panic!("it says nothing")), WorkerState::Running);
        let closed = Instant::now();
        drop(gate);
        assert!(running.join(HANGS));
        assert!(closed.elapsed() >= END, "it has the time to stop its robot");
    }
}
