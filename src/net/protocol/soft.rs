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
/// Delay of the retransmission of a heartbeat, on a link with [`Setup::repeats_heartbeats`]: half of the period of
/// heartbeats.
///
/// [`Setup::repeats_heartbeats`]: super::reliability::Setup::repeats_heartbeats
const REPEAT_AFTER: Span = Span::from_millis(100);

/// Soft state of a host that waits on one link.
#[derive(Clone, Debug, Default)]
pub struct Soft {
    /// For each stream the receivers of its newest message and its encoding.
    pending: BTreeMap<StreamId, (Audience, Frame)>,
    due: Option<Time>,
    /// Time since which soft state is pending; `None` if there is none.
    since: Option<Time>,
    /// Time since which the soft state had been waiting that was last sent in a datagram of its own. The next period
    /// counts from there, so that waits do not add up.
    sent: Option<Time>,
    repeats: Repeats,
}

/// Heartbeats to be retransmitted; none on a link without [`Setup::repeats_heartbeats`].
///
/// [`Setup::repeats_heartbeats`]: super::reliability::Setup::repeats_heartbeats
#[derive(Clone, Debug, Default)]
struct Repeats {
    wanted: bool,
    /// For each stream the time at which the retransmission is due, its receivers and its encoding.
    waiting: BTreeMap<StreamId, (Time, Audience, Frame)>,
}

impl Repeats {
    /// Notes that a message has left.
    fn note(&mut self, now: Time, stream: StreamId, audience: Audience, frame: &Frame) {
        if self.wanted && stream.0 == Kind::Heartbeat {
            self.waiting.insert(stream, (now + REPEAT_AFTER, audience, frame.clone()));
        }
    }

    fn due(&self) -> Option<Time> {
        self.waiting.values().map(|(due, ..)| *due).min()
    }

    /// Appends what is due at `now`, has the receivers `audience` and fits to a datagram.
    fn add_to(&mut self, now: Time, audience: Audience, bytes: &mut Vec<u8>) {
        self.waiting.retain(|_, (due, to, frame)| *due > now || *to != audience || !append(frame, bytes));
    }

    fn next(&mut self, now: Time) -> Option<(Audience, Frame)> {
        let stream = *self.waiting.iter().find(|(_, (due, ..))| *due <= now)?.0;
        self.waiting.remove(&stream).map(|(_, audience, frame)| (audience, frame))
    }
}

/// Appends the message in `frame` to a datagram if it fits. Returns whether it does.
fn append(frame: &Frame, bytes: &mut Vec<u8>) -> bool {
    let block = &frame[HEADER_BYTES..];
    let fits = bytes.len() + block.len() <= MAX_PLAIN_BYTES;
    if fits {
        bytes.extend_from_slice(block);
    }
    fits
}

impl Soft {
    /// Returns the state before any message. `repeats_heartbeats` says whether each heartbeat is sent twice.
    pub fn new(repeats_heartbeats: bool) -> Soft {
        Soft { repeats: Repeats { wanted: repeats_heartbeats, ..Repeats::default() }, ..Soft::default() }
    }

    /// Takes a message in place of the last one of its stream. `data_sent` is the time at which data was last sent to
    /// the same receivers.
    pub fn put(&mut self, now: Time, stream: StreamId, to: (Audience, Frame), data_sent: Option<Time>) {
        self.repeats.waiting.remove(&stream);
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
        self.due.into_iter().chain(self.repeats.due()).min()
    }

    /// Appends what has the receivers `audience` and fits to the datagram `bytes`, which leaves at `now`.
    pub fn add_to(&mut self, now: Time, audience: Audience, bytes: &mut Vec<u8>) {
        let Soft { pending, repeats, .. } = self;
        repeats.add_to(now, audience, bytes);
        pending.retain(|stream, (to, frame)| {
            let leaves = *to == audience && append(frame, bytes);
            if leaves {
                repeats.note(now, *stream, audience, frame);
            }
            !leaves
        });
        self.settle();
    }

    /// Takes out a message that is due at `now`, for a datagram without data; `None` if none is.
    pub fn next(&mut self, now: Time) -> Option<(Audience, Frame)> {
        if self.due.is_none_or(|due| due > now) {
            return self.repeats.next(now);
        }
        let (stream, (audience, frame)) = self.pending.pop_first()?;
        self.sent = self.since.or(Some(now));
        self.repeats.note(now, stream, audience, &frame);
        self.settle();
        Some((audience, frame))
    }

    fn settle(&mut self) {
        if self.pending.is_empty() {
            (self.due, self.since) = (None, None);
        }
    }
}
