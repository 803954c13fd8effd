//! The emulated ether: one actor a link, carrying frames between the Networks of one process.

use std::collections::{BTreeMap, BTreeSet};

use super::{Arrive, In, Transmit};
use crate::actors::Core;
use crate::messages::ids::HostId;
use crate::messages::wire::{KINDS, Kind};
use crate::net::codec::{Content, Frame, first};
use crate::net::medium::Medium;
use crate::net::router::Audience;
use crate::time::Time;

/// The ether of one link.
#[derive(Debug)]
pub struct Ether {
    medium: Medium,
    /// By kind; and last, whoever listens to anything, for what the link layer says for itself.
    listeners: Vec<Vec<HostId>>,
    /// Frames on their way, in order of arrival and, at one instant, of departure.
    flying: BTreeMap<(Time, u64), Arrive>,
    departures: u64,
    copies: Vec<(Time, Frame)>,
}

impl Ether {
    /// An ether on which `listens` says which hosts listen to a kind of message.
    pub fn new(medium: Medium, listens: impl Fn(Kind) -> Vec<HostId>) -> Ether {
        let mut listeners: Vec<Vec<HostId>> = KINDS.iter().map(|&kind| listens(kind)).collect();
        listeners.push(listeners.concat().into_iter().collect::<BTreeSet<_>>().into_iter().collect());
        Ether { medium, listeners, flying: BTreeMap::new(), departures: 0, copies: Vec::new() }
    }

    fn carry(&mut self, now: Time, kind: Kind, transmit: &Transmit, to: HostId, out: &mut Vec<Arrive>) {
        self.medium.carry(now, kind, (transmit.from, to), &transmit.frame, &mut self.copies);
        for (at, frame) in self.copies.drain(..) {
            let arrive = Arrive { to, frame };
            if at <= now {
                out.push(arrive);
            } else {
                self.flying.insert((at, self.departures), arrive);
                self.departures += 1;
            }
        }
    }
}

impl Core for Ether {
    type In = In;
    type Out = Arrive;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Arrive>) {
        let In::Transmit(transmit) = input else { unreachable!("an ether has no socket") };
        let (kind, heard_as) = match first(&transmit.frame).expect("a Network sends whole datagrams") {
            Content::Message(kind) => (kind, kind as usize),
            // Soft state: the medium treats it like the soft state of robots.
            _ => (Kind::Heartbeat, KINDS.len()),
        };
        match transmit.audience {
            Audience::Host(to) => self.carry(now, kind, &transmit, to, out),
            Audience::All => {
                for at in 0..self.listeners[heard_as].len() {
                    let to = self.listeners[heard_as][at];
                    if to != transmit.from {
                        self.carry(now, kind, &transmit, to, out);
                    }
                }
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        self.flying.keys().next().map(|&(at, _)| at)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Arrive>) {
        while let Some(entry) = self.flying.first_entry().filter(|entry| entry.key().0 <= now) {
            out.push(entry.remove());
        }
    }
}
