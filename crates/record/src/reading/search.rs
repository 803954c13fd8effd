//! Search for the next intact element behind damage, among bytes that may look like one.

use std::io;

use super::chunk::{self, MAX_CHUNK};
use super::element::{self, HEAD, MAGIC, op};
use super::survey::{ATTACHMENT_HEAD, Surveyor};

impl Surveyor<'_> {
    /// Returns the place of the next intact element from `from` on, of those that can be told from other bytes.
    pub(super) fn search(&mut self, from: u64) -> io::Result<Option<u64>> {
        self.search_before(from, self.out.length)
    }

    /// Whether an intact chunk or attached file begins in the damaged element at the present place, which says that it
    /// ends at `to`, and goes on behind `to`. The damaged one's length is then wrong, as that of a block of a disk in
    /// the wrong place. One that ends before `to` may be a part of a chunk or of an attached file, as a record that
    /// is attached to a record; in others, such as an index, it shows that their length is wrong, too.
    pub(super) fn is_crossed(&mut self, to: u64) -> io::Result<bool> {
        let holds =
            self.head(self.at)?.is_some_and(|(opcode, _)| matches!(opcode, op::CHUNK | op::ATTACHMENT | op::PRIVATE..));
        let mut at = self.at + 1;
        while let Some(found) = self.search_before(at, to)? {
            let Some((opcode, end)) = self.head(found)? else { break };
            if (end > to || !holds) && matches!(opcode, op::CHUNK | op::ATTACHMENT) {
                return Ok(true);
            }
            at = if end > to { found + 1 } else { end };
        }
        Ok(false)
    }

    fn search_before(&mut self, from: u64, until: u64) -> io::Result<Option<u64>> {
        const STEP: u64 = 1 << 16;
        let mut begin = from;
        while begin < until && self.budget > 0 {
            let window = self.source.bytes(begin, STEP.min(until - begin))?;
            for (offset, byte) in window.iter().enumerate() {
                let at = begin + offset as u64;
                if matches!(*byte, op::CHUNK | op::ATTACHMENT | op::METADATA | op::DATA_END) && self.is_intact(at)? {
                    return Ok(Some(at));
                }
            }
            begin += window.len() as u64;
        }
        Ok(None)
    }

    /// Whether the bytes at `at` are an intact element, and not others that look like one.
    fn is_intact(&mut self, at: u64) -> io::Result<bool> {
        match self.head(at)? {
            Some((opcode, end)) => self.is_intact_as(opcode, at, end),
            None => Ok(false),
        }
    }

    /// Whether the bytes from `at` to `end` are an intact element of the kind `opcode`, whatever the first one says.
    pub(super) fn is_intact_as(&mut self, opcode: u8, at: u64, end: u64) -> io::Result<bool> {
        let (from, length) = (at + HEAD, end - at - HEAD);
        let begins = self.source.bytes(from, length.min(ATTACHMENT_HEAD))?;
        let likely = match opcode {
            op::CHUNK => element::chunk(&begins, length)
                .is_some_and(|head| length <= MAX_CHUNK && head.size > 0 && (head.crc != 0 || !self.ours)),
            op::ATTACHMENT => element::attachment(&begins, length).is_some(),
            op::METADATA => {
                length <= begins.len() as u64 && element::metadata(&begins).is_some_and(|(n, _)| !n.is_empty())
            }
            _ => length == 4 && self.is_end(end)?,
        };
        if !likely || self.budget < length {
            return Ok(false);
        }
        self.budget -= length;
        Ok(match opcode {
            op::CHUNK => {
                let opened = chunk::open(self.source.bytes(from, length)?);
                let read = opened.and_then(|chunk| {
                    self.budget = self.budget.saturating_sub(chunk.elements.len() as u64);
                    chunk.each(|_, _, _| Some(()))
                });
                read.is_ok()
            }
            op::ATTACHMENT => {
                let stated = self.source.bytes(end - 4, 4)?;
                self.crc(from, end - 4)?.to_le_bytes() == stated[..]
            }
            _ => true,
        })
    }

    /// Whether elements of an index follow from `at` to the end of the file, of which the last is a footer.
    pub(super) fn is_end(&mut self, mut at: u64) -> io::Result<bool> {
        let mut last = 0;
        while let Some((opcode, end)) = self.head(at)? {
            // These come before the mark of the end alone.
            if matches!(opcode, op::MESSAGE..=op::MESSAGE_INDEX | op::ATTACHMENT | op::METADATA | op::DATA_END) {
                return Ok(false);
            }
            (last, at) = (opcode, end);
            self.budget = self.budget.saturating_sub(HEAD);
            if opcode == op::FOOTER || self.budget == 0 {
                break;
            }
        }
        Ok(last == op::FOOTER && at + 8 == self.out.length && self.source.bytes(at, 8)? == MAGIC)
    }
}
