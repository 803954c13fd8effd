//! Soft state that crosses hops: heartbeats reach the state server and its instructions all hosts, though none hears
//! all; and nothing of a relay that lies is believed.
//!
//! `MESH_SECONDS=60 cargo test --release --test link hops:: -- --nocapture` runs all cells for so long each.

use std::collections::{BTreeMap, BTreeSet};

use crate::mesh::{Cell, FIELD, LINE, Team};
use crate::rig::{LINK, TEAM, key};
use murmurate::actors::network::{Config, Identity};
use murmurate::messages::geometry::{Task, Vec2};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Following, Heartbeat, Kind, Mode, Phase, Round, Status, Stop, Wire};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::member::public;
use murmurate::net::protocol::reliability::{Reliabilities, Setup};
use murmurate::net::protocol::router::{Audience, Publishers, Route, Router};
use murmurate::net::protocol::signatures::Signatures;
use murmurate::time::{Span, Time};

/// Host of the state server.
const SERVER: HostId = HostId(0);

/// Returns the id of a host of a team, or of its operator.
fn id(host: u16, hosts: u16) -> HostId {
    if host == hosts { HostId::operator(1) } else { HostId(host) }
}

/// Keys of a team, by which members can or cannot speak as each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Keys {
    /// One key: each member as each.
    Team,
    /// Each member has its own.
    Members,
}

impl Keys {
    fn of(self, host: u16, hosts: u16) -> Key {
        let secret = |of: u16| *blake3::hash(&of.to_le_bytes()).as_bytes();
        let pair = |one: u16, other: u16| {
            let mut bytes = [3; 32];
            bytes[..2].copy_from_slice(&one.min(other).to_le_bytes());
            bytes[2..4].copy_from_slice(&one.max(other).to_le_bytes());
            bytes
        };
        match self {
            Keys::Team => key(),
            Keys::Members => {
                let publics = (0..=hosts).map(|of| (id(of, hosts), public(&secret(of)))).collect();
                let signatures = Signatures::new(Some(secret(host)), &publics).expect("they are public keys");
                let pairs = (0..=hosts).map(|other| (id(other, hosts), pair(host, other))).collect();
                Key::of_member([9; 32], pairs).with_signatures(signatures)
            }
        }
    }
}

/// Returns a host of a team whose only link is the mesh, with the robot of its number; with the number of hosts an
/// operator.
fn host(host: u16, hosts: u16, keys: Keys) -> Config {
    let me = id(host, hosts);
    let all: Vec<HostId> = (0..hosts).map(HostId).collect();
    let publishers = Publishers {
        names: (0..hosts).map(|host| format!("robot-{host}")).collect(),
        agents: all.clone(),
        actuators: all.clone(),
        localizers: all,
        server: SERVER,
    };
    let router = Router::new(usize::from(hosts), |kind, robot| {
        let leads = host == SERVER.0;
        match kind {
            Kind::Heartbeat => Route { local: leads, leaves: (!leads).then_some((LINK, Audience::Host(SERVER))) },
            Kind::Mode => Route { local: !leads, leaves: leads.then_some((LINK, Audience::All)) },
            Kind::Latent => {
                Route { local: robot.0 != host, leaves: (robot.0 == host).then_some((LINK, Audience::All)) }
            }
            _ => Route { local: true, leaves: Some((LINK, Audience::All)) },
        }
    });
    Config {
        me: Identity { host: me, team: TEAM, incarnation: 1 + u32::from(host) },
        key: Some(keys.of(host, hosts)),
        links: vec![Some(Setup { mesh: true, ..Setup::multicast(Reliabilities::new()) })],
        router: router.with_publishers(publishers.into()),
        parts: None,
    }
}

fn beat(robot: u16, number: u32) -> Wire {
    let round = Round { term: 1, episode: number };
    let beat = Heartbeat::new(RobotId(robot), round, Phase::Running, Latch::default());
    Wire::Heartbeat(Heartbeat { policy: 0x1234_5678, ..beat })
}

/// Returns an instruction; each ten seconds it has other starts and goals.
fn mode(hosts: u16, number: u32) -> Wire {
    let round = Round { term: 1, episode: number };
    let at = (number / 200) as f32;
    let task = |robot: u16| Task { start: Vec2::new(f32::from(robot), at), goal: Vec2::new(at, f32::from(robot)) };
    let tasks = (0..hosts).map(task).collect();
    let (phase, first, latch) = (Phase::Running, RobotId(0), Latch::default());
    Wire::Mode(Mode { round, repeat: 0, phase, first, tasks, latch })
}

/// Steps of a test, and the periods of heartbeats and of instructions in steps.
const STEP: Span = Span::from_millis(50);
const BEATS: u32 = 6;
const MODES: u32 = 5;

/// Times of soft state: for each message and host that it is for, the time until it was there \[ms\].
struct Told {
    /// Of heartbeats at the state server, and of instructions at all others.
    after_ms: [Vec<Option<f64>>; 2],
    /// Airtime beside that of states alone.
    airtime: f64,
}

/// Says heartbeats and instructions for a time, each robot at a step of its own.
fn publish(team: &mut Team, hosts: u16, time: Span) -> BTreeMap<(u16, u32), Time> {
    let (mut said, end) = (BTreeMap::new(), team.rig.now + time);
    for step in 0.. {
        let now = team.rig.now;
        if now >= end {
            break;
        }
        let number = (now.since(Time::ZERO).as_secs() / STEP.as_secs()) as u32;
        if step % MODES == 0 {
            team.rig.publish(usize::from(SERVER.0), mode(hosts, number));
            said.insert((SERVER.0, number), now);
        }
        for robot in (1..hosts).filter(|robot| (step + u32::from(*robot)) % BEATS == 0) {
            team.rig.publish(usize::from(robot), beat(robot, number));
            said.insert((robot, number), now);
        }
        team.run(STEP);
    }
    said
}

fn tell(cell: Cell, keys: Keys, time: Span) -> Told {
    let hosts = cell.hosts;
    let mut alone = Team::new(cell, (0..hosts).map(|index| host(index, hosts, keys)));
    let before = alone.airtime_s();
    alone.run(time);
    let states_s = alone.airtime_s() - before;

    let mut team = Team::new(cell, (0..hosts).map(|index| host(index, hosts, keys)));
    // A host is believed once it has echoed what the state server has said.
    publish(&mut team, hosts, Span::from_millis(4000));
    team.rig.delivered.iter_mut().for_each(Vec::clear);
    team.rig.sent.clear();
    let (since, before) = (team.rig.now, team.airtime_s());
    let said = publish(&mut team, hosts, time);
    let share = (team.airtime_s() - before) / team.rig.now.since(since).as_secs();
    team.run(Span::from_millis(1000));
    let first = |host: u16, from: u16, number: u32| {
        let is_it = |message: &Wire| match message {
            Wire::Heartbeat(beat) => beat.robot.0 == from && beat.round.episode == number,
            Wire::Mode(mode) => from == SERVER.0 && mode.round.episode == number,
            _ => false,
        };
        team.rig.delivered[usize::from(host)].iter().find(|(_, message)| is_it(message)).map(|(at, _)| *at)
    };
    let mut after_ms = [Vec::new(), Vec::new()];
    for ((from, number), at) in said {
        let readers = if from == SERVER.0 { 1..hosts } else { 0..1 };
        for host in readers {
            let after = first(host, from, number).map(|then| 1e3 * then.since(at).as_secs());
            after_ms[usize::from(from == SERVER.0)].push(after);
        }
    }
    Told { after_ms, airtime: share / (states_s / time.as_secs()) }
}

fn holds(cell: Cell, keys: Keys, time: Span, least: [f64; 2], most: f64) {
    let told = tell(cell, keys, time);
    let within = |all: &Vec<Option<f64>>, ms: f64| {
        let some = all.iter().filter(|after| after.is_some_and(|after| after <= ms)).count();
        100.0 * some as f64 / all.len() as f64
    };
    let [beats, modes] = [0, 1].map(|kind| [100.0, 500.0].map(|ms| within(&told.after_ms[kind], ms)));
    println!(
        "{cell:?} {keys:?}: heartbeats {:.1} % in 100 ms, {:.1} % in 500 ms; instructions {:.1}, {:.1} %; \
         airtime {:.2} of states alone",
        beats[0], beats[1], modes[0], modes[1], told.airtime
    );
    assert!(beats[1] >= least[0] && modes[1] >= least[1] && told.airtime <= most, "{cell:?} {keys:?}");
}

#[test]
fn soft_state_reaches_who_it_is_for_across_hops() {
    let seconds = seconds();
    let time = Span::from_millis(1000 * seconds.unwrap_or(6));
    for keys in [Keys::Team, Keys::Members] {
        let still = Cell { speed_m_s: 0.0, loss: 0.05, ..FIELD };
        holds(still, keys, time, [98.0, 98.0], 1.75);
        if seconds.is_some() {
            holds(Cell { loss: 0.16, ..still }, keys, time, [98.0, 98.0], 1.75);
            holds(Cell { loss: 0.05, ..FIELD }, keys, time, [97.0, 97.0], 1.75);
            holds(FIELD, keys, time, [97.0, 97.0], 1.75);
            holds(Cell { loss: 0.05, ..LINE }, keys, time, [0.0, 0.0], 2.5);
            holds(LINE, keys, time, [0.0, 0.0], 2.5);
        }
    }
}

/// Returns the time until an operator beside the team has had the confirmation of its stop by each host \[ms\], if it
/// has.
fn confirmed(cell: Cell, keys: Keys) -> Option<f64> {
    let hosts = cell.hosts - 1;
    let mut team = Team::new(cell, (0..=hosts).map(|index| host(index, hosts, keys)));
    team.next[usize::from(hosts)] = Time::MAX;
    publish(&mut team, hosts, Span::from_millis(3000));
    let (said, latch) = (team.rig.now, Latch::engaged(1));
    team.rig.publish(usize::from(hosts), Wire::Stop(Stop { by: id(hosts, hosts), latch }));
    let mut stands = BTreeSet::new();
    while team.rig.now.since(said) < Span::from_millis(3000) {
        team.run(Span::from_millis(10));
        for host in 0..hosts {
            let told = &team.rig.delivered[usize::from(host)];
            let has = told.iter().any(|(_, told)| matches!(told, Wire::Stop(stop) if stop.latch == latch));
            if has && stands.insert(host) {
                let follows = Following { robot: RobotId(host), controller: Some(latch), body: Some(latch) };
                team.rig.publish(usize::from(host), Wire::Status(Status::of(HostId(host), false, vec![follows], None)));
            }
        }
        let told = team.rig.delivered[usize::from(hosts)].iter();
        let has = told.filter_map(|(_, told)| match told {
            Wire::Status(status) => Some(status.host),
            _ => None,
        });
        if has.collect::<BTreeSet<HostId>>().len() == usize::from(hosts) {
            return Some(1e3 * team.rig.now.since(said).as_secs());
        }
    }
    None
}

#[test]
fn an_operator_has_the_confirmation_of_each_host_of_a_field() {
    for keys in [Keys::Team, Keys::Members] {
        for speed_m_s in [0.0, 1.0] {
            let cell = Cell { hosts: 21, speed_m_s, ..FIELD };
            let after_ms = confirmed(cell, keys);
            println!("{cell:?} {keys:?}: confirmed after {after_ms:?} ms");
            assert!(after_ms.is_some_and(|ms| ms <= 1500.0), "{cell:?} {keys:?}: {after_ms:?}");
        }
    }
    if seconds().is_some() {
        println!("50 robots: confirmed after {:?} ms", confirmed(Cell { hosts: 51, ..FIELD }, Keys::Team));
    }
}

/// Returns the time of each cell that the environment asks for \[s\].
fn seconds() -> Option<u64> {
    std::env::var("MESH_SECONDS").ok().map(|text| text.parse().expect("MESH_SECONDS is a number"))
}

/// Returns the hosts that have believed an instruction, and those of which the state server has believed a heartbeat,
/// in a line of five whose middle host passes nothing on, or a field.
fn with_one_that_withholds(cell: Cell, liar: u16) -> (Team, BTreeSet<u16>, BTreeSet<u16>) {
    let hosts = cell.hosts;
    let deaf = |index: u16| {
        let config = host(index, hosts, Keys::Members);
        if index != liar {
            return config;
        }
        // It speaks for itself and hears all, and is no part of the mesh.
        Config { links: vec![Some(Setup::multicast(Reliabilities::new()))], ..config }
    };
    let mut team = Team::new(cell, (0..hosts).map(deaf));
    publish(&mut team, hosts, Span::from_millis(7000));
    let has_mode =
        |host: &u16| team.rig.delivered[usize::from(*host)].iter().any(|(_, told)| matches!(told, Wire::Mode(_)));
    let modes = (0..hosts).filter(has_mode).collect();
    let beats = team.rig.delivered[0].iter().filter_map(|(_, told)| match told {
        Wire::Heartbeat(beat) => Some(beat.robot.0),
        _ => None,
    });
    let beats = beats.collect();
    (team, modes, beats)
}

#[test]
fn one_that_withholds_is_walked_around_where_a_way_exists() {
    let cell = Cell { speed_m_s: 0.0, loss: 0.05, ..FIELD };
    let (_, modes, beats) = with_one_that_withholds(cell, 7);
    let all: BTreeSet<u16> = (1..cell.hosts).filter(|host| *host != 7).collect();
    assert!(modes.is_superset(&all) && beats.is_superset(&all), "{modes:?} {beats:?}");
}

#[test]
fn one_that_withholds_where_no_other_way_exists_cuts_the_team_and_is_named() {
    let cell = Cell { hosts: 5, loss: 0.0, ..LINE };
    let (team, modes, beats) = with_one_that_withholds(cell, 2);
    assert!(modes.contains(&1) && !modes.contains(&3) && !beats.contains(&4), "{modes:?} {beats:?}");
    let named = |host: usize| {
        team.rig.peers[host].iter().filter(|peer| peer.withholds).map(|peer| peer.host).collect::<Vec<u16>>()
    };
    assert_eq!([0, 1, 3, 4].map(named), [vec![], vec![2], vec![2], vec![]]);
}

#[test]
fn each_host_of_a_line_and_an_operator_beside_it_name_the_neighbour_by_which_they_hear_the_others() {
    let (robots, cell) = (5, Cell { hosts: 6, loss: 0.0, ..LINE });
    for keys in [Keys::Team, Keys::Members] {
        let mut team = Team::new(cell, (0..cell.hosts).map(|index| host(index, robots, keys)));
        publish(&mut team, robots, Span::from_millis(6000));
        for at in 0..cell.hosts {
            let hops = team.rig.ways[usize::from(at)].hops.clone().expect("its link is a mesh");
            let by: Vec<(u16, u16)> = hops.iter().map(|hop| (hop.host, hop.by)).collect();
            let next = |to: u16| if to < at { at - 1 } else { at + 1 };
            let expected: Vec<(u16, u16)> = (0..robots).filter(|to| *to != at).map(|to| (to, next(to))).collect();
            assert_eq!(by, expected, "at {at}, {keys:?}");
            assert!(hops.iter().all(|hop| hop.age_s < 1.0), "at {at}, {keys:?}: {hops:?}");
        }
        let overheard = |at: usize| {
            let pairs = team.rig.ways[at].overheard.iter().map(|one| (one.at, one.host));
            pairs.collect::<Vec<(u16, u16)>>()
        };
        assert_eq!((overheard(5), overheard(4)), (vec![(4, 3)], vec![]), "hosts report for themselves");
    }
}
