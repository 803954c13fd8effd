//! Decoders of the elements of MCAP files (<https://mcap.dev/spec>), over bytes in memory. No length in a file is
//! trusted: all decoders return `None` for bytes that do not have the form of their element.

use std::collections::BTreeMap;

/// Bytes at the beginning and at the end of an MCAP file.
pub const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Length of an element's opcode and length \[bytes\].
pub const HEAD: u64 = 9;

/// Opcodes of the elements that are interpreted.
#[allow(missing_docs, reason = "the names are those of the specification")]
pub mod op {
    pub const HEADER: u8 = 0x01;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const ATTACHMENT: u8 = 0x09;
    pub const METADATA: u8 = 0x0C;
    pub const DATA_END: u8 = 0x0F;
    /// Smallest opcode of elements that applications may define.
    pub const PRIVATE: u8 = 0x80;
}

/// Values of metadata, by name.
pub type Map = BTreeMap<String, String>;

/// Bytes of an element that are still to be decoded.
#[derive(Clone, Copy)]
pub struct Rest<'a>(pub &'a [u8]);

#[allow(missing_docs, reason = "each decodes the type in its name")]
impl<'a> Rest<'a> {
    pub fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.take(1)?.first().copied()
    }

    pub fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(self.take(2)?.try_into().ok()?))
    }

    pub fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.take(4)?.try_into().ok()?))
    }

    pub fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.take(8)?.try_into().ok()?))
    }

    /// Decodes bytes after their length of four bytes.
    pub fn block(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u32()?).ok()?;
        self.take(length)
    }

    pub fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.block()?).ok()
    }

    pub fn map(&mut self) -> Option<Map> {
        let (mut pairs, mut map) = (Rest(self.block()?), Map::new());
        while !pairs.0.is_empty() {
            let (name, value) = (pairs.text()?, pairs.text()?);
            map.insert(name.to_owned(), value.to_owned());
        }
        Some(map)
    }

    /// Decodes the head of an element inside a chunk: returns its opcode and its bytes.
    pub fn element(&mut self) -> Option<(u8, &'a [u8])> {
        let opcode = self.u8()?;
        let length = usize::try_from(self.u64()?).ok()?;
        Some((opcode, self.take(length)?))
    }
}

/// Schema of messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// Id of the schema in its file, from 1.
    pub id: u16,
    /// Name of the schema, such as `foxglove.SceneUpdate`.
    pub name: String,
    /// Encoding of the schema, such as `protobuf`.
    pub encoding: String,
    /// Content of the schema in its encoding.
    pub data: Vec<u8>,
}

/// Channel of an MCAP file: a topic, with the encoding and schema of its messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Id of the channel in its file.
    pub id: u16,
    /// Id of the channel's schema in the file; 0 for none.
    pub schema: u16,
    /// Name of the topic to which the channel's messages belong.
    pub topic: String,
    /// Encoding of the channel's messages, such as `protobuf` or `json`.
    pub encoding: String,
    /// Other properties of the channel, as the writing program has named them.
    pub metadata: Map,
}

/// Message of a channel, in place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageView<'a> {
    /// Id of the message's channel.
    pub channel: u16,
    /// Number of the message, as its writer counts.
    pub sequence: u32,
    /// Time at which the message was recorded \[ns\].
    pub log_time: u64,
    /// Time at which the message was published \[ns\].
    pub publish_time: u64,
    /// Content of the message in the encoding of its channel.
    pub data: &'a [u8],
}

/// Returns the profile and the library in a file's header.
pub fn header(bytes: &[u8]) -> Option<(&str, &str)> {
    let mut rest = Rest(bytes);
    Some((rest.text()?, rest.text()?)).filter(|_| rest.0.is_empty())
}

/// Decodes a schema.
pub fn schema(bytes: &[u8]) -> Option<Schema> {
    let mut rest = Rest(bytes);
    let id = rest.u16()?;
    let (name, encoding) = (rest.text()?.to_owned(), rest.text()?.to_owned());
    (id != 0).then_some(Schema { id, name, encoding, data: rest.block()?.to_vec() })
}

/// Decodes a channel.
pub fn channel(bytes: &[u8]) -> Option<Channel> {
    let mut rest = Rest(bytes);
    let (id, schema) = (rest.u16()?, rest.u16()?);
    let (topic, encoding) = (rest.text()?.to_owned(), rest.text()?.to_owned());
    Some(Channel { id, schema, topic, encoding, metadata: rest.map()? })
}

/// Whether a schema or a channel, which of them `opcode` says, can be decoded.
pub fn is_definition(opcode: u8, bytes: &[u8]) -> bool {
    if opcode == op::CHANNEL { channel(bytes).is_some() } else { schema(bytes).is_some() }
}

/// Decodes a message.
pub fn message(bytes: &[u8]) -> Option<MessageView<'_>> {
    let mut rest = Rest(bytes);
    let (channel, sequence, log_time, publish_time) = (rest.u16()?, rest.u32()?, rest.u64()?, rest.u64()?);
    Some(MessageView { channel, sequence, log_time, publish_time, data: rest.0 })
}

/// Returns the name and the values of metadata.
pub fn metadata(bytes: &[u8]) -> Option<(String, Map)> {
    let mut rest = Rest(bytes);
    let (name, values) = (rest.text()?, rest.map()?);
    // A longer one would take along what follows it.
    rest.0.is_empty().then(|| (name.to_owned(), values))
}

/// Beginning of an attachment, before its content.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AttachmentHead {
    /// Time at which the attachment was recorded \[ns\].
    pub log_time: u64,
    /// Time at which the attachment was created \[ns\].
    pub create_time: u64,
    /// Name of the attachment; in our records the path of a file as it was given.
    pub name: String,
    /// Media type of the attachment.
    pub media_type: String,
    /// Place of the content from the beginning of the element's bytes.
    pub at: u64,
    /// Length of the content \[bytes\].
    pub length: u64,
}

/// Decodes the beginning of an attachment of `length` bytes. `bytes` are its first ones, or all of them.
pub fn attachment(bytes: &[u8], length: u64) -> Option<AttachmentHead> {
    let mut rest = Rest(bytes);
    let (log_time, create_time) = (rest.u64()?, rest.u64()?);
    let (name, media_type) = (rest.text()?.to_owned(), rest.text()?.to_owned());
    let content = rest.u64()?;
    let at = (bytes.len() - rest.0.len()) as u64;
    // The checksum follows the content.
    let head = AttachmentHead { log_time, create_time, name, media_type, at, length: content };
    (at.checked_add(content)?.checked_add(4)? == length).then_some(head)
}

/// Beginning of a chunk, before its elements.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChunkHead {
    /// Time of the first message \[ns\]; 0 if there is none.
    pub first: u64,
    /// Time of the last message \[ns\]; 0 if there is none.
    pub last: u64,
    /// Length of the elements before compression \[bytes\].
    pub size: u64,
    /// Checksum (CRC-32) of the elements before compression; 0 for none.
    pub crc: u32,
    /// Name of the compression; empty for none.
    pub compression: String,
    /// Length of the elements in the file \[bytes\].
    pub stored: u64,
    /// Place of the elements from the beginning of the chunk's bytes.
    pub at: u64,
}

/// Longest name of a compression that is accepted \[bytes\].
const COMPRESSION: usize = 32;
/// Most bytes that the beginning of a chunk may have.
pub const CHUNK_HEAD: usize = 40 + COMPRESSION;

/// Decodes the beginning of a chunk of `length` bytes. `bytes` are at least its first [`CHUNK_HEAD`], or all of them.
pub fn chunk(bytes: &[u8], length: u64) -> Option<ChunkHead> {
    let mut rest = Rest(bytes);
    let (first, last, size, crc) = (rest.u64()?, rest.u64()?, rest.u64()?, rest.u32()?);
    let compression = rest.text().filter(|name| name.len() <= COMPRESSION)?.to_owned();
    let stored = rest.u64()?;
    let at = (bytes.len() - rest.0.len()) as u64;
    let consistent = at.checked_add(stored)? == length && (!compression.is_empty() || size == stored);
    consistent.then_some(ChunkHead { first, last, size, crc, compression, stored, at })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_beyond_the_bytes_is_refused_in_every_element() {
        let long = [0xff; 64];
        assert!(header(&long).is_none() && schema(&long).is_none() && channel(&long).is_none());
        assert!(metadata(&long).is_none() && attachment(&long, 64).is_none() && chunk(&long, 64).is_none());
        assert!(message(&long[..21]).is_none() && message(&long[..22]).is_some());
        assert!(Rest(&long).element().is_none());
    }

    #[test]
    fn an_attachment_ends_with_its_element() {
        let mut bytes = [0; 16].to_vec();
        bytes.extend([1, 0, 0, 0, b'a', 0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0, b'x', b'y', 1, 2, 3, 4]);
        let head = attachment(&bytes, bytes.len() as u64).expect("it is whole");
        assert_eq!((&*head.name, head.at, head.length), ("a", 33, 2));
        assert!(attachment(&bytes, bytes.len() as u64 - 1).is_none());
        bytes[25] = 3;
        assert!(attachment(&bytes, bytes.len() as u64).is_none());
    }
}
