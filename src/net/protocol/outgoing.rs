//! Transmission on a link: sequence numbers, piggybacking, reports and retransmission. Uses `incoming` for all it needs
//! of other hosts.

use std::collections::BTreeMap;

use super::acks::Acks;
use super::bucket::{Bucket, Rate};
use super::choice::{Choice, Said};
use super::codec::{self, BLOCK_BYTES, Content, EncodeError, FLAGS_AT, Flags, Frame, HEADER_BYTES, Header};
use super::codec::{MAX_FRAME_BYTES, MAX_PLAIN_BYTES, add};
use super::counts::LinkCounts;
use super::incoming::{Incoming, Urgency};
use super::key::Key;
use super::relay::Block;
use super::reliability::{Heartbeats, Piggyback, Reliability, Reports, Setup};
use super::report::write_held;
use super::report_schedule::Occasion;
use super::retransmit::{Retransmitter, Untagged};
use super::router::Audience;
use super::signing::Signing;
use super::soft::{Roomy, Soft};
use crate::messages::ids::{HostId, LinkId};
use crate::messages::wire::{Kind, Wire};
use crate::time::{Span, Time};

/// Longest time between two link reports of a host on a link, in a small team or while another host waits for one; then
/// the next one is sent, in a datagram of its own if need be. Otherwise `pace` says how long it is.
pub const REPORT_PERIOD: Span = Span::from_millis(250);
/// Age of the last report from which on a report that another host waits for may be piggybacked.
const PENDING_PIGGYBACK_AGE: Span = Span::from_millis(10);
/// Smallest interval between urgent reports, so that a flood of recordings does not cause a flood of answers.
const URGENT_PERIOD: Span = Span::from_millis(20);
/// Rate limit of urgent reports. Ten operators that act at the same time need about ten of them. Sequences of
/// recordings cause no more urgent reports than there are regular ones.
const URGENT_RATE: Rate = Rate { per_s: 4.0, burst: 25.0 };
/// Interval of urgent reports of an operator, which a whole team has to accept soon.
const EAGER_PERIOD: Span = Span::from_millis(5);

/// Receivers of a datagram, and the datagram with its authentication tag, as given to a transport.
pub type Outbound = (Audience, Frame);

/// State of the transmission on one link: sequence numbers, waiting soft state, link reports and datagrams to
/// retransmit.
#[derive(Clone, Debug)]
pub struct Outgoing {
    me: Header,
    link: LinkId,
    pub(super) key: Option<Key>,
    /// Largest datagram without its tags \[bytes\].
    pub(super) room: usize,
    pub(super) setup: Setup,
    to_all: u32,
    direct: BTreeMap<HostId, u32>,
    pub(super) retransmitter: Retransmitter,
    soft: Soft,
    /// For each set of receivers, the time at which data was last sent to it.
    data_sent: BTreeMap<Audience, Time>,
    pub(super) report_sent: Option<Time>,
    pub(super) report_due: Option<Time>,
    /// Whether another host waits for a report.
    report_pending: bool,
    /// Whether the next report is due in a datagram of its own, even if others are appended to data before.
    report_alone: bool,
    /// Time at which the pending urgent report is due, and time of the last one.
    urgent_due: Option<Time>,
    urgent_sent: Option<Time>,
    urgent_bucket: Bucket,
    /// Whether report entries contain the number of the next unicast datagram to their host.
    numbered: bool,
    pub(super) acks: Acks,
    signing: Signing,
    /// Entries for the next datagram to all hosts.
    pub(super) carried: Block,
    /// State of a link that chooses how data for all hosts leaves.
    pub(super) choice: Option<Box<Choice>>,
}

impl Outgoing {
    /// Returns the state before any datagram. `me` is the header from which those of all datagrams are made, and
    /// `first_report` the time until the first link report.
    pub fn new(me: Header, link: LinkId, key: Option<Key>, setup: Setup, first_report: Span) -> Outgoing {
        let report_due = (setup.reports == Reports::On).then_some(Time::ZERO + first_report);
        let numbered = key.is_some() && setup.is_addressed();
        let room = key.as_ref().map_or(MAX_PLAIN_BYTES, Key::room);
        let choice = Choice::new(setup.choosing, setup.spread, me.sender);
        Outgoing {
            me,
            link,
            key,
            room,
            setup,
            to_all: 0,
            direct: BTreeMap::new(),
            retransmitter: Retransmitter::default(),
            soft: Soft::default(),
            data_sent: BTreeMap::new(),
            report_sent: None,
            report_due,
            report_pending: false,
            report_alone: false,
            urgent_due: None,
            urgent_sent: None,
            urgent_bucket: Bucket::full(Time::ZERO, &URGENT_RATE),
            numbered,
            acks: Acks::default(),
            signing: Signing::default(),
            carried: Block::default(),
            choice,
        }
    }

    /// Sends a message to the hosts in `audience`: at once, or with the next datagram if it is soft state. Appends the
    /// datagrams that are due to `out`. Returns the message as a datagram without tag; fails if it is out of range or
    /// too long.
    pub fn send(
        &mut self,
        now: Time,
        audience: Audience,
        message: &Wire,
        incoming: &mut Incoming,
        counts: &mut LinkCounts,
        out: &mut Vec<Outbound>,
    ) -> Result<Frame, EncodeError> {
        let audience = if self.setup.piggyback == Piggyback::Any { Audience::All } else { audience };
        let (kind, stream, said) = (message.kind(), (message.kind(), message.robot()), Said::of(message));
        let soft = kind.is_soft();
        let reliability = self.reliability_of(message);
        let flags = if reliability == Reliability::Ack { Flags::ACK } else { 0 };
        let encoded = codec::encode(&self.header(audience, flags), message)?;
        let signatures = self.key.as_ref().and_then(Key::signatures).filter(|_| kind.is_signed());
        let signed = signatures.and_then(|by| self.signing.sign(by, (&self.me, self.link), stream, &encoded));
        let frame = signed.unwrap_or_else(|| Frame::clone(&encoded));
        if frame.len() > self.room {
            return Err(EncodeError::TooLong(kind, frame.len(), self.room));
        }
        if soft && self.setup.piggyback != Piggyback::Never {
            self.soft.put(now, stream, (audience, frame.clone()), self.data_sent.get(&audience).copied());
            self.send_soft(now, incoming, counts, out);
            return Ok(encoded);
        }
        if self.choice.as_mut().is_some_and(|choice| choice.leaves_out(now, said, incoming)) {
            return Ok(encoded);
        }
        // A pending repeat of the same stream is sent before the new message, since after it the repeat would be stale.
        if let Some(datagram) = self.retransmitter.supersede(now, stream) {
            self.send_copy(datagram, counts, out);
        }
        let held = if reliability == Reliability::Nack { self.retransmitter.held(audience) } else { Vec::new() };
        let plain = self.with_piggybacked(now, audience, frame.clone(), &held, incoming);
        let length = plain.len();
        self.leave(now, (audience, said), (&plain, &frame), incoming, (counts, out));
        let repeats = if reliability == Reliability::Repeat { incoming.repeats(now, audience) } else { 0 };
        let sequence = self.header(audience, 0).sequence;
        self.retransmitter.keep(now, stream, (audience, plain), sequence, (reliability, repeats));
        self.count(audience);
        if soft {
            counts.soft += 1;
            self.soft.forget(stream);
            if self.is_sent_twice(now, audience, incoming) {
                self.soft.repeat(now, stream, (audience, &frame));
            }
        } else {
            counts.sent += 1;
            self.data_sent.insert(audience, now);
            self.probe(now, (said, length), counts, out);
        }
        Ok(encoded)
    }

    /// Whether a heartbeat that leaves at `now` is to be retransmitted.
    fn is_sent_twice(&self, now: Time, audience: Audience, incoming: &Incoming) -> bool {
        match self.setup.heartbeats {
            Heartbeats::Once => false,
            Heartbeats::TwiceWhileLossy => incoming.repeats(now, audience) > 0,
            Heartbeats::Twice => true,
        }
    }

    pub(super) fn header(&self, audience: Audience, flags: u8) -> Header {
        match audience {
            Audience::All => Header { flags: Flags(flags), sequence: self.to_all, ..self.me },
            Audience::Host(host) => {
                let sequence = self.direct.get(&host).copied().unwrap_or(0);
                Header { flags: Flags(flags | Flags::DIRECT), sequence, ..self.me }
            }
        }
    }

    pub(super) fn count(&mut self, audience: Audience) {
        let next = match audience {
            Audience::All => &mut self.to_all,
            Audience::Host(host) => self.direct.entry(host).or_default(),
        };
        *next = next.wrapping_add(1);
    }

    /// Returns the final datagram: with additional flags, and with a tag if there is a key.
    pub(super) fn seal(&self, plain: &Frame, audience: Audience, flags: u8) -> Frame {
        if self.key.is_none() && flags == 0 {
            return plain.clone();
        }
        let mut bytes = Vec::with_capacity(plain.len() + MAX_FRAME_BYTES - self.room);
        bytes.extend_from_slice(plain);
        bytes[FLAGS_AT] |= flags;
        if let Some(key) = &self.key {
            let to = if let Audience::Host(host) = audience { Some(host) } else { None };
            key.seal(&mut bytes, self.link, to);
        }
        bytes.into()
    }

    /// Returns the datagram with the pending blocks (soft state, report, acknowledgements) that fit appended.
    fn with_piggybacked(
        &mut self,
        now: Time,
        audience: Audience,
        frame: Frame,
        held: &[u32],
        incoming: &mut Incoming,
    ) -> Frame {
        let all = audience == Audience::All;
        let acks = self.setup.piggyback == Piggyback::Any && !self.acks.is_empty();
        let soft = self.soft.has_for(now, audience);
        let report = all && self.may_piggyback_report(now);
        let carries = all && !self.carried.is_empty();
        if !(soft || report || acks || carries) && held.is_empty() {
            return frame;
        }
        let mut bytes = frame.to_vec();
        if !held.is_empty() && bytes.len() + BLOCK_BYTES + 4 * held.len() <= self.room {
            add(&mut bytes, Content::Held, |bytes| write_held(held, bytes));
        }
        self.piggyback(now, audience, &mut bytes, incoming);
        if all {
            self.carried.add_to(&mut bytes, self.room);
        }
        bytes.into()
    }

    /// Appends all pending blocks that have the same receivers and fit into the datagram.
    pub(super) fn piggyback(&mut self, now: Time, audience: Audience, bytes: &mut Vec<u8>, incoming: &mut Incoming) {
        let any = self.setup.piggyback == Piggyback::Any;
        // The loss that others report is only looked at where it matters: that takes a look at all of them.
        let twice = self.soft.has_heartbeat(audience) && self.is_sent_twice(now, audience, incoming);
        self.soft.add_to(now, audience, Roomy { bytes, most: self.room }, twice);
        if any {
            self.acks.add_to(bytes, self.room);
        }
        if audience == Audience::All && self.may_piggyback_report(now) {
            let (urgent, regular) = (self.urgent_due, self.report_due);
            self.report(now, bytes, incoming, Occasion::Regular);
            // On a link with unicast, candidates receive only separate reports and no data, so these reports stay due.
            self.urgent_due = urgent.filter(|_| !any);
            if self.report_alone {
                self.report_due = regular;
            }
        }
    }

    fn may_piggyback_report(&self, now: Time) -> bool {
        let age = if self.report_pending {
            PENDING_PIGGYBACK_AGE.min(self.setup.report_piggyback_age)
        } else {
            self.setup.report_piggyback_age
        };
        self.setup.reports == Reports::On
            && self.setup.piggyback != Piggyback::Never
            && self.report_sent.is_none_or(|sent| now.since(sent) >= age)
    }

    /// Appends a report if it fits. An urgent one is only appended if it lists a host. Returns whether it was appended.
    fn report(&mut self, now: Time, bytes: &mut Vec<u8>, incoming: &mut Incoming, occasion: Occasion) -> bool {
        let room = self.room.saturating_sub(bytes.len() + BLOCK_BYTES);
        let Some(mut report) = incoming.report(now, room, occasion) else { return false };
        if occasion == Occasion::Urgent && report.heard.is_empty() {
            return false;
        }
        for entry in report.heard.iter_mut().filter(|_| self.numbered) {
            entry.direct = Some(self.direct.get(&entry.host).copied().unwrap_or(0));
        }
        add(bytes, report.content(), |bytes| report.write(bytes));
        self.urgent_due = None;
        if occasion == Occasion::Urgent {
            self.urgent_sent = Some(now);
            self.urgent_bucket.take(now, &URGENT_RATE);
            return true;
        }
        self.report_pending = false;
        self.plan_report(now, incoming);
        let held = self.retransmitter.held(Audience::All);
        if !held.is_empty() && bytes.len() + BLOCK_BYTES + 4 * held.len() <= self.room {
            add(bytes, Content::Held, |bytes| write_held(&held, bytes));
        }
        true
    }

    /// Schedules a link report that another host needs, to prove its liveness or to accept this host. `urgency` says
    /// how soon.
    pub fn request_report(&mut self, now: Time, urgency: Urgency) {
        if urgency == Urgency::Regular || self.setup.reports == Reports::Off {
            return;
        }
        self.report_pending = true;
        self.hasten_report();
        self.report_alone |= urgency == Urgency::OwnDatagram && self.setup.is_addressed();
        let eager = self.setup.report_piggyback_age == Span::ZERO;
        if eager || urgency == Urgency::Immediate {
            let period = if eager { EAGER_PERIOD } else { URGENT_PERIOD };
            let due = self.urgent_sent.map_or(now, |sent| now.max(sent + period));
            self.urgent_due = Some(self.urgent_due.map_or(due, |before| before.min(due)));
        }
    }

    fn send_soft(&mut self, now: Time, incoming: &mut Incoming, counts: &mut LinkCounts, out: &mut Vec<Outbound>) {
        while let Some((first, audience, frame)) = self.soft.next(now) {
            if let Some(stream) = first.filter(|(kind, _)| *kind == Kind::Heartbeat)
                && self.is_sent_twice(now, audience, incoming)
            {
                self.soft.repeat(now, stream, (audience, &frame));
            }
            let mut bytes = codec::start(&self.header(audience, 0));
            bytes.extend_from_slice(&frame[HEADER_BYTES..]);
            self.piggyback(now, audience, &mut bytes, incoming);
            self.send_alone(audience, bytes, counts, out);
        }
    }

    pub(super) fn send_alone(
        &mut self,
        audience: Audience,
        bytes: Vec<u8>,
        counts: &mut LinkCounts,
        out: &mut Vec<Outbound>,
    ) {
        out.push((audience, self.seal(&bytes.into(), audience, 0)));
        self.count(audience);
        counts.soft += 1;
    }

    pub(super) fn send_copy(&mut self, (audience, plain): Untagged, counts: &mut LinkCounts, out: &mut Vec<Outbound>) {
        out.push((audience, self.seal(&plain, audience, Flags::COPY)));
        counts.copies += 1;
    }

    /// Returns the time at which `wake` has to be called next; `None` if nothing is due.
    pub fn due(&self) -> Option<Time> {
        let choice = self.choice.as_ref().and_then(|choice| choice.due());
        let dues =
            [choice, self.retransmitter.due(), self.soft.due(), self.acks.due(), self.report_due, self.urgent_due];
        let first = dues.map(|due| due.unwrap_or(Time::MAX)).into_iter().fold(Time::MAX, Time::min);
        Some(first).filter(|due| *due < Time::MAX)
    }

    /// Sends what is due at `now` (retransmissions, soft state, acknowledgements, link reports): appends the datagrams
    /// to `out`.
    pub fn wake(&mut self, now: Time, incoming: &mut Incoming, counts: &mut LinkCounts, out: &mut Vec<Outbound>) {
        while let Some(datagram) = self.retransmitter.next(now, counts) {
            self.send_copy(datagram, counts, out);
        }
        self.leave_pending(now, counts, out);
        self.send_soft(now, incoming, counts, out);
        if self.acks.due().is_some_and(|due| due <= now) {
            self.send_acks(counts, out);
        }
        // A regular report includes what a due urgent one would list.
        if self.report_due.is_some_and(|due| due <= now) {
            self.send_report(now, Occasion::Regular, incoming, counts, out);
        }
        if self.urgent_due.is_some_and(|due| due <= now) {
            self.urgent_due = None;
            let eager = self.setup.report_piggyback_age == Span::ZERO;
            if eager || self.urgent_bucket.left(now, &URGENT_RATE) > 0 {
                self.send_report(now, Occasion::Urgent, incoming, counts, out);
            }
        }
    }

    /// Sends a report in a datagram of its own, except an urgent one that would list no host.
    fn send_report(
        &mut self,
        now: Time,
        occasion: Occasion,
        incoming: &mut Incoming,
        counts: &mut LinkCounts,
        out: &mut Vec<Outbound>,
    ) {
        let mut bytes = codec::start(&self.header(Audience::All, 0));
        if self.report(now, &mut bytes, incoming, occasion) {
            self.report_alone = false;
            self.send_alone(Audience::All, bytes, counts, out);
        }
    }
}
