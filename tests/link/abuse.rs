//! Abuse: invalid datagrams of a network, an outsider or a broken host are refused by cause, and no other host suffers.

use std::net::SocketAddr;
use std::sync::Arc;

use crate::rig;
use crate::rig::{LINK, Rig, TEAM, config, key, latent, multicast, network, report};
use murmurate::actor::Core;
use murmurate::actors::network::{Config, Identity, In, Network, Out};
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Heartbeat, Kind, Phase, Round, Stop, Wire};
use murmurate::net::protocol::codec::TAG_BYTES;
use murmurate::net::protocol::codec::{self, Content, Flags, Header};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::link::{Guest, LinkCounts, Standing};
use murmurate::net::protocol::reliability::{Reliabilities, Setup};
use murmurate::net::protocol::report::{Entry, Report, Stamp};
use murmurate::net::protocol::router::{Audience, Publishers, Route, Router};
use murmurate::time::{Span, Time};
use proptest::prelude::*;

/// Returns two hosts that have accepted each other, and one more datagram of host 1 that host 0 has not received.
fn two() -> (Rig, Vec<u8>) {
    let mut rig = Rig::team(2, Reliabilities::new());
    rig.meet();
    rig.counted(0);
    let frame = held_back(&mut rig);
    (rig, frame)
}

/// Returns one more datagram of host 1 that host 0 does not receive.
fn held_back(rig: &mut Rig) -> Vec<u8> {
    let delay = std::mem::replace(&mut rig.delay, Span::from_secs(1e6));
    rig.publish(1, latent(1, 1));
    rig.delay = delay;
    rig.last_data(1).to_vec()
}

/// Returns the counts of host 0 after these datagrams, less those of the last full second.
fn counted_for(rig: &mut Rig, frames: &[Vec<u8>]) -> LinkCounts {
    let before = rig.counts[0];
    rig.delivered[0].clear();
    for frame in frames {
        rig.arrive(0, frame);
    }
    let after = rig.counted(0);
    let less = |of: fn(&LinkCounts) -> u64| of(&after) - of(&before);
    LinkCounts {
        accepted: less(|c| c.accepted),
        own: less(|c| c.own),
        auth: less(|c| c.auth),
        replay: less(|c| c.replay),
        late: less(|c| c.late),
        ahead: less(|c| c.ahead),
        urgent: less(|c| c.urgent),
        skipped: less(|c| c.skipped),
        unproven: less(|c| c.unproven),
        duplicate_id: less(|c| c.duplicate_id),
        team: less(|c| c.team),
        version: less(|c| c.version),
        range: less(|c| c.range),
        duplicate: less(|c| c.duplicate),
        stale: less(|c| c.stale),
        rate: less(|c| c.rate),
        crowd: less(|c| c.crowd),
        malformed: less(|c| c.malformed),
        misrouted: less(|c| c.misrouted),
        ..LinkCounts::default()
    }
}

fn sealed(key: &Key, header: Header, message: &Wire) -> Vec<u8> {
    let mut bytes = codec::encode(&header, message).expect("a sound message").to_vec();
    key.seal(&mut bytes, LINK, None);
    bytes
}

fn header(sender: u16, incarnation: u32, sequence: u32) -> Header {
    Header { flags: Flags::default(), team: TEAM, sender: HostId(sender), incarnation, sequence }
}

/// Returns a datagram whose report proves to host 0 that its sender is alive.
fn lively(rig: &Rig, header: Header, message: &Wire) -> Vec<u8> {
    let mut bytes = codec::encode(&header, message).expect("a sound message").to_vec();
    let mut said = rig.sent.iter().rev().filter(|flight| flight.from == 0);
    let echo = said.find_map(|flight| report(&flight.frame, TAG_BYTES)).expect("host 0 reports").stamp;
    let entry = Entry { host: HostId(0), echo, held: Span::ZERO, lost: 0, challenge: false, direct: None };
    let report = Report { stamp: Stamp::new(rig.now.as_nanos() / 1000 + 1), heard: vec![entry] };
    codec::add(&mut bytes, Content::Report, |bytes| report.write(bytes));
    key().seal(&mut bytes, LINK, None);
    bytes
}

#[test]
fn a_datagram_truncated_anywhere_is_refused_and_the_whole_one_is_accepted() {
    let (mut rig, frame) = two();
    let cut: Vec<Vec<u8>> = (0..=frame.len()).map(|length| frame[..length].to_vec()).collect();
    let counts = counted_for(&mut rig, &cut);
    assert_eq!(counts.auth + counts.malformed, frame.len() as u64);
    assert_eq!((counts.malformed, counts.accepted), (30, 1), "shorter than header and tag, and the whole one");
}

#[test]
fn a_datagram_with_any_flipped_bit_is_refused() {
    let (mut rig, frame) = two();
    let turned = |bit: usize| {
        let mut turned = frame.clone();
        turned[bit / 8] ^= 1 << (bit % 8);
        turned
    };
    let all: Vec<Vec<u8>> = (0..frame.len() * 8).map(turned).chain([frame.clone()]).collect();
    let counts = counted_for(&mut rig, &all);
    assert_eq!(counts, LinkCounts { auth: frame.len() as u64 * 8, accepted: 1, ..LinkCounts::default() });
}

#[test]
fn each_refusal_has_its_cause() {
    let (mut rig, frame) = two();
    let (message, later) = (latent(1, 1), 1000);
    let of = |change: fn(&mut Header)| {
        let mut header = header(1, 1, later);
        change(&mut header);
        sealed(&key(), header, &message)
    };
    let stranger = sealed(&Key::new([1; 32]), header(1, 1, later), &message);
    let untagged = codec::encode(&header(1, 1, later), &message).unwrap().to_vec();
    let mut version = untagged.clone();
    version[0] += 1;
    key().seal(&mut version, LINK, None);
    let mut garbled = untagged.clone();
    garbled.truncate(60);
    key().seal(&mut garbled, LINK, None);
    let mut number = untagged.clone();
    let end = number.len();
    number[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    key().seal(&mut number, LINK, None);
    let other_link = {
        let mut bytes = untagged.clone();
        key().seal(&mut bytes, murmurate::messages::ids::LinkId(1), None);
        bytes
    };
    let none = LinkCounts::default();
    let mut is = |frame: Vec<u8>, counts: LinkCounts, what: &str| {
        assert_eq!(counted_for(&mut rig, &[frame]), counts, "{what}");
        assert!(rig.delivered[0].is_empty() || counts.accepted > 0, "{what}");
    };
    is(stranger, LinkCounts { auth: 1, ..none }, "another key, so a forged id");
    is(untagged, LinkCounts { auth: 1, ..none }, "no tag");
    is(other_link, LinkCounts { auth: 1, ..none }, "of another link");
    is(of(|header| header.team += 1), LinkCounts { team: 1, ..none }, "another team with the same key");
    is(version, LinkCounts { version: 1, ..none }, "another version");
    is(garbled, LinkCounts { malformed: 1, ..none }, "cut before it was tagged");
    is(of(|header| header.sender = HostId(0)), LinkCounts { own: 1, ..none }, "our own");
    is(of(|header| header.incarnation = 0), LinkCounts { unproven: 1, ..none }, "an incarnation that proves nothing");
    is(of(|header| header.sender = HostId(5)), LinkCounts { unproven: 1, ..none }, "a host that proves nothing");
    is(number, LinkCounts { range: 1, ..none }, "a number that is none");
    is(frame, LinkCounts { late: 1, ..none }, "what was held back for longer than a report");
    let fresh = held_back(&mut rig);
    let counts = counted_for(&mut rig, &[fresh.clone(), fresh.clone()]);
    assert_eq!(counts, LinkCounts { accepted: 1, duplicate: 1, ..none }, "the datagram itself and a copy");
    // 5000 sequence numbers later, datagrams with the old numbers are outside the replay window.
    let old = held_back(&mut rig);
    let counts = counted_for(&mut rig, &[of(|header| header.sequence += 5000), old]);
    assert!(counts.accepted == 1 && counts.replay >= 1, "{counts:?}");
}

#[test]
fn a_member_in_anothers_name_is_heard_by_nobody_and_disturbs_nobody() {
    let keys = |host: u16| {
        let pair = |other: u16| {
            let mut bytes = [3; 32];
            bytes[..2].copy_from_slice(&[host.min(other) as u8, host.max(other) as u8]);
            bytes
        };
        Key::of_member([9; 32], (0..3).map(|other| (HostId(other), pair(other))).collect())
    };
    let of = |host: u16| config(host, 3, 1, Some(keys(host)), multicast(Reliabilities::new()));
    let mut rig = Rig::new((0..3).map(of));
    rig.meet();
    let latch = Latch::engaged(1);
    let round = Round { term: 1, episode: 1 };
    let forged = [
        Wire::Stop(Stop { by: HostId(0), latch }),
        Wire::Heartbeat(Heartbeat::new(RobotId(0), round, Phase::Running, latch)),
        latent(0, 9),
    ];
    let mut frames = Vec::new();
    for message in &forged {
        for ahead in [1, 2, 900, 7000, 1 << 30] {
            for (flags, to) in [(0, None), (Flags::DIRECT, Some(HostId(1)))] {
                let header = Header { flags: Flags(flags), ..header(0, 1, 20 + ahead) };
                let mut bytes = codec::encode(&header, message).expect("a sound message").to_vec();
                keys(2).seal(&mut bytes, LINK, to);
                frames.push(bytes);
            }
        }
    }
    rig.counted(1);
    rig.delivered[1].clear();
    let before = rig.counts[1].auth;
    frames.iter().for_each(|frame| rig.arrive(1, frame));
    assert_eq!(rig.counted(1).auth - before, frames.len() as u64);
    assert!(rig.delivered[1].is_empty(), "none is heard");
    for episode in 2..12 {
        rig.publish(0, latent(0, episode));
        rig.run_ms(20);
    }
    assert_eq!(rig.delivered[1].len(), 10, "and host 0 is heard as before");
    let stop = Wire::Stop(Stop { by: HostId(0), latch });
    rig.publish(0, stop.clone());
    rig.run_ms(10);
    assert!(rig.delivered[1].iter().any(|(_, message)| *message == stop), "its own stop holds");
}

/// Datagrams of another member of the team in the name of host 0, whose last datagram had the number `last`.
type Forgery = fn(&Rig, last: u32) -> Vec<Vec<u8>>;
/// Whether the counts of the receiver are as they must be.
type Expected = fn(&LinkCounts) -> bool;

#[test]
fn a_stop_holds_however_far_another_member_has_raised_the_numbers_of_its_sender() {
    let forged = |number| sealed(&key(), header(0, 1, number), &latent(0, 9));
    let attacks: [(&str, Forgery, Expected); 4] = [
        (
            "the numbers that come next",
            |_, last| (1..200).map(|next| sealed(&key(), header(0, 1, last + next), &latent(0, 9))).collect(),
            |counts| counts.urgent == 1,
        ),
        (
            "numbers as far ahead as may be, again and again",
            |_, last| (1..9).map(|n| sealed(&key(), header(0, 1, last + n * 7900), &latent(0, 9))).collect(),
            |counts| counts.urgent == 1 && counts.ahead == 0,
        ),
        (
            "a report ahead, so that all others are late",
            |rig, last| {
                let mut said = rig.sent.iter().rev().filter(|flight| flight.from == 0);
                let report = said.find_map(|flight| report(&flight.frame, TAG_BYTES)).expect("host 0 reports");
                let mut bytes = codec::encode(&header(0, 1, last + 900), &latent(0, 9)).unwrap().to_vec();
                codec::add(&mut bytes, Content::Report, |bytes| report.write(bytes));
                key().seal(&mut bytes, LINK, None);
                vec![bytes]
            },
            |counts| counts.urgent == 1 && counts.late > 0,
        ),
        (
            "a number that nobody can have reached",
            |_, last| vec![sealed(&key(), header(0, 1, last.wrapping_add(1 << 30)), &latent(0, 9))],
            |counts| counts.urgent == 0 && counts.ahead == 1,
        ),
    ];
    for (what, attack, counted) in attacks {
        let (mut rig, _) = two();
        rig.publish(0, latent(0, 1));
        // Reports are remembered at some distance.
        rig.run_ms(40);
        let last = codec::peek(&rig.last_data(0)).unwrap().sequence;
        for frame in attack(&rig, last) {
            rig.arrive(1, &frame);
        }
        rig.run_ms(400);
        rig.delivered[1].clear();
        let stop = Wire::Stop(Stop { by: HostId(0), latch: Latch::engaged(1) });
        rig.publish(0, stop.clone());
        rig.run_ms(10);
        let recorded = rig.last_data(0);
        for _ in 0..100 {
            rig.arrive(1, &recorded);
        }
        let stops = |rig: &Rig| rig.delivered[1].iter().filter(|(_, message)| *message == stop).count();
        assert_eq!(stops(&rig), 1, "{what}: it holds, and its recording is nothing new");
        let counts = rig.counted(1);
        assert!(counted(&counts), "{what}: {counts:?}");
    }
    // An outsider's copies of what has never been accepted hold no more than other recordings.
    let (mut rig, _) = two();
    rig.restart(1, config(1, 2, 2, Some(key()), multicast(Reliabilities::new())));
    rig.arrive(1, &forged(1));
    rig.arrive(1, &sealed(&key(), header(0, 1, 5), &Wire::Stop(Stop { by: HostId(0), latch: Latch::engaged(1) })));
    assert!(rig.delivered[1].is_empty(), "its sender has not shown that it is alive");
}

#[test]
fn a_host_of_the_former_version_is_refused_and_named_until_it_is_replaced() {
    let (mut rig, _) = two();
    let of = |sender: u16, version: u8| {
        let mut bytes = codec::encode(&header(sender, 1, 1000), &latent(1, 1)).unwrap().to_vec();
        bytes[0] = version;
        key().seal(&mut bytes, LINK, None);
        bytes
    };
    let counts = counted_for(&mut rig, &[of(1, 4), of(2, 4), of(3, 3)]);
    assert_eq!(counts, LinkCounts { version: 3, ..LinkCounts::default() });
    rig.run_ms(1000);
    let former: Vec<(u16, bool)> = rig.peers[0].iter().map(|peer| (peer.host, peer.is_former)).collect();
    assert_eq!(former, [(1, false), (2, true)], "host 1 has this version by now, and of version 3 nothing is known");
}

#[test]
fn blocks_of_a_later_version_are_passed_over_and_the_rest_is_read() {
    let (mut rig, _) = two();
    let mut later = codec::start(&header(1, 1, 1000));
    codec::add(&mut later, Content::Other(0x7f), |bytes| bytes.extend([1, 2, 3]));
    let encoded = codec::encode(&header(1, 1, 1000), &latent(1, 1)).unwrap();
    later.extend_from_slice(&encoded[codec::HEADER_BYTES..]);
    codec::add(&mut later, Content::Other(0xff), |_| {});
    let mut cut = later[..later.len() - 1].to_vec();
    for bytes in [&mut later, &mut cut] {
        key().seal(bytes, LINK, None);
    }
    let none = LinkCounts::default();
    assert_eq!(counted_for(&mut rig, &[cut]), LinkCounts { malformed: 1, ..none });
    assert_eq!(counted_for(&mut rig, &[later]), LinkCounts { accepted: 1, skipped: 2, ..none });
    assert_eq!(rig.delivered[0].len(), 1);
}

#[test]
fn recordings_are_refused_after_any_restart() {
    let mut rig = Rig::team(2, Reliabilities::new());
    rig.meet();
    for episode in 0..20 {
        rig.publish(1, latent(1, episode));
        let next = rig.now + Span::from_millis(50);
        rig.run_to(next);
    }
    assert_eq!(rig.delivered[0].len(), 20);
    let recorded: Vec<Vec<u8>> =
        rig.sent.iter().filter(|flight| flight.from == 1).map(|flight| flight.frame.to_vec()).collect();
    let setup = || multicast(Reliabilities::new());

    // The receiver restarts and the sender is dead, so no newer datagram contradicts the recording.
    rig.restart(0, config(0, 2, 2, Some(key()), setup()));
    rig.restart(1, config(0, 2, 99, None, setup()));
    rig.counts[0] = LinkCounts::default();
    for frame in &recorded {
        rig.arrive(0, frame);
    }
    assert!(rig.delivered[0].len() == 20, "nothing more");
    assert_eq!(rig.counted(0).unproven, recorded.len() as u64);

    // The sender restarts and is accepted; datagrams from before its restart are not.
    rig.restart(1, config(1, 2, 2, Some(key()), setup()));
    rig.meet();
    rig.publish(1, latent(1, 77));
    rig.run_ms(10);
    assert_eq!(rig.delivered[0].len(), 1, "it is accepted within three messages");
    rig.counted(0);
    let counts = counted_for(&mut rig, &recorded);
    assert_eq!(counts.unproven + counts.replay, recorded.len() as u64);
    assert!(rig.delivered[0].is_empty());
}

#[test]
fn a_delayed_datagram_is_refused_long_after_its_sender_fell_silent() {
    let (mut rig, frame) = two();
    rig.restart(1, config(0, 2, 99, None, multicast(Reliabilities::new())));
    let later = rig.now + Span::from_millis(5500);
    rig.run_to(later);
    let counts = counted_for(&mut rig, &[frame]);
    assert_eq!((counts.unproven + counts.late, counts.accepted), (1, 0));
}

#[test]
fn sequence_numbers_wrap_and_those_before_the_wrap_stay_old() {
    let (mut rig, _) = two();
    let message = latent(1, 1);
    rig.restart(1, config(0, 2, 99, None, multicast(Reliabilities::new())));
    rig.run_ms(600);
    let first = lively(&rig, header(1, 5, u32::MAX - 1), &message);
    let of = |sequence: u32| sealed(&key(), header(1, 5, sequence), &message);
    rig.arrive(0, &first);
    let all = [of(u32::MAX), of(0), of(1), of(u32::MAX), of(u32::MAX - 500), of(u32::MAX - 5000)];
    let counts = counted_for(&mut rig, &all);
    assert_eq!((counts.accepted, counts.duplicate, counts.replay), (4, 2, 1), "{counts:?}");
}

#[test]
fn two_live_hosts_with_one_id_are_detected_by_all() {
    // The fourth host has the id of the second.
    let hosts = [(0, 1), (1, 1), (2, 1), (1, 2)];
    let config = |(host, incarnation)| config(host, 3, incarnation, Some(key()), multicast(Reliabilities::new()));
    let mut rig = Rig::new(hosts.map(config));
    for step in 0..60 {
        for (host, robot) in [(0, 0), (1, 1), (2, 2), (3, 1)] {
            rig.publish(host, latent(robot, step));
        }
        let next = rig.now + Span::from_millis(50);
        rig.run_to(next);
    }
    for host in 0..3 {
        assert!(rig.counted(host).duplicate_id > 5, "host {host}: {:?}", rig.counts[host]);
    }
    assert!(rig.peers[0].iter().any(|peer| peer.host == 1 && peer.duplicate_ids > 5));
    assert!(rig.delivered[0].len() > 100, "one of the two and the third host are heard");
}

#[test]
fn of_twenty_hosts_only_the_flooding_one_is_limited() {
    let mut rig = Rig::team(20, Reliabilities::new());
    rig.meet();
    for ms in 0..2000u32 {
        // One host sends forty messages a millisecond, each other twenty a second.
        for _ in 0..40 {
            rig.publish(1, latent(1, ms));
        }
        if ms % 50 == 0 {
            (2..20).for_each(|host| rig.publish(usize::from(host), latent(host, ms)));
        }
        let next = rig.now + Span::from_millis(1);
        rig.run_to(next);
    }
    let of = |robot: u16| {
        rig.delivered[0].iter().filter(|(_, message)| message.robot().0 == robot && message.kind() as u8 == 1).count()
    };
    let babbled = of(1);
    assert!((20_000..=25_000).contains(&babbled), "{babbled} of 80 000 got in");
    assert!((2..20).all(|robot| of(robot) == 40), "everybody else is heard");
    assert!(rig.counted(0).rate > 50_000);
}

/// Returns the counts of a network after a second.
fn counts_of(network: &mut Network) -> LinkCounts {
    let mut out = Vec::new();
    network.wake(Time::ZERO + Span::from_millis(1000), &mut out);
    let counts = out.iter().find_map(|said| if let Out::Counts(counts) = said { Some(**counts) } else { None });
    counts.expect("it tells its counts")
}

/// Route of a stop: to all hosts.
const STOP: Route = Route { local: true, leaves: Some((LINK, Audience::All)) };

/// Returns the configuration of host 0 in a team of four whose hosts it knows.
fn team_of_four(key: Option<Key>, setup: Setup) -> Config {
    let mut config = config(0, 4, 1, key, setup);
    let agents: Vec<HostId> = (0..4).map(HostId).collect();
    let names = agents.iter().map(|host| format!("host {}", host.0)).collect();
    let publishers =
        Publishers { names, actuators: agents.clone(), localizers: agents.clone(), agents, server: HostId(0) };
    let all = |_, robot: RobotId| Route { local: robot != RobotId(0), leaves: None };
    let router = Router::new(4, |kind, robot| if kind == Kind::Stop { STOP } else { all(kind, robot) });
    config.router = router.with_publishers(Arc::new(publishers));
    config
}

fn engage(number: u16) -> Wire {
    Wire::Stop(Stop::engage(HostId::operator(number), Latch::default()))
}

#[test]
fn forged_senders_take_no_table_space_from_hosts_and_operators() {
    let mut network = network(team_of_four(None, multicast(Reliabilities::new())));
    let mut delivered = |sender: u16, sequence: u32, message: Wire| {
        let mut out = Vec::new();
        let frame = codec::encode(&header(sender, 1, sequence), &message).expect("a sound message");
        network.handle(Time::ZERO, In::Frame(LINK, frame, None), &mut out);
        out.iter().filter(|said| matches!(said, Out::Deliver(_))).count()
    };
    assert_eq!(delivered(1, 1, latent(1, 1)), 1);
    for sender in 4..=20_000 {
        delivered(sender, 1, latent(1, 1));
    }
    let operators = (0..HostId::OPERATORS).map(|number| delivered(HostId::operator(number).0, 1, engage(number)));
    assert_eq!(operators.sum::<usize>(), usize::from(HostId::OPERATORS), "each operator is heard");
    assert_eq!(delivered(1, 2, latent(1, 2)), 1, "a host that was accepted before is");
    assert_eq!(delivered(3, 1, latent(3, 1)), 1, "and one that comes later");
    let counts = counts_of(&mut network);
    assert_eq!((counts.crowd, counts.replay + counts.duplicate_id), (0, 0));
}

#[test]
fn an_operator_and_a_host_are_accepted_beside_thousands_forged_by_a_member() {
    let none = config(9, 4, 1, None, multicast(Reliabilities::new()));
    let mut rig = Rig::new([team_of_four(Some(key()), multicast(Reliabilities::new())), none.clone(), none]);
    let says_hello = |rig: &mut Rig, sender: u16, stamp: u64| {
        let mut bytes = codec::start(&header(sender, 1, stamp as u32));
        let report = Report { stamp: Stamp::new(stamp), heard: Vec::new() };
        codec::add(&mut bytes, Content::Report, |bytes| report.write(bytes));
        key().seal(&mut bytes, LINK, None);
        rig.arrive(0, &bytes);
    };
    // Candidates of both kinds that never prove to be alive; then some that do.
    for sender in 0..3000 {
        says_hello(&mut rig, 4 + sender, 5);
        says_hello(&mut rig, HostId::operator(sender).0, 5);
    }
    rig.run_ms(500);
    for number in 0..3000 {
        let frame = lively(&rig, header(HostId::operator(number).0, 2, 1), &engage(number));
        rig.arrive(0, &frame);
    }
    assert_eq!(rig.delivered[0].len(), 3000, "each is accepted");
    rig.delivered[0].clear();
    // A real host and a real operator, from their first datagrams on.
    rig.restart(1, config(3, 4, 7, Some(key()), multicast(Reliabilities::new())));
    rig.restart(2, operator(5, 7));
    for _ in 0..25 {
        let micros = rig.now.as_nanos() / 1000;
        says_hello(&mut rig, HostId::operator((micros % 3000) as u16).0, micros);
        rig.publish(1, latent(3, 1));
        rig.publish(2, engage(5));
        rig.run_ms(20);
    }
    let heard = |kind: Kind| rig.delivered[0].iter().filter(|(_, message)| message.kind() == kind).count();
    assert!(heard(Kind::Latent) > 10 && heard(Kind::Stop) > 10, "{} {}", heard(Kind::Latent), heard(Kind::Stop));
    assert_eq!(rig.counted(0).crowd, 0);
}

/// Returns an operator with this number.
fn operator(number: u16, incarnation: u32) -> Config {
    let router = Router::new(4, |kind, _| match kind {
        Kind::Stop => STOP,
        _ => Route::default(),
    });
    let me = Identity { host: HostId::operator(number), team: TEAM, incarnation };
    let setup = Setup { report_piggyback_age: Span::ZERO, ..multicast(Reliabilities::new()) };
    Config { me, key: Some(key()), links: vec![Some(setup)], router, parts: None }
}

/// Returns a team of two hosts and an operator on a link with this setup, after the operator has sent some stops; and
/// all datagrams of the operator.
fn with_operator(setup: &Setup) -> (Rig, Vec<Vec<u8>>) {
    let host = |host| config(host, 2, 1, Some(key()), setup.clone());
    let mut rig = Rig::new([host(0), host(1), config(9, 2, 1, None, setup.clone())]);
    rig.run_ms(1000);
    let mut config = operator(5, 7);
    config.links = vec![Some(Setup { report_piggyback_age: Span::ZERO, ..setup.clone() })];
    rig.restart(2, config);
    for _ in 0..10 {
        rig.publish(2, engage(5));
        rig.run_ms(20);
    }
    let said = rig.sent.iter().filter(|flight| flight.from == 2).map(|flight| flight.frame.to_vec()).collect();
    (rig, said)
}

#[test]
fn a_replay_of_an_operator_from_another_address_does_not_divert_its_answers() {
    let setup = Setup::unicast(Reliabilities::new());
    let (mut rig, said) = with_operator(&setup);
    let [here, elsewhere] = [1, 2].map(|port| Some(SocketAddr::from(([127, 0, 0, 1], port))));
    // Its own datagrams come from its own address.
    let delay = std::mem::replace(&mut rig.delay, Span::from_secs(1e6));
    rig.publish(2, engage(5));
    let fresh = rig.sent.last().expect("it has said a stop").frame.clone();
    rig.delay = delay;
    let guest =
        |at: Option<SocketAddr>, standing| Guest { host: HostId::operator(5), at: at.expect("an address"), standing };
    rig.arrive_from(0, &fresh, here);
    assert_eq!(rig.admitted[0], [guest(here, Standing::Accepted)]);
    for frame in said.iter().chain([&fresh.to_vec()]) {
        rig.arrive_from(0, frame, elsewhere);
    }
    assert_eq!(rig.admitted[0].len(), 1, "a recording of an accepted guest admits no second one");

    // Once the operator is forgotten, its recordings first make it a candidate, and soon have no effect.
    rig.restart(2, config(9, 2, 1, None, setup));
    rig.run_ms(20_000);
    for _ in 0..50 {
        said.iter().for_each(|frame| rig.arrive_from(0, frame, elsewhere));
        rig.run_ms(100);
    }
    let admitted = &rig.admitted[0][1..];
    assert!(!admitted.is_empty() && admitted.iter().all(|guest| guest.standing == Standing::Candidate));
    assert!(admitted.len() <= 20 * said.len(), "{} times, in 2 s and never again", admitted.len());
    let before = rig.admitted[0].len();
    said.iter().for_each(|frame| rig.arrive_from(0, frame, elsewhere));
    assert_eq!(rig.admitted[0].len(), before);
}

#[test]
fn repeated_replays_of_an_operator_do_not_raise_a_host_s_traffic() {
    for setup in [multicast(Reliabilities::new()), Setup::unicast(Reliabilities::new())] {
        let (mut rig, said) = with_operator(&setup);
        rig.restart(2, config(9, 2, 1, None, setup));
        rig.run_ms(20_000);
        let mut spoken = |recordings: &[Vec<u8>]| {
            rig.sent.clear();
            for ms in 0..10_000 {
                if ms % 200 == 0 {
                    rig.publish(1, rig::heartbeat(1, ms));
                }
                for frame in recordings {
                    rig.arrive(1, frame);
                }
                rig.run_ms(1);
            }
            let own = rig.sent.iter().filter(|flight| flight.from == 1);
            (own.clone().count(), own.map(|flight| flight.bytes).sum::<usize>())
        };
        let quiet = spoken(&[]);
        let [first, all] = [spoken(&said[..1]), spoken(&said)];
        println!("datagrams and bytes in 10 s: quiet {quiet:?}, one recording {first:?}, all {all:?}");
        // At most a burst of answers while the timestamps are new: 25, and 4 a second during that time.
        assert!(first.0 <= quiet.0 + 2, "one recording is answered once: {first:?} beside {quiet:?}");
        assert!(all.0 <= quiet.0 + 30, "{all:?} beside {quiet:?}");
        assert!(all.1 <= 15_000, "the budget of soft state is 1.5 kB/s: {all:?}");
    }
}

#[test]
fn endless_sequences_of_recordings_cause_few_answers() {
    let (mut rig, _) = two();
    rig.sent.clear();
    for ms in 0..10_000u32 {
        // More former operators than are remembered, with timestamps that always advance.
        for number in [ms, ms + 1] {
            let sender = HostId::operator((number % 3000) as u16).0;
            let mut bytes = codec::start(&header(sender, 1, ms));
            let report = Report { stamp: Stamp::new(1_000_000 + u64::from(ms)), heard: Vec::new() };
            codec::add(&mut bytes, Content::Report, |bytes| report.write(bytes));
            key().seal(&mut bytes, LINK, None);
            rig.arrive(1, &bytes);
        }
        rig.run_ms(1);
    }
    let count = rig.sent.iter().filter(|flight| flight.from == 1).count();
    let bytes: usize = rig.sent.iter().filter(|flight| flight.from == 1).map(|flight| flight.bytes).sum();
    println!("in 10 s {count} datagrams, {bytes} bytes");
    assert!(count <= 25 + 40 + 50, "25 at once, 4 a second, and regular reports: {count}");
    assert!(bytes <= 25_000, "{bytes}");
}

fn junk() -> impl Strategy<Value = Vec<Vec<u8>>> {
    prop::collection::vec(prop::collection::vec(any::<u8>(), 0..300), 0..20)
}

proptest! {
    #[test]
    fn junk_is_counted_and_never_panics(junk in junk()) {
        for key in [None, Some(key())] {
            let mut network = network(config(0, 4, 1, key.clone(), multicast(Reliabilities::new())));
            for bytes in &junk {
                // As it is, and also after a valid header and with a valid tag, to reach later checks.
                let mut deep = codec::start(&header(1, 1, 1));
                deep.extend_from_slice(bytes);
                if let Some(key) = &key {
                    key.seal(&mut deep, LINK, None);
                }
                for frame in [bytes.clone(), deep] {
                    network.handle(Time::ZERO, In::Frame(LINK, frame.into(), None), &mut Vec::new());
                }
            }
            network.wake(Time::ZERO, &mut Vec::new());
        }
    }
}
