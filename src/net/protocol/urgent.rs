//! Emergency stops in datagrams that are refused for their number: they hold all the same.

use super::codec::{self, Header};
use super::incoming::Incoming;
use super::link::LinkState;
use crate::messages::wire::{Kind, Stop, Wire};
use crate::time::Time;

impl Incoming {
    /// Returns whether an emergency stop is a new one of its sender, for any number of its datagram. A stop that
    /// engages is never refused for a number: a member with the team's key can raise the numbers that are expected
    /// of another.
    pub(super) fn is_new_stop(&self, header: &Header, stop: Stop) -> bool {
        let sender = self.senders.get((header.sender, header.incarnation));
        sender.is_some_and(|sender| stop.latch.is_engaged() && stop.latch > sender.stop)
    }

    /// Records an emergency stop, so that it is not new any more.
    pub(super) fn note_stop(&mut self, header: &Header, stop: Stop) {
        if let Some(sender) = self.senders.get_mut((header.sender, header.incarnation)) {
            sender.stop = sender.stop.max(stop.latch);
        }
    }
}

impl LinkState {
    /// Looks for a new emergency stop of an accepted sender in a datagram whose number is refused. Returns it if it is
    /// believed, and `Some(None)` if it is not; `None` if there is none, and nothing has changed.
    #[cold]
    pub(super) fn new_stop(&mut self, now: Time, header: &Header, plain: &[u8]) -> Option<Option<Stop>> {
        let mut found = None;
        for (kind, body, signature) in codec::messages(plain).filter(|(kind, ..)| *kind == Kind::Stop) {
            let Ok(message @ Wire::Stop(stop)) = codec::message(kind, body) else { continue };
            if !self.incoming.is_new_stop(header, stop) {
                continue;
            }
            found = Some(None);
            if self.believes(now, header, &message, (body, signature)) {
                self.incoming.note_stop(header, stop);
                self.counts.urgent += 1;
                return Some(Some(stop));
            }
        }
        found
    }

    /// Returns the emergency stop in the last datagram if it holds although the datagram was refused for its number.
    pub(crate) fn urgent(&self) -> Option<Stop> {
        self.urgent
    }
}
