//! Detection of duplicate ids: if two live hosts have the same id, the one that started later has to end. The caller
//! ends it.
//!
//! Each process lists the other in its link reports, with the other's stamp and its own uptime. So the later one learns
//! of the earlier one within a few reports after its start.

use super::counts::LinkCounts;
use super::report::MAX_HELD_FOR;
use crate::messages::ids::{HostId, LinkId};
use crate::time::{Span, Time};

/// Time since its start after which a process no longer ends because another host has the same id. Every member with
/// the key can claim an earlier start, and a false claim must not end a team.
pub const SETTLED: Span = Span::from_millis(10_000);
/// Difference of uptimes below which the incarnations decide which process ends.
const TIE_MARGIN: Span = Span::from_millis(50);

/// Finding that another live process has the same host id as this process and started earlier, so that this process
/// has to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DuplicateId {
    /// Link on which the other host was received.
    pub link: LinkId,
    /// Common id of both hosts.
    pub host: HostId,
    /// Incarnation (random number of one run) of the process that started earlier.
    pub incarnation: u32,
}

/// Detection of other live processes with the host id of this process, on one link.
#[derive(Clone, Copy, Debug)]
pub struct DuplicateIds {
    me: (LinkId, HostId, u32),
    began: Option<Time>,
    claims: u64,
    duplicate: Option<DuplicateId>,
}

impl DuplicateIds {
    /// Returns the state before any datagram. `host` is the id of this process, and `incarnation` its incarnation.
    pub fn new(link: LinkId, host: HostId, incarnation: u32) -> DuplicateIds {
        const { assert!(SETTLED.as_nanos() < MAX_HELD_FOR.as_nanos(), "a report can say that it has run for so long") };
        DuplicateIds { me: (link, host, incarnation), began: None, claims: 0, duplicate: None }
    }

    /// Returns the time since the first call of `uptime` or `claim`, which counts as the start of this process.
    pub fn uptime(&mut self, now: Time) -> Span {
        now.since(*self.began.get_or_insert(now))
    }

    /// Handles a link report of another process with the same host id: its incarnation, and its uptime `theirs` as
    /// stated in the report. The caller has checked that the report echoes a recent stamp of this process.
    pub fn claim(&mut self, now: Time, incarnation: u32, theirs: Span) {
        let ours = self.uptime(now);
        let (link, host, mine) = self.me;
        self.claims += 1;
        if self.claims.is_power_of_two() {
            let times = self.claims;
            tracing::error!("a second live host has the id {} of this one (noticed {times} times)", host.0);
        }
        // The claim was in transit for a while. Both sides allow for it so that exactly one of the two ends.
        let later = if mine < incarnation { theirs + TIE_MARGIN > ours } else { theirs > ours + TIE_MARGIN };
        if later && ours < SETTLED && self.duplicate.is_none() {
            self.duplicate = Some(DuplicateId { link, host, incarnation });
        }
    }

    /// Returns the process with the same host id that was started earlier, so that this process has to end. `None` if
    /// none was found.
    pub fn duplicate(&self) -> Option<DuplicateId> {
        self.duplicate
    }
}

/// Counts a refused datagram of another incarnation of `host` than the accepted one, and logs it if both are alive:
/// `times` is the number of such datagrams. With `None`, the accepted one may have died and this is its restart.
#[cold]
pub(super) fn refuse_another(host: HostId, times: Option<u64>, counts: &mut LinkCounts) {
    let Some(times) = times else {
        counts.unproven += 1;
        return;
    };
    counts.duplicate_id += 1;
    if times.is_power_of_two() {
        tracing::error!("two live hosts have the id {} (noticed {times} times): stop one of them", host.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_the_later_one_ends_and_of_two_at_once_the_smaller_incarnation() {
        let must_end = |ours_ms: u64, mine: u32, theirs_ms: u64, theirs: u32| {
            let mut ids = DuplicateIds::new(LinkId(0), HostId(3), mine);
            ids.uptime(Time::ZERO);
            ids.claim(Time::ZERO + Span::from_millis(ours_ms), theirs, Span::from_millis(theirs_ms));
            ids.duplicate().is_some()
        };
        for (mine, theirs) in [(1, 2), (2, 1)] {
            assert!(must_end(300, mine, 9000, theirs) && !must_end(9000, mine, 300, theirs));
            assert!(!must_end(10_000, mine, 16_000, theirs), "it is settled");
        }
        assert!(must_end(301, 1, 300, 2) && !must_end(301, 2, 300, 1));
    }
}
