//! Supervisor of DDS processes, child processes of a host that connect it to ROS 2: the worker of a driver or source.
//! The module `pair` decides when to start, kill and use these processes, and the supervisor does it.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender};
use std::thread;
use std::time::{Duration, Instant};

use murmurate::config::ConfigError;
use murmurate::edge::{Packet, Port, Worker};
use murmurate::time::{Span, Time};

use super::packet::{LONGEST, Plan};
use super::pair::{Action, Id, Input, Pair};
use super::{REFUSED, SUBCOMMAND};

/// Largest number of events that wait for the supervisor. A DDS process that sends more is blocked, and drops packets.
const ROOM: usize = 256;
/// Time given to the DDS processes at the end of the host to publish zero velocities and leave DDS; after it they are
/// killed. The host waits one second.
const FAREWELL: Duration = Duration::from_millis(700);
/// Longest part of a line of a DDS process's stderr that is kept for the log \[bytes\].
const LONGEST_WORDS: u64 = 400;

/// Worker of a driver or source that starts, watches and replaces DDS processes (child processes that connect the host
/// to ROS 2), each with the topics of `plan`.
#[derive(Clone, Debug)]
pub struct Supervisor {
    /// Topics and limits that each DDS process gets.
    pub plan: Plan,
    /// Whether a spare DDS process, which can take over at once, runs beside the active one.
    pub spare: bool,
    /// Program file whose subcommand `ros2-node` is the DDS process; `None` for the running program itself.
    pub program: Option<PathBuf>,
}

/// Input of the supervisor's loop: an output or the end of a DDS process, or a packet of the driver or source.
enum Happened {
    Line(Id, Vec<u8>),
    Ended(Id),
    Packet(Packet),
    /// The exit status of an ended DDS process was read. The text describes its end, for the log.
    Collected(String),
    /// The control thread of the host has closed the port of this worker, which then has to end.
    Closed,
}

/// Running DDS process: its handle, its input, and the thread that reads its stderr.
struct Process {
    child: Child,
    stdin: UnixStream,
    stderr: Option<thread::JoinHandle<String>>,
    /// Whether the supervisor killed the process; then the reason is already logged.
    killed: bool,
}

impl Process {
    fn kill(&mut self) {
        self.killed = true;
        let _ = self.child.kill();
    }
}

impl Worker for Supervisor {
    fn check(&self) -> Result<(), ConfigError> {
        super::settings::check_built()
    }

    fn claim(&self) -> Option<String> {
        let topic = self.plan.writers.first().map(|writer| &writer.topic)?;
        Some(format!("topic {topic} in domain {}", self.plan.domain))
    }

    fn run(self: Box<Self>, mut port: Port) {
        let (tx, happened) = mpsc::sync_channel(ROOM);
        let sender = port.sender();
        let packets = tx.clone();
        let reader = thread::spawn(move || {
            while let Some(packet) = port.wait() {
                if packets.send(Happened::Packet(packet)).is_err() {
                    return;
                }
            }
            let _ = packets.send(Happened::Closed);
        });
        let pass = |line| sender.send(line);
        let ends = (0, String::new());
        let mut shell = Shell { supervisor: &self, tx, processes: BTreeMap::new(), pass: &pass, ends };
        shell.run(&happened);
        drop(happened);
        let _ = reader.join();
    }
}

/// State of the supervisor's loop: the running DDS processes, and channels to the loop and to the driver or source.
struct Shell<'a> {
    supervisor: &'a Supervisor,
    tx: SyncSender<Happened>,
    processes: BTreeMap<Id, Process>,
    pass: &'a dyn Fn(Packet),
    /// Number of successive ends of DDS processes for the same reason, and that reason.
    ends: (u64, String),
}

impl Shell<'_> {
    fn run(&mut self, happened: &Receiver<Happened>) {
        let start = Instant::now();
        let clock = || Time::ZERO + Span::from_nanos(u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX));
        let mut pair = Pair::new(clock(), self.supervisor.plan.clone(), self.supervisor.spare);
        let mut actions = Vec::new();
        loop {
            pair.tick(clock(), &mut actions);
            self.act(&mut actions);
            let wait = Duration::from_nanos(pair.wake_at().since(clock()).as_nanos());
            let event = match happened.recv_timeout(wait) {
                Ok(event) => event,
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => return,
            };
            let now = clock();
            match &event {
                Happened::Line(id, line) => pair.handle(now, Input::Line(*id, line), &mut actions),
                Happened::Packet(packet) => pair.handle(now, Input::Packet(packet), &mut actions),
                Happened::Ended(id) => {
                    pair.handle(now, Input::Ended(*id), &mut actions);
                    // The other process first gets the newest command.
                    self.act(&mut actions);
                    self.bury(*id);
                }
                Happened::Collected(how) => self.log_end(how.clone()),
                Happened::Closed => return self.close(happened),
            }
            self.act(&mut actions);
        }
    }

    fn act(&mut self, actions: &mut Vec<Action>) {
        for action in actions.drain(..) {
            match action {
                Action::Pass(line) => (self.pass)(line),
                Action::Kill(id) => {
                    if let Some(process) = self.processes.get_mut(&id) {
                        process.kill();
                    }
                }
                Action::Send(id, line) => {
                    if let Some(process) = self.processes.get_mut(&id) {
                        // A full socket means that the process does not read; a part of a line would spoil the rest.
                        if !matches!(process.stdin.write(&line), Ok(written) if written == line.len()) {
                            process.kill();
                        }
                    }
                }
                Action::Start(id) => match self.start(id) {
                    Ok(process) => drop(self.processes.insert(id, process)),
                    Err(error) => {
                        let name = &self.supervisor.plan.name;
                        tracing::error!("{name}: its DDS process cannot be started: {error}; it is tried again");
                        // From a thread of its own, since this one empties the queue.
                        let tx = self.tx.clone();
                        thread::spawn(move || tx.send(Happened::Ended(id)));
                    }
                },
            }
        }
    }

    fn start(&self, id: Id) -> std::io::Result<Process> {
        // By this link the program is found even after its file was replaced by another version.
        let program = self.supervisor.program.clone().unwrap_or_else(|| PathBuf::from("/proc/self/exe"));
        let (stdin, theirs) = UnixStream::pair()?;
        stdin.set_nonblocking(true)?;
        // Arenas of an allocator count as address space, which is limited: one, and small ones of mimalloc [KiB].
        let mut child = Command::new(program)
            .arg0("murmurate")
            .arg(SUBCOMMAND)
            .env("MALLOC_ARENA_MAX", "1")
            .env("MIMALLOC_ARENA_RESERVE", "16384")
            .stdin(Stdio::from(OwnedFd::from(theirs)))
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let tx = self.tx.clone();
        let stdout = child.stdout.take();
        thread::spawn(move || {
            if let Some(stdout) = stdout {
                read(stdout, id, &tx);
            }
            let _ = tx.send(Happened::Ended(id));
        });
        let stderr = child.stderr.take().map(|stderr| thread::spawn(move || first_words(stderr)));
        Ok(Process { child, stdin, stderr, killed: false })
    }

    /// Removes a DDS process that has closed its output. A new thread kills it, waits for its exit status and reports
    /// an unexpected end to the loop.
    fn bury(&mut self, id: Id) {
        let Some(mut process) = self.processes.remove(&id) else { return };
        let tx = self.tx.clone();
        thread::spawn(move || {
            let _ = process.child.kill();
            let status = process.child.wait();
            let words = process.stderr.and_then(|words| words.join().ok()).unwrap_or_default();
            // One that has reported its reason needs no second line.
            let reported = status.as_ref().is_ok_and(|status| status.code() == Some(i32::from(REFUSED)));
            let how = status.map_or_else(|error| error.to_string(), |status| status.to_string());
            if !process.killed && !reported {
                let _ = tx.send(Happened::Collected(format!("({how}) {words}")));
            }
        });
    }

    /// Logs the end of a DDS process with its reason. Of successive ends for the same reason, logs only the ends 1, 2,
    /// 4, 8 and so on.
    fn log_end(&mut self, how: String) {
        if self.ends.1 != how {
            self.ends = (0, how);
        }
        self.ends.0 += 1;
        let (count, how) = &self.ends;
        if count.is_power_of_two() {
            tracing::warn!(count, "{}: its DDS process has ended and is replaced: {how}", self.supervisor.plan.name);
        }
    }

    /// Ends all DDS processes: closes their inputs, gives them time to stop their robots and leave DDS, and kills those
    /// that do not end.
    fn close(&mut self, happened: &Receiver<Happened>) {
        for process in self.processes.values() {
            let _ = process.stdin.shutdown(Shutdown::Both);
        }
        let end = Instant::now() + FAREWELL;
        while !self.processes.is_empty() {
            match happened.recv_timeout(end.saturating_duration_since(Instant::now())) {
                Ok(Happened::Ended(id)) => {
                    if let Some(mut process) = self.processes.remove(&id) {
                        let _ = process.child.wait();
                    }
                }
                Ok(_) => {}
                Err(_) => break,
            }
        }
        for mut process in std::mem::take(&mut self.processes).into_values() {
            let _ = process.child.kill();
            let _ = process.child.wait();
        }
    }
}

/// Reads lines from the output of DDS process `id` and sends them to the supervisor's loop, until the output is closed.
fn read(stdout: ChildStdout, id: Id, tx: &SyncSender<Happened>) {
    let mut stdout = BufReader::new(stdout);
    let most = u64::try_from(LONGEST + 1).expect("a small number");
    loop {
        let mut line = Vec::new();
        match stdout.by_ref().take(most).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => {
                if tx.send(Happened::Line(id, line)).is_err() {
                    return;
                }
            }
        }
    }
}

/// Reads the stderr of a DDS process to its end and returns its first two lines that are not empty, such as a panic and
/// its message. Bytes of a line after the first `LONGEST_WORDS` count as the next line.
fn first_words(stderr: ChildStderr) -> String {
    let (mut stderr, mut words) = (BufReader::new(stderr), Vec::new());
    loop {
        let mut line = Vec::new();
        match stderr.by_ref().take(LONGEST_WORDS).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return words.join(" "),
            Ok(_) => {
                let line = String::from_utf8_lossy(&line).trim().to_owned();
                if words.len() < 2 && !line.is_empty() {
                    words.push(line);
                }
            }
        }
    }
}
