//! The command `murmurate record merge`: merges the records of a team's hosts into one, on a common clock.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use mcap::records::{MessageHeader, Metadata};
use mcap::{WriteOptions, Writer};

use crate::record::chosen::{self, Chosen, tell};
use murmurate::config::shown;
use murmurate_record::clocks::{Alignment, Part, Traffic, align};
use murmurate_record::identity::{Identity, METADATA};
use murmurate_record::reader::{self, Item, Reader};
use murmurate_record::stage;
use murmurate_robot::output::{print, talk};
use murmurate_robot::temporary::Temporary;
use murmurate_robot::{BadInput, Ended, bad};

/// Flags of `murmurate record merge`.
#[derive(clap::Args)]
pub struct Args {
    /// Records of the hosts of one run, or their folder
    #[arg(required = true, value_name = "FILE|DIR")]
    records: Vec<PathBuf>,
    /// The merged record
    #[arg(short, long, value_name = "FILE.mcap")]
    output: PathBuf,
}

/// Topics of drawings that the records of all hosts contain; the merged record has them from one host only.
const DRAWN: [&str; 4] = ["/scene", "/robots", "/tf", "/episode"];

/// Runs `record merge`: merges the records of hosts into one file, and prints the clock offset that was found for each
/// host.
pub fn run(args: &Args) -> Result<Ended> {
    let Chosen { records, left_out } = chosen::records(&args.records)?;
    let folder = args.output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let no_room = || format!("cannot write '{}'", args.output.display());
    let place = args.output.canonicalize().ok();
    if place.is_some() && records.iter().any(|(path, _)| path.canonicalize().ok() == place) {
        return bad(format!("--output: '{}' is one of the records: name another file", args.output.display()));
    }
    let mut fresh = Temporary::new_in(folder, 0o640).with_context(no_room)?;
    let Merge { parts, alignment, whole } = merge(records, fresh.seekable())?;
    fresh.sync().with_context(no_room)?;
    fresh.replace(&args.output).with_context(no_room)?;
    for part in &parts {
        let (ahead, uncertainty) = (part.clock.ahead_ns(i64::MAX / 2), part.clock.uncertainty_ns().unwrap_or(0));
        print(&format!(
            "{}: {:+.3} ms, within {:.3} ms",
            shown::value(&part.host),
            ahead as f64 / 1e6,
            uncertainty as f64 / 1e6
        ))?;
    }
    let beyond = alignment.beyond_ns as f64 / 1e6;
    print(&format!(
        "{} matched; none arrives before its sending beyond these bounds, which contain {beyond:.3} ms for \
         the lengths of turns",
        shown::counted(alignment.matched, "datagram")
    ))?;
    Ok(if whole && !left_out { Ended::Done } else { Ended::Unfit })
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
/// clock offset cannot be found is left out, and so are records that are not of hosts; damaged places are named. All
/// that is said on stderr.
pub fn merge(records: Vec<(PathBuf, Identity)>, output: &mut File) -> Result<Merge> {
    let wrong = |error: reader::ReadError| BadInput(error.to_string());
    let (only, mut whole) = (records.len() == 1, true);
    let (mut paths, mut hosts, mut traffic) = (Vec::new(), Vec::new(), Vec::new());
    for (path, identity) in records {
        let at = path.display();
        let why = match &identity.host {
            _ if identity.operator => format!("'{at}' is what an operator has received"),
            None => format!("'{at}' is the record of a simulation, which has one time already"),
            Some(host) => {
                hosts.push(format!("{}-{:08x}", host.name, host.incarnation));
                whole &= tell(reader::messages(&path).map_err(wrong)?.1.health(), identity.anchor_ns);
                traffic.push(Traffic::read(&path)?);
                paths.push(path);
                continue;
            }
        };
        if only {
            return bad(why);
        }
        talk(&format!("left out: {why}"));
        whole &= identity.operator;
    }
    if paths.is_empty() {
        return bad("none of these records is of a host".to_owned());
    }
    let mut alignment = align(&traffic);
    drop(traffic);
    let mut parts = Vec::new();
    for ((path, host), clock) in paths.into_iter().zip(hosts).zip(std::mem::take(&mut alignment.clocks)) {
        match clock {
            Some(clock) => parts.push(Part { path, host, clock }),
            None => {
                talk(&format!("warning: '{host}' is left out: no datagrams join it with the others in both directions"))
            }
        }
    }
    write(&parts, Writer::with_options(BufWriter::new(output), options())?)
        .context("cannot write the merged record")?;
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

type Merged<'a> = Writer<BufWriter<&'a mut File>>;

/// Writes the merged file: metadata, and the messages of all records in the order of their times on the common clock.
fn write(parts: &[Part], mut writer: Merged<'_>) -> Result<()> {
    let clocks = parts.iter().map(|part| {
        let (ahead, uncertainty) = (part.clock.ahead_ns(i64::MAX / 2), part.clock.uncertainty_ns().unwrap_or(0));
        (part.host.clone(), format!("{{\"ahead_ns\":{ahead},\"uncertainty_ns\":{uncertainty}}}"))
    });
    writer.write_metadata(&Metadata { name: chosen::MERGED.to_owned(), metadata: clocks.collect() })?;
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
fn painter(parts: &[Part]) -> Result<usize> {
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
    fn advance(&mut self, writer: &mut Merged<'_>) -> Result<()> {
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
    use murmurate_record::clocks::ClockDifference;

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
}
