//! Repair of a record that was cut or damaged: copies everything intact to a new file with an end and an index, which
//! every MCAP reader accepts. Also files of other programs: channels, schemas, times and numbers stay as they are.

use std::io::{Seek, Write};

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions, Writer};

use super::digest;
use super::file::with_digest;
use super::reader::{Attachment, Item, Message, ReadError, Reader};

/// Error in the repair, or in another copy, of a record.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// The original file cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The new file cannot be written.
    #[error("cannot write the copy: {0}")]
    Write(#[from] McapError),
}

/// Copies everything intact of `from`, and the attachments `more`, to `to`, with an end and an index. Returns the
/// number of messages.
pub fn copy(from: &mut Reader, more: Vec<Attachment>, to: impl Write + Seek) -> Result<u64, RepairError> {
    copy_changed(from, more, to, |_| {})
}

/// Copies as [`copy`] does, with each message as `change` leaves it.
pub fn copy_changed(
    from: &mut Reader,
    more: Vec<Attachment>,
    to: impl Write + Seek,
    mut change: impl FnMut(&mut Message),
) -> Result<u64, RepairError> {
    let library = concat!("murmurate ", env!("CARGO_PKG_VERSION"));
    let options = WriteOptions::new().compression(None).profile(from.profile()).library(library);
    let mut writer = options.create(to)?;
    let metadata = metadata(from);
    metadata.iter().try_for_each(|metadata| writer.write_metadata(metadata))?;
    more.into_iter().try_for_each(|attachment| attach(&mut writer, attachment))?;
    let mut messages = 0;
    while let Some(item) = from.next_item()? {
        match item {
            Item::Metadata(..) => {}
            Item::Attachment(attachment) => attach(&mut writer, attachment)?,
            Item::Schema(schema) => {
                writer.add_schema_with_id(schema.id, &schema.name, &schema.encoding, &schema.data)?;
            }
            Item::Channel(channel) => {
                // A channel may name a schema that is lost.
                let schema = match from.has_schema(channel.schema) {
                    true => channel.schema,
                    false => 0,
                };
                let (topic, encoding) = (&channel.topic, &channel.encoding);
                writer.add_channel_with_id(channel.id, schema, topic, encoding, &channel.metadata)?;
            }
            Item::Message(mut message) => {
                change(&mut message);
                let (channel_id, sequence) = (message.channel.id, message.sequence);
                let (log_time, publish_time) = (message.at, message.published);
                let header = MessageHeader { channel_id, sequence, log_time, publish_time };
                writer.write_to_known_channel(&header, &message.data)?;
                messages += 1;
            }
        }
    }
    // A record of ours has them twice.
    let ours = metadata.iter().any(|metadata| metadata.name == digest::METADATA);
    metadata.iter().filter(|_| ours).try_for_each(|metadata| writer.write_metadata(metadata))?;
    writer.finish()?;
    Ok(messages)
}

/// Returns the metadata of a copy: those of the original, and the digests of ours, which may be fewer by now.
fn metadata(from: &Reader) -> Vec<Metadata> {
    let all = from.metadata().iter().filter(|(name, _)| name != digest::METADATA);
    let all = all.map(|(name, values)| Metadata { name: name.clone(), metadata: values.clone() });
    let (ours, theirs): (Vec<_>, Vec<_>) = all.partition(|metadata| metadata.name.starts_with("murmurate."));
    let ours = if ours.is_empty() { ours } else { with_digest(ours) };
    ours.into_iter().chain(theirs).collect()
}

fn attach<W: Write + Seek>(writer: &mut Writer<W>, attachment: Attachment) -> Result<(), McapError> {
    let Attachment { log_time, create_time, name, media_type, data } = attachment;
    writer.attach(&mcap::Attachment { log_time, create_time, name, media_type, data: data.into() })
}
