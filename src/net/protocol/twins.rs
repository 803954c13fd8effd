//! Two live hosts with one id: which of the two was started later, and is to end. Decides; ends nothing.
//!
//! Each lists the other in its reports with the stamp that it has heard and how long it has run itself. So the later
//! one learns of the earlier one within a few reports of its start.

use super::report::MAX_HELD_FOR;
use crate::messages::ids::{HostId, LinkId};
use crate::time::{Span, Time};

/// A process that has run for so long does not end for what another one says: only members with the key can say it,
/// and one that lies must not end a team.
pub const SETTLED: Span = Span::from_millis(10_000);
/// Two that were started within this time are told apart by their incarnations.
const TOGETHER: Span = Span::from_millis(50);

/// Another live host has the id of this one, and was started before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Duplicate {
    /// The link on which it was heard.
    pub link: LinkId,
    /// The id.
    pub host: HostId,
    /// The other one's incarnation.
    pub epoch: u32,
}

/// Others with the id of this process on one link.
#[derive(Clone, Copy, Debug)]
pub struct Twins {
    me: (LinkId, HostId, u32),
    began: Option<Time>,
    claims: u64,
    duplicate: Option<Duplicate>,
}

impl Twins {
    /// None known. `epoch` is this incarnation.
    pub fn new(link: LinkId, host: HostId, epoch: u32) -> Twins {
        const { assert!(SETTLED.as_nanos() < MAX_HELD_FOR.as_nanos(), "a report can say that it has run for so long") };
        Twins { me: (link, host, epoch), began: None, claims: 0, duplicate: None }
    }

    /// How long this process has run on this link, which begins with the first time that it is asked.
    pub fn uptime(&mut self, now: Time) -> Span {
        now.since(*self.began.get_or_insert(now))
    }

    /// Another incarnation with this id echoes a stamp of now, and says that it has run for `theirs`.
    pub fn claim(&mut self, now: Time, epoch: u32, theirs: Span) {
        let ours = self.uptime(now);
        let (link, host, mine) = self.me;
        self.claims += 1;
        if self.claims.is_power_of_two() {
            let times = self.claims;
            tracing::error!("a second live host has the id {} of this one (noticed {times} times)", host.0);
        }
        // Each allows for the other's report having been under way, in such a way that one of the two gives in.
        let later = if mine < epoch { theirs + TOGETHER > ours } else { theirs > ours + TOGETHER };
        if later && ours < SETTLED && self.duplicate.is_none() {
            self.duplicate = Some(Duplicate { link, host, epoch });
        }
    }

    /// The process that this one duplicates, if it does.
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
