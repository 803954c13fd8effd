//! One participant of a messaging benchmark: the Network actor, link, codec, authentication and UDP transport of
//! `murmurate host`, without robots. It sends what robots send: latents at a given rate, heartbeats and modes.
//!
//! Environment variables configure it (`NP_ID`, `NP_N`, `NP_RATE`, ...; `NP_RECORD` names a folder for records as a
//! host makes them; `NP_ROBOT=0` leaves out heartbeats and modes, which other peers do not send; `NP_VARIANT=uni` sends
//! to each other participant at its address in `NP_PEERS`, and not to a group; `NP_REPEAT=0` repeats nothing;
//! `NP_AUTH=sender` gives each participant keys of its own; `NP_CONFIDENTIAL=1` encrypts), and it
//! writes its results to files in `NP_DIR`. The harness that starts it measures other middleware in the same way. A
//! message of 152 bytes (sender, sequence number, timestamp, two floats of position, 32 floats) is sent as a latent.
//! The sequence number is in its episode, the timestamp in its term and velocity, the position in its position.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::rc::Rc;
use std::str::FromStr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use murmurate::actor::Core;
use murmurate::actors::network;
use murmurate::graph::end::HostEnd;
use murmurate::graph::event;
use murmurate::graph::sockets::Shared;
use murmurate::messages::geometry::{Motion, Task, Vec2};
use murmurate::messages::ids::{HostId, LinkId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Features, Heartbeat, Kind, Latent, Mode, Phase, Round, Wire};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::reliability::{Reliabilities, Reliability, Setup};
use murmurate::net::protocol::router::{Audience, Route, Router};
use murmurate::net::transport::udp::{multicast, unicast};
use murmurate::net::transport::{Endpoint, Filter, Transport};
use murmurate::random::Seed;
use murmurate::runtime::clock::Clock;
use murmurate::runtime::real::{Readers, run_real};
use murmurate::runtime::shell::{Mailbox, start};
use murmurate::time::{Span, Time};
use nix::sys::resource::{UsageWho, getrusage};
use nix::time::{ClockId, clock_gettime};
use tracing::info_span;

/// The program's allocator.
#[cfg(all(feature = "mimalloc", target_os = "linux"))]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Flag in the sequence number of a hello.
const HELLO: u32 = 0x8000_0000;
/// Number of floats in a message.
const FLOATS: usize = 32;
/// Periods of the heartbeats of every participant and of the modes of the first one, as of robots and state servers.
const HEARTBEAT: Span = Span::from_millis(200);
const MODE: Span = Span::from_millis(100);
/// Maximum delay of heartbeats and modes, so that they share a wake-up; as of the link's timers.
const MAX_LATE: Span = Span::from_millis(25);
const LINK: LinkId = LinkId(0);
/// Any key: the cost of authentication does not depend on it.
const KEY: [u8; 32] = *b"the key of the messaging harness";

/// Returns this participant's key: that of all, or with `NP_AUTH=sender` those of a member of a team with an operator.
fn key() -> Key {
    team_key().confidential_if(variable("NP_CONFIDENTIAL", 0) == 1)
}

fn team_key() -> Key {
    if variable("NP_AUTH", String::new()) != "sender" {
        return Key::new(KEY);
    }
    let (me, participants) = (variable("NP_ID", 0u16), variable("NP_N", 2u16));
    let members = (0..participants).map(HostId).chain([HostId::operator(1)]);
    let pair = |other: HostId| {
        let mut bytes = KEY;
        let [a, b] = [me.min(other.0), me.max(other.0)].map(u16::to_le_bytes);
        bytes[..4].copy_from_slice(&[a[0], a[1], b[0], b[1]]);
        bytes
    };
    Key::of_member(KEY, members.map(|other| (other, pair(other))).collect())
}

/// Returns the monotonic clock, which the harness uses \[ns\].
fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("every kernel has this clock");
    now.tv_sec() as u64 * 1_000_000_000 + now.tv_nsec() as u64
}

fn sleep_until(ns: u64) {
    std::thread::sleep(Duration::from_nanos(ns.saturating_sub(monotonic_ns())));
}

fn cpu() -> [f64; 2] {
    let usage = getrusage(UsageWho::RUSAGE_SELF).expect("a process may ask for its own usage");
    [usage.user_time(), usage.system_time()].map(|time| time.tv_sec() as f64 + time.tv_usec() as f64 * 1e-6)
}

/// Returns the histogram bin of a delay \[ns\]: 64 bins per octave.
fn step(delay: u64) -> usize {
    let octave = (63 - (delay | 64).leading_zeros() as usize) - 6;
    octave * 64 + (delay >> octave) as usize
}

/// Returns the lower edge of a bin \[ns\].
fn begin_of(step: usize) -> u64 {
    let octave = (step / 64).saturating_sub(1);
    ((step - octave * 64) as u64) << octave
}

fn variable<T: FromStr>(name: &str, default: T) -> T {
    let given = std::env::var(name).ok().filter(|text| !text.is_empty());
    given.map_or(default, |text| {
        text.parse().unwrap_or_else(|_| panic!("{name}={text} is not what the harness sets it to"))
    })
}

/// Reception statistics of one sender.
#[derive(Clone, Default)]
struct Sender {
    heard: bool,
    /// One bit for each sequence number.
    seen: Vec<u64>,
    unique: u64,
    duplicates: u64,
    out_of_order: u64,
    last: Option<u32>,
}

/// A participant: its schedule and its measurements.
struct Peer {
    id: u16,
    rate: f64,
    seconds: f64,
    drain: Span,
    hello: Span,
    start_ns: u64,
    /// Harness clock at the actors' time zero \[ns\].
    zero_ns: u64,
    hellos: u32,
    sent: u32,
    next: Time,
    next_heartbeat: Time,
    next_mode: Time,
    /// Interval in which messages are sent, once it is known.
    window: Option<(Time, Time)>,
    cpu: [f64; 2],
    send_ns: u64,
    mesh_ns: u64,
    senders: Vec<Sender>,
    /// Histogram of delays, by bin.
    delays: Vec<u64>,
    max_ns: u64,
    last_arrival_ns: u64,
}

enum In {
    Arrived(Latent),
    /// Start of the measurement on the harness clock \[ns\].
    Go(u64),
}

impl Peer {
    fn new(id: u16, participants: usize, zero_ns: u64) -> Peer {
        let hello = Span::from_millis(variable("NP_HELLO_MS", 20));
        let first = Span::from_nanos(hello.as_nanos() * u64::from(id) / participants as u64);
        let next = Time::from_nanos(monotonic_ns() - zero_ns) + first;
        let robot = variable("NP_ROBOT", 1) != 0;
        Peer {
            id,
            rate: variable("NP_RATE", 10.0),
            seconds: variable("NP_SECONDS", 3.0),
            drain: Span::from_secs(variable("NP_DRAIN", 1.0)),
            hello,
            start_ns: variable("NP_START_NS", zero_ns),
            zero_ns,
            hellos: 0,
            sent: 0,
            next,
            next_heartbeat: if robot { next } else { Time::MAX },
            next_mode: if robot { next } else { Time::MAX },
            window: None,
            cpu: [0.0; 2],
            send_ns: 0,
            mesh_ns: 0,
            senders: vec![Sender::default(); participants],
            delays: vec![0; step(u64::MAX) + 1],
            max_ns: 0,
            last_arrival_ns: 0,
        }
    }

    fn say(&self, sequence: u32, out: &mut Vec<Wire>) {
        let own = 0.5 * f32::from(self.id + 1);
        let stamp = monotonic_ns() - self.start_ns.min(self.zero_ns);
        let (ms, rest) = ((stamp / 1_000_000) as u32, stamp % 1_000_000);
        out.push(Wire::Latent(Latent {
            robot: RobotId(self.id),
            round: Round { term: ms, episode: sequence },
            phase: Phase::Running,
            motion: Motion {
                position: Vec2::new((sequence & 0xffff) as f32, 0.0),
                velocity: Vec2::new((rest / 1000) as f32, (rest % 1000) as f32),
            },
            features: Features((0..FLOATS).map(|at| own + at as f32).collect()),
            part: None,
        }));
    }

    fn hear(&mut self, latent: &Latent) {
        let now = monotonic_ns();
        let others = self.senders.len() - 1;
        let Some(sender) = self.senders.get_mut(latent.robot.index()) else { return };
        sender.heard = true;
        if self.mesh_ns == 0 && self.senders.iter().filter(|sender| sender.heard).count() == others {
            self.mesh_ns = now;
        }
        let sequence = latent.round.episode;
        if sequence & HELLO != 0 {
            return;
        }
        let sender = &mut self.senders[latent.robot.index()];
        let (word, bit) = ((sequence / 64) as usize, 1 << (sequence % 64));
        if word >= sender.seen.len() {
            sender.seen.resize((word + 1).next_power_of_two().max(1024), 0);
        }
        if sender.seen[word] & bit != 0 {
            sender.duplicates += 1;
            return;
        }
        sender.seen[word] |= bit;
        sender.unique += 1;
        if sender.last.is_some_and(|last| sequence < last) {
            sender.out_of_order += 1;
        }
        sender.last = sender.last.max(Some(sequence));
        let velocity = latent.motion.velocity;
        let stamp = u64::from(latent.round.term) * 1_000_000 + velocity.x as u64 * 1000 + velocity.y as u64;
        let delay = now.saturating_sub(stamp + self.start_ns.min(self.zero_ns));
        self.delays[step(delay)] += 1;
        self.max_ns = self.max_ns.max(delay);
        self.last_arrival_ns = now;
    }

    /// Returns the due time of message number `sent`.
    fn due(&self, begin: Time) -> Time {
        if self.rate <= 0.0 {
            return self.next;
        }
        let step_ns = 1e9 / self.rate;
        let offset = step_ns * (f64::from(self.sent) + f64::from(self.id) / self.senders.len() as f64);
        begin + Span::from_nanos(offset as u64)
    }

    /// Sends what is due by `now`.
    fn send(&mut self, now: Time, out: &mut Vec<Wire>) {
        let Some((begin, end)) = self.window else {
            self.say(HELLO | self.hellos, out);
            self.hellos += 1;
            self.next += self.hello;
            return;
        };
        if self.cpu == [0.0; 2] {
            self.cpu = cpu();
        }
        if self.rate < 0.0 || self.due(begin) >= end || now >= end {
            self.next = Time::MAX;
            return;
        }
        // At the maximum rate: a burst of messages, then received datagrams are handled.
        for _ in 0..if self.rate == 0.0 { 16 } else { 1 } {
            self.say(self.sent, out);
            self.sent += 1;
        }
        self.send_ns = now.since(begin).as_nanos();
        self.next = if self.rate == 0.0 { now + Span::from_nanos(1) } else { self.due(begin) };
        if self.next >= end {
            self.next = Time::MAX;
        }
    }

    fn is_over(&self, now: Time) -> bool {
        self.window.is_some_and(|(_, end)| now >= end + self.drain)
    }

    /// Formats the result file, which the harness reads.
    fn result(&self) -> String {
        let now = cpu();
        let begin_ns = self.window.map_or(0, |(begin, _)| begin.as_nanos() + self.zero_ns);
        let mut text = format!(
            "mesh {}\nsent {} 0 {}\ncpu {:.6} {:.6}\nmax {}\nlastrx {}\n",
            self.mesh_ns,
            self.sent,
            self.send_ns,
            now[0] - self.cpu[0],
            now[1] - self.cpu[1],
            self.max_ns,
            self.last_arrival_ns.saturating_sub(begin_ns)
        );
        for (id, sender) in self.senders.iter().enumerate().filter(|(id, _)| *id != usize::from(self.id)) {
            writeln!(text, "from {id} {} {} {}", sender.unique, sender.duplicates, sender.out_of_order)
                .expect("text grows");
        }
        for (step, count) in self.delays.iter().enumerate().filter(|(_, count)| **count > 0) {
            writeln!(text, "h {} {count}", begin_of(step)).expect("text grows");
        }
        text + "end\n"
    }
}

impl Core for Peer {
    type In = In;
    type Out = Wire;

    fn handle(&mut self, now: Time, input: In, _: &mut Vec<Wire>) {
        match input {
            In::Arrived(latent) => self.hear(&latent),
            In::Go(ns) => {
                let begin = Time::from_nanos(ns - self.zero_ns);
                self.window = Some((begin, begin + Span::from_secs(self.seconds)));
                self.next = if self.rate > 0.0 { self.due(begin) } else { begin.max(now) };
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        Some(self.next.min(self.next_heartbeat).min(self.next_mode))
    }

    fn tolerance(&self, _: Span) -> Span {
        // Messages are sent on time; a heartbeat or a mode may be delayed to share a wake-up.
        let soft = self.next_heartbeat.min(self.next_mode);
        if self.next > soft { self.next.since(soft).min(MAX_LATE) } else { Span::ZERO }
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Wire>) {
        let (round, phase, latch) = (Round { term: 1, episode: 0 }, Phase::Running, Latch::default());
        if self.next <= now {
            self.send(now, out);
        }
        if self.next_heartbeat <= now {
            self.next_heartbeat = now + HEARTBEAT;
            out.push(Wire::Heartbeat(Heartbeat::new(RobotId(self.id), round, phase, latch)));
        }
        if self.next_mode <= now {
            self.next_mode = if self.id == 0 { now + MODE } else { Time::MAX };
            let tasks = vec![Task { start: Vec2::zeros(), goal: Vec2::zeros() }; self.senders.len()].into();
            if self.id == 0 {
                out.push(Wire::Mode(Mode { round, repeat: 0, phase, first: RobotId(0), tasks, latch }));
            }
        }
    }
}

fn main() {
    let (id, participants): (u16, usize) = (variable("NP_ID", 0), variable("NP_N", 2));
    let folder: PathBuf = variable("NP_DIR", PathBuf::from("."));
    sleep_until(variable("NP_START_NS", 0));
    let open = endpoint(id)
        .open(HostId(id), Filter::Team { number: 1, tagged: true })
        .unwrap_or_else(|error| panic!("{error}"));
    let (origin, zero_ns) = (Instant::now(), monotonic_ns());
    let peer = Rc::new(RefCell::new(Peer::new(id, participants, zero_ns)));
    let record = Record::open(id, participants);
    let (mut ready, mut told) = (false, false);
    run_real(
        origin,
        |clock, readers| wire(clock, readers, open, (&peer, &record), (id, participants)),
        |mailbox, now| {
            record.turn(now);
            let (mesh_ns, going, over) = {
                let peer = peer.borrow();
                (peer.mesh_ns, peer.window.is_some(), peer.is_over(now))
            };
            if mesh_ns != 0 && !ready {
                ready = true;
                put(&folder, id, "ready", &format!("{mesh_ns}\n"));
            }
            if !going && !told {
                let go = fs::read_to_string(folder.join("go")).ok().and_then(|text| text.trim().parse().ok());
                if let Some(ns) = go {
                    told = true;
                    mailbox.send(In::Go(ns));
                }
            }
            over
        },
    );
    put(&folder, id, "out", &peer.borrow().result());
}

/// Whether messages go to each participant by itself, and not to a group.
fn is_unicast() -> bool {
    variable("NP_VARIANT", String::new()) == "uni"
}

/// Returns the endpoint of a participant: in a multicast group, or at its own address.
fn endpoint(id: u16) -> Arc<dyn Endpoint> {
    const PORT: u16 = 45_451;
    let interface = variable("NP_IFACE", "lo".to_owned());
    if !is_unicast() {
        return multicast::endpoint((Ipv4Addr::new(239, 192, 7, 8), PORT).into(), &interface, 4 << 20);
    }
    let addresses = variable("NP_PEERS", String::new());
    let at = |text: &str| text.parse::<IpAddr>().unwrap_or_else(|_| panic!("NP_PEERS={addresses} has no addresses"));
    let mut peers: BTreeMap<HostId, SocketAddr> =
        (0..).map(HostId).zip(addresses.split(',').map(|text| SocketAddr::from((at(text), PORT)))).collect();
    let own = peers.remove(&HostId(id)).unwrap_or_else(|| panic!("NP_PEERS={addresses} has no entry {id}"));
    unicast::endpoint(own, peers, &interface, 4 << 20)
}

/// Record of a participant, as a host makes it; none unless `NP_RECORD` names a folder.
#[derive(Clone)]
struct Record(Option<Rc<murmurate_record::queue::Inlet>>);

impl Record {
    fn open(id: u16, participants: usize) -> Record {
        use murmurate_record::Scope;
        use murmurate_record::file::Beginning;
        use murmurate_record::identity::Identity;
        use murmurate_record::queue::WhenFull;
        use murmurate_record::series::Retention;
        use murmurate_record::stage::Stage;
        use murmurate_record::topics::Topics;
        use murmurate_record::writer::Recording;
        let Some(folder) = std::env::var_os("NP_RECORD").map(PathBuf::from) else { return Record(None) };
        let stage = Stage {
            scenario: String::new(),
            mode: String::new(),
            hosts: (0..participants).map(|host| format!("peer-{host}")).collect(),
            homes: (0..participants as u16).map(HostId).collect(),
            robots: participants,
            half_extent: [1.0; 2],
            walls: Vec::new(),
            unlabelled: false,
            hull_m: 0.2,
            range_m: None,
            drawn: Vec::new(),
            movers: Vec::new(),
            waypoints: Vec::new(),
            senses: Vec::new(),
        };
        let beginning = Beginning { identity: Identity::here("1f", Vec::new(), ""), attached: Vec::new() };
        let path = folder.join(format!("peer-{id}-{:016x}.mcap", monotonic_ns()));
        let topics = Topics::new(stage, Scope::Host, 0);
        let kept = (WhenFull::Drop, Retention::default());
        let recording = Recording::start(&path, &beginning, topics, kept).unwrap_or_else(|error| panic!("{error}"));
        Record(Some(recording.inlet()))
    }

    /// Notes what the Network says, with what its host would record of it.
    fn note(&self, said: event::Event) {
        use murmurate::graph::inputs::Input;
        use murmurate_record::Event;
        let Some(inlet) = &self.0 else { return };
        match said {
            event::Event::Published(frame) => inlet.push(Event::Published(HostId(0), frame.clone())),
            event::Event::Sent(link, frame) => inlet.push(Event::Sent(link, frame.clone())),
            event::Event::Message(message) => {
                // The datagram that has brought it: as many bytes.
                inlet.push(Event::Input(Input::Frame(LINK, ARRIVED.with(Clone::clone), None)));
                inlet.push(Event::Delivered(message.clone()));
            }
            _ => {}
        }
    }

    fn turn(&self, now: Time) {
        self.0.iter().for_each(|inlet| inlet.turn(now));
    }
}

thread_local! {
    /// Bytes of a datagram with a latent and a tag.
    static ARRIVED: murmurate::net::protocol::codec::Frame = vec![0u8; 195].into();
}

/// Replaces a file atomically.
fn put(folder: &std::path::Path, id: u16, name: &str, text: &str) {
    let temporary = folder.join(format!(".tmp.{id}"));
    fs::write(&temporary, text).expect("the harness's folder can be written");
    fs::rename(&temporary, folder.join(format!("{name}.{id}"))).expect("the harness's folder can be written");
}

/// Starts the actors: Network, transport and peer.
fn wire(
    clock: &Clock,
    readers: &mut Readers,
    open: Box<dyn Transport>,
    (peer, record): (&Rc<RefCell<Peer>>, &Record),
    (id, participants): (u16, usize),
) -> Mailbox<In> {
    let to_peer = Mailbox::<In>::new("peer");
    let router = Router::new(participants, |kind, robot| {
        let own = robot == RobotId(id);
        let (local, leaves) = match kind {
            Kind::Latent => (!own, own),
            Kind::Heartbeat => (id == 0, own && id != 0),
            Kind::Mode => (true, id == 0),
            _ => (false, false),
        };
        Route { local, leaves: leaves.then_some((LINK, Audience::All)) }
    });
    let mode = if variable("NP_REPEAT", 1) == 0 { Reliability::BestEffort } else { Reliability::Repeat };
    let reliability = Reliabilities::from([(Kind::Latent, mode)]);
    let setup = if is_unicast() { Setup::unicast(reliability) } else { Setup::multicast(reliability) };
    let end = HostEnd {
        me: network::Identity { host: HostId(id), team: 1, incarnation: 1 },
        key: Some(key()),
        seed: Seed::of_run(u64::from(id)),
        links: vec![Some(setup)],
        keep: None,
        transports: vec![(LINK, open)],
    };
    let inward = to_peer.clone();
    let record = record.clone();
    let network = end.open((clock, readers), router, move |said| {
        record.note(said);
        if let event::Event::Message(Wire::Latent(latent)) = said {
            inward.send(In::Arrived(latent.clone()));
        }
    });
    let peer = Rc::clone(peer);
    let make = move |_| Shared(Rc::clone(&peer));
    start(clock, &to_peer, info_span!("peer"), make, move |message| network.send(network::In::Publish(message)));
    to_peer
}
