//! Retransmission: the newest datagram of each stream, until it is out of date. Decides when; seals
//! and sends nothing.
//!
//! A newer message of a stream takes the older one's place, so nothing fresh ever waits behind something old.

use std::collections::{BTreeMap, BTreeSet};

use super::codec::Frame;
use super::counts::LinkCounts;
use super::limits::FRESH;
use super::reliability::Reliability;
use super::report::{MAX_HELD, Name};
use super::router::Audience;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Kind;
use crate::time::{Span, Time};

/// How long after a message its repeat follows, unless the next of its stream is due before.
pub const REPEAT_AFTER: Span = Span::from_millis(4);
/// How long the first retry waits for an acknowledgement; each further one twice as long as the one before.
pub const RETRY_AFTER: Span = Span::from_millis(5);
/// How often a message is sent again without an acknowledgement.
pub const RETRIES: u8 = 5;
/// Two requests for one datagram within this time are answered once.
const ONCE_WITHIN: Span = Span::from_millis(2);

/// A kind about a robot.
pub type Stream = (Kind, RobotId);
/// A datagram that is to leave once more: for whom, and its bytes without a tag.
pub type Once = (Audience, Frame);

/// The newest datagram of a stream, kept as long as it may have to be sent again.
#[derive(Clone, Debug)]
struct Kept {
    audience: Audience,
    sequence: u32,
    plain: Frame,
    reliability: Reliability,
    left: Time,
    due: Option<Time>,
    /// How often it has been, and how often it may be sent again.
    again: u8,
    most: u8,
    /// When it was last offered to be asked for: counted in offers.
    offered: u64,
    acked: BTreeSet<HostId>,
}

/// All that may have to be sent again.
#[derive(Clone, Debug, Default)]
pub struct Again {
    kept: BTreeMap<Stream, Kept>,
    dues: BTreeSet<(Time, Stream)>,
    /// The hosts that have acknowledged anything, and when last.
    ackers: BTreeMap<HostId, Time>,
    /// How many offers there were.
    offers: u64,
}

impl Again {
    /// A newer message of this stream is about to leave. What waits of the older one goes before it or not at all.
    pub fn supersede(&mut self, now: Time, stream: Stream) -> Option<Once> {
        let kept = self.kept.get(&stream)?;
        let before = kept.reliability == Reliability::Repeat && kept.due.is_some() && kept.left < now;
        let once = before.then(|| (kept.audience, kept.plain.clone()));
        self.forget(stream);
        once
    }

    fn forget(&mut self, stream: Stream) {
        if let Some(due) = self.kept.remove(&stream).and_then(|kept| kept.due) {
            self.dues.remove(&(due, stream));
        }
    }

    /// A datagram with a message of this stream has left; `repeats` is how often receivers want it again.
    pub fn keep(
        &mut self,
        now: Time,
        stream: Stream,
        (audience, plain): Once,
        sequence: u32,
        (reliability, repeats): (Reliability, u8),
    ) {
        let (after, most) = match reliability {
            Reliability::BestEffort => return,
            Reliability::Repeat if repeats == 0 => return,
            Reliability::Repeat => (Some(REPEAT_AFTER), repeats),
            Reliability::Nack => (None, u8::MAX),
            Reliability::Ack => (Some(RETRY_AFTER), RETRIES),
        };
        let due = after.map(|after| now + after);
        let (left, again, acked, offered) = (now, 0, BTreeSet::new(), 0);
        let kept = Kept { audience, sequence, plain, reliability, left, due, again, most, offered, acked };
        self.kept.insert(stream, kept);
        self.dues.extend(due.map(|due| (due, stream)));
    }

    /// Takes what is kept of a stream to be sent once more, and plans the next time.
    fn once_more(&mut self, now: Time, stream: Stream) -> Option<Once> {
        let kept = self.kept.get_mut(&stream)?;
        if let Some(due) = kept.due.take() {
            self.dues.remove(&(due, stream));
        }
        kept.again = kept.again.saturating_add(1);
        kept.left = now;
        let once = (kept.audience, kept.plain.clone());
        match kept.reliability {
            Reliability::Repeat if kept.again >= kept.most => self.forget(stream),
            Reliability::Repeat => kept.due = Some(now + REPEAT_AFTER),
            // The last retry is waited for as well.
            Reliability::Ack => kept.due = Some(now + RETRY_AFTER * (1 << kept.again.min(RETRIES))),
            Reliability::BestEffort | Reliability::Nack => {}
        }
        self.dues.extend(self.kept.get(&stream).and_then(|kept| kept.due).map(|due| (due, stream)));
        Some(once)
    }

    /// `from` acknowledges these. One that is for all is done when everyone has who acknowledged anything of late.
    pub fn acknowledged(&mut self, now: Time, from: HostId, names: &[Name]) {
        self.ackers.insert(from, now);
        self.ackers.retain(|_, at| now.since(*at) < FRESH);
        for name in names {
            let Some(stream) = self.find(from, name, Reliability::Ack) else { continue };
            let kept = self.kept.get_mut(&stream).expect("it was found");
            kept.acked.insert(from);
            if kept.audience != Audience::All || self.ackers.keys().all(|host| kept.acked.contains(host)) {
                self.forget(stream);
            }
        }
    }

    /// The stream of the datagram that `from` names: numbers are counted to all, or to `from` alone.
    fn find(&self, from: HostId, name: &Name, reliability: Reliability) -> Option<Stream> {
        let audience = if name.direct { Audience::Host(from) } else { Audience::All };
        let named = |kept: &Kept| kept.sequence == name.sequence && kept.audience == audience;
        let found = self.kept.iter().find(|(_, kept)| kept.reliability == reliability && named(kept));
        found.map(|(stream, _)| *stream)
    }

    /// `from` asks for these again; what has been overtaken by newer state is not worth it.
    pub fn asked(&mut self, now: Time, from: HostId, names: &[Name]) -> Vec<Once> {
        let mut wanted = |name: &Name| {
            let stream = self.find(from, name, Reliability::Nack)?;
            let kept = &self.kept[&stream];
            let rested = kept.again == 0 || now.since(kept.left) >= ONCE_WITHIN;
            if rested { self.once_more(now, stream) } else { None }
        };
        names.iter().filter_map(&mut wanted).collect()
    }

    /// The numbers that receivers may ask for: of the streams that are repaired those that were offered
    /// longest ago, so that each has its turn.
    pub fn held(&mut self, audience: Audience) -> Vec<u32> {
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

    /// When anything is next due.
    pub fn due(&self) -> Option<Time> {
        self.dues.first().map(|(due, _)| *due)
    }

    /// The next that is due now; what has been sent often enough is given up.
    pub fn next(&mut self, now: Time, counts: &mut LinkCounts) -> Option<Once> {
        while let Some(&(_, stream)) = self.dues.first().filter(|(due, _)| *due <= now) {
            if self.kept[&stream].again < self.kept[&stream].most {
                return self.once_more(now, stream);
            }
            self.forget(stream);
            counts.lapsed += 1;
        }
        None
    }
}
