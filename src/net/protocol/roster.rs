//! Rosters: the members of a team with their public keys, in a numbered list that the team's root key signs. Each one
//! has a new key that all its members have, encrypted for each of them, and takes the place of the one before it.
//!
//! The root key is on no robot. A roster is checked without any other key, so hosts repeat it as it is, also to members
//! that know the roster before it alone. Little-endian:
//!
//! | bytes | field |
//! |---|---|
//! | 4 | number of the roster |
//! | 1 | 1 if the keys of the roster before it stay valid for a while, else 0 |
//! | 24 | random nonce |
//! | 1 | number of members |
//! | 34 each | number of the member (2), its public key |
//! | 48 each | the key of all members, encrypted for this one (XChaCha20-Poly1305) |
//! | 64 | signature by the root key (Ed25519) |

use std::collections::BTreeMap;

use chacha20poly1305::{AeadInOut, KeyInit, XChaCha20Poly1305};
use ed25519_dalek::{Signer, SigningKey, VerifyingKey};

use super::tags::Bytes;
use crate::messages::ids::HostId;
use crate::messages::release::MAX_MEMBERS;
use crate::time::Span;

/// Time after a planned change until which datagrams with the keys before it are accepted.
pub const ACCEPTS_FOR: Span = Span::from_millis(10_000);

/// Length of a key \[bytes\].
const KEY: usize = 32;
/// Length of the nonce of a roster \[bytes\].
pub const NONCE_BYTES: usize = 24;
const TAG: usize = 16;
const ENTRY: usize = 2 + KEY;
const WRAPPED: usize = KEY + TAG;
const SIGNATURE: usize = 64;
/// Length of what is before the members \[bytes\].
const HEAD: usize = 4 + 1 + NONCE_BYTES + 1;

/// Context of what is signed, so that a signature of something else is never one of a roster.
const SIGNED: &[u8] = b"murmurate 2026-11-28 roster";

/// List of the members of a team, hosts and operators.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Roster {
    /// Number of the roster, from 1. A higher number takes the place of a lower one, and never the reverse.
    pub number: u32,
    /// Whether the keys of the roster before it stay valid for a while, so that no message is lost; no if a member was
    /// removed.
    pub planned: bool,
    /// Public key of each member (Ed25519).
    pub members: BTreeMap<HostId, Bytes>,
}

/// Reason why a roster is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RosterError {
    /// It is that of the present keys, or one before it.
    #[error("it is not newer than the roster of the present keys")]
    Known,
    /// It has not the form of a roster.
    #[error("it has not the form of a roster")]
    Malformed,
    /// It does not name this member with its key, so nothing in it can be checked.
    #[error("this member is not in it, with this key")]
    Absent,
    /// The root key of this team has not made it.
    #[error("the root key of this team has not signed it")]
    Unsigned,
}

/// Makes the roster `roster` of the team with the number `team`. `root` is the secret root key, `shared` the new key of
/// all members, and `wrap` returns the key by which `shared` is encrypted for a member with this number and public
/// key. `None` if there are too many members, or none can be made for one.
pub(super) fn seal(
    (team, roster): (u16, &Roster),
    root: &Bytes,
    shared: &Bytes,
    nonce: [u8; NONCE_BYTES],
    wrap: impl Fn(HostId, &Bytes) -> Option<Bytes>,
) -> Option<Vec<u8>> {
    let count = u8::try_from(roster.members.len()).ok().filter(|count| usize::from(*count) <= MAX_MEMBERS)?;
    let mut bytes = roster.number.to_le_bytes().to_vec();
    bytes.push(u8::from(roster.planned));
    bytes.extend_from_slice(&nonce);
    bytes.push(count);
    for (member, public) in &roster.members {
        bytes.extend_from_slice(&member.0.to_le_bytes());
        bytes.extend_from_slice(public);
    }
    let listed = beside(team, &bytes);
    for (member, public) in &roster.members {
        let mut wrapped = *shared;
        let cipher = XChaCha20Poly1305::new(&wrap(*member, public)?.into());
        let tag = cipher.encrypt_inout_detached(&nonce.into(), &listed, wrapped.as_mut_slice().into()).ok()?;
        bytes.extend_from_slice(&wrapped);
        bytes.extend_from_slice(&tag);
    }
    let signature = SigningKey::from_bytes(root).sign(&signed(team, &bytes));
    bytes.extend_from_slice(&signature.to_bytes());
    Some(bytes)
}

/// Returns the roster in `bytes` and the key of all its members, as the member `me` of the team `team` takes it, whose
/// roster has the number `known`. `root` is the public root key, `wrap` the key by which things are encrypted for this
/// member. The cheap checks come first: only the root key and this member make what passes them.
pub(super) fn open(
    bytes: &[u8],
    (team, me, public): (u16, HostId, &Bytes),
    known: u32,
    (root, wrap): (&Bytes, &Bytes),
) -> Result<(Roster, Bytes), RosterError> {
    let roster = read(bytes)?;
    if roster.number <= known {
        return Err(RosterError::Known);
    }
    let place = roster.members.keys().position(|member| *member == me).ok_or(RosterError::Absent)?;
    if roster.members.get(&me) != Some(public) {
        return Err(RosterError::Absent);
    }
    let (listed, rest) = bytes.split_at(HEAD + roster.members.len() * ENTRY);
    let (wrapped, tag) = rest[place * WRAPPED..][..WRAPPED].split_at(KEY);
    let nonce: [u8; NONCE_BYTES] = bytes[5..5 + NONCE_BYTES].try_into().expect("that many");
    let tag: [u8; TAG] = tag.try_into().expect("that many");
    let mut shared: Bytes = wrapped.try_into().expect("that many");
    XChaCha20Poly1305::new(&(*wrap).into())
        .decrypt_inout_detached(&nonce.into(), &beside(team, listed), shared.as_mut_slice().into(), &tag.into())
        .map_err(|_| RosterError::Unsigned)?;
    let (all, signature) = bytes.split_last_chunk::<SIGNATURE>().expect("it has the form of one");
    let root = VerifyingKey::from_bytes(root).map_err(|_| RosterError::Unsigned)?;
    root.verify_strict(&signed(team, all), &ed25519_dalek::Signature::from_bytes(signature))
        .map_err(|_| RosterError::Unsigned)?;
    Ok((roster, shared))
}

/// Returns the roster in `bytes`. Nothing of it is checked but its form.
pub fn read(bytes: &[u8]) -> Result<Roster, RosterError> {
    let (head, rest) = bytes.split_first_chunk::<HEAD>().ok_or(RosterError::Malformed)?;
    let [n0, n1, n2, n3, planned, ..] = *head;
    let count = usize::from(head[HEAD - 1]);
    if rest.len() != count * (ENTRY + WRAPPED) + SIGNATURE || count > MAX_MEMBERS || planned > 1 {
        return Err(RosterError::Malformed);
    }
    let entries = rest.as_chunks::<ENTRY>().0.iter().take(count);
    let entry = |[low, high, public @ ..]: &[u8; ENTRY]| (HostId(u16::from_le_bytes([*low, *high])), *public);
    let members: BTreeMap<HostId, Bytes> = entries.map(entry).collect();
    let ascends = rest.as_chunks::<ENTRY>().0.iter().take(count).map(entry).map(|(member, _)| member).is_sorted();
    if members.len() != count || !ascends {
        return Err(RosterError::Malformed);
    }
    Ok(Roster { number: u32::from_le_bytes([n0, n1, n2, n3]), planned: planned == 1, members })
}

/// Returns what is authenticated beside the encrypted key of all members: the team, and the roster until there.
fn beside(team: u16, listed: &[u8]) -> Vec<u8> {
    [&team.to_le_bytes(), listed].concat()
}

fn signed(team: u16, bytes: &[u8]) -> Vec<u8> {
    [SIGNED, &team.to_le_bytes(), bytes].concat()
}
