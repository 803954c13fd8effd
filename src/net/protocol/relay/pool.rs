//! Entries of other hosts that a host passes on: which it knows, and which it still has to say.
//!
//! A relay cannot check a proof that is for the state server alone. So that one that invents entries keeps no true one
//! from being passed on, the entries of a stream that could not be checked are kept apart by the neighbour that has
//! said them; the newest goes on at once, each other one if its neighbour still says it a while later.

use std::collections::BTreeMap;

use super::entry::{Content, EntryId};
use super::own::TIMES;
use crate::messages::ids::HostId;
use crate::net::protocol::codec::Frame;
use crate::time::{Span, Time};

/// Number of neighbours that have said an entry from which on it needs no more.
const ENOUGH: u8 = 5;
/// Largest number of different entries of a stream.
const VARIANTS: usize = 3;
/// Time after which an entry that is not the newest of its stream is passed on, longer than a period of states.
const DOUBTED: Span = Span::from_millis(60);
/// Age from which on an entry is not said any more.
const OLD: Span = Span::from_millis(2_000);
/// Largest number of streams of other hosts.
const MOST: usize = 512;

/// Entries of other hosts, by stream.
#[derive(Clone, Debug, Default)]
pub(super) struct Pool(BTreeMap<EntryId, Vec<Held>>);

/// Entry of another host.
#[derive(Clone, Debug)]
struct Held {
    entry: Frame,
    /// Incarnation of the origin, and number.
    order: (u32, u32),
    /// Neighbour that has said it first.
    from: HostId,
    since: Time,
    /// Number of times that neighbours have said it, and this host.
    heard: u8,
    said: u8,
}

impl Held {
    fn is_after(&self, order: (u32, u32)) -> bool {
        self.order.0 == order.0 && self.order.1.wrapping_sub(order.1) < u32::MAX / 2
    }
}

impl Pool {
    /// Takes note that the neighbour `from` says an entry. Returns whether it is known.
    pub fn heard(&mut self, from: HostId, id: EntryId, entry: &Frame) -> bool {
        let Some(held) = self.0.get_mut(&id) else { return false };
        let Some(at) = held.iter().position(|held| held.entry == *entry) else { return false };
        held[at].heard = held[at].heard.saturating_add(1);
        // It has taken the place of the one that the neighbour has said before.
        let same = Frame::clone(entry);
        held.retain(|held| held.from != from || held.entry == same);
        true
    }

    /// Takes an entry that the neighbour `from` has said first. One whose proof was checked and is sound takes the
    /// place of all older ones.
    pub fn put(&mut self, now: Time, (id, from): (EntryId, HostId), order: (u32, u32), entry: &Frame, sound: bool) {
        if self.0.len() >= MOST && !self.0.contains_key(&id) {
            self.0.retain(|_, held| held.iter().any(|held| now.since(held.since) < OLD));
            if self.0.len() >= MOST {
                return;
            }
        }
        let held = self.0.entry(id).or_default();
        if held.iter().any(|held| (sound || held.from == from) && held.is_after(order)) {
            return;
        }
        // A recording of a former run has a sound proof, too.
        held.retain(|held| !(sound && held.order.0 == order.0) && held.from != from);
        if held.len() >= VARIANTS {
            held.remove(0);
        }
        held.push(Held { entry: Frame::clone(entry), order, from, since: now, heard: 1, said: 0 });
    }

    /// Returns the entries that are to be said at `now`: those of the state server, on which all wait, then the newest.
    pub fn unsaid(&self, now: Time) -> Vec<Frame> {
        let mut all: Vec<(Time, &EntryId, &Frame)> = Vec::new();
        for (id, held) in &self.0 {
            let newest = held.iter().max_by_key(|held| held.order.1);
            for one in held {
                let waits = newest.is_some_and(|newest| newest.entry != one.entry) && now.since(one.since) < DOUBTED;
                if one.said < TIMES && one.heard < ENOUGH && now.since(one.since) < OLD && !waits {
                    all.push((one.since, id, &one.entry));
                }
            }
        }
        let leads = |id: &EntryId| id.1 == Content::Lead;
        all.sort_by(|a, b| leads(b.1).cmp(&leads(a.1)).then(b.0.cmp(&a.0)).then(a.1.cmp(b.1)));
        all.into_iter().map(|(.., entry)| Frame::clone(entry)).collect()
    }

    /// Takes note that an entry has left. Returns whether it was known.
    pub fn said(&mut self, entry: &Frame) -> bool {
        let held = self.0.values_mut().flatten().find(|held| held.entry == *entry);
        held.map(|held| held.said += 1).is_some()
    }
}
