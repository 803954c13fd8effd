//! Reader of records, from the first byte to the last. A file that a crash has cut is read up to its last whole
//! message.

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

/// Longest record that is accepted \[bytes\], so that a damaged length takes no memory.
const LONGEST: usize = 1 << 27;

/// Error of a file that is read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("cannot read the record '{}': {error}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The reason.
        error: std::io::Error,
    },
    /// The file is not MCAP, or it is damaged.
    #[error("the record '{}' cannot be read: {error}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The reason.
        error: McapError,
    },
    /// The file has no usable identity.
    #[error("'{}' is no record of this program: {error}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// The reason.
        error: WrongIdentity,
    },
    /// The file ends before its identity.
    #[error("'{}' is no record of this program: it has no metadata '{METADATA}'", path.display())]
    Nameless {
        /// The file.
        path: PathBuf,
    },
}

/// Channel of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Its topic.
    pub topic: String,
    /// Encoding of its messages.
    pub encoding: String,
    /// Number of its schema in the file, 0 for none.
    pub schema: u16,
}

/// Message of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Its channel.
    pub channel: Rc<Channel>,
    /// Its time \[ns\] since 1970, or since the start of a simulation.
    pub at: u64,
    /// Its bytes.
    pub data: Vec<u8>,
}

/// Part of a file.
#[derive(Clone, Debug)]
pub enum Item {
    /// Metadata with its name.
    Metadata(String, BTreeMap<String, String>),
    /// A file in the file: name, media type, content.
    Attachment(String, String, Vec<u8>),
    /// Schema with its number: name, encoding, data.
    Schema(SchemaHeader, Vec<u8>),
    /// Channel with its number.
    Channel(u16, Rc<Channel>),
    /// A message.
    Message(Message),
}

/// Reader of a file.
pub struct Reader {
    path: PathBuf,
    file: Box<dyn Read>,
    inner: LinearReader,
    channels: BTreeMap<u16, Rc<Channel>>,
    complete: bool,
    over: bool,
    /// Number of the file that is read, if the record may go on in others.
    part: Option<u32>,
}

impl Reader {
    /// Opens a file.
    pub fn open(path: &Path) -> Result<Reader, ReadError> {
        let file = File::open(path).map_err(|error| ReadError::Open { path: path.to_owned(), error })?;
        Ok(Reader { part: Some(0), ..Reader::of(path, BufReader::with_capacity(1 << 18, file)) })
    }

    /// Reads a file from any source; `path` is its name in errors.
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

    /// Whether the end of the data was found: the file was finished and not cut.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Returns the next part of the file; `None` at its end.
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
                        // Those of the first file say it all.
                        Some(Item::Metadata(..) | Item::Attachment(..)) if self.part.is_some_and(|part| part > 0) => {}
                        Some(item) => {
                            self.note(&item);
                            return Ok(Some(item));
                        }
                        None => {}
                    }
                }
                // A crash cuts the file anywhere, in a record or in a chunk.
                Some(Err(McapError::UnexpectedEof | McapError::UnexpectedEoc)) => self.over = true,
                Some(Err(error)) => {
                    self.over = true;
                    return Err(ReadError::Damaged { path: self.path.clone(), error });
                }
            }
        }
        Ok(None)
    }

    /// Goes on with the next file of the record, if there is one.
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

    /// Learns from the identity whether the record may go on in other files.
    fn note(&mut self, item: &Item) {
        if let Item::Metadata(name, metadata) = item
            && name == METADATA
        {
            let is = |field: &str, value: &str| metadata.get(field).is_none_or(|found| found == value);
            self.part = self.part.filter(|_| is("excerpt", "false") && is("part", "0"));
        }
    }

    /// Returns the next message; `None` at the end of the file.
    pub fn next_message(&mut self) -> Result<Option<Message>, ReadError> {
        while let Some(item) = self.next_item()? {
            if let Item::Message(message) = item {
                return Ok(Some(message));
            }
        }
        Ok(None)
    }
}

/// Returns the part that a record is; `None` for an index.
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

/// A record whose beginning was read.
pub struct Opened {
    /// Its identity.
    pub identity: Identity,
    /// The files in it: name and content.
    pub attached: Vec<(String, Vec<u8>)>,
    /// Its messages, from the first.
    pub messages: Messages,
}

/// Messages of a record.
pub struct Messages {
    reader: Reader,
    next: Option<Message>,
}

impl Messages {
    /// Returns the next message; `None` at the end of the file.
    pub fn next_message(&mut self) -> Result<Option<Message>, ReadError> {
        match self.next.take() {
            Some(message) => Ok(Some(message)),
            None => self.reader.next_message(),
        }
    }

    /// Whether the end of the data was found: the file was finished and not cut.
    pub fn is_complete(&self) -> bool {
        self.reader.is_complete()
    }
}

/// Opens a record and reads its beginning.
pub fn open(path: &Path) -> Result<Opened, ReadError> {
    let (identity, attached, messages) = open_any(path)?;
    let identity = identity.ok_or_else(|| ReadError::Nameless { path: path.to_owned() })?;
    Ok(Opened { identity, attached, messages })
}

/// Beginning of any MCAP file: its identity if it is a record, the files in it, and its messages.
pub type Beginning = (Option<Identity>, Vec<(String, Vec<u8>)>, Messages);

/// Opens an MCAP file and reads its beginning. A merged record has no identity of its own.
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
