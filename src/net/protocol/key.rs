//! Keys of a process, and the keyed tags of datagrams. No other module makes or checks tags.
//!
//! A team has one key of all its members, or each member has a key with each other one. In the first case any member
//! can impersonate another. In the second none can: what goes to one host has a tag of that pair's key, what goes to
//! all has a short tag for each member. A tag covers the whole datagram, its link and its receiver. The latter two take
//! no bytes in the datagram, but a datagram of one link is not valid on another. Nothing is encrypted. Generation and
//! storage of keys are elsewhere.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use super::codec::{self, FLAGS_AT, Flags, HEADER_BYTES, MAX_FRAME_BYTES, SHORT_TAG_BYTES, TAG_BYTES};
use super::signatures::Signatures;
use crate::messages::ids::{HostId, LinkId};

/// Length of what is hashed together with a datagram, the id of the link and that of the receiver \[bytes\].
const ASSOCIATED_BYTES: usize = 4;

/// Key of 32 bytes.
type Bytes = [u8; 32];

/// Secret keys with which a process authenticates datagrams. In a replay, a list of the datagrams that had a valid tag
/// takes their place.
#[derive(Clone)]
pub struct Key {
    secret: Secret,
    signatures: Option<Arc<Signatures>>,
}

#[derive(Clone)]
enum Secret {
    /// Key of all members of the team.
    Team(Bytes),
    /// Keys of one member.
    Member(Arc<Member>),
    /// In a replay: digests of the datagrams whose tags were valid when they were recorded.
    Accepted(Arc<BTreeSet<[u8; 16]>>),
}

/// Keys of one member of a team: that of all members, under which datagrams are hashed, and those of the pairs.
struct Member {
    team: Bytes,
    /// For each member, this one included: the key that only the two have. Short tags are in this order.
    pairs: BTreeMap<HostId, Bytes>,
}

impl Key {
    fn of(secret: Secret) -> Key {
        Key { secret, signatures: None }
    }

    /// Returns the keys of a process of a team whose operators sign what ends a stop or a hold.
    pub fn with_signatures(self, signatures: Signatures) -> Key {
        Key { signatures: Some(Arc::new(signatures)), ..self }
    }

    /// Returns the keys by which orders are signed and checked; `None` in a team whose operators sign nothing.
    pub fn signatures(&self) -> Option<&Signatures> {
        self.signatures.as_deref()
    }

    /// Creates the key of a team, known to all its members, from its 32 bytes.
    pub fn new(bytes: Bytes) -> Key {
        Key::of(Secret::Team(bytes))
    }

    /// Creates the keys of one member of a team whose members cannot impersonate each other: `team` is known to all of
    /// them, `pairs` has for each member, this one included, the key that only the two have.
    ///
    /// # Panics
    /// If there are more members than [`MAX_MEMBERS`](codec::MAX_MEMBERS).
    pub fn of_member(team: Bytes, pairs: BTreeMap<HostId, Bytes>) -> Key {
        assert!(pairs.len() <= codec::MAX_MEMBERS, "whoever reads keys checks their number");
        Key::of(Secret::Member(Arc::new(Member { team, pairs })))
    }

    /// Creates a substitute for a key, for replays of records only: it accepts exactly the datagrams with these
    /// [`digest`]s, and makes tags of zeros. It gives no protection on a link.
    pub fn trusting(accepted: BTreeSet<[u8; 16]>) -> Key {
        Key::of(Secret::Accepted(Arc::new(accepted)))
    }

    /// Appends the authentication tag to a datagram on the link `link`, for the host `to`, or for all hosts if `to` is
    /// `None`. What a member sends to a host that is no member has a tag of zeros, which nobody accepts.
    pub fn seal(&self, datagram: &mut Vec<u8>, link: LinkId, to: Option<HostId>) {
        datagram[FLAGS_AT] |= Flags::TAGGED;
        match (&self.secret, to) {
            (Secret::Team(secret), _) => {
                let tag = tag_of(secret, datagram, link, to);
                datagram.extend_from_slice(&tag.as_bytes()[..TAG_BYTES]);
            }
            (Secret::Member(member), Some(host)) => {
                let tag = member.pairs.get(&host).map(|pair| *tag_of(pair, datagram, link, to).as_bytes());
                datagram.extend_from_slice(&tag.unwrap_or_default()[..TAG_BYTES]);
            }
            (Secret::Member(member), None) => {
                datagram[FLAGS_AT] |= Flags::FOR_EACH;
                let digest = tag_of(&member.team, datagram, link, None);
                for pair in member.pairs.values() {
                    datagram.extend_from_slice(&short_tag(pair, &digest));
                }
                datagram.push(member.pairs.len() as u8);
            }
            (Secret::Accepted(_), _) => datagram.extend_from_slice(&[0; TAG_BYTES]),
        }
    }

    /// Returns the datagram without its authentication tag; `None` if the tag is not valid for the link `link` and, in
    /// a unicast datagram, for the receiver `here`.
    pub fn open<'a>(&self, datagram: &'a [u8], link: LinkId, here: HostId) -> Option<&'a [u8]> {
        if datagram.len() < HEADER_BYTES + TAG_BYTES || datagram.len() > MAX_FRAME_BYTES {
            return None;
        }
        // The flags are not authenticated yet; they only select the tag to expect.
        let flags = Flags(datagram[FLAGS_AT]);
        let plain = codec::untagged(datagram);
        let tag = &datagram[plain.len()..];
        let to = flags.has(Flags::DIRECT).then_some(here);
        let secret = match &self.secret {
            Secret::Accepted(accepted) => return accepted.contains(&digest(datagram, link)).then_some(plain),
            Secret::Team(secret) => secret,
            Secret::Member(member) => {
                let pair = member.pairs.get(&codec::peek(datagram).ok()?.sender)?;
                match to {
                    Some(_) => pair,
                    None => return member.is_valid((plain, tag), (flags, link, here), pair).then_some(plain),
                }
            }
        };
        // A short tag is a part of a datagram for each member; hashes are compared in constant time.
        let expected = hash_of(secret, plain, link, to);
        let whole = tag.len() == TAG_BYTES && !flags.has(Flags::FOR_EACH);
        (whole && padded(&expected.as_bytes()[..TAG_BYTES]) == padded(tag)).then_some(plain)
    }
}

impl Member {
    /// Returns whether a datagram for all, in two parts, has the short tag that its sender makes for this member `here`
    /// with the key `pair` of the two.
    fn is_valid(
        &self,
        (plain, tags): (&[u8], &[u8]),
        (flags, link, here): (Flags, LinkId, HostId),
        pair: &Bytes,
    ) -> bool {
        if !flags.has(Flags::FOR_EACH) || tags.len() != self.pairs.len() * SHORT_TAG_BYTES + 1 {
            return false;
        }
        let Some(place) = self.pairs.keys().position(|member| *member == here) else { return false };
        let expected = short_tag(pair, &hash_of(&self.team, plain, link, None));
        padded(&expected) == padded(&tags[place * SHORT_TAG_BYTES..][..SHORT_TAG_BYTES])
    }
}

/// Returns the tag of a datagram for one of its receivers: a keyed hash of the datagram's hash under the team's key.
fn short_tag(pair: &Bytes, hash: &blake3::Hash) -> [u8; SHORT_TAG_BYTES] {
    let mut tag = [0; SHORT_TAG_BYTES];
    tag.copy_from_slice(&blake3::keyed_hash(pair, hash.as_bytes()).as_bytes()[..SHORT_TAG_BYTES]);
    tag
}

/// Returns the keyed hash of a datagram, as [`tag_of`] does, of bytes that cannot be changed.
fn hash_of(secret: &Bytes, plain: &[u8], link: LinkId, to: Option<HostId>) -> blake3::Hash {
    // This allocation is faster than clearing a buffer of the largest size.
    let mut hashed = Vec::with_capacity(plain.len() + ASSOCIATED_BYTES);
    hashed.extend_from_slice(plain);
    tag_of(secret, &mut hashed, link, to)
}

/// Returns the keyed hash of a datagram, its link and its receiver. `datagram` is the same afterwards.
fn tag_of(secret: &Bytes, datagram: &mut Vec<u8>, link: LinkId, to: Option<HostId>) -> blake3::Hash {
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

/// Returns a tag as a hash, with zeros after it: hashes are compared in constant time.
fn padded(tag: &[u8]) -> blake3::Hash {
    let mut bytes = [0; 32];
    bytes[..tag.len()].copy_from_slice(tag);
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

    /// Keys of the members of these numbers, in order. A pair's key is made of the two numbers.
    fn members(numbers: &[u16]) -> Vec<Key> {
        let pair = |one: u16, other: u16| {
            let mut bytes = [1; 32];
            bytes[..2].copy_from_slice(&one.min(other).to_le_bytes());
            bytes[2..4].copy_from_slice(&one.max(other).to_le_bytes());
            bytes
        };
        let of = |one: u16| Key::of_member([9; 32], numbers.iter().map(|&n| (HostId(n), pair(one, n))).collect());
        numbers.iter().copied().map(of).collect()
    }

    fn datagram(sender: u16, flags: u8) -> Vec<u8> {
        let flags = Flags(flags);
        let mut plain =
            codec::start(&codec::Header { flags, team: 7, sender: HostId(sender), incarnation: 1, sequence: 1 });
        plain.extend_from_slice(&[5; 40]);
        plain
    }

    #[test]
    fn no_member_makes_what_another_accepts_as_a_thirds() {
        let keys = members(&[0, 1, 2, 0xc001]);
        for (to, flags) in [(None, 0), (Some(HostId(1)), Flags::DIRECT)] {
            let mut honest = datagram(0, flags);
            let plain = honest.len();
            keys[0].seal(&mut honest, LinkId(1), to);
            assert_eq!(honest.len() - plain, if to.is_some() { TAG_BYTES } else { 4 * SHORT_TAG_BYTES + 1 });
            let opened = keys[1].open(&honest, LinkId(1), HostId(1)).expect("it is of host 0");
            assert_eq!(opened.len(), plain);
            assert_eq!(codec::untagged(&honest), opened, "a record's reader has no key");
            assert!(keys[1].open(&honest, LinkId(2), HostId(1)).is_none(), "on another link");
            assert_eq!(keys[2].open(&honest, LinkId(1), HostId(2)).is_some(), to.is_none(), "what is for host 1 alone");
            let all = (0..honest.len() * 8).all(|bit| {
                let mut turned = honest.clone();
                turned[bit / 8] ^= 1 << (bit % 8);
                // The short tags of others are theirs to check.
                let others = to.is_none() && (plain..honest.len() - 1).contains(&(bit / 8));
                let own = (plain + SHORT_TAG_BYTES..plain + 2 * SHORT_TAG_BYTES).contains(&(bit / 8));
                keys[1].open(&turned, LinkId(1), HostId(1)).is_some() == (others && !own)
            });
            assert!(all, "any flipped bit");
            // Host 2 and the team's key make it in the name of host 0.
            for forger in [&keys[2], &Key::new([9; 32])] {
                let mut forged = datagram(0, flags);
                forger.seal(&mut forged, LinkId(1), to);
                assert!(keys[1].open(&forged, LinkId(1), HostId(1)).is_none());
                assert!(keys[3].open(&forged, LinkId(1), HostId(0xc001)).is_none());
            }
            // A part of an honest one, as one for host 1 alone or for all.
            let mut other = honest.clone();
            other[FLAGS_AT] ^= Flags::DIRECT;
            assert!(keys[1].open(&other, LinkId(1), HostId(1)).is_none());
        }
        let mut own = datagram(1, 0);
        keys[1].seal(&mut own, LinkId(1), None);
        assert!(keys[1].open(&own, LinkId(1), HostId(1)).is_some(), "of another process of the same operator");
        let mut stranger = datagram(7, 0);
        keys[2].seal(&mut stranger, LinkId(1), None);
        assert!(keys[1].open(&stranger, LinkId(1), HostId(1)).is_none(), "of no member");
        let mut unknown = datagram(2, Flags::DIRECT);
        keys[2].seal(&mut unknown, LinkId(1), Some(HostId(9)));
        assert!(members(&[2, 9])[1].open(&unknown, LinkId(1), HostId(9)).is_none(), "for no member");
    }
}
