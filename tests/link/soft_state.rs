//! Cost of soft state, and how soon it does its work, in teams of 5, 50 and 200: bytes a second, joining, loss that
//! reaches the sender, and proof of life that holds.

use std::collections::BTreeSet;

use crate::rig::{Flight, Rig, heartbeat, latent, report};
use murmurate::messages::wire::Kind;
use murmurate::net::protocol::codec::TAG_BYTES;
use murmurate::net::protocol::codec::{self, Content, HEADER_BYTES};
use murmurate::net::protocol::reliability::Reliabilities;
use murmurate::time::Span;

/// The most soft state that a host may send \[bytes/s\]: UDP payload with tags, without `Mode`.
const MOST_BYTES_PER_S: f64 = 1500.0;
/// Milliseconds between two messages of a host that says little: 2.4 a second.
const SLOW_MS: u64 = 416;
/// Milliseconds between two heartbeats.
const BEAT_MS: u64 = 200;

/// Bytes of a datagram that are soft state: all of it, or what rides on data.
fn soft_bytes(flight: &Flight) -> usize {
    let plain = &flight.frame[..flight.frame.len() - TAG_BYTES];
    let mut data = 0;
    for (content, body) in codec::blocks(plain).flatten() {
        if matches!(content, Content::Message(kind) if !matches!(kind, Kind::Heartbeat | Kind::Mode)) {
            data += 3 + body.len();
        }
    }
    if data > 0 { plain.len() - HEADER_BYTES - data } else { flight.bytes }
}

/// Lets a team say heartbeats, and data if it is to, for so many milliseconds; hosts are out of step. `each` sees it
/// after each step of 20 ms and says whether that was enough.
fn talk(rig: &mut Rig, kinds: &[Kind], ms: u64, mut each: impl FnMut(&mut Rig) -> bool) {
    let hosts = rig.networks.len() as u64;
    let begin = rig.now;
    for step in 0..ms / 20 {
        for host in 0..hosts {
            let due = |period: u64, phase: u64| (step + host * 7 + phase).is_multiple_of(period / 20);
            if host > 0 && due(BEAT_MS, 0) {
                rig.publish(host as usize, heartbeat(host as u16, step as u32));
            }
            if kinds.contains(&Kind::Latent) && due(SLOW_MS, 1) {
                rig.publish(host as usize, latent(host as u16, step as u32));
            }
        }
        rig.run_to(begin + Span::from_millis(20) * (step + 1));
        if each(rig) {
            return;
        }
    }
}

/// Number of pairs of hosts that accept each other, by their newest summaries.
fn accepted(rig: &Rig) -> usize {
    rig.peers.iter().map(|peers| peers.iter().filter(|peer| peer.accepted).count()).sum()
}

/// The most soft state that any host sends \[bytes/s\].
fn cost(rig: &mut Rig, kinds: &[Kind], seconds: u64) -> f64 {
    rig.sent.clear();
    talk(rig, kinds, seconds * 1000, |_| false);
    let mut bytes = vec![0; rig.networks.len()];
    rig.sent.iter().for_each(|flight| bytes[flight.from] += soft_bytes(flight));
    bytes.into_iter().max().unwrap_or_default() as f64 / seconds as f64
}

/// Adds the hosts that have been told by now of a loss of at least 2 in 64.
fn told(rig: &mut Rig, told: &mut BTreeSet<usize>) {
    for (_, to, frame) in rig.arrived.iter_mut().flat_map(std::mem::take) {
        let heard = report(&frame, TAG_BYTES).map(|report| report.heard).unwrap_or_default();
        if heard.iter().any(|entry| usize::from(entry.host.0) == to && entry.lost >= 2) {
            told.insert(to);
        }
    }
}

#[test]
fn soft_state_keeps_to_its_budget_and_does_its_work_however_large_the_team() {
    println!("| hosts | whole after [s] | idle [B/s] | 2.4 messages/s [B/s] | all know of 30 % loss after [s] |");
    for (hosts, told_ms) in [(5u16, 2000), (50, 2000), (200, 4000)] {
        let mut rig = Rig::team(hosts, Reliabilities::new());
        let pairs = usize::from(hosts) * usize::from(hosts - 1);
        talk(&mut rig, &[], 4000, |rig| accepted(rig) == pairs);
        let whole = rig.now;
        assert_eq!(accepted(&rig), pairs, "{hosts} hosts are whole within 4 s");
        talk(&mut rig, &[], 2000, |_| false);
        let idle = cost(&mut rig, &[], 4);
        let slow = cost(&mut rig, &[Kind::Latent], 4);
        assert!(idle.max(slow) <= MOST_BYTES_PER_S, "{hosts} hosts: {idle} and {slow} B/s");

        (rig.loss, rig.arrived) = (0.3, Some(Vec::new()));
        let (lossy, mut knows) = (rig.now, BTreeSet::new());
        talk(&mut rig, &[Kind::Latent], told_ms, |rig| {
            told(rig, &mut knows);
            knows.len() == usize::from(hosts)
        });
        let after = rig.now.since(lossy);
        assert_eq!(knows.len(), usize::from(hosts), "{hosts} hosts: every sender knows of loss after {after}");
        println!("| {hosts} | {:.0} | {idle:.0} | {slow:.0} | {:.2} |", whole.as_secs(), after.as_secs());

        rig.arrived = None;
        let mut least = pairs;
        talk(&mut rig, &[Kind::Latent], 20_000, |rig| {
            least = least.min(accepted(rig));
            false
        });
        assert_eq!(least, pairs, "{hosts} hosts: none ceases to be accepted at 30 % loss");
    }
}
