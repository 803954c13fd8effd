//! Transmission on a link that chooses: number, receivers and times of the transmissions of a datagram, by the
//! decision.

use super::leaving::{Choice, Pending, Said};
use super::{Pair, Way};
use crate::net::protocol::codec::{self, BLOCK_BYTES, Content, Flags, Frame, Header, add};
use crate::net::protocol::counts::LinkCounts;
use crate::net::protocol::incoming::Incoming;
use crate::net::protocol::link::LinkState;
use crate::net::protocol::outgoing::{Outbound, Outgoing};
use crate::net::protocol::router::Audience;
use crate::time::{Span, Time};

/// Time after a datagram at which its copy leaves: longer than most bursts of loss, so that three come within 20 ms.
const APART: Span = Span::from_millis(5);
/// One of so many datagrams with copies has the first copy at once, as a pair.
const PAIRED: u32 = 8;
/// Sustained budget of report entries on such a link \[bytes/s\]. Of ten hosts each is listed once a second.
const ENTRY_BYTES_PER_S: f64 = 120.0;

impl LinkState {
    /// Returns whether the link chooses how it sends, and so has to know where each host is.
    pub(crate) fn chooses(&self) -> bool {
        self.outgoing.choice.is_some()
    }

    /// Limits what the reports of a link that chooses take on the air, which on slow frames is most of all.
    pub(in crate::net::protocol) fn save_airtime(&mut self) {
        if self.chooses() {
            let (schedule, entry_bytes) = (self.incoming.schedule.clone(), self.incoming.local.entry_bytes);
            self.incoming.schedule = schedule.with_budget(ENTRY_BYTES_PER_S, entry_bytes);
        }
    }
}

impl Outgoing {
    /// Takes note of a datagram that is a duplicate. Returns whether its time of arrival tells something, so that the
    /// datagram has an effect.
    pub(in crate::net::protocol) fn completes(&mut self, now: Time, header: &Header, pair: Option<Pair>) -> bool {
        let Some(choice) = self.choice.as_mut().filter(|choice| choice.pairs.completes(now, header)) else {
            return false;
        };
        choice.pairs.note(now, header, pair);
        true
    }

    /// Takes note of a datagram that is new.
    pub(in crate::net::protocol) fn note_arrival(&mut self, now: Time, header: &Header, pair: Option<Pair>) {
        if let Some(choice) = &mut self.choice {
            choice.pairs.note(now, header, pair);
        }
    }

    /// Sends the datagram `plain` with a message: at once, or as the link has decided. A copy is `bare`, the message
    /// alone, unless it ends a pair. Appends what is due to `out`.
    pub(in crate::net::protocol) fn leave(
        &mut self,
        now: Time,
        (audience, message): (Audience, Said),
        (plain, bare): (&Frame, &Frame),
        incoming: &Incoming,
        (counts, out): (&mut LinkCounts, &mut Vec<Outbound>),
    ) {
        let Some(mut choice) = self.choice.take() else {
            return out.push((audience, self.seal(plain, audience, 0)));
        };
        let reports = self.report_sent == Some(now);
        // Whoever has not been accepted yet is no neighbour, and needs the report.
        let hidden = choice.neighbours.is_empty() || reports && !incoming.candidates.waiting(now).is_empty();
        let way = if hidden { Way::Multicast(8) } else { choice.decision().way };
        if !message.is_part {
            choice.supersede(message.stream);
        }
        let due = now + choice.offset(message);
        match way {
            Way::Multicast(_) => self.leave_for_all(due, (message, way), (plain, bare), &mut choice),
            Way::Unicast => self.leave_for_each(due, message, plain, &mut choice),
        }
        self.choice = Some(choice);
        self.leave_pending(now, counts, out);
    }

    /// Marks a datagram as a pair, if there is room.
    fn marked(&self, plain: &Frame, pair: Pair) -> Frame {
        let mut bytes = plain.to_vec();
        if bytes.len() + BLOCK_BYTES + 3 <= self.room {
            add(&mut bytes, Content::Pair, |bytes| pair.write(0, bytes));
        }
        bytes.into()
    }

    fn leave_for_all(
        &self,
        due: Time,
        (message, way): (Said, Way),
        (plain, bare): (&Frame, &Frame),
        choice: &mut Choice,
    ) {
        // Parts of large messages are many, and asked for if they are missing.
        let mut count = if message.is_part { 1 } else { choice.transmissions(way) };
        let mut paired = false;
        if count > 1 {
            choice.copied = choice.copied.wrapping_add(1);
            paired = !choice.pinned && choice.copied.is_multiple_of(PAIRED);
        } else if message.is_state() && choice.is_due(due, false) {
            (count, paired) = (2, true);
        }
        if paired {
            choice.number = choice.number.wrapping_add(1);
        }
        let marked = paired.then(|| self.marked(plain, Pair { unicast: false, number: choice.number }));
        let plain = marked.as_ref().unwrap_or(plain);
        let audience = Audience::All;
        let first = self.seal(plain, audience, 0);
        let stream = message.stream;
        let pending = |frame: &Frame, is_copy| Pending { stream, audience, frame: frame.clone(), is_copy };
        choice.put(due, pending(&first, false));
        let copy = |plain: &Frame| self.seal(plain, audience, Flags::COPY);
        if paired {
            choice.put(due, pending(&copy(plain), true));
        }
        let apart = APART.max(choice.round());
        let later = 1 + u32::from(paired)..count;
        if !later.is_empty() {
            let copy = copy(bare);
            later.for_each(|number| {
                let after = apart * u64::from(number - u32::from(paired));
                choice.put(due + after, pending(&copy, true));
            });
        }
    }

    fn leave_for_each(&self, due: Time, message: Said, plain: &Frame, choice: &mut Choice) {
        let stream = message.stream;
        let paired = (message.is_state() && choice.is_due(due, true)).then(|| choice.next_neighbour().0);
        let marked = paired.map(|_| self.marked(plain, Pair { unicast: true, number: choice.number }));
        let plain = marked.as_ref().unwrap_or(plain);
        let first = self.seal(plain, Audience::All, 0);
        for (index, host) in choice.neighbours.clone().into_iter().enumerate() {
            let audience = Audience::Host(host);
            choice.put(due, Pending { stream, audience, frame: first.clone(), is_copy: false });
            if paired == Some(index) {
                let frame = self.seal(plain, Audience::All, Flags::COPY);
                choice.put(due, Pending { stream, audience, frame, is_copy: true });
            }
        }
    }

    /// Sends a pair by the way that data does not take, if one is due, after a message of this stream that took
    /// `length` bytes.
    pub(in crate::net::protocol) fn probe(
        &mut self,
        now: Time,
        (message, length): (Said, usize),
        counts: &mut LinkCounts,
        out: &mut Vec<Outbound>,
    ) {
        let Some(mut choice) = self.choice.take() else { return };
        let unicast = choice.decision().way != Way::Unicast;
        if message.is_state() && choice.is_due(now, unicast) {
            let stream = message.stream;
            let audience = if unicast { Audience::Host(choice.next_neighbour().1) } else { Audience::All };
            choice.number = choice.number.wrapping_add(u16::from(!unicast));
            let mut bytes = codec::start(&self.header(audience, 0));
            let pair = Pair { unicast, number: choice.number };
            let body = length.min(self.room).saturating_sub(bytes.len() + BLOCK_BYTES);
            add(&mut bytes, Content::Pair, |bytes| pair.write(body, bytes));
            let plain: Frame = bytes.into();
            let due = now + choice.offset(message);
            for flags in [0, Flags::COPY] {
                let frame = self.seal(&plain, audience, flags);
                choice.put(due, Pending { stream, audience, frame, is_copy: flags > 0 });
            }
            self.count(audience);
        }
        self.choice = Some(choice);
        self.leave_pending(now, counts, out);
    }

    /// Sends what is due at `now` of what waits: appends it to `out`.
    pub(in crate::net::protocol) fn leave_pending(
        &mut self,
        now: Time,
        counts: &mut LinkCounts,
        out: &mut Vec<Outbound>,
    ) {
        let Some(choice) = &mut self.choice else { return };
        while let Some(entry) = choice.pending.first_entry().filter(|entry| entry.key().0 <= now) {
            let Pending { audience, frame, is_copy, .. } = entry.remove();
            counts.copies += u64::from(is_copy);
            out.push((audience, frame));
        }
    }
}
