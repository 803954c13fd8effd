//! The command `murmurate record info`: describes records.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;

use crate::record::chosen::first_files;
use murmurate::config::shown;
use murmurate_record::info::{self, Info};
use murmurate_record::reader;
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
    let beginning = reader::open_any(path).map_err(|error| BadInput(error.to_string()))?;
    Ok(info::describe(path, beginning)?)
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
