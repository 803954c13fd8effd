//! Output of a host and of a launch while they drive robots: writing never delays a control tick, and counts are
//! reported, however a process ends.

use std::io::{BufRead, BufReader, ErrorKind, PipeReader, PipeWriter, Read, Write, pipe};
use std::os::fd::AsFd;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

use crate::alone;
use crate::beside;
use crate::crew::{folder, report};
use crate::program::lateness::Lateness;
use crate::program::skip::skip;
use crate::program::{murmurate, run, text};
use murmurate_report::event::{Counted, HostEvent};
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::sys::signal::{Signal, kill};
use nix::sys::stat::Mode;
use nix::sys::wait::{Id, WaitPidFlag, waitid};
use nix::unistd::{Pid, mkfifo};
use serde_json::Value;

const ROBOTS: usize = 12;
/// Time without a reader: the queue holds 13 seconds of the trajectories of this many robots.
const STUCK: Duration = Duration::from_secs(18);
const PATIENCE: Duration = Duration::from_secs(60);
/// Period of control ticks.
const TICK: Duration = Duration::from_millis(50);

/// Pipe that is already full.
struct Full {
    reader: PipeReader,
    writer: PipeWriter,
}

impl Full {
    fn new() -> Full {
        let (reader, writer) = pipe().expect("a pipe");
        let full = Full { reader, writer };
        full.fill();
        full
    }

    /// Returns the blocking end for a process to write to.
    fn end(&self) -> Stdio {
        self.writer.try_clone().expect("a copy").into()
    }

    fn fill(&self) {
        let set = |flags| assert!(fcntl(self.writer.as_fd(), FcntlArg::F_SETFL(flags)).is_ok());
        set(OFlag::O_NONBLOCK);
        for junk in [&[b'\n'; 4096][..], b"\n"] {
            let full = loop {
                match (&self.writer).write(junk) {
                    Ok(written) => assert!(written > 0),
                    Err(error) => break error.kind(),
                }
            };
            assert_eq!(full, ErrorKind::WouldBlock);
        }
        set(OFlag::empty());
    }
}

/// Process that is killed at the end of the test.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Process {
    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(i32::try_from(self.0.id()).expect("small")), signal).expect("it runs");
    }

    /// Returns how it has ended. It waits three times half a second for pipes; only what waits for ever takes a minute.
    fn ends(&mut self, beside: &str) -> ExitStatus {
        let pid = Id::Pid(Pid::from_raw(i32::try_from(self.0.id()).expect("small")));
        let (runs, ended) = channel::<()>();
        thread::spawn(move || {
            let _ = waitid(pid, WaitPidFlag::WEXITED | WaitPidFlag::WNOWAIT);
            drop(runs);
        });
        assert_eq!(ended.recv_timeout(PATIENCE), Err(RecvTimeoutError::Disconnected), "{beside} hold the process up");
        self.0.wait().expect("it is ours")
    }
}

/// Returns a team with all agents and the state server on one host and the World on another.
fn team() -> String {
    let robots: Vec<String> = (0..ROBOTS).map(|robot| robot.to_string()).collect();
    let robots = robots.join(", ");
    let carries = "\"latent\", \"reading\", \"heartbeat\", \"mode\", \"stop\", \"motor-command\"";
    format!(
        "team = 731\nkey_file = \"team.key\"\nepisodes = 10000\npolicy = \"orca\"\n\n[deployment]\nmode = \"two\"\n\
         robots = {ROBOTS}\nplacement = \"drive\"\nstepping = \"seeded\"\n\n[[deployment.host]]\nname = \"pc\"\n\
         agents = [[{robots}]]\nstate_server = true\n\n[[deployment.host]]\nname = \"world\"\n\
         simulates = [{robots}]\n\n[[deployment.link]]\nname = \"wires\"\nmedium = \"cable\"\ncarries = [{carries}]\n\n\
         [link.wires]\ninterface = \"lo\"\ngroup = \"239.255.73.1:40731\"\n"
    )
}

/// Waits for a while.
fn pass(span: Duration) {
    let (_keep, silence) = channel::<()>();
    assert!(silence.recv_timeout(span).is_err());
}

/// Reads counts until they cover the time without a reader; then the pipe stays open, unread.
fn read_all(reader: &PipeReader) -> Receiver<Counted> {
    let reader = reader.try_clone().expect("a copy");
    let (sender, found) = channel();
    thread::spawn(move || {
        let mut seconds = 0;
        for line in BufReader::with_capacity(1, reader).lines().map_while(Result::ok) {
            if let Some(HostEvent::Counted(counted)) = HostEvent::from_line(&line) {
                seconds += 1;
                if seconds == STUCK.as_secs() {
                    let _ = sender.send(counted);
                    return;
                }
            }
        }
    });
    found
}

#[test]
fn full_pipes_and_a_trajectory_pipe_without_a_reader_make_no_tick_late() {
    let _alone = alone();
    let (folder, file) = folder(&team());
    let fifo = folder.path().join("paths.csv");
    mkfifo(&fifo, Mode::S_IRWXU).expect("a pipe");
    let pipes: Vec<[Full; 2]> = (0..2).map(|_| [Full::new(), Full::new()]).collect();
    let start = |host: &str, [out, log]: &[Full; 2]| {
        // With the priority of its service (packaging/), where this is permitted.
        let mut command = Command::new("nice");
        command.args(["-n", "-10", env!("CARGO_BIN_EXE_murmurate"), "host", &file, "--host", host, "--json"]);
        if host == "world" {
            command.arg("--trajectories").arg(&fifo);
        }
        command.env("MURMURATE_LOG", "debug").stdin(Stdio::null()).stdout(out.end()).stderr(log.end());
        Process(command.spawn().expect("it starts"))
    };
    let mut hosts: Vec<Process> = ["pc", "world"].iter().zip(&pipes).map(|(host, pipes)| start(host, pipes)).collect();
    let machine = Lateness::watch();
    pass(STUCK);
    let lateness = machine.end();
    // Now stdout is read again; the log never is.
    let [pc, world] = [0, 1].map(|host| read_all(&pipes[host][0].reader));
    let [pc, world] = [pc, world].map(|host| host.recv_timeout(PATIENCE).expect("it has gone on while nobody read"));
    let late: u64 = pc.safety.iter().map(|robot| robot.counts.late_tick + robot.counts.own_state).sum();
    report(&format!("{} messages, {late} late ticks, dropped: {:?} {:?}", pc.messages, pc.unwritten, world.unwritten));
    for (host, [out, _]) in hosts.iter_mut().zip(&pipes) {
        out.fill();
        host.signal(Signal::SIGTERM);
        let status = host.ends("stuck pipes");
        assert!(status.code().is_some(), "it has ended by itself: {status}");
    }
    if lateness < TICK {
        assert_eq!(late, 0, "late ticks");
    } else {
        skip("idle", "ticks beside full pipes are not judged: this machine is late by itself");
    }
    let seconds = STUCK.as_secs();
    assert!(pc.messages > 15 * seconds * ROBOTS as u64, "its robots were driven all the while: {pc:?}");
    assert!(world.unwritten.steps > 0, "the steps that were dropped are counted: {world:?}");
}

/// Returns the team of a launch: two robots and their World, with episodes of a few seconds.
fn pair(episodes: u32, number: u16) -> (tempfile::TempDir, String) {
    let links: String = [("loopback", 1), ("infra", 2)]
        .iter()
        .map(|(link, last)| {
            format!("[link.{link}]\ninterface = \"lo\"\ngroup = \"239.255.74.{last}:{}\"\n", 40_000 + number)
        })
        .collect();
    let head = format!(
        "team = {number}\nkey_file = \"team.key\"\nmode = \"offboard\"\nrobots = 2\nepisodes = {episodes}\n\
         policy = \"orca\"\n"
    );
    folder(&(head + &links))
}

/// Starts a launch; returns its lines on stderr, too.
fn launched(episodes: u32, number: u16) -> (tempfile::TempDir, String, Process, Receiver<String>) {
    let (folder, file) = pair(episodes, number);
    let mut child = murmurate(&["launch", &file, "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    let log = child.stderr.take().expect("it is piped");
    let (sender, lines) = channel();
    thread::spawn(move || {
        BufReader::new(log).lines().map_while(Result::ok).for_each(|line| drop(sender.send(line)));
    });
    (folder, file, Process(child), lines)
}

/// Sends a signal to one of the hosts of a launch.
fn signal_host(launch: &Process, host: &str, signal: Signal) {
    let id = launch.0.id();
    let children = std::fs::read_to_string(format!("/proc/{id}/task/{id}/children")).expect("it runs");
    let is = |pid: &&str| {
        let command = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        command.contains(&format!("--host\0{host}\0"))
    };
    let pid = children.split_whitespace().find(is).expect("the host runs");
    kill(Pid::from_raw(pid.parse().expect("a number")), signal).expect("it runs");
}

fn until(lines: &Receiver<String>, said: &mut String, words: &[&str]) {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let Ok(line) = lines.recv_timeout(left) else { panic!("never came: {words:?}; said: {said}") };
        *said += &format!("{line}\n");
        if words.iter().all(|word| line.contains(word)) {
            return;
        }
    }
}

/// Interrupts a launch; returns its exit code, its JSON object and the rest of its log.
fn interrupted(mut launch: Process, lines: &Receiver<String>) -> (Option<i32>, Value, String) {
    launch.signal(Signal::SIGINT);
    let mut out = String::new();
    launch.0.stdout.take().expect("it is piped").read_to_string(&mut out).expect("it is text");
    let code = launch.0.wait().expect("it is ours").code();
    let log: Vec<String> = lines.iter().collect();
    (code, serde_json::from_str(&out).expect("one JSON object"), log.join("\n"))
}

#[test]
fn a_launch_reports_the_counts_of_its_hosts_after_a_stop_a_kill_and_an_interrupt() {
    let _beside = beside();
    let (_folder, file, launch, lines) = launched(1000, 741);
    let mut said = String::new();
    until(&lines, &mut said, &["3 processes run"]);
    // Long enough for every host to have reported counts.
    pass(Duration::from_secs(3));
    signal_host(&launch, "agent-1", Signal::SIGKILL);
    until(&lines, &mut said, &["warning: the process 'agent-1'", "started again"]);
    pass(Duration::from_secs(2));
    let stop = run(&["stop", &file]);
    assert_eq!(stop.status.code(), Some(0), "{}{}", text(&stop.stdout), text(&stop.stderr));
    until(&lines, &mut said, &["agent-1", "ERROR", "emergency stop"]);
    // Warnings of a guard reach the log, too, not only errors.
    let rearm = run(&["stop", &file, "--rearm"]);
    assert_eq!(rearm.status.code(), Some(0), "{}{}", text(&rearm.stdout), text(&rearm.stderr));
    until(&lines, &mut said, &["WARN", "re-armed"]);
    let (code, json, log) = interrupted(launch, &lines);
    assert_eq!(code, Some(130), "{said}{log}");
    assert_eq!(json["interrupted"], true, "{json}");
    assert!(json["safety"]["stop"].as_u64().is_some_and(|stops| stops >= 2), "both robots were stopped: {json}");
    assert!(json["messages"].as_u64().is_some_and(|messages| messages > 100), "{json}");
    assert!(json["links"]["sent"].as_u64().is_some_and(|sent| sent > 100), "{json}");
    assert_eq!(json["unwritten"]["log_lines"], 0, "{json}");
}

#[test]
fn a_launch_with_an_unread_log_ends_with_all_results() {
    let _beside = beside();
    let (_folder, file) = pair(1, 743);
    let log = Full::new();
    let mut command = murmurate(&["launch", &file, "--json"]);
    command.env("MURMURATE_LOG", "debug").stdout(Stdio::piped()).stderr(log.end());
    let mut launch = Process(command.spawn().expect("it starts"));
    let (sender, ended) = channel();
    let mut stdout = launch.0.stdout.take().expect("it is piped");
    thread::spawn(move || {
        let mut out = String::new();
        let _ = stdout.read_to_string(&mut out);
        let _ = sender.send(out);
    });
    let out = ended.recv_timeout(PATIENCE).expect("a stuck log has held it up");
    let json: Value = serde_json::from_str(&out).expect("one JSON object");
    assert_eq!((launch.0.wait().expect("it is ours").code(), &json["interrupted"]), (Some(0), &Value::from(false)));
    assert_eq!(json["episodes"], 1, "{json}");
    assert!(json["links"]["sent"].as_u64().is_some_and(|sent| sent > 100), "{json}");
}

#[test]
fn an_interrupt_after_the_last_verdict_is_reported() {
    let _beside = beside();
    let (_folder, _, launch, lines) = launched(1, 742);
    let mut said = String::new();
    until(&lines, &mut said, &["episode 1 of 1"]);
    let (code, json, log) = interrupted(launch, &lines);
    assert_eq!((code, &json["interrupted"]), (Some(130), &Value::from(true)), "{json}\n{log}");
    assert_eq!(json["episodes"], 1);
}
