//! Captured members of a team: an attacker with the key file of one host, a robot's or the state server's, prevents no
//! stop and ends none.
//!
//! `MURMURATE_CAPTURED="500 30000"` makes so many stops beside so many forged datagrams a second, and
//! `MURMURATE_ROUTER=udp/127.0.0.1:7447` names a Zenoh router for the test through one.

use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use murmurate::actors::network;
use murmurate::actors::network::Identity;
use murmurate::graph::end::HostEnd;
use murmurate::graph::event::Event;
use murmurate::messages::geometry::{Motion, Task, Vec2};
use murmurate::messages::ids::{HostId, LinkId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{
    Features, Following, Heartbeat, Latent, Leading, Mode, MotorCommand, Phase, Reading, Release, Round, Signature,
    Status, Stop, Wire,
};
use murmurate::net::protocol::codec::{self, Flags, Header};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::reliability::{Reliabilities, Setup};
use murmurate::net::protocol::router::{Audience, Route, Router};
use murmurate::net::transport::udp::{multicast, unicast};
use murmurate::net::transport::{self, Endpoint, Filter, Transmit, Transport};
use murmurate::random::{Seed, Stream};
use murmurate::runtime::clock::Clock;
use murmurate::runtime::real::run_real;
use murmurate::runtime::shell::Mailbox;
use murmurate::time::{Span, Time};
use murmurate_zenoh::{SessionConfig, Streams};
use nix::sys::signal::Signal;
use rand::RngExt;

use crate::alone;
use crate::crew::{Crew, Said, of_members, report};
use crate::kill::{self, ROBOTS};
use crate::program::lateness::Lateness;
use crate::program::skip::skip;
use crate::program::{run, text};

const TEAM: u16 = 793;
const HOSTS: [&str; 5] = ["agent-0", "agent-1", "agent-2", "world", "server"];
const ROBOT: HostId = HostId(1);
const SERVER: HostId = HostId(4);
const OPERATOR: HostId = HostId::operator(1);
/// Period at which a captured member speaks.
const PERIOD: Span = Span::from_millis(5);
/// Time for which a stopped team is attacked.
const ATTACKED: Duration = Duration::from_millis(1000);

/// How the hosts of a team reach each other on the link of the stop.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Link {
    Multicast,
    Unicast,
    Zenoh,
}

impl Link {
    /// Number of the team, from which its ports are.
    fn team(self) -> u16 {
        TEAM + self as u16
    }

    fn group(self) -> SocketAddrV4 {
        SocketAddrV4::new(Ipv4Addr::new(239, 255, 79, 1), 40_000 + self.team())
    }

    /// Returns where a host listens on a unicast link.
    fn at(self, host: HostId) -> SocketAddrV4 {
        SocketAddrV4::new(Ipv4Addr::LOCALHOST, 41_900 + host.0)
    }

    /// Returns where datagrams for the hosts of the team go.
    fn targets(self) -> Vec<SocketAddrV4> {
        match self {
            Link::Multicast => vec![self.group()],
            Link::Unicast => (0..5).map(|host| self.at(HostId(host))).collect(),
            Link::Zenoh => Vec::new(),
        }
    }

    fn open(self, host: HostId) -> (Setup, Box<dyn Transport>) {
        let none = Reliabilities::new;
        let (setup, endpoint) = match self {
            Link::Multicast => (Setup::multicast(none()), multicast::endpoint(self.group().into(), "lo", 4 << 20)),
            Link::Unicast => {
                let peers = (0..5).map(HostId).filter(|other| *other != host);
                let peers = peers.map(|other| (other, self.at(other).into())).collect();
                (Setup::unicast(none()), unicast::endpoint(self.at(host).into(), peers, "lo", 4 << 20))
            }
            Link::Zenoh => {
                let session = SessionConfig {
                    key: format!("murmurate/{}/loopback", self.team()),
                    mode: Some("client".to_owned()),
                    connect: router().into_iter().collect(),
                    listen: Vec::new(),
                    config: None,
                    streams: Streams::Refuse,
                    guest: false,
                };
                (session.setup(none()), Arc::new(session) as Arc<dyn Endpoint>)
            }
        };
        let open = endpoint.open(host, Filter::All).expect("it can be opened");
        (Setup { report_piggyback_age: Span::ZERO, ..setup }, open)
    }
}

/// Returns where a Zenoh router listens, if there is one.
fn router() -> Option<String> {
    std::env::var("MURMURATE_ROUTER").ok()
}

/// Sends datagrams to all hosts of the team.
struct Sender {
    link: Link,
    socket: UdpSocket,
    session: Option<Box<dyn Transport>>,
}

impl Sender {
    fn open(link: Link, host: HostId) -> Sender {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).expect("a socket");
        socket.set_multicast_loop_v4(true).expect("loopback");
        let interface: socket2::Socket = socket.try_clone().expect("a copy").into();
        interface.set_multicast_if_v4(&Ipv4Addr::LOCALHOST).expect("the loopback interface");
        Sender { link, socket, session: (link == Link::Zenoh).then(|| link.open(host).1) }
    }

    fn send(&mut self, from: HostId, frame: &[u8]) {
        self.link.targets().iter().for_each(|to| drop(self.socket.send_to(frame, to)));
        if let Some(session) = &mut self.session {
            let transmit = Transmit { from, audience: Audience::All, frame: frame.into() };
            session.handle(Time::ZERO, transport::In::Transmit(transmit));
        }
    }
}

/// State that a captured member has heard, and releases that it has recorded, which it keeps for its next runs.
#[derive(Default)]
struct Heard {
    round: Round,
    latch: Latch,
    releases: Vec<Release>,
}

/// Captured member: it does what its host does until it attacks.
struct Captured {
    attacks: Arc<AtomicBool>,
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Captured {
    /// Takes the place of the host `host`, with its key file, and forges `rate` datagrams a second while it attacks.
    fn start(
        link: Link,
        (host, file): (HostId, PathBuf),
        (rate, seed): (u64, u64),
        heard: &Arc<Mutex<Heard>>,
    ) -> Captured {
        let (attacks, over) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let key = murmurate_robot::key::read(&file).expect("a key file").key();
        let forger = {
            let (attacks, over, key) = (Arc::clone(&attacks), Arc::clone(&over), key.clone());
            thread::spawn(move || forge(link, (host, &key), (rate, seed), (&attacks, &over)))
        };
        let member = {
            let (attacks, over, heard) = (Arc::clone(&attacks), Arc::clone(&over), Arc::clone(heard));
            thread::spawn(move || speak(link, (host, key), seed, &heard, (attacks, over)))
        };
        Captured { attacks, over, threads: vec![forger, member] }
    }

    fn attack(&self) {
        self.attacks.store(true, Ordering::Relaxed);
    }

    fn end(self) {
        self.over.store(true, Ordering::Relaxed);
        self.threads.into_iter().for_each(|thread| thread.join().expect("it has ended well"));
    }
}

/// Sends datagrams in the names of others, with tags by the keys of `host`, and its own ones with numbers far ahead.
fn forge(
    link: Link,
    (host, key): (HostId, &Key),
    (rate, seed): (u64, u64),
    (attacks, over): (&AtomicBool, &AtomicBool),
) {
    let mut sender_to_all = Sender::open(link, host);
    let mut stream = Seed::of_run(seed).stream("forger");
    let (mut sent, began) = (0u64, Instant::now());
    while !over.load(Ordering::Relaxed) {
        if !attacks.load(Ordering::Relaxed) || sent > began.elapsed().as_micros() as u64 * rate / 1_000_000 {
            thread::yield_now();
            continue;
        }
        sent += 1;
        let names = [OPERATOR, SERVER, ROBOT, HostId(0), HostId(3), host];
        let sender = names[stream.random_range(0..names.len())];
        let far = [1, 200, 1 << 20, 1 << 30][stream.random_range(0..4usize)];
        let sequence = (sent as u32).wrapping_add(far);
        let header = Header { flags: Flags(0), team: link.team(), sender, incarnation: stream.random(), sequence };
        let lie = lie(&mut stream, (sender, Round::default(), Latch::default()), &[]);
        let Ok(frame) = codec::encode(&header, &lie) else { continue };
        let mut frame = frame.to_vec();
        key.seal(&mut frame, LinkId(0), None);
        sender_to_all.send(host, &frame);
    }
    // A session drops what it has no room for.
    let unsent = sender_to_all.session.as_ref().map_or(0, |session| session.counts().unsent);
    assert!(2 * unsent <= sent, "{unsent} of {sent} forged datagrams were not sent: forge fewer");
}

/// Returns a lie: a message that belongs to another member, or one with a lesser latch.
fn lie(stream: &mut Stream, (by, round, latch): (HostId, Round, Latch), releases: &[Release]) -> Wire {
    let next = [Stop::rearm(by, latch).latch, Stop::resume(by, latch).latch];
    let lesser = [next[0], next[1], Latch::clear(0), Latch::clear(1 << 40), Latch::held(1 << 40)];
    let lesser = lesser[stream.random_range(0..lesser.len())];
    let robot = RobotId(stream.random_range(0..3));
    let task = Task { start: Vec2::zeros(), goal: Vec2::new(1.0, 1.0) };
    let far = Round { term: round.term + stream.random_range(0..2), episode: round.episode + 1 };
    match stream.random_range(0..11u8) {
        0 => Wire::Heartbeat(Heartbeat::new(robot, far, Phase::Running, lesser)),
        1 => Wire::Mode(mode(far, lesser, task)),
        2 => Wire::Stop(Stop { by, latch: lesser }),
        3 => Wire::Stop(Stop { by: OPERATOR, latch: lesser }),
        4 => {
            let robots = ROBOTS.map(|n| Following { robot: RobotId(n), controller: Some(lesser), body: Some(lesser) });
            let leading = Some(Leading { latch: lesser, hindrances: Vec::new() });
            Wire::Status(Status::of(by, false, robots.to_vec(), leading))
        }
        5 => {
            let velocity = Vec2::new(1.0, 0.0);
            Wire::MotorCommand(MotorCommand { robot, velocity, valid_for: Span::from_millis(1000) })
        }
        6 => Wire::Reading(Reading::of_point(robot, 1 << 40, Motion::default())),
        7 => Wire::Latent(Latent {
            robot,
            round: far,
            phase: Phase::Running,
            motion: Motion::default(),
            features: Features(vec![1e5; 32].into()),
            part: None,
        }),
        8 => Wire::Status(Status::of(by, true, Vec::new(), None)),
        9 if !releases.is_empty() => Wire::Release(releases[stream.random_range(0..releases.len())].clone()),
        _ => {
            let hosts = (0..5).map(|host| (HostId(host), stream.random())).collect();
            Wire::Release(Release { by: OPERATOR, latch: lesser, hosts, signature: Signature([7; 64]) })
        }
    }
}

fn mode(round: Round, latch: Latch, task: Task) -> Mode {
    Mode { round, repeat: 0, phase: Phase::Running, first: RobotId(0), tasks: [task; 3].into(), latch }
}

/// Returns a message of the captured host for which the team goes on driving.
fn usual(host: HostId, now: Time, heard: &Heard) -> Wire {
    if host == ROBOT {
        return Wire::Heartbeat(Heartbeat::new(RobotId(1), heard.round, Phase::Running, heard.latch));
    }
    // Another goal every two seconds, on one side of the wall and then on the other.
    let turn = (now.as_nanos() / 2_000_000_000) as u32;
    let round = Round { term: heard.round.term.max(1) + 1, episode: turn + 1 };
    let side = if turn.is_multiple_of(2) { 1.5 } else { -1.5 };
    let mut mode = mode(round, heard.latch, Task { start: Vec2::zeros(), goal: Vec2::zeros() });
    let at = |robot: usize, y: f32| Vec2::new(robot as f32 - 1.0, y);
    let goal = |robot: usize| Task { start: at(robot, -side), goal: at(robot, side) };
    mode.tasks = (0..3).map(goal).collect();
    Wire::Mode(mode)
}

fn speak(
    link: Link,
    (host, key): (HostId, Key),
    seed: u64,
    heard: &Arc<Mutex<Heard>>,
    (attacks, over): (Arc<AtomicBool>, Arc<AtomicBool>),
) {
    let (setup, open) = link.open(host);
    let mut bytes = [0; 32];
    getrandom::fill(&mut bytes).expect("there are random numbers");
    let incarnation = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let end = HostEnd {
        me: Identity { host, team: link.team(), incarnation },
        key: Some(key),
        seed: Seed::of_bytes(bytes),
        links: vec![Some(setup), None],
        keep: None,
        transports: vec![(LinkId(0), open)],
    };
    let router = Router::new(3, |_, _| Route { local: true, leaves: Some((LinkId(0), Audience::All)) });
    let (noted, said) = (Arc::clone(heard), Arc::clone(heard));
    let mut stream = Seed::of_run(seed).stream("member");
    let mut next = Time::ZERO;
    run_real(
        Instant::now(),
        |clock, readers| {
            let network = end.open((clock, readers), router, move |event| {
                let mut heard = noted.lock().expect("nobody panics");
                match event {
                    Event::Message(Wire::Mode(mode)) if host == ROBOT => {
                        (heard.round, heard.latch) = (mode.round, mode.latch);
                    }
                    Event::Message(Wire::Heartbeat(beat)) if host == SERVER => {
                        (heard.round.term, heard.latch) = (heard.round.term.max(beat.round.term), beat.latch);
                    }
                    Event::Message(Wire::Release(release)) if !heard.releases.contains(release) => {
                        heard.releases.push(release.clone());
                    }
                    _ => {}
                }
            });
            tick(clock);
            network
        },
        |network: &Mailbox<network::In>, now| {
            while next <= now {
                let heard = said.lock().expect("nobody panics");
                let message = match attacks.load(Ordering::Relaxed) {
                    true => lie(&mut stream, (host, heard.round, heard.latch), &heard.releases),
                    false => usual(host, now, &heard),
                };
                network.send(network::In::Publish(message));
                next += PERIOD;
            }
            over.load(Ordering::Relaxed)
        },
    );
}

/// Makes the loop turn at least so often, whatever arrives.
fn tick(clock: &Clock) {
    let again = clock.clone();
    clock.call(clock.now() + PERIOD, Box::new(move || tick(&again)));
}

/// Team whose members have keys of their own.
struct Team {
    crew: Crew,
    file: String,
    folder: tempfile::TempDir,
}

impl Team {
    fn start(link: Link) -> Team {
        // A robot that was led astray need not find its way back.
        let mut written = kill::team(link.team()).replace("placement = \"drive\"", "placement = \"exact\"");
        assert!(written.contains("exact"));
        if link == Link::Unicast {
            let peers = (0..).map(HostId).zip(HOSTS).map(|(host, name)| format!("{name} = \"{}\"", link.at(host)));
            let peers = peers.collect::<Vec<_>>().join(", ");
            let group = format!("group = \"{}\"", link.group());
            let unicast = format!("transport = \"unicast\"\npeers = {{ {peers} }}");
            assert!(written.contains(&group));
            written = written.replace(&group, &unicast);
        }
        if link == Link::Zenoh {
            let group = format!("interface = \"lo\"\ngroup = \"{}\"", link.group());
            assert!(written.contains(&group));
            let router = router().expect("the test was not skipped");
            written = written.replace(&group, &format!("transport = \"zenoh\"\nconnect = \"{router}\""));
        }
        let (crew, folder, file) = of_members(&written, &HOSTS);
        Team { crew, file, folder }
    }

    fn key_file(&self, name: &str) -> PathBuf {
        Path::new(self.folder.path()).join("keys").join(format!("{name}.key"))
    }

    /// Waits until each of these robots was driven at least once from now on.
    fn driven(&self, robots: &[u16]) {
        let mut waiting = robots.to_vec();
        self.crew.row("robots are driven", |row, _| {
            waiting.retain(|robot| !(*robot == row.robot && row.is_driven()));
            waiting.is_empty().then_some(())
        });
    }

    /// Stops the team while it is attacked. Returns for how long after the start of the operator's process robots were
    /// driven at most, and what of that is the machine's.
    fn stop(&self, captured: &Captured) -> (Duration, Duration) {
        let began = Instant::now();
        assert!(run(&["--version"]).status.success());
        let (start, lateness) = (began.elapsed(), Lateness::watch());
        captured.attack();
        let began = Instant::now();
        let output = run(&["stop", &self.file, "--json"]);
        // A captured robot need not confirm.
        assert!(matches!(output.status.code(), Some(0 | 1)), "{}", text(&output.stderr));
        let until = Instant::now() + ATTACKED;
        let mut last = began;
        self.crew.until("the attack goes on", |heard| {
            if let Said::Row(row) = &heard.said
                && row.is_driven()
            {
                last = last.max(heard.at);
            }
            (heard.at >= until).then_some(())
        });
        (last - began, start + lateness.end())
    }

    fn succeeds(&self, args: &[&str]) {
        let output = run(args);
        assert_eq!(output.status.code(), Some(0), "{args:?}: {}", text(&output.stderr));
    }
}

/// Returns how many stops to make, and how many datagrams a second to forge.
fn size() -> (u64, u64) {
    let Ok(size) = std::env::var("MURMURATE_CAPTURED") else { return (4, 2000) };
    let numbers: Vec<u64> = size.split(' ').map(|word| word.parse().expect("two numbers")).collect();
    (numbers[0], numbers[1])
}

/// Captures the state server and a robot in turn, and stops the team while they attack.
fn stops_hold(link: Link) {
    let _alone = alone();
    let (stops, rate) = size();
    let mut team = Team::start(link);
    let heard = Arc::new(Mutex::new(Heard::default()));
    let mut worst = Duration::ZERO;
    for turn in 0..stops {
        let (host, name) = if turn.is_multiple_of(2) { (SERVER, "server") } else { (ROBOT, "agent-1") };
        team.driven(&ROBOTS);
        team.crew.signal(name, Signal::SIGKILL);
        team.crew.ended(name);
        let captured = Captured::start(link, (host, team.key_file(name)), (rate, turn), &heard);
        // It is believed once its host has been silent for a while.
        team.crew.pass(Duration::from_millis(800));
        // A captured robot is not driven.
        team.driven(if host == ROBOT { &[0, 2] } else { &ROBOTS });
        let (moved, machine) = team.stop(&captured);
        report(&format!("{name} captured: robots were driven for {moved:.0?} after the order, machine {machine:.0?}"));
        assert!(moved <= Duration::from_millis(500) + 2 * machine, "{name} captured: {moved:?}, machine {machine:?}");
        worst = worst.max(moved);
        captured.end();
        team.crew.start(name);
        team.crew.ready(&[name]);
        team.succeeds(&["stop", &team.file, "--rearm"]);
        team.succeeds(&["resume", &team.file]);
    }
    team.driven(&ROBOTS);
    let releases = heard.lock().expect("nobody panics").releases.len();
    report(&format!(
        "{link:?}: {stops} stops beside {rate} forged datagrams/s, {releases} releases recorded: {worst:.0?} at most"
    ));
}

#[test]
fn a_captured_robot_or_state_server_prevents_no_stop_and_ends_none() {
    stops_hold(Link::Multicast);
}

#[test]
fn nor_does_one_on_a_unicast_link() {
    stops_hold(Link::Unicast);
}

#[test]
fn nor_does_one_through_a_zenoh_router() {
    if router().is_none() || !murmurate_zenoh::BUILT {
        return skip("zenoh", "there is no Zenoh router, or the program is built without Zenoh");
    }
    stops_hold(Link::Zenoh);
}
