//! The emulated link: one actor per link, which carries frames (packets) between the Network actors of one process.
//!
//! With a radio, frames contend for the radio channel first. The link emulator then delays or loses the frames that
//! have come through.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::radio_link::RadioLink;
use crate::actor::Core;
use crate::faults::ManualLinkFault;
use crate::messages::ids::HostId;
use crate::messages::local::Truth;
use crate::messages::wire::{KINDS, Kind};
use crate::net::media::emulator::LinkEmulator;
use crate::net::media::radio::RadioCounts;
use crate::net::media::reach::Reach;
use crate::net::protocol::codec::{self, Content, Frame, first};
use crate::net::protocol::router::Audience;
use crate::net::transport::Transmit;
use crate::time::Time;

/// Input message of an ether: a frame to carry, or what affects the emulation.
#[derive(Clone, Debug)]
pub enum In {
    /// Frame to carry, with its receivers.
    Transmit(Transmit),
    /// True positions of the robots, from a World. Sent only if what the link carries depends on them.
    Truth(Truth),
    /// Number of the episode that begins, for faults that are timed from it.
    EpisodeBegins(u32),
    /// Fault that a person sets during the run, such as a cut link.
    Manual(ManualLinkFault),
}

/// Output message of an ether, the actor that emulates one link.
#[derive(Clone, Debug)]
pub enum Out {
    /// A frame that arrives at this host.
    Arrive(HostId, Frame),
    /// Counters of frames and airtime of the link's emulated radio, for the Recorder, the actor that collects the
    /// results. Boxed because it is large and rare.
    Counts(Box<RadioCounts>),
}

/// Ether: the actor that emulates the medium of one link. It carries frames from host to host, with delay, loss, range
/// and faults.
#[derive(Debug)]
pub struct Ether {
    emulator: LinkEmulator,
    radio: Option<RadioLink>,
    /// Tells which hosts are in range of a sender; `None` if the range is unlimited. Not used with a radio.
    reach: Option<Reach>,
    /// Tells which hosts are near enough to a sender that they may use its latents; `None` if all are. Not used with a
    /// radio.
    users: Option<Reach>,
    /// Numbers of the hosts that receive each kind of message, in the order of `KINDS`. One more entry has the hosts
    /// that receive any kind, for frames that contain only data of the link layer itself, such as acknowledgements.
    listeners: Vec<Arc<[u16]>>,
    /// Frames that were sent and have not yet arrived. The key is the time of arrival, then the number of the
    /// departure, which orders frames that arrive at one instant.
    in_flight: BTreeMap<(Time, u64), (HostId, Frame)>,
    departures: u64,
    copies: Vec<(Time, Frame)>,
    reached: Vec<HostId>,
}

impl Ether {
    /// Returns the ether of one link. `emulator` applies delay, loss and planned faults. `radio` models a shared radio
    /// channel; without it (`None`), frames do not contend.
    ///
    /// `reach` limits the range; `None` means unlimited. It is ignored with a radio, whose own range then applies.
    /// `listens` is a function that returns the hosts that receive messages of a given kind.
    pub fn new(
        emulator: LinkEmulator,
        radio: Option<RadioLink>,
        reach: Option<Reach>,
        listens: impl Fn(Kind) -> Vec<HostId>,
    ) -> Ether {
        let of = |kind| listens(kind).into_iter().map(|host| host.0).collect::<BTreeSet<u16>>();
        let by_kind: Vec<BTreeSet<u16>> = KINDS.iter().map(|&kind| of(kind)).collect();
        let all = by_kind.iter().flatten().copied().collect();
        let listeners = by_kind.into_iter().chain([all]).map(|hosts| hosts.into_iter().collect()).collect();
        let (in_flight, copies, reached) = (BTreeMap::new(), Vec::new(), Vec::new());
        Ether { emulator, radio, reach, users: None, listeners, in_flight, departures: 0, copies, reached }
    }

    /// Returns the ether with knowledge of the hosts that may use each other's latents: a latent is not carried to
    /// others, which would refuse it. So the work for a frame grows with the hosts near its sender, not with the team.
    /// No fault must be planned on the link. It is ignored with a radio, whose frames take time for all.
    pub fn with_users(self, users: Option<Reach>) -> Ether {
        Ether { users, ..self }
    }

    fn transmit(&mut self, now: Time, transmit: &Transmit, out: &mut Vec<Out>) {
        let (kind, index) = match first(&transmit.frame) {
            Ok(Content::Message(kind)) => (kind, kind as usize),
            // The link layer's own soft state is impaired like the robots' soft state, and so is what is encrypted.
            _ => (Kind::Heartbeat, KINDS.len()),
        };
        if let Some(radio) = &mut self.radio {
            return radio.offer(now, transmit, kind, &self.listeners[index]);
        }
        let (from, listeners) = (transmit.from, &self.listeners[index]);
        let is_latent = self.users.is_some() && codec::is_only(&transmit.frame, Kind::Latent);
        let mut users = self.users.take();
        let mut near = users.as_mut().filter(|_| is_latent);
        let mut reached = std::mem::take(&mut self.reached);
        reached.clear();
        match (transmit.audience, &mut self.reach) {
            (Audience::Host(to), Some(reach)) => reached.extend(Some(to).filter(|&to| reach.covers(from, to))),
            (Audience::Host(to), None) => reached.push(to),
            (Audience::All, Some(reach)) => reach.listeners(from, listeners, &mut reached),
            (Audience::All, None) => match near.as_mut().filter(|_| !self.emulator.draws(kind)) {
                Some(near) => near.listeners(from, listeners, &mut reached),
                None => reached.extend(listeners.iter().copied().map(HostId).filter(|&to| to != from)),
            },
        }
        for &to in &reached {
            if near.as_ref().is_none_or(|near| near.covers(from, to)) {
                self.carry(now, kind, (from, to), &transmit.frame, out);
            } else {
                self.emulator.leave_out(now, kind);
            }
        }
        self.users = users;
        self.reached = reached;
    }

    fn carry(&mut self, now: Time, kind: Kind, (from, to): (HostId, HostId), frame: &Frame, out: &mut Vec<Out>) {
        self.emulator.carry(now, kind, (from, to), frame, &mut self.copies);
        for (at, frame) in self.copies.drain(..) {
            if at <= now {
                out.push(Out::Arrive(to, frame));
            } else {
                self.in_flight.insert((at, self.departures), (to, frame));
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
                self.radio.iter_mut().for_each(|radio| radio.locate(&truth));
                self.reach.iter_mut().chain(&mut self.users).for_each(|reach| reach.locate(&truth));
            }
            In::EpisodeBegins(episode) => self.emulator.begin(now, episode),
            In::Manual(fault) => self.emulator.set_manual(fault),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        let arrival = self.in_flight.keys().next().map(|&(at, _)| at);
        [arrival, self.radio.as_ref().map(RadioLink::wake_at)].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if let Some(radio) = &mut self.radio {
            let mut heard = Vec::new();
            let counts = radio.wake(now, &mut heard);
            for delivery in heard {
                let between = (HostId(delivery.from), HostId(delivery.to));
                self.carry(now, delivery.token.kind, between, &delivery.token.frame, out);
            }
            out.extend(counts.map(|counts| Out::Counts(Box::new(counts))));
        }
        while let Some(entry) = self.in_flight.first_entry().filter(|entry| entry.key().0 <= now) {
            let (to, frame) = entry.remove();
            out.push(Out::Arrive(to, frame));
        }
    }
}
