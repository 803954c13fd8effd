//! Messages in parts on a link: its requests for those that are missing, and those of other hosts.

use super::{Lacking, is_part};
use crate::messages::ids::HostId;
use crate::messages::wire::{Kind, Wire};
use crate::net::protocol::codec::{self, Content, add};
use crate::net::protocol::counts::LinkCounts;
use crate::net::protocol::link::LinkState;
use crate::net::protocol::outgoing::{Outbound, Outgoing};
use crate::net::protocol::reliability::Reliability;
use crate::net::protocol::router::Audience;

impl LinkState {
    /// Returns the parts of messages that the sender of the last datagram has not received; none if it was refused.
    pub(crate) fn lacking(&self) -> &[Lacking] {
        &self.lacking
    }

    /// Asks the host `from` for the parts `lacking` of its messages: appends the datagram to `out`.
    pub(crate) fn ask_for_parts(&mut self, from: HostId, lacking: &[Lacking], out: &mut Vec<Outbound>) {
        self.outgoing.ask_for_parts(from, lacking, &mut self.counts, out);
        self.plan();
    }

    /// Returns whether missing parts of messages are asked for on this link.
    pub(crate) fn repairs_parts(&self) -> bool {
        self.outgoing.repairs_parts()
    }

    /// Returns the length of the largest datagram without its tags \[bytes\].
    pub(crate) fn room(&self) -> usize {
        self.outgoing.room
    }
}

impl Outgoing {
    /// Returns the reliability mode of a message on the link. Parts are repaired by those that join them.
    pub(in crate::net::protocol) fn reliability_of(&self, message: &Wire) -> Reliability {
        if is_part(message) { Reliability::BestEffort } else { self.setup.of(message.kind()) }
    }

    /// Appends to `out` a datagram that asks for the parts `lacking`. On a link on which every datagram reaches every
    /// host it goes to all, so that others need not ask.
    pub fn ask_for_parts(
        &mut self,
        from: HostId,
        lacking: &[Lacking],
        counts: &mut LinkCounts,
        out: &mut Vec<Outbound>,
    ) {
        let audience = if self.setup.is_addressed() { Audience::Host(from) } else { Audience::All };
        let mut bytes = codec::start(&self.header(audience, 0));
        add(&mut bytes, Content::Lacking, |bytes| Lacking::write(lacking, bytes));
        self.send_alone(audience, bytes, counts, out);
    }

    /// Returns whether missing parts of messages are asked for: messages of policies are repaired on the link.
    pub fn repairs_parts(&self) -> bool {
        self.setup.of(Kind::Latent) != Reliability::BestEffort
    }
}
