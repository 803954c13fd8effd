//! Rosters: the members of a team with their public keys, in a numbered list that the team's root key signs. Each one
//! has a new key that all its members have, encrypted for each of them, and takes the place of the one before it.
//!
//! The root key is on no robot. A roster is checked without any other key, so hosts repeat it as it is, also to members
//! that know the roster before it alone. It consists of a head and pages, since more than 12 members are too many for
//! one datagram: each datagram has the head, the index of a page in one byte, and that page. Files have the head and
//! all pages. Little-endian, the head:
//!
//! | bytes | field |
//! |---|---|
//! | 4 | number of the roster |
//! | 1 | 1 if the keys of the roster before it stay valid for a while, else 0 |
//! | 24 | random nonce |
//! | 1 | number of pages, 1 or 2 |
//! | 32 each | hash of each page (BLAKE3) |
//! | 64 | signature by the root key of all before (Ed25519) |
//!
//! A page:
//!
//! | bytes | field |
//! |---|---|
//! | 1 | number of members, 1 to 12 |
//! | 34 each | number of the member (2), its public key |
//! | 48 each | the key of all members, encrypted for this one (XChaCha20-Poly1305) |

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
const HASH: usize = 32;
const SIGNATURE: usize = 64;
/// Length of what is before the hashes of the pages \[bytes\].
const FIXED: usize = 4 + 1 + NONCE_BYTES + 1;
/// Largest number of members on a page: so many fit into a datagram with the head.
const PAGE: usize = 12;
const MAX_PAGES: usize = MAX_MEMBERS.div_ceil(PAGE);

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
    /// This page of it has arrived before, and another one is missing.
    #[error("this page of it is known")]
    Repeated,
}

/// Head of a roster.
#[derive(Clone, Copy)]
pub struct Head<'a> {
    /// All of it.
    pub(super) bytes: &'a [u8],
    /// Number of the roster.
    pub number: u32,
    planned: bool,
    nonce: [u8; NONCE_BYTES],
    hashes: &'a [[u8; HASH]],
}

/// Page of a roster.
#[derive(Clone, Copy)]
pub struct Page<'a> {
    bytes: &'a [u8],
    entries: &'a [[u8; ENTRY]],
    wrapped: &'a [[u8; WRAPPED]],
}

impl<'a> Head<'a> {
    /// Reads the head at the start of `bytes`, and returns what is after it, too.
    fn read(bytes: &'a [u8]) -> Result<(Head<'a>, &'a [u8]), RosterError> {
        let fixed = bytes.first_chunk::<FIXED>().ok_or(RosterError::Malformed)?;
        let [n0, n1, n2, n3, planned, nonce @ .., pages] = *fixed;
        let length = FIXED + usize::from(pages) * HASH + SIGNATURE;
        let (head, rest) = bytes.split_at_checked(length).ok_or(RosterError::Malformed)?;
        if planned > 1 || !(1..=MAX_PAGES).contains(&usize::from(pages)) {
            return Err(RosterError::Malformed);
        }
        let hashes = head[FIXED..length - SIGNATURE].as_chunks().0;
        let number = u32::from_le_bytes([n0, n1, n2, n3]);
        Ok((Head { bytes: head, number, planned: planned == 1, nonce, hashes }, rest))
    }

    /// Returns whether it says that `page` is its page `index`.
    fn has(&self, index: usize, page: &Page) -> bool {
        self.hashes.get(index) == Some(blake3::hash(page.bytes).as_bytes())
    }

    /// Returns what is authenticated beside the encrypted key of all members on `page`.
    fn beside(&self, team: u16, page: &Page) -> Vec<u8> {
        beside(team, &self.bytes[..4 + 1 + NONCE_BYTES], page.entries.as_flattened())
    }

    /// Returns whether the root key of the team with this number has made it.
    pub(super) fn is_signed(&self, team: u16, root: &Bytes) -> bool {
        let Some((all, signature)) = self.bytes.split_last_chunk::<SIGNATURE>() else { return false };
        let signature = ed25519_dalek::Signature::from_bytes(signature);
        VerifyingKey::from_bytes(root).is_ok_and(|root| root.verify_strict(&signed(team, all), &signature).is_ok())
    }
}

impl<'a> Page<'a> {
    /// Reads the page at the start of `bytes`, and returns what is after it, too.
    fn read(bytes: &'a [u8]) -> Result<(Page<'a>, &'a [u8]), RosterError> {
        let count = bytes.first().map_or(0, |count| usize::from(*count));
        let length = 1 + count * (ENTRY + WRAPPED);
        let (page, rest) = bytes.split_at_checked(length).ok_or(RosterError::Malformed)?;
        if !(1..=PAGE).contains(&count) {
            return Err(RosterError::Malformed);
        }
        let (entries, wrapped) = page[1..].split_at(count * ENTRY);
        Ok((Page { bytes: page, entries: entries.as_chunks().0, wrapped: wrapped.as_chunks().0 }, rest))
    }

    fn members(&self) -> impl Iterator<Item = (HostId, Bytes)> {
        let entry = |[low, high, public @ ..]: &[u8; ENTRY]| (HostId(u16::from_le_bytes([*low, *high])), *public);
        self.entries.iter().map(entry)
    }
}

/// Makes the roster `roster` of the team with the number `team`. `root` is the secret root key, `shared` the new key of
/// all members, and `wrap` returns the key by which `shared` is encrypted for a member with this number and public
/// key. `None` if there are too many members or none, or no key can be made for one.
pub(super) fn seal(
    (team, roster): (u16, &Roster),
    root: &Bytes,
    shared: &Bytes,
    nonce: [u8; NONCE_BYTES],
    wrap: impl Fn(HostId, &Bytes) -> Option<Bytes>,
) -> Option<Vec<u8>> {
    let members: Vec<(HostId, Bytes)> = roster.members.iter().map(|(member, key)| (*member, *key)).collect();
    if members.is_empty() || members.len() > MAX_MEMBERS {
        return None;
    }
    let mut head = roster.number.to_le_bytes().to_vec();
    head.push(u8::from(roster.planned));
    head.extend_from_slice(&nonce);
    let mut pages = Vec::new();
    for members in members.chunks(PAGE) {
        let entry = |(member, public): &(HostId, Bytes)| [&member.0.to_le_bytes()[..], public].concat();
        let entries: Vec<u8> = members.iter().flat_map(entry).collect();
        let mut page = vec![members.len() as u8];
        page.extend_from_slice(&entries);
        for (member, public) in members {
            let mut wrapped = *shared;
            let cipher = XChaCha20Poly1305::new(&wrap(*member, public)?.into());
            let beside = beside(team, &head, &entries);
            let tag = cipher.encrypt_inout_detached(&nonce.into(), &beside, wrapped.as_mut_slice().into()).ok()?;
            page.extend_from_slice(&wrapped);
            page.extend_from_slice(&tag);
        }
        pages.push(page);
    }
    head.push(pages.len() as u8);
    head.extend(pages.iter().flat_map(|page| *blake3::hash(page).as_bytes()));
    let signature = SigningKey::from_bytes(root).sign(&signed(team, &head));
    head.extend_from_slice(&signature.to_bytes());
    Some([head, pages.concat()].concat())
}

/// Returns the roster in `bytes`, head and pages, and the key of all its members, as the member `me` of the team `team`
/// takes it, whose roster has the number `known`. `root` is the public root key, `wrap` the key by which things are
/// encrypted for this member.
pub(super) fn open(
    bytes: &[u8],
    who: (u16, HostId, &Bytes),
    known: u32,
    keys: (&Bytes, &Bytes),
) -> Result<(Roster, Bytes), RosterError> {
    let roster = read(bytes)?;
    if roster.number <= known {
        return Err(RosterError::Known);
    }
    let (head, pages) = split(bytes)?;
    let mut opened = pages.iter().enumerate().map(|(index, page)| open_page(&head, (index, page), who, keys));
    let own = opened.find(|opened| !matches!(opened, Err(RosterError::Absent)));
    let shared = own.unwrap_or(Err(RosterError::Absent))?;
    let whole = pages.iter().enumerate().all(|(index, page)| head.has(index, page));
    if whole { Ok((roster, shared)) } else { Err(RosterError::Unsigned) }
}

/// Returns the key of all members from the page of a roster that names the member `me`. The cheap checks come first:
/// only the root key and this member make what passes them.
pub(super) fn open_page(
    head: &Head,
    (index, page): (usize, &Page),
    (team, me, public): (u16, HostId, &Bytes),
    (root, wrap): (&Bytes, &Bytes),
) -> Result<Bytes, RosterError> {
    let place = page.members().position(|member| member == (me, *public)).ok_or(RosterError::Absent)?;
    let (wrapped, tag) = page.wrapped[place].split_first_chunk::<KEY>().expect("that many");
    let (mut shared, tag): (Bytes, [u8; TAG]) = (*wrapped, tag.try_into().expect("that many"));
    XChaCha20Poly1305::new(&(*wrap).into())
        .decrypt_inout_detached(&head.nonce.into(), &head.beside(team, page), shared.as_mut_slice().into(), &tag.into())
        .map_err(|_| RosterError::Unsigned)?;
    let made = head.has(index, page) && head.is_signed(team, root);
    if made { Ok(shared) } else { Err(RosterError::Unsigned) }
}

fn split(bytes: &[u8]) -> Result<(Head<'_>, Vec<Page<'_>>), RosterError> {
    let (head, mut rest) = Head::read(bytes)?;
    let mut pages = Vec::new();
    while !rest.is_empty() {
        let page;
        (page, rest) = Page::read(rest)?;
        pages.push(page);
    }
    if pages.len() == head.hashes.len() { Ok((head, pages)) } else { Err(RosterError::Malformed) }
}

/// Returns the roster in `bytes`, head and pages. Nothing of it is checked but its form.
pub fn read(bytes: &[u8]) -> Result<Roster, RosterError> {
    let (head, pages) = split(bytes)?;
    let listed: Vec<(HostId, Bytes)> = pages.iter().flat_map(Page::members).collect();
    let ascends = listed.is_sorted_by(|(one, _), (next, _)| one < next);
    let full = pages.iter().rev().skip(1).all(|page| page.entries.len() == PAGE);
    if !(ascends && full) || listed.len() > MAX_MEMBERS {
        return Err(RosterError::Malformed);
    }
    Ok(Roster { number: head.number, planned: head.planned, members: listed.into_iter().collect() })
}

/// Returns the pages of a roster as datagrams have them, each after the head and its index.
pub fn pages(bytes: &[u8]) -> Vec<Vec<u8>> {
    let Ok((head, pages)) = split(bytes) else { return Vec::new() };
    let sheet = |(index, page): (u8, &Page)| [head.bytes, &[index], page.bytes].concat();
    (0..).zip(&pages).map(sheet).collect()
}

/// Returns the head of a roster, the index of one of its pages, and that page, as a datagram has them.
pub fn read_page(bytes: &[u8]) -> Result<(Head<'_>, usize, Page<'_>), RosterError> {
    let (head, rest) = Head::read(bytes)?;
    let (index, rest) = rest.split_first().ok_or(RosterError::Malformed)?;
    let (page, rest) = Page::read(rest)?;
    if !rest.is_empty() || usize::from(*index) >= head.hashes.len() {
        return Err(RosterError::Malformed);
    }
    Ok((head, usize::from(*index), page))
}

/// Returns the number of the roster of a page, as a datagram has it; `None` if it has not the form of one.
pub(super) fn number_of(page: &[u8]) -> Option<u32> {
    Head::read(page).ok().map(|(head, _)| head.number)
}

/// Returns whether a page, as a datagram has it, is of the roster `whole`.
pub(super) fn is_of(page: &[u8], whole: &[u8]) -> bool {
    let head = |bytes| Head::read(bytes).map(|(head, _)| head.bytes);
    head(page).is_ok_and(|one| head(whole) == Ok(one))
}

/// Pages of one roster that have arrived. The head was checked, so that only its own pages are taken.
#[derive(Clone, Debug, Default)]
pub struct Collected {
    head: Vec<u8>,
    pages: Vec<Vec<u8>>,
}

impl Collected {
    /// Returns the collection of the pages of the roster with this head, before any of them.
    pub(super) fn of(head: &Head) -> Collected {
        Collected { head: head.bytes.to_vec(), pages: vec![Vec::new(); head.hashes.len()] }
    }

    /// Returns whether it is that of the roster with this head.
    pub(super) fn is_of(&self, head: &Head) -> bool {
        self.head == head.bytes
    }

    /// Returns the number of the roster; zero if there is none.
    pub(super) fn number(&self) -> u32 {
        Head::read(&self.head).map_or(0, |(head, _)| head.number)
    }

    /// Takes a page. Returns the roster if it is whole now.
    pub(super) fn take(&mut self, (index, page): (usize, &Page)) -> Result<Option<Vec<u8>>, RosterError> {
        let (head, _) = Head::read(&self.head)?;
        if !head.has(index, page) {
            return Err(RosterError::Unsigned);
        }
        let known = !self.pages[index].is_empty();
        self.pages[index] = page.bytes.to_vec();
        match self.pages.iter().all(|page| !page.is_empty()) {
            true => Ok(Some([self.head.clone(), self.pages.concat()].concat())),
            false if known => Err(RosterError::Repeated),
            false => Ok(None),
        }
    }
}

/// Returns what is authenticated beside the encrypted key of all members: team, number, nonce and the page's members.
fn beside(team: u16, begins: &[u8], entries: &[u8]) -> Vec<u8> {
    [&team.to_le_bytes(), begins, entries].concat()
}

fn signed(team: u16, bytes: &[u8]) -> Vec<u8> {
    [SIGNED, &team.to_le_bytes(), bytes].concat()
}
