//! Answers of a link to what others send: acknowledgements, retransmissions on request, and requests of its own.

use super::codec::{self, Content, add};
use super::counts::LinkCounts;
use super::outgoing::{Outbound, Outgoing};
use super::reliability::Piggyback;
use super::report::{DatagramId, write_ids};
use super::router::Audience;
use crate::messages::ids::HostId;
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

    /// Handles acknowledgements that the host `from` has sent for datagrams of this host.
    pub fn acknowledged(&mut self, now: Time, from: HostId, ids: &[DatagramId]) {
        self.retransmitter.acknowledged(now, from, ids);
    }

    /// Retransmits the datagrams that the host `from` requests: appends those that are still kept to `out`.
    pub fn requested(
        &mut self,
        now: Time,
        from: HostId,
        ids: &[DatagramId],
        counts: &mut LinkCounts,
        out: &mut Vec<Outbound>,
    ) {
        for datagram in self.retransmitter.requested(now, from, ids) {
            self.send_copy(datagram, counts, out);
        }
    }

    /// Appends to `out` a datagram to all hosts that requests the retransmission of the missing datagrams `ids`.
    pub fn ask(&mut self, ids: &[DatagramId], counts: &mut LinkCounts, out: &mut Vec<Outbound>) {
        let mut bytes = codec::start(&self.header(Audience::All, 0));
        add(&mut bytes, Content::Nack, |bytes| write_ids(ids, bytes));
        self.send_alone(Audience::All, bytes, counts, out);
    }

    /// Sends the acknowledgements that are due, in datagrams of their own.
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
