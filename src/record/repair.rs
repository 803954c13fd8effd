//! Repair of a record that a crash has cut: its whole messages in a new file with an end and an index, which every
//! reader takes.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{Attachment, McapError, WriteOptions, Writer};

use super::reader::{Item, ReadError, Reader};

/// What a repair has found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Repaired {
    /// Messages that were kept.
    pub messages: u64,
    /// Whether the file was whole already.
    pub was_complete: bool,
}

/// Error of a repair.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The new file cannot be written.
    #[error("cannot write the repaired record: {0}")]
    Write(#[from] McapError),
}

/// Copies all whole messages of a file to `to`.
pub fn repair(from: &mut Reader, to: impl Write + Seek) -> Result<Repaired, RepairError> {
    let library = concat!("murmurate ", env!("CARGO_PKG_VERSION"));
    let mut writer: Writer<_> = WriteOptions::new().compression(None).library(library).create(to)?;
    let (mut schemas, mut channels) = (BTreeMap::new(), BTreeMap::new());
    let mut found = Repaired::default();
    while let Some(item) = from.next_item()? {
        match item {
            Item::Metadata(name, metadata) => {
                writer.write_metadata(&mcap::records::Metadata { name, metadata })?;
            }
            Item::Attachment(name, media_type, data) => {
                writer.attach(&Attachment { log_time: 0, create_time: 0, name, media_type, data: data.into() })?;
            }
            Item::Schema(header, data) => {
                let id = writer.add_schema(&header.name, &header.encoding, &data)?;
                schemas.insert(header.id, id);
            }
            Item::Channel(_, channel) => {
                let schema = schemas.get(&channel.schema).copied().unwrap_or(0);
                let id = writer.add_channel(schema, &channel.topic, &channel.encoding, &BTreeMap::new())?;
                channels.insert(channel.topic.clone(), id);
            }
            Item::Message(message) => {
                let sequence = u32::try_from(found.messages % (1 << 32)).expect("it was reduced");
                let channel_id = channels[&message.channel.topic];
                let header = MessageHeader { channel_id, sequence, log_time: message.at, publish_time: message.at };
                writer.write_to_known_channel(&header, &message.data)?;
                found.messages += 1;
            }
        }
    }
    writer.finish()?;
    found.was_complete = from.is_complete();
    Ok(found)
}
