//! The file of a record: MCAP in chunks without compression, each written whole, so that what was flushed before a
//! crash can be read. The writer has a thread of its own.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Attachment, McapError, WriteOptions, Writer};

use super::Event;
use super::identity::{Identity, METADATA};
use super::queue::{Inlet, Outlet, WhenFull, queue};
use super::stage::{self, Stage};
use super::topics::{Topic, Topics};

/// Size of a chunk \[bytes\].
const CHUNK: u64 = 1 << 18;
/// Time after which a file in real time is flushed. A crash loses this, the writer's pause, and what has just happened.
const FLUSH: Duration = Duration::from_millis(100);

/// Error of a record's file.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file cannot be made.
    #[error("cannot write the record '{}': {error}", path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// The reason.
        error: std::io::Error,
    },
    /// The file could not be written on.
    #[error("the record '{}' ends early: {reason}; what was written before can be read", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
}

/// File that is put into a record.
#[derive(Clone, Debug)]
pub struct Attached {
    /// Its name: the path as the command was given it.
    pub name: String,
    /// Its media type.
    pub media_type: &'static str,
    /// Its content.
    pub content: Vec<u8>,
}

/// Beginning of a record: its identity, and the files that the run was made of.
#[derive(Clone, Debug)]
pub struct Beginning {
    /// The identity.
    pub identity: Identity,
    /// The files.
    pub attached: Vec<Attached>,
}

/// File of a record that is being written.
pub struct RecordFile {
    writer: Writer<NoSeek<BufWriter<File>>>,
    channels: BTreeMap<Topic, u16>,
    schemas: BTreeMap<String, u16>,
    sequence: u32,
}

impl RecordFile {
    /// Creates a file, which must not exist, and writes its beginning.
    pub fn create(path: &Path, beginning: &Beginning, stage: &Stage) -> Result<RecordFile, RecordError> {
        let failed = |error| RecordError::Create { path: path.to_owned(), error };
        let file = OpenOptions::new().write(true).create_new(true).open(path).map_err(failed)?;
        let wrong = |error: McapError| RecordError::Write { path: path.to_owned(), reason: error.to_string() };
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK))
            .disable_seeking(true)
            .library(concat!("murmurate ", env!("CARGO_PKG_VERSION")));
        let writer = options.create(NoSeek::new(BufWriter::with_capacity(1 << 16, file))).map_err(wrong)?;
        let mut file = RecordFile { writer, channels: BTreeMap::new(), schemas: BTreeMap::new(), sequence: 0 };
        file.begin(beginning, stage).map_err(wrong)?;
        Ok(file)
    }

    fn begin(&mut self, beginning: &Beginning, stage: &Stage) -> Result<(), McapError> {
        let Beginning { identity, attached } = beginning;
        let metadata = mcap::records::Metadata { name: METADATA.to_owned(), metadata: identity.to_metadata() };
        self.writer.write_metadata(&metadata)?;
        let metadata = mcap::records::Metadata { name: stage::METADATA.to_owned(), metadata: stage.to_metadata() };
        self.writer.write_metadata(&metadata)?;
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

    /// Appends a message.
    pub fn write(&mut self, stage: &Stage, topic: Topic, at: u64, data: &[u8]) -> Result<(), McapError> {
        let channel_id = match self.channels.get(&topic) {
            Some(channel) => *channel,
            None => self.open(stage, topic)?,
        };
        let header = MessageHeader { channel_id, sequence: self.sequence, log_time: at, publish_time: at };
        self.sequence = self.sequence.wrapping_add(1);
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

    /// Ends the chunk and hands all to the operating system.
    pub fn flush(&mut self) -> Result<(), McapError> {
        self.writer.flush()
    }

    /// Writes the end, with the summary that lets readers seek.
    pub fn finish(mut self) -> Result<(), McapError> {
        self.writer.finish()?;
        let mut file = self.writer.into_inner().into_inner();
        file.flush()?;
        file.get_ref().sync_all()?;
        Ok(())
    }
}

/// Record that is being made: its queue, and the thread that writes its file.
pub struct Recording {
    inlet: Rc<Inlet>,
    thread: JoinHandle<()>,
    path: PathBuf,
    failure: Arc<Mutex<Option<String>>>,
}

impl Recording {
    /// Creates the file and starts the writer's thread.
    pub fn start(
        path: &Path,
        beginning: &Beginning,
        topics: Topics,
        when_full: WhenFull,
    ) -> Result<Recording, RecordError> {
        let file = RecordFile::create(path, beginning, topics.stage())?;
        let (inlet, outlet) = queue(when_full);
        let failure = Arc::new(Mutex::new(None));
        let failed = Arc::clone(&failure);
        let flush = (when_full == WhenFull::Drop).then_some(FLUSH);
        let thread = thread::Builder::new()
            .name("record".to_owned())
            .spawn(move || {
                if let Err(error) = serve(file, &outlet, topics, flush) {
                    *failed.lock().unwrap_or_else(|poisoned| poisoned.into_inner()) = Some(reason(&error));
                }
            })
            .map_err(|error| RecordError::Create { path: path.to_owned(), error })?;
        Ok(Recording { inlet: Rc::new(inlet), thread, path: path.to_owned(), failure })
    }

    /// Returns the end of the queue at the thread that runs actors.
    pub fn inlet(&self) -> Rc<Inlet> {
        Rc::clone(&self.inlet)
    }

    /// Reason why the file could not be written on, once.
    pub fn failure(&self) -> Option<RecordError> {
        let reason = self.failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).take()?;
        Some(RecordError::Write { path: self.path.clone(), reason })
    }

    /// Ends the record and waits for the writer: at most for `most`, or as long as it takes. Returns the number of
    /// events that the record lacks.
    pub fn finish(self, most: Option<Duration>) -> Result<u64, RecordError> {
        self.inlet.close();
        let until = most.map(|most| (most, Instant::now() + most));
        while !self.thread.is_finished() && until.is_none_or(|(_, until)| Instant::now() < until) {
            thread::park_timeout(Duration::from_millis(2));
        }
        if let (false, Some((most, _))) = (self.thread.is_finished(), until) {
            let reason = format!("its disk has taken more than {} s", most.as_secs_f64());
            return Err(RecordError::Write { path: self.path, reason });
        }
        match self.failure() {
            Some(error) => Err(error),
            None => Ok(self.inlet.dropped()),
        }
    }
}

/// Returns the reason of an error: what the operating system said, where it said something.
fn reason(error: &McapError) -> String {
    match error {
        McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

/// Writes what comes through the queue until its other end is closed.
fn serve(mut file: RecordFile, outlet: &Outlet, mut topics: Topics, flush: Option<Duration>) -> Result<(), McapError> {
    let (mut taken, mut instant) = (Vec::new(), Vec::new());
    let (mut flushed, mut written) = (Instant::now(), false);
    let stage = topics.stage().clone();
    while outlet.take(&mut taken) {
        for event in taken.drain(..) {
            let Event::Turn(now) = event else {
                instant.push(event);
                continue;
            };
            let mut result = Ok(());
            topics.instant(now, &instant, &mut |topic, at, data| {
                if result.is_ok() {
                    result = file.write(&stage, topic, at, data);
                }
            });
            result?;
            instant.clear();
            written = true;
        }
        if flush.is_some_and(|period| written && flushed.elapsed() >= period) {
            file.flush()?;
            (flushed, written) = (Instant::now(), false);
        }
    }
    file.finish()
}
