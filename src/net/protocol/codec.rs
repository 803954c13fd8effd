//! Encoder and decoder of the wire format, for all datagrams.
//!
//! A datagram is a header of 14 bytes, little-endian, then blocks, then a tag where the team has a key (`key`):
//!
//! | bytes | field |
//! |---|---|
//! | 0 | version of the wire format |
//! | 1 | flags |
//! | 2..4 | team |
//! | 4..6 | sending host |
//! | 6..10 | the sender's incarnation, a random number |
//! | 10..14 | sequence number, counted on this link: one count for datagrams to all hosts, one for each single receiver
//! |
//!
//! A block is a content byte, a length of 2 bytes and a body: a message as one MessagePack array, or a control block of
//! the link layer (`report`). Decoding never panics, and never allocates more than the length of the datagram.

use std::borrow::Cow;
use std::sync::Arc;

use serde::de::DeserializeSeed as _;

use super::unpack::Reader;
use crate::messages::ids::HostId;
pub use crate::messages::release::MAX_MEMBERS;
use crate::messages::wire::{KINDS, Kind, Unfit, Wire};

/// Version of the wire format; a receiver refuses all others.
pub const VERSION: u8 = 5;
/// Version before this one, which records have. Its header, blocks and tag have the same layout, and its messages lack
/// fields alone.
const FORMER: u8 = 4;
/// Length of the authentication tag at the end of a datagram \[bytes\]: keyed BLAKE3, truncated to 128 bits.
pub const TAG_BYTES: usize = 16;
/// Length of the tag for one member in a datagram for each member \[bytes\]: keyed BLAKE3, truncated to 64 bits.
/// By guessing 30 000 a second one is found in ten million years.
pub const SHORT_TAG_BYTES: usize = 8;
/// Length of the header at the start of a datagram \[bytes\].
pub const HEADER_BYTES: usize = 14;
/// Offset of the flags within the header of a datagram \[bytes\].
pub const FLAGS_AT: usize = 1;
/// Length of the header of a block within a datagram \[bytes\]: type of the content, and length of the body.
pub const BLOCK_BYTES: usize = 3;
/// Largest datagram with its authentication tags \[bytes\]: with the headers of IPv6 and UDP the 1280 bytes that every
/// IPv6 link carries (RFC 8200, section 5).
pub const MAX_FRAME_BYTES: usize = 1232;
/// Largest datagram without its authentication tags \[bytes\]: beside it there is room for a tag for each of 12
/// members. That of a larger team or a confidential one is smaller (`key`).
pub const MAX_PLAIN_BYTES: usize = MAX_FRAME_BYTES - (12 * SHORT_TAG_BYTES + 1);

/// Bytes of an encoded datagram; clones share them.
pub type Frame = Arc<[u8]>;

/// Header of a datagram, and its bytes without the tag and in clear.
pub type Opened<'a> = (Header, Cow<'a, [u8]>);

/// Flags in the header of a datagram, one bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags(pub u8);

impl Flags {
    /// Flag bit: the datagram ends with an authentication tag.
    pub const TAGGED: u8 = 1;
    /// Flag bit: the datagram is for one host, and numbered among the sender's datagrams to that host alone.
    pub const DIRECT: u8 = 2;
    /// Flag bit: the datagram is a retransmission.
    pub const COPY: u8 = 4;
    /// Flag bit: the sender asks the receiver to acknowledge the datagram.
    pub(crate) const ACK: u8 = 8;
    /// Flag bit: the datagram ends with a short tag for each member of the team, and their number in one byte.
    pub const FOR_EACH: u8 = 16;
    /// Flag bit: the blocks are encrypted (`cipher`).
    pub const ENCRYPTED: u8 = 32;
    /// Flag bit: the first of the encrypted blocks is a link report, which a unicast link sends to more addresses.
    pub const REPORT: u8 = 64;
    /// Flag bit: the datagram is a roster (`roster`), which is signed and has no tag.
    pub const ROSTER: u8 = 128;

    /// Whether the flag `bit`, one of the constants of this type, is set.
    pub fn has(self, bit: u8) -> bool {
        self.0 & bit != 0
    }
}

/// Header of a datagram: flags, sender and sequence number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Flags of the datagram.
    pub flags: Flags,
    /// Team number of the sender.
    pub team: u16,
    /// Host that sent the datagram.
    pub sender: HostId,
    /// Incarnation of the sender; a restarted host has a new one.
    pub incarnation: u32,
    /// Sequence number of the datagram. Each incarnation has on each link one sequence space for datagrams to all
    /// hosts, and one for each single receiver.
    pub sequence: u32,
}

/// Type of the content of a block, the unit of which datagrams consist: a message, or control data of the link layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Message of this kind, such as a latent.
    Message(Kind),
    /// Link report: the sender's stamp, and an entry with echo, delay and loss for each listed host.
    Report,
    /// Link report on a link with unicast datagrams: each entry also has the sequence number of the sender's next
    /// unicast datagram to its host.
    NumberedReport,
    /// Acknowledgements of datagrams that have arrived.
    Ack,
    /// Requests to retransmit datagrams that have not arrived.
    Nack,
    /// Sequence numbers of earlier datagrams that their sender still keeps, so that receivers may request them.
    Held,
    /// Roster of the team's members (`roster`), in a datagram of its own.
    Roster,
    /// Signature of the message in the block before it (`signing`).
    Signature,
    /// Parts of messages that have not arrived (`parts`).
    Lacking,
    /// Soft state of others that the sender passes on (`relay`).
    Relayed,
    /// Mark of a pair: a copy of the datagram follows at once (`choice`).
    Pair,
    /// Content of a later version, with its byte; it is passed over.
    Other(u8),
}

impl Content {
    const REPORT: u8 = 0x80;
    const ACK: u8 = 0x81;
    const NACK: u8 = 0x82;
    const HELD: u8 = 0x83;
    const NUMBERED_REPORT: u8 = 0x84;
    const ROSTER: u8 = 0x85;
    const SIGNATURE: u8 = 0x86;
    const LACKING: u8 = 0x87;
    const RELAYED: u8 = 0x88;
    const PAIR: u8 = 0x8a;

    fn byte(self) -> u8 {
        match self {
            Content::Message(kind) => kind as u8,
            Content::Report => Content::REPORT,
            Content::NumberedReport => Content::NUMBERED_REPORT,
            Content::Ack => Content::ACK,
            Content::Nack => Content::NACK,
            Content::Held => Content::HELD,
            Content::Roster => Content::ROSTER,
            Content::Signature => Content::SIGNATURE,
            Content::Lacking => Content::LACKING,
            Content::Relayed => Content::RELAYED,
            Content::Pair => Content::PAIR,
            Content::Other(byte) => byte,
        }
    }

    fn of(byte: u8) -> Content {
        match byte {
            Content::REPORT => Content::Report,
            Content::NUMBERED_REPORT => Content::NumberedReport,
            Content::ROSTER => Content::Roster,
            Content::SIGNATURE => Content::Signature,
            Content::LACKING => Content::Lacking,
            Content::RELAYED => Content::Relayed,
            Content::PAIR => Content::Pair,
            Content::ACK => Content::Ack,
            Content::NACK => Content::Nack,
            Content::HELD => Content::Held,
            _ => KINDS.get(usize::from(byte)).copied().map_or(Content::Other(byte), Content::Message),
        }
    }
}

/// Reason why a message cannot be sent.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// The message is outside the ranges of its kind.
    #[error("a {0:?} is unfit to send: {1}")]
    Unfit(Kind, Unfit),
    /// The message takes the first number of bytes, and there is room for the second.
    #[error("a {0:?} takes {1} bytes; there is room for {2}")]
    TooLong(Kind, usize, usize),
}

/// Reason why bytes are not a valid datagram.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The number of bytes (given) is below that of a header or above that of the largest datagram.
    #[error("{0} bytes are no frame")]
    Length(usize),
    /// The datagram has another version of the wire format, given here.
    #[error("version {0} of the wire format; this program speaks {VERSION}")]
    Version(u8),
    /// The datagram has flags that none has together; all are given here.
    #[error("no datagram has the flags {0:#04x}")]
    Flags(u8),
    /// The blocks are encrypted.
    #[error("the blocks are encrypted")]
    Encrypted,
    /// A block is longer than the datagram, or there are too few or too many blocks.
    #[error("the blocks are not what their lengths say")]
    Blocks,
    /// A block with control data of the link layer is malformed; its type is given.
    #[error("the body is not a {0:?}")]
    Link(Content),
    /// The body of a message of the given kind is malformed.
    #[error("the body is not a {0:?}")]
    Body(Kind),
    /// A block has bytes after its message; the message's kind is given.
    #[error("bytes follow the {0:?}")]
    Trailing(Kind),
    /// The message is outside the ranges of its kind.
    #[error("the {0:?} is unfit: {1}")]
    Unfit(Kind, Unfit),
}

/// Returns a new datagram that contains only the given header.
pub fn start(header: &Header) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(256);
    bytes.extend_from_slice(&[VERSION, header.flags.0]);
    bytes.extend_from_slice(&header.team.to_le_bytes());
    bytes.extend_from_slice(&header.sender.0.to_le_bytes());
    bytes.extend_from_slice(&header.incarnation.to_le_bytes());
    bytes.extend_from_slice(&header.sequence.to_le_bytes());
    bytes
}

/// Appends a block with content of the type `content` to a datagram; `write` appends the block's body.
pub fn add(datagram: &mut Vec<u8>, content: Content, write: impl FnOnce(&mut Vec<u8>)) {
    let at = datagram.len();
    datagram.extend_from_slice(&[content.byte(), 0, 0]);
    write(datagram);
    let length = u16::try_from(datagram.len() - at - BLOCK_BYTES).unwrap_or(u16::MAX);
    datagram[at + 1..at + BLOCK_BYTES].copy_from_slice(&length.to_le_bytes());
}

/// Encodes a message as a datagram without an authentication tag. Fails if the message is outside the ranges of its
/// kind or too long.
pub fn encode(header: &Header, message: &Wire) -> Result<Frame, EncodeError> {
    let kind = message.kind();
    message.check().map_err(|unfit| EncodeError::Unfit(kind, unfit))?;
    let mut bytes = start(header);
    add(&mut bytes, Content::Message(kind), |bytes| {
        rmp_serde::encode::write(bytes, message).expect("plain data is always MessagePack");
    });
    if bytes.len() > MAX_PLAIN_BYTES {
        return Err(EncodeError::TooLong(kind, bytes.len(), MAX_PLAIN_BYTES));
    }
    Ok(bytes.into())
}

/// Returns whether a datagram is of this version of the wire format, and not of the one before it, which only records
/// still have.
pub fn is_current(datagram: &[u8]) -> bool {
    datagram.first() == Some(&VERSION)
}

/// Returns whether the blocks of a datagram are encrypted.
pub fn is_encrypted(datagram: &[u8]) -> bool {
    datagram.get(FLAGS_AT).is_some_and(|flags| Flags(*flags).has(Flags::ENCRYPTED))
}

/// Decodes only the header of a datagram, of this version of the wire format or the one before it. Fails if the length,
/// version or flags are invalid.
pub fn peek(datagram: &[u8]) -> Result<Header, DecodeError> {
    let header = datagram.first_chunk::<HEADER_BYTES>().filter(|_| datagram.len() <= MAX_FRAME_BYTES);
    let Some(&[version, flags, t0, t1, s0, s1, e0, e1, e2, e3, n0, n1, n2, n3]) = header else {
        return Err(DecodeError::Length(datagram.len()));
    };
    if version != VERSION && version != FORMER {
        return Err(DecodeError::Version(version));
    }
    let flags = Flags(flags);
    let mixed = flags.has(Flags::ROSTER) && flags.0 != Flags::ROSTER;
    if mixed || flags.has(Flags::REPORT) && !flags.has(Flags::ENCRYPTED) {
        return Err(DecodeError::Flags(flags.0));
    }
    let (incarnation, sequence) = (u32::from_le_bytes([e0, e1, e2, e3]), u32::from_le_bytes([n0, n1, n2, n3]));
    let (team, sender) = (u16::from_le_bytes([t0, t1]), HostId(u16::from_le_bytes([s0, s1])));
    Ok(Header { flags, team, sender, incarnation, sequence })
}

/// Returns a datagram without its authentication tag, if it says that it has one. The tag is not checked.
pub fn untagged(datagram: &[u8]) -> &[u8] {
    let flags = Flags(datagram.get(FLAGS_AT).copied().unwrap_or(0));
    let tags = match datagram.last() {
        Some(members) if flags.has(Flags::FOR_EACH) => usize::from(*members) * SHORT_TAG_BYTES + 1,
        _ => TAG_BYTES,
    };
    let plain = datagram.len().checked_sub(tags).filter(|_| flags.has(Flags::TAGGED));
    &datagram[..plain.unwrap_or(datagram.len())]
}

/// Returns the blocks of a datagram without authentication tag, each as type of content and body. An error
/// is the last item, since the bytes after it cannot be split.
pub fn blocks(plain: &[u8]) -> impl Iterator<Item = Result<(Content, &[u8]), DecodeError>> {
    let mut rest = plain.get(HEADER_BYTES..).unwrap_or_default();
    let encrypted = is_encrypted(plain);
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let block = if encrypted { Err(DecodeError::Encrypted) } else { split(rest) };
        rest = block.as_ref().map_or(&[], |(_, _, rest)| rest);
        Some(block.map(|(content, body, _)| (content, body)))
    })
}

/// Returns the messages of a datagram without authentication tag, each as its kind, its body, and the body of
/// the signature that follows it, if one does.
pub fn messages(plain: &[u8]) -> impl Iterator<Item = (Kind, &[u8], Option<&[u8]>)> {
    let mut blocks = blocks(plain).flatten().peekable();
    std::iter::from_fn(move || {
        let (kind, body) = blocks.by_ref().find_map(|(content, body)| match content {
            Content::Message(kind) => Some((kind, body)),
            _ => None,
        })?;
        let signature = blocks.next_if(|(content, _)| *content == Content::Signature).map(|(_, body)| body);
        Some((kind, body, signature))
    })
}

fn split(bytes: &[u8]) -> Result<(Content, &[u8], &[u8]), DecodeError> {
    let (&[content, low, high], rest) = bytes.split_first_chunk().ok_or(DecodeError::Blocks)?;
    let content = Content::of(content);
    let (body, rest) = rest.split_at_checked(u16::from_le_bytes([low, high]).into()).ok_or(DecodeError::Blocks)?;
    Ok((content, body, rest))
}

/// Returns the type of the first block in a datagram, by which an emulated medium decides how to treat the datagram. Of
/// an encrypted datagram it is known if that is a link report.
pub fn first(datagram: &[u8]) -> Result<Content, DecodeError> {
    if is_encrypted(datagram) {
        let report = Flags(datagram[FLAGS_AT]).has(Flags::REPORT);
        return if report { Ok(Content::Report) } else { Err(DecodeError::Encrypted) };
    }
    split(datagram.get(HEADER_BYTES..).unwrap_or_default()).map(|(content, ..)| content)
}

/// Returns whether a datagram consists of one message of this kind alone, without a tag.
pub fn is_only(datagram: &[u8], kind: Kind) -> bool {
    let plain = peek(datagram).is_ok_and(|header| !header.flags.has(Flags::TAGGED));
    let mut blocks = blocks(datagram);
    plain && matches!((blocks.next(), blocks.next()), (Some(Ok((Content::Message(of), _))), None) if of == kind)
}

/// Returns a datagram with the page `page` of a roster (`roster`) from the sender `me`. It has no number and no tag:
/// the roster's own signature is checked.
pub fn with_roster(me: &Header, page: &[u8]) -> Frame {
    let mut bytes = start(&Header { flags: Flags(Flags::ROSTER), sequence: 0, ..*me });
    add(&mut bytes, Content::Roster, |bytes| bytes.extend_from_slice(page));
    bytes.into()
}

/// Returns the page of a roster in a datagram that says that it is one; `None` for any other datagram. Nothing is
/// checked.
pub fn roster_of(datagram: &[u8]) -> Option<&[u8]> {
    if datagram.get(FLAGS_AT) != Some(&Flags::ROSTER) {
        return None;
    }
    peek(datagram).ok()?;
    let mut all = blocks(datagram);
    match (all.next()?.ok()?, all.next()) {
        ((Content::Roster, sealed), None) => Some(sealed),
        _ => None,
    }
}

/// Decodes the body of a message of kind `kind`, and checks that its values are in range.
pub fn message(kind: Kind, bytes: &[u8]) -> Result<Wire, DecodeError> {
    let mut reader = Reader(bytes);
    let message = kind.deserialize(&mut reader).map_err(|_| DecodeError::Body(kind))?;
    if !reader.0.is_empty() {
        return Err(DecodeError::Trailing(kind));
    }
    message.check().map_err(|unfit| DecodeError::Unfit(kind, unfit))?;
    Ok(message)
}

/// Decodes a datagram without authentication tag that contains exactly one message. Fails on any other datagram.
pub fn decode(plain: &[u8]) -> Result<(Header, Wire), DecodeError> {
    let header = peek(plain)?;
    let mut all = blocks(plain);
    let (content, bytes) = all.next().ok_or(DecodeError::Blocks)??;
    let Content::Message(kind) = content else { return Err(DecodeError::Link(content)) };
    match all.next() {
        None => Ok((header, message(kind, bytes)?)),
        Some(_) => Err(DecodeError::Blocks),
    }
}
