//! Links that choose: which way they take on an emulated radio, what arrives in time, and what it costs.
//!
//! `AUTO_FULL=1 cargo test --release --test link auto:: -- --nocapture` makes the tables of docs/auto.md.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::rig::{Rig, config, key, network_of_run};
use murmurate::actor::Core;
use murmurate::actors::network::Out;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::wire::{Features, Kind, Latent, Phase, Round, Wire};
use murmurate::net::media::radio::{Channel, Radio, Topology};
use murmurate::net::protocol::choice::{Choosing, Way};
use murmurate::net::protocol::codec::{self, Content, FLAGS_AT, Flags, Frame};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::reliability::{Reliabilities, Setup};
use murmurate::net::protocol::router::Audience;
use murmurate::random::{RngExt, Seed, Stream};
use murmurate::time::{Span, Time};

/// Time within which a state is of use.
const IN_TIME: Span = Span::from_millis(20);
/// Period of states, and the largest deviation from it either way \[ns\].
const PERIOD: Span = Span::from_millis(50);
const JITTER_NS: u64 = 500_000;

/// Team and channel.
#[derive(Clone, Copy, Debug)]
struct Cell {
    hosts: u16,
    /// Rate of multicast frames, by its name.
    rate: &'static str,
    noise: f64,
    /// Whether members have keys of their own, so that a state has a tag for each of them.
    members: bool,
    /// Whether all states are said at the same instants.
    lockstep: bool,
}

const CELL: Cell = Cell { hosts: 5, rate: "ofdm-24", noise: 0.16, members: false, lockstep: false };

impl Cell {
    fn radio(&self) -> Radio {
        let basic_rate = self.rate.parse().expect("a rate of the table");
        Radio { channel: Topology::AdHoc, basic_rate, noise_loss: self.noise, ..Radio::default() }
    }

    fn key(&self, host: u16) -> Key {
        let pair = |other: u16| {
            let mut bytes = [3; 32];
            bytes[..2].copy_from_slice(&[host.min(other) as u8, host.max(other) as u8]);
            bytes
        };
        // The members are the hosts, and an operator.
        let others = (0..self.hosts).chain([HostId::operator(1).0]).map(|other| (HostId(other), pair(other)));
        if self.members { Key::of_member([9; 32], others.collect()) } else { key() }
    }
}

/// Results of the states of a team.
#[derive(Clone, Copy, Debug, Default)]
struct Told {
    /// States that left, for each host that should have them, and those that came in time.
    wanted: u64,
    in_time: u64,
    /// Time with something on the air \[s\], and the part of it that is no state.
    airtime_s: f64,
    beside_s: f64,
    /// Time that was looked at \[s\], and the hosts that took part, for each second \[s\].
    passed_s: f64,
    hosts_s: f64,
    states: u64,
}

impl Told {
    fn share(&self) -> f64 {
        self.in_time as f64 / self.wanted.max(1) as f64
    }

    fn airtime(&self) -> f64 {
        self.airtime_s / self.passed_s
    }

    fn beside(&self) -> f64 {
        self.beside_s / self.passed_s
    }

    fn hz(&self) -> f64 {
        self.states as f64 / self.hosts_s
    }

    fn add(&mut self, other: Told) {
        self.wanted += other.wanted;
        self.in_time += other.in_time;
        self.airtime_s += other.airtime_s;
        self.beside_s += other.beside_s;
        self.passed_s += other.passed_s;
        self.hosts_s += other.hosts_s;
        self.states += other.states;
    }
}

/// Hosts that say states on a radio channel.
struct Team {
    cell: Cell,
    rig: Rig,
    next: Vec<Time>,
    said: Vec<Vec<Time>>,
    stream: Stream,
}

impl Team {
    fn new(cell: Cell, choosing: Choosing, seed: u64) -> Team {
        let setup = Setup { choosing, spread: cell.lockstep, ..Setup::multicast(Reliabilities::new()) };
        let hosts = usize::from(cell.hosts);
        let of = |host| config(host, hosts, 1, Some(cell.key(host)), setup.clone());
        let mut rig = Rig::new((0..cell.hosts).map(of));
        rig.radio = Some(Channel::new(cell.radio(), cell.hosts, &Seed::of_run(seed)));
        let mut stream = Seed::of_run(seed).stream("auto");
        let first = (0..hosts).map(|_| Time::ZERO + Span::from_nanos(stream.random_range(0..PERIOD.as_nanos())));
        let next = if cell.lockstep { vec![Time::ZERO + PERIOD; hosts] } else { first.collect() };
        Team { cell, rig, next, said: vec![Vec::new(); hosts], stream }
    }

    /// Puts the team on another channel, with the first `active` hosts alone.
    fn change(&mut self, cell: Cell, active: u16, seed: u64) {
        self.cell = Cell { hosts: self.cell.hosts, ..cell };
        self.rig.radio = Some(Channel::new(self.cell.radio(), self.cell.hosts, &Seed::of_run(seed)));
        self.rig.off = (usize::from(active)..usize::from(self.cell.hosts)).collect();
    }

    fn state(&mut self, robot: u16) -> Wire {
        let said = &mut self.said[usize::from(robot)];
        said.push(self.rig.now);
        let (round, phase) = (Round { term: 1, episode: said.len() as u32 - 1 }, Phase::Running);
        let features = Features((0..32).map(|_| self.stream.random_range(-1.0..1.0)).collect::<Arc<[f32]>>());
        let motion = Motion { position: Vec2::new(1.25, -0.5), velocity: Vec2::new(0.3, 0.1) };
        Wire::Latent(Latent { robot: RobotId(robot), round, phase, motion, features, part: None })
    }

    /// Lets a time pass, and says what came of the states in it. Those of its last 20 ms are left out.
    fn run(&mut self, time: Span) -> Told {
        let (begin, end) = (self.rig.now, self.rig.now + time);
        let airtime = |rig: &Rig| 1e-9 * rig.radio.as_ref().expect("it has one").counts(rig.now).airtime_ns as f64;
        let before = airtime(&self.rig);
        self.rig.sent.clear();
        self.rig.delivered.iter_mut().for_each(Vec::clear);
        loop {
            let (at, host) = self.next.iter().copied().zip(0_u16..).min().expect("there are hosts");
            self.rig.run_to(at.min(end));
            if at > end {
                break;
            }
            let jitter = if self.cell.lockstep { JITTER_NS } else { self.stream.random_range(0..2 * JITTER_NS) };
            self.next[usize::from(host)] = at + (PERIOD - Span::from_nanos(JITTER_NS)) + Span::from_nanos(jitter);
            if !self.rig.off.contains(&usize::from(host)) {
                let state = self.state(host);
                self.rig.publish(usize::from(host), state);
            }
        }
        let (airtime_s, passed_s) = (airtime(&self.rig) - before, time.as_secs());
        let (left, beside_s) = self.left();
        let hosts = self.said.len() - self.rig.off.len();
        let counts = |said: Time| said >= begin && said + IN_TIME <= end;
        let said = |robot: u16, episode: u32| self.said[usize::from(robot)][episode as usize];
        let states = left.iter().filter(|(robot, episode)| counts(said(*robot, *episode))).count() as u64;
        let in_time = |(at, message): &(Time, Wire)| match message {
            Wire::Latent(Latent { robot, round, .. }) => {
                let said = said(robot.0, round.episode);
                counts(said) && at.since(said) <= IN_TIME
            }
            _ => false,
        };
        let in_time = self.rig.delivered.iter().flatten().filter(|told| in_time(told)).count() as u64;
        let wanted = states * (hosts as u64 - 1);
        let hosts_s = hosts as f64 * (passed_s - IN_TIME.as_secs());
        Told { wanted, in_time, airtime_s, beside_s, passed_s, hosts_s, states }
    }

    /// Returns the states that left since they were forgotten, and the time that all else took on the air \[s\].
    fn left(&self) -> (BTreeSet<(u16, u32)>, f64) {
        let radio = self.cell.radio();
        let (mut left, mut beside_s) = (BTreeSet::new(), 0.0);
        let mut last: Option<(Frame, Option<usize>)> = None;
        for flight in self.rig.sent.iter().filter(|flight| !self.rig.off.contains(&flight.from)) {
            let on_air = |bytes| match flight.audience {
                Audience::All => radio.multicast_airtime(bytes).as_secs(),
                Audience::Host(_) => radio.frame_airtime(bytes).as_secs() / (1.0 - self.cell.noise),
            };
            if last.as_ref().is_none_or(|(frame, _)| !Arc::ptr_eq(frame, &flight.frame)) {
                last = Some((flight.frame.clone(), state_of(&flight.frame, &mut left)));
            }
            let bare = last.as_ref().and_then(|(_, bare)| *bare);
            let probes = matches!(flight.audience, Audience::Host(_)) && Flags(flight.frame[FLAGS_AT]).has(Flags::COPY);
            beside_s += on_air(flight.bytes) - bare.filter(|_| !probes).map_or(0.0, on_air);
        }
        (left, beside_s)
    }

    fn decision(&mut self) -> String {
        let next = self.rig.now + Span::from_millis(1000);
        self.rig.run_to(next);
        let peer = self.rig.peers[0].first();
        peer.and_then(|peer| peer.sends.clone()).unwrap_or_default()
    }
}

/// Returns the length of a datagram with a state and nothing else but its tags; `None` for another one.
fn state_of(frame: &Frame, left: &mut BTreeSet<(u16, u32)>) -> Option<usize> {
    let plain = codec::untagged(frame);
    let (content, body) = codec::blocks(plain).next()?.ok()?;
    if content != Content::Message(Kind::Latent) {
        return None;
    }
    let Ok(Wire::Latent(latent)) = codec::message(Kind::Latent, body) else { return None };
    left.insert((latent.robot.0, latent.round.episode));
    Some(codec::HEADER_BYTES + codec::BLOCK_BYTES + body.len() + frame.len() - plain.len())
}

/// Runs a team until its links have decided, and then for `seconds`. Returns what came of it, and the decision.
fn measure(cell: Cell, choosing: Choosing, seconds: u64) -> (Told, String) {
    let mut team = Team::new(cell, choosing, 1);
    for _ in 0..30 {
        team.run(Span::from_millis(1000));
    }
    let mut told = Told::default();
    for _ in 0..seconds {
        told.add(team.run(Span::from_millis(1000)));
    }
    (told, team.decision())
}

fn show(name: &str, cell: Cell, told: &Told, decision: &str) {
    let Cell { hosts, rate, members, .. } = cell;
    let (share, airtime, beside) = (100.0 * told.share(), 100.0 * told.airtime(), 100.0 * told.beside());
    println!(
        "{name}, N {hosts}, {rate}, members {members}: {share:.2} % in 20 ms, airtime {airtime:.2} %, of it \
         {beside:.2} beside states, {:.1} Hz; {decision}",
        told.hz()
    );
}

fn is_full() -> bool {
    std::env::var("AUTO_FULL").is_ok()
}

#[test]
fn a_link_takes_multicast_with_copies_where_its_frames_are_short_and_unicast_where_they_are_long() {
    let short = measure(CELL, Choosing::Measured, 10);
    show("auto", CELL, &short.0, &short.1);
    assert!(short.1.starts_with("multicast, 2."), "{}", short.1);
    assert!(short.0.share() >= 0.985 && short.0.airtime() <= 0.037, "{:?}", short.0);
    let slow = Cell { rate: "dsss-1", ..CELL };
    let (long, decision) = measure(slow, Choosing::Measured, 10);
    show("auto", slow, &long, &decision);
    assert!(decision.starts_with("unicast"), "{decision}");
    let (unicast, _) = measure(slow, Choosing::Pinned(Way::Unicast), 10);
    show("unicast", slow, &unicast, "");
    assert!(long.share() >= 0.99 && long.beside() <= 0.005, "{long:?}");
    let of_states = |told: &Told| told.airtime() - told.beside();
    assert!((of_states(&long) / of_states(&unicast) - 1.0).abs() <= 0.05, "{long:?} {unicast:?}");
}

#[test]
fn an_overloaded_link_says_half_of_its_states_and_most_of_them_arrive() {
    let cell = Cell { hosts: 20, rate: "dsss-1", ..CELL };
    let (told, decision) = measure(cell, Choosing::Measured, 10);
    show("auto", cell, &told, &decision);
    assert!(decision.contains("Hz of 20"), "{decision}");
    assert!(told.share() >= 0.75 && (told.hz() - 10.0).abs() < 0.3, "{told:?}");
}

#[test]
fn the_states_of_a_team_that_acts_at_the_same_instants_are_spread() {
    let cell = Cell { hosts: 10, lockstep: true, ..CELL };
    let (told, decision) = measure(cell, Choosing::Measured, 10);
    show("auto, lockstep", cell, &told, &decision);
    assert!(told.share() >= 0.98, "{told:?}");
}

#[test]
fn decisions_replay_bit_for_bit() {
    let mut team = Team::new(CELL, Choosing::Measured, 3);
    team.rig.tape = Some(Vec::new());
    let mut sent: Vec<Vec<(Audience, Frame)>> = vec![Vec::new(); 5];
    for rate in ["ofdm-24", "dsss-1"] {
        team.change(Cell { rate, ..CELL }, 5, 3);
        team.run(Span::from_millis(20_000));
        for flight in &team.rig.sent {
            sent[flight.from].push((flight.audience, flight.frame.clone()));
        }
    }
    let tape = team.rig.tape.take().expect("it was recorded");
    let setup = Setup { choosing: Choosing::Measured, ..Setup::multicast(Reliabilities::new()) };
    let again = (0..5).map(|host| network_of_run(config(host, 5, 1, Some(key()), setup.clone()), host.into()));
    let (mut again, mut resent) = (again.collect::<Vec<_>>(), vec![Vec::new(); 5]);
    for (now, host, input) in tape {
        let mut out = Vec::new();
        match input {
            Some(input) => again[host].handle(now, input, &mut out),
            None => again[host].wake(now, &mut out),
        }
        resent[host].extend(out.into_iter().filter_map(|said| match said {
            Out::Transmit(_, audience, frame) => Some((audience, frame)),
            _ => None,
        }));
    }
    let by_unicast = |sent: &[(Audience, Frame)]| sent.iter().filter(|(to, _)| *to != Audience::All).count();
    assert!(sent.iter().all(|sent| by_unicast(sent) > 100), "each has changed its way");
    for (host, (sent, again)) in sent.iter().zip(&resent).enumerate() {
        let first = sent.iter().zip(again).position(|(one, other)| one != other);
        assert_eq!((first, sent.len()), (None, again.len()), "host {host}");
    }
}

/// Time with one channel and one size of the team.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    seconds: u64,
    cell: Cell,
    active: u16,
}

/// Largest number of hosts of a team that changes.
const MOST: u16 = 12;

/// Draws a run of `seconds` with random changes of loss, rate and number of hosts.
fn changes(seconds: u64, seed: u64) -> Vec<Stretch> {
    let mut stream = Seed::of_run(seed).stream("changes");
    let (mut all, mut left) = (Vec::new(), seconds);
    while left > 0 {
        let seconds = stream.random_range(15..60).min(left);
        let rate = ["dsss-1", "ofdm-6", "ofdm-12", "ofdm-24"][stream.random_range(0..4)];
        let noise = [0.02, 0.08, 0.16, 0.25][stream.random_range(0..4)];
        all.push(Stretch { seconds, cell: Cell { rate, noise, ..CELL }, active: stream.random_range(3..=MOST) });
        left -= seconds;
    }
    all
}

/// Runs a team through all changes. Returns what came of it, and the seconds in which host 0 decided anew.
fn through(stretches: &[Stretch], choosing: Choosing) -> (Told, Vec<u64>) {
    let mut team = Team::new(Cell { hosts: MOST, ..stretches[0].cell }, choosing, 1);
    let (mut told, mut decided, mut before) = (Told::default(), Vec::new(), String::new());
    for (index, stretch) in (0..).zip(stretches) {
        team.change(stretch.cell, stretch.active, 100 + index);
        // The links of a team that begins measure nothing yet.
        let warm = if index == 0 { 10 } else { 0 };
        for second in 0..stretch.seconds + warm {
            let one = team.run(Span::from_millis(1000));
            if second >= warm {
                told.add(one);
            }
            let sends = team.rig.peers[0].first().and_then(|peer| peer.sends.clone()).unwrap_or_default();
            let way = sends.split(':').next().unwrap_or_default().to_owned();
            if way != before {
                decided.extend((!before.is_empty()).then(|| team.rig.now.as_secs().round() as u64));
                before = way;
            }
        }
    }
    (told, decided)
}

#[test]
fn a_link_follows_random_changes_as_well_as_the_best_fixed_way() {
    let (seconds, seeds) = if is_full() { (600, 5) } else { (60, 1) };
    for seed in 1..=seeds {
        let stretches = changes(seconds, seed);
        let (auto, decided) = through(&stretches, Choosing::Measured);
        let fixed = [Way::Unicast, Way::Multicast(8), Way::Multicast(16), Way::Multicast(24), Way::Multicast(32)];
        let fixed = fixed.map(|way| (way, through(&stretches, Choosing::Pinned(way)).0));
        let percent = |told: &Told| (100.0 * told.share(), 100.0 * told.airtime());
        println!("seed {seed}: auto {:.2?}, decided in the seconds {decided:?}", percent(&auto));
        fixed.iter().for_each(|(way, told)| println!("  {way:?} {:.2?}", percent(told)));
        let as_good = fixed.iter().filter(|(_, told)| told.share() >= auto.share() - 0.005);
        let best = as_good.map(|(_, told)| told.airtime()).fold(f64::INFINITY, f64::min);
        assert!(auto.airtime() <= 1.05 * best, "{:.4} {best:.4}", auto.airtime());
        assert!(decided.windows(2).all(|two| two[1] - two[0] >= 4), "{decided:?}");
    }
}

#[test]
fn the_front_of_share_and_airtime() {
    if !is_full() {
        return;
    }
    for members in [false, true] {
        for rate in ["ofdm-24", "dsss-1"] {
            for hosts in [3, 5, 10, 20] {
                let cell = Cell { hosts, rate, members, ..CELL };
                let (told, decision) = measure(cell, Choosing::Measured, 60);
                show("auto", cell, &told, &decision);
                assert!(told.share() >= if hosts < 20 { 0.95 } else { 0.6 }, "{told:?}");
                let (unicast, _) = measure(cell, Choosing::Pinned(Way::Unicast), 20);
                show("unicast", cell, &unicast, "");
                for eighths in [8, 16, 24] {
                    let (fixed, _) = measure(cell, Choosing::Pinned(Way::Multicast(eighths)), 20);
                    show(&format!("multicast, {} copies", eighths / 8), cell, &fixed, "");
                }
            }
        }
    }
}
