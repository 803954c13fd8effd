//! The one encoder and the one decoder of the wire.
//!
//! A frame is a fixed header of 14 bytes, little-endian, and one MessagePack array:
//!
//! | bytes | field |
//! |---|---|
//! | 0 | version of the wire format |
//! | 1 | kind of message |
//! | 2..4 | team |
//! | 4..6 | sending host |
//! | 6..10 | epoch: the sender's incarnation |
//! | 10..14 | sequence number of the sender on this link |
//!
//! A later tag of up to 26 bytes keeps header and tag within 40. Decoding never panics, whatever the
//! bytes, and never allocates more than the frame is long.

use std::sync::Arc;

use serde::Deserialize;

use crate::messages::ids::HostId;
use crate::messages::wire::{KINDS, Kind, Unfit, Wire};

/// Version of the wire format; a receiver refuses every other.
pub const VERSION: u8 = 1;
/// Bytes of the header.
pub const HEADER_BYTES: usize = 14;
/// The largest frame: below the 1280 bytes that every IPv6 link carries (RFC 8200, section 5), with room for
/// IP and UDP headers and a tag.
pub const MAX_FRAME_BYTES: usize = 1200;

/// An encoded message with its header, shared by all who carry it.
pub type Frame = Arc<[u8]>;

/// Who sent a frame, and which of its frames it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// What the frame holds.
    pub kind: Kind,
    /// The team that it belongs to.
    pub team: u16,
    /// The host that sent it.
    pub sender: HostId,
    /// The sender's incarnation; a restarted host has a later one.
    pub epoch: u32,
    /// Counts the sender's frames on this link within an epoch.
    pub sequence: u32,
}

/// Why a message cannot be sent.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// The message breaks its own ranges.
    #[error("a {0:?} is unfit to send: {1}")]
    Unfit(Kind, Unfit),
    /// The frame would not fit into one datagram.
    #[error("a {0:?} takes {1} bytes; a frame holds {MAX_FRAME_BYTES}")]
    TooLong(Kind, usize),
}

/// Why bytes are not a frame.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// Shorter than a header or longer than a datagram.
    #[error("{0} bytes are no frame")]
    Length(usize),
    /// Another version of the wire format.
    #[error("version {0} of the wire format; this program speaks {VERSION}")]
    Version(u8),
    /// A kind of message that does not exist.
    #[error("no message has the kind {0}")]
    Kind(u8),
    /// The body is not the message that the header promises.
    #[error("the body is not a {0:?}")]
    Body(Kind),
    /// Bytes follow the message.
    #[error("bytes follow the {0:?}")]
    Trailing(Kind),
    /// The message breaks its own ranges.
    #[error("the {0:?} is unfit: {1}")]
    Unfit(Kind, Unfit),
}

/// Encodes a message behind its header. The header's kind is the message's.
pub fn encode(header: &Header, message: &Wire) -> Result<Frame, EncodeError> {
    let kind = message.kind();
    assert_eq!(header.kind, kind, "a header names the kind of its message");
    message.check().map_err(|unfit| EncodeError::Unfit(kind, unfit))?;
    let mut bytes = Vec::with_capacity(256);
    bytes.extend_from_slice(&[VERSION, kind as u8]);
    bytes.extend_from_slice(&header.team.to_le_bytes());
    bytes.extend_from_slice(&header.sender.0.to_le_bytes());
    bytes.extend_from_slice(&header.epoch.to_le_bytes());
    bytes.extend_from_slice(&header.sequence.to_le_bytes());
    match message {
        Wire::Reading(body) => rmp_serde::encode::write(&mut bytes, body),
        Wire::Latent(body) => rmp_serde::encode::write(&mut bytes, body),
        Wire::MotorCommand(body) => rmp_serde::encode::write(&mut bytes, body),
        Wire::Heartbeat(body) => rmp_serde::encode::write(&mut bytes, body),
        Wire::Mode(body) => rmp_serde::encode::write(&mut bytes, body),
        Wire::Stop(body) => rmp_serde::encode::write(&mut bytes, body),
    }
    .expect("plain data is always MessagePack");
    if bytes.len() > MAX_FRAME_BYTES {
        return Err(EncodeError::TooLong(kind, bytes.len()));
    }
    Ok(bytes.into())
}

/// Reads a frame's header alone.
pub fn peek(frame: &[u8]) -> Result<Header, DecodeError> {
    if frame.len() < HEADER_BYTES || frame.len() > MAX_FRAME_BYTES {
        return Err(DecodeError::Length(frame.len()));
    }
    if frame[0] != VERSION {
        return Err(DecodeError::Version(frame[0]));
    }
    let u16_at = |at: usize| u16::from_le_bytes([frame[at], frame[at + 1]]);
    let u32_at = |at: usize| u32::from_le_bytes([frame[at], frame[at + 1], frame[at + 2], frame[at + 3]]);
    Ok(Header {
        kind: KINDS.get(usize::from(frame[1])).copied().ok_or(DecodeError::Kind(frame[1]))?,
        team: u16_at(2),
        sender: HostId(u16_at(4)),
        epoch: u32_at(6),
        sequence: u32_at(10),
    })
}

/// Decodes a whole frame.
pub fn decode(frame: &[u8]) -> Result<(Header, Wire), DecodeError> {
    let header = peek(frame)?;
    let (kind, bytes) = (header.kind, &frame[HEADER_BYTES..]);
    let message = match kind {
        Kind::Reading => Wire::Reading(body(kind, bytes)?),
        Kind::Latent => Wire::Latent(body(kind, bytes)?),
        Kind::MotorCommand => Wire::MotorCommand(body(kind, bytes)?),
        Kind::Heartbeat => Wire::Heartbeat(body(kind, bytes)?),
        Kind::Mode => Wire::Mode(body(kind, bytes)?),
        Kind::Stop => Wire::Stop(body(kind, bytes)?),
    };
    message.check().map_err(|unfit| DecodeError::Unfit(kind, unfit))?;
    Ok((header, message))
}

fn body<'a, T: Deserialize<'a>>(kind: Kind, bytes: &'a [u8]) -> Result<T, DecodeError> {
    // rmp-serde would also read a struct from a map; only the array that we write is the format.
    if bytes.first().is_none_or(|marker| marker & 0xf0 != 0x90) {
        return Err(DecodeError::Body(kind));
    }
    let mut reader = rmp_serde::Deserializer::from_read_ref(bytes);
    let body = T::deserialize(&mut reader).map_err(|_| DecodeError::Body(kind))?;
    // rmp-serde stops after one value without a word about the rest: ask for a second one, of a type that
    // takes nothing but its marker, so that only the true end is a missing marker.
    match <()>::deserialize(&mut reader) {
        Err(rmp_serde::decode::Error::InvalidMarkerRead(_)) => Ok(body),
        _ => Err(DecodeError::Trailing(kind)),
    }
}
