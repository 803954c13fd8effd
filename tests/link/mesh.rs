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
use murmurate::time::Span;

/// Range \[m\] in which frames are read, and in which they are sensed.
const RANGE_M: f32 = 30.0;
const SENSE_M: f32 = 55.0;
/// Time between two stops \[ms\]: longer than a stop is said on.
const APART_MS: u64 = 1500;
/// Step of time and of positions \[ms\], and number of steps in a period of states.
const STEP_MS: u64 = 5;
const STEPS: u64 = 10;

/// Hosts of a mesh, and what the medium does.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Number of hosts in a line, or in a field.
    hosts: u16,
    line: bool,
    loss: f64,
    /// Speed of all hosts \[m/s\].
    speed_m_s: f32,
}

/// Places of hosts that move straight on and are reflected by the edges of their field.
struct Places {
    at: Vec<Vec2>,
    velocity: Vec<Vec2>,
    side_m: f32,
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
        Places { velocity: velocity.collect(), at, side_m }
    }

    /// Moves all hosts by a step.
    fn go_on(&mut self) {
        for (at, velocity) in self.at.iter_mut().zip(&mut self.velocity) {
            *at += *velocity * (1e-3 * STEP_MS as f32);
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

/// What came of stops: of each the time until the last host had it \[ms\], if all had it before the next one; and the
/// airtime of all with the stops and without \[s\].
struct Told {
    complete_ms: Vec<Option<f64>>,
    airtime_s: [f64; 2],
}

/// Says so many stops, each by a host that is drawn, between which hosts send their states.
fn stops(cell: Cell, count: usize) -> Told {
    let mut stream = Seed::of_run(11).stream("mesh");
    let mut places = Places::new(cell, &mut stream);
    let mut rig = Rig::new((0..cell.hosts).map(|index| host(index, cell.hosts)));
    rig.radio = Some(Channel::new(
        Radio {
            channel: Topology::AdHoc,
            basic_rate: "ofdm-6".parse().expect("a rate of the table"),
            range_m: Some(RANGE_M),
            sense_m: Some(SENSE_M),
            noise_loss: cell.loss,
            ..Radio::default()
        },
        cell.hosts,
        &Seed::of_run(12),
    ));
    let (mut complete_ms, mut number, mut step) = (Vec::new(), 0, 0_u64);
    run(&mut rig, &mut places, &mut step, 3000);
    let airtime = |rig: &Rig| rig.radio.as_ref().expect("it has one").counts(rig.now).airtime_ns;
    let before = airtime(&rig);
    run(&mut rig, &mut places, &mut step, 3000);
    let without_s = 1e-9 * (airtime(&rig) - before) as f64 / 3.0;
    let before = airtime(&rig);
    while complete_ms.len() < count {
        let connected = is_connected(&places.at);
        number += 2;
        let (by, latch, said) = (stream.random_range(0..cell.hosts), Latch::engaged(number), rig.now);
        rig.delivered.iter_mut().for_each(Vec::clear);
        rig.publish(usize::from(by), Wire::Stop(Stop { by: HostId(by), latch }));
        run(&mut rig, &mut places, &mut step, APART_MS + stream.random_range(0..50));
        if !(connected && is_connected(&places.at)) {
            continue;
        }
        let had = |told: &Vec<(murmurate::time::Time, Wire)>| {
            told.iter()
                .find(|(_, message)| matches!(message, Wire::Stop(stop) if stop.latch == latch))
                .map(|(at, _)| *at)
        };
        let last: Option<Vec<_>> = rig.delivered.iter().map(had).collect();
        complete_ms.push(last.map(|all| 1e3 * all.into_iter().max().expect("hosts").since(said).as_secs()));
        rig.sent.clear();
    }
    let stopped_s = 1e-9 * (airtime(&rig) - before) as f64 / (number / 2) as f64 / (1e-3 * APART_MS as f64);
    Told { complete_ms, airtime_s: [stopped_s, without_s] }
}

/// Lets hosts send states and move for a time.
fn run(rig: &mut Rig, places: &mut Places, step: &mut u64, ms: u64) {
    for _ in 0..ms / STEP_MS {
        places.go_on();
        let radio = rig.radio.as_mut().expect("it has one");
        (0..).zip(&places.at).for_each(|(station, at)| radio.place(station, *at));
        for host in (0..places.at.len()).filter(|host| *host as u64 * 7 % STEPS == *step % STEPS) {
            rig.publish(host, latent(host as u16, *step as u32));
        }
        *step += 1;
        let next = rig.now + Span::from_millis(STEP_MS);
        rig.run_to(next);
    }
}

fn holds(cell: Cell, count: usize) {
    let told = stops(cell, count);
    let within = |ms: f64| {
        let some = told.complete_ms.iter().filter(|complete| complete.is_some_and(|complete| complete <= ms));
        100.0 * some.count() as f64 / told.complete_ms.len() as f64
    };
    let longest = told.complete_ms.iter().map(|one| one.unwrap_or(f64::INFINITY)).fold(0.0, f64::max);
    let [stopped, without] = told.airtime_s.map(|share| 100.0 * share);
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

const LINE: Cell = Cell { hosts: 7, line: true, loss: 0.16, speed_m_s: 0.0 };
const FIELD: Cell = Cell { hosts: 20, line: false, loss: 0.16, speed_m_s: 1.0 };

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
    let mut rig = Rig::new((0..3).map(|index| {
        let config = host(index, 3);
        Config { links: vec![Some(Setup::multicast(Reliabilities::new()))], ..config }
    }));
    let radio = Radio { channel: Topology::AdHoc, range_m: Some(RANGE_M), ..Radio::default() };
    rig.radio = Some(Channel::new(radio, 3, &Seed::of_run(1)));
    let cell = Cell { hosts: 3, loss: 0.0, ..LINE };
    let mut places = Places::new(cell, &mut Seed::of_run(1).stream("mesh"));
    let mut step = 0;
    run(&mut rig, &mut places, &mut step, 3000);
    rig.delivered.iter_mut().for_each(Vec::clear);
    rig.publish(0, Wire::Stop(Stop { by: HostId(0), latch: Latch::engaged(1) }));
    run(&mut rig, &mut places, &mut step, 2000);
    let has = [0, 1, 2].map(|host: usize| rig.delivered[host].iter().any(|(_, told)| matches!(told, Wire::Stop(_))));
    assert_eq!(has, [true, true, false]);
}
