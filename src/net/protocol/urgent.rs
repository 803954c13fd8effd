//! Emergency stops in datagrams that are refused for their number: they hold all the same.

use super::codec::Header;
use super::incoming::Incoming;
use crate::messages::wire::Stop;

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
