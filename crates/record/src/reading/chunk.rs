//! Decompression and check of one chunk, and the elements in it.

use std::io::Read;

use super::element::{self, ChunkHead, MessageView, Rest, op};

/// Largest chunk that is read, before and after compression \[bytes\]; others are damage. Ours have 256 kB, those of
/// other programs a few MB, or one message.
pub const MAX_CHUNK: u64 = 1 << 25;

/// Reason why a chunk cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BadChunk {
    /// The lengths in its beginning contradict each other.
    Head,
    /// It is longer than [`MAX_CHUNK`].
    Long,
    /// It is compressed in a way that this program does not read.
    Compression(String),
    /// It cannot be decompressed.
    Compressed,
    /// Its checksum is wrong.
    Checksum,
    /// It has no checksum, and should have one.
    Unchecked,
    /// Its elements do not have the form of elements.
    Elements,
}

impl std::fmt::Display for BadChunk {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            BadChunk::Head => f.write_str("a chunk's lengths are wrong"),
            BadChunk::Long => write!(f, "a chunk is longer than {MAX_CHUNK} bytes"),
            BadChunk::Compression(name) => {
                write!(f, "a chunk is compressed with {name:?}, which this program does not read: mcap decompress")
            }
            BadChunk::Compressed => f.write_str("a chunk cannot be decompressed"),
            BadChunk::Checksum => f.write_str("a chunk's checksum is wrong"),
            BadChunk::Unchecked => f.write_str("a chunk's checksum is absent"),
            BadChunk::Elements => f.write_str("a chunk's messages cannot be read"),
        }
    }
}

/// Chunk whose checksum is right, or that has none.
pub struct Chunk {
    /// Beginning of the chunk.
    pub head: ChunkHead,
    /// Elements of the chunk, without compression.
    pub elements: Vec<u8>,
}

/// Decompresses and checks the chunk with the bytes `bytes`.
pub fn open(mut bytes: Vec<u8>) -> Result<Chunk, BadChunk> {
    if bytes.len() as u64 > MAX_CHUNK {
        return Err(BadChunk::Long);
    }
    let head = element::chunk(&bytes, bytes.len() as u64).ok_or(BadChunk::Head)?;
    if head.size > MAX_CHUNK {
        return Err(BadChunk::Long);
    }
    let elements = match &*head.compression {
        "" => bytes.split_off(head.at as usize),
        "zstd" => {
            let decoder = ruzstd::decoding::StreamingDecoder::new(&bytes[head.at as usize..]);
            decompressed(decoder.map_err(|_| BadChunk::Compressed)?, head.size)?
        }
        "lz4" => decompressed(lz4_flex::frame::FrameDecoder::new(&bytes[head.at as usize..]), head.size)?,
        other => return Err(BadChunk::Compression(other.to_owned())),
    };
    if head.crc != 0 && crc32fast::hash(&elements) != head.crc {
        return Err(BadChunk::Checksum);
    }
    Ok(Chunk { head, elements })
}

fn decompressed(from: impl Read, size: u64) -> Result<Vec<u8>, BadChunk> {
    // At most `MAX_CHUNK`, and memory is taken as it is filled.
    let mut elements = Vec::with_capacity(size as usize + 1);
    // One byte more than there should be, so that more is noticed and not cut off.
    let read = from.take(size + 1).read_to_end(&mut elements);
    if read.is_err() || elements.len() as u64 != size {
        return Err(BadChunk::Compressed);
    }
    Ok(elements)
}

impl Chunk {
    /// Calls `each` with the place of each element in the chunk, its opcode and its bytes. Fails if they do not fill
    /// the chunk, or if `each` returns `None`.
    pub fn each(&self, mut each: impl FnMut(u64, u8, &[u8]) -> Option<()>) -> Result<(), BadChunk> {
        let mut rest = Rest(&self.elements);
        while !rest.0.is_empty() {
            let at = (self.elements.len() - rest.0.len()) as u64;
            rest.element().and_then(|(opcode, bytes)| each(at, opcode, bytes)).ok_or(BadChunk::Elements)?;
        }
        Ok(())
    }

    /// Returns the times of the first and last message \[ns\], as the beginning of a chunk states them.
    pub fn span(&self) -> (u64, u64) {
        let mut span: Option<(u64, u64)> = None;
        let read = self.each(|_, opcode, bytes| {
            if opcode == op::MESSAGE {
                let MessageView { log_time, .. } = element::message(bytes)?;
                span = Some(span.map_or((log_time, log_time), |(a, b)| (a.min(log_time), b.max(log_time))));
            }
            Some(())
        });
        read.ok().and(span).unwrap_or_default()
    }
}
