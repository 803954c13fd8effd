//! Candidates: incarnations of hosts that have not proved their liveness yet. Reports echo their stamps for a while, so
//! that they can.
//!
//! A recording of an earlier run can never prove it. Therefore the table is bounded, hosts of the team are kept apart
//! from guests, and candidates echoed least come first. Only an advancing stamp keeps a candidate fresh, so a repeated
//! recording expires.

use std::collections::BTreeMap;

use super::limits::FRESH;
use super::report::Stamp;
use crate::messages::ids::HostId;
use crate::time::{Span, Time};

/// Largest number of candidates (incarnations that have not proved their liveness yet) that are hosts of the team.
const MAX_HOSTS: usize = 1024;
/// Largest number of candidates that are guests: operators, and hosts that the deployment does not know.
const MAX_GUESTS: usize = 256;
/// Part of a full table of candidates that is removed at once, as a divisor: 16 removes one sixteenth. So a flood of
/// datagrams does not cause a search of the table for each of them.
const REMOVED_SHARE: usize = 16;
/// Largest number of stored candidates (incarnations that have not proved their liveness) of one host. An
/// attacker is unlikely to have recorded as many earlier runs of a host with the same key and link.
pub const MAX_CANDIDATES: usize = 32;
/// Difference \[us\] beyond which two stamps belong to different runs, even with equal incarnations: an hour.
const SAME_CLOCK_US: i64 = 3_600_000_000;

/// Incarnation (one run) of another host that has not proved its liveness yet, with the last stamp received from it.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Incarnation: random number of one run of the host.
    pub incarnation: u32,
    /// Latest stamp that was received from the incarnation.
    pub stamp: Stamp,
    /// Time at which the stamp in `stamp` arrived.
    pub at: Time,
    /// Number of this host's link reports that have echoed the candidate's stamp, to let it prove its liveness.
    pub echoed: u32,
}

impl Candidate {
    fn is_fresh(&self, now: Time) -> bool {
        now.since(self.at) < FRESH
    }

    /// Returns the sort key by which candidates are removed from a full table: expired ones first, then those whose
    /// stamps this host's reports have echoed most often; among equals, the one whose stamp has not advanced for the
    /// longest time.
    fn removal_order(&self, now: Time) -> (bool, u32, Span) {
        (!self.is_fresh(now), self.echoed, now.since(self.at))
    }
}

/// Whether a stamp received from a candidate (incarnation that has not proved its liveness) is later than those before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Novelty {
    /// The candidate is new, or the stamp is later than all before: the sender may be live and wait for an echo.
    New,
    /// The same, and this host's reports have echoed a stamp of the candidate before: it may not receive them.
    Unanswered,
    /// The stamp is not later than those before; the last later one arrived less than 2 s ago.
    Repeated,
    /// The stamp is not later than those before; the last later one arrived 2 s ago or more, so the sender may be a
    /// recording.
    Expired,
}

/// Table of candidates (incarnations that have not proved their liveness yet) with a limit on their number: one table
/// for hosts of the team, another for guests.
#[derive(Clone, Debug)]
struct Table {
    by_host: BTreeMap<HostId, Vec<Candidate>>,
    count: usize,
    most: usize,
}

impl Table {
    fn new(most: usize) -> Table {
        Table { by_host: BTreeMap::new(), count: 0, most }
    }

    fn note(&mut self, now: Time, host: HostId, candidate: Candidate) -> Novelty {
        let stamp = candidate.stamp;
        let same = |known: &&mut Candidate| {
            known.incarnation == candidate.incarnation && stamp.ahead_us(known.stamp).abs() < SAME_CLOCK_US
        };
        let all = self.by_host.get_mut(&host);
        if let Some(known) = all.and_then(|all| all.iter_mut().find(same)) {
            if stamp.ahead_us(known.stamp) > 0 {
                (known.stamp, known.at) = (stamp, now);
                return if known.echoed > 0 { Novelty::Unanswered } else { Novelty::New };
            }
            return if known.is_fresh(now) { Novelty::Repeated } else { Novelty::Expired };
        }
        if self.count >= self.most {
            self.make_room(now);
        }
        let all = self.by_host.entry(host).or_default();
        if all.len() >= MAX_CANDIDATES {
            *all.iter_mut().max_by_key(|known| known.removal_order(now)).expect("there are many") = candidate;
        } else {
            self.count += 1;
            all.push(candidate);
        }
        Novelty::New
    }

    /// Removes a sixteenth of the candidates from a full table: expired ones first, then those that were echoed most.
    fn make_room(&mut self, now: Time) {
        let each = self.by_host.iter().flat_map(|(&host, all)| all.iter().map(move |one| (host, *one)));
        let mut all: Vec<(HostId, Candidate)> = each.collect();
        all.sort_by_key(|(_, one)| std::cmp::Reverse(one.removal_order(now)));
        for (host, first) in all.into_iter().take(self.most / REMOVED_SHARE) {
            self.remove(host, |one| (one.incarnation, one.stamp) == (first.incarnation, first.stamp));
        }
    }

    fn remove(&mut self, host: HostId, leaves: impl Fn(&Candidate) -> bool) {
        let Some(all) = self.by_host.get_mut(&host) else { return };
        let before = all.len();
        all.retain(|one| !leaves(one));
        self.count -= before - all.len();
        if all.is_empty() {
            self.by_host.remove(&host);
        }
    }

    /// Returns the candidates whose stamps have advanced lately, for the next report to echo: those whose stamps were
    /// echoed least first, among equals the newest.
    fn waiting(&self, now: Time) -> Vec<(HostId, Candidate)> {
        let each = self.by_host.iter().flat_map(|(&host, all)| all.iter().map(move |one| (host, *one)));
        let mut waiting: Vec<(HostId, Candidate)> = each.filter(|(_, one)| one.is_fresh(now)).collect();
        waiting.sort_by_key(|(_, one)| (one.echoed, now.since(one.at)));
        waiting
    }
}

/// All incarnations seen on one link that have not proved their liveness yet: of hosts of the team, and of guests.
#[derive(Clone, Debug)]
pub struct Candidates {
    hosts: Table,
    guests: Table,
    first_guest: HostId,
}

impl Candidates {
    /// Creates an empty table of candidates. Hosts of the team have ids below `first_guest`; guests (operators, and
    /// hosts that the deployment does not know) have the others.
    pub fn new(first_guest: HostId) -> Candidates {
        Candidates { hosts: Table::new(MAX_HOSTS), guests: Table::new(MAX_GUESTS), first_guest }
    }

    fn table(&mut self, host: HostId) -> &mut Table {
        if host < self.first_guest { &mut self.hosts } else { &mut self.guests }
    }

    /// Records the `stamp` in a link report of an incarnation that has not proved its liveness, and adds the
    /// incarnation as a candidate if it is new. Returns whether the stamp was new.
    pub fn note(&mut self, now: Time, host: HostId, incarnation: u32, stamp: Stamp) -> Novelty {
        self.table(host).note(now, host, Candidate { incarnation, stamp, at: now, echoed: 0 })
    }

    /// Returns what [`Candidates::note`] returns if it would change nothing, as the stamp is no news of a candidate
    /// that is known; `None` if it would.
    pub fn unchanged(&self, now: Time, host: HostId, incarnation: u32, stamp: Stamp) -> Option<Novelty> {
        let table = if host < self.first_guest { &self.hosts } else { &self.guests };
        let known = table.by_host.get(&host).into_iter().flatten();
        // Of several that match, `note` takes the first one.
        let mut same =
            known.filter(|known| known.incarnation == incarnation && stamp.ahead_us(known.stamp).abs() < SAME_CLOCK_US);
        let known = same.next().filter(|known| stamp.ahead_us(known.stamp) <= 0)?;
        Some(if known.is_fresh(now) { Novelty::Repeated } else { Novelty::Expired })
    }

    /// Removes an incarnation that has proved its liveness. Returns the removed candidate; `None` if it was not in the
    /// table.
    pub fn forget(&mut self, host: HostId, incarnation: u32) -> Option<Candidate> {
        let table = self.table(host);
        let all = table.by_host.get(&host)?.iter();
        let known = all.filter(|known| known.incarnation == incarnation).max_by_key(|known| known.echoed).copied();
        table.remove(host, |one| one.incarnation == incarnation);
        known
    }

    /// Returns the candidates whose stamps the next report echoes: those whose stamps have advanced in the last 2 s,
    /// guests and hosts of the team alternately, so that neither group delays the other. Within each group, those whose
    /// stamps were echoed least come first, then the newest.
    pub fn waiting(&self, now: Time) -> Vec<(HostId, Candidate)> {
        let [mut guests, mut hosts] = [&self.guests, &self.hosts].map(|table| table.waiting(now).into_iter());
        let mut waiting = Vec::with_capacity(guests.len() + hosts.len());
        while guests.len() + hosts.len() > 0 {
            waiting.extend(guests.next());
            waiting.extend(hosts.next());
        }
        waiting
    }

    /// Counts that a link report of this host has echoed this stamp of the host `host`.
    pub fn echoed(&mut self, host: HostId, stamp: Stamp) {
        let all = self.table(host).by_host.get_mut(&host);
        if let Some(one) = all.and_then(|all| all.iter_mut().find(|one| one.stamp == stamp)) {
            one.echoed = one.echoed.saturating_add(1);
        }
    }

    /// Returns for each host the candidate whose stamp has advanced last; its first stamp counts as an advance.
    pub fn newest(&self) -> impl Iterator<Item = (HostId, Candidate)> {
        let all = self.hosts.by_host.iter().chain(&self.guests.by_host);
        all.filter_map(|(&host, all)| Some((host, *all.iter().max_by_key(|one| one.at)?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn none() -> Candidates {
        Candidates::new(HostId::operator(0))
    }

    #[test]
    fn a_crowd_of_recordings_does_not_displace_a_candidate_that_was_never_echoed() {
        let (host, mut all) = (HostId(1), none());
        let at = |ms: u64| Time::ZERO + Span::from_millis(ms);
        for incarnation in 0..MAX_CANDIDATES as u32 {
            let stamp = Stamp::new(u64::from(incarnation) + 5);
            assert_eq!(all.note(at(0), host, incarnation, stamp), Novelty::New);
            all.echoed(host, stamp);
        }
        all.note(at(1), host, 1000, Stamp::new(1000));
        for incarnation in 2000..2010 {
            all.note(at(2), host, incarnation, Stamp::new(incarnation.into()));
            all.echoed(host, Stamp::new(incarnation.into()));
        }
        let waiting = all.waiting(at(3));
        assert_eq!((waiting.len(), waiting[0].1.incarnation), (MAX_CANDIDATES, 1000), "it is echoed next");
    }

    #[test]
    fn a_stamp_that_is_repeated_does_not_keep_a_candidate_fresh() {
        let (host, mut all) = (HostId(1), none());
        let at = |ms: u64| Time::ZERO + Span::from_millis(ms);
        for ms in (0..3000).step_by(100) {
            all.note(at(ms), host, 1, Stamp::new(5));
            all.note(at(ms), host, 2, Stamp::new(5 + ms));
            all.note(at(ms), host, 2, Stamp::new(4));
        }
        let waiting = all.waiting(at(3000));
        assert_eq!(
            waiting.iter().map(|(_, one)| (one.incarnation, one.stamp)).collect::<Vec<_>>(),
            [(2, Stamp::new(2905))]
        );
    }

    #[test]
    fn a_recording_with_the_incarnation_of_a_live_host_is_another_candidate() {
        let (host, mut all) = (HostId(1), none());
        all.note(Time::ZERO, host, 1, Stamp::new(1 << 45));
        all.note(Time::ZERO, host, 1, Stamp::new(1 << 46));
        assert_eq!(all.waiting(Time::ZERO).len(), 2);
        assert!(all.forget(host, 1).is_some() && all.waiting(Time::ZERO).is_empty());
    }

    #[test]
    fn of_a_full_table_those_leave_that_were_echoed_most_whichever_host_they_are_of() {
        let mut all = none();
        let often = |all: &mut Candidates, host: u16, times: u32| {
            let stamp = Stamp::new(u64::from(host) + 5);
            assert_eq!(all.note(Time::ZERO, HostId(host), 1, stamp), Novelty::New);
            (0..times).for_each(|_| all.echoed(HostId(host), stamp));
        };
        (0..MAX_HOSTS as u16).for_each(|host| often(&mut all, host, if host == 77 { 9 } else { 1 }));
        often(&mut all, 5000, 0);
        let left: Vec<u16> = all.newest().map(|(host, _)| host.0).collect();
        assert!(left.contains(&5000) && !left.contains(&77));
        assert_eq!((left.len(), all.hosts.count), (MAX_HOSTS - MAX_HOSTS / REMOVED_SHARE + 1, left.len()));
        assert_eq!(all.waiting(Time::ZERO)[0].0, HostId(5000));
    }

    #[test]
    fn neither_operators_nor_hosts_take_the_places_of_the_other_or_are_echoed_before_all_of_them() {
        let mut all = none();
        all.note(Time::ZERO, HostId(1), 1, Stamp::new(5));
        for number in 0..5000 {
            all.note(Time::ZERO + Span::from_millis(1), HostId::operator(number), 1, Stamp::new(5));
        }
        assert!(all.guests.count <= MAX_GUESTS && all.hosts.count == 1);
        let waiting = all.waiting(Time::ZERO + Span::from_millis(1));
        assert!(waiting[0].0.is_operator() && waiting[1].0 == HostId(1));
        (0..5000).for_each(|host| _ = all.note(Time::ZERO + FRESH, HostId(host), 1, Stamp::new(9)));
        assert!(all.guests.count > MAX_GUESTS / 2 && all.hosts.count <= MAX_HOSTS);
        let incarnations = all.newest().count();
        assert_eq!(incarnations, all.hosts.count + all.guests.count);
    }

    #[test]
    fn a_stamp_is_news_once() {
        let mut all = none();
        let mut note =
            |ms: u64, stamp: u64| all.note(Time::ZERO + Span::from_millis(ms), HostId(1), 1, Stamp::new(stamp));
        assert_eq!(
            [note(0, 5), note(1, 5), note(2, 9), note(3, 8)],
            [Novelty::New, Novelty::Repeated, Novelty::New, Novelty::Repeated]
        );
        assert_eq!(note(2 + FRESH.as_nanos() / 1_000_000, 9), Novelty::Expired);
    }

    #[test]
    fn a_candidate_whose_stamps_advance_after_an_echo_has_not_answered_it() {
        let mut all = none();
        let note = |all: &mut Candidates, stamp| all.note(Time::ZERO, HostId(1), 1, Stamp::new(stamp));
        assert_eq!([note(&mut all, 5), note(&mut all, 6)], [Novelty::New; 2]);
        all.echoed(HostId(1), Stamp::new(6));
        assert_eq!([note(&mut all, 6), note(&mut all, 7)], [Novelty::Repeated, Novelty::Unanswered]);
        all.forget(HostId(1), 1);
        assert_eq!(note(&mut all, 8), Novelty::New);
    }
}
