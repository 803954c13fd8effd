//! A host's record with one thing changed: what a comparison must notice.

use std::collections::BTreeMap;
use std::io::BufWriter;
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, WriteOptions, Writer};
use murmurate::graph::inputs::Input;
use murmurate_record::reader::{Item, Message, Reader};
use murmurate_record::tape::{self, Turn};

/// Copies a record with its turns changed.
pub fn edit(from: &Path, to: &Path, mut change: impl FnMut(&mut Turn)) {
    copy(from, to, |message| {
        if message.channel.topic == "/tape/turn" {
            let mut turn = tape::read(&message.data).expect("a turn");
            change(&mut turn);
            message.data.clear();
            tape::begin(&mut message.data, turn.now, turn.sent);
            turn.inputs.iter().for_each(|input| tape::add(&mut message.data, input));
        }
        true
    });
}

/// Copies a record; `keep` may change each message, and says whether it is copied.
pub fn copy(from: &Path, to: &Path, mut keep: impl FnMut(&mut Message) -> bool) {
    let file = BufWriter::new(std::fs::File::create(to).expect("it can be made"));
    let mut writer = Writer::with_options(file, WriteOptions::new().compression(None)).expect("a writer");
    let (mut reader, mut schemas) = (Reader::open(from).expect("a record"), BTreeMap::new());
    while let Some(item) = reader.next_item().expect("it is whole") {
        match item {
            Item::Metadata(name, metadata) => writer.write_metadata(&Metadata { name, metadata }).expect("written"),
            Item::Attachment(murmurate_record::reader::Attachment { name, media_type, data, .. }) => {
                let attachment = Attachment { log_time: 0, create_time: 0, name, media_type, data: data.into() };
                writer.attach(&attachment).expect("written");
            }
            Item::Schema(schema) => {
                let id = writer.add_schema(&schema.name, &schema.encoding, &schema.data).expect("written");
                schemas.insert(schema.id, id);
            }
            Item::Channel(..) => {}
            Item::Message(mut message) => {
                if !keep(&mut message) {
                    continue;
                }
                let schema = schemas.get(&message.channel.schema).copied().unwrap_or(0);
                let (topic, encoding) = (&message.channel.topic, &message.channel.encoding);
                let channel_id = writer.add_channel(schema, topic, encoding, &BTreeMap::new()).expect("written");
                let header = MessageHeader { channel_id, sequence: 0, log_time: message.at, publish_time: message.at };
                writer.write_to_known_channel(&header, &message.data).expect("written");
            }
        }
    }
    writer.finish().expect("written");
}

/// Whether an input is a datagram with a latent in it, going by its length.
pub fn is_latent(input: &Input) -> bool {
    matches!(input, Input::Frame(_, frame, _) if frame.len() > 140)
}
