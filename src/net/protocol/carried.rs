//! Entries of a mesh (`relay`) in the datagrams of a link: beside data, or in a datagram of their own.

use super::codec::{self, HEADER_BYTES};
use super::link::LinkState;
use super::outgoing::Outbound;
use super::relay::Block;
use super::router::Audience;
use crate::time::Time;

impl LinkState {
    /// Takes entries for the next datagram with data to all hosts.
    pub(crate) fn carry(&mut self, block: Block) {
        self.outgoing.carried = block;
    }

    /// Returns the entries that have left since: those that had room; none if the datagram was left out.
    pub(crate) fn carried(&mut self) -> Block {
        let block = std::mem::take(&mut self.outgoing.carried);
        if block.left { block } else { Block::default() }
    }

    /// Sends entries in a datagram of their own, with what else waits: appends it to `out`. Returns those that had
    /// room.
    pub(crate) fn send_carried(&mut self, now: Time, mut block: Block, out: &mut Vec<Outbound>) -> Block {
        self.incoming.duplicate_ids.uptime(now);
        let LinkState { outgoing, incoming, counts, .. } = self;
        let mut bytes = codec::start(&outgoing.header(Audience::All, 0));
        block.add_to(&mut bytes, outgoing.room);
        if bytes.len() > HEADER_BYTES {
            outgoing.piggyback(now, Audience::All, &mut bytes, incoming);
            outgoing.send_alone(Audience::All, bytes, counts, out);
        }
        self.plan();
        block
    }
}
