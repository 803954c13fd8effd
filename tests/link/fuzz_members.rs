//! Datagrams of a member of the team with valid tags and whatever content: the host that they reach does not panic, and
//! believes nothing that this member may not say.
//!
//! `MURMURATE_SEALED=100000000` sends so many.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::fuzz_decoders::{corpus, mutate};
use crate::rig::{LINK, Rig, TEAM, config, latent, multicast};
use ed25519_dalek::{Signer, SigningKey};
use murmurate::actor::Core;
use murmurate::actors::network::{Config, In, Out};
use murmurate::messages::geometry::{Motion, Pose, Task, Vec2};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{
    Aloft, Cut, Flight, Heartbeat, KINDS, Located, Mode, MotorCommand, Observe, Phase, Place, Reading, Release, Round,
    Signature, Status, Stop, Telemetry, Whereabouts, Wire,
};
use murmurate::net::protocol::codec::{self, Flags, Header};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::member::public;
use murmurate::net::protocol::reliability::Reliabilities;
use murmurate::net::protocol::router::{Audience, Publishers, Route, Router};
use murmurate::net::protocol::signatures::Signatures;
use murmurate::random::{Seed, Stream};
use murmurate::time::Span;
use rand::RngExt;

/// Host of robot 1 and of nothing else, which sends.
const MEMBER: HostId = HostId(1);
const OPERATOR: HostId = HostId::operator(1);
const MEMBERS: [HostId; 4] = [HostId(0), MEMBER, HostId(2), OPERATOR];
/// Number of datagrams that a team gets before it is a new one: its rate limit and its window begin anew.
const EPOCH: usize = 5000;

fn secret(of: HostId) -> [u8; 32] {
    *blake3::hash(&of.0.to_le_bytes()).as_bytes()
}

fn signatures(of: HostId) -> Signatures {
    let members = MEMBERS.map(|member| (member, public(&secret(member)))).into();
    Signatures::new(Some(secret(of)), &members).expect("they are public keys")
}

fn key(of: HostId) -> Key {
    let pair = |one: HostId, other: HostId| {
        let mut bytes = [3; 32];
        bytes[..2].copy_from_slice(&one.min(other).0.to_le_bytes());
        bytes[2..4].copy_from_slice(&one.max(other).0.to_le_bytes());
        bytes
    };
    let pairs = MEMBERS.map(|other| (other, pair(of, other))).into();
    Key::of_member([9; 32], pairs).with_signatures(signatures(of))
}

fn host(id: HostId) -> Config {
    let publishers = Publishers {
        names: ["a", "b", "c"].map(str::to_owned).to_vec(),
        agents: vec![HostId(0), MEMBER, HostId(2)],
        actuators: vec![HostId(0), MEMBER, HostId(2)],
        localizers: vec![HostId(2); 3],
        server: HostId(2),
    };
    let router = Router::new(4, |_, _| Route { local: true, leaves: Some((LINK, Audience::All)) });
    let router = router.with_publishers(Arc::new(publishers));
    Config { router, ..config(id.0, 4, 1, Some(key(id)), multicast(Reliabilities::new())) }
}

/// Returns whether the member may say this: the table of docs/wire.md, for a host of one robot.
fn may_say(message: &Wire, recorded: &Wire) -> bool {
    let own = RobotId(1);
    match message {
        Wire::Heartbeat(beat) => beat.robot == own,
        Wire::Latent(latent) => latent.robot == own,
        Wire::MotorCommand(command) => command.robot == own,
        Wire::Stop(stop) => stop.by == MEMBER && !stop.latch.is_clear(),
        Wire::Status(status) => status.host == MEMBER,
        Wire::Telemetry(telemetry) => telemetry.host == MEMBER,
        Wire::Located(located) => located.host == MEMBER && located.robots.is_empty(),
        Wire::Release(_) => message == recorded,
        Wire::Aloft(aloft) => aloft.robot == own,
        Wire::Mode(_) | Wire::Reading(_) | Wire::Sensed(_) | Wire::Observe(_) | Wire::Place(_) | Wire::Cut(_) => false,
    }
}

/// Returns a message in any name.
fn any(stream: &mut Stream, recorded: &Wire) -> Wire {
    let host = [HostId(0), MEMBER, HostId(2), HostId(7), OPERATOR][stream.random_range(0..5usize)];
    let robot = RobotId(stream.random_range(0..4));
    let number = [0, 1, 5, 6, 1 << 40][stream.random_range(0..5usize)];
    let latch = [Latch::clear, Latch::held, Latch::engaged][stream.random_range(0..3usize)](number);
    let (round, phase) = (Round { term: 1, episode: stream.random() }, Phase::from(stream.random_range(0..9u8)));
    match stream.random_range(0..15u8) {
        13 => Wire::Aloft(Aloft { robot, flight: Flight::from(stream.random_range(0..6u8)) }),
        14 => Wire::Cut(Cut { by: host, robot }),
        0 => Wire::Heartbeat(Heartbeat::new(robot, round, phase, latch)),
        1 => latent(robot.0, stream.random()),
        2 => Wire::MotorCommand(MotorCommand { robot, velocity: Vec2::zeros(), valid_for: Span::ZERO }),
        3 => Wire::Reading(Reading::of_point(robot, stream.random(), Motion::default())),
        4 => {
            let tasks = [Task { start: Vec2::zeros(), goal: Vec2::zeros() }; 2].into();
            Wire::Mode(Mode { round, repeat: 0, phase, first: robot, tasks, latch })
        }
        5 => Wire::Status(Status::of(host, stream.random(), Vec::new(), None)),
        6 => Wire::Telemetry(Telemetry::of(host, Vec::new())),
        7 => Wire::Observe(Observe { by: host }),
        8 => Wire::Place(Place { by: host, number: 1, robot, pose: Pose::default() }),
        9 => Wire::Located(Located { host, robots: vec![(robot, Whereabouts::Known)], answer: None }),
        10 => recorded.clone(),
        11 => {
            let hosts = vec![(HostId(0), 1), (MEMBER, 1)];
            let signature = Signature(std::array::from_fn(|_| stream.random()));
            Wire::Release(Release { by: host, latch, hosts, signature })
        }
        _ => Wire::Stop(Stop { by: host, latch }),
    }
}

/// Team with a release of its operator that the member has recorded.
fn team() -> (Rig, Wire) {
    let mut rig = Rig::new([host(HostId(0)), host(MEMBER), host(HostId(2)), host(OPERATOR)]);
    (0..4).for_each(|_| rig.meet());
    rig.publish(3, Wire::Stop(Stop { by: OPERATOR, latch: Latch::held(3) }));
    rig.run_ms(20);
    let recorded = rig.delivered[1].iter().map(|(_, message)| message).find(|m| matches!(m, Wire::Release(_)));
    let recorded = recorded.expect("an operator signs").clone();
    (rig, recorded)
}

/// Appends the member's signature to a datagram that begins with a message which counts with it alone, as docs/wire.md
/// says. All that follows the header of its block is the body of the message then.
fn sign(frame: &mut Vec<u8>, edition: u32) {
    const BODY: usize = codec::HEADER_BYTES + codec::BLOCK_BYTES;
    let kind = frame.get(codec::HEADER_BYTES).and_then(|byte| KINDS.get(usize::from(*byte)));
    if frame.len() < BODY || !kind.is_some_and(|kind| kind.is_signed()) {
        return;
    }
    let length = (frame.len() - BODY) as u16;
    frame[BODY - 2..BODY].copy_from_slice(&length.to_le_bytes());
    let mut signed = b"murmurate 2026-11-28 message".to_vec();
    signed.extend_from_slice(&frame[2..4]);
    signed.extend_from_slice(&LINK.0.to_le_bytes());
    signed.extend_from_slice(&frame[4..10]);
    signed.extend_from_slice(&edition.to_le_bytes());
    signed.push(frame[codec::HEADER_BYTES]);
    signed.extend_from_slice(&frame[BODY..]);
    let signature = SigningKey::from_bytes(&secret(MEMBER)).sign(&signed).to_bytes();
    frame.extend_from_slice(&[0x86, 68, 0]);
    frame.extend_from_slice(&edition.to_le_bytes());
    frame.extend_from_slice(&signature);
}

/// Returns a datagram of the member, whose content is mutated before it is sealed; `None` if that is too long.
fn sealed(stream: &mut Stream, seal: &Key, (message, sequence): (&Wire, u32), others: &[Vec<u8>]) -> Option<Vec<u8>> {
    let direct = stream.random_range(0..4u8) == 0;
    let flags = Flags(if direct { Flags::DIRECT } else { 0 });
    let header = Header { flags, team: TEAM, sender: MEMBER, incarnation: 1, sequence };
    let mut frame = codec::encode(&header, message).expect("a sound message").to_vec();
    if stream.random_range(0..3u8) > 0 {
        let mut body = frame.split_off(codec::HEADER_BYTES);
        mutate(&mut body, &others[stream.random_range(0..others.len())], stream);
        frame.extend_from_slice(&body);
    }
    if stream.random_range(0..8u8) > 0 {
        sign(&mut frame, sequence);
    }
    let fits = frame.len() <= codec::MAX_PLAIN_BYTES - 40;
    fits.then(|| seal.seal(&mut frame, LINK, direct.then_some(HostId(0))));
    fits.then_some(frame)
}

#[test]
fn a_member_is_believed_nothing_that_it_may_not_say_whatever_it_seals() {
    let rounds = std::env::var("MURMURATE_SEALED").map_or(1_000_000, |rounds| rounds.parse().expect("a number"));
    let mut others: Vec<Vec<u8>> = corpus().into_iter().map(|file| file[codec::HEADER_BYTES..].to_vec()).collect();
    let (mut stream, mut out, seal) = (Seed::of_run(2).stream("sealed"), Vec::new(), key(MEMBER));
    let (mut believed, mut kinds): (u64, BTreeMap<String, u64>) = (0, BTreeMap::new());
    for _ in 0..rounds / EPOCH {
        let (mut rig, recorded) = team();
        for at in 0..EPOCH {
            let message = any(&mut stream, &recorded);
            let Some(frame) = sealed(&mut stream, &seal, (&message, 100 + at as u32), &others) else { continue };
            if others.len() < 300 {
                others.push(frame[codec::HEADER_BYTES..].to_vec());
            }
            let now = rig.now + Span::from_nanos(100_000 * at as u64);
            rig.networks[0].handle(now, In::Frame(LINK, frame.into(), None), &mut out);
            for said in out.drain(..) {
                let Out::Deliver(message) = said else { continue };
                assert!(may_say(&message, &recorded), "{message:?} is believed of a robot's host");
                believed += 1;
                *kinds.entry(format!("{:?}", message.kind())).or_default() += 1;
            }
        }
    }
    println!("{rounds} sealed datagrams, {believed} messages believed: {kinds:?}");
    assert!(believed * 50 > rounds as u64, "the member is heard: {believed} of {rounds}: {kinds:?}");
    let heard = ["Heartbeat", "Latent", "MotorCommand", "Stop", "Status", "Release"];
    assert!(heard.iter().all(|kind| kinds.contains_key(*kind)), "{kinds:?}");
}
