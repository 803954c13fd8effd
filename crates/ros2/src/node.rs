//! The program `ros2-node`: the DDS process of a host, its child process that is connected to ROS 2. Packets of the
//! host arrive on stdin, packets to it leave on stdout, one on each line.
//!
//! DDS has no authentication, and forged packets can use up all memory. So DDS runs in a process of its own with a
//! memory limit. The process publishes zero velocities when a command expires, when the host sends nothing, and when
//! stdin ends; after the end of stdin it exits.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::IpAddr;
use std::process::ExitCode;
use std::sync::mpsc::{self, Receiver, SyncSender, TryRecvError};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::resource::{Resource, setrlimit};

use super::dds::Dds;
use super::packet::{self, FromNode, LONGEST, Plan, ReceivedMessage, Role, Sample, ToNode, TopicState, Vitals};
use super::{REFUSED, SUBCOMMAND};

/// Period of the heartbeats that a DDS process sends to its host.
const BEAT: Duration = Duration::from_millis(50);
/// Time without a packet of the host after which a DDS process publishes zero velocities instead of its commands.
const SILENCE: Duration = Duration::from_millis(150);
/// Periods at which a DDS process publishes zero velocities to a robot without a valid command: first for the time
/// `URGENT`, then after it.
const ZEROS: [Duration; 2] = [Duration::from_millis(20), Duration::from_millis(200)];
/// Time for which a DDS process publishes zero velocities at the short period, after a robot has lost its last valid
/// command.
const URGENT: Duration = Duration::from_millis(1000);
/// Time for which a DDS process still publishes zero velocities after the end of stdin, before it exits. The host waits
/// one second for the exit.
const FAREWELL: Duration = Duration::from_millis(300);
/// Longest time that a DDS process takes to tell other participants that it leaves; after it the process exits at once.
const SIGN_OFF: Duration = Duration::from_millis(200);
/// Shortest time between two messages of a topic that a spare DDS process reports to the host.
const SPARE_REPORT: Duration = Duration::from_millis(200);
/// Largest number of packets that wait until the host reads them from stdout; further ones are dropped. So a halted
/// host does not delay zero velocities. As many packets of the host may wait.
const ROOM: usize = 64;

/// Runs the DDS process of a host until its input (stdin) ends. Returns the exit code: `REFUSED` if DDS cannot be
/// opened, 2 if the input does not begin with a plan, 1 if the memory cannot be limited.
#[expect(clippy::print_stderr, reason = "this process has no log; its host passes on what it says on stderr")]
pub fn run() -> ExitCode {
    let mut stdin = BufReader::new(io::stdin());
    let mut line = Vec::new();
    let Ok(ToNode::Open(plan)) = read_line(&mut stdin, &mut line).and_then(|()| decode(&line)) else {
        eprintln!("{SUBCOMMAND} is started by a host, which sends it a plan; there is nothing to do here by hand");
        return ExitCode::from(2);
    };
    if let Err(error) = limit_memory(plan.memory_mib) {
        eprintln!("{}: the memory of the DDS process cannot be limited: {error}; it does not start", plan.name);
        return ExitCode::FAILURE;
    }
    // A panic in a thread of DDS would leave a process that beats and hears nothing.
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        report(panic);
        std::process::abort();
    }));
    let writer = HostWriter::start();
    let dds = networks(plan.interface.as_deref()).and_then(|networks| Dds::open(&plan, &networks));
    match dds {
        Ok(dds) => Node::new(plan, dds, writer).run(stdin),
        Err(problem) => {
            writer.refuse(&plan, &problem);
            ExitCode::from(REFUSED)
        }
    }
}

fn decode(line: &[u8]) -> io::Result<ToNode> {
    packet::decode_to_node(line).map_err(io::Error::other)
}

/// Replaces `line` by the next line of `input`, of which it reads at most `LONGEST` + 1 bytes. The end of the input is
/// an error.
fn read_line(input: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<()> {
    line.clear();
    let most = u64::try_from(LONGEST + 1).expect("a small number");
    match input.by_ref().take(most).read_until(b'\n', line)? {
        0 => Err(io::ErrorKind::UnexpectedEof.into()),
        _ => Ok(()),
    }
}

/// Limits the address space of this process to its present size plus `mib` \[MiB\], and forbids core files.
fn limit_memory(mib: u32) -> io::Result<()> {
    let now_kib = memory_kib("VmSize:").unwrap_or(0);
    let bytes = (now_kib + u64::from(mib) * 1024) * 1024;
    setrlimit(Resource::RLIMIT_AS, bytes, bytes)?;
    // No core files: an abort at the limit is an ordinary end.
    setrlimit(Resource::RLIMIT_CORE, 0, 0)?;
    Ok(())
}

/// Returns the amount of memory \[KiB\] in the line of `/proc/self/status` that begins with `field`, such as `VmRSS:`;
/// `None` if it cannot be read.
fn memory_kib(field: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix(field))?.split_whitespace().next()?.parse().ok()
}

/// Returns the IPv4 addresses of the network interface with this name or address; empty, for all interfaces, if
/// `interface` is `None`.
fn networks(interface: Option<&str>) -> Result<Vec<IpAddr>, String> {
    let Some(interface) = interface else { return Ok(Vec::new()) };
    let all = nix::ifaddrs::getifaddrs().map_err(|error| format!("the interfaces cannot be listed: {error}"))?;
    let address: Option<IpAddr> = interface.parse().ok();
    let mut found = Vec::new();
    for entry in all {
        let Some(v4) = entry.address.and_then(|address| address.as_sockaddr_in().map(|v4| IpAddr::V4(v4.ip()))) else {
            continue;
        };
        if entry.interface_name == interface || address == Some(v4) {
            found.push(v4);
        }
    }
    if found.is_empty() {
        return Err(format!("interface '{interface}' has no IPv4 address here; `ip -4 address` lists those that have"));
    }
    Ok(found)
}

/// Sender of packets from a DDS process to its host, with a thread that writes them to stdout.
struct HostWriter {
    lines: SyncSender<Vec<u8>>,
    written: thread::JoinHandle<()>,
}

impl HostWriter {
    fn start() -> HostWriter {
        let (lines, queue) = mpsc::sync_channel::<Vec<u8>>(ROOM);
        let written = thread::spawn(move || {
            let mut stdout = io::stdout();
            for line in queue {
                if stdout.write_all(&line).and_then(|()| stdout.flush()).is_err() {
                    return;
                }
            }
        });
        HostWriter { lines, written }
    }

    fn send(&self, packet: &FromNode) {
        // Without room the host is halted, and packets of now are old when it goes on.
        let _ = self.lines.try_send(packet::encode(packet));
    }

    /// Reports the same problem for all topics of the plan, and waits until all packets are written to stdout.
    fn refuse(self, plan: &Plan, problem: &str) {
        let topics = plan.writers.iter().map(|writer| (&writer.topic, true));
        for (topic, written) in topics.chain(plan.readers.iter().map(|reader| (&reader.topic, false))) {
            let problem = Some(problem.chars().take(300).collect());
            self.send(&FromNode::Topic(TopicState { topic: topic.clone(), written, peers: 0, problem, refused: 0 }));
        }
        drop(self.lines);
        let _ = self.written.join();
    }
}

/// Watchdog on the velocity commands of one topic: determines when to publish zero velocities.
#[derive(Clone, Copy, Debug, Default)]
struct Motor {
    /// Time at which the last velocity command expires; `None` before the first command.
    until: Option<Instant>,
    /// Time since which zero velocities are published, and time of the next one; `None` while a command is valid.
    stopped: Option<(Instant, Instant)>,
}

impl Motor {
    /// Records that a velocity command is published, which is valid until the time `until`.
    fn command(&mut self, until: Instant) {
        *self = Motor { until: Some(until), stopped: None };
    }

    /// Whether a zero velocity has to be published now, as the last command has expired or `trusted` is false. If so,
    /// sets the time of the next one.
    fn zero_due(&mut self, now: Instant, trusted: bool) -> bool {
        if self.until.is_none_or(|until| trusted && now < until) {
            return false;
        }
        let (since, next) = *self.stopped.get_or_insert((now, now));
        if now < next {
            return false;
        }
        let period = if now.duration_since(since) < URGENT { ZEROS[0] } else { ZEROS[1] };
        self.stopped = Some((since, now + period));
        true
    }

    /// Returns the time at which `zero_due` has to be called next; `None` before the first command.
    fn wake_at(&self) -> Option<Instant> {
        self.stopped.map(|(_, next)| next).or(self.until)
    }
}

/// State of a DDS process once its DDS participant is open.
struct Node {
    dds: Dds,
    writer: HostWriter,
    role: Role,
    motors: Vec<Motor>,
    /// For each published topic, whether it carries velocity commands.
    commands: Vec<bool>,
    /// States of the topics as last reported to the host.
    reported: Vec<TopicState>,
    /// For each subscribed topic, the time from which a spare DDS process reports its next message.
    report_at: Vec<Instant>,
    /// Arrival time of the host's last packet.
    host: Instant,
}

impl Node {
    fn new(plan: Plan, dds: Dds, writer: HostWriter) -> Node {
        let now = Instant::now();
        Node {
            dds,
            writer,
            role: Role::Spare,
            motors: vec![Motor::default(); plan.writers.len()],
            commands: plan.writers.iter().map(|writer| writer.kind.is_command()).collect(),
            reported: Vec::new(),
            report_at: vec![now; plan.readers.len()],
            host: now,
        }
    }

    fn run(mut self, stdin: BufReader<io::Stdin>) -> ExitCode {
        let packets = self.listen(stdin);
        let mut beat_at = Instant::now();
        let mut ends: Option<Instant> = None;
        loop {
            let now = Instant::now();
            if ends.is_none() && !self.carry_out(now, &packets) {
                ends = Some(now + FAREWELL);
            }
            self.report_received(now);
            let moved = self.publish_zeros(now, ends.is_none() && now.duration_since(self.host) <= SILENCE);
            if ends.is_some_and(|end| now >= end || !moved) {
                return self.close();
            }
            if now >= beat_at {
                beat_at = now + BEAT;
                self.beat();
            }
            let wakes = self.motors.iter().filter_map(Motor::wake_at).filter(|at| *at > now);
            let wake =
                wakes.chain([self.host + SILENCE].into_iter().filter(|at| *at > now)).fold(beat_at, Instant::min);
            self.dds.wait(wake.saturating_duration_since(Instant::now()));
        }
    }

    /// Starts a thread that reads packets of the host from `stdin`. Returns the queue of these packets.
    fn listen(&self, mut stdin: BufReader<io::Stdin>) -> Receiver<ToNode> {
        let (tx, packets) = mpsc::sync_channel(ROOM);
        let waker = self.dds.waker();
        thread::spawn(move || {
            let mut line = Vec::new();
            while read_line(&mut stdin, &mut line).is_ok() {
                // The host is trusted; a line cut short at its end is the only one that is not understood.
                if let Ok(packet) = decode(&line) {
                    if tx.send(packet).is_err() {
                        return;
                    }
                    let _ = waker.wake();
                }
            }
            drop(tx);
            let _ = waker.wake();
        });
        packets
    }

    /// Carries out all waiting packets of the host; of several commands for a topic, only the newest. Returns false at
    /// the end of the host's input.
    fn carry_out(&mut self, now: Instant, packets: &Receiver<ToNode>) -> bool {
        let mut newest = vec![None; self.motors.len()];
        let open = loop {
            match packets.try_recv() {
                Ok(ToNode::Beat(role)) => {
                    if role == Role::Active && self.role == Role::Spare {
                        // All topics are reported anew: the host had those of another process.
                        self.reported.clear();
                    }
                    self.role = role;
                }
                Ok(ToNode::Drive(drive)) => {
                    if let Some(slot) = newest.get_mut(usize::from(drive.topic)) {
                        *slot = Some(drive);
                    }
                }
                Ok(ToNode::Publish(publish)) if self.role == Role::Active => {
                    self.dds.publish(usize::from(publish.topic), &publish.message);
                }
                Ok(ToNode::Publish(_) | ToNode::Open(_)) => {}
                Err(TryRecvError::Empty) => break true,
                Err(TryRecvError::Disconnected) => break false,
            }
            self.host = now;
        };
        for (topic, drive) in newest.into_iter().enumerate() {
            if let Some(drive) = drive.filter(|_| self.role == Role::Active && self.commands[topic]) {
                self.dds.drive(topic, [drive.x, drive.y, drive.yaw]);
                self.motors[topic].command(now + Duration::from_millis(u64::from(drive.for_ms)));
            }
        }
        open
    }

    /// Reports received ROS messages to the host. A spare reports at most one of each topic per `SPARE_REPORT`.
    fn report_received(&mut self, now: Instant) {
        let Node { dds, writer, role, report_at, .. } = self;
        dds.take(|topic, sample: Sample| {
            if *role == Role::Active || now >= report_at[topic] {
                report_at[topic] = now + SPARE_REPORT;
                let topic = u16::try_from(topic).expect("a plan has at most 256 topics");
                writer.send(&FromNode::Received(ReceivedMessage { topic, sample }));
            }
        });
    }

    /// If this process is active, publishes the zero velocities that are due: to robots whose last command has expired
    /// and, if `trusted` is false, to all that had a command. Returns whether it is active and has published a command.
    fn publish_zeros(&mut self, now: Instant, trusted: bool) -> bool {
        for (topic, motor) in self.motors.iter_mut().enumerate() {
            if self.role == Role::Active && motor.zero_due(now, trusted) {
                self.dds.drive(topic, [0.0; 3]);
            }
        }
        self.role == Role::Active && self.motors.iter().any(|motor| motor.until.is_some())
    }

    fn beat(&mut self) {
        let resident = memory_kib("VmRSS:").unwrap_or(0) / 1024;
        for (index, state) in self.dds.states().enumerate() {
            match self.reported.get_mut(index) {
                Some(reported) if reported == state => continue,
                Some(reported) => *reported = state.clone(),
                None => self.reported.push(state.clone()),
            }
            self.writer.send(&FromNode::Topic(state.clone()));
        }
        let resident_mib = u32::try_from(resident).unwrap_or(u32::MAX);
        self.writer.send(&FromNode::Beat(Vitals { resident_mib, matched: self.dds.is_matched() }));
    }

    /// Leaves DDS, for which it waits at most `SIGN_OFF`, and returns the exit code.
    fn close(self) -> ExitCode {
        let (done, closed) = mpsc::channel();
        let dds = self.dds;
        thread::spawn(move || {
            dds.close();
            let _ = done.send(());
        });
        let _ = closed.recv_timeout(SIGN_OFF);
        ExitCode::SUCCESS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_that_lapses_is_followed_by_zeros_fast_at_first() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut motor = Motor::default();
        assert!(!motor.zero_due(at(0), false), "it has moved nothing");
        motor.command(at(200));
        let zeros: Vec<u64> = (0..3000).filter(|ms| motor.zero_due(at(*ms), true)).collect();
        assert_eq!(zeros[..3], [200, 220, 240]);
        assert_eq!(zeros.iter().filter(|ms| **ms < 1200).count(), 50);
        assert_eq!(zeros[50..53], [1200, 1400, 1600]);
        motor.command(at(3200));
        assert!(!motor.zero_due(at(3000), true));
        assert!(motor.zero_due(at(3001), false), "the host is silent");
    }

    #[test]
    fn interfaces_are_found_by_name_and_by_address() {
        assert_eq!(networks(None), Ok(vec![]));
        let loopback: IpAddr = "127.0.0.1".parse().unwrap();
        assert_eq!(networks(Some("127.0.0.1")), Ok(vec![loopback]));
        assert_eq!(networks(Some("lo")), Ok(vec![loopback]));
        assert!(networks(Some("no-such")).unwrap_err().contains("'no-such' has no IPv4 address"));
    }

    #[test]
    fn lines_are_read_up_to_their_longest() {
        let mut input: &[u8] = b"one\ntwo";
        let mut line = Vec::new();
        assert!(read_line(&mut input, &mut line).is_ok() && line == b"one\n");
        assert!(read_line(&mut input, &mut line).is_ok() && line == b"two");
        assert!(read_line(&mut input, &mut line).is_err());
    }
}
