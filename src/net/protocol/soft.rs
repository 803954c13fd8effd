//! Soft state (repeated messages: instructions, heartbeats, telemetry) that waits on a link, and when it leaves.

use std::collections::BTreeMap;

use super::codec::{Frame, HEADER_BYTES, MAX_PLAIN_BYTES};
use super::retransmit::StreamId;
use super::router::Audience;
use crate::messages::wire::Kind;
use crate::time::{Span, Time};

/// Longest time that soft state waits for a datagram with data to which it can be appended, one to the same receivers.
/// It does not wait if the last of these was sent longer ago than this. With data twelve times a second, all soft state
/// is appended.
pub const PIGGYBACK_WAIT: Span = Span::from_millis(100);
/// Smallest interval between datagrams that contain only soft state; half of it if they contain an instruction of the
/// state server.
pub const SOFT_PERIOD: Span = Span::from_millis(200);
/// Time after a heartbeat at which it leaves once more on a link with [`Setup::repeats_heartbeats`]: half of the period
/// of heartbeats.
///
/// [`Setup::repeats_heartbeats`]: super::reliability::Setup::repeats_heartbeats
const COPY_AFTER: Span = Span::from_millis(100);

/// Messages of soft state: for each stream the receivers of its newest message and its encoding.
type Newest = BTreeMap<StreamId, (Audience, Frame)>;

/// Soft state of a host that waits on one link.
#[derive(Clone, Debug, Default)]
pub struct Soft {
    pending: Newest,
    due: Option<Time>,
    /// Time since which soft state is pending; `None` if there is none.
    since: Option<Time>,
    /// Time since which the soft state had been waiting that was last sent in a datagram of its own. The next period
    /// counts from there, so that waits do not add up.
    sent: Option<Time>,
    copies: Copies,
}

/// Heartbeats that have left once and leave once more; none on most links.
#[derive(Clone, Debug, Default)]
struct Copies {
    wanted: bool,
    newest: Newest,
    due: Option<Time>,
}

impl Copies {
    /// Notes that a message has left.
    fn note(&mut self, now: Time, stream: StreamId, audience: Audience, frame: &Frame) {
        if self.wanted && stream.0 == Kind::Heartbeat {
            self.newest.insert(stream, (audience, frame.clone()));
            self.due = self.due.or(Some(now + COPY_AFTER));
        }
    }

    fn next(&mut self, now: Time) -> Option<(Audience, Frame)> {
        let (_, copy) = if self.due.is_some_and(|due| due <= now) { self.newest.pop_first() } else { None }?;
        if self.newest.is_empty() {
            self.due = None;
        }
        Some(copy)
    }

    /// Forgets the copy of a message of this stream, of which there is a newer one.
    fn forget(&mut self, stream: StreamId) {
        self.newest.remove(&stream);
        if self.newest.is_empty() {
            self.due = None;
        }
    }
}

impl Soft {
    /// Returns the state before any message. `repeats_heartbeats` says whether each heartbeat leaves twice.
    pub fn new(repeats_heartbeats: bool) -> Soft {
        Soft { copies: Copies { wanted: repeats_heartbeats, ..Copies::default() }, ..Soft::default() }
    }

    /// Takes a message in place of the last one of its stream. `data_sent` is the time at which data was last sent to
    /// the same receivers.
    pub fn put(&mut self, now: Time, stream: StreamId, to: (Audience, Frame), data_sent: Option<Time>) {
        self.copies.forget(stream);
        self.pending.insert(stream, to);
        let modes = self.pending.keys().any(|(kind, _)| *kind == Kind::Mode);
        let period = if modes { Span::from_nanos(SOFT_PERIOD.as_nanos() / 2) } else { SOFT_PERIOD };
        let flows = data_sent.is_some_and(|sent| now.since(sent) < PIGGYBACK_WAIT);
        let wait = if flows { now + PIGGYBACK_WAIT } else { now };
        let due = self.sent.map_or(wait, |sent| wait.max(sent + period));
        self.due = Some(self.due.map_or(due, |before| before.min(due)));
        self.since = self.since.or(Some(now));
    }

    /// Whether no message waits for a datagram to which it can be appended.
    pub fn is_empty(&self) -> bool {
        self.pending.is_empty()
    }

    /// Returns the time at which a datagram without data is due; `None` if nothing waits.
    pub fn due(&self) -> Option<Time> {
        self.due.into_iter().chain(self.copies.due).min()
    }

    /// Appends what has the receivers `audience` and fits to the datagram `bytes`, which leaves at `now`.
    pub fn add_to(&mut self, now: Time, audience: Audience, bytes: &mut Vec<u8>) {
        let Soft { pending, copies, .. } = self;
        pending.retain(|stream, (to, frame)| {
            let block = &frame[HEADER_BYTES..];
            let fits = *to == audience && bytes.len() + block.len() <= MAX_PLAIN_BYTES;
            if fits {
                bytes.extend_from_slice(block);
                copies.note(now, *stream, audience, frame);
            }
            !fits
        });
        self.settle();
    }

    /// Takes out a message that is due at `now`, for a datagram without data; `None` if none is.
    pub fn next(&mut self, now: Time) -> Option<(Audience, Frame)> {
        if self.due.is_none_or(|due| due > now) {
            return self.copies.next(now);
        }
        let (stream, (audience, frame)) = self.pending.pop_first()?;
        self.sent = self.since.or(Some(now));
        self.copies.note(now, stream, audience, &frame);
        self.settle();
        Some((audience, frame))
    }

    fn settle(&mut self) {
        if self.pending.is_empty() {
            (self.due, self.since) = (None, None);
        }
    }
}
