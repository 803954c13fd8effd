//! View that one station of a channel with space has of the medium: whether it is busy, and when slots may be counted.

use serde::{Deserialize, Serialize};

use crate::time::{Span, Time};

/// View that one station has of the medium.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct View {
    /// Number of transmissions that the station senses now, its own among them.
    pub busy: u32,
    /// Time from which the station counts slots, if it senses nothing.
    pub free_at: Time,
    /// Time up to which the medium is reserved for an acknowledgement (network allocation vector, IEEE 802.11-2016,
    /// 10.3.2.4).
    pub reserved: Time,
    /// Whether the last frame that was sensed could not be read though it was strong enough.
    pub unread: bool,
    /// Number of the transmission that the station itself sends.
    pub sending: Option<u32>,
}

impl View {
    /// Returns the view of a station that counts slots from `free_at` on.
    pub fn new(free_at: Time) -> View {
        View { busy: 0, free_at, reserved: Time::ZERO, unread: false, sending: None }
    }

    /// Returns how many slots have passed at time `now` since the station could count them; `None` before.
    pub fn slots(&self, now: Time, slot: Span) -> Option<u64> {
        (self.free_at <= now).then(|| now.since(self.free_at).as_nanos() / slot.as_nanos())
    }
}
