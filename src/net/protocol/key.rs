//! Team key and the keyed tags of datagrams. No other module makes or checks tags.
//!
//! A tag covers the whole datagram, its link and its receiver. The latter two take no bytes in the datagram, but a
//! datagram of one link is not valid on another. Nothing is encrypted. Generation and storage of keys are elsewhere.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::Arc;

use super::codec::{FLAGS_AT, Flags, HEADER_BYTES, MAX_FRAME_BYTES, TAG_BYTES};
use crate::messages::ids::{HostId, LinkId};

/// Length of what is hashed together with a datagram, the id of the link and that of the receiver \[bytes\].
const ASSOCIATED_BYTES: usize = 4;

/// Secret key of a team, known to all its members, which authenticates datagrams. In a replay, a list of the datagrams
/// that had a valid tag takes its place.
#[derive(Clone)]
pub struct Key(Secret);

#[derive(Clone)]
enum Secret {
    Bytes([u8; 32]),
    /// In a replay: digests of the datagrams whose tags were valid when they were recorded.
    Accepted(Arc<BTreeSet<[u8; 16]>>),
}

impl Key {
    /// Creates the key from its 32 bytes.
    pub fn new(bytes: [u8; 32]) -> Key {
        Key(Secret::Bytes(bytes))
    }

    /// Creates a substitute for a key, for replays of records only: it accepts exactly the datagrams with these
    /// [`digest`]s, and makes tags of zeros. It gives no protection on a link.
    pub fn trusting(accepted: BTreeSet<[u8; 16]>) -> Key {
        Key(Secret::Accepted(Arc::new(accepted)))
    }

    /// Appends the authentication tag to a datagram on the link `link`, for the host `to`, or for all hosts if `to` is
    /// `None`.
    pub fn seal(&self, datagram: &mut Vec<u8>, link: LinkId, to: Option<HostId>) {
        datagram[FLAGS_AT] |= Flags::TAGGED;
        match &self.0 {
            Secret::Bytes(secret) => {
                let tag = tag_of(secret, datagram, link, to);
                datagram.extend_from_slice(&tag.as_bytes()[..TAG_BYTES]);
            }
            Secret::Accepted(_) => datagram.extend_from_slice(&[0; TAG_BYTES]),
        }
    }

    /// Returns the datagram without its authentication tag; `None` if the tag is not valid for the link `link` and, in
    /// a unicast datagram, for the receiver `here`.
    pub fn open<'a>(&self, datagram: &'a [u8], link: LinkId, here: HostId) -> Option<&'a [u8]> {
        if datagram.len() < HEADER_BYTES + TAG_BYTES || datagram.len() > MAX_FRAME_BYTES {
            return None;
        }
        let (plain, tag) = datagram.split_at(datagram.len() - TAG_BYTES);
        let secret = match &self.0 {
            Secret::Bytes(secret) => secret,
            Secret::Accepted(accepted) => return accepted.contains(&digest(datagram, link)).then_some(plain),
        };
        // The flag is not authenticated yet; it only selects the tag to expect.
        let to = (plain[FLAGS_AT] & Flags::DIRECT != 0).then_some(here);
        // This allocation is faster than clearing a buffer of the largest size.
        let mut hashed = Vec::with_capacity(plain.len() + ASSOCIATED_BYTES);
        hashed.extend_from_slice(plain);
        let expected = tag_of(secret, &mut hashed, link, to);
        // Hashes are compared in constant time; the bytes that are not sent are zero in both.
        (half(&expected.as_bytes()[..TAG_BYTES]) == half(tag)).then_some(plain)
    }
}

/// Returns the keyed hash of a datagram, its link and its receiver. `datagram` is the same afterwards.
fn tag_of(secret: &[u8; 32], datagram: &mut Vec<u8>, link: LinkId, to: Option<HostId>) -> blake3::Hash {
    let length = datagram.len();
    datagram.extend_from_slice(&associated(link, to));
    let hash = blake3::keyed_hash(secret, datagram);
    datagram.truncate(length);
    hash
}

/// Returns a digest of a datagram with its tag and of its link, by which a replay recognizes the datagram.
pub fn digest(datagram: &[u8], link: LinkId) -> [u8; 16] {
    let mut all = datagram.to_vec();
    all.extend_from_slice(&link.0.to_le_bytes());
    let mut short = [0; 16];
    short.copy_from_slice(&blake3::hash(&all).as_bytes()[..16]);
    short
}

fn associated(link: LinkId, to: Option<HostId>) -> [u8; ASSOCIATED_BYTES] {
    let ([a, b], [c, d]) = (link.0.to_le_bytes(), to.map_or(u16::MAX, |host| host.0).to_le_bytes());
    [a, b, c, d]
}

fn half(tag: &[u8]) -> blake3::Hash {
    let mut bytes = [0; 32];
    bytes[..TAG_BYTES].copy_from_slice(tag);
    blake3::Hash::from_bytes(bytes)
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(secret)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tag_holds_for_one_key_one_link_and_one_host() {
        let (key, other) = (Key::new([7; 32]), Key::new([8; 32]));
        let mut sealed = vec![0; HEADER_BYTES];
        sealed[FLAGS_AT] = Flags::DIRECT;
        key.seal(&mut sealed, LinkId(1), Some(HostId(4)));
        assert_eq!(sealed.len(), HEADER_BYTES + TAG_BYTES);
        assert!(key.open(&sealed, LinkId(1), HostId(4)).is_some());
        assert!(key.open(&sealed, LinkId(2), HostId(4)).is_none());
        assert!(key.open(&sealed, LinkId(1), HostId(5)).is_none());
        assert!(other.open(&sealed, LinkId(1), HostId(4)).is_none());
        assert!(!format!("{key:?}").contains('7'), "a key is never printed");
    }
}
