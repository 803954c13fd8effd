//! Retransmission of the newest datagram of each stream. Decides when; the caller seals and sends.
//!
//! A newer message of a stream replaces the older one, so that new messages never wait for the delivery of old ones.

use std::collections::{BTreeMap, BTreeSet};

use super::codec::Frame;
use super::counts::LinkCounts;
use super::limits::FRESH;
use super::reliability::Reliability;
use super::report::{DatagramId, MAX_HELD};
use super::router::Audience;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Kind;
use crate::time::{Span, Time};

/// Time after which a message in the reliability mode `repeat` is sent again; earlier if the next message of its stream
/// comes earlier.
pub(crate) const REPEAT_AFTER: Span = Span::from_millis(4);
/// Time without an acknowledgement after which a message in the reliability mode `ack` is first retransmitted. Each
/// further wait is twice as long.
pub const RETRY_AFTER: Span = Span::from_millis(5);
/// Largest number of retransmissions of a message in the reliability mode `ack` that is not acknowledged.
pub const RETRIES: u8 = 5;
/// Interval within which several requests for one datagram are answered once.
const REQUEST_INTERVAL: Span = Span::from_millis(2);

/// Identity of a stream of messages: the kind of the messages, and the robot that they are about.
pub(crate) type StreamId = (Kind, RobotId);
/// Receivers of a datagram, and the datagram without its authentication tag.
pub(crate) type Untagged = (Audience, Frame);

/// Newest datagram of a stream, kept for retransmission.
#[derive(Clone, Debug)]
struct Kept {
    audience: Audience,
    sequence: u32,
    plain: Frame,
    reliability: Reliability,
    sent_at: Time,
    due: Option<Time>,
    /// Number of retransmissions so far, and the most allowed.
    count: u8,
    limit: u8,
    /// Number of the offer that last included the datagram.
    offered: u64,
    acked: BTreeSet<HostId>,
}

/// Newest datagram of each stream of one link, kept as long as it may be retransmitted.
#[derive(Clone, Debug, Default)]
pub(crate) struct Retransmitter {
    kept: BTreeMap<StreamId, Kept>,
    dues: BTreeSet<(Time, StreamId)>,
    /// Hosts that have acknowledged any datagram, with the time of their last acknowledgement.
    ackers: BTreeMap<HostId, Time>,
    /// Number of offers for retransmission so far.
    offers: u64,
}

impl Retransmitter {
    /// Removes the kept datagram of a stream because a newer message replaces it. Returns it if a repeat of it is
    /// pending (mode `repeat`) and it was sent before `now`: the repeat has to go out before the newer message, after
    /// which receivers would refuse it as stale. `None` otherwise.
    pub(crate) fn supersede(&mut self, now: Time, stream: StreamId) -> Option<Untagged> {
        let kept = self.kept.get(&stream)?;
        let before = kept.reliability == Reliability::Repeat && kept.due.is_some() && kept.sent_at < now;
        let datagram = before.then(|| (kept.audience, kept.plain.clone()));
        self.forget(stream);
        datagram
    }

    fn forget(&mut self, stream: StreamId) {
        if let Some(due) = self.kept.remove(&stream).and_then(|kept| kept.due) {
            self.dues.remove(&(due, stream));
        }
    }

    /// Keeps a datagram that was sent at `now` with a message of this stream, as the stream's reliability mode
    /// requires. `repeats` is the number of times that a message in the mode `repeat` is sent again.
    pub(crate) fn keep(
        &mut self,
        now: Time,
        stream: StreamId,
        (audience, plain): Untagged,
        sequence: u32,
        (reliability, repeats): (Reliability, u8),
    ) {
        let (after, limit) = match reliability {
            Reliability::BestEffort => return,
            Reliability::Repeat if repeats == 0 => return,
            Reliability::Repeat => (Some(REPEAT_AFTER), repeats),
            Reliability::Nack => (None, u8::MAX),
            Reliability::Ack => (Some(RETRY_AFTER), RETRIES),
        };
        let due = after.map(|after| now + after);
        let (sent_at, count, acked, offered) = (now, 0, BTreeSet::new(), 0);
        let kept = Kept { audience, sequence, plain, reliability, sent_at, due, count, limit, offered, acked };
        self.kept.insert(stream, kept);
        self.dues.extend(due.map(|due| (due, stream)));
    }

    /// Returns the kept datagram of a stream for retransmission, and schedules the next one.
    fn retransmit(&mut self, now: Time, stream: StreamId) -> Option<Untagged> {
        let kept = self.kept.get_mut(&stream)?;
        if let Some(due) = kept.due.take() {
            self.dues.remove(&(due, stream));
        }
        kept.count = kept.count.saturating_add(1);
        kept.sent_at = now;
        let datagram = (kept.audience, kept.plain.clone());
        match kept.reliability {
            Reliability::Repeat if kept.count >= kept.limit => self.forget(stream),
            Reliability::Repeat => kept.due = Some(now + REPEAT_AFTER),
            // Includes the wait for the answer to the last retransmission.
            Reliability::Ack => kept.due = Some(now + RETRY_AFTER * (1 << kept.count.min(RETRIES))),
            Reliability::BestEffort | Reliability::Nack => {}
        }
        self.dues.extend(self.kept.get(&stream).and_then(|kept| kept.due).map(|due| (due, stream)));
        Some(datagram)
    }

    /// Handles acknowledgements of the host `from`. A multicast datagram is removed once every host that has recently
    /// acknowledged any datagram has acknowledged it.
    pub(crate) fn acknowledged(&mut self, now: Time, from: HostId, ids: &[DatagramId]) {
        self.ackers.insert(from, now);
        self.ackers.retain(|_, at| now.since(*at) < FRESH);
        for id in ids {
            let Some(stream) = self.find(from, id, Reliability::Ack) else { continue };
            let kept = self.kept.get_mut(&stream).expect("it was found");
            kept.acked.insert(from);
            if kept.audience != Audience::All || self.ackers.keys().all(|host| kept.acked.contains(host)) {
                self.forget(stream);
            }
        }
    }

    /// Returns the stream of the datagram that the host `from` refers to: sent to all hosts, or only to `from`.
    fn find(&self, from: HostId, id: &DatagramId, reliability: Reliability) -> Option<StreamId> {
        let audience = if id.direct { Audience::Host(from) } else { Audience::All };
        let named = |kept: &Kept| kept.sequence == id.sequence && kept.audience == audience;
        let found = self.kept.iter().find(|(_, kept)| kept.reliability == reliability && named(kept));
        found.map(|(stream, _)| *stream)
    }

    /// Returns the datagrams that the host `from` requests, except those that newer messages have replaced, and those
    /// retransmitted within the last 2 ms.
    pub(crate) fn requested(&mut self, now: Time, from: HostId, ids: &[DatagramId]) -> Vec<Untagged> {
        let mut answer = |id: &DatagramId| {
            let stream = self.find(from, id, Reliability::Nack)?;
            let kept = &self.kept[&stream];
            let rested = kept.count == 0 || now.since(kept.sent_at) >= REQUEST_INTERVAL;
            if rested { self.retransmit(now, stream) } else { None }
        };
        ids.iter().filter_map(&mut answer).collect()
    }

    /// Returns the sequence numbers of the kept datagrams to `audience` that receivers may request, at most 16
    /// (`MAX_HELD`). Those offered longest ago come first.
    pub(crate) fn held(&mut self, audience: Audience) -> Vec<u32> {
        let repaired = |kept: &&mut Kept| kept.reliability == Reliability::Nack && kept.audience == audience;
        let mut all: Vec<&mut Kept> = self.kept.values_mut().filter(repaired).collect();
        if all.len() > MAX_HELD {
            all.sort_by_key(|kept| kept.offered);
            all.truncate(MAX_HELD);
        }
        self.offers += 1;
        for kept in &mut all {
            kept.offered = self.offers;
        }
        all.iter().map(|kept| kept.sequence).collect()
    }

    /// Returns the time of the next retransmission; `None` if none is pending.
    pub(crate) fn due(&self) -> Option<Time> {
        self.dues.first().map(|(due, _)| *due)
    }

    /// Returns the next datagram that is due for retransmission at `now`; `None` if none is. Datagrams that were
    /// retransmitted as often as permitted are removed, and counted in `counts`.
    pub(crate) fn next(&mut self, now: Time, counts: &mut LinkCounts) -> Option<Untagged> {
        while let Some(&(_, stream)) = self.dues.first().filter(|(due, _)| *due <= now) {
            if self.kept[&stream].count < self.kept[&stream].limit {
                return self.retransmit(now, stream);
            }
            self.forget(stream);
            counts.lapsed += 1;
        }
        None
    }
}
