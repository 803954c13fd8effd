//! Sequential reader of record files. Everything intact in a damaged file is read, and what is not is named.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;
use std::path::Path;
use std::rc::Rc;

use super::health::Health;
use super::identity::{Identity, METADATA};
use super::parts::{self, Part};
pub use super::read_error::{MAX_ATTACHED, ReadError};
use super::reading::chunk::{self, Chunk};
use super::reading::damage::Survey;
pub use super::reading::element::{Channel, Schema};
use super::reading::element::{HEAD, Map, Rest, attachment, message, op};
use super::reading::source::{Seekable, Source};
use super::reading::survey::ATTACHMENT_HEAD;

/// Message in the file of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Channel that the message belongs to.
    pub channel: Rc<Channel>,
    /// Number of the message, as its writer counts.
    pub sequence: u32,
    /// Time of the message \[ns\]: since 1970, or since the start of a simulation.
    pub at: u64,
    /// Time at which the message was published \[ns\]; in our records the same.
    pub published: u64,
    /// Content of the message in the encoding of its channel.
    pub data: Vec<u8>,
}

/// Attached file of an MCAP file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// Time at which the attachment was recorded \[ns\].
    pub log_time: u64,
    /// Time at which the attachment was created \[ns\].
    pub create_time: u64,
    /// Name of the attachment: the path of the file, as given to the program.
    pub name: String,
    /// Media type of the file.
    pub media_type: String,
    /// Content of the file.
    pub data: Vec<u8>,
}

/// Element of an MCAP file. Metadata, schemas, channels and attachments of a file come before its messages.
#[derive(Clone, Debug)]
pub enum Item {
    /// Metadata: its name and its values.
    Metadata(String, Map),
    /// Schema of messages.
    Schema(Rc<Schema>),
    /// Channel of messages.
    Channel(Rc<Channel>),
    /// Attached file.
    Attachment(Attachment),
    /// A message of a channel.
    Message(Message),
}

/// Sequential reader of the files of a record, which may be damaged.
pub struct Reader {
    /// Files of the record that are still to be read; the first is being read.
    parts: VecDeque<Part>,
    /// Number of files that were read to their end.
    read: usize,
    health: Health,
    /// Elements of the present file that come before its messages.
    first: VecDeque<Item>,
    attachments: VecDeque<Range<u64>>,
    channels: BTreeMap<u16, Rc<Channel>>,
    /// Place in the present file up to which it was read.
    at: u64,
    /// Chunk that is being read, and the place in it.
    chunk: Option<(Chunk, usize)>,
    attached: u64,
}

impl Reader {
    /// Opens an MCAP file and looks at all of it. If it is the first file of a record that has several, the reader goes
    /// on with the others.
    pub fn open(path: &Path) -> Result<Reader, ReadError> {
        Ok(Reader::of_parts(parts::of_record(path)?))
    }

    /// Opens one MCAP file, without others of its record.
    pub fn open_one(path: &Path) -> Result<Reader, ReadError> {
        Ok(Reader::of_parts([parts::one(path)?].into()))
    }

    /// Returns a reader of MCAP data in memory. `path` stands for the file in errors.
    pub fn of(path: &Path, source: impl Seekable + 'static) -> Result<Reader, ReadError> {
        Ok(Reader::of_parts([parts::surveyed(path, Source::new(source))?].into()))
    }

    fn of_parts(parts: VecDeque<Part>) -> Reader {
        let health = Health::of(parts.iter().map(|part| (&*part.path, &part.survey)));
        let mut reader = Reader {
            parts,
            read: 0,
            health,
            first: VecDeque::new(),
            attachments: VecDeque::new(),
            channels: BTreeMap::new(),
            at: 0,
            chunk: None,
            attached: 0,
        };
        reader.begin();
        reader
    }

    /// Begins with the present file.
    fn begin(&mut self) {
        let Some(Part { survey, .. }) = self.parts.front() else { return };
        let channels = survey.channels.iter().map(|(id, channel)| (*id, Rc::new(channel.clone())));
        self.channels = channels.collect();
        self.first = survey.schemas.values().map(|schema| Item::Schema(Rc::new(schema.clone()))).collect();
        self.first.extend(self.channels.values().map(|channel| Item::Channel(Rc::clone(channel))));
        // Every file of a record repeats the metadata and attachments of the first one.
        if self.read == 0 {
            let metadata = survey.metadata.iter().rev();
            metadata.for_each(|(name, values)| self.first.push_front(Item::Metadata(name.clone(), values.clone())));
            self.attachments = survey.attachments.iter().cloned().collect();
        }
        (self.at, self.chunk) = (0, None);
    }

    /// Returns what is known of the record's files: whether they are whole, and what is damaged in them.
    pub fn health(&self) -> &Health {
        &self.health
    }

    /// Returns the metadata of the first file, each intact: name and values.
    pub fn metadata(&self) -> &[(String, Map)] {
        self.parts.front().map_or(&[], |part| &part.survey.metadata)
    }

    /// Returns whether the present file has the schema with the id `id`.
    pub fn has_schema(&self, id: u16) -> bool {
        self.parts.front().is_some_and(|part| part.survey.schemas.contains_key(&id))
    }

    /// Returns the profile in the header of the present file, which names the conventions that it keeps.
    pub fn profile(&self) -> &str {
        self.parts.front().map_or("", |part| &part.survey.profile)
    }

    /// Returns whether the mark of the end of the data is there. A file that a crash has cut has no such mark.
    pub fn is_complete(&self) -> bool {
        self.health.cut.is_none()
    }

    /// Returns at how many places messages are lost to damage, of those before the last message that was read.
    pub fn gaps(&self) -> usize {
        let now = self.parts.front().map_or(0, |part| part.survey.losses_before(self.at.max(1)));
        now + self.health.losses.iter().take(self.read).sum::<usize>()
    }

    /// Returns the next intact element; `None` at the end.
    pub fn next_item(&mut self) -> Result<Option<Item>, ReadError> {
        if let Some(item) = self.first.pop_front() {
            return Ok(Some(item));
        }
        if let Some(range) = self.attachments.pop_front() {
            return self.attachment(range).map(|attachment| Some(Item::Attachment(attachment)));
        }
        loop {
            if let Some(message) = self.next_of_chunk() {
                return Ok(Some(Item::Message(message)));
            }
            let Some(part) = self.parts.front_mut() else { return Ok(None) };
            match next_place(&part.survey, self.at) {
                Some(at) => {
                    let failed = |error| ReadError::Open { path: part.path.clone(), error };
                    let head = part.source.bytes(at, HEAD).map_err(failed)?;
                    let length = u64::from_le_bytes(head[1..].try_into().expect("eight bytes"));
                    self.at = at + HEAD + length;
                    if !matches!(head[0], op::CHUNK | op::MESSAGE) {
                        continue;
                    }
                    let bytes = part.source.bytes(at + HEAD, length).map_err(failed)?;
                    if head[0] == op::MESSAGE {
                        let channels = &self.channels;
                        let found = message(&bytes).filter(|_| !part.survey.skips_loose);
                        if let Some(message) = found.and_then(|view| owned(channels, view)) {
                            return Ok(Some(Item::Message(message)));
                        }
                        continue;
                    }
                    let changed = |_| failed(std::io::Error::other("it has changed while it was read"));
                    let chunk = chunk::open(bytes).map_err(changed)?;
                    self.chunk = Some((chunk, 0)).filter(|(chunk, _)| chunk.head.crc != 0 || !part.survey.skips_loose);
                }
                None => {
                    // The health of the present file is needed at the end, too.
                    if self.parts.len() == 1 {
                        self.at = u64::MAX;
                        return Ok(None);
                    }
                    self.parts.pop_front();
                    self.read += 1;
                    self.begin();
                    if let Some(item) = self.first.pop_front() {
                        return Ok(Some(item));
                    }
                }
            }
        }
    }

    fn next_of_chunk(&mut self) -> Option<Message> {
        while let Some((chunk, at)) = &mut self.chunk {
            let mut rest = Rest(&chunk.elements[*at..]);
            let Some((opcode, bytes)) = rest.element() else {
                self.chunk = None;
                break;
            };
            *at = chunk.elements.len() - rest.0.len();
            if opcode == op::MESSAGE
                && let Some(message) = message(bytes).and_then(|view| owned(&self.channels, view))
            {
                return Some(message);
            }
        }
        None
    }

    fn attachment(&mut self, range: Range<u64>) -> Result<Attachment, ReadError> {
        let part = self.parts.front_mut().expect("attachments are those of a file");
        let failed = |error| ReadError::Open { path: part.path.clone(), error };
        let length = range.end - range.start - HEAD;
        self.attached += length;
        if self.attached > MAX_ATTACHED {
            return Err(ReadError::Attached { path: part.path.clone() });
        }
        let from = range.start + HEAD;
        let begins = part.source.bytes(from, length.min(ATTACHMENT_HEAD)).map_err(failed)?;
        let changed = || failed(std::io::Error::other("it has changed while it was read"));
        let head = attachment(&begins, length).ok_or_else(changed)?;
        let data = part.source.bytes(from + head.at, head.length).map_err(failed)?;
        let (name, media_type) = (head.name, head.media_type);
        Ok(Attachment { log_time: head.log_time, create_time: head.create_time, name, media_type, data })
    }

    /// Returns the attached files, each with name and content.
    fn attached(&mut self) -> Result<Vec<(String, Vec<u8>)>, ReadError> {
        let mut attached = Vec::new();
        while let Some(range) = self.attachments.pop_front() {
            let Attachment { name, data, .. } = self.attachment(range)?;
            attached.push((name, data));
        }
        Ok(attached)
    }

    /// Returns the next message of the file and skips other elements; `None` at its end.
    pub fn next_message(&mut self) -> Result<Option<Message>, ReadError> {
        (self.first, self.attachments) = Default::default();
        while let Some(item) = self.next_item()? {
            if let Item::Message(message) = item {
                return Ok(Some(message));
            }
        }
        Ok(None)
    }

    /// Returns the identity of the record; `None` for a file of another program and for a record that was merged of
    /// several.
    fn identity(&self) -> Result<Option<Identity>, ReadError> {
        let Some(part) = self.parts.front() else { return Ok(None) };
        let found = part.survey.metadata.iter().find(|(name, _)| name == METADATA);
        let wrong = |error| ReadError::Foreign { path: part.path.clone(), error };
        found.map(|(_, values)| Identity::of_metadata(values).map_err(wrong)).transpose()
    }
}

/// Returns the place of the first intact element at `at` or behind.
fn next_place(survey: &Survey, at: u64) -> Option<u64> {
    let later = survey.intact.partition_point(|range| range.end <= at);
    survey.intact.get(later).map(|range| range.start.max(at))
}

fn owned(channels: &BTreeMap<u16, Rc<Channel>>, view: super::reading::element::MessageView<'_>) -> Option<Message> {
    let channel = Rc::clone(channels.get(&view.channel)?);
    let (at, published, data) = (view.log_time, view.publish_time, view.data.to_vec());
    Some(Message { channel, sequence: view.sequence, at, published, data })
}

/// Record that was opened and read up to its first message.
pub struct Opened {
    /// Identity of the recorded run.
    pub identity: Identity,
    /// Files attached to the record, each with name and content.
    pub attached: Vec<(String, Vec<u8>)>,
    /// Reader of the record's messages, from the first one on.
    pub messages: Messages,
}

/// Reader of the messages of a record.
pub struct Messages(Reader);

impl Messages {
    /// Returns the next intact message of the record; `None` at its end.
    pub fn next_message(&mut self) -> Result<Option<Message>, ReadError> {
        self.0.next_message()
    }

    /// Returns whether the mark of the record's end is there. A record that a crash has cut has no such mark.
    pub fn is_complete(&self) -> bool {
        self.0.is_complete()
    }

    /// Returns at how many places messages are lost to damage, of those before the last message that was read.
    pub fn gaps(&self) -> usize {
        self.0.gaps()
    }

    /// Returns what is known of the record's files: whether they are whole, and what is damaged in them.
    pub fn health(&self) -> &Health {
        self.0.health()
    }
}

/// Opens a record and reads it up to its first message. Fails if the file has no identity of a record.
pub fn open(path: &Path) -> Result<Opened, ReadError> {
    let (identity, mut messages) = messages(path)?;
    let attached = messages.0.attached()?;
    Ok(Opened { identity, attached, messages })
}

/// Opens a record for its messages alone, without its attached files. Fails as [`open`].
pub fn messages(path: &Path) -> Result<(Identity, Messages), ReadError> {
    let reader = Reader::open(path)?;
    let (identity, messages) = (reader.identity()?, Messages(reader));
    let (path, health) = (path.to_owned(), messages.health());
    match identity {
        Some(identity) => Ok((identity, messages)),
        None if health.nothing => Err(ReadError::Empty { path, zeros: health.bytes > 0 }),
        None if health.loses_identity => Err(ReadError::Unidentified { path }),
        None => Err(ReadError::Nameless { path }),
    }
}

/// Beginning of an MCAP file: its identity if it is a record, its attached files (name and content), and the reader of
/// its messages.
pub type Beginning = (Option<Identity>, Vec<(String, Vec<u8>)>, Messages);

/// Opens an MCAP file and reads it up to its first message. The identity is `None` for a file of another program and
/// for a record that was merged of several.
pub fn open_any(path: &Path) -> Result<Beginning, ReadError> {
    let mut reader = Reader::open(path)?;
    let identity = reader.identity()?;
    let attached = if identity.is_some() { reader.attached()? } else { Vec::new() };
    Ok((identity, attached, Messages(reader)))
}
