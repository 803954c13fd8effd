//! The team key: a keyed tag on every datagram, made and checked here and nowhere else.
//!
//! The tag covers the whole datagram, and the link and the host that it is meant for, which cost no bytes: a
//! datagram of one link proves nothing on another. It hides nothing; whoever listens can read. Where keys come from
//! and where they are kept is not known here.

use std::fmt;

use super::codec::{FLAGS_AT, Flags, HEADER_BYTES, MAX_FRAME_BYTES, TAG_BYTES};
use crate::messages::ids::{HostId, LinkId};

/// Bytes that say where a datagram belongs.
const PLACE_BYTES: usize = 4;

/// What every member of a team knows and nobody else.
#[derive(Clone)]
pub struct Key([u8; 32]);

impl Key {
    /// The key with these bytes.
    pub fn new(bytes: [u8; 32]) -> Key {
        Key(bytes)
    }

    /// Adds the tag to a datagram without one; `to` is the host it is for, or none if for all.
    pub fn seal(&self, datagram: &mut Vec<u8>, link: LinkId, to: Option<HostId>) {
        datagram[FLAGS_AT] |= Flags::TAGGED;
        let tag = self.tag(datagram, link, to);
        datagram.extend_from_slice(&tag.as_bytes()[..TAG_BYTES]);
    }

    /// The datagram without its tag, if that is right for `link` and, where it is for one host, for `here`.
    pub fn open<'a>(&self, datagram: &'a [u8], link: LinkId, here: HostId) -> Option<&'a [u8]> {
        if datagram.len() < HEADER_BYTES + TAG_BYTES || datagram.len() > MAX_FRAME_BYTES {
            return None;
        }
        let (plain, tag) = datagram.split_at(datagram.len() - TAG_BYTES);
        // Nothing is believed yet: the flag only says which of two tags to expect.
        let to = (plain[FLAGS_AT] & Flags::DIRECT != 0).then_some(here);
        // A buffer of the longest frame's length would take longer to clear than this one to get.
        let mut hashed = Vec::with_capacity(plain.len() + PLACE_BYTES);
        hashed.extend_from_slice(plain);
        let expected = self.tag(&mut hashed, link, to);
        // Hashes compare in constant time; the half that is not sent is zero in both.
        (half(&expected.as_bytes()[..TAG_BYTES]) == half(tag)).then_some(plain)
    }

    /// The whole hash of a datagram and its place, which it has room for or grows for.
    fn tag(&self, datagram: &mut Vec<u8>, link: LinkId, to: Option<HostId>) -> blake3::Hash {
        let length = datagram.len();
        datagram.extend_from_slice(&place(link, to));
        let hash = blake3::keyed_hash(&self.0, datagram);
        datagram.truncate(length);
        hash
    }
}

fn place(link: LinkId, to: Option<HostId>) -> [u8; PLACE_BYTES] {
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
