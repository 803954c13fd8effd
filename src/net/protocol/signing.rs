//! Signatures of the messages to all that other members may pass on unchanged: emergency stops and the state server's
//! instructions. Each host checks them, independently of the tag of the datagram. Pure.
//!
//! A signature is a block after its message, little-endian:
//!
//! | bytes | field |
//! |---|---|
//! | 4 | edition: how many messages this run of the signer has signed on the link, this one included |
//! | 64 | signature (Ed25519) of team, link, signer, incarnation, edition, kind and body of the message |
//!
//! An unchanged message has the same signature: it is signed once, and checked once by each host.

use std::collections::BTreeMap;

use super::bucket::{Bucket, Rate};
use super::codec::{BLOCK_BYTES, Content, Frame, HEADER_BYTES, Header, add};
use super::retransmit::StreamId;
use super::signatures::{Signatures, Signed};
use crate::messages::ids::LinkId;
use crate::messages::wire::Kind;
use crate::time::Time;

const SIGNATURE_BYTES: usize = 64;
/// Limit of the new signatures of one sender that are checked, of stops and of all else each: some 50 us each, so that
/// one that signs without pause takes no more than a percent of a processor. A state server makes some ten in the first
/// second of an episode.
const CHECKS: Rate = Rate { per_s: 100.0, burst: 100.0 };

/// Signed messages that this process has sent on one link.
#[derive(Clone, Debug, Default)]
pub(super) struct Signing {
    edition: u32,
    newest: BTreeMap<StreamId, Newest>,
}

/// Newest message of a stream, and its block with edition and signature.
#[derive(Clone, Debug)]
struct Newest {
    body: Box<[u8]>,
    block: Box<[u8]>,
}

impl Signing {
    /// Returns the datagram `encoded`, which has one message of the stream `stream`, with its signature. `None` if this
    /// process has no key of its own to sign with.
    pub fn sign(
        &mut self,
        by: &Signatures,
        (me, link): (&Header, LinkId),
        stream: StreamId,
        encoded: &Frame,
    ) -> Option<Frame> {
        let body = &encoded[HEADER_BYTES + BLOCK_BYTES..];
        if self.newest.get(&stream).is_none_or(|before| *before.body != *body) {
            let edition = self.edition.wrapping_add(1);
            let mut block = edition.to_le_bytes().to_vec();
            block.extend_from_slice(&by.sign(&signed((me, link), edition, stream.0, body))?);
            self.edition = edition;
            self.newest.insert(stream, Newest { body: body.into(), block: block.into() });
        }
        let Newest { block, .. } = self.newest.get(&stream)?;
        let mut bytes = encoded.to_vec();
        add(&mut bytes, Content::Signature, |bytes| bytes.extend_from_slice(block));
        Some(bytes.into())
    }
}

/// Returns the bytes that the process with the header `signer` signs for the link `link`.
fn signed((signer, link): (&Header, LinkId), edition: u32, kind: Kind, body: &[u8]) -> Vec<u8> {
    /// Context of what is signed, so that a signature of something else is never one of a message.
    const CONTEXT: &[u8] = b"murmurate 2026-11-28 message";
    let mut bytes = CONTEXT.to_vec();
    bytes.extend_from_slice(&signer.team.to_le_bytes());
    bytes.extend_from_slice(&link.0.to_le_bytes());
    bytes.extend_from_slice(&signer.sender.0.to_le_bytes());
    bytes.extend_from_slice(&signer.incarnation.to_le_bytes());
    bytes.extend_from_slice(&edition.to_le_bytes());
    bytes.push(kind as u8);
    bytes.extend_from_slice(body);
    bytes
}

/// Returns the signed bytes of a message from the process with the header `signer`, with the signature in the block
/// after it; `None` if that has not the form of one.
pub(super) fn claimed(from: (&Header, LinkId), kind: Kind, body: &[u8], block: &[u8]) -> Option<Signed> {
    let (edition, signature) = block.split_first_chunk()?;
    let edition = u32::from_le_bytes(*edition);
    let signature: [u8; SIGNATURE_BYTES] = signature.try_into().ok()?;
    Some(Signed { by: from.0.sender, edition, bytes: signed(from, edition, kind, body), signature })
}

/// Signatures in the messages of one sender that were checked, and how many more may be.
#[derive(Clone, Debug)]
pub(crate) struct Checked {
    /// For each stream the edition of its newest message with a valid signature, and a digest of it.
    newest: BTreeMap<StreamId, (u32, blake3::Hash)>,
    /// Checks that are left: of stops, and of all else.
    left: [Bucket; 2],
}

impl Checked {
    /// Returns the state of a sender that is accepted at `now`.
    pub fn new(now: Time) -> Checked {
        Checked { newest: BTreeMap::new(), left: [Bucket::full(now, &CHECKS); 2] }
    }

    /// Returns whether the signature in a message of the stream `stream` is valid. An instruction that is older than
    /// the newest one is not believed; a stop is.
    pub fn check(&mut self, now: Time, stream: StreamId, signed: &Signed, by: &Signatures) -> bool {
        let mut digest = blake3::Hasher::new();
        let digest = digest.update(&signed.bytes).update(&signed.signature).finalize();
        match self.newest.get(&stream) {
            Some((_, known)) if *known == digest => return true,
            Some((edition, _)) if signed.edition < *edition && stream.0 == Kind::Mode => return false,
            _ => {}
        }
        let valid = self.left[usize::from(stream.0 != Kind::Stop)].take(now, &CHECKS) && by.verify(signed);
        if valid {
            self.newest.insert(stream, (signed.edition, digest));
        }
        valid
    }
}
