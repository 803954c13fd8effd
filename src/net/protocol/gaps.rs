//! Missing datagrams of one link: which ones to request, and when. The caller sends the requests.

use std::collections::BTreeMap;

use rand::RngExt;

use super::codec::{Flags, Header};
use super::lateness::LATE;
use super::report::DatagramId;
use super::window::Window;
use crate::random::Stream;
use crate::time::{Span, Time};

/// Largest number of missing datagrams that are tracked.
const MAX_GAPS: usize = 256;
/// Largest number of requests for a datagram. At 30 % loss of requests and answers, 7 % of the missing datagrams stay
/// missing.
const ASKS: u32 = 4;
/// Longest random wait before a receiver requests a missing datagram. The first receiver that requests it suppresses
/// the requests of others (RFC 5401, section 3.2).
pub const BACKOFF: Span = Span::from_millis(10);

/// State of a missing datagram.
#[derive(Clone, Copy, Debug)]
struct Gap {
    due: Time,
    asked: u32,
}

/// Missing datagrams of one link that senders have offered for retransmission, with the times of the requests.
#[derive(Clone, Debug, Default)]
pub struct Gaps(BTreeMap<DatagramId, Gap>);

impl Gaps {
    /// Removes the datagram with this header, which has arrived, from the missing ones. Adds those that it offers for
    /// retransmission (sequence numbers `held`) and that `window`, of the same sequence space, has not received.
    /// `backoff` draws the wait before a request. Datagrams that their sender does not offer, such as requests, are
    /// not requested when they are lost.
    pub fn note(
        &mut self,
        now: Time,
        header: &Header,
        held: &[u32],
        window: &Window,
        mut backoff: impl FnMut() -> Span,
    ) {
        self.0.remove(&DatagramId::of(header));
        for &sequence in held.iter().filter(|sequence| window.misses(**sequence)) {
            if self.0.len() < MAX_GAPS {
                let id = DatagramId::of(&Header { sequence, ..*header });
                self.0.entry(id).or_insert_with(|| Gap { due: now + backoff(), asked: 0 });
            }
        }
    }

    /// Returns whether no missing datagram is tracked.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns whether the datagram with this header is the retransmission of one that is missing. It is then accepted
    /// at any age.
    pub fn awaits(&self, header: &Header) -> bool {
        header.flags.has(Flags::COPY) && self.0.contains_key(&DatagramId::of(header))
    }

    /// Postpones requests for the datagrams `ids`, which another host has just requested. It concerns only datagrams to
    /// all hosts: each receiver has its own sequence space for unicast datagrams.
    pub fn asked_by_others(&mut self, now: Time, ids: &[DatagramId]) {
        for id in ids.iter().filter(|id| !id.direct) {
            if let Some(gap) = self.0.get_mut(id) {
                gap.due = gap.due.max(now + BACKOFF * 2);
            }
        }
    }

    /// Returns the time at which to call [`Gaps::ask`] next; `None` if no missing datagram is tracked.
    pub fn due(&self) -> Option<Time> {
        self.0.values().map(|gap| gap.due).min()
    }

    /// Returns the datagrams to request at `now`, at most `room`. `backoff` draws the wait before the next request for
    /// each.
    pub fn ask(&mut self, now: Time, room: usize, mut backoff: impl FnMut() -> Span) -> Vec<DatagramId> {
        let mut ids = Vec::new();
        self.0.retain(|_, gap| gap.asked < ASKS || gap.due > now);
        for (id, gap) in &mut self.0 {
            if gap.due <= now && ids.len() < room {
                ids.push(*id);
                gap.asked += 1;
                // Wait one round trip for the answer to the last request.
                gap.due = now + if gap.asked < ASKS { BACKOFF * (1 << gap.asked) + backoff() } else { LATE * 2 };
            }
        }
        ids
    }
}

/// Draws the backoff before a request for a retransmission: mostly long, rarely short, so that few receivers send one
/// (RFC 5401, section 3.2, `RandomBackoff`).
pub(super) fn backoff(stream: &mut Stream) -> Span {
    /// Number of receivers that the distribution of the backoff assumes.
    const GROUP: f64 = 10.0;
    let (lambda, longest) = (libm::log(GROUP) + 1.0, BACKOFF.as_secs());
    let scale = lambda / (longest * (libm::exp(lambda) - 1.0));
    let drawn = stream.random_range(0.0..1.0) * (lambda / longest) + scale;
    Span::from_secs((longest / lambda * libm::log(drawn / scale)).min(longest))
}
