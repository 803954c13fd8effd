//! Soft state (repeated messages: instructions, heartbeats, telemetry) that waits on a link, and when it leaves.

use std::collections::BTreeMap;

use super::codec::{Frame, HEADER_BYTES};
use super::retransmit::StreamId;
use super::router::Audience;
use crate::messages::ids::RobotId;
use crate::messages::wire::Kind;
use crate::time::{Span, Time};

/// Longest time that soft state waits for a datagram with data to which it can be appended, one to the same receivers.
/// It does not wait if the last of these was sent longer ago than this. With data twelve times a second, all soft state
/// is appended.
pub const PIGGYBACK_WAIT: Span = Span::from_millis(100);
/// Smallest interval between datagrams that contain only soft state; half of it if they contain an instruction of the
/// state server.
pub const SOFT_PERIOD: Span = Span::from_millis(200);
/// Time after a heartbeat from which on its retransmission is appended to a datagram with data, and after which it
/// leaves in a datagram of its own: a fifth and half of the period of heartbeats.
const REPEAT_AFTER: [Span; 2] = [Span::from_millis(40), Span::from_millis(100)];

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

/// Heartbeats to be retransmitted.
#[derive(Clone, Debug, Default)]
struct Repeats {
    /// For each stream the time at which its heartbeat was sent, its receivers and its encoding.
    waiting: BTreeMap<StreamId, (Time, Audience, Frame)>,
}

impl Repeats {
    /// Notes that a message has left.
    fn note(&mut self, now: Time, stream: StreamId, audience: Audience, frame: &Frame) {
        if stream.0 == Kind::Heartbeat {
            self.waiting.insert(stream, (now, audience, frame.clone()));
        }
    }

    fn due(&self) -> Option<Time> {
        self.waiting.values().map(|(sent, ..)| *sent + REPEAT_AFTER[1]).min()
    }

    fn has_for(&self, now: Time, audience: Audience) -> bool {
        self.waiting.values().any(|(sent, to, _)| *to == audience && now.since(*sent) >= REPEAT_AFTER[0])
    }

    /// Appends what may leave at `now`, has the receivers `audience` and fits to a datagram.
    fn add_to(&mut self, now: Time, audience: Audience, datagram: &mut Roomy) {
        let waits = |sent: Time| now.since(sent) < REPEAT_AFTER[0];
        self.waiting.retain(|_, (sent, to, frame)| waits(*sent) || *to != audience || !datagram.append(frame));
    }

    fn next(&mut self, now: Time) -> Option<(Audience, Frame)> {
        let stream = *self.waiting.iter().find(|(_, (sent, ..))| *sent + REPEAT_AFTER[1] <= now)?.0;
        self.waiting.remove(&stream).map(|(_, audience, frame)| (audience, frame))
    }
}

/// Datagram to which messages are appended, and its largest length \[bytes\].
pub struct Roomy<'a> {
    /// Bytes of the datagram so far.
    pub bytes: &'a mut Vec<u8>,
    /// Largest length of the datagram.
    pub most: usize,
}

impl Roomy<'_> {
    /// Appends the message in `frame` if it fits. Returns whether it does.
    fn append(&mut self, frame: &Frame) -> bool {
        let block = &frame[HEADER_BYTES..];
        let fits = self.bytes.len() + block.len() <= self.most;
        if fits {
            self.bytes.extend_from_slice(block);
        }
        fits
    }
}

impl Soft {
    /// Forgets the retransmission of a heartbeat, since its stream has a newer message.
    pub fn forget(&mut self, stream: StreamId) {
        self.repeats.waiting.remove(&stream);
    }

    /// Notes that a message has left, of which a heartbeat is to be retransmitted.
    pub fn repeat(&mut self, now: Time, stream: StreamId, (audience, frame): (Audience, &Frame)) {
        self.repeats.note(now, stream, audience, frame);
    }

    /// Whether a heartbeat to the receivers `audience` waits to be sent for the first time.
    pub fn has_heartbeat(&self, audience: Audience) -> bool {
        let mut all = self.pending.range((Kind::Heartbeat, RobotId(0))..=(Kind::Heartbeat, RobotId(u16::MAX)));
        all.any(|(_, (to, _))| *to == audience)
    }

    /// Takes a message in place of the last one of its stream. `data_sent` is the time at which data was last sent to
    /// the same receivers.
    pub fn put(&mut self, now: Time, stream: StreamId, to: (Audience, Frame), data_sent: Option<Time>) {
        self.forget(stream);
        self.pending.insert(stream, to);
        let modes = self.pending.keys().any(|(kind, _)| *kind == Kind::Mode);
        let period = if modes { Span::from_nanos(SOFT_PERIOD.as_nanos() / 2) } else { SOFT_PERIOD };
        let flows = data_sent.is_some_and(|sent| now.since(sent) < PIGGYBACK_WAIT);
        let wait = if flows { now + PIGGYBACK_WAIT } else { now };
        let due = self.sent.map_or(wait, |sent| wait.max(sent + period));
        self.due = Some(self.due.map_or(due, |before| before.min(due)));
        self.since = self.since.or(Some(now));
    }

    /// Whether a message waits that can be appended to a datagram to `audience` that leaves at `now`.
    pub fn has_for(&self, now: Time, audience: Audience) -> bool {
        self.pending.values().any(|(to, _)| *to == audience) || self.repeats.has_for(now, audience)
    }

    /// Returns the time at which a datagram without data is due; `None` if nothing waits.
    pub fn due(&self) -> Option<Time> {
        self.due.into_iter().chain(self.repeats.due()).min()
    }

    /// Appends what has the receivers `audience` and fits to the datagram, which leaves at `now`. `twice` says whether
    /// heartbeats in it are to be retransmitted.
    pub fn add_to(&mut self, now: Time, audience: Audience, mut datagram: Roomy, twice: bool) {
        let Soft { pending, repeats, .. } = self;
        repeats.add_to(now, audience, &mut datagram);
        pending.retain(|stream, (to, frame)| {
            let leaves = *to == audience && datagram.append(frame);
            if leaves && twice {
                repeats.note(now, *stream, audience, frame);
            }
            !leaves
        });
        self.settle();
    }

    /// Takes out a message that is due at `now`, for a datagram without data; `None` if none is. Its stream is returned
    /// with one that leaves for the first time.
    pub fn next(&mut self, now: Time) -> Option<(Option<StreamId>, Audience, Frame)> {
        if self.due.is_none_or(|due| due > now) {
            return self.repeats.next(now).map(|(audience, frame)| (None, audience, frame));
        }
        let (stream, (audience, frame)) = self.pending.pop_first()?;
        self.sent = self.since.or(Some(now));
        self.settle();
        Some((Some(stream), audience, frame))
    }

    fn settle(&mut self) {
        if self.pending.is_empty() {
            (self.due, self.since) = (None, None);
        }
    }
}
