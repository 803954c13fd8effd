//! Aligns the records of a team's hosts on one clock: estimates the offsets of the hosts' clocks from the records.
//!
//! Every datagram that one host has published and another has received gives a bound: it cannot arrive before it was
//! sent. Of the datagrams between two hosts within ten seconds, the fastest in each direction bound the clock offset
//! from both sides; the middle is the estimate, and half of the width its uncertainty (Cristian, 1989). A recorded time
//! is that at which a turn of the event loop began, so single times are early by up to a turn's length. Therefore the
//! fastest 2 % are left out of the estimate; where they contradict it, the uncertainty grows.

use std::collections::BTreeMap;
use std::path::Path;

use xxhash_rust::xxh3::xxh3_64;

use super::keys::RecordedKey;
use super::reader::{self, ReadError};
use super::tape;
use murmurate::graph::inputs::Input;
use murmurate::net::protocol::codec;

/// Length of the time window of one estimate of a clock offset \[ns\].
const WINDOW_NS: i64 = 10_000_000_000;

/// Identity of a datagram: host id of its sender, incarnation of the sender, sequence number, digest of its message.
pub type DatagramKey = (u16, u32, u32, u64);

/// Datagrams that one host has published and received, with their times on its own clock \[ns\] since 1970.
#[derive(Default)]
pub struct Traffic {
    published: BTreeMap<DatagramKey, i64>,
    arrived: Vec<(DatagramKey, i64)>,
    /// Whether some of the arrived datagrams are encrypted, so that it is not known what they are.
    encrypted: bool,
}

impl Traffic {
    /// Reads the datagrams of a host, with their times, from its record. Encrypted ones are read with its key.
    pub fn read(path: &Path, mut key: Option<RecordedKey>) -> Result<Traffic, ReadError> {
        let (_, mut messages) = reader::messages(path)?;
        let mut traffic = Traffic::default();
        while let Some(message) = messages.next_message()? {
            // A time beyond this is damage; sums of others do not overflow.
            let Some(at) = i64::try_from(message.at).ok().filter(|at| *at < 1 << 61) else { continue };
            if message.channel.topic.starts_with("/wire/") {
                traffic.publish(at, &message.data);
            } else if message.channel.topic == "/tape/turn" {
                let Some(turn) = tape::read(&message.data) else { continue };
                for input in turn.inputs {
                    key.iter_mut().for_each(|key| key.follow(turn.now, &input));
                    let Input::Frame(link, frame, _) = input else { continue };
                    let encrypted = key.as_ref().filter(|_| codec::is_encrypted(&frame));
                    let plain = encrypted.and_then(|key| key.open(&frame, link));
                    traffic.arrive(at, plain.as_deref().unwrap_or(&frame));
                }
            }
        }
        Ok(traffic)
    }

    /// Adds a datagram that the host has published at `at` \[ns\]. A datagram without a message is ignored.
    pub fn publish(&mut self, at: i64, datagram: &[u8]) {
        if let Some(key) = key(datagram) {
            self.published.entry(key).or_insert(at);
        }
    }

    /// Returns whether some of the arrived datagrams are encrypted, so that it is not known what they are.
    pub fn is_encrypted(&self) -> bool {
        self.encrypted
    }

    /// Adds a datagram that has arrived at the host at `at` \[ns\]. A datagram without a message is ignored.
    pub fn arrive(&mut self, at: i64, datagram: &[u8]) {
        self.encrypted |= codec::is_encrypted(datagram);
        self.arrived.extend(key(datagram).map(|key| (key, at)));
    }

    /// Returns the apparent delay \[ns\] of the fastest datagrams from this host to `other`, for each window of this
    /// host's clock: the 2 % quantile of arrival on the clock of `other` minus publication on this host's clock.
    fn fastest(&self, other: &Traffic) -> BTreeMap<i64, i64> {
        let mut took: BTreeMap<i64, Vec<i64>> = BTreeMap::new();
        for (key, arrived) in &other.arrived {
            let Some(sent) = self.published.get(key) else { continue };
            took.entry(sent.div_euclid(WINDOW_NS)).or_default().push(arrived - sent);
        }
        let quantile = |mut all: Vec<i64>| {
            let at = all.len() / 50;
            *all.select_nth_unstable(at).1
        };
        took.into_iter().map(|(window, all)| (window, quantile(all))).collect()
    }
}

/// Returns the identity of a datagram; `None` if it has no message (only content of the link layer) or is invalid.
pub fn key(datagram: &[u8]) -> Option<DatagramKey> {
    let header = codec::peek(datagram).ok()?;
    let (content, bytes) = codec::blocks(datagram).next()?.ok()?;
    matches!(content, codec::Content::Message(_))
        .then(|| (header.sender.0, header.incarnation, header.sequence, xxh3_64(bytes)))
}

/// Offset of a host's clock from the reference clock during one window.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Estimate {
    /// Middle of the window \[ns\], on the clock of the host against which the offset was first measured.
    at: i64,
    /// Time by which the host's clock is ahead of the reference clock \[ns\].
    ahead: i64,
    /// Bound on the error of `ahead` \[ns\].
    uncertainty: i64,
}

/// Offset of a host's clock from the reference clock over time, as a series of estimates. The reference is the clock of
/// the first record.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClockDifference(Vec<Estimate>);

impl ClockDifference {
    /// Returns the offset of the reference clock from itself: zero.
    fn reference() -> ClockDifference {
        ClockDifference(vec![Estimate { at: 0, ahead: 0, uncertainty: 0 }])
    }

    /// Estimates the offset of the clock of `there` from that of `here`, window by window.
    fn between(here: &Traffic, there: &Traffic) -> ClockDifference {
        let (forth, back) = (here.fastest(there), there.fastest(here));
        let estimates = forth.iter().filter_map(|(window, forth)| {
            // A window of the other clock may be shifted by up to one, as the clocks differ.
            let back = (window - 1..=window + 1).filter_map(|near| back.get(&near)).min()?;
            let (ahead, uncertainty) = ((forth - back) / 2, (forth + back) / 2);
            Some(Estimate { at: window * WINDOW_NS + WINDOW_NS / 2, ahead, uncertainty: uncertainty.max(0) })
        });
        ClockDifference(estimates.collect())
    }

    /// Returns the largest uncertainty of the estimated clock offsets \[ns\]; `None` without an estimate.
    pub fn uncertainty_ns(&self) -> Option<i64> {
        self.0.iter().map(|estimate| estimate.uncertainty).max()
    }

    /// Returns the time \[ns\] by which the host's clock is ahead of the reference clock when it shows `at` \[ns\]:
    /// interpolated linearly between estimates, and 0 without one.
    pub fn ahead_ns(&self, at: i64) -> i64 {
        let later = self.0.partition_point(|estimate| estimate.at <= at);
        match (later.checked_sub(1).map(|before| self.0[before]), self.0.get(later)) {
            (None, None) => 0,
            (Some(only), None) => only.ahead,
            (None, Some(only)) => only.ahead,
            (Some(before), Some(after)) => {
                let share = (at - before.at) as f64 / (after.at - before.at) as f64;
                before.ahead + ((after.ahead - before.ahead) as f64 * share) as i64
            }
        }
    }

    /// Returns the time by which the host's clock is ahead at the last estimate, and the largest uncertainty of all
    /// estimates \[ns\]; 0 without an estimate.
    pub fn latest_ns(&self) -> (i64, i64) {
        (self.ahead_ns(i64::MAX / 2), self.uncertainty_ns().unwrap_or(0))
    }

    /// Returns the same offsets with all uncertainties increased by `by_ns` \[ns\].
    fn widened(mut self, by_ns: i64) -> ClockDifference {
        self.0.iter_mut().for_each(|estimate| estimate.uncertainty += by_ns);
        self
    }

    /// Converts an offset from another host's clock to one from the reference clock. `base` is the offset of that other
    /// clock from the reference.
    fn after(&self, base: &ClockDifference) -> ClockDifference {
        let uncertainty = base.uncertainty_ns().unwrap_or(0);
        let moved = |estimate: &Estimate| Estimate {
            ahead: estimate.ahead + base.ahead_ns(estimate.at),
            uncertainty: estimate.uncertainty + uncertainty,
            ..*estimate
        };
        ClockDifference(self.0.iter().map(moved).collect())
    }
}

/// Clock offsets of several hosts, estimated from their records. The reference is the clock of the first record.
#[derive(Debug)]
pub struct Alignment {
    /// Offset of the clock of each record, in the order of the records; `None` if it cannot be estimated, because no
    /// datagrams in both directions connect the host with the reference.
    pub clocks: Vec<Option<ClockDifference>>,
    /// Number of datagrams that were found in the records of both their sender and a receiver.
    pub matched: u64,
    /// Largest time \[ns\] by which a datagram seems to arrive before it was published, beyond the uncertainties of
    /// both clocks; 0 if none does. The uncertainties in `clocks` already include it.
    pub beyond_ns: i64,
}

/// Estimates the offsets of the hosts' clocks from the datagrams that they exchanged. `all` has the datagrams of one
/// record each; the clock of the first is the reference.
pub fn align(all: &[Traffic]) -> Alignment {
    let mut clocks: Vec<Option<ClockDifference>> = vec![None; all.len()];
    if let Some(first) = clocks.first_mut() {
        *first = Some(ClockDifference::reference());
    }
    // Adds the clock with the smallest uncertainty to the known ones, until none is left.
    while let Some((place, clock)) = best(all, &clocks) {
        clocks[place] = Some(clock);
    }
    let (mut matched, mut beyond) = (0, vec![0; all.len()]);
    for (here, there) in pairs(all.len()) {
        let (Some(a), Some(b)) = (&clocks[here], &clocks[there]) else { continue };
        let allowed = a.uncertainty_ns().unwrap_or(0) + b.uncertainty_ns().unwrap_or(0);
        for (key, arrived) in &all[there].arrived {
            let Some(sent) = all[here].published.get(key) else { continue };
            matched += 1;
            let took = (arrived - b.ahead_ns(*arrived)) - (sent - a.ahead_ns(*sent));
            for host in [here, there] {
                beyond[host] = beyond[host].max(-took - allowed);
            }
        }
    }
    let widened = clocks.into_iter().zip(&beyond).map(|(clock, beyond)| Some(clock?.widened(*beyond))).collect();
    Alignment { clocks: widened, matched, beyond_ns: beyond.into_iter().max().unwrap_or(0) }
}

fn pairs(count: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..count).flat_map(move |here| (0..count).map(move |there| (here, there))).filter(|(here, there)| here != there)
}

/// Returns the index of a host and the offset of its clock: of the clocks without an offset so far, the one that has
/// the smallest uncertainty relative to a clock with an offset. `None` if none can be connected.
fn best(all: &[Traffic], clocks: &[Option<ClockDifference>]) -> Option<(usize, ClockDifference)> {
    let mut found: Option<(i64, usize, ClockDifference)> = None;
    for (here, there) in pairs(all.len()) {
        let (Some(base), None) = (&clocks[here], &clocks[there]) else { continue };
        let clock = ClockDifference::between(&all[here], &all[there]).after(base);
        if let Some(uncertainty) = clock.uncertainty_ns()
            && found.as_ref().is_none_or(|(least, ..)| uncertainty < *least)
        {
            found = Some((uncertainty, there, clock));
        }
    }
    found.map(|(_, there, clock)| (there, clock))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Traffic of two hosts whose second clock is ahead by `ahead` and faster by `drift`, with delays in both
    /// directions.
    fn two(ahead: i64, drift: f64, delays: [i64; 2]) -> [Traffic; 2] {
        let mut all = [Traffic::default(), Traffic::default()];
        let there = |at: i64| at + ahead + (at as f64 * drift) as i64;
        for step in 0..3000i64 {
            let at = step * 20_000_000;
            let jitter = (step * 7919 % 13) * 300_000;
            let forth = (0, 1, step as u32, 5);
            all[0].published.insert(forth, at);
            all[1].arrived.push((forth, there(at + delays[0] + jitter)));
            let back = (1, 1, step as u32, 6);
            all[1].published.insert(back, there(at));
            all[0].arrived.push((back, at + delays[1] + jitter));
        }
        all
    }

    #[test]
    fn clocks_that_differ_and_drift_are_found_within_the_stated_uncertainty() {
        for (ahead, drift) in [(200_000_000, 0.0), (-200_000_000, 0.0), (150_000_000, 50e-6)] {
            let all = two(ahead, drift, [1_000_000, 3_000_000]);
            let alignment = align(&all);
            let clock = alignment.clocks[1].as_ref().unwrap();
            let uncertainty = clock.uncertainty_ns().unwrap();
            assert!((1_500_000..3_500_000).contains(&uncertainty), "half of the round trip: {uncertainty}");
            for at in [1_000_000_000i64, 30_000_000_000, 59_000_000_000] {
                let truth = ahead + (at as f64 * drift) as i64;
                let error = (clock.ahead_ns(at + truth) - truth).abs();
                assert!(error <= uncertainty, "{error} of {uncertainty} at {at}");
            }
            assert_eq!((alignment.matched, alignment.beyond_ns), (6000, 0));
        }
    }

    #[test]
    fn a_host_without_replies_has_no_clock() {
        let mut all = two(5, 0.0, [10, 10]);
        all[0].arrived.clear();
        let alignment = align(&all);
        assert!(alignment.clocks[1].is_none() && alignment.clocks[0].is_some());
    }
}
