//! Duplicate ids: of two live hosts with one id, the one that was started later has to end. Ends nothing itself.
//!
//! Each lists the other in its reports with the other's stamp and its own uptime. So the later one learns of the
//! earlier one within a few reports of its start.

use super::report::MAX_HELD_FOR;
use crate::messages::ids::{HostId, LinkId};
use crate::time::{Span, Time};

/// Uptime from which a process does not end for a duplicate: any member with the key can claim to be one, and a false
/// claim must not end a team.
pub const SETTLED: Span = Span::from_millis(10_000);
/// Difference of uptime below which two are ordered by their incarnations.
const TOGETHER: Span = Span::from_millis(50);

/// Another live host with this host's id, which was started before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Duplicate {
    /// Link on which it was received.
    pub link: LinkId,
    /// The id.
    pub host: HostId,
    /// Incarnation of the other process.
    pub epoch: u32,
}

/// Other processes with the id of this one on one link.
#[derive(Clone, Copy, Debug)]
pub struct Twins {
    me: (LinkId, HostId, u32),
    began: Option<Time>,
    claims: u64,
    duplicate: Option<Duplicate>,
}

impl Twins {
    /// Returns the initial state. `epoch` is this process's incarnation.
    pub fn new(link: LinkId, host: HostId, epoch: u32) -> Twins {
        const { assert!(SETTLED.as_nanos() < MAX_HELD_FOR.as_nanos(), "a report can say that it has run for so long") };
        Twins { me: (link, host, epoch), began: None, claims: 0, duplicate: None }
    }

    /// Uptime of this process on this link, counted from the first call.
    pub fn uptime(&mut self, now: Time) -> Span {
        now.since(*self.began.get_or_insert(now))
    }

    /// Handles the claim of another incarnation with this id, which echoes a recent stamp, that its uptime is `theirs`.
    pub fn claim(&mut self, now: Time, epoch: u32, theirs: Span) {
        let ours = self.uptime(now);
        let (link, host, mine) = self.me;
        self.claims += 1;
        if self.claims.is_power_of_two() {
            let times = self.claims;
            tracing::error!("a second live host has the id {} of this one (noticed {times} times)", host.0);
        }
        // The claim was in transit for a while; both sides allow for it such that exactly one of the two ends.
        let later = if mine < epoch { theirs + TOGETHER > ours } else { theirs > ours + TOGETHER };
        if later && ours < SETTLED && self.duplicate.is_none() {
            self.duplicate = Some(Duplicate { link, host, epoch });
        }
    }

    /// Returns the process that this one duplicates, if any.
    pub fn duplicate(&self) -> Option<Duplicate> {
        self.duplicate
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_the_later_one_gives_in_and_of_two_at_once_the_smaller_incarnation() {
        let gives_in = |ours_ms: u64, mine: u32, theirs_ms: u64, theirs: u32| {
            let mut twins = Twins::new(LinkId(0), HostId(3), mine);
            twins.uptime(Time::ZERO);
            twins.claim(Time::ZERO + Span::from_millis(ours_ms), theirs, Span::from_millis(theirs_ms));
            twins.duplicate().is_some()
        };
        for (mine, theirs) in [(1, 2), (2, 1)] {
            assert!(gives_in(300, mine, 9000, theirs) && !gives_in(9000, mine, 300, theirs));
            assert!(!gives_in(10_000, mine, 16_000, theirs), "it is settled");
        }
        assert!(gives_in(301, 1, 300, 2) && !gives_in(301, 2, 300, 1));
    }
}
