//! Survey of a whole MCAP file: which ranges of it are intact, and what is damaged, where.
//!
//! A chunk is used if its checksum is right, an attachment likewise. Our metadata have digests of their own. Everything
//! else is covered by the checksums of the data section and of the summary. Where the chain of elements breaks, the
//! next intact element is searched for, so a hole costs what it covers.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::ops::Range;

use super::chunk::{self, Chunk, MAX_CHUNK};
use super::damage::{Damage, End, Loss, Survey};
use super::element::{self, HEAD, MAGIC, Map, op};
use super::source::Source;

/// Largest number of damaged places that are named; what is behind the last one is not read.
const MAX_DAMAGE: usize = 1000;
/// Most bytes of schemas, channels and metadata that are kept of a file.
const MAX_KEPT: usize = 1 << 24;
/// Largest number of bytes at which an attachment's content may begin.
pub const ATTACHMENT_HEAD: u64 = 1 << 14;
/// Beginning of the name by which this program calls itself in the header of a file.
const LIBRARY: &str = "murmurate ";
/// Limit on the search for intact elements: number of times that the length of the file may be read.
const SEARCHES: u64 = 8;

/// Reads all of a file. Returns `None` if it is no MCAP file: it has neither the beginning of one nor anything intact.
pub fn survey(source: &mut Source) -> io::Result<Option<Survey>> {
    let mut surveyor = Surveyor::new(source);
    let known = surveyor.run()?;
    known.then(|| surveyor.finish()).transpose()
}

/// Content of the file from a place on.
enum Step {
    /// An intact element, up to this place.
    Intact(u64),
    /// An element that is damaged, up to this place, why, and what is lost by it.
    Damaged(u64, String, Loss),
    /// Something whose length is not known, and why it is no element.
    Broken(String),
    /// The mark of the end, up to this place, with the checksum of all before it.
    End(u64, u32),
}

pub(super) struct Surveyor<'a> {
    pub(super) source: &'a mut Source,
    pub(super) out: Survey,
    pub(super) at: u64,
    /// Time of the last intact message \[ns\].
    pub(super) time: Option<u64>,
    /// Whether this program has written the file: then nothing that can have a checksum is without one.
    pub(super) ours: bool,
    /// Places that contradict others, which is damage only if a checksum says so.
    pub(super) suspects: Vec<Damage>,
    /// Number of suspects that another program may have written as they are, so that they explain no wrong checksum.
    pub(super) doubts: usize,
    /// Attached files that have no checksum, and whether they end in a zero. Where a disk has lost a file's end, and
    /// the checksum with it, there are zeros.
    pub(super) unproven: Vec<(Range<u64>, bool)>,
    /// Messages of the last chunk by channel: time and place.
    pub(super) index: Option<BTreeMap<u16, Vec<(u64, u64)>>>,
    pub(super) used: BTreeSet<u16>,
    /// Places of chunks by checksum, length, and times of their first and last message.
    pub(super) chunks: BTreeMap<(u32, u64, u64, u64), Vec<Range<u64>>>,
    /// Channels and schemas outside chunks.
    pub(super) loose: Vec<(u8, Vec<u8>)>,
    /// Whether there are messages whose only checksum is that of the file: outside chunks, or in chunks without one.
    pub(super) has_loose_messages: bool,
    /// Whether a chunk, an attachment or metadata has no checksum of its own.
    pub(super) bare: bool,
    pub(super) metadata: Vec<(Range<u64>, String, Map)>,
    pub(super) kept: usize,
    /// Whether the checksum of all of the file is right.
    pub(super) proven: bool,
    /// Number of bytes that may still be read in searches.
    pub(super) budget: u64,
}

impl Surveyor<'_> {
    fn new(source: &mut Source) -> Surveyor<'_> {
        let length = source.length();
        Surveyor {
            source,
            out: Survey::unread(length),
            at: 0,
            time: None,
            ours: false,
            suspects: Vec::new(),
            doubts: 0,
            unproven: Vec::new(),
            index: None,
            used: BTreeSet::new(),
            chunks: BTreeMap::new(),
            loose: Vec::new(),
            has_loose_messages: false,
            bare: false,
            metadata: Vec::new(),
            kept: 0,
            proven: false,
            budget: length.saturating_mul(SEARCHES) + MAX_CHUNK,
        }
    }

    /// Goes through the file. Returns whether it is one of MCAP.
    fn run(&mut self) -> io::Result<bool> {
        let length = self.out.length;
        if length == 0 {
            return Ok(true);
        }
        let magic = length >= 8 && self.source.bytes(0, 8)? == MAGIC;
        if magic {
            self.at = 8;
        } else if self.zeros()? == length {
            self.out.end = End::Zeros;
            return Ok(true);
        } else {
            let begun = length < 8 && MAGIC.starts_with(&self.source.bytes(0, length)?);
            if !self.resume("the beginning of the file is wrong")? {
                return Ok(begun);
            }
        }
        while self.at < length {
            match self.step()? {
                Step::Intact(to) => self.intact(to),
                Step::Damaged(to, what, loss) if self.is_plausible(to)? && !self.is_crossed(to)? => {
                    self.damaged(self.at..to, what, loss);
                    self.at = to;
                }
                Step::End(to, crc) => {
                    self.ends(to, crc)?;
                    return Ok(true);
                }
                Step::Damaged(_, what, _) | Step::Broken(what) => {
                    if !self.resume(&what)? {
                        return Ok(true);
                    }
                }
            }
            if self.out.damage.len() >= MAX_DAMAGE {
                break;
            }
        }
        self.out.end = End::Cut { at: self.at, zeros: 0 };
        Ok(true)
    }

    fn intact(&mut self, to: u64) {
        match self.out.intact.last_mut() {
            Some(last) if last.end == self.at => last.end = to,
            _ => self.out.intact.push(self.at..to),
        }
        self.at = to;
    }

    pub(super) fn damaged(&mut self, range: Range<u64>, what: String, loss: Loss) {
        self.index = None;
        self.out.damage.push(Damage { range, what, times: (self.time, None), loss });
    }

    /// Notes that the element up to `to` is damaged if a checksum says that something is.
    pub(super) fn suspect(&mut self, to: u64, what: &str, loss: Loss) {
        let what = what.to_owned();
        self.suspects.push(Damage { range: self.at..to, what, times: (self.time, None), loss });
    }

    /// Goes on at the next intact element, and says that what is before it is damaged. Without one the file ends here:
    /// returns `false`.
    fn resume(&mut self, what: &str) -> io::Result<bool> {
        match self.search(self.at + 1)? {
            Some(found) => {
                self.damaged(self.at..found, what.to_owned(), Loss::Messages);
                self.at = found;
                Ok(true)
            }
            None => {
                self.out.end = End::Cut { at: self.at, zeros: self.zeros()? };
                Ok(false)
            }
        }
    }

    /// Returns the number of zeros at the end of the file, from the present place on.
    fn zeros(&mut self) -> io::Result<u64> {
        let mut zeros = 0;
        self.source.pieces(self.at, self.out.length, |piece| {
            let trailing = piece.iter().rev().take_while(|byte| **byte == 0).count();
            zeros = if trailing == piece.len() { zeros + trailing as u64 } else { trailing as u64 };
        })?;
        Ok(zeros)
    }

    /// Returns opcode and end of the element at `at`, if it is in the file.
    pub(super) fn head(&mut self, at: u64) -> io::Result<Option<(u8, u64)>> {
        if self.out.length.saturating_sub(at) < HEAD {
            return Ok(None);
        }
        let head = self.source.bytes(at, HEAD)?;
        let length = u64::from_le_bytes(head[1..].try_into().expect("eight bytes"));
        let end = at.checked_add(HEAD).and_then(|from| from.checked_add(length));
        Ok(end.filter(|end| *end <= self.out.length).map(|end| (head[0], end)))
    }

    /// Whether an element may begin at `at`, going by its opcode and its length, or the file ends there.
    fn is_plausible(&mut self, at: u64) -> io::Result<bool> {
        let known = |opcode: u8| matches!(opcode, op::SCHEMA..=op::MESSAGE_INDEX | op::ATTACHMENT | op::METADATA);
        let head = self.head(at)?;
        let fits = head.is_some_and(|(opcode, end)| known(opcode) || (opcode == op::DATA_END && end - at == HEAD + 4));
        Ok(fits || at == self.out.length)
    }

    fn step(&mut self) -> io::Result<Step> {
        let broken = |what: &str| Ok(Step::Broken(what.to_owned()));
        let Some((opcode, end)) = self.head(self.at)? else { return broken("an element has no end") };
        let (from, length) = (self.at + HEAD, end - self.at - HEAD);
        if !matches!(opcode, op::ATTACHMENT | op::CHUNK | op::PRIVATE..) && length > MAX_CHUNK {
            return broken("an element is too long");
        }
        let loss = if matches!(opcode, op::ATTACHMENT | op::METADATA) { Loss::Other } else { Loss::Messages };
        let damaged = |what: &str| Ok(Step::Damaged(end, what.to_owned(), loss));
        match opcode {
            op::CHUNK => return self.chunk(end),
            op::ATTACHMENT => {
                return match self.attachment(from, length)? {
                    true => {
                        self.out.attachments.push(self.at..end);
                        Ok(Step::Intact(end))
                    }
                    false => damaged("an attached file's checksum or length is wrong"),
                };
            }
            op::PRIVATE.. => return self.private(end),
            _ => {}
        }
        let bytes = self.source.bytes(from, length)?;
        // Almost any bytes have the form of a message, so a chunk with a wrong first byte would pass for one.
        let outside = matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE);
        if outside && element::chunk(&bytes, length).is_some() && self.is_intact_as(op::CHUNK, self.at, end)? {
            return damaged("the first byte of a chunk is wrong");
        }
        // Behind a wrong length other bytes seem to be a message, and would take intact chunks along. This program
        // writes all messages in chunks.
        if outside && (self.ours || (!self.chunks.is_empty() && self.is_crossed(end)?)) {
            return broken("no element of MCAP begins here");
        }
        let fits = match opcode {
            op::HEADER => element::header(&bytes).map(|(profile, library)| {
                self.out.profile = profile.to_owned();
                self.ours = library.starts_with(LIBRARY) && self.at == 8;
            }),
            op::SCHEMA | op::CHANNEL => {
                if !element::is_definition(opcode, &bytes) {
                    self.doubt(end, form(&bytes, length));
                }
                self.keep(bytes.len()).then(|| self.loose.push((opcode, bytes)))
            }
            op::MESSAGE => element::message(&bytes).map(|message| {
                self.has_loose_messages = true;
                self.used.insert(message.channel);
                self.pass(message.log_time, message.log_time);
            }),
            op::MESSAGE_INDEX => self.check_index(&bytes, end),
            op::METADATA => element::metadata(&bytes).filter(|_| self.keep(bytes.len())).map(|(name, values)| {
                self.metadata.push((self.at..end, name, values));
            }),
            op::DATA_END if length == 4 => {
                // A disk that has mixed up its blocks may have put a copy of the mark into the middle.
                if !self.is_end(end)? && self.search(end)?.is_some() {
                    return broken("a mark of the end is where something else was");
                }
                let crc = u32::from_le_bytes(bytes[..4].try_into().expect("four bytes"));
                return Ok(Step::End(end, crc));
            }
            _ => return broken("no element of MCAP begins here"),
        };
        match fits {
            Some(()) => Ok(Step::Intact(end)),
            None => damaged("an element cannot be read"),
        }
    }

    /// Passes over an element that is none of MCAP's own. Other programs may write such; but a wrong first byte makes
    /// one of any element, and what is in it would be left out without a word.
    fn private(&mut self, end: u64) -> io::Result<Step> {
        let (at, from, length) = (self.at, self.at + HEAD, end - self.at - HEAD);
        // These are recognized reliably: by their checksums, or as the last element before the index and the footer.
        if self.is_intact_as(op::CHUNK, at, end)? {
            return Ok(Step::Damaged(end, "the first byte of a chunk is wrong".to_owned(), Loss::Messages));
        }
        if self.is_intact_as(op::ATTACHMENT, at, end)? {
            return Ok(Step::Damaged(end, "the first byte of an attached file is wrong".to_owned(), Loss::Other));
        }
        if self.is_intact_as(op::DATA_END, at, end)? {
            return Ok(Step::Broken("the first byte of the mark of the end is wrong".to_owned()));
        }
        let begins = self.source.bytes(from, length.min(ATTACHMENT_HEAD))?;
        let form = form(&begins, length);
        // With a wrong length, too, it would take intact ones along. This program writes no such elements.
        if form.is_none() && (self.ours || self.is_crossed(end)?) {
            return Ok(Step::Broken("no element of MCAP begins here".to_owned()));
        }
        self.doubt(end, form);
        Ok(Step::Intact(end))
    }

    /// Notes that another element, perhaps of the form `form`, may have been where one is up to `end`.
    fn doubt(&mut self, end: u64, form: Option<(&str, Loss)>) {
        let unknown = ("an element of no known kind is where another may have been", Loss::Messages);
        let (what, loss) = form.unwrap_or(unknown);
        self.suspect(end, what, loss);
        self.doubts += usize::from(!self.ours);
    }

    pub(super) fn keep(&mut self, bytes: usize) -> bool {
        self.kept += bytes;
        self.kept <= MAX_KEPT
    }

    /// Notes that intact messages of the times from `first` to `last` \[ns\] come here.
    fn pass(&mut self, first: u64, last: u64) {
        for places in [&mut self.out.damage, &mut self.suspects] {
            let open = places.iter_mut().rev().take_while(|damage| damage.times.1.is_none());
            open.for_each(|damage| damage.times.1 = Some(first));
        }
        self.time = Some(last);
    }

    fn chunk(&mut self, end: u64) -> io::Result<Step> {
        let (from, length) = (self.at + HEAD, end - self.at - HEAD);
        let opened =
            if length > MAX_CHUNK { Err(chunk::BadChunk::Long) } else { chunk::open(self.source.bytes(from, length)?) };
        let opened = opened.and_then(|chunk| self.note_checksum(&chunk).map(|()| chunk));
        let taken = opened.and_then(|chunk| self.take(&chunk).map(|()| chunk));
        let chunk = match taken {
            Ok(chunk) => chunk,
            Err(chunk::BadChunk::Head) => return Ok(Step::Broken(chunk::BadChunk::Head.to_string())),
            Err(why) => return Ok(Step::Damaged(end, why.to_string(), Loss::Messages)),
        };
        let (first, last) = chunk.span();
        if (chunk.head.first, chunk.head.last) != (first, last) {
            self.suspect(from + chunk.head.at, "the times in a chunk's beginning are wrong", Loss::Nothing);
        }
        if last != 0 {
            self.pass(first, last);
        }
        if chunk.head.crc != 0 {
            let key = (chunk.head.crc, chunk.head.size, first, last);
            self.chunks.entry(key).or_default().push(self.at..end);
        }
        Ok(Step::Intact(end))
    }

    /// Notes whether a chunk has no checksum. Fails if it should have one, which a hole in the file may have taken.
    fn note_checksum(&mut self, chunk: &Chunk) -> Result<(), chunk::BadChunk> {
        // This program does not compress: another one has made a copy.
        self.ours &= chunk.head.compression.is_empty();
        if chunk.head.crc != 0 || chunk.elements.is_empty() {
            return Ok(());
        }
        if self.ours || !self.chunks.is_empty() {
            return Err(chunk::BadChunk::Unchecked);
        }
        (self.bare, self.has_loose_messages) = (true, true);
        Ok(())
    }

    /// Takes the definitions in a chunk, and where its messages are.
    fn take(&mut self, chunk: &Chunk) -> Result<(), chunk::BadChunk> {
        let mut index: BTreeMap<u16, Vec<(u64, u64)>> = BTreeMap::new();
        let mut definitions = Vec::new();
        chunk.each(|at, opcode, bytes| {
            match opcode {
                op::MESSAGE => {
                    let message = element::message(bytes)?;
                    index.entry(message.channel).or_default().push((message.log_time, at));
                }
                op::CHANNEL | op::SCHEMA => definitions.push((opcode, bytes.to_vec())),
                _ => {}
            }
            (definitions.len() <= MAX_KEPT / 16).then_some(())
        })?;
        for (opcode, bytes) in definitions {
            let kept = self.keep(bytes.len()) && self.define(opcode, &bytes);
            kept.then_some(()).ok_or(chunk::BadChunk::Elements)?;
        }
        self.used.extend(index.keys());
        index.values_mut().for_each(|all| all.sort_unstable());
        self.index = Some(index);
        Ok(())
    }

    /// Notes a channel or a schema, unless its id has one. Returns whether it can be read.
    pub(super) fn define(&mut self, opcode: u8, bytes: &[u8]) -> bool {
        if opcode == op::CHANNEL {
            let channel = element::channel(bytes);
            channel.map(|channel| self.out.channels.entry(channel.id).or_insert(channel)).is_some()
        } else {
            let schema = element::schema(bytes);
            schema.map(|schema| self.out.schemas.entry(schema.id).or_insert(schema)).is_some()
        }
    }
}

/// Returns what an element of `length` bytes that begins with the bytes `begins` may have been, and what is lost then.
/// Metadata and a header are recognized by their form alone, which an element of another program may have, too.
fn form(begins: &[u8], length: u64) -> Option<(&'static str, Loss)> {
    let all = Some(begins).filter(|bytes| bytes.len() as u64 == length)?;
    if element::metadata(all).is_some() {
        return Some(("metadata may have been here", Loss::Other));
    }
    element::header(all).map(|_| ("the header of the file may have been here", Loss::Nothing))
}
