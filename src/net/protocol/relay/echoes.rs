//! Numbers of a host's entries, and the newest of others, by which readers tell how old an entry is.
//!
//! A number is the time of the host's own clock, from a random one on. An entry that echoes a number of its reader was
//! made after that number was; so its reader knows how old it is at most, whatever relays did, without another clock.

use std::collections::BTreeMap;

use super::entry::{Entry, MAX_ECHOES};
use crate::messages::ids::HostId;
use crate::random::{RngExt, Stream};
use crate::time::{Span, Time};

/// Age of an echoed number up to which an entry is believed.
const FRESH: Span = Span::from_millis(2_000);
/// Age of what was heard last of a host from which on it is not echoed any more.
const GONE: Span = Span::from_millis(5_000);

/// Own numbers, and the newest ones of other hosts.
#[derive(Clone, Debug)]
pub(super) struct Echoes {
    first: u32,
    last: u32,
    newest: BTreeMap<HostId, Newest>,
}

/// Newest number of another host.
#[derive(Clone, Debug)]
struct Newest {
    incarnation: u32,
    number: u32,
    at: Time,
    /// Time at which this incarnation last said something that was fresh.
    trusted: Option<Time>,
}

impl Echoes {
    pub fn new(stream: &mut Stream) -> Echoes {
        let first = stream.random_range(0..u32::MAX);
        Echoes { first, last: first, newest: BTreeMap::new() }
    }

    fn clock(&self, now: Time) -> u32 {
        // It wraps after 49 days.
        self.first.wrapping_add((now.since(Time::ZERO).as_nanos() / 1_000_000) as u32)
    }

    /// Returns the number of an entry that is made at `now`: larger than that of each before.
    pub fn number(&mut self, now: Time) -> u32 {
        let (clock, next) = (self.clock(now), self.last.wrapping_add(1));
        // More than one in a millisecond run ahead of the clock.
        let ahead = next.wrapping_sub(clock) < u32::MAX / 2;
        self.last = if ahead { next } else { clock };
        self.last
    }

    /// Returns the echoes of an entry that is made at `now`: of the host `of`, or with `None` of all hosts.
    pub fn of(&self, now: Time, of: Option<HostId>) -> Vec<(HostId, u32)> {
        let alive = self.newest.iter().filter(|(_, newest)| now.since(newest.at) <= GONE);
        let asked = alive.filter(|(host, _)| of.is_none_or(|of| **host == of));
        asked.map(|(host, newest)| (*host, newest.number)).take(MAX_ECHOES).collect()
    }

    /// Takes note of an entry with a sound proof. One of another incarnation is echoed once that before says nothing
    /// fresh any more.
    pub fn note(&mut self, now: Time, entry: &Entry) {
        let Entry { incarnation, number, .. } = *entry;
        let newest = Newest { incarnation, number, at: now, trusted: None };
        let known = self.newest.entry(entry.origin).or_insert_with(|| newest.clone());
        let is_trusted = known.trusted.is_some_and(|at| now.since(at) <= FRESH);
        if known.incarnation == incarnation {
            let newer = number.wrapping_sub(known.number) < u32::MAX / 2;
            // A recording does not keep the number of a host from being echoed that has not been fresh yet.
            if newer || !is_trusted {
                (known.number, known.at) = (number, now);
            }
        } else if !is_trusted {
            *known = newest;
        }
    }

    /// Takes note that an entry was fresh: its origin is alive, and its run takes the place of one before.
    pub fn trust(&mut self, now: Time, entry: &Entry) {
        let Entry { incarnation, number, .. } = *entry;
        let known = self.newest.get(&entry.origin).filter(|known| known.incarnation == incarnation);
        let newest = known.filter(|known| number.wrapping_sub(known.number) > u32::MAX / 2).map(|known| known.number);
        let newest = Newest { incarnation, number: newest.unwrap_or(number), at: now, trusted: Some(now) };
        self.newest.insert(entry.origin, newest);
    }

    /// Whether an entry was made at most two seconds ago, by the echo of a number of this host `me`; and by the
    /// incarnation of its origin that is alive.
    pub fn is_fresh(&self, now: Time, entry: &Entry, me: HostId) -> bool {
        let mine = entry.echoes.iter().find(|(host, _)| *host == me);
        let age_ms = mine.map(|(_, number)| self.clock(now).wrapping_sub(*number).cast_signed());
        // A number may be ahead of the clock by those of the same millisecond.
        age_ms.is_some_and(|ms| (-50..=(FRESH.as_nanos() / 1_000_000) as i32).contains(&ms))
    }
}
