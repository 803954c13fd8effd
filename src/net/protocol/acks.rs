//! Acknowledgements that a host has still to send on one link. They are collected for a short time, so that one block
//! acknowledges many datagrams.

use std::collections::BTreeMap;

use super::codec::{BLOCK_BYTES, Content, add};
use super::report::{DatagramId, ID_BYTES, MAX_IDS, write_ids};
use crate::messages::ids::HostId;
use crate::time::{Span, Time};

/// Time after the first pending acknowledgement at which all pending ones are sent.
const ACK_WITHIN: Span = Span::from_millis(2);

/// Acknowledgements that a host has still to send on one link: the ids of the received datagrams, by their sender.
#[derive(Clone, Debug, Default)]
pub struct Acks {
    pending: BTreeMap<HostId, Vec<DatagramId>>,
    due: Option<Time>,
}

impl Acks {
    /// Adds the id of a received datagram that is to be acknowledged. It is ignored if `MAX_IDS` (64) datagrams of its
    /// sender are already pending. If nothing was pending, the acknowledgements become due 2 ms after `now`.
    pub fn note(&mut self, now: Time, id: DatagramId) {
        let ids = self.pending.entry(id.host).or_default();
        if ids.len() < MAX_IDS {
            ids.push(id);
        }
        self.due = self.due.or(Some(now + ACK_WITHIN));
    }

    /// Returns whether the acknowledgement of this datagram is pending, or nothing more of its sender can be.
    pub fn has(&self, id: &DatagramId) -> bool {
        self.pending.get(&id.host).is_some_and(|ids| ids.len() >= MAX_IDS || ids.contains(id))
    }

    /// Returns true if no acknowledgement is pending.
    pub fn is_empty(&self) -> bool {
        self.pending.is_empty()
    }

    /// Returns the time at which the pending acknowledgements are to be sent; `None` if there are none.
    pub fn due(&self) -> Option<Time> {
        self.due
    }

    /// Returns the host with the lowest number among the senders of datagrams that are still to be acknowledged; `None`
    /// if there are none.
    pub fn first_host(&self) -> Option<HostId> {
        self.pending.first_key_value().map(|(host, _)| *host)
    }

    /// Appends pending acknowledgements to `bytes`, a datagram that goes to all hosts: one block for each sender of
    /// acknowledged datagrams, as many ids as fit into `most` bytes. The appended ids are no longer pending.
    pub fn add_to(&mut self, bytes: &mut Vec<u8>, most: usize) {
        while let Some(mut waiting) = self.pending.first_entry() {
            let room = most.saturating_sub(bytes.len() + BLOCK_BYTES) / ID_BYTES;
            if room == 0 {
                return;
            }
            let most = waiting.get().len().min(room);
            let ids: Vec<DatagramId> = waiting.get_mut().drain(..most).collect();
            add(bytes, Content::Ack, |bytes| write_ids(&ids, bytes));
            if waiting.get().is_empty() {
                waiting.remove();
            }
        }
        self.due = None;
    }

    /// Appends all pending acknowledgements of datagrams of the host `host` to `bytes`, a datagram for that host that
    /// has no other block yet. They are no longer pending.
    pub fn add_for(&mut self, host: HostId, bytes: &mut Vec<u8>) {
        if let Some(ids) = self.pending.remove(&host) {
            add(bytes, Content::Ack, |bytes| write_ids(&ids, bytes));
        }
        if self.pending.is_empty() {
            self.due = None;
        }
    }
}
