//! Neighbours that pass nothing on: they speak, and say no entry of any other host.

use std::collections::{BTreeMap, VecDeque};

use crate::messages::ids::HostId;
use crate::time::{Span, Time};

/// Time in which a neighbour has to pass something on. With the period of counts it is named within five seconds.
const WINDOW: Span = Span::from_millis(4_000);
/// Number of entries that a neighbour would have passed on in this time, from which on none is no chance.
const EXPECTED: f64 = 12.0;
/// Number of neighbours from which on one of them need not say an entry, since others have.
const ENOUGH: f64 = 5.0;
/// Time since its last entry for which a host counts as a neighbour.
const NEAR: Span = Span::from_millis(1_500);

/// Entries that were said to all neighbours, and when each neighbour last passed one on.
#[derive(Clone, Debug, Default)]
pub(super) struct Withholding {
    /// Times at which entries were said, and how many.
    said: VecDeque<(Time, usize)>,
    neighbours: BTreeMap<HostId, Neighbour>,
}

#[derive(Clone, Copy, Debug)]
struct Neighbour {
    heard: Time,
    /// Time at which it last passed something on, or was heard after a silence.
    passed: Time,
}

impl Withholding {
    /// Takes note that this host has said so many entries, its own or those of others.
    pub fn note_said(&mut self, now: Time, count: usize) {
        self.said.push_back((now, count));
        while self.said.front().is_some_and(|(at, _)| now.since(*at) > WINDOW) {
            self.said.pop_front();
        }
    }

    /// Takes note that a neighbour has sent entries, and whether there is one of another host among them.
    pub fn note_heard(&mut self, now: Time, from: HostId, passes: bool) {
        let new = Neighbour { heard: now, passed: now };
        let known = self.neighbours.entry(from).or_insert(new);
        if passes || now.since(known.heard) > NEAR {
            known.passed = now;
        }
        known.heard = now;
    }

    /// Returns the neighbours that are heard and have passed nothing on. Each entry is said twice, and one of many
    /// neighbours says only a part of them.
    pub fn hosts(&self, now: Time) -> Vec<HostId> {
        let near = self.neighbours.iter().filter(|(_, known)| now.since(known.heard) <= NEAR);
        let count = near.clone().count() as f64;
        let recent = self.said.iter().filter(|(at, _)| now.since(*at) <= WINDOW);
        let said: usize = recent.map(|(_, count)| count).sum();
        let expected = said as f64 / 2.0 * (ENOUGH / count.max(ENOUGH));
        let silent = near.filter(|(_, known)| expected >= EXPECTED && now.since(known.passed) >= WINDOW);
        silent.map(|(host, _)| *host).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    #[test]
    fn a_neighbour_that_speaks_and_passes_nothing_on_is_named_within_five_seconds() {
        let mut withholding = Withholding::default();
        for ms in (0..5000).step_by(500) {
            withholding.note_said(at_ms(ms), 4);
            withholding.note_heard(at_ms(ms), HostId(1), false);
            withholding.note_heard(at_ms(ms), HostId(2), ms % 2000 == 0);
        }
        assert_eq!(withholding.hosts(at_ms(3900)), [], "it may have had nothing to say");
        assert_eq!(withholding.hosts(at_ms(4600)), [HostId(1)]);
        assert_eq!(withholding.hosts(at_ms(9000)), [], "it is not heard any more");
    }

    #[test]
    fn none_of_many_is_named_for_what_others_have_said() {
        let mut withholding = Withholding::default();
        for ms in (0..5000).step_by(500) {
            withholding.note_said(at_ms(ms), 4);
            (1..=20).for_each(|host| withholding.note_heard(at_ms(ms), HostId(host), false));
        }
        assert_eq!(withholding.hosts(at_ms(4600)), []);
    }
}
