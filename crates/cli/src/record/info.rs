//! The command `murmurate record info`: describes records.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;
use serde_json::Value;

use crate::record::chosen::first_files;
use murmurate::config::shown;
use murmurate_record::identity::Identity;
use murmurate_record::reader::{self, ReadError};
use murmurate_robot::output::print;
use murmurate_robot::{BadInput, Ended};

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
    /// Whether the record is complete and intact: its end was written, and no checksum is wrong.
    whole: bool,
    /// State of the record in words, such as `whole` or `cut`.
    state: String,
    /// Whether a part of the record has no checksum that is right, so that damage to it is not noticed.
    unchecked: bool,
    /// Damaged places of the record, with their times since its start.
    damaged: Vec<String>,
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

/// Runs `record info`: prints what records contain. Returns [`Ended::Unfit`] if one is cut, damaged or lacks events.
pub fn run(args: &Args) -> Result<Ended> {
    let paths = first_files(&args.records)?;
    let only = paths.len() == 1;
    let mut table = Table { records: Vec::new() };
    for path in paths {
        match look(&path) {
            Err(error) if only => return Err(error),
            Err(error) => table.records.push(Info { record: path, state: error.to_string(), ..Info::default() }),
            Ok(info) => table.records.push(info),
        }
    }
    print(&if args.json { serde_json::to_string(&table).context("a table is JSON")? } else { table.to_string() })?;
    let sound = table.records.iter().all(|info| info.whole && info.dropped == 0);
    Ok(if sound { Ended::Done } else { Ended::Unfit })
}

fn look(path: &Path) -> Result<Info> {
    let wrong = |error: ReadError| BadInput(error.to_string());
    let (identity, attached, mut messages) = reader::open_any(path).map_err(wrong)?;
    let health = messages.health().clone();
    let of = match identity.as_ref().map(|identity| (&identity.host, identity.repeat)) {
        _ if identity.as_ref().is_some_and(|identity| identity.operator) => "what an operator received".to_owned(),
        Some((Some(host), _)) => format!("host {}, incarnation {:08x}", host.name, host.incarnation),
        Some((None, repeat)) => format!("simulation, repeat {repeat}"),
        None if health.nothing => "nothing".to_owned(),
        None if health.loses_identity => "not known: its metadata are damaged".to_owned(),
        None => "a merged record, or another program's file".to_owned(),
    };
    let said = |of: fn(&Identity) -> String| identity.as_ref().map(of).unwrap_or_default();
    let (mut info, zero) = (Info::default(), identity.as_ref().map_or(0, |identity| identity.anchor_ns));
    (info.record, info.of, info.bytes) = (path.to_owned(), of, health.bytes);
    info.version = said(|identity| identity.version.clone());
    info.build = said(|identity| identity.build.clone());
    info.command = said(|identity| identity.arguments.join(" "));
    info.attached = attached.iter().map(|(name, _)| name.clone()).collect();
    let (mut first, mut last) = (None, 0);
    while let Some(message) = messages.next_message()? {
        first = first.or(Some(message.at));
        last = message.at.max(last);
        *info.topics.entry(message.channel.topic.clone()).or_default() += 1;
        if message.channel.encoding == "json" {
            note(&mut info, &message.data);
        }
    }
    (info.whole, info.unchecked) = (health.is_whole(), health.unchecked);
    info.state = match &health.cut {
        _ if health.nothing && health.bytes == 0 => "empty: nothing was written".to_owned(),
        _ if health.nothing => "empty: nothing was written but zeros".to_owned(),
        _ if !health.faults.is_empty() => "DAMAGED".to_owned(),
        Some(cut) => format!("cut, {}; 'record repair' gives it an end", cut.since(zero)),
        None => "whole".to_owned(),
    };
    if health.unchecked && !health.nothing {
        info.state += ", unchecked: parts of it have no checksum";
    }
    // The end of a file that is damaged and cut is one place more.
    let cut = health.cut.iter().filter(|_| !health.faults.is_empty());
    info.damaged = health.faults.iter().chain(cut).map(|fault| fault.since(zero)).collect();
    info.duration_s = last.saturating_sub(first.unwrap_or(last)) as f64 / 1e9;
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
            writeln!(f, "{}", shown::value(info.record.display()))?;
            if info.of.is_empty() {
                write!(f, "  {}", shown::value(&info.state))?;
                continue;
            }
            writeln!(f, "  of        {}", shown::value(&info.of))?;
            if !info.version.is_empty() {
                let made = format!("version {}, build {}: {}", info.version, info.build, info.command);
                writeln!(f, "  made by   {}", shown::value(made))?;
            }
            writeln!(f, "  holds     {:.2} s, {} bytes, {}", info.duration_s, info.bytes, shown::value(&info.state))?;
            for damage in &info.damaged {
                writeln!(f, "  damaged   {}", shown::value(damage))?;
            }
            if info.dropped > 0 {
                writeln!(f, "  lacks     {}, dropped when it was written", shown::counted(info.dropped, "event"))?;
            }
            if !info.attached.is_empty() {
                writeln!(f, "  files     {}", shown::value(info.attached.join(", ")))?;
            }
            if !info.verdicts.is_empty() {
                let verdicts: Vec<String> =
                    info.verdicts.iter().map(|(verdict, count)| format!("{count} {verdict}")).collect();
                writeln!(f, "  episodes  {}", shown::value(verdicts.join(", ")))?;
            }
            write!(f, "  topics    ")?;
            for (index, (topic, count)) in info.topics.iter().enumerate() {
                if index > 0 {
                    write!(f, "\n            ")?;
                }
                write!(f, "{count:>8}  {}", shown::value(topic))?;
            }
        }
        Ok(())
    }
}
