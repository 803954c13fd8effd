//! Incarnations that have not shown yet that they are alive: each is echoed for a while, so that it can.
//!
//! A recording of a former run is such a candidate for ever, so candidates are bounded, and their places are given
//! fairly: first to those that were echoed least. A recording that repeats itself grows old, since only a stamp that
//! has advanced keeps a candidate fresh.

use std::collections::BTreeMap;

use super::incoming::{FRESH, MAX_SENDERS};
use super::report::Stamp;
use crate::messages::ids::HostId;
use crate::time::{Span, Time};

/// The most candidates of one host: more former runs than one is likely to have recorded of the same key and link.
pub const MAX_CANDIDATES: usize = 32;
/// Stamps that lie further apart are of two runs, even of one incarnation: an hour \[us\].
const SAME_CLOCK_US: i64 = 3_600_000_000;
/// How often old candidates are looked for, once there are too many in all.
const PURGE_PERIOD: Span = Span::from_millis(250);

/// An incarnation that has not shown yet that it is alive.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// The incarnation.
    pub epoch: u32,
    /// Its greatest stamp.
    pub stamp: Stamp,
    /// When that came.
    pub at: Time,
    /// How often it was echoed.
    pub echoed: u32,
}

impl Candidate {
    fn is_fresh(&self, now: Time) -> bool {
        now.since(self.at) < FRESH
    }
}

/// All candidates of one link.
#[derive(Clone, Debug, Default)]
pub struct Candidates {
    by_host: BTreeMap<HostId, Vec<Candidate>>,
    count: usize,
    purged: Option<Time>,
}

impl Candidates {
    /// Takes up the stamp of a report. Gives whether there was room.
    pub fn note(&mut self, now: Time, host: HostId, epoch: u32, stamp: Stamp) -> bool {
        let full = self.count >= MAX_SENDERS;
        if full && self.purged.is_none_or(|at| now.since(at) >= PURGE_PERIOD) {
            self.purge(now);
        }
        let full = self.count >= MAX_SENDERS;
        let all = self.by_host.entry(host).or_default();
        let same = |known: &&mut Candidate| known.epoch == epoch && stamp.ahead_us(known.stamp).abs() < SAME_CLOCK_US;
        if let Some(known) = all.iter_mut().find(same) {
            if stamp.ahead_us(known.stamp) > 0 {
                (known.stamp, known.at) = (stamp, now);
            }
            return true;
        }
        let candidate = Candidate { epoch, stamp, at: now, echoed: 0 };
        if all.len() < MAX_CANDIDATES && !full {
            self.count += 1;
            all.push(candidate);
            return true;
        }
        // The one that has had most chances makes room; of several, the one that has said nothing new for longest.
        let weakest = all.iter_mut().max_by_key(|known| (!known.is_fresh(now), known.echoed, now.since(known.at)));
        let room = weakest.is_some();
        if let Some(weakest) = weakest {
            *weakest = candidate;
        } else {
            self.by_host.remove(&host);
        }
        room
    }

    fn purge(&mut self, now: Time) {
        self.purged = Some(now);
        self.by_host.values_mut().for_each(|all| all.retain(|known| known.is_fresh(now)));
        self.by_host.retain(|_, all| !all.is_empty());
        self.count = self.by_host.values().map(Vec::len).sum();
    }

    /// This incarnation has shown that it is alive, and is no candidate any more. Gives what was known of it.
    pub fn forget(&mut self, host: HostId, epoch: u32) -> Option<Candidate> {
        let all = self.by_host.get_mut(&host)?;
        let before = all.len();
        let known = all.iter().filter(|known| known.epoch == epoch).max_by_key(|known| known.echoed).copied();
        all.retain(|known| known.epoch != epoch);
        self.count -= before - all.len();
        if all.is_empty() {
            self.by_host.remove(&host);
        }
        known
    }

    /// Those whose stamp is fresh enough to be echoed: operators first, then who was echoed least, then the newest.
    pub fn waiting(&self, now: Time) -> Vec<(HostId, Candidate)> {
        let each = self.by_host.iter().flat_map(|(&host, all)| all.iter().map(move |one| (host, *one)));
        let mut waiting: Vec<(HostId, Candidate)> = each.filter(|(_, one)| one.is_fresh(now)).collect();
        waiting.sort_by_key(|(host, one)| (!host.is_operator(), one.echoed, now.since(one.at)));
        waiting
    }

    /// A report leaves that echoes this stamp.
    pub fn echoed(&mut self, host: HostId, stamp: Stamp) {
        if let Some(one) = self.by_host.get_mut(&host).and_then(|all| all.iter_mut().find(|one| one.stamp == stamp)) {
            one.echoed = one.echoed.saturating_add(1);
        }
    }

    /// Of each host the candidate that said something new last.
    pub fn newest(&self) -> impl Iterator<Item = (HostId, Candidate)> {
        self.by_host.iter().filter_map(|(&host, all)| Some((host, *all.iter().max_by_key(|one| one.at)?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crowd_of_recordings_does_not_displace_a_candidate_that_was_never_echoed() {
        let (host, mut all) = (HostId(1), Candidates::default());
        let at = |ms: u64| Time::ZERO + Span::from_millis(ms);
        for epoch in 0..MAX_CANDIDATES as u32 {
            let stamp = Stamp::new(u64::from(epoch) + 5);
            assert!(all.note(at(0), host, epoch, stamp));
            all.echoed(host, stamp);
        }
        assert!(all.note(at(1), host, 1000, Stamp::new(1000)), "it takes the place of one that was echoed");
        for epoch in 2000..2010 {
            all.note(at(2), host, epoch, Stamp::new(epoch.into()));
            all.echoed(host, Stamp::new(epoch.into()));
        }
        let waiting = all.waiting(at(3));
        assert_eq!((waiting.len(), waiting[0].1.epoch), (MAX_CANDIDATES, 1000), "and is echoed next");
    }

    #[test]
    fn a_stamp_that_is_repeated_does_not_keep_a_candidate_fresh() {
        let (host, mut all) = (HostId(1), Candidates::default());
        let at = |ms: u64| Time::ZERO + Span::from_millis(ms);
        for ms in (0..3000).step_by(100) {
            all.note(at(ms), host, 1, Stamp::new(5));
            all.note(at(ms), host, 2, Stamp::new(5 + ms));
            all.note(at(ms), host, 2, Stamp::new(4));
        }
        let waiting = all.waiting(at(3000));
        assert_eq!(waiting.iter().map(|(_, one)| (one.epoch, one.stamp)).collect::<Vec<_>>(), [(2, Stamp::new(2905))]);
    }

    #[test]
    fn a_recording_with_the_incarnation_of_a_live_host_is_another_candidate() {
        let (host, mut all) = (HostId(1), Candidates::default());
        all.note(Time::ZERO, host, 1, Stamp::new(1 << 45));
        all.note(Time::ZERO, host, 1, Stamp::new(1 << 46));
        assert_eq!(all.waiting(Time::ZERO).len(), 2);
        assert!(all.forget(host, 1).is_some() && all.waiting(Time::ZERO).is_empty());
    }

    #[test]
    fn candidates_are_bounded_and_old_ones_make_room() {
        let mut all = Candidates::default();
        for host in 0..2 * MAX_SENDERS as u16 {
            assert_eq!(all.note(Time::ZERO, HostId(host), 1, Stamp::new(5)), usize::from(host) < MAX_SENDERS);
        }
        assert!(all.note(Time::ZERO + FRESH, HostId(5000), 1, Stamp::new(5)), "the others have grown old");
        all.forget(HostId(5000), 1);
        assert!(all.by_host.is_empty() && all.count == 0);
    }
}
