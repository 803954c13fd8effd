//! Emergency stops that cross hops: a stop of any host reaches all of a line and of a field, though none hears all.
//!
//! `MESH_STOPS=500 cargo test --release --test link mesh:: -- --nocapture` runs all cells with so many stops each.

use std::collections::BTreeSet;

use crate::rig::{LINK, Rig, TEAM, key, latent};
use murmurate::actors::network::{Config, Identity};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::HostId;
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Kind, Stop, Wire};
use murmurate::net::media::radio::{Channel, Radio, Topology};
use murmurate::net::protocol::reliability::{Reliabilities, Setup};
use murmurate::net::protocol::router::{Audience, Route, Router};
use murmurate::random::{RngExt, Seed, Stream};
use murmurate::time::{Span, Time};

/// Range \[m\] in which frames are read, and in which they are sensed.
const RANGE_M: f32 = 30.0;
const SENSE_M: f32 = 55.0;
/// Least time between two stops: longer than a stop is said on.
const APART: Span = Span::from_millis(1500);
/// Period of states, and the largest random addition to it.
const PERIOD: Span = Span::from_millis(50);
const JITTER: Span = Span::from_millis(1);

/// Hosts of a mesh, and what the medium does.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// Number of hosts in a line, or in a field.
    pub hosts: u16,
    pub line: bool,
    pub loss: f64,
    /// Speed of all hosts \[m/s\].
    pub speed_m_s: f32,
}

/// Places of hosts that move straight on and are reflected by the edges of their field.
struct Places {
    at: Vec<Vec2>,
    velocity: Vec<Vec2>,
    side_m: f32,
    moved: Time,
}

impl Places {
    fn new(cell: Cell, stream: &mut Stream) -> Places {
        // The density of twenty hosts in a square of 84 m.
        let side_m = 84.0 * (f32::from(cell.hosts) / 20.0).sqrt();
        let mut drawn = |hosts: u16| {
            (0..hosts).map(|_| Vec2::new(stream.random_range(0.0..side_m), stream.random_range(0.0..side_m))).collect()
        };
        let line = || (0..cell.hosts).map(|host| Vec2::new(25.0 * f32::from(host), 0.0)).collect();
        let mut at: Vec<Vec2> = if cell.line { line() } else { drawn(cell.hosts) };
        while !is_connected(&at) {
            at = drawn(cell.hosts);
        }
        let velocity = (0..cell.hosts).map(|_| {
            let (sin, cos) = stream.random_range(0.0..std::f32::consts::TAU).sin_cos();
            Vec2::new(cos, sin) * cell.speed_m_s
        });
        Places { velocity: velocity.collect(), at, side_m, moved: Time::ZERO }
    }

    /// Moves all hosts to where they are at `now`.
    fn move_to(&mut self, now: Time) {
        let passed_s = now.since(std::mem::replace(&mut self.moved, now)).as_secs() as f32;
        for (at, velocity) in self.at.iter_mut().zip(&mut self.velocity) {
            *at += *velocity * passed_s;
            for axis in 0..2 {
                let beyond = at[axis] < 0.0 && velocity[axis] < 0.0 || at[axis] > self.side_m && velocity[axis] > 0.0;
                velocity[axis] *= if beyond { -1.0 } else { 1.0 };
            }
        }
    }
}

/// Returns whether there is a way from each host to each.
fn is_connected(at: &[Vec2]) -> bool {
    let (mut found, mut next) = (BTreeSet::from([0]), vec![0]);
    while let Some(from) = next.pop() {
        let near = (0..at.len()).filter(|to| (at[*to] - at[from]).norm() <= RANGE_M);
        next.extend(near.filter(|to| found.insert(*to)));
    }
    found.len() == at.len()
}

/// Returns a host that takes part in a mesh, which sends latents and stops to all others.
fn host(host: u16, hosts: u16) -> Config {
    let router = Router::new(usize::from(hosts), |kind, robot| {
        let own = robot.0 == host || kind == Kind::Stop;
        Route { local: !own || kind == Kind::Stop, leaves: own.then_some((LINK, Audience::All)) }
    });
    Config {
        me: Identity { host: HostId(host), team: TEAM, incarnation: 1 },
        key: Some(key()),
        links: vec![Some(Setup { mesh: true, ..Setup::multicast(Reliabilities::new()) })],
        router,
        parts: None,
    }
}

/// Hosts on a radio channel that move and send states, each at its own moments.
pub struct Team {
    pub rig: Rig,
    places: Places,
    /// Time of the next state of each host.
    pub next: Vec<Time>,
    stream: Stream,
}

impl Team {
    /// Starts the hosts of a cell, and lets them meet.
    pub fn new(cell: Cell, configs: impl Iterator<Item = Config>) -> Team {
        let mut stream = Seed::of_run(11).stream("mesh");
        let mut rig = Rig::new(configs);
        let radio = Radio {
            channel: Topology::AdHoc,
            basic_rate: "ofdm-6".parse().expect("a rate of the table"),
            range_m: Some(RANGE_M),
            sense_m: Some(SENSE_M),
            noise_loss: cell.loss,
            ..Radio::default()
        };
        rig.radio = Some(Channel::new(radio, cell.hosts, &Seed::of_run(12)));
        let next = (0..cell.hosts).map(|_| Time::ZERO + random(&mut stream, PERIOD)).collect();
        let mut team = Team { rig, places: Places::new(cell, &mut stream), next, stream };
        team.run(Span::from_millis(3000));
        team
    }

    /// Lets hosts send states and move for a time.
    pub fn run(&mut self, time: Span) {
        let end = self.rig.now + time;
        loop {
            let (at, host) = self.next.iter().copied().zip(0_u16..).min().expect("there are hosts");
            self.places.move_to(at.min(end));
            let radio = self.rig.radio.as_mut().expect("it has one");
            (0..).zip(&self.places.at).for_each(|(station, at)| radio.place(station, *at));
            self.rig.run_to(at.min(end));
            if at > end {
                return;
            }
            self.rig.publish(usize::from(host), latent(host, 1));
            // No clock ticks as another one, and no scheduler wakes to the microsecond.
            self.next[usize::from(host)] = at + PERIOD + random(&mut self.stream, JITTER);
        }
    }

    /// Says a stop by a host. Returns the time until the last host had it \[ms\], if all had it in time.
    fn stop(&mut self, by: u16, latch: Latch) -> Option<f64> {
        let (said, more) = (self.rig.now, random(&mut self.stream, PERIOD));
        self.rig.delivered.iter_mut().for_each(Vec::clear);
        self.rig.sent.clear();
        self.rig.publish(usize::from(by), Wire::Stop(Stop { by: HostId(by), latch }));
        self.run(APART + more);
        let is_it = |message: &Wire| matches!(message, Wire::Stop(stop) if stop.latch == latch);
        let had = |told: &Vec<(Time, Wire)>| told.iter().find(|(_, message)| is_it(message)).map(|(at, _)| *at);
        let last: Option<Vec<Time>> = self.rig.delivered.iter().map(had).collect();
        last.and_then(|all| all.into_iter().max()).map(|last| 1e3 * last.since(said).as_secs())
    }

    /// Returns the time with something on the air so far \[s\].
    pub fn airtime_s(&self) -> f64 {
        1e-9 * self.rig.radio.as_ref().expect("it has one").counts(self.rig.now).airtime_ns as f64
    }
}

fn random(stream: &mut Stream, most: Span) -> Span {
    Span::from_nanos(stream.random_range(0..most.as_nanos()))
}

/// Results of stops: of each the time until the last host had it \[ms\], if all had it in time; and the share of the
/// time in which something was on the air, with the stops and without.
struct Told {
    complete_ms: Vec<Option<f64>>,
    airtime: [f64; 2],
}

/// Says so many stops, each by a host that is drawn, between which hosts send their states.
fn stops(cell: Cell, count: usize) -> Told {
    let mut team = Team::new(cell, (0..cell.hosts).map(|index| host(index, cell.hosts)));
    let before = (team.rig.now, team.airtime_s());
    team.run(Span::from_millis(3000));
    let share = |team: &Team, (since, airtime_s): (Time, f64)| {
        (team.airtime_s() - airtime_s) / team.rig.now.since(since).as_secs()
    };
    let (without, before) = (share(&team, before), (team.rig.now, team.airtime_s()));
    let (mut complete_ms, mut number) = (Vec::new(), 0);
    while complete_ms.len() < count {
        let connected = is_connected(&team.places.at);
        number += 2;
        let by = team.stream.random_range(0..cell.hosts);
        let complete = team.stop(by, Latch::engaged(number));
        // Nothing reaches the other half of a team that has split.
        if connected && is_connected(&team.places.at) {
            complete_ms.push(complete);
        }
    }
    let airtime = [share(&team, before), without];
    Told { complete_ms, airtime }
}

fn holds(cell: Cell, count: usize) {
    let told = stops(cell, count);
    let within = |ms: f64| {
        let some = told.complete_ms.iter().filter(|complete| complete.is_some_and(|complete| complete <= ms));
        100.0 * some.count() as f64 / told.complete_ms.len() as f64
    };
    let longest = told.complete_ms.iter().map(|one| one.unwrap_or(f64::INFINITY)).fold(0.0, f64::max);
    let [stopped, without] = told.airtime.map(|share| 100.0 * share);
    let (soon, late) = (within(100.0), within(500.0));
    println!(
        "{cell:?}: {count} stops, {soon:.1} % complete in 100 ms, {late:.1} % in 500 ms, longest {longest:.0} ms; \
         airtime {stopped:.1} % with a stop each 1.5 s, {without:.1} % without"
    );
    assert!(late == 100.0 && soon >= 90.0, "{cell:?}");
}

/// Returns the number of stops in each cell that the environment asks for.
fn asked() -> Option<usize> {
    std::env::var("MESH_STOPS").ok().map(|count| count.parse().expect("MESH_STOPS is a number"))
}

pub const LINE: Cell = Cell { hosts: 7, line: true, loss: 0.16, speed_m_s: 0.0 };
pub const FIELD: Cell = Cell { hosts: 20, line: false, loss: 0.16, speed_m_s: 1.0 };

#[test]
fn a_stop_reaches_all_of_a_line_and_of_a_moving_field() {
    let cells = match asked() {
        None => vec![LINE, FIELD],
        Some(_) => [LINE, FIELD, Cell { hosts: 50, ..FIELD }]
            .into_iter()
            .flat_map(|cell| [0.05, 0.16].map(|loss| Cell { loss, ..cell }))
            .flat_map(|cell| [0.0, 1.0].map(|speed_m_s| Cell { speed_m_s, ..cell }))
            // A line that moves falls apart.
            .filter(|cell| !(cell.line && cell.speed_m_s > 0.0))
            .collect(),
    };
    cells.into_iter().for_each(|cell| holds(cell, asked().unwrap_or(20)));
}

#[test]
fn without_a_mesh_a_stop_reaches_the_neighbours_of_its_sender_alone() {
    let cell = Cell { hosts: 3, loss: 0.0, ..LINE };
    let one_hop = |index| Config { links: vec![Some(Setup::multicast(Reliabilities::new()))], ..host(index, 3) };
    let mut team = Team::new(cell, (0..3).map(one_hop));
    assert_eq!(team.stop(0, Latch::engaged(1)), None);
    let has = |host: usize| team.rig.delivered[host].iter().any(|(_, told)| matches!(told, Wire::Stop(_)));
    assert_eq!([0, 1, 2].map(has), [true, true, false]);
}
