//! Merge of the records of a team's hosts into one MCAP file, in the order of a common clock.

use std::collections::BTreeMap;
use std::error::Error;
use std::io::{BufWriter, Seek, Write};
use std::path::PathBuf;

use mcap::records::{MessageHeader, Metadata};
use mcap::{WriteOptions, Writer};

use super::chosen::Unusable;
use super::clocks::{Alignment, ClockDifference, Traffic, align};
use super::identity::{Identity, MERGED, METADATA};
use super::keys::RecordedKey;
use super::reader::{self, Item, ReadError, Reader};
use super::stage;
use murmurate::net::protocol::key::Key;

/// Error of a merge of records.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    /// The records are of the wrong kind, or cannot be opened.
    #[error(transparent)]
    Unusable(#[from] Unusable),
    /// A record that was opened cannot be read to its end.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The merged file cannot be written.
    #[error("cannot write the merged record")]
    Write(#[source] Box<dyn Error + Send + Sync>),
}

/// Topics of drawings that the records of all hosts contain; the merged record has them from one host only.
const DRAWN: [&str; 4] = ["/scene", "/robots", "/tf", "/episode"];

/// Record of one host among merged records.
pub struct Part {
    /// Path of the record's file.
    pub path: PathBuf,
    /// Name of the host's process: name and incarnation of the host.
    pub host: String,
    /// Offset of the host's clock from the clock of the first record.
    pub clock: ClockDifference,
}

/// Records that were merged.
pub struct Merge {
    /// The merged records, each with its clock offset.
    pub parts: Vec<Part>,
    /// Result of the alignment of the clocks.
    pub alignment: Alignment,
    /// Whether all of them are whole, and none had to be left out.
    pub whole: bool,
}

/// Merges the records of the hosts of one run into the file `output`, in the order of a common clock. A host whose
/// clock offset cannot be found is left out, and so are records that are not of hosts. Calls `warn` with a line of text
/// for each of these, and for each damaged place. What hosts of a confidential team have received is read with `key`,
/// and stays encrypted in the merged file.
pub fn merge(
    records: Vec<(PathBuf, Identity)>,
    key: Option<&Key>,
    output: impl Write + Seek,
    mut warn: impl FnMut(&str),
) -> Result<Merge, MergeError> {
    let (only, mut whole) = (records.len() == 1, true);
    let (mut paths, mut hosts, mut traffic) = (Vec::new(), Vec::new(), Vec::new());
    for (path, identity) in records {
        let at = path.display();
        let why = match &identity.host {
            _ if identity.imported => format!("'{at}' was imported, as one record of all robots"),
            _ if identity.operator => format!("'{at}' is what an operator has received"),
            None => format!("'{at}' is the record of a simulation, which has one time already"),
            Some(host) => {
                hosts.push(host.process_name());
                let (_, messages) = reader::messages(&path).map_err(Unusable::from)?;
                messages.health().lines(identity.anchor_ns).iter().for_each(|line| warn(line));
                whole &= messages.health().is_whole();
                let of_host = Traffic::read(&path, key.map(|key| RecordedKey::new(key, host)))?;
                if of_host.is_encrypted() {
                    let why = format!(
                        "what '{at}' has received is encrypted, so its clock is not known: give the team's key with \
                         --key-file, or copies that 'record share' has made"
                    );
                    return Err(Unusable(why).into());
                }
                traffic.push(of_host);
                paths.push(path);
                continue;
            }
        };
        if only {
            return Err(Unusable(why).into());
        }
        warn(&format!("left out: {why}"));
        whole &= identity.operator;
    }
    if paths.is_empty() {
        return Err(Unusable("none of these records is of a host".to_owned()).into());
    }
    let mut alignment = align(&traffic);
    drop(traffic);
    let mut parts = Vec::new();
    for ((path, host), clock) in paths.into_iter().zip(hosts).zip(std::mem::take(&mut alignment.clocks)) {
        match clock {
            Some(clock) => parts.push(Part { path, host, clock }),
            None => {
                warn(&format!("warning: '{host}' is left out: no datagrams join it with the others in both directions"))
            }
        }
    }
    write(&parts, output).map_err(MergeError::Write)?;
    Ok(Merge { parts, alignment, whole })
}

fn options() -> WriteOptions {
    WriteOptions::new().compression(None).library(concat!("murmurate ", env!("CARGO_PKG_VERSION")))
}

/// One record of a host while it is read for the merged file.
struct Source<'a> {
    part: &'a Part,
    reader: Reader,
    schemas: BTreeMap<u16, u16>,
    /// Next message of this record that belongs into the merged file: its time on the common clock \[ns\], its channel
    /// id in the merged file, and its bytes. `None` at the end of the record.
    next: Option<(u64, u16, Vec<u8>)>,
    draws: bool,
}

type Written<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Writes the merged file: metadata, and the messages of all records in the order of their times on the common clock.
fn write(parts: &[Part], output: impl Write + Seek) -> Written<()> {
    let mut writer = Writer::with_options(BufWriter::new(output), options())?;
    let clocks = parts.iter().map(|part| {
        let (ahead, uncertainty) = part.clock.latest_ns();
        (part.host.clone(), format!("{{\"ahead_ns\":{ahead},\"uncertainty_ns\":{uncertainty}}}"))
    });
    writer.write_metadata(&Metadata { name: MERGED.to_owned(), metadata: clocks.collect() })?;
    let painter = painter(parts)?;
    let mut sources = Vec::new();
    for (index, part) in parts.iter().enumerate() {
        let (reader, schemas) = (Reader::open(&part.path)?, BTreeMap::new());
        let mut source = Source { part, reader, schemas, next: None, draws: index == painter };
        source.advance(&mut writer)?;
        sources.push(source);
    }
    let mut sequence = 0;
    while let Some(first) = sources
        .iter_mut()
        .filter(|source| source.next.is_some())
        .min_by_key(|source| source.next.as_ref().map(|(at, ..)| *at))
    {
        let (at, channel_id, data) = first.next.take().expect("those without were left out");
        writer
            .write_to_known_channel(&MessageHeader { channel_id, sequence, log_time: at, publish_time: at }, &data)?;
        sequence = sequence.wrapping_add(1);
        first.advance(&mut writer)?;
    }
    writer.finish()?;
    Ok(())
}

/// Returns the index of the record from which the merged file takes the drawings (`DRAWN`): the first one with true
/// states of simulated robots, or else record 0.
fn painter(parts: &[Part]) -> Result<usize, ReadError> {
    for (index, part) in parts.iter().enumerate() {
        let mut reader = Reader::open(&part.path)?;
        // A channel appears with its first message, which may be late: a World is restarted, or begins after readings.
        while let Some(item) = reader.next_item()? {
            if matches!(item, Item::Channel(channel) if channel.topic == "/truth") {
                return Ok(index);
            }
        }
    }
    Ok(0)
}

impl Source<'_> {
    /// Reads this record up to the next message that belongs into the merged file, and stores it in `next`. Copies
    /// metadata and schemas on the way.
    fn advance(&mut self, writer: &mut Writer<impl Write + Seek>) -> Written<()> {
        self.next = None;
        while let Some(item) = self.reader.next_item()? {
            match item {
                Item::Metadata(name, metadata) if name == METADATA => {
                    let name = format!("{METADATA}.{}", self.part.host);
                    writer.write_metadata(&Metadata { name, metadata })?;
                }
                Item::Metadata(name, metadata) if name == stage::METADATA && self.draws => {
                    writer.write_metadata(&Metadata { name, metadata })?;
                }
                Item::Schema(schema) => {
                    let id = writer.add_schema(&schema.name, &schema.encoding, &schema.data)?;
                    self.schemas.insert(schema.id, id);
                }
                Item::Message(message) => {
                    let topic = &message.channel.topic;
                    if DRAWN.contains(&&**topic) && !self.draws {
                        continue;
                    }
                    let topic = match &**topic {
                        "/tape/turn" => format!("/tape/{}", self.part.host),
                        other => other.to_owned(),
                    };
                    let schema = self.schemas.get(&message.channel.schema).copied().unwrap_or(0);
                    let channel = writer.add_channel(schema, &topic, &message.channel.encoding, &BTreeMap::new())?;
                    let at = message.at as i64;
                    let at = u64::try_from(at - self.part.clock.ahead_ns(at)).unwrap_or(0);
                    self.next = Some((at, channel, message.data));
                    return Ok(());
                }
                Item::Metadata(..) | Item::Attachment(_) | Item::Channel(_) => {}
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;

    #[test]
    fn drawings_are_of_the_record_with_true_states_even_if_they_begin_late() {
        let folder = tempfile::TempDir::new().expect("a temporary folder");
        let record = |name: &str, topics: &[&str]| {
            let path = folder.path().join(name);
            let mut writer = Writer::with_options(File::create(&path).unwrap(), options()).unwrap();
            for topic in topics {
                let channel_id = writer.add_channel(0, topic, "json", &BTreeMap::new()).unwrap();
                let header = MessageHeader { channel_id, sequence: 0, log_time: 1, publish_time: 1 };
                writer.write_to_known_channel(&header, b"{}").unwrap();
            }
            writer.finish().unwrap();
            Part { path, host: name.to_owned(), clock: ClockDifference::default() }
        };
        let drawn = ["/tape/turn", "/scene", "/robots", "/tf"];
        let parts = [record("agent", &drawn), record("world", &[&drawn[..], &["/truth", "/tf"]].concat())];
        assert_eq!(painter(&parts).unwrap(), 1);
        assert_eq!(painter(&parts[..1]).unwrap(), 0, "without true states the first one draws");
    }

    #[test]
    fn what_is_not_of_a_host_is_refused_alone_and_left_out_beside_others() {
        let simulation = || (PathBuf::from("a.mcap"), Identity::here("1f", Vec::new(), ""));
        let mut warnings = Vec::new();
        let mut of = |records| {
            let merged = merge(records, None, std::io::Cursor::new(Vec::new()), |line| warnings.push(line.to_owned()));
            merged.err().map(|error| error.to_string())
        };
        let alone = "'a.mcap' is the record of a simulation, which has one time already";
        assert_eq!(of(vec![simulation()]).as_deref(), Some(alone));
        assert_eq!(of(vec![simulation(), simulation()]).as_deref(), Some("none of these records is of a host"));
        assert_eq!(warnings, vec![format!("left out: {alone}"); 2]);
    }
}
