//! Duplicate ids: of two live hosts with one id, the one that was started later has to end. Ends nothing itself.
//!
//! Each lists the other in its reports with the other's stamp and its own uptime. So the later one learns of the
//! earlier one within a few reports of its start.

use super::report::MAX_HELD_FOR;
use crate::messages::ids::{HostId, LinkId};
use crate::time::{Span, Time};

/// Uptime from which a process no longer ends because of a duplicate id. Any member with the key can claim to be an
/// earlier process, and a false claim must not end a team.
pub const SETTLED: Span = Span::from_millis(10_000);
/// Difference of uptime below which two are ordered by their incarnations.
const TIE_MARGIN: Span = Span::from_millis(50);

/// Another live host with the id of this one, which was started earlier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DuplicateId {
    /// Link on which the other host was received.
    pub link: LinkId,
    /// The id.
    pub host: HostId,
    /// Incarnation of the other process.
    pub incarnation: u32,
}

/// Other processes that use the id of this process on one link.
#[derive(Clone, Copy, Debug)]
pub struct DuplicateIds {
    me: (LinkId, HostId, u32),
    began: Option<Time>,
    claims: u64,
    duplicate: Option<DuplicateId>,
}

impl DuplicateIds {
    /// Returns the initial state. `incarnation` is this process's incarnation.
    pub fn new(link: LinkId, host: HostId, incarnation: u32) -> DuplicateIds {
        const { assert!(SETTLED.as_nanos() < MAX_HELD_FOR.as_nanos(), "a report can say that it has run for so long") };
        DuplicateIds { me: (link, host, incarnation), began: None, claims: 0, duplicate: None }
    }

    /// Uptime of this process on this link, counted from the first call.
    pub fn uptime(&mut self, now: Time) -> Span {
        now.since(*self.began.get_or_insert(now))
    }

    /// Handles the claim of another process with this id that its uptime is `theirs`. The claim must echo a recent
    /// stamp.
    pub fn claim(&mut self, now: Time, incarnation: u32, theirs: Span) {
        let ours = self.uptime(now);
        let (link, host, mine) = self.me;
        self.claims += 1;
        if self.claims.is_power_of_two() {
            let times = self.claims;
            tracing::error!("a second live host has the id {} of this one (noticed {times} times)", host.0);
        }
        // The claim was in transit for a while; both sides allow for it such that exactly one of the two ends.
        let later = if mine < incarnation { theirs + TIE_MARGIN > ours } else { theirs > ours + TIE_MARGIN };
        if later && ours < SETTLED && self.duplicate.is_none() {
            self.duplicate = Some(DuplicateId { link, host, incarnation });
        }
    }

    /// Returns the earlier process with the same id, so that this one has to end; `None` if there is none.
    pub fn duplicate(&self) -> Option<DuplicateId> {
        self.duplicate
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
