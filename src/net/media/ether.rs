//! The emulated ether: one actor a link, carrying frames between the Networks of one process.
//!
//! With a radio, frames are first on the air, and the medium takes over what arrives there.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::air::Air;
use crate::actor::Core;
use crate::messages::ids::HostId;
use crate::messages::wire::{KINDS, Kind};
use crate::net::media::medium::Medium;
use crate::net::media::radio::RadioCounts;
use crate::net::media::reach::Reach;
use crate::net::protocol::codec::{Content, Frame, first};
use crate::net::protocol::router::Audience;
use crate::net::transport::{Arrive, In, Transmit};
use crate::time::Time;

/// What an ether says.
#[derive(Clone, Debug)]
pub enum Out {
    /// To a Network.
    Arrive(Arrive),
    /// To the Recorder: what has happened on its radio. Boxed: it is large and rare.
    Counts(Box<RadioCounts>),
}

/// The ether of one link.
#[derive(Debug)]
pub struct Ether {
    medium: Medium,
    air: Option<Air>,
    /// Who is near enough, if it is not everyone.
    reach: Option<Reach>,
    /// By kind; and last, whoever listens to anything, for what the link layer says for itself.
    listeners: Vec<Arc<[u16]>>,
    /// Frames on their way, in order of arrival and, at one instant, of departure.
    flying: BTreeMap<(Time, u64), Arrive>,
    departures: u64,
    copies: Vec<(Time, Frame)>,
    reached: Vec<HostId>,
}

impl Ether {
    /// An ether on which `listens` says which hosts listen to a kind of message. With a radio, the range is that one's.
    pub fn new(medium: Medium, air: Option<Air>, reach: Option<Reach>, listens: impl Fn(Kind) -> Vec<HostId>) -> Ether {
        let of = |kind| listens(kind).into_iter().map(|host| host.0).collect::<BTreeSet<u16>>();
        let by_kind: Vec<BTreeSet<u16>> = KINDS.iter().map(|&kind| of(kind)).collect();
        let all = by_kind.iter().flatten().copied().collect();
        let listeners = by_kind.into_iter().chain([all]).map(|hosts| hosts.into_iter().collect()).collect();
        let (flying, copies, reached) = (BTreeMap::new(), Vec::new(), Vec::new());
        Ether { medium, air, reach, listeners, flying, departures: 0, copies, reached }
    }

    fn transmit(&mut self, now: Time, transmit: &Transmit, out: &mut Vec<Out>) {
        let (kind, heard_as) = match first(&transmit.frame).expect("a Network sends whole datagrams") {
            Content::Message(kind) => (kind, kind as usize),
            // Soft state: the medium treats it like the soft state of robots.
            _ => (Kind::Heartbeat, KINDS.len()),
        };
        if let Some(air) = &mut self.air {
            return air.offer(now, transmit, kind, &self.listeners[heard_as]);
        }
        let (from, listeners) = (transmit.from, &self.listeners[heard_as]);
        let mut reached = std::mem::take(&mut self.reached);
        reached.clear();
        match (transmit.audience, &mut self.reach) {
            (Audience::Host(to), Some(reach)) => reached.extend(Some(to).filter(|&to| reach.covers(from, to))),
            (Audience::Host(to), None) => reached.push(to),
            (Audience::All, Some(reach)) => reach.listeners(from, listeners, &mut reached),
            (Audience::All, None) => reached.extend(listeners.iter().copied().map(HostId).filter(|&to| to != from)),
        }
        for &to in &reached {
            self.carry(now, kind, (from, to), &transmit.frame, out);
        }
        self.reached = reached;
    }

    fn carry(&mut self, now: Time, kind: Kind, (from, to): (HostId, HostId), frame: &Frame, out: &mut Vec<Out>) {
        self.medium.carry(now, kind, (from, to), frame, &mut self.copies);
        for (at, frame) in self.copies.drain(..) {
            let arrive = Arrive { to, from: None, frame };
            if at <= now {
                out.push(Out::Arrive(arrive));
            } else {
                self.flying.insert((at, self.departures), arrive);
                self.departures += 1;
            }
        }
    }
}

impl Core for Ether {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Transmit(transmit) => self.transmit(now, &transmit, out),
            In::Truth(truth) => {
                self.air.iter_mut().for_each(|air| air.locate(&truth));
                self.reach.iter_mut().for_each(|reach| reach.locate(&truth));
            }
            In::Admit(_) => unreachable!("an ether has no socket"),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        let arrival = self.flying.keys().next().map(|&(at, _)| at);
        [arrival, self.air.as_ref().map(Air::wake_at)].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if let Some(air) = &mut self.air {
            let mut heard = Vec::new();
            let counts = air.wake(now, &mut heard);
            for delivery in heard {
                let between = (HostId(delivery.from), HostId(delivery.to));
                self.carry(now, delivery.token.kind, between, &delivery.token.frame, out);
            }
            out.extend(counts.map(|counts| Out::Counts(Box::new(counts))));
        }
        while let Some(entry) = self.flying.first_entry().filter(|entry| entry.key().0 <= now) {
            out.push(Out::Arrive(entry.remove()));
        }
    }
}
