//! Retransmissions: every copy goes to a host that lacks the datagram, as far as its sender can know. Duplicates are as
//! rare as with a stop-and-wait protocol of the same loss, retries and round-trip time.

use std::collections::{BTreeMap, BTreeSet};

use crate::rig::{LINK, Rig, TEAM, key, latent};
use murmurate::actors::network::{Config, Identity};
use murmurate::messages::geometry::Motion;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::wire::{Kind, MotorCommand, Reading, Wire};
use murmurate::net::protocol::codec::TAG_BYTES;
use murmurate::net::protocol::codec::{self, Content, Flags, MAX_FRAME_BYTES};
use murmurate::net::protocol::reliability::{Reliabilities, Reliability, Setup};
use murmurate::net::protocol::report::read_ids;
use murmurate::net::protocol::retransmit::{RETRIES, RETRY_AFTER};
use murmurate::net::protocol::router::{Audience, Route, Router};
use murmurate::random::Seed;
use murmurate::time::{Span, Time};
use proptest::prelude::*;
use rand::RngExt;

/// One-way delay in the rig, and the longest wait of an acknowledgement for others.
const ONE_WAY_S: f64 = 300e-6;
const ACK_WAIT_S: f64 = 2e-3;

/// Returns a configuration in which host 0 sends readings and motor commands of robot i to host i, or latents to all.
fn config(host: u16, hosts: usize, reliability: Reliability, to: To) -> Config {
    let router = Router::new(hosts, |kind, robot| match (kind, to) {
        (Kind::Reading | Kind::MotorCommand, To::One) => Route {
            local: robot.0 == host && host > 0,
            leaves: (host == 0).then_some((LINK, Audience::Host(HostId(robot.0)))),
        },
        (Kind::Latent, To::All) => Route { local: host > 0, leaves: (host == 0).then_some((LINK, Audience::All)) },
        _ => Route::default(),
    });
    let kinds = [Kind::Reading, Kind::MotorCommand, Kind::Latent].map(|kind| (kind, reliability));
    let setup = if to == To::One { Setup::unicast } else { Setup::multicast };
    let me = Identity { host: HostId(host), team: TEAM, incarnation: 1 };
    Config { me, key: Some(key()), links: vec![Some(setup(Reliabilities::from(kinds)))], router, parts: None }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum To {
    One,
    All,
}

fn reading(robot: u16, number: u64) -> Wire {
    Wire::Reading(Reading::of_point(RobotId(robot), number, Motion::default()))
}

fn command(robot: u16) -> Wire {
    let velocity = Motion::default().velocity;
    Wire::MotorCommand(MotorCommand { robot: RobotId(robot), velocity, valid_for: Span::from_millis(200) })
}

/// Returns a team in which host 0 and each other host have accepted each other.
fn team(receivers: u16, reliability: Reliability, to: To) -> Rig {
    let hosts = receivers + 1;
    let mut rig = Rig::new((0..hosts).map(|host| config(host, hosts.into(), reliability, to)));
    rig.run_ms(2500);
    rig.arrived = Some(Vec::new());
    rig.sent.clear();
    rig
}

/// Checks and counts the copies that host 0 has sent: each is the datagram of that number to that audience, and a host
/// lacked it as far as host 0 could know.
fn checked_copies(rig: &Rig, reliability: Reliability) -> u64 {
    let mut originals = BTreeMap::new();
    let arrived = rig.arrived.as_ref().expect("arrivals are remembered");
    let mut told: Vec<(Time, u16, Content, bool, u32)> = Vec::new();
    for (at, to, frame) in arrived.iter().filter(|(_, to, _)| *to == 0) {
        let header = codec::peek(frame).expect("a sound datagram");
        for (content, body) in codec::blocks(&frame[..frame.len() - TAG_BYTES]).flatten() {
            if !matches!(content, Content::Ack | Content::Nack) {
                continue;
            }
            let names = read_ids(content, body).expect("sound names").into_iter();
            let mine = names.filter(|name| usize::from(name.host.0) == *to);
            told.extend(mine.map(|name| (*at, header.sender.0, content, name.direct, name.sequence)));
        }
    }
    let mut copies = 0;
    for flight in rig.sent.iter().filter(|flight| flight.from == 0) {
        let header = codec::peek(&flight.frame).expect("a sound datagram");
        let one = if let Audience::Host(host) = flight.audience { Some(host.0) } else { None };
        let (id, plain) = ((one, header.sequence), flight.frame[2..flight.frame.len() - TAG_BYTES].to_vec());
        if !header.flags.has(Flags::COPY) {
            assert!(originals.insert(id, plain).is_none(), "each number is given once");
            continue;
        }
        copies += 1;
        assert_eq!(originals.get(&id), Some(&plain), "a copy goes where its original went");
        let named = told.iter().filter(|(_, _, _, direct, number)| (*direct, *number) == (one.is_some(), id.1));
        let mut before = named.filter(|(at, ..)| *at <= flight.at);
        if reliability == Reliability::Nack {
            let asks = |(at, from, content, ..): &(Time, u16, Content, bool, u32)| {
                *at == flight.at && *content == Content::Nack && one.is_none_or(|one| one == *from)
            };
            assert!(before.any(asks), "a copy answers a host that asks for it");
        } else {
            let acked: BTreeSet<u16> = before.filter(|(at, ..)| *at < flight.at).map(|(_, from, ..)| *from).collect();
            let lacks = one.map_or(acked.len() < rig.networks.len() - 1, |one| !acked.contains(&one));
            assert!(lacks, "a copy goes to a host that has not acknowledged it");
        }
    }
    copies
}

/// Returns the duplicates per message of stop-and-wait: it retransmits to all receivers after the same times until each
/// has acknowledged. Copies and acknowledgements are lost alike.
fn model(receivers: u16, loss: f64) -> f64 {
    const MESSAGES: u32 = 20_000;
    let mut stream = Seed::of_run(9).stream("model");
    let mut duplicates = 0u32;
    for _ in 0..MESSAGES {
        let mut has = vec![false; receivers.into()];
        let mut acked_at = vec![f64::INFINITY; receivers.into()];
        let (mut at, mut wait) = (0.0, RETRY_AFTER.as_secs());
        for _ in 0..=RETRIES {
            if acked_at.iter().all(|acked| *acked <= at) {
                break;
            }
            for (has, acked_at) in has.iter_mut().zip(&mut acked_at) {
                if stream.random_bool(1.0 - loss) {
                    duplicates += u32::from(std::mem::replace(has, true));
                    if stream.random_bool(1.0 - loss) {
                        *acked_at = acked_at.min(at + 2.0 * ONE_WAY_S + ACK_WAIT_S);
                    }
                }
            }
            (at, wait) = (at + wait, 2.0 * wait);
        }
    }
    f64::from(duplicates) / f64::from(MESSAGES)
}

/// Returns duplicates and deliveries per message, to one or all of `receivers`, at a loss of 30 %.
fn repaired(receivers: u16, reliability: Reliability, to: To) -> (f64, f64) {
    let mut rig = team(receivers, reliability, to);
    rig.loss = 0.3;
    let before: u64 = (0..rig.networks.len()).map(|host| rig.counts[host].duplicate).sum();
    let rounds = 2000 / u64::from(receivers);
    let mut said = 0;
    for round in 0..rounds {
        for host in 1..=receivers {
            match to {
                To::One => {
                    rig.publish(0, reading(host, round));
                    said += 1;
                }
                To::All if host == 1 => {
                    rig.publish(0, latent(1, round as u32));
                    said += 1;
                }
                To::All => {}
            }
        }
        // Missing datagrams are detected from reports, one every 250 ms.
        rig.run_ms(if reliability == Reliability::Nack { 400 } else { 120 });
        if to == To::One {
            // A receiver detects a gap from the next datagram that is addressed to it.
            (1..=receivers).for_each(|host| rig.publish(0, command(host)));
            said += usize::from(receivers);
        }
        rig.run_ms(130);
    }
    let delivered: usize = rig.delivered.iter().map(Vec::len).sum();
    let copies = checked_copies(&rig, reliability);
    assert!(copies > 50, "there is something to repair");
    assert!(rig.sent.iter().all(|flight| flight.bytes <= MAX_FRAME_BYTES));
    for host in 0..rig.networks.len() {
        rig.counted(host);
    }
    let after: u64 = rig.counts.iter().map(|counts| counts.duplicate).sum();
    ((after - before) as f64 / said as f64, delivered as f64 / said as f64)
}

#[test]
fn every_copy_goes_to_a_host_that_lacks_it_and_duplicates_are_those_of_stop_and_wait() {
    println!("| reliability | receivers | addressed | delivered | duplicates a message | stop-and-wait |");
    for reliability in [Reliability::Ack, Reliability::Nack] {
        for receivers in [2u16, 5, 10, 20] {
            for to in [To::One, To::All] {
                let addressed = if to == To::One { 1 } else { receivers };
                let (duplicates, delivered) = repaired(receivers, reliability, to);
                let (delivered, expected) = (delivered / f64::from(addressed), model(addressed, 0.3));
                println!(
                    "| {reliability:?} | {receivers} | {to:?} | {delivered:.3} | {duplicates:.3} | {expected:.3} |"
                );
                assert!(duplicates <= 1.2 * expected, "{reliability:?}, {receivers}, {to:?}");
                // 70 % arrive without retransmission. An addressed datagram that is missing is detected only from the
                // next one, and 30 % of those are lost as well.
                let bar = match (reliability, to) {
                    (Reliability::Ack, _) => 0.99,
                    (_, To::All) => 0.95,
                    (_, To::One) => 0.86,
                };
                assert!(delivered >= bar, "{reliability:?}, {receivers}, {to:?}: {delivered}");
            }
        }
    }
}

#[test]
fn acknowledgements_do_not_exceed_the_size_limit_of_a_large_datagram() {
    let mut rig = Rig::team(9, Reliabilities::from([(Kind::Latent, Reliability::Ack)]));
    rig.meet();
    rig.run_ms(1000);
    rig.sent.clear();
    rig.delivered[1].clear();
    let large = |robot: u16, number: u32| match latent(robot, number) {
        Wire::Latent(mut latent) => {
            latent.features = murmurate::messages::wire::Features(vec![0.5; 256].into());
            Wire::Latent(latent)
        }
        other => other,
    };
    for number in 0..20 {
        // Host 0 has eight datagrams to acknowledge just before it sends a large one itself.
        (1..9u16).for_each(|host| rig.publish(usize::from(host), latent(host, number)));
        rig.run_ms(1);
        rig.publish(0, large(0, number));
        rig.run_ms(99);
    }
    assert!(rig.sent.iter().all(|flight| flight.bytes <= MAX_FRAME_BYTES), "no datagram is too large");
    let large = rig.sent.iter().filter(|flight| flight.bytes > 1100).count();
    assert!(large >= 20, "{large} large datagrams");
    assert!((0..9).all(|host| rig.counted(host).malformed == 0));
    assert_eq!(rig.delivered[1].iter().filter(|(_, message)| message.robot().0 == 0).count(), 20);
    assert!(rig.sent.iter().all(|flight| flight.frame[1] & Flags::COPY == 0), "and all were acknowledged in time");
}

#[test]
fn each_of_twenty_streams_is_offered_for_retransmission() {
    // One host sends one latent each of twenty robots; then nothing but soft state.
    let router = |host: u16| {
        Router::new(21, move |_, _| Route { local: host == 1, leaves: (host == 0).then_some((LINK, Audience::All)) })
    };
    let config = |host: u16| {
        let setup = Setup::multicast(Reliabilities::from([(Kind::Latent, Reliability::Nack)]));
        let me = Identity { host: HostId(host), team: TEAM, incarnation: 1 };
        Config { me, key: Some(key()), links: vec![Some(setup)], router: router(host), parts: None }
    };
    let mut rig = Rig::new([config(0), config(1)]);
    rig.run_ms(2500);
    rig.loss = 1.0;
    (0..20).for_each(|robot| rig.publish(0, latent(robot, 1)));
    rig.loss = 0.0;
    rig.run_ms(3000);
    let robots: BTreeSet<u16> = rig.delivered[1].iter().map(|(_, message)| message.robot().0).collect();
    assert_eq!(robots.len(), 20, "{robots:?}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_schedule_retransmits_to_a_host_that_has_the_datagram(
        receivers in 2u16..12,
        ack in any::<bool>(),
        one in any::<bool>(),
        loss in 0.0f64..0.6,
        jitter_us in 0u64..3000,
        schedule in prop::collection::vec((0u64..60, 1u16..12, any::<bool>()), 1..80),
    ) {
        let reliability = if ack { Reliability::Ack } else { Reliability::Nack };
        let to = if one { To::One } else { To::All };
        let mut rig = team(receivers, reliability, to);
        (rig.loss, rig.jitter) = (loss, Span::from_nanos(jitter_us * 1000));
        for (number, (wait_ms, robot, second)) in schedule.into_iter().enumerate() {
            let robot = 1 + robot % receivers;
            let message = match to {
                To::All => latent(robot, number as u32),
                To::One if second => command(robot),
                To::One => reading(robot, number as u64),
            };
            rig.publish(0, message);
            rig.run_ms(wait_ms);
        }
        rig.run_ms(500);
        checked_copies(&rig, reliability);
        for (host, got) in rig.delivered.iter().enumerate() {
            let mut newest = BTreeMap::new();
            for (_, message) in got {
                prop_assert!(to == To::All || usize::from(message.robot().0) == host, "it is for this host");
                let number = match message {
                    Wire::Reading(reading) => reading.stamp_ns,
                    Wire::Latent(latent) => latent.round.episode.into(),
                    _ => continue,
                };
                let before = newest.insert(message.robot(), number);
                prop_assert!(before.is_none_or(|before| before < number), "each once, and in order");
            }
        }
    }
}
