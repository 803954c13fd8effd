//! Pending acknowledgements of one link, collected for a short time so that one block acknowledges many datagrams.

use std::collections::BTreeMap;

use super::codec::{BLOCK_BYTES, Content, MAX_PLAIN_BYTES, add};
use super::report::{DatagramId, ID_BYTES, MAX_IDS, write_ids};
use crate::messages::ids::HostId;
use crate::time::{Span, Time};

/// Time for which acknowledgements are collected.
const ACK_WITHIN: Span = Span::from_millis(2);

/// Ids of received datagrams that are to be acknowledged, by sender.
#[derive(Clone, Debug, Default)]
pub struct Acks {
    pending: BTreeMap<HostId, Vec<DatagramId>>,
    due: Option<Time>,
}

impl Acks {
    /// Adds a received datagram that is to be acknowledged.
    pub fn note(&mut self, now: Time, id: DatagramId) {
        let ids = self.pending.entry(id.host).or_default();
        if ids.len() < MAX_IDS {
            ids.push(id);
        }
        self.due = self.due.or(Some(now + ACK_WITHIN));
    }

    /// Whether no acknowledgement is pending.
    pub fn is_empty(&self) -> bool {
        self.pending.is_empty()
    }

    /// Time at which the pending acknowledgements are to be sent; `None` if there are none.
    pub fn due(&self) -> Option<Time> {
        self.due
    }

    /// First host with datagrams to acknowledge; `None` if there are none.
    pub fn first_host(&self) -> Option<HostId> {
        self.pending.first_key_value().map(|(host, _)| *host)
    }

    /// Appends acknowledgement blocks to a datagram to all hosts, as many as fit, and removes what it has appended.
    pub fn add_to(&mut self, bytes: &mut Vec<u8>) {
        while let Some(mut waiting) = self.pending.first_entry() {
            let room = MAX_PLAIN_BYTES.saturating_sub(bytes.len() + BLOCK_BYTES) / ID_BYTES;
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

    /// Appends the acknowledgements for one host to an empty datagram, and removes them.
    pub fn add_for(&mut self, host: HostId, bytes: &mut Vec<u8>) {
        if let Some(ids) = self.pending.remove(&host) {
            add(bytes, Content::Ack, |bytes| write_ids(&ids, bytes));
        }
        if self.pending.is_empty() {
            self.due = None;
        }
    }
}
