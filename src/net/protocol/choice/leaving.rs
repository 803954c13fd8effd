//! State of a link that chooses: what it has measured and decided, and what waits to leave.

use std::collections::BTreeMap;

use super::pairs::Pairs;
use super::{Chooser, Choosing, Decision, Measured, Way};
use crate::messages::ids::HostId;
use crate::messages::wire::{Kind, Wire};
use crate::net::protocol::codec::Frame;
use crate::net::protocol::incoming::Incoming;
use crate::net::protocol::retransmit::StreamId;
use crate::net::protocol::router::Audience;
use crate::net::protocol::window::LOSS_SPAN;
use crate::time::{Span, Time};

/// Interval at which a link decides anew.
const DECIDES: Span = Span::from_millis(500);
/// Time without a datagram after which a host counts no more.
const HEARD: Span = Span::from_millis(2000);
/// Time after a change to multicast until which reports are about unicast, too.
const MIXED: Span = Span::from_millis(4000);
/// Largest share of the air that the pairs of all hosts take, by multicast and by unicast.
const SHARES: [f64; 2] = [0.0015, 0.0007];
/// Factor on these shares while the time of a frame is unknown.
const HASTE: f64 = 8.0;
/// Time of a frame while it is unknown \[s\]: at 1 Mbit/s, and at 54.
const UNKNOWN_S: [f64; 2] = [2.3e-3, 0.11e-3];
/// Weight of a new figure in the running mean of the loss of each host.
const WEIGHT: f64 = 0.25;
/// Longest time over which the states of a team that acts at the same instants are spread \[s\].
const SPREAD_S: f64 = 15e-3;
/// Time for the states of a host while it is unknown how long they take \[s\].
const SLOT_S: f64 = 0.5e-3;

/// Message that a datagram has.
#[derive(Clone, Copy, Debug)]
pub(in crate::net::protocol) struct Said {
    pub(super) stream: StreamId,
    pub(super) is_part: bool,
}

impl Said {
    /// Returns what counts of a message.
    pub(in crate::net::protocol) fn of(message: &Wire) -> Said {
        let is_part = matches!(message, Wire::Latent(latent) if latent.part.is_some());
        Said { stream: (message.kind(), message.robot()), is_part }
    }

    /// Whether the message is a state of a robot as a whole.
    pub(super) fn is_state(self) -> bool {
        self.stream.0 == Kind::Latent && !self.is_part
    }
}

/// Pause between two slots \[s\]: without it the next station waits for its turn, and may collide with the one after.
const PAUSE_S: f64 = 105e-6;
/// Number of slots while no host is heard, among which each host takes that of its id.
const UNHEARD: usize = 32;

/// Datagram that leaves later.
#[derive(Clone, Debug)]
pub(super) struct Pending {
    pub(super) stream: StreamId,
    pub(super) audience: Audience,
    pub(super) frame: Frame,
    /// Whether it is a copy of one that has left.
    pub(super) is_copy: bool,
}

/// State of a link that chooses.
#[derive(Clone, Debug)]
pub(in crate::net::protocol) struct Choice {
    pub(super) chooser: Chooser,
    pub(super) pinned: bool,
    /// Whether hosts act at the same instants, so that their states have to be spread.
    spread: bool,
    pub(super) pairs: Pairs,
    /// Hosts that are heard, in order, guests among them.
    pub(super) neighbours: Vec<HostId>,
    /// Place of this host among the hosts of the team that are heard, and their number.
    place: (usize, usize),
    decided: Option<Time>,
    /// States since the last decision, and of each stream the number so far.
    states: u32,
    said: BTreeMap<StreamId, u32>,
    /// Smoothed share of the multicast frames of this host that each other one does not receive.
    lost: BTreeMap<HostId, f64>,
    /// Eighths of a transmission that are left over.
    credit: u32,
    /// Datagrams with copies so far.
    pub(super) copied: u32,
    /// Number of this host's pairs by multicast, and the time from which on the next one by each way is due.
    pub(super) number: u16,
    due: [Option<Time>; 2],
    /// Neighbour that the next pair by unicast is for.
    turn: usize,
    pub(super) pending: BTreeMap<(Time, u32), Pending>,
    order: u32,
}

impl Choice {
    /// Returns the state of a link at its start; `None` if its way is fixed.
    pub(in crate::net::protocol) fn new(choosing: Choosing, spread: bool, me: HostId) -> Option<Box<Choice>> {
        let (chooser, pinned) = match choosing {
            Choosing::Fixed => return None,
            Choosing::Measured => (Chooser::default(), false),
            Choosing::Pinned(way) => (Chooser::starting_with(way), true),
        };
        Some(Box::new(Choice {
            chooser,
            pinned,
            spread,
            pairs: Pairs::default(),
            neighbours: Vec::new(),
            place: (usize::from(me.0) % UNHEARD, UNHEARD),
            decided: None,
            states: 0,
            said: BTreeMap::new(),
            lost: BTreeMap::new(),
            credit: 0,
            copied: 0,
            number: 0,
            due: [None; 2],
            turn: 0,
            pending: BTreeMap::new(),
            order: 0,
        }))
    }

    /// Returns the decision that holds.
    pub(in crate::net::protocol) fn decision(&self) -> &Decision {
        self.chooser.decision()
    }

    /// Returns the time of the next datagram that waits; `None` if none does.
    pub(in crate::net::protocol) fn due(&self) -> Option<Time> {
        self.pending.keys().next().map(|(due, _)| *due)
    }

    /// Takes a state into account that this host wants to send. Returns whether it is left out, as the link is
    /// overloaded.
    pub(in crate::net::protocol) fn leaves_out(&mut self, now: Time, message: Said, incoming: &Incoming) -> bool {
        if !message.is_state() {
            return false;
        }
        self.states += 1;
        self.decide(now, incoming);
        let said = self.said.entry(message.stream).or_default();
        *said += 1;
        let said = *said;
        !said.is_multiple_of(u32::from(self.decision().divisor))
    }

    /// Decides anew, if it is time.
    fn decide(&mut self, now: Time, incoming: &Incoming) {
        let Some(before) = self.decided else {
            (self.decided, self.states) = (Some(now), 0);
            return;
        };
        let passed = now.since(before);
        if passed < DECIDES {
            return;
        }
        let local = &incoming.local;
        let heard = incoming.senders.iter().filter(|(_, sender)| sender.age(now).is_some_and(|age| age <= HEARD));
        let heard: Vec<_> = heard.map(|((host, _), sender)| (host, sender.reported_lost)).collect();
        let team: Vec<_> = heard.iter().filter(|(host, _)| *host < local.first_guest && !host.is_operator()).collect();
        let mixed = self.chooser.age(now).is_some_and(|age| age < MIXED);
        let reported = !mixed && self.decision().way != Way::Unicast;
        let pooled = self.pairs.loss();
        let lost = &mut self.lost;
        let mut loss = |host: HostId, lost_of_span: u8| {
            let told = if reported { f64::from(lost_of_span) / f64::from(LOSS_SPAN) } else { pooled };
            let mean = lost.entry(host).or_insert(told);
            *mean += WEIGHT * (told - *mean);
            *mean
        };
        let measured = Measured {
            hosts: team.len() + 1,
            states_hz: f64::from(self.states) / passed.as_secs(),
            loss: team.iter().map(|(host, lost)| loss(*host, *lost)).collect(),
            multicast_s: self.pairs.frame_s(false),
            unicast_s: self.pairs.frame_s(true),
            congested: incoming.congestion.is_on(now),
        };
        if !team.is_empty() {
            self.place = (team.iter().filter(|(host, _)| *host < local.host).count(), team.len() + 1);
        }
        self.neighbours = heard.iter().map(|(host, _)| *host).collect();
        self.neighbours.dedup();
        self.lost.retain(|host, _| self.neighbours.contains(host));
        (self.decided, self.states) = (Some(now), 0);
        let before = self.decision().clone();
        if self.pinned {
            self.chooser.keep(measured);
        } else if self.chooser.update(now, measured) {
            tracing::info!(link = local.link.0, "sends by {} (before: {:?})", self.decision(), before.way);
        }
    }

    /// Returns whether a pair by this way is due.
    pub(super) fn is_due(&mut self, now: Time, unicast: bool) -> bool {
        if self.pinned || self.neighbours.is_empty() {
            return false;
        }
        let way = usize::from(unicast);
        let time_s = self.pairs.frame_s(unicast);
        let hosts = self.place.1 as f64;
        let share = if time_s.is_some() { SHARES[way] } else { SHARES[way] * HASTE };
        let period_s = 2.0 * time_s.unwrap_or(UNKNOWN_S[way]) * hosts / share;
        // The hosts of a team begin one after the other.
        let first = || now + Span::from_secs(period_s * self.place.0 as f64 / hosts);
        let due = *self.due[way].get_or_insert_with(first);
        if due <= now {
            self.due[way] = Some(now + Span::from_secs(period_s));
        }
        due <= now
    }

    /// Returns how often the next datagram leaves by multicast on this decision.
    pub(super) fn transmissions(&mut self, way: Way) -> u32 {
        let Way::Multicast(eighths) = way else { return 1 };
        self.credit += u32::from(eighths);
        let count = self.credit / 8;
        self.credit %= 8;
        count
    }

    /// Returns how long the states of this host wait for their slot.
    pub(super) fn offset(&self, message: Said) -> Span {
        if self.spread && message.is_state() { self.slot() * self.place.0 as u64 } else { Span::ZERO }
    }

    /// Whether it has had states to decide for.
    pub(super) fn has_decided(&self) -> bool {
        self.decided.is_some()
    }

    /// Returns the place of this host among the hosts of the team that are heard, and their number.
    pub(super) fn place(&self) -> (usize, usize) {
        self.place
    }

    /// Returns how long states wait for their slot; `None` if they are not spread.
    pub(super) fn wait(&self) -> Option<Span> {
        self.spread.then(|| self.slot() * self.place.0 as u64)
    }

    /// Returns the time in which each host has had its slot; zero if states are not spread.
    pub(super) fn round(&self) -> Span {
        if self.spread { self.slot() * self.place.1 as u64 } else { Span::ZERO }
    }

    /// Returns the length of a slot.
    fn slot(&self) -> Span {
        let Decision { way, measured, .. } = self.decision();
        // Copies come later, when all have had their turn.
        let frames = if *way == Way::Unicast { Way::Unicast } else { Way::Multicast(8) };
        let time_s = measured.cost_s(frames);
        let slot_s = if time_s.is_finite() { time_s + PAUSE_S } else { SLOT_S };
        Span::from_secs(slot_s.min(SPREAD_S / self.place.1 as f64))
    }

    /// Returns the neighbour that the next pair by unicast is for, with its index. There is one.
    pub(super) fn next_neighbour(&mut self) -> (usize, HostId) {
        self.turn = (self.turn + 1) % self.neighbours.len();
        (self.turn, self.neighbours[self.turn])
    }

    pub(super) fn put(&mut self, due: Time, pending: Pending) {
        self.order = self.order.wrapping_add(1);
        self.pending.insert((due, self.order), pending);
    }

    /// Drops what waits of a stream that has something newer.
    pub(super) fn supersede(&mut self, stream: StreamId) {
        self.pending.retain(|_, pending| pending.stream != stream);
    }
}
