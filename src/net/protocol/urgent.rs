//! Emergency stops in datagrams that are refused for their number: they hold all the same.

use super::codec::{self, Content, Header};
use super::incoming::Incoming;
use super::link::LinkState;
use crate::messages::wire::{Kind, Stop, Wire};

impl Incoming {
    /// Returns whether an emergency stop is a new one of its sender, whatever the number of its datagram is, and
    /// records it if so. A stop that engages is never refused for a number: whoever has the team's key can raise the
    /// numbers that are expected of another.
    pub fn is_new_stop(&mut self, header: &Header, stop: Stop) -> bool {
        let Some(sender) = self.senders.get_mut((header.sender, header.incarnation)) else { return false };
        let new = stop.latch.is_engaged() && stop.latch > sender.stop;
        if new {
            sender.stop = stop.latch;
        }
        new
    }
}

impl LinkState {
    /// Returns the emergency stop in a datagram whose number is refused, if it is a new one of an accepted sender.
    #[cold]
    pub(super) fn new_stop(&mut self, header: &Header, plain: &[u8]) -> Option<Stop> {
        let stops = codec::blocks(plain).flatten().filter(|(content, _)| *content == Content::Message(Kind::Stop));
        let stops = stops.filter_map(|(_, body)| codec::message(Kind::Stop, body).ok());
        let mut stops = stops.filter_map(|message| if let Wire::Stop(stop) = message { Some(stop) } else { None });
        let new = stops.find(|stop| self.incoming.is_new_stop(header, *stop));
        self.counts.urgent += u64::from(new.is_some());
        new
    }

    /// Returns the emergency stop in the last datagram if it holds although the datagram was refused for its number.
    pub(crate) fn urgent(&self) -> Option<Stop> {
        self.urgent
    }
}
