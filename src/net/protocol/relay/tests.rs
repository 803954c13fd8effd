//! Relays of a team with members' keys, one of which lies: it alters, invents, records and holds back.

use std::collections::BTreeMap;

use super::entry::Entry;
use super::*;
use crate::messages::geometry::{Task, Vec2};
use crate::messages::latch::Latch;
use crate::messages::wire::{Heartbeat, Mode, Phase, Round};
use crate::net::protocol::member::public;
use crate::net::protocol::signatures::Signatures;
use crate::random::Seed;

const HOSTS: u16 = 4;
const SERVER: HostId = HostId(0);
/// Robot's host out of reach of the state server, and the two between them.
const ROBOT: HostId = HostId(3);
const HONEST: HostId = HostId(1);
const LIAR: HostId = HostId(2);

/// Host of the team, with its keys.
struct Host(Relay, Key);

fn key(host: HostId) -> Key {
    let secret = |of: u16| *blake3::hash(&of.to_le_bytes()).as_bytes();
    let pair = |one: u16, other: u16| {
        let mut bytes = [3; 32];
        bytes[..2].copy_from_slice(&one.min(other).to_le_bytes());
        bytes[2..4].copy_from_slice(&one.max(other).to_le_bytes());
        bytes
    };
    let publics: BTreeMap<_, _> = (0..HOSTS).map(|of| (HostId(of), public(&secret(of)))).collect();
    let signatures = Signatures::new(Some(secret(host.0)), &publics).expect("they are public keys");
    let pairs = (0..HOSTS).map(|other| (HostId(other), pair(host.0, other))).collect();
    Key::of_member([9; 32], pairs).with_signatures(signatures)
}

impl Host {
    fn new(host: HostId, incarnation: u32) -> Host {
        let mut stream = Seed::of_run(u64::from(incarnation)).stream(&format!("relay/{}", host.0));
        Host(Relay::new(Identity { host, team: 7, incarnation }, SERVER, &mut stream), key(host))
    }

    fn says(&mut self, ms: u64) -> Block {
        let block = self.0.choose(at_ms(ms), Some(&self.1));
        self.0.said(at_ms(ms), &block.entries);
        block
    }

    fn hears(&mut self, ms: u64, from: HostId, block: &Block) -> Vec<(HostId, Wire)> {
        self.0.hear(at_ms(ms), from, block, Some(&self.1), |_, _| true)
    }
}

fn at_ms(ms: u64) -> Time {
    Time::ZERO + Span::from_millis(ms)
}

fn beat(number: u32) -> Wire {
    let round = Round { term: 1, episode: number };
    Wire::Heartbeat(Heartbeat::new(RobotId(ROBOT.0), round, Phase::Running, Latch::default()))
}

fn mode(number: u32) -> Wire {
    let (round, first, latch) = (Round { term: 1, episode: number }, RobotId(0), Latch::default());
    let tasks = vec![Task { start: Vec2::new(0.5, 1.0), goal: Vec2::new(2.0, 1.0) }; usize::from(HOSTS)];
    Wire::Mode(Mode { round, repeat: 0, phase: Phase::Running, first, tasks: tasks.into(), latch })
}

/// A state server and a robot's host that have met over the honest host, at 1 s, and all that each has said.
struct Met {
    server: Host,
    honest: Host,
    robot: Host,
    of_server: Vec<Block>,
    of_robot: Vec<Block>,
}

fn met() -> Met {
    let [server, honest, robot] = [(SERVER, 10), (HONEST, 11), (ROBOT, 13)].map(|(host, run)| Host::new(host, run));
    let mut met = Met { server, honest, robot, of_server: Vec::new(), of_robot: Vec::new() };
    for ms in (0..=1000).step_by(250) {
        met.turn(ms, ms as u32);
    }
    met
}

impl Met {
    /// Lets each end say something, and the honest host pass it on. Returns what the server and the robot believe.
    fn turn(&mut self, ms: u64, number: u32) -> [Vec<(HostId, Wire)>; 2] {
        self.server.0.put(at_ms(ms), &mode(number));
        self.robot.0.put(at_ms(ms), &beat(number));
        let (down, up) = (self.server.says(ms), self.robot.says(ms));
        assert_eq!(self.honest.hears(ms, SERVER, &down), [], "it has no robot, and is not the server");
        self.honest.hears(ms, ROBOT, &up);
        let on = self.honest.says(ms);
        let believed = [self.server.hears(ms, HONEST, &on), self.robot.hears(ms, HONEST, &on)];
        self.of_server.push(down);
        self.of_robot.push(up);
        believed
    }
}

fn entries(entries: Vec<Frame>) -> Block {
    Block { entries, ..Block::default() }
}

fn heads(block: &Block, content: Content) -> Vec<Frame> {
    let is = |entry: &&Frame| Entry::read(entry).is_some_and(|(head, ..)| head.content == content);
    block.entries.iter().filter(is).cloned().collect()
}

#[test]
fn what_is_passed_on_is_believed_by_who_it_is_for_once_each_end_has_echoed_the_other() {
    let mut met = met();
    let [server, robot] = met.turn(1250, 7);
    assert_eq!(server, [(ROBOT, beat(7))]);
    assert_eq!(robot, [(SERVER, mode(7))]);
    assert!(met.honest.0.counts().passed_on > 0);
}

#[test]
fn an_entry_that_is_altered_anywhere_is_not_believed() {
    let mut met = met();
    met.server.0.put(at_ms(1250), &mode(9));
    met.robot.0.put(at_ms(1250), &beat(9));
    let (down, up) = (met.server.says(1250), met.robot.says(1250));
    let own = [heads(&down, Content::Lead), heads(&up, Content::Message(Kind::Heartbeat))].map(|all| all[0].clone());
    for (entry, ends) in own.iter().zip([ROBOT, SERVER]) {
        for bit in 16..8 * entry.len() {
            let mut turned = entry.to_vec();
            turned[bit / 8] ^= 1 << (bit % 8);
            let reader = if ends == ROBOT { &mut met.robot } else { &mut met.server };
            let believed = reader.hears(1250, LIAR, &entries(vec![turned.into()]));
            assert_eq!(believed, [], "bit {bit}");
        }
    }
    assert_eq!(met.server.hears(1250, HONEST, &up), [(ROBOT, beat(9))], "what is sound is believed afterwards");
    assert!(met.server.0.counts().forged > 0 && met.robot.0.counts().forged > 0);
}

#[test]
fn a_member_makes_no_entry_in_the_name_of_another() {
    let mut met = met();
    let head = |origin: HostId, incarnation, content, echo: &Block| {
        let (theirs, ..) = Entry::read(&echo.entries[0]).expect("it is one");
        Entry { origin, incarnation, number: theirs.number + 1, content, echoes: theirs.echoes }
    };
    let (up, down) = (met.of_robot.last().expect("it has spoken"), met.of_server.last().expect("it has spoken"));
    let liar = key(LIAR);
    let body = rmp_serde::encode::to_vec(&beat(99)).expect("it is plain");
    let forged = head(ROBOT, 13, Content::Message(Kind::Heartbeat), up);
    let forged = proof::sealed(&forged, &body, 7, Some(&liar), SERVER);
    assert_eq!(met.server.hears(1010, LIAR, &entries(vec![forged])), []);
    let Wire::Mode(false_mode) = mode(99) else { panic!("it is one") };
    let forged = head(SERVER, 10, Content::Lead, down);
    let forged = proof::sealed(&forged, &Lead::body(&false_mode), 7, Some(&liar), SERVER);
    assert_eq!(met.robot.hears(1010, LIAR, &entries(vec![forged])), []);
    // Other starts and goals than those that the instruction names.
    let other =
        Layout::of(&Mode { tasks: vec![Task { start: Vec2::zeros(), goal: Vec2::zeros() }; 4].into(), ..false_mode });
    let other = other.entry(Identity { host: LIAR, team: 7, incarnation: 12 });
    assert_eq!(met.robot.hears(1010, LIAR, &entries(vec![other])), []);
}

#[test]
fn what_was_recorded_or_held_back_for_two_seconds_is_not_believed() {
    let mut met = met();
    met.server.0.put(at_ms(1250), &mode(9));
    met.robot.0.put(at_ms(1250), &beat(9));
    let (down, up) = (met.server.says(1250), met.robot.says(1250));
    assert_eq!(met.server.hears(3300, LIAR, &up), [], "held back");
    assert_eq!(met.robot.hears(3300, LIAR, &down), [], "held back");
    assert!(met.server.0.counts().unfresh > 0 && met.robot.0.counts().unfresh > 0);
    // A new run of the robot's host and of the server's, which hear all that was said before.
    let (mut robot, mut server) = (Host::new(ROBOT, 23), Host::new(SERVER, 20));
    for (up, down) in met.of_robot.iter().zip(&met.of_server) {
        assert_eq!(robot.hears(100, LIAR, down), []);
        assert_eq!(server.hears(100, LIAR, up), []);
    }
    // What came before is not believed again.
    met.turn(3500, 10);
    let [server, _] = met.turn(3750, 11);
    assert_eq!(server, [(ROBOT, beat(11))]);
    let again = met.of_robot.last().expect("it has spoken").clone();
    assert_eq!(met.server.hears(3760, LIAR, &again), []);
}

#[test]
fn inventions_of_a_liar_keep_no_true_entry_from_being_passed_on() {
    let mut met = met();
    let mut believed = 0;
    for turn in 0..20_u32 {
        let ms = 1250 + 250 * u64::from(turn);
        // It invents newer heartbeats of the robot's, which a relay cannot check, and says recorded instructions.
        let (last, body, _) = Entry::read(&met.of_robot[met.of_robot.len() - 1].entries[0]).expect("it is one");
        let invented = (0..5_u32).map(|more| {
            let head = Entry { number: last.number.wrapping_add(500 + 7 * more + turn), ..last.clone() };
            head.bytes(body, &[1; 8])
        });
        let mut lies: Vec<Frame> = invented.collect();
        lies.extend(met.of_server[0].entries.iter().cloned());
        met.honest.hears(ms - 100, LIAR, &entries(lies));
        let [server, robot] = met.turn(ms, 100 + turn);
        // One that may be the older of two waits for longer than a period of states.
        let late = met.honest.says(ms + 70);
        let late = met.server.hears(ms + 70, HONEST, &late).len();
        assert_eq!((server.len() + late, robot.len()), (1, 1), "turn {turn}");
        believed += 1;
    }
    assert_eq!(believed, 20);
}

#[test]
fn starts_and_goals_travel_once_and_who_lacks_them_is_told() {
    let mut met = met();
    let layouts = |blocks: &[Block]| blocks.iter().map(|block| heads(block, Content::Layout).len()).sum::<usize>();
    assert!((1..=2).contains(&layouts(&met.of_server)), "{}", layouts(&met.of_server));
    // A host that has missed them.
    let mut late = Host::new(ROBOT, 33);
    let mut believed = Vec::new();
    for ms in (1250..3500).step_by(250) {
        met.server.0.put(at_ms(ms), &mode(ms as u32));
        late.0.put(at_ms(ms), &beat(ms as u32));
        let (down, up) = (met.server.says(ms), late.says(ms));
        met.server.hears(ms, ROBOT, &up);
        believed.extend(late.hears(ms, SERVER, &down));
    }
    assert!(believed.len() >= 4, "{}", believed.len());
}

#[test]
fn numbers_grow_and_what_a_host_says_is_bounded() {
    let mut stream = Seed::of_run(1).stream("echoes");
    let mut echoes = Echoes::new(&mut stream);
    let numbers: Vec<u32> = (0..100).map(|at| echoes.number(at_ms(at / 10))).collect();
    assert!(numbers.windows(2).all(|pair| pair[1].wrapping_sub(pair[0]) < 1000 && pair[0] != pair[1]));
    let mut host = Host::new(HONEST, 11);
    for robot in 0..100_u16 {
        let round = Round { term: 1, episode: 1 };
        let beat = Wire::Heartbeat(Heartbeat::new(RobotId(robot), round, Phase::Running, Latch::default()));
        host.0.put(at_ms(0), &beat);
    }
    let block = host.says(0);
    let bytes: usize = block.entries.iter().map(|entry| entry.len()).sum();
    assert!(block.entries.len() <= MOST_ENTRIES && bytes <= MOST_BYTES, "{} {bytes}", block.entries.len());
    assert!(host.0.due().is_some(), "the others leave soon");
}
