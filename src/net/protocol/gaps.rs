//! Datagrams that are known to be missing: which are asked for, and when. Sends nothing.

use std::collections::BTreeMap;

use super::codec::{Flags, Header};
use super::order::LATE;
use super::report::Name;
use super::window::Window;
use crate::time::{Span, Time};

/// The most datagrams that are known to be missing.
const MAX_GAPS: usize = 256;
/// How often a missing datagram is asked for: at 30 % loss of requests and answers alike, 7 % stay missing.
const ASKS: u32 = 4;
/// The longest random wait before asking, so that one asks for all (RFC 5401, section 3.2).
pub const BACKOFF: Span = Span::from_millis(10);

/// A datagram that is missing.
#[derive(Clone, Copy, Debug)]
struct Gap {
    due: Time,
    asked: u32,
}

/// All that is known to be missing on one link.
#[derive(Clone, Debug, Default)]
pub struct Gaps(BTreeMap<Name, Gap>);

impl Gaps {
    /// A new datagram says what its sender still holds: whatever of it has not been here is missing. `backoff` draws
    /// how long to wait before asking. Only what is held is asked for, so requests never breed requests.
    pub fn note(
        &mut self,
        now: Time,
        header: &Header,
        held: &[u32],
        window: &Window,
        mut backoff: impl FnMut() -> Span,
    ) {
        self.0.remove(&Name::of(header));
        for &sequence in held.iter().filter(|sequence| window.misses(**sequence)) {
            if self.0.len() < MAX_GAPS {
                let name = Name::of(&Header { sequence, ..*header });
                self.0.entry(name).or_insert_with(|| Gap { due: now + backoff(), asked: 0 });
            }
        }
    }

    /// Whether nothing is known to be missing.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether this is a copy of a datagram that is being asked for: however old, its sender still holds it.
    pub fn awaits(&self, header: &Header) -> bool {
        header.flags.has(Flags::COPY) && self.0.contains_key(&Name::of(header))
    }

    /// Another host has asked for these: a second request would be one too many. What is for one host has a number
    /// among those of that host alone, so another's request says nothing of this one's.
    pub fn asked_by_others(&mut self, now: Time, names: &[Name]) {
        for name in names.iter().filter(|name| !name.direct) {
            if let Some(gap) = self.0.get_mut(name) {
                gap.due = gap.due.max(now + BACKOFF * 2);
            }
        }
    }

    /// When something is to be asked for.
    pub fn due(&self) -> Option<Time> {
        self.0.values().map(|gap| gap.due).min()
    }

    /// The datagrams to ask for now, at most `room`.
    pub fn ask(&mut self, now: Time, room: usize, mut backoff: impl FnMut() -> Span) -> Vec<Name> {
        let mut names = Vec::new();
        self.0.retain(|_, gap| gap.asked < ASKS || gap.due > now);
        for (name, gap) in &mut self.0 {
            if gap.due <= now && names.len() < room {
                names.push(*name);
                gap.asked += 1;
                // The last answer is waited for as long as there and back may take.
                gap.due = now + if gap.asked < ASKS { BACKOFF * (1 << gap.asked) + backoff() } else { LATE * 2 };
            }
        }
        names
    }
}
