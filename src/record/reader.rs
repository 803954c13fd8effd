//! Sequential reader of record files. A file cut by a crash is read up to its last complete message.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use mcap::records::{Record, SchemaHeader, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};

use super::identity::{Identity, METADATA, WrongIdentity};
use super::series::part_of;

/// Longest MCAP record (element of a file) that is accepted \[bytes\]. It bounds the memory that a damaged length can
/// claim.
const LONGEST: usize = 1 << 27;

/// Error while a record is read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("cannot read the record '{}': {error}", path.display())]
    Open {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// The file is not MCAP, or is damaged.
    #[error("the record '{}' cannot be read: {error}", path.display())]
    Damaged {
        /// Path of the file.
        path: PathBuf,
        /// Error of the MCAP parser.
        error: McapError,
    },
    /// The identity of the record in the file cannot be used by this program.
    #[error("'{}' is no record of this program: {error}", path.display())]
    Foreign {
        /// Path of the file.
        path: PathBuf,
        /// Text that says what is wrong with the identity.
        error: WrongIdentity,
    },
    /// The file has no metadata `murmurate.run` before its first message, so it is not a record of this program.
    #[error("'{}' is no record of this program: it has no metadata '{METADATA}'", path.display())]
    Nameless {
        /// Path of the file.
        path: PathBuf,
    },
}

/// Channel of an MCAP file: a topic, with the encoding and schema of its messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Name of the topic to which the channel's messages belong.
    pub topic: String,
    /// Encoding of the channel's messages, such as `protobuf` or `json`.
    pub encoding: String,
    /// Id of the channel's schema in the file; 0 for none.
    pub schema: u16,
}

/// Message in the file of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Channel that the message belongs to.
    pub channel: Rc<Channel>,
    /// Time of the message \[ns\]: since 1970, or since the start of a simulation.
    pub at: u64,
    /// Content of the message in the encoding of its channel.
    pub data: Vec<u8>,
}

/// Element of an MCAP file.
#[derive(Clone, Debug)]
pub enum Item {
    /// Metadata: its name and its values.
    Metadata(String, BTreeMap<String, String>),
    /// Attached file: its name, media type and content.
    Attachment(String, String, Vec<u8>),
    /// Schema of messages: its id, name and encoding, and its content.
    Schema(SchemaHeader, Vec<u8>),
    /// Channel with its id in the file.
    Channel(u16, Rc<Channel>),
    /// A message of a channel.
    Message(Message),
}

/// Sequential reader of an MCAP file, which may have been cut by a crash.
pub struct Reader {
    path: PathBuf,
    file: Box<dyn Read>,
    inner: LinearReader,
    channels: BTreeMap<u16, Rc<Channel>>,
    complete: bool,
    over: bool,
    /// Index of the file being read among the files of its record, from 0; `None` if no further file belongs to the
    /// record.
    part: Option<u32>,
}

impl Reader {
    /// Opens an MCAP file. If it is the first file of a record that has several, the reader continues with the others.
    pub fn open(path: &Path) -> Result<Reader, ReadError> {
        let file = File::open(path).map_err(|error| ReadError::Open { path: path.to_owned(), error })?;
        Ok(Reader { part: Some(0), ..Reader::of(path, BufReader::with_capacity(1 << 18, file)) })
    }

    /// Returns a reader of MCAP data from any source. `path` stands for the file in errors.
    pub fn of(path: &Path, source: impl Read + 'static) -> Reader {
        let options = LinearReaderOptions::default().with_skip_end_magic(true).with_record_length_limit(LONGEST);
        Reader {
            path: path.to_owned(),
            file: Box::new(source),
            inner: LinearReader::new_with_options(options),
            channels: BTreeMap::new(),
            complete: false,
            over: false,
            part: None,
        }
    }

    /// Returns whether the mark of the end of the data was read. A file that a crash has cut has no such mark.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Returns the next element of the file; `None` at its end, or where a crash has cut it.
    pub fn next_item(&mut self) -> Result<Option<Item>, ReadError> {
        while !self.over {
            match self.inner.next_event() {
                None => self.over = true,
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                    let read = self.file.read(self.inner.insert(wanted));
                    let read = read.map_err(|error| ReadError::Open { path: self.path.clone(), error })?;
                    self.inner.notify_read(read);
                }
                Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                    if opcode == op::DATA_END {
                        if self.goes_on()? {
                            continue;
                        }
                        (self.complete, self.over) = (true, true);
                        break;
                    }
                    let damaged = |error| ReadError::Damaged { path: self.path.clone(), error };
                    let record = parse_record(opcode, data).map_err(damaged)?;
                    match item(&mut self.channels, record) {
                        // Every file of a record repeats the metadata and attachments of the first one.
                        Some(Item::Metadata(..) | Item::Attachment(..)) if self.part.is_some_and(|part| part > 0) => {}
                        Some(item) => {
                            self.note(&item);
                            return Ok(Some(item));
                        }
                        None => {}
                    }
                }
                // A crash can cut the file anywhere, even inside an MCAP record or a chunk.
                Some(Err(McapError::UnexpectedEof | McapError::UnexpectedEoc)) => self.over = true,
                Some(Err(error)) => {
                    self.over = true;
                    return Err(ReadError::Damaged { path: self.path.clone(), error });
                }
            }
        }
        Ok(None)
    }

    /// Continues with the next file of the record, and returns `true`; returns `false` if there is none.
    fn goes_on(&mut self) -> Result<bool, ReadError> {
        let Some(part) = self.part.map(|part| part + 1) else { return Ok(false) };
        let path = part_of(&self.path, part);
        if !path.exists() {
            return Ok(false);
        }
        let first = std::mem::take(&mut self.path);
        *self = Reader { path: first, part: Some(part), ..Reader::open(&path)? };
        Ok(true)
    }

    /// Notes from the record's identity whether the record may continue in other files: it does not if it has only
    /// excerpts, or if this is not its first file.
    fn note(&mut self, item: &Item) {
        if let Item::Metadata(name, metadata) = item
            && name == METADATA
        {
            let is = |field: &str, value: &str| metadata.get(field).is_none_or(|found| found == value);
            self.part = self.part.filter(|_| is("excerpt", "false") && is("part", "0"));
        }
    }

    /// Returns the next message of the file and skips other elements; `None` at its end, or where a crash has cut it.
    pub fn next_message(&mut self) -> Result<Option<Message>, ReadError> {
        while let Some(item) = self.next_item()? {
            if let Item::Message(message) = item {
                return Ok(Some(message));
            }
        }
        Ok(None)
    }
}

/// Converts a parsed MCAP record to an [`Item`], and adds channels to `channels`; `None` for index records and the
/// like.
fn item(channels: &mut BTreeMap<u16, Rc<Channel>>, record: Record<'_>) -> Option<Item> {
    match record {
        Record::Metadata(metadata) => Some(Item::Metadata(metadata.name, metadata.metadata)),
        Record::Attachment { header, data, .. } => {
            Some(Item::Attachment(header.name, header.media_type, data.into_owned()))
        }
        Record::Schema { header, data } => Some(Item::Schema(header, data.into_owned())),
        Record::Channel(channel) => {
            let known = Channel { topic: channel.topic, encoding: channel.message_encoding, schema: channel.schema_id };
            let known = Rc::new(known);
            channels.insert(channel.id, Rc::clone(&known));
            Some(Item::Channel(channel.id, known))
        }
        Record::Message { header, data } => {
            let channel = Rc::clone(channels.get(&header.channel_id)?);
            Some(Item::Message(Message { channel, at: header.log_time, data: data.into_owned() }))
        }
        _ => None,
    }
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
pub struct Messages {
    reader: Reader,
    next: Option<Message>,
}

impl Messages {
    /// Returns the next message of the record; `None` at its end, or where a crash has cut it.
    pub fn next_message(&mut self) -> Result<Option<Message>, ReadError> {
        match self.next.take() {
            Some(message) => Ok(Some(message)),
            None => self.reader.next_message(),
        }
    }

    /// Returns whether the mark of the record's end was read. A record that a crash has cut has no such mark.
    pub fn is_complete(&self) -> bool {
        self.reader.is_complete()
    }
}

/// Opens a record and reads it up to its first message. Fails if the file has no identity of a record.
pub fn open(path: &Path) -> Result<Opened, ReadError> {
    let (identity, attached, messages) = open_any(path)?;
    let identity = identity.ok_or_else(|| ReadError::Nameless { path: path.to_owned() })?;
    Ok(Opened { identity, attached, messages })
}

/// Beginning of an MCAP file: its identity if it is a record, its attached files (name and content), and the reader of
/// its messages.
pub type Beginning = (Option<Identity>, Vec<(String, Vec<u8>)>, Messages);

/// Opens an MCAP file and reads it up to its first message. The identity is `None` for a file of another program and
/// for a record that was merged of several.
pub fn open_any(path: &Path) -> Result<Beginning, ReadError> {
    let mut reader = Reader::open(path)?;
    let (mut identity, mut attached, mut next) = (None, Vec::new(), None);
    while let Some(item) = reader.next_item()? {
        match item {
            Item::Metadata(name, metadata) if name == METADATA => {
                let wrong = |error| ReadError::Foreign { path: path.to_owned(), error };
                identity = Some(Identity::of_metadata(&metadata).map_err(wrong)?);
            }
            Item::Attachment(name, _, content) => attached.push((name, content)),
            Item::Message(message) => {
                next = Some(message);
                break;
            }
            Item::Metadata(..) | Item::Schema(..) | Item::Channel(..) => {}
        }
    }
    Ok((identity, attached, Messages { reader, next }))
}
