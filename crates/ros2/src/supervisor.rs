//! Supervisor of DDS processes, child processes of a host that connect it to ROS 2: the worker of a driver or source.
//! The module `pair` decides when to start, kill and use these processes, and the supervisor does it.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::net::Shutdown;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use actix::{
    Actor, ActorContext, ActorFutureExt, AsyncContext, Context, Handler, Message, Recipient, SpawnHandle,
    StreamHandler, Supervised, WrapFuture,
};
use futures_util::stream::{Stream, StreamExt, once, unfold};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, BufReader};
use tokio::net::unix::pipe;
use tokio::task::{JoinHandle, spawn_blocking, spawn_local};

use murmurate::config::ConfigError;
use murmurate::edge::{self, Port, Seat, Worker};
use murmurate::time::{Span, Time};

use super::packet::{LONGEST, Plan};
use super::pair::{Action, Id, Input, Pair};
use super::{REFUSED, SUBCOMMAND};

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
    /// Field of the settings that names ROS 2, for the error of a program without it.
    pub field: &'static str,
}

/// Output or end of a DDS process.
#[derive(Debug)]
enum Happened {
    Line(Id, Vec<u8>),
    Ended(Id),
}

impl Message for Happened {
    type Result = ();
}

/// Running DDS process: its handle, its input, and the task that reads its stderr.
struct Process {
    child: Child,
    stdin: UnixStream,
    stderr: Option<JoinHandle<String>>,
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
        super::settings::check_built(self.field)
    }

    fn claim(&self) -> Option<String> {
        let topic = self.plan.writers.first().map(|writer| &writer.topic)?;
        Some(format!("topic {topic} in domain {}", self.plan.domain))
    }

    fn start(self: Box<Self>, seat: Seat) -> Recipient<edge::Input> {
        seat.start(move |port| {
            let pair = Pair::new(Time::ZERO, self.plan.clone(), self.spare);
            let (begun, ends) = (Instant::now(), (0, String::new()));
            Keeper {
                supervisor: *self,
                port,
                pair,
                begun,
                processes: BTreeMap::new(),
                ends,
                timer: None,
                closes: false,
            }
        })
    }
}

/// Actor that starts, watches and replaces DDS processes.
struct Keeper {
    supervisor: Supervisor,
    port: Port,
    pair: Pair,
    begun: Instant,
    processes: BTreeMap<Id, Process>,
    /// Number of successive ends of DDS processes for the same reason, and that reason.
    ends: (u64, String),
    /// Timer of the pair's next turn.
    timer: Option<SpawnHandle>,
    /// Whether the host ends, so that no process is started any more.
    closes: bool,
}

impl Actor for Keeper {
    type Context = Context<Self>;

    fn started(&mut self, context: &mut Context<Self>) {
        self.turn(None, context);
    }
}

impl Supervised for Keeper {}

impl Handler<edge::Input> for Keeper {
    type Result = ();

    fn handle(&mut self, input: edge::Input, context: &mut Context<Self>) {
        match input {
            edge::Input::Packet(packet) => self.turn(Some(Input::Packet(&packet)), context),
            edge::Input::Close => self.close(context),
        }
    }
}

impl Handler<Happened> for Keeper {
    type Result = ();

    fn handle(&mut self, happened: Happened, context: &mut Context<Self>) {
        match happened {
            Happened::Line(id, line) => self.turn(Some(Input::Line(id, &line)), context),
            Happened::Ended(id) => {
                // The other process first gets the newest command.
                self.turn(Some(Input::Ended(id)), context);
                self.bury(id, context);
            }
        }
    }
}

impl StreamHandler<Happened> for Keeper {
    fn handle(&mut self, happened: Happened, context: &mut Context<Self>) {
        <Keeper as Handler<Happened>>::handle(self, happened, context);
    }

    /// The last item of a stream is the end of its process.
    fn finished(&mut self, _: &mut Context<Self>) {}
}

impl Keeper {
    fn now(&self) -> Time {
        Time::ZERO + Span::from_nanos(u64::try_from(self.begun.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }

    /// Gives an input to the pair, or none when its time has come; does what it decides, and sets the timer for its
    /// next turn. When the host ends nothing is decided any more.
    fn turn(&mut self, input: Option<Input<'_>>, context: &mut Context<Self>) {
        if self.closes {
            return;
        }
        let (now, mut actions) = (self.now(), Vec::new());
        if let Some(input) = input {
            self.pair.handle(now, input, &mut actions);
        }
        self.pair.tick(now, &mut actions);
        actions.into_iter().for_each(|action| self.act(action, context));
        if let Some(timer) = self.timer.take() {
            context.cancel_future(timer);
        }
        let wait = Duration::from_nanos(self.pair.wake_at().since(self.now()).as_nanos());
        self.timer = Some(context.run_later(wait, |keeper, context| keeper.turn(None, context)));
    }

    fn act(&mut self, action: Action, context: &mut Context<Self>) {
        match action {
            Action::Pass(line) => self.port.send(line),
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
            Action::Start(id) => match self.launch(id, context) {
                Ok(process) => drop(self.processes.insert(id, process)),
                Err(error) => {
                    let name = &self.supervisor.plan.name;
                    tracing::error!("{name}: its DDS process cannot be started: {error}; it is tried again");
                    context.notify(Happened::Ended(id));
                }
            },
        }
    }

    fn launch(&self, id: Id, context: &mut Context<Self>) -> io::Result<Process> {
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
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let mut process = Process { child, stdin, stderr: None, killed: false };
        match (lines(stdout, id), first_words(stderr)) {
            (Ok(lines), Ok(words)) => {
                context.add_stream(lines);
                process.stderr = Some(spawn_local(words));
                Ok(process)
            }
            (Err(error), _) | (_, Err(error)) => {
                process.kill();
                let _ = process.child.wait();
                Err(error)
            }
        }
    }

    /// Removes a DDS process that has closed its output: kills it, waits for its exit status, logs an unexpected end.
    fn bury(&mut self, id: Id, context: &mut Context<Self>) {
        let Some(mut process) = self.processes.remove(&id) else { return };
        if !self.closes {
            let _ = process.child.kill();
        }
        let Process { mut child, stderr, killed, .. } = process;
        let burial = async move {
            // The kernel may take a while, in which the other process is needed.
            let status = spawn_blocking(move || child.wait()).await.unwrap_or_else(|error| Err(error.into()));
            let words = match stderr {
                Some(words) => words.await.unwrap_or_default(),
                None => String::new(),
            };
            // One that has reported its reason needs no second line.
            let reported = status.as_ref().is_ok_and(|status| status.code() == Some(i32::from(REFUSED)));
            let how = status.map_or_else(|error| error.to_string(), |status| status.to_string());
            (killed || reported, format!("({how}) {words}"))
        };
        context.spawn(burial.into_actor(self).map(|(known, how), keeper, context| {
            if keeper.closes {
                if keeper.processes.is_empty() {
                    context.stop();
                }
            } else if !known {
                keeper.log_end(how);
            }
        }));
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
    /// that do not end. Then the actor stops.
    fn close(&mut self, context: &mut Context<Self>) {
        self.closes = true;
        if self.processes.is_empty() {
            return context.stop();
        }
        for process in self.processes.values() {
            let _ = process.stdin.shutdown(Shutdown::Both);
        }
        context.run_later(FAREWELL, |keeper, context| {
            for mut process in std::mem::take(&mut keeper.processes).into_values() {
                let _ = process.child.kill();
                let _ = process.child.wait();
            }
            context.stop();
        });
    }
}

/// Returns the lines of the output of DDS process `id`, and at last its end.
fn lines(stdout: Option<ChildStdout>, id: Id) -> io::Result<impl Stream<Item = Happened>> {
    let stdout = receiver(stdout.map(OwnedFd::from))?;
    let most = u64::try_from(LONGEST + 1).expect("a small number");
    let lines = unfold(BufReader::new(stdout), move |mut stdout| async move {
        let mut line = Vec::new();
        match (&mut stdout).take(most).read_until(b'\n', &mut line).await {
            Ok(0) | Err(_) => None,
            Ok(_) => Some((Happened::Line(id, line), stdout)),
        }
    });
    Ok(lines.chain(once(async move { Happened::Ended(id) })))
}

/// Reads the stderr of a DDS process to its end and returns its first two lines that are not empty, such as a panic and
/// its message. Bytes of a line after the first `LONGEST_WORDS` count as the next line.
fn first_words(stderr: Option<ChildStderr>) -> io::Result<impl Future<Output = String>> {
    let mut stderr = BufReader::new(receiver(stderr.map(OwnedFd::from))?);
    Ok(async move {
        let mut words = Vec::new();
        loop {
            let mut line = Vec::new();
            match (&mut stderr).take(LONGEST_WORDS).read_until(b'\n', &mut line).await {
                Ok(0) | Err(_) => return words.join(" "),
                Ok(_) => {
                    let line = String::from_utf8_lossy(&line).trim().to_owned();
                    if words.len() < 2 && !line.is_empty() {
                        words.push(line);
                    }
                }
            }
        }
    })
}

fn receiver(pipe: Option<OwnedFd>) -> io::Result<pipe::Receiver> {
    pipe::Receiver::from_owned_fd(pipe.expect("the process was started with pipes"))
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::fd::AsFd;
    use std::os::unix::fs::PermissionsExt;
    use std::thread;

    use murmurate::edge::{Gate, Running, WorkerState, start};
    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;
    use tempfile::TempDir;

    use super::*;
    use crate::packet::{Drive, FromNode, Publication, ToNode, Written, decode_from_node, encode};

    /// Longest wait for anything: only a worker that hangs takes so long.
    const HANGS: Duration = Duration::from_secs(60);

    /// Stand-in for a DDS process. It answers each line with a heartbeat and its number, as that of its subscribers,
    /// and appends the commands that it reads to a file.
    const NODE: &str = r#"#!/bin/sh
while read -r line; do
    echo '{"beat":{"resident_mib":12,"matched":true}}'
    echo '{"topic":{"topic":"/r1/cmd_vel","written":true,"peers":'$$',"problem":null}}'
    case "$line" in *'"drive"'*) echo "$$ $line" >>FILE ;; esac
done
"#;

    /// Supervisor whose DDS processes are stand-ins.
    struct Bench {
        gate: Gate,
        running: Running,
        folder: TempDir,
    }

    impl Bench {
        fn start(spare: bool) -> Bench {
            let folder = TempDir::new().unwrap();
            let (new, program) = (folder.path().join("new"), folder.path().join("node"));
            let commands = folder.path().join("commands");
            fs::write(&new, NODE.replace("FILE", &format!("'{}'", commands.display()))).unwrap();
            fs::set_permissions(&new, fs::Permissions::from_mode(0o700)).unwrap();
            fs::rename(new, &program).unwrap();
            let plan = Plan {
                name: "robot 1".to_owned(),
                domain: 0,
                interface: None,
                memory_mib: 192,
                writers: vec![Publication { topic: "/r1/cmd_vel".to_owned(), kind: Written::Twist }],
                readers: Vec::new(),
            };
            let (gate, running) =
                start(Box::new(Supervisor { plan, spare, program: Some(program), field: "name" }), "driver 1")
                    .expect("a thread can be started");
            Bench { gate, running, folder }
        }

        /// Waits until the active process has told its number and is one that is meant.
        fn active(&mut self, is_meant: impl Fn(Pid) -> bool) -> Pid {
            let (begun, bell) = (Instant::now(), self.gate.bell());
            let mut found = None;
            while found.is_none() {
                assert!(begun.elapsed() < HANGS, "no such process is active");
                poll(&mut [PollFd::new(bell.as_fd(), PollFlags::POLLIN)], PollTimeout::from(100u16)).unwrap();
                let state = self.gate.take(|packet| match decode_from_node(&packet) {
                    Ok(FromNode::Topic(state)) => {
                        let pid = Pid::from_raw(i32::try_from(state.peers).unwrap());
                        found = Some(pid).filter(|pid| is_meant(*pid)).or(found);
                    }
                    other => panic!("{other:?}"),
                });
                assert_eq!(state, WorkerState::Running);
            }
            found.unwrap()
        }

        fn drive(&mut self, x: f64) {
            self.gate.send(encode(&ToNode::Drive(Drive { topic: 0, x, y: 0.0, yaw: 0.0, for_ms: 1000 })).into());
        }

        /// Waits until a process has read a command of one of these speeds.
        fn commanded(&self, pid: Pid, speeds: &[f64]) {
            let begun = Instant::now();
            let is_told = |line: &str| {
                let read = line.strip_prefix(&format!("{pid} ")).and_then(|line| serde_json::from_str(line).ok());
                matches!(read, Some(ToNode::Drive(drive)) if speeds.contains(&drive.x))
            };
            while !fs::read_to_string(self.folder.path().join("commands")).is_ok_and(|all| all.lines().any(is_told)) {
                assert!(begun.elapsed() < HANGS, "process {pid} has no command of {speeds:?} m/s");
                thread::park_timeout(Duration::from_millis(5));
            }
        }
    }

    /// Waits until a process is killed.
    fn is_killed(pid: Pid) {
        let begun = Instant::now();
        while kill(pid, None).is_ok() {
            assert!(begun.elapsed() < HANGS, "process {pid} is still there");
            thread::park_timeout(Duration::from_millis(5));
        }
    }

    #[test]
    fn a_halted_process_is_killed_and_another_has_the_newest_command() {
        for spare in [true, false] {
            let mut bench = Bench::start(spare);
            let halted = bench.active(|_| true);
            bench.drive(0.25);
            bench.commanded(halted, &[0.25]);
            kill(halted, Signal::SIGSTOP).unwrap();
            let since = Instant::now();
            let other = bench.active(|pid| pid != halted);
            assert!(since.elapsed() >= Duration::from_millis(100), "a busy machine is no halt");
            is_killed(halted);
            // The spare drives on, or stands if the command has lapsed; one that was started anew waits for the next.
            if spare {
                bench.commanded(other, &[0.25, 0.0]);
            }
            bench.drive(0.5);
            bench.commanded(other, &[0.5]);
            drop(bench.gate);
            assert!(bench.running.join(HANGS));
            is_killed(other);
        }
    }

    #[test]
    fn a_host_ends_although_its_processes_are_halted() {
        let mut bench = Bench::start(false);
        let halted = bench.active(|_| true);
        kill(halted, Signal::SIGSTOP).unwrap();
        drop(bench.gate);
        assert!(bench.running.join(HANGS));
        assert!(kill(halted, None).is_err(), "it is killed");
    }
}
