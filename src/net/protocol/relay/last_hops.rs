//! Neighbours by which the newest soft state of each other host has come first, for display alone.

use std::collections::BTreeMap;

use crate::messages::ids::HostId;
use crate::net::protocol::ways::LastHop;
use crate::time::Time;

/// Neighbour that has said the newest entry of each origin first.
#[derive(Clone, Debug, Default)]
pub(super) struct LastHops(BTreeMap<HostId, Newest>);

/// Newest entry of an origin.
#[derive(Clone, Copy, Debug)]
struct Newest {
    by: HostId,
    at: Time,
    /// Incarnation of the origin, and its number.
    order: (u32, u32),
}

impl LastHops {
    /// Takes note that a neighbour has said an entry of a host, a member of the team. Not every relay can check the
    /// entry, so a neighbour that invents one may be named here; nothing acts on it.
    pub fn note(&mut self, now: Time, (origin, by): (HostId, HostId), order: (u32, u32)) {
        let known = self.0.get(&origin);
        let is_older = known.is_some_and(|known| {
            known.order.0 == order.0 && order.1.wrapping_sub(known.order.1).wrapping_sub(1) >= u32::MAX / 2
        });
        if !is_older {
            self.0.insert(origin, Newest { by, at: now, order });
        }
    }

    /// Returns the last hop of each origin, in the order of their ids.
    pub fn told(&self, now: Time) -> Vec<LastHop> {
        let told = |(origin, newest): (&HostId, &Newest)| LastHop {
            host: origin.0,
            by: newest.by.0,
            age_s: now.since(newest.at).as_secs(),
        };
        self.0.iter().map(told).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Span;

    #[test]
    fn the_first_neighbour_that_says_the_newest_entry_is_named() {
        let at = |ms| Time::ZERO + Span::from_millis(ms);
        let (mut ways, origin) = (LastHops::default(), HostId(4));
        ways.note(at(100), (origin, HostId(1)), (7, u32::MAX));
        ways.note(at(110), (origin, HostId(2)), (7, u32::MAX));
        ways.note(at(120), (origin, HostId(3)), (7, u32::MAX - 5));
        let told = |by, age_s| vec![LastHop { host: 4, by, age_s }];
        assert_eq!(ways.told(at(300)), told(1, 0.2), "a repetition and an older one name nobody");
        ways.note(at(400), (origin, HostId(2)), (7, 3));
        assert_eq!(ways.told(at(400)), told(2, 0.0), "numbers wrap");
        ways.note(at(500), (origin, origin), (8, 1));
        assert_eq!(ways.told(at(500)), told(4, 0.0), "a new run, heard directly");
    }
}
