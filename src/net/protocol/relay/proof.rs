//! Proofs of entries: that their origin has made them, whoever passed them on.
//!
//! Where members have keys of their own, a heartbeat has a tag of the pair of its origin and the state server, its only
//! reader; a lead and a status have their origin's signature. A release has the signature of its operator, and a layout
//! is named by a lead. In a team with one key, all members of which can speak as each other, entries have no proof.

use super::Said;
use super::entry::{Content, Entry};
use crate::messages::ids::HostId;
use crate::messages::wire::{Kind, Wire};
use crate::net::protocol::bucket::{Bucket, Rate};
use crate::net::protocol::codec::{Frame, SHORT_TAG_BYTES};
use crate::net::protocol::key::Key;
use crate::net::protocol::link::Identity;
use crate::net::protocol::signatures::{Signatures, Signed};
use crate::net::protocol::tags;
use crate::time::Time;

/// Context of what is proved, so that a proof of something else is never one of an entry.
const CONTEXT: &[u8] = b"murmurate 2026-11-30 entry";
/// Limit of the signatures that are checked of what one neighbour says: some 50 us each.
const CHECKS: Rate = Rate { per_s: 100.0, burst: 100.0 };

/// Result of the check of an entry's proof.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Its origin has made it.
    Sound,
    /// Its proof is for another host.
    Unreadable,
    /// It is not what its origin has made, or has not the proof that it needs.
    False,
}

/// Returns an entry with its proof. `server` is the host of the state server.
pub(super) fn sealed(entry: &Entry, body: &[u8], team: u16, key: Option<&Key>, server: HostId) -> Frame {
    let proved = || proved(entry, body, team);
    let signed = || key.and_then(Key::signatures).and_then(|by| by.sign(&proved()));
    let proof: Vec<u8> = match entry.content {
        Content::Message(Kind::Heartbeat) => {
            key.and_then(|key| key.pair(server)).map_or(Vec::new(), |pair| tags::short(pair, &proved()).to_vec())
        }
        Content::Message(Kind::Release) | Content::Layout => Vec::new(),
        Content::Message(_) | Content::Lead => signed().map_or(Vec::new(), |signature| signature.to_vec()),
    };
    entry.bytes(body, &proof)
}

fn proved(entry: &Entry, body: &[u8], team: u16) -> Vec<u8> {
    [CONTEXT, &team.to_le_bytes(), &entry.proved(body)].concat()
}

/// Checks of what one neighbour says: how many more may be made.
#[derive(Clone, Debug)]
pub(super) struct Checks(Bucket);

impl Checks {
    /// Returns the state of a neighbour that is first heard at `now`.
    pub fn new(now: Time) -> Checks {
        Checks(Bucket::full(now, &CHECKS))
    }

    /// Returns what is known of an entry with this body and proof, at the process `me`.
    pub fn verdict(
        &mut self,
        now: Time,
        (entry, said): (&Entry, &Said),
        (body, proof): (&[u8], &[u8]),
        key: Option<&Key>,
        (me, server): (Identity, HostId),
    ) -> Verdict {
        let Some(by) = key.and_then(Key::signatures).filter(|by| !by.are_trusted()) else { return Verdict::Sound };
        let is = |sound: bool| if sound { Verdict::Sound } else { Verdict::False };
        let proved = || proved(entry, body, me.team);
        match (entry.content, said) {
            (Content::Message(Kind::Heartbeat), _) if me.host != server => {
                if proof.len() == SHORT_TAG_BYTES {
                    Verdict::Unreadable
                } else {
                    Verdict::False
                }
            }
            (Content::Message(Kind::Heartbeat), _) => {
                let tags = key.into_iter().flat_map(|key| key.pairs_with(entry.origin));
                let proved = proved();
                is(tags.into_iter().any(|pair| tags::is_short(pair, &proved, proof)))
            }
            (_, Said::Message(Wire::Release(release))) => {
                let is_for_me = me.host.is_operator() || release.names(me.host, me.incarnation);
                let signed = Signed::release(me.team, release);
                match release.by.is_operator() && self.0.take(now, &CHECKS) && by.verify(&signed) {
                    true if is_for_me => Verdict::Sound,
                    true => Verdict::Unreadable,
                    false => Verdict::False,
                }
            }
            _ => is(self.0.take(now, &CHECKS) && is_signed(by, entry, proved(), proof)),
        }
    }
}

fn is_signed(by: &Signatures, entry: &Entry, bytes: Vec<u8>, proof: &[u8]) -> bool {
    let Ok(signature) = proof.try_into() else { return false };
    by.verify(&Signed { by: entry.origin, edition: 0, bytes, signature })
}
