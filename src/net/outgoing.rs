//! What leaves on a link: sequence numbers, what rides on what, what is sent again and when. Knows no receiver but
//! by what `incoming` says of it.

use std::collections::BTreeMap;

use super::again::{Again, Once, Stream};
use super::codec::{self, BLOCK_BYTES, Content, EncodeError, FLAGS_AT, Flags, Frame, HEADER_BYTES, Header};
use super::codec::{MAX_PLAIN_BYTES, add};
use super::counts::LinkCounts;
use super::incoming::Incoming;
use super::key::Key;
use super::reliability::{Reliability, Reports, Ride, Setup};
use super::report::{MAX_NAMES, Name, write_held, write_names};
use super::router::Audience;
use crate::messages::ids::{HostId, LinkId};
use crate::messages::wire::{Kind, Wire};
use crate::time::{Span, Time};

/// How long soft state waits for data to ride on, where data has left within this time: a robot that says something
/// twelve times a second still takes all of it along. What may not wait is no soft state: a `Stop` leaves at once.
pub const HOLD: Span = Span::from_millis(100);
/// Soft state leaves by itself no more often than this; half of it where there are modes among it.
pub const SOFT_PERIOD: Span = Span::from_millis(200);
/// A report rides as soon as the last one is this old.
pub const REPORT_RIDES: Span = Span::from_millis(150);
/// A report leaves by itself when the last one is this old.
pub const REPORT_PERIOD: Span = Span::from_millis(250);
/// Where no data flows, whoever has to prove itself is answered after half to one and a half of this.
const ANSWER: Span = Span::from_millis(100);
/// Without data for so long none is expected.
const QUIET: Span = Span::from_millis(500);
/// How long acknowledgements wait for each other.
const ACK_WITHIN: Span = Span::from_millis(2);

/// A datagram on its way to a transport.
pub type Leaving = (Audience, Frame);

/// Everything that leaves on one link.
#[derive(Clone, Debug)]
pub struct Outgoing {
    me: Header,
    link: LinkId,
    key: Option<Key>,
    setup: Setup,
    to_all: u32,
    direct: BTreeMap<HostId, u32>,
    again: Again,
    /// Soft state that waits: the newest of each stream, whom it is for, its block.
    soft: BTreeMap<Stream, (Audience, Frame)>,
    soft_due: Option<Time>,
    /// Since when any waits.
    soft_since: Option<Time>,
    /// When that was said which last left by itself: periods count from there, so that waiting does not add up.
    soft_said: Option<Time>,
    data_left: Option<Time>,
    report_left: Option<Time>,
    report_due: Option<Time>,
    /// A host waits for a report.
    prompted: bool,
    acks: BTreeMap<HostId, Vec<Name>>,
    acks_due: Option<Time>,
}

impl Outgoing {
    /// Nothing yet. `first_report` is when the first report leaves at the latest.
    pub fn new(me: Header, link: LinkId, key: Option<Key>, setup: Setup, first_report: Span) -> Outgoing {
        let report_due = (setup.reports == Reports::On).then_some(Time::ZERO + first_report);
        Outgoing {
            me,
            link,
            key,
            setup,
            to_all: 0,
            direct: BTreeMap::new(),
            again: Again::default(),
            soft: BTreeMap::new(),
            soft_due: None,
            soft_since: None,
            soft_said: None,
            data_left: None,
            report_left: None,
            report_due,
            prompted: false,
            acks: BTreeMap::new(),
            acks_due: None,
        }
    }

    /// A message leaves, at once or, if it is soft state, with the next datagram. Gives what was encoded.
    pub fn say(
        &mut self,
        now: Time,
        audience: Audience,
        message: &Wire,
        incoming: &mut Incoming,
        counts: &mut LinkCounts,
        out: &mut Vec<Leaving>,
    ) -> Result<Frame, EncodeError> {
        let audience = if self.setup.ride == Ride::Any { Audience::All } else { audience };
        let (kind, stream) = (message.kind(), (message.kind(), message.robot()));
        let soft = matches!(kind, Kind::Heartbeat | Kind::Mode);
        let reliability = self.setup.of(kind);
        let flags = if reliability == Reliability::Ack { Flags::ACK } else { 0 };
        let frame = codec::encode(&self.header(audience, flags), message)?;
        if soft && self.setup.ride != Ride::Never {
            self.soft.insert(stream, (audience, frame.clone()));
            self.plan_soft(now);
            self.leave_soft(now, incoming, counts, out);
            return Ok(frame);
        }
        // What waits of the same stream goes before it or not at all: never after.
        if let Some(once) = self.again.supersede(now, stream) {
            self.leave_again(once, counts, out);
        }
        let held = if reliability == Reliability::Nack { self.again.held(audience) } else { Vec::new() };
        let plain = self.with_riders(now, audience, frame.clone(), &held, incoming);
        out.push((audience, self.seal(&plain, audience, 0)));
        let repeats = if reliability == Reliability::Repeat { incoming.repeats(now, audience) } else { 0 };
        let sequence = self.header(audience, 0).sequence;
        self.again.keep(now, stream, (audience, plain), sequence, (reliability, repeats));
        self.count(audience);
        if soft {
            counts.soft += 1;
        } else {
            counts.sent += 1;
            self.data_left = Some(now);
        }
        Ok(frame)
    }

    fn header(&self, audience: Audience, flags: u8) -> Header {
        match audience {
            Audience::All => Header { flags: Flags(flags), sequence: self.to_all, ..self.me },
            Audience::Host(host) => {
                let sequence = self.direct.get(&host).copied().unwrap_or(0);
                Header { flags: Flags(flags | Flags::DIRECT), sequence, ..self.me }
            }
        }
    }

    fn count(&mut self, audience: Audience) {
        let next = match audience {
            Audience::All => &mut self.to_all,
            Audience::Host(host) => self.direct.entry(host).or_default(),
        };
        *next = next.wrapping_add(1);
    }

    /// The datagram as it leaves: with more flags, and a tag if there is a key.
    fn seal(&self, plain: &Frame, audience: Audience, flags: u8) -> Frame {
        if self.key.is_none() && flags == 0 {
            return plain.clone();
        }
        let mut bytes = plain.to_vec();
        bytes[FLAGS_AT] |= flags;
        if let Some(key) = &self.key {
            let to = if let Audience::Host(host) = audience { Some(host) } else { None };
            key.seal(&mut bytes, self.link, to);
        }
        bytes.into()
    }

    /// The datagram with what may ride on it.
    fn with_riders(
        &mut self,
        now: Time,
        audience: Audience,
        frame: Frame,
        held: &[u32],
        incoming: &mut Incoming,
    ) -> Frame {
        let all = audience == Audience::All;
        let acks = self.setup.ride == Ride::Any && !self.acks.is_empty();
        if self.soft.is_empty() && !(all && self.report_rides(now)) && !acks && held.is_empty() {
            return frame;
        }
        let mut bytes = frame.to_vec();
        if !held.is_empty() && bytes.len() + BLOCK_BYTES + 4 * held.len() <= MAX_PLAIN_BYTES {
            add(&mut bytes, Content::Held, |bytes| write_held(held, bytes));
        }
        self.board(now, audience, &mut bytes, incoming);
        bytes.into()
    }

    /// Puts all that waits, may ride and finds room on a datagram.
    fn board(&mut self, now: Time, audience: Audience, bytes: &mut Vec<u8>, incoming: &mut Incoming) {
        let any = self.setup.ride == Ride::Any;
        self.soft.retain(|_, (to, frame)| {
            let block = &frame[HEADER_BYTES..];
            let rides = *to == audience && bytes.len() + block.len() <= MAX_PLAIN_BYTES;
            if rides {
                bytes.extend_from_slice(block);
            }
            !rides
        });
        if self.soft.is_empty() {
            (self.soft_due, self.soft_since) = (None, None);
        }
        if any && !self.acks.is_empty() {
            for names in std::mem::take(&mut self.acks).into_values() {
                add(bytes, Content::Ack, |bytes| write_names(&names, bytes));
            }
            self.acks_due = None;
        }
        if audience == Audience::All && self.report_rides(now) {
            self.report(now, bytes, incoming);
        }
    }

    fn report_rides(&self, now: Time) -> bool {
        self.setup.reports == Reports::On
            && self.setup.ride != Ride::Never
            && self.report_left.is_none_or(|left| self.prompted || now.since(left) >= REPORT_RIDES)
    }

    fn report(&mut self, now: Time, bytes: &mut Vec<u8>, incoming: &mut Incoming) {
        let room = MAX_PLAIN_BYTES.saturating_sub(bytes.len() + BLOCK_BYTES);
        let Some(mut report) = incoming.report(now, room) else { return };
        for entry in &mut report.heard {
            entry.direct = self.direct.get(&entry.host).copied().unwrap_or(0);
        }
        add(bytes, Content::Report, |bytes| report.write(bytes));
        let held = self.again.held(Audience::All);
        if !held.is_empty() && bytes.len() + BLOCK_BYTES + 4 * held.len() <= MAX_PLAIN_BYTES {
            add(bytes, Content::Held, |bytes| write_held(&held, bytes));
        }
        (self.report_left, self.report_due) = (Some(now), Some(now + REPORT_PERIOD));
        self.prompted = false;
    }

    /// A sender has to prove itself and needs our stamp for it.
    pub fn prompt(&mut self, now: Time, share: f64) {
        if self.prompted || self.setup.reports == Reports::Off {
            return;
        }
        self.prompted = true;
        // Whatever leaves soon anyway takes the report along, and nobody is told twice within a period.
        let quiet = |left: Option<Time>| left.is_none_or(|left| now.since(left) > QUIET);
        if quiet(self.data_left) && quiet(self.soft_said) {
            // Before the first report of all, that one answers everyone.
            let Some(left) = self.report_left else { return };
            let due = (now + Span::from_secs(ANSWER.as_secs() * (0.5 + share))).max(left + REPORT_PERIOD);
            self.report_due = self.report_due.map(|before| before.min(due));
        }
    }

    fn plan_soft(&mut self, now: Time) {
        let modes = self.soft.keys().any(|(kind, _)| *kind == Kind::Mode);
        let period = if modes { Span::from_nanos(SOFT_PERIOD.as_nanos() / 2) } else { SOFT_PERIOD };
        let flows = self.data_left.is_some_and(|left| now.since(left) < HOLD);
        let wait = if flows { now + HOLD } else { now };
        let due = self.soft_said.map_or(wait, |left| wait.max(left + period));
        self.soft_due = Some(self.soft_due.map_or(due, |before| before.min(due)));
        self.soft_since = self.soft_since.or(Some(now));
    }

    fn leave_soft(&mut self, now: Time, incoming: &mut Incoming, counts: &mut LinkCounts, out: &mut Vec<Leaving>) {
        while self.soft_due.is_some_and(|due| due <= now) {
            let Some((&stream, (audience, frame))) = self.soft.first_key_value() else {
                (self.soft_due, self.soft_since) = (None, None);
                return;
            };
            let (audience, block) = (*audience, frame[HEADER_BYTES..].to_vec());
            self.soft_said = self.soft_since.or(Some(now));
            self.soft.remove(&stream);
            let mut bytes = codec::start(&self.header(audience, 0));
            bytes.extend_from_slice(&block);
            self.board(now, audience, &mut bytes, incoming);
            self.leave_alone(audience, bytes, counts, out);
            if self.soft.is_empty() {
                (self.soft_due, self.soft_since) = (None, None);
            }
        }
    }

    fn leave_alone(&mut self, audience: Audience, bytes: Vec<u8>, counts: &mut LinkCounts, out: &mut Vec<Leaving>) {
        out.push((audience, self.seal(&bytes.into(), audience, 0)));
        self.count(audience);
        counts.soft += 1;
    }

    fn leave_again(&mut self, (audience, plain): Once, counts: &mut LinkCounts, out: &mut Vec<Leaving>) {
        out.push((audience, self.seal(&plain, audience, Flags::COPY)));
        counts.copies += 1;
    }

    /// A datagram that wants it is to be acknowledged.
    pub fn acknowledge(&mut self, now: Time, name: Name) {
        let names = self.acks.entry(name.host).or_default();
        if names.len() < MAX_NAMES {
            names.push(name);
        }
        self.acks_due = self.acks_due.or(Some(now + ACK_WITHIN));
    }

    /// `from` acknowledges these.
    pub fn acknowledged(&mut self, now: Time, from: HostId, names: &[Name]) {
        self.again.acknowledged(now, from, names);
    }

    /// Somebody asks for these again.
    pub fn asked(&mut self, now: Time, names: &[Name], counts: &mut LinkCounts, out: &mut Vec<Leaving>) {
        for once in self.again.asked(now, names) {
            self.leave_again(once, counts, out);
        }
    }

    /// Asks for datagrams that are missing.
    pub fn ask(&mut self, names: &[Name], counts: &mut LinkCounts, out: &mut Vec<Leaving>) {
        let mut bytes = codec::start(&self.header(Audience::All, 0));
        add(&mut bytes, Content::Nack, |bytes| write_names(names, bytes));
        self.leave_alone(Audience::All, bytes, counts, out);
    }

    /// When anything is next due.
    pub fn due(&self) -> Option<Time> {
        [self.again.due(), self.soft_due, self.report_due, self.acks_due].into_iter().flatten().min()
    }

    /// Does what is due.
    pub fn wake(&mut self, now: Time, incoming: &mut Incoming, counts: &mut LinkCounts, out: &mut Vec<Leaving>) {
        while let Some(once) = self.again.next(now, counts) {
            self.leave_again(once, counts, out);
        }
        self.leave_soft(now, incoming, counts, out);
        if self.acks_due.is_some_and(|due| due <= now) {
            self.acks_due = None;
            for (host, names) in std::mem::take(&mut self.acks) {
                let audience = if self.setup.ride == Ride::Any { Audience::All } else { Audience::Host(host) };
                let mut bytes = codec::start(&self.header(audience, 0));
                add(&mut bytes, Content::Ack, |bytes| write_names(&names, bytes));
                self.leave_alone(audience, bytes, counts, out);
            }
        }
        if self.report_due.is_some_and(|due| due <= now) {
            let mut bytes = codec::start(&self.header(Audience::All, 0));
            self.report(now, &mut bytes, incoming);
            self.leave_alone(Audience::All, bytes, counts, out);
        }
    }
}
