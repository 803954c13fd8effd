//! Emergency stops in datagrams that are refused for their number: they hold all the same.

use super::codec::{self, Header};
use super::incoming::Incoming;
use super::link::LinkState;
use crate::messages::wire::{Kind, Stop, Wire};
use crate::time::Time;

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
    pub(super) fn new_stop(&mut self, now: Time, header: &Header, plain: &[u8]) -> Option<Stop> {
        let mut stops = codec::messages(plain).filter(|(kind, ..)| *kind == Kind::Stop);
        let new = stops.find_map(|(kind, body, proof)| match codec::message(kind, body) {
            Ok(Wire::Stop(stop)) => {
                let believed = stop.latch.is_engaged() && self.believes(now, header, &Wire::Stop(stop), (body, proof));
                (believed && self.incoming.is_new_stop(header, stop)).then_some(stop)
            }
            _ => None,
        });
        self.counts.urgent += u64::from(new.is_some());
        new
    }

    /// Returns the emergency stop in the last datagram if it holds although the datagram was refused for its number.
    pub(crate) fn urgent(&self) -> Option<Stop> {
        self.urgent
    }
}
