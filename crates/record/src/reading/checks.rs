//! Checks of single elements of a damaged file by what they say of themselves: an index of messages, an attached file.

use std::io;

use super::damage::Loss;
use super::element;
use super::survey::{ATTACHMENT_HEAD, Surveyor};

impl Surveyor<'_> {
    /// Compares the index of a channel's messages with the chunk before it. Returns `None` if it is no index.
    pub(super) fn check_index(&mut self, bytes: &[u8], end: u64) -> Option<()> {
        let mut rest = element::Rest(bytes);
        let (channel, all) = (rest.u16()?, rest.block().filter(|all| all.len() % 16 == 0)?);
        // With a longer length it would take the next chunk along.
        rest.0.is_empty().then_some(())?;
        let Some(index) = &mut self.index else { return Some(()) };
        let mut rest = element::Rest(all);
        let mut listed: Vec<(u64, u64)> = std::iter::from_fn(|| Some((rest.u64()?, rest.u64()?))).collect();
        listed.sort_unstable();
        if index.remove(&channel).unwrap_or_default() != listed {
            self.suspect(end, "an index of messages is wrong", Loss::Nothing);
        }
        Some(())
    }

    /// Checks the attachment of `length` bytes at `from`, without keeping it.
    pub(super) fn attachment(&mut self, from: u64, length: u64) -> io::Result<bool> {
        let head = self.source.bytes(from, length.min(ATTACHMENT_HEAD))?;
        if element::attachment(&head, length).is_none() {
            return Ok(false);
        }
        let stated = u32::from_le_bytes(self.source.bytes(from + length - 4, 4)?.try_into().expect("four bytes"));
        if stated == 0 && !self.ours {
            self.bare = true;
            let in_zeros = self.source.bytes(from + length - 5, 1)? == [0];
            self.unproven.push((self.at..from + length, in_zeros));
            return Ok(true);
        }
        Ok(self.crc(from, from + length - 4)? == stated)
    }

    pub(super) fn crc(&mut self, from: u64, to: u64) -> io::Result<u32> {
        let mut crc = crc32fast::Hasher::new();
        self.source.pieces(from, to, |piece| crc.update(piece))?;
        Ok(crc.finalize())
    }
}
