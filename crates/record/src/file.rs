//! Writes the file of a record: MCAP in uncompressed chunks, each written as a whole, so that the chunks flushed before
//! a crash can be read.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Attachment, McapError, WriteOptions, Writer};

use super::digest;
use super::identity::{Identity, METADATA};
use super::reading::damage::{End, Survey};
use super::reading::source::Source;
use super::reading::survey::survey;
use super::stage::{self, Stage};
use super::topics::Topic;

/// Size of a message in an MCAP file without its data \[bytes\]: opcode, length, channel, sequence and two times.
const MESSAGE_BYTES: u64 = 31;
/// Size of a chunk of an MCAP file, after which the next one begins \[bytes\].
const CHUNK: u64 = 1 << 18;
/// Error while a record is written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file cannot be created.
    #[error("cannot write the record '{}': {error}", path.display())]
    Create {
        /// Path of the file that cannot be created.
        path: PathBuf,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// A write has failed after the file was created.
    #[error("the record '{}' ends early: {reason}; what was written before can be read", path.display())]
    Write {
        /// Path of the file that cannot be written.
        path: PathBuf,
        /// Text that says why the write has failed.
        reason: String,
    },
}

/// File that is stored in a record as an MCAP attachment.
#[derive(Clone, Debug)]
pub struct Attached {
    /// Name of the attachment: the path as given on the command line.
    pub name: String,
    /// Media type of the file.
    pub media_type: &'static str,
    /// Content of the file.
    pub content: Vec<u8>,
}

/// Beginning of a record's file: the identity of the run, and its input files.
#[derive(Clone, Debug)]
pub struct Beginning {
    /// Identity of the recorded run.
    pub identity: Identity,
    /// Input files of the run, such as the team file and the policy file.
    pub attached: Vec<Attached>,
}

/// MCAP file of a record that is being written.
pub struct RecordFile {
    writer: Writer<NoSeek<BufWriter<File>>>,
    channels: BTreeMap<Topic, u16>,
    schemas: BTreeMap<String, u16>,
    sequence: u32,
    bytes: u64,
    /// Metadata of the file, which are written again at its end.
    metadata: Vec<Metadata>,
}

impl RecordFile {
    /// Creates the file of a record and writes its beginning. `stage` has what a picture of the run needs: hosts,
    /// ground and walls. Fails if the file exists.
    pub fn create(path: &Path, beginning: &Beginning, stage: &Stage) -> Result<RecordFile, RecordError> {
        let failed = |error| RecordError::Create { path: path.to_owned(), error };
        // Other users of the machine may not read it: it contains the team's files and the positions of its robots. It
        // is opened for reading, too, because after a failed write its content is checked.
        let mut options = OpenOptions::new();
        let file = options.read(true).write(true).create_new(true).mode(0o640).open(path).map_err(failed)?;
        let wrong = |error: McapError| RecordError::Write { path: path.to_owned(), reason: error.to_string() };
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK))
            .disable_seeking(true)
            .library(concat!("murmurate ", env!("CARGO_PKG_VERSION")));
        let writer = options.create(NoSeek::new(BufWriter::with_capacity(1 << 16, file))).map_err(wrong)?;
        let metadata = with_digest(vec![
            Metadata { name: METADATA.to_owned(), metadata: beginning.identity.to_metadata() },
            Metadata { name: stage::METADATA.to_owned(), metadata: stage.to_metadata() },
        ]);
        let (channels, schemas) = (BTreeMap::new(), BTreeMap::new());
        let mut file = RecordFile { writer, channels, schemas, sequence: 0, bytes: 0, metadata };
        file.begin(beginning).map_err(wrong)?;
        Ok(file)
    }

    fn begin(&mut self, beginning: &Beginning) -> Result<(), McapError> {
        let Beginning { identity, attached } = beginning;
        for metadata in &self.metadata {
            self.writer.write_metadata(metadata)?;
        }
        for Attached { name, media_type, content } in attached {
            self.writer.attach(&Attachment {
                log_time: identity.anchor_ns,
                create_time: identity.anchor_ns,
                name: name.clone(),
                media_type: (*media_type).to_owned(),
                data: content.into(),
            })?;
        }
        self.writer.flush()
    }

    /// Appends a message with the content `data` to the file. `at` is its time \[ns\], since 1970 or the start of a
    /// simulation; `stage` has the names of the hosts, which are parts of topics' names.
    pub fn write(&mut self, stage: &Stage, topic: Topic, at: u64, data: &[u8]) -> Result<(), McapError> {
        let channel_id = match self.channels.get(&topic) {
            Some(channel) => *channel,
            None => self.open(stage, topic)?,
        };
        let header = MessageHeader { channel_id, sequence: self.sequence, log_time: at, publish_time: at };
        self.sequence = self.sequence.wrapping_add(1);
        self.bytes += MESSAGE_BYTES + data.len() as u64;
        self.writer.write_to_known_channel(&header, data)
    }

    fn open(&mut self, stage: &Stage, topic: Topic) -> Result<u16, McapError> {
        let schema = match topic.schema() {
            None => 0,
            Some(schema) => match self.schemas.get(&schema.name) {
                Some(id) => *id,
                None => {
                    let id = self.writer.add_schema(&schema.name, schema.encoding, &schema.data)?;
                    *self.schemas.entry(schema.name).or_insert(id)
                }
            },
        };
        let channel = self.writer.add_channel(schema, &topic.name(stage), topic.encoding(), &BTreeMap::new())?;
        self.channels.insert(topic, channel);
        Ok(channel)
    }

    /// Returns the size of the messages written so far \[bytes\].
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Writes the current chunk (block of messages) to the file, so that a crash of the program does not lose it.
    pub fn flush(&mut self) -> Result<(), McapError> {
        self.writer.flush()
    }

    /// Writes the end of the file with the index that lets readers seek, and syncs the file to disk. If that fails, the
    /// file ends with its last whole chunk.
    pub fn finish(mut self) -> Result<(), McapError> {
        if let Err(error) = self.end() {
            self.salvage();
            return Err(error);
        }
        let mut file = self.writer.into_inner().into_inner();
        if let Err(error) = file.flush() {
            cut(file);
            return Err(error.into());
        }
        file.get_ref().sync_all()?;
        Ok(())
    }

    fn end(&mut self) -> Result<(), McapError> {
        // A second time, for a file whose beginning is damaged later.
        for metadata in &self.metadata {
            self.writer.write_metadata(metadata)?;
        }
        self.writer.finish().map(drop)
    }

    /// Gives up the file after a write has failed: cuts off what is behind its last whole chunk, without writing more.
    pub fn salvage(self) {
        cut(self.writer.into_inner().into_inner());
    }
}

/// Cuts off what is behind the last whole chunk of a file. What is in its buffer is not written.
fn cut(file: BufWriter<File>) {
    let (file, _) = file.into_parts();
    let Ok(copy) = file.try_clone() else { return };
    let known = Source::new(copy).and_then(|mut source| survey(&mut source));
    if let Ok(Some(Survey { end: End::Cut { at, .. }, .. })) = known {
        // An error leaves a longer file, of which as much can be read.
        let _ = file.set_len(at).and_then(|()| file.sync_all());
    }
}

/// Returns `all` metadata of a file with the metadata that hold their digests.
pub(super) fn with_digest(mut all: Vec<Metadata>) -> Vec<Metadata> {
    let named: Vec<_> = all.iter().map(|metadata| (&*metadata.name, &metadata.metadata)).collect();
    let metadata = digest::of_all(&named);
    all.push(Metadata { name: digest::METADATA.to_owned(), metadata });
    all
}

/// Converts an error of creating a further file of a record to an error of writing.
pub(super) fn broken(error: RecordError) -> McapError {
    McapError::Io(std::io::Error::other(error.to_string()))
}
