//! The command `murmurate record info`: describes records.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use anyhow::{Context, Result};
use serde::Serialize;
use serde_json::Value;

use crate::program::output::print;
use crate::program::replay::files;
use crate::program::{BadInput, Ended};
use crate::record::identity::Identity;
use crate::record::reader::{self, ReadError};

/// Flags of `murmurate record info`.
#[derive(clap::Args)]
pub struct Args {
    /// Records, or folders of records
    #[arg(required = true, value_name = "FILE|DIR")]
    records: Vec<PathBuf>,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// Description of one record; printed by `record info`.
#[derive(Default, Serialize)]
struct Info {
    record: PathBuf,
    of: String,
    version: String,
    build: String,
    command: String,
    /// Names of the attached files.
    attached: Vec<String>,
    duration_s: f64,
    bytes: u64,
    /// Whether the record is complete: its end was written, and no crash has cut it.
    whole: bool,
    /// Error at which reading stopped, if the record is damaged; `None` otherwise.
    damaged: Option<String>,
    /// Number of events that the record lacks, because they could not be written in time.
    dropped: u64,
    /// Number of messages by topic.
    topics: BTreeMap<String, u64>,
    /// Number of episodes by verdict.
    verdicts: BTreeMap<String, u64>,
}

#[derive(Serialize)]
struct Table {
    records: Vec<Info>,
}

/// Runs `record info`: prints what records contain. Returns [`Ended::Unfit`] if one is damaged or lacks events.
pub fn run(args: &Args) -> Result<Ended> {
    let records = files(&args.records)?.into_iter().map(look).collect::<Result<_>>()?;
    let table = Table { records };
    print(&if args.json { serde_json::to_string(&table).context("a table is JSON")? } else { table.to_string() })?;
    let sound = table.records.iter().all(|info| info.damaged.is_none() && info.dropped == 0);
    Ok(if sound { Ended::Done } else { Ended::Unfit })
}

fn look(path: PathBuf) -> Result<Info> {
    let wrong = |error: ReadError| BadInput(error.to_string());
    let (identity, attached, mut messages) = reader::open_any(&path).map_err(wrong)?;
    let of = match identity.as_ref().map(|identity| (&identity.host, identity.repeat)) {
        _ if identity.as_ref().is_some_and(|identity| identity.operator) => "what an operator received".to_owned(),
        Some((Some(host), _)) => format!("host {}, incarnation {:08x}", host.name, host.incarnation),
        Some((None, repeat)) => format!("simulation, repeat {repeat}"),
        None => "a merged record, or another program's file".to_owned(),
    };
    let said = |of: fn(&Identity) -> String| identity.as_ref().map(of).unwrap_or_default();
    let mut info = Info {
        of,
        version: said(|identity| identity.version.clone()),
        build: said(|identity| identity.build.clone()),
        command: said(|identity| identity.arguments.join(" ")),
        attached: attached.iter().map(|(name, _)| name.clone()).collect(),
        bytes: path.metadata().map_or(0, |about| about.len()),
        ..Info::default()
    };
    let (mut first, mut last) = (None, 0);
    loop {
        match messages.next_message() {
            Ok(Some(message)) => {
                first = first.or(Some(message.at));
                last = message.at.max(last);
                *info.topics.entry(message.channel.topic.clone()).or_default() += 1;
                if message.channel.encoding == "json" {
                    note(&mut info, &message.data);
                }
            }
            Ok(None) => break,
            Err(ReadError::Damaged { error, .. }) => {
                info.damaged = Some(error.to_string());
                break;
            }
            Err(error) => return Err(error.into()),
        }
    }
    info.whole = messages.is_complete();
    info.duration_s = last.saturating_sub(first.unwrap_or(last)) as f64 / 1e9;
    info.record = path;
    Ok(info)
}

fn note(info: &mut Info, data: &[u8]) {
    let Ok(said) = serde_json::from_slice::<Value>(data) else { return };
    info.dropped += said["recording_dropped"].as_u64().unwrap_or(0);
    if let Some(verdict) = said["verdict"].as_str() {
        *info.verdicts.entry(verdict.to_owned()).or_default() += 1;
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, info) in self.records.iter().enumerate() {
            if index > 0 {
                writeln!(f, "\n")?;
            }
            writeln!(f, "{}", info.record.display())?;
            writeln!(f, "  of        {}", info.of)?;
            if !info.version.is_empty() {
                writeln!(f, "  made by   version {}, build {}: {}", info.version, info.build, info.command)?;
            }
            let state = match (&info.damaged, info.whole) {
                (Some(why), _) => format!("DAMAGED: {why}"),
                (None, true) => "whole".to_owned(),
                (None, false) => "cut by a crash; 'record repair' gives it an end".to_owned(),
            };
            writeln!(f, "  holds     {:.2} s, {} bytes, {state}", info.duration_s, info.bytes)?;
            if info.dropped > 0 {
                writeln!(f, "  lacks     {} events, which were dropped", info.dropped)?;
            }
            if !info.attached.is_empty() {
                writeln!(f, "  files     {}", info.attached.join(", "))?;
            }
            if !info.verdicts.is_empty() {
                let verdicts: Vec<String> =
                    info.verdicts.iter().map(|(verdict, count)| format!("{count} {verdict}")).collect();
                writeln!(f, "  episodes  {}", verdicts.join(", "))?;
            }
            write!(f, "  topics    ")?;
            for (index, (topic, count)) in info.topics.iter().enumerate() {
                if index > 0 {
                    write!(f, "\n            ")?;
                }
                write!(f, "{count:>8}  {topic}")?;
            }
        }
        Ok(())
    }
}
