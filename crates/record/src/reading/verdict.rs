//! Last part of a survey: what the checksums over all of a file say, and which metadata are right.

use std::collections::BTreeSet;
use std::io;
use std::ops::Range;

use super::damage::{Damage, End, Loss, Survey};
use super::element::{HEAD, MAGIC, Map, op};
use super::survey::Surveyor;
use crate::digest;

/// Longest end of a file, behind its messages, that is checked \[bytes\].
const MAX_SUMMARY: u64 = 1 << 27;

impl Surveyor<'_> {
    /// Checks everything at the mark of the end, which is up to `to`: the data before it, by `crc`, and the summary.
    pub(super) fn ends(&mut self, to: u64, crc: u32) -> io::Result<()> {
        let mark = self.at;
        self.out.end = End::Marked;
        let absent = crc == 0 && self.ours;
        let wrong = !self.out.damage.is_empty() || absent || (crc != 0 && self.crc(0, mark)? != crc);
        let mut unexplained = false;
        if wrong {
            unexplained = self.out.damage.is_empty() && self.suspects.len() == self.doubts;
            self.out.damage.append(&mut self.suspects);
            self.leave_out_unproven();
        }
        let trusted = self.settle_metadata(unexplained)?;
        // What is wrong may be the checksum, which is a part of the mark.
        if wrong && self.has_loose_messages {
            self.out.skips_loose = true;
            let what = "a checksum over all messages that have none of their own is wrong".to_owned();
            self.damaged(0..to, what, Loss::Messages);
        } else if unexplained {
            let (of_metadata, loss) = if trusted { ("right", Loss::Nothing) } else { ("damaged", Loss::Other) };
            let is = if absent { "absent" } else { "wrong" };
            let what = format!("a checksum is {is}: messages and files are right, the metadata are {of_metadata}");
            self.damaged(0..to, what, loss);
        }
        if !wrong {
            self.define_loose();
        }
        self.proven = !wrong && crc != 0;
        self.out.damage.sort_by_key(|damage| damage.range.start);
        // Chunks may have checksums of their own; the header, and where messages are, have none.
        self.out.unchecked = crc == 0 || (wrong && self.bare);
        self.summary(to)
    }

    fn define_loose(&mut self) {
        for (opcode, bytes) in std::mem::take(&mut self.loose) {
            self.define(opcode, &bytes);
        }
    }

    /// Checks what follows the mark of the end, which is up to `from`: index, footer and magic.
    fn summary(&mut self, from: u64) -> io::Result<()> {
        let length = self.out.length;
        // Of the footer: its head, two places, and the checksum.
        let footer = length.checked_sub(8 + HEAD + 20).filter(|footer| *footer >= from && length - from < MAX_SUMMARY);
        let fits = match footer {
            None => false,
            Some(footer) => {
                let bytes = self.source.bytes(footer, HEAD + 28)?;
                let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"));
                let stated = u32::from_le_bytes(bytes[25..29].try_into().expect("four bytes"));
                let begin = if number(9) == 0 { footer } else { number(9) };
                let form = bytes[0] == op::FOOTER && number(1) == 20 && bytes[29..] == MAGIC && begin == from;
                self.out.unchecked |= stated == 0;
                form && (stated != 0 || !self.ours) && (stated == 0 || self.crc(from, footer + HEAD + 16)? == stated)
            }
        };
        if !fits {
            self.damaged(
                from..length,
                "the index at the end is wrong; nothing else is lost by that".to_owned(),
                Loss::Nothing,
            );
            return Ok(());
        }
        let mut at = from;
        while let Some((opcode, end)) = self.head(at)?.filter(|(opcode, _)| *opcode != op::FOOTER) {
            if matches!(opcode, op::SCHEMA | op::CHANNEL) {
                let bytes = self.source.bytes(at + HEAD, end - at - HEAD)?;
                if self.keep(bytes.len()) {
                    self.define(opcode, &bytes);
                }
            }
            at = end;
        }
        Ok(())
    }

    /// Decides which metadata are right by their digests. Those without one are right unless `unexplained`: the
    /// checksum of the file is wrong, and nothing else is damaged; or damage may reach into them from behind. Returns
    /// whether no metadata are in doubt for the first reason.
    fn settle_metadata(&mut self, unexplained: bool) -> io::Result<bool> {
        let starts: BTreeSet<u64> = self.out.damage.iter().map(|damage| damage.range.start).collect();
        let mut reached = Vec::new();
        for (Range { end, .. }, ..) in &self.metadata {
            let cut = matches!(self.out.end, End::Cut { at, .. } if at == *end && at < self.out.length);
            reached.push((cut || starts.contains(end)) && !begins_element(&self.source.bytes(*end, 1)?));
        }
        let all: Vec<(&str, &Map)> = self.metadata.iter().map(|(_, name, values)| (&**name, values)).collect();
        let judged = digest::judge(&all);
        for name in judged.absent {
            let (range, what) = (0..self.out.length, format!("the metadata '{name}' are absent"));
            self.out.damage.push(Damage { range, what, times: (None, None), loss: Loss::Other });
        }
        let unknown = judged.of.contains(&digest::Match::Unknown);
        self.bare |= unknown;
        let all = std::mem::take(&mut self.metadata).into_iter().zip(judged.of).zip(reached);
        for (((range, name, values), verdict), reached) in all {
            match verdict {
                digest::Match::Unknown if reached => {
                    let what =
                        format!("the metadata '{name}' have no digest, and damage begins in them or behind them");
                    self.out.damage.push(Damage { range, what, times: (None, None), loss: Loss::Other });
                    continue;
                }
                digest::Match::Unknown if unexplained => continue,
                digest::Match::Right | digest::Match::Unknown => {}
                digest::Match::Wrong { copied } => {
                    let (said, loss) = if copied { ("; a copy is right", Loss::Nothing) } else { ("", Loss::Other) };
                    let what = format!("the metadata '{name}' are damaged{said}");
                    self.out.damage.push(Damage { range, what, times: (None, None), loss });
                    continue;
                }
            }
            if !self.out.metadata.iter().any(|(known, same)| (known, same) == (&name, &values)) {
                self.out.metadata.push((name, values));
            }
        }
        Ok(!(unknown && unexplained))
    }

    /// Leaves out the attached files of which only a checksum over all of the file could say that they are right: it
    /// is wrong, or it was cut off, and zeros at the end of a file may be what a disk has lost.
    fn leave_out_unproven(&mut self) {
        let cut = self.out.end != End::Marked;
        let unproven = std::mem::take(&mut self.unproven).into_iter().filter(|(_, in_zeros)| *in_zeros || !cut);
        for (range, _) in unproven {
            self.out.attachments.retain(|known| known.start != range.start);
            let what = "an attached file has no checksum, and nothing else says that it is right".to_owned();
            self.out.damage.push(Damage { range, what, times: (None, None), loss: Loss::Other });
        }
    }

    /// Leaves out chunks that are in the file twice, as on a disk that has mixed up its blocks: of two that one which
    /// is out of order, or has damage beside it, or the later one.
    fn leave_out_strays(&mut self) {
        let chunks = std::mem::take(&mut self.chunks);
        // Place and times of the chunks that are in the file once.
        let once = chunks.iter().filter(|(_, places)| places.len() == 1);
        let mut once: Vec<(u64, u64, u64)> =
            once.map(|((.., first, last), places)| (places[0].start, *first, *last)).collect();
        once.sort_unstable();
        for ((.., first, last), places) in chunks.into_iter().filter(|(_, places)| places.len() > 1) {
            let damage = &self.out.damage;
            let beside = |place: &Range<u64>| {
                damage.iter().any(|damage| damage.range.end == place.start || damage.range.start == place.end)
            };
            let disorder = |place: &Range<u64>| {
                let (before, after) = once.split_at(once.partition_point(|(start, ..)| *start < place.start));
                let late = before.last().is_some_and(|(.., last)| *last > first);
                usize::from(late) + usize::from(after.first().is_some_and(|(_, first, _)| *first < last))
            };
            let kept = (0..places.len()).min_by_key(|number| (disorder(&places[*number]), beside(&places[*number])));
            let kept = kept.expect("there are several");
            for (_, stray) in places.into_iter().enumerate().filter(|(number, _)| *number != kept) {
                let all = std::mem::take(&mut self.out.intact).into_iter();
                let apart = |range: Range<u64>| {
                    let (before, after) =
                        (range.start..range.end.min(stray.start), range.start.max(stray.end)..range.end);
                    [before, after].into_iter().filter(|range| range.start < range.end)
                };
                self.out.intact = all.flat_map(apart).collect();
                let what = "a chunk is a copy of another one, in the place of something else".to_owned();
                let damage = Damage { range: stray, what, times: (None, None), loss: Loss::Messages };
                self.out.damage.push(damage);
            }
        }
        self.out.damage.sort_by_key(|damage| damage.range.start);
    }

    pub(super) fn finish(mut self) -> io::Result<Survey> {
        if self.out.end != End::Marked {
            self.leave_out_unproven();
        }
        if !self.proven {
            self.leave_out_strays();
        }
        if self.out.end != End::Marked {
            self.settle_metadata(false)?;
            self.define_loose();
            self.out.unchecked = self.bare || self.has_loose_messages;
        }
        self.out.last = self.time;
        let unknown: Vec<u16> = self.used.iter().copied().filter(|id| !self.out.channels.contains_key(id)).collect();
        if let Some(first) = unknown.first() {
            let what = format!("the definitions of {} channels are lost, such as that of {first}", unknown.len());
            self.damaged(0..self.out.length, what, Loss::Messages);
        }
        Ok(self.out)
    }
}

/// Whether an element of a record may begin with the bytes `bytes`. If not, damage that is noticed from here on may
/// have begun in the element before: it has then changed the first byte behind that one.
fn begins_element(bytes: &[u8]) -> bool {
    matches!(bytes, [op::CHUNK | op::ATTACHMENT | op::METADATA | op::DATA_END, ..])
}
