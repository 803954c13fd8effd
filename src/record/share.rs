//! Copies records so that they can be shared without the team's key: an attached list states which datagrams had a
//! valid tag, and a replay uses it instead of the key.

use std::collections::BTreeSet;
use std::io::{Seek, Write};

use super::reader::{Item, Messages, ReadError, Reader};
use super::repair::{Copy, RepairError};
use super::tape;
use crate::graph::inputs::Input;
use crate::messages::ids::HostId;
use crate::net::protocol::key::{Key, digest};

/// Name of the attachment of a shared record that lists 16-byte digests of the datagrams with a valid tag.
pub const ACCEPTED: &str = "murmurate.accepted";

/// Result of checking the tags of a record's datagrams.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Digests of the datagrams with a valid tag.
    pub accepted: BTreeSet<[u8; 16]>,
    /// Number of datagrams without a valid tag.
    pub refused: u64,
}

/// Checks with the team's key the tags of all datagrams that the host `host` has received, by its record. Returns the
/// digests of those with a valid tag.
pub fn accepted(mut messages: Messages, key: &Key, host: HostId) -> Result<Found, ReadError> {
    let mut found = Found::default();
    while let Some(message) = messages.next_message()? {
        if message.channel.topic != "/tape/turn" {
            continue;
        }
        for input in tape::read(&message.data).into_iter().flat_map(|turn| turn.inputs) {
            if let Input::Frame(link, frame, _) = input {
                match key.open(&frame, link, host) {
                    Some(_) => drop(found.accepted.insert(digest(&frame, link))),
                    None => found.refused += 1,
                }
            }
        }
    }
    Ok(found)
}

/// Copies a record to `to` and attaches the list `accepted` of its datagrams with a valid tag.
pub fn copy(from: &mut Reader, accepted: &BTreeSet<[u8; 16]>, to: impl Write + Seek) -> Result<(), RepairError> {
    let mut copy = Copy::begin(to)?;
    let list: Vec<u8> = accepted.iter().flatten().copied().collect();
    copy.item(Item::Attachment(ACCEPTED.to_owned(), "application/octet-stream".to_owned(), list))?;
    while let Some(item) = from.next_item()? {
        copy.item(item)?;
    }
    copy.finish()?;
    Ok(())
}

/// Returns a key for a replay that accepts exactly the datagrams in the list of a shared record, which is one of the
/// attachments; `None` if it has no list.
pub fn trusted(attached: &[(String, Vec<u8>)]) -> Option<Key> {
    let (_, list) = attached.iter().find(|(name, _)| name == ACCEPTED)?;
    let (digests, _) = list.as_chunks::<16>();
    Some(Key::trusting(digests.iter().copied().collect()))
}
