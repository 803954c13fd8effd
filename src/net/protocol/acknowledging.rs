//! When acknowledgements leave on a link, and in which datagrams. `acks` collects them.

use super::codec;
use super::counts::LinkCounts;
use super::outgoing::{Outbound, Outgoing};
use super::reliability::Piggyback;
use super::report::DatagramId;
use super::router::Audience;
use crate::time::Time;

impl Outgoing {
    /// Schedules the acknowledgement of a datagram that has arrived.
    pub fn acknowledge(&mut self, now: Time, id: DatagramId) {
        self.acks.note(now, id);
    }

    /// Returns whether the acknowledgement of this datagram is pending, or nothing more of its sender can be.
    pub fn acknowledges(&self, id: &DatagramId) -> bool {
        self.acks.has(id)
    }

    /// Sends the pending acknowledgements: appends the datagrams to `out`.
    pub(super) fn send_acks(&mut self, counts: &mut LinkCounts, out: &mut Vec<Outbound>) {
        while let Some(host) = self.acks.first_host() {
            let audience = if self.setup.piggyback == Piggyback::Any { Audience::All } else { Audience::Host(host) };
            let mut bytes = codec::start(&self.header(audience, 0));
            match audience {
                Audience::All => self.acks.add_to(&mut bytes, self.room),
                Audience::Host(host) => self.acks.add_for(host, &mut bytes),
            }
            self.send_alone(audience, bytes, counts, out);
        }
    }
}
