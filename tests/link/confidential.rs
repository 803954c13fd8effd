//! Confidential teams: their messages arrive as in clear, cannot be read on the way, and no nonce is of two datagrams.

use std::collections::BTreeMap;

use crate::rig::{LINK, Rig, config, heartbeat, key, latent, multicast};
use murmurate::messages::ids::HostId;
use murmurate::messages::wire::{Kind, Wire};
use murmurate::net::protocol::cipher::ENCRYPTION_BYTES;
use murmurate::net::protocol::codec::{self, Content, DecodeError, FLAGS_AT, Flags, HEADER_BYTES};
use murmurate::net::protocol::codec::{MAX_FRAME_BYTES, MAX_PLAIN_BYTES, SHORT_TAG_BYTES, TAG_BYTES};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::reliability::{Reliabilities, Reliability, Setup};
use murmurate::net::protocol::router::Audience;
use murmurate::time::Time;

/// Returns the key of the host `host` among `hosts` members.
fn member(host: u16, hosts: u16) -> Key {
    let pair = |other: u16| {
        let mut bytes = [3; 32];
        bytes[..2].copy_from_slice(&[host.min(other) as u8, host.max(other) as u8]);
        bytes
    };
    Key::of_member([9; 32], (0..hosts).map(|other| (HostId(other), pair(other))).collect())
}

/// Returns the keys of a team, by host: one for all, or those of members.
type Keys = fn(u16) -> Key;
const KEYS: [(&str, Keys); 2] = [("one key", |_| key()), ("members", |host| member(host, 4))];

fn reliabilities() -> Reliabilities {
    Reliabilities::from([(Kind::Latent, Reliability::Ack), (Kind::Heartbeat, Reliability::BestEffort)])
}

/// Runs four hosts that send latents and heartbeats over a lossy link; host 3 is restarted twice, once as a run that
/// has drawn the same incarnation again.
fn team(keys: Keys, setup: &Setup, confidential: bool) -> Rig {
    let of = |host: u16, incarnation| {
        config(host, 4, incarnation, Some(keys(host).confidential_if(confidential)), setup.clone())
    };
    let mut rig = Rig::new((0..4).map(|host| of(host, 1)));
    rig.meet();
    rig.loss = 0.2;
    for run in 0..3u32 {
        for round in 0..40 {
            for host in 0..4u16 {
                rig.publish(usize::from(host), latent(host, 100 * run + round));
                rig.publish(usize::from(host), heartbeat(host, 100 * run + round));
            }
            rig.run_ms(20);
        }
        rig.restart(3, of(3, [2, 1, 1][run as usize]));
    }
    rig
}

/// Returns the part of an encrypted datagram's nonce that is sent, with that of its header.
fn nonce(frame: &[u8]) -> Vec<u8> {
    let inner = codec::untagged(frame);
    let each = Flags(frame[FLAGS_AT]).has(Flags::FOR_EACH);
    let end = inner.len() - if each { TAG_BYTES } else { 0 };
    [&inner[end - (ENCRYPTION_BYTES - TAG_BYTES)..end], &frame[6..HEADER_BYTES]].concat()
}

fn setups() -> [Setup; 2] {
    [multicast(reliabilities()), Setup::unicast(reliabilities())]
}

#[test]
fn a_confidential_team_receives_what_one_in_clear_does_at_the_same_times() {
    for (name, keys) in KEYS {
        for setup in setups() {
            let delivered = |confidential| -> Vec<Vec<(Time, Wire)>> { team(keys, &setup, confidential).delivered };
            let clear = delivered(false);
            assert!(clear.iter().all(|got| got.len() > 200), "{name}: {:?}", clear.iter().map(Vec::len));
            assert!(clear == delivered(true), "{name}");
        }
    }
}

#[test]
fn nothing_but_headers_is_read_on_the_way_and_no_nonce_is_of_two_datagrams() {
    for (name, keys) in KEYS {
        for setup in setups() {
            let rig = team(keys, &setup, true);
            let mut seen: BTreeMap<Vec<u8>, (Audience, Vec<u8>)> = BTreeMap::new();
            let mut copies = 0;
            for flight in &rig.sent {
                let frame = &flight.frame[..];
                assert!(Flags(frame[FLAGS_AT]).has(Flags::TAGGED | Flags::ENCRYPTED) && frame.len() <= MAX_FRAME_BYTES);
                // The features of a latent, each 0.5.
                assert!(!frame.windows(8).any(|bytes| bytes == [0, 0, 0, 63, 0, 0, 0, 63]), "{name}");
                match codec::first(frame) {
                    Ok(first) => assert_eq!(first, Content::Report, "{name}"),
                    Err(error) => assert_eq!(error, DecodeError::Encrypted, "{name}"),
                }
                assert!(codec::blocks(codec::untagged(frame)).all(|block| block == Err(DecodeError::Encrypted)));
                let whole = (flight.audience, frame.to_vec());
                if let Some(before) = seen.insert(nonce(frame), whole.clone()) {
                    assert_eq!(before, whole, "{name}: a nonce of two datagrams");
                    copies += 1;
                }
            }
            // The second to fourth transmission of a datagram are alike.
            assert!(copies > 10 && seen.len() > 1000, "{name}: {copies} of {}", seen.len());
        }
    }
}

#[test]
fn runs_with_one_incarnation_repeat_numbers_and_no_nonce() {
    let rig = team(|host| member(host, 4), &multicast(reliabilities()), true);
    let mut numbers: BTreeMap<Vec<u8>, Vec<Vec<u8>>> = BTreeMap::new();
    for flight in rig.sent.iter().filter(|flight| flight.from == 3) {
        // Header without flags.
        let nonces = numbers.entry(flight.frame[2..HEADER_BYTES].to_vec()).or_default();
        let nonce = nonce(&flight.frame);
        if !nonces.contains(&nonce) {
            nonces.push(nonce);
        }
    }
    let twice = numbers.values().filter(|nonces| nonces.len() > 1).count();
    assert!(twice > 40, "{twice} of {} numbers were used twice", numbers.len());
}

#[test]
fn a_host_that_encrypts_and_one_that_does_not_refuse_each_other() {
    for (name, keys) in KEYS {
        let of = |host: u16, confidential| {
            config(host, 4, 1, Some(keys(host).confidential_if(confidential)), multicast(reliabilities()))
        };
        let mut rig = Rig::new([of(0, true), of(1, false), of(2, true)]);
        for episode in 0..20 {
            (0..3u16).for_each(|host| rig.publish(usize::from(host), latent(host, episode)));
            rig.run_ms(20);
        }
        let counts: Vec<_> = (0..3).map(|host| rig.counted(host)).collect();
        assert!(rig.delivered[1].is_empty() && !rig.delivered[0].is_empty(), "{name}");
        for counts in &counts {
            assert!(counts.confidential > 20 && counts.auth == counts.confidential, "{name}: {counts:?}");
        }
        assert!(counts[1].key_trouble().is_some_and(|why| why.contains("'confidential'")), "{name}");
        // A flag of encryption on a datagram in clear, and the reverse.
        for host in [0, 1] {
            let mut lie = rig.last_of(1 - host);
            lie[FLAGS_AT] ^= Flags::ENCRYPTED;
            let before = rig.counted(host);
            rig.arrive(host, &lie);
            let after = rig.counted(host);
            assert!(after.auth > before.auth && after.accepted == before.accepted, "{name}");
        }
    }
}

#[test]
fn confidentiality_takes_16_bytes_of_a_latent_with_one_tag_and_32_of_one_with_a_tag_for_each() {
    let length = |key: Key, to: Option<HostId>| {
        let header = codec::Header { flags: Flags(0), team: 7, sender: HostId(0), incarnation: 9, sequence: 1000 };
        let mut datagram = codec::encode(&header, &latent(0, 1)).expect("a sound message").to_vec();
        key.seal(&mut datagram, LINK, to);
        datagram.len()
    };
    for (key, to, more) in [
        (key(), None, ENCRYPTION_BYTES - TAG_BYTES),
        (member(0, 6), None, ENCRYPTION_BYTES),
        (member(0, 6), Some(HostId(1)), ENCRYPTION_BYTES - TAG_BYTES),
    ] {
        let clear = length(key.clone(), to);
        assert_eq!(length(key.confidential(), to), clear + more);
    }
    // The largest messages fit beside what encryption and the tags of twelve members take.
    const { assert!(MAX_PLAIN_BYTES + 12 * SHORT_TAG_BYTES < MAX_FRAME_BYTES) };
}
