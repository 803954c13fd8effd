//! Repair of a record that a crash has cut: copies its complete messages to a new file with an end and an index, which
//! every MCAP reader accepts.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{Attachment, McapError, WriteOptions, Writer};

use super::reader::{Item, ReadError, Reader};

/// Result of the repair of a record that a crash has cut.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Repaired {
    /// Number of messages that were copied.
    pub messages: u64,
    /// Whether the file was complete already and needed no repair.
    pub was_complete: bool,
}

/// Error in the repair, or in another copy, of a record.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// The original file cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The new file cannot be written.
    #[error("cannot write the repaired record: {0}")]
    Write(#[from] McapError),
}

/// Repairs a record that a crash has cut: copies all its complete elements to `to` and adds an end and an index.
pub fn repair(from: &mut Reader, to: impl Write + Seek) -> Result<Repaired, RepairError> {
    let mut copy = Copy::begin(to)?;
    while let Some(item) = from.next_item()? {
        copy.item(item)?;
    }
    let messages = copy.finish()?;
    Ok(Repaired { messages, was_complete: from.is_complete() })
}

/// Writer of a copy of an MCAP file, element by element.
pub(super) struct Copy<W: Write + Seek> {
    writer: Writer<W>,
    schemas: BTreeMap<u16, u16>,
    channels: BTreeMap<String, u16>,
    messages: u64,
}

impl<W: Write + Seek> Copy<W> {
    /// Begins a copy in the new MCAP file `to`.
    pub fn begin(to: W) -> Result<Copy<W>, McapError> {
        let library = concat!("murmurate ", env!("CARGO_PKG_VERSION"));
        let writer = WriteOptions::new().compression(None).library(library).create(to)?;
        Ok(Copy { writer, schemas: BTreeMap::new(), channels: BTreeMap::new(), messages: 0 })
    }

    /// Writes one element of the original file to the copy.
    pub fn item(&mut self, item: Item) -> Result<(), McapError> {
        match item {
            Item::Metadata(name, metadata) => {
                self.writer.write_metadata(&mcap::records::Metadata { name, metadata })?;
            }
            Item::Attachment(name, media_type, data) => {
                let data = data.into();
                self.writer.attach(&Attachment { log_time: 0, create_time: 0, name, media_type, data })?;
            }
            Item::Schema(header, data) => {
                let id = self.writer.add_schema(&header.name, &header.encoding, &data)?;
                self.schemas.insert(header.id, id);
            }
            Item::Channel(_, channel) => {
                let schema = self.schemas.get(&channel.schema).copied().unwrap_or(0);
                let id = self.writer.add_channel(schema, &channel.topic, &channel.encoding, &BTreeMap::new())?;
                self.channels.insert(channel.topic.clone(), id);
            }
            Item::Message(message) => {
                let sequence = u32::try_from(self.messages % (1 << 32)).expect("it was reduced");
                let channel_id = self.channels[&message.channel.topic];
                let header = MessageHeader { channel_id, sequence, log_time: message.at, publish_time: message.at };
                self.writer.write_to_known_channel(&header, &message.data)?;
                self.messages += 1;
            }
        }
        Ok(())
    }

    /// Writes the end and the index of the copy. Returns the number of messages in it.
    pub fn finish(mut self) -> Result<u64, McapError> {
        self.writer.finish()?;
        Ok(self.messages)
    }
}
