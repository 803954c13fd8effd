//! Tags of datagrams, and their encryption, under one key or under those of the pairs of members. `key` has these keys.

use std::borrow::Cow;
use std::collections::BTreeMap;

use super::cipher::{ASSOCIATED_BYTES, Associated, Cipher};
use super::codec::{self, FLAGS_AT, Flags, SHORT_TAG_BYTES, TAG_BYTES};
use crate::messages::ids::{HostId, LinkId};

/// Key of 32 bytes.
pub type Bytes = [u8; 32];

/// Keys of one member of a team: that of all members, under which datagrams are hashed, and those of the pairs.
#[derive(Clone)]
pub struct Pairs {
    /// Key of all members.
    pub team: Shared,
    /// For each member, this one included: the key that only the two have. Short tags are in this order.
    pub pairs: BTreeMap<HostId, Shared>,
}

/// Key that several members have, and its cipher if their datagrams are confidential.
#[derive(Clone)]
pub struct Shared {
    /// The key.
    pub bytes: Bytes,
    cipher: Option<Cipher>,
}

impl Shared {
    /// Returns the key without a cipher.
    pub fn new(bytes: Bytes) -> Shared {
        Shared { bytes, cipher: None }
    }

    /// Returns the key with its cipher.
    pub fn with_cipher(self) -> Shared {
        Shared { cipher: Some(Cipher::new(&self.bytes)), ..self }
    }

    /// Appends the one tag of a datagram, after it has encrypted the blocks if the flags say so.
    pub fn seal(&self, datagram: &mut Vec<u8>, associated: Associated) {
        if let Some(cipher) = self.cipher_of(datagram) {
            return cipher.encrypt(datagram, associated);
        }
        let tag = tag_of(&self.bytes, datagram, associated);
        datagram.extend_from_slice(&tag.as_bytes()[..TAG_BYTES]);
    }

    /// Returns a datagram without its one tag, and as it was in clear; `None` if the tag is not valid.
    pub fn open<'a>(&self, datagram: &'a [u8], associated: Associated) -> Option<Cow<'a, [u8]>> {
        // A short tag is a part of a datagram for each member.
        if Flags(datagram[FLAGS_AT]).has(Flags::FOR_EACH) {
            return None;
        }
        if codec::is_encrypted(datagram) {
            return self.cipher_of(datagram)?.decrypt(datagram, associated).map(Cow::Owned);
        }
        let plain = codec::untagged(datagram);
        let (expected, tag) = (hash_of(&self.bytes, plain, associated), &datagram[plain.len()..]);
        // Hashes are compared in constant time.
        let valid = tag.len() == TAG_BYTES && padded(&expected.as_bytes()[..TAG_BYTES]) == padded(tag);
        valid.then_some(plain.into())
    }

    /// Returns the cipher if the flags of the datagram say that it is encrypted.
    fn cipher_of(&self, datagram: &[u8]) -> Option<&Cipher> {
        self.cipher.as_ref().filter(|_| codec::is_encrypted(datagram))
    }
}

impl Pairs {
    /// Appends a short tag for each member to a datagram for all, after it has encrypted the blocks if the flags say
    /// so.
    pub fn seal(&self, datagram: &mut Vec<u8>, associated: Associated) {
        datagram[FLAGS_AT] |= Flags::FOR_EACH;
        if let Some(cipher) = self.team.cipher_of(datagram) {
            cipher.encrypt(datagram, associated);
        }
        let hash = tag_of(&self.team.bytes, datagram, associated);
        for pair in self.pairs.values() {
            datagram.extend_from_slice(&short_tag(&pair.bytes, &hash));
        }
        datagram.push(self.pairs.len() as u8);
    }

    /// Returns a datagram for all without its tags, and as it was in clear; `None` if the short tag that its sender
    /// makes for this member `here` with the key `pair` of the two is not valid.
    pub fn open<'a>(
        &self,
        datagram: &'a [u8],
        (associated, here): (Associated, HostId),
        pair: &Bytes,
    ) -> Option<Cow<'a, [u8]>> {
        let plain = codec::untagged(datagram);
        let tags = &datagram[plain.len()..];
        if !Flags(datagram[FLAGS_AT]).has(Flags::FOR_EACH) || tags.len() != self.pairs.len() * SHORT_TAG_BYTES + 1 {
            return None;
        }
        let place = self.pairs.keys().position(|member| *member == here)?;
        let expected = short_tag(pair, &hash_of(&self.team.bytes, plain, associated));
        if padded(&expected) != padded(&tags[place * SHORT_TAG_BYTES..][..SHORT_TAG_BYTES]) {
            return None;
        }
        if codec::is_encrypted(datagram) {
            return self.team.cipher_of(datagram)?.decrypt(plain, associated).map(Cow::Owned);
        }
        Some(plain.into())
    }
}

/// Returns the tag of a datagram for one of its receivers: a keyed hash of the datagram's hash under the team's key.
fn short_tag(pair: &Bytes, hash: &blake3::Hash) -> [u8; SHORT_TAG_BYTES] {
    let mut tag = [0; SHORT_TAG_BYTES];
    tag.copy_from_slice(&blake3::keyed_hash(pair, hash.as_bytes()).as_bytes()[..SHORT_TAG_BYTES]);
    tag
}

/// Returns a short tag of bytes that are no datagram, by the key of a pair.
pub(super) fn short(pair: &Bytes, bytes: &[u8]) -> [u8; SHORT_TAG_BYTES] {
    short_tag(pair, &blake3::hash(bytes))
}

/// Returns whether `tag` is the short tag of bytes that are no datagram, by the key of a pair.
pub(super) fn is_short(pair: &Bytes, bytes: &[u8], tag: &[u8]) -> bool {
    tag.len() == SHORT_TAG_BYTES && padded(&short(pair, bytes)) == padded(tag)
}

/// Returns the keyed hash of a datagram, as [`tag_of`] does, of bytes that cannot be changed.
fn hash_of(secret: &Bytes, plain: &[u8], associated: Associated) -> blake3::Hash {
    // This allocation is faster than clearing a buffer of the largest size.
    let mut hashed = Vec::with_capacity(plain.len() + ASSOCIATED_BYTES);
    hashed.extend_from_slice(plain);
    tag_of(secret, &mut hashed, associated)
}

/// Returns the keyed hash of a datagram, its link and its receiver. `datagram` is the same afterwards.
fn tag_of(secret: &Bytes, datagram: &mut Vec<u8>, associated: Associated) -> blake3::Hash {
    let length = datagram.len();
    datagram.extend_from_slice(&associated);
    let hash = blake3::keyed_hash(secret, datagram);
    datagram.truncate(length);
    hash
}

/// Returns the associated data of a datagram, which is authenticated and not sent: its link, and its receiver if it
/// has one.
pub fn associated(link: LinkId, to: Option<HostId>) -> Associated {
    let ([a, b], [c, d]) = (link.0.to_le_bytes(), to.map_or(u16::MAX, |host| host.0).to_le_bytes());
    [a, b, c, d]
}

/// Returns a tag as a hash, with zeros after it: hashes are compared in constant time.
fn padded(tag: &[u8]) -> blake3::Hash {
    let mut bytes = [0; 32];
    bytes[..tag.len()].copy_from_slice(tag);
    blake3::Hash::from_bytes(bytes)
}
