//! Copies records so that they can be shared without the team's key: an attached list states which datagrams had a
//! valid tag, and a replay uses it instead of the key. Datagrams of a confidential team are in clear in the copy.

use std::collections::BTreeSet;
use std::io::{Seek, Write};

use super::keys::RecordedKey;
use super::reader::{Attachment, Message, Messages, ReadError, Reader};
use super::repair::{self, RepairError};
use super::tape;
use murmurate::graph::inputs::Input;
use murmurate::messages::ids::LinkId;
use murmurate::net::protocol::codec::{self, Frame};
use murmurate::net::protocol::key::{Key, digest};

/// Name of the attachment that a record without the team's key has: the list of the 16-byte digests of the datagrams
/// that had a valid authentication tag.
pub const ACCEPTED: &str = "murmurate.accepted";

/// Result of checking the authentication tags of a record's datagrams.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Digests of the datagrams with a valid authentication tag, as they are in a copy.
    pub accepted: BTreeSet<[u8; 16]>,
    /// Number of datagrams without a valid authentication tag.
    pub refused: u64,
}

/// Checks the authentication tags of all datagrams that a host has received, with its key. `messages` are those of the
/// host's record.
pub fn accepted(mut messages: Messages, mut key: RecordedKey) -> Result<Found, ReadError> {
    let mut found = Found::default();
    while let Some(message) = messages.next_message()? {
        if message.channel.topic != "/tape/turn" {
            continue;
        }
        let Some(turn) = tape::read(&message.data) else { continue };
        for input in turn.inputs {
            if let Input::Frame(link, frame, _) = &input {
                match opened((frame, *link), &key) {
                    Some(frame) => drop(found.accepted.insert(digest(&frame, *link))),
                    None => found.refused += 1,
                }
            }
            key.follow(turn.now, &input);
        }
    }
    Ok(found)
}

/// Returns a datagram that a host with the key `key` has received as it is in a copy: unchanged, or if it is encrypted
/// in clear, with a tag of zeros. `None` if its tag is not valid.
fn opened((frame, link): (&Frame, LinkId), key: &RecordedKey) -> Option<Frame> {
    let plain = key.open(frame, link)?;
    if !codec::is_encrypted(frame) {
        return Some(Frame::clone(frame));
    }
    let mut clear = plain.into_owned();
    Key::trusting(BTreeSet::new()).seal(&mut clear, link, None);
    Some(clear.into())
}

/// Copies the record of a host with the key `key` to `to`, with `accepted`, the digests of the datagrams that had a
/// valid authentication tag, as an attachment. What has arrived encrypted is in clear there.
pub fn copy(
    from: &mut Reader,
    mut key: RecordedKey,
    accepted: &BTreeSet<[u8; 16]>,
    to: impl Write + Seek,
) -> Result<(), RepairError> {
    let data = accepted.iter().flatten().copied().collect();
    let (name, media_type) = (ACCEPTED.to_owned(), "application/octet-stream".to_owned());
    let list = Attachment { log_time: 0, create_time: 0, name, media_type, data };
    repair::copy_changed(from, vec![list], to, |message| decrypt(message, &mut key))?;
    Ok(())
}

/// Replaces the encrypted datagrams in a turn of the host's event loop by those in clear. Other messages are as before.
fn decrypt(message: &mut Message, key: &mut RecordedKey) {
    if message.channel.topic != "/tape/turn" {
        return;
    }
    let Some(mut turn) = tape::read(&message.data) else { return };
    let mut changed = false;
    for input in &mut turn.inputs {
        key.follow(turn.now, input);
        if let Input::Frame(link, frame, _) = input
            && codec::is_encrypted(frame)
            && let Some(clear) = opened((frame, *link), key)
        {
            (*frame, changed) = (clear, true);
        }
    }
    if changed {
        message.data.clear();
        tape::begin(&mut message.data, turn.now, turn.sent);
        turn.inputs.iter().for_each(|input| tape::add(&mut message.data, input));
    }
}

/// Returns a key with which a replay accepts exactly the datagrams that had a valid authentication tag in the recorded
/// run. Their list is one of the files attached to the record; `None` if there is no list.
pub fn trusted(attached: &[(String, Vec<u8>)]) -> Option<Key> {
    let (_, list) = attached.iter().find(|(name, _)| name == ACCEPTED)?;
    let (digests, _) = list.as_chunks::<16>();
    Some(Key::trusting(digests.iter().copied().collect()))
}
