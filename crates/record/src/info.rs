//! Description of a record: of which run it is, what it contains, and whether it is complete.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::Value;

use super::identity::Identity;
use super::reader::{Beginning, ReadError};

/// Description of one record: of which run it is, what it contains, and whether it is complete.
#[derive(Default, Serialize)]
pub struct Info {
    /// Path of the record.
    pub record: PathBuf,
    /// Process that made it, such as `simulation, repeat 2`; empty if the file cannot be read.
    pub of: String,
    /// Version of the program that made it; empty if it is not known.
    pub version: String,
    /// Digest of the program that made it; empty if it is not known.
    pub build: String,
    /// Arguments of the command that made it.
    pub command: String,
    /// Names of the attached files.
    pub attached: Vec<String>,
    /// Time from its first to its last message \[s\].
    pub duration_s: f64,
    /// Size of its files \[bytes\].
    pub bytes: u64,
    /// Whether the record is complete and intact: its end was written, and no checksum is wrong.
    pub whole: bool,
    /// State of the record in words, such as `whole` or `cut`.
    pub state: String,
    /// Whether a part of the record has no checksum that is right, so that damage to it is not noticed.
    pub unchecked: bool,
    /// Damaged places of the record, with their times since its start.
    pub damaged: Vec<String>,
    /// Number of events that the record lacks, because they could not be written in time.
    pub dropped: u64,
    /// Number of messages by topic.
    pub topics: BTreeMap<String, u64>,
    /// Number of episodes by verdict.
    pub verdicts: BTreeMap<String, u64>,
}

/// Reads the record at `path`, of which `beginning` was read already, and describes it.
pub fn describe(path: &Path, (identity, attached, mut messages): Beginning) -> Result<Info, ReadError> {
    let health = messages.health().clone();
    let of = match identity.as_ref().map(|identity| (&identity.host, identity.repeat)) {
        _ if identity.as_ref().is_some_and(|identity| identity.operator) => "what an operator received".to_owned(),
        _ if identity.as_ref().is_some_and(|identity| identity.imported) => "a run from elsewhere".to_owned(),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file::RecordFile;
    use crate::reader;
    use crate::stage::Stage;
    use murmurate::trial::Trial;

    #[test]
    fn a_record_without_an_end_is_described_as_cut() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("a.mcap");
        let mut identity = Identity::here("1f", vec!["sim".to_owned(), "--seed".to_owned(), "3".to_owned()], "");
        identity.repeat = 2;
        let stage = Stage::of(&Trial::preset("sim", "passage").unwrap());
        let beginning = crate::file::Beginning { identity, attached: Vec::new() };
        let mut file = RecordFile::create(&path, &beginning, &stage).unwrap();
        file.flush().unwrap();
        let of = || describe(&path, reader::open_any(&path).unwrap()).unwrap();
        let info = of();
        assert_eq!((&*info.of, &*info.command, &*info.build), ("simulation, repeat 2", "sim --seed 3", "1f"));
        assert!(!info.whole && info.state.starts_with("cut, "), "{}", info.state);
        assert_eq!((info.attached.len(), info.dropped, info.topics.len()), (0, 0, 0));
        file.finish().unwrap();
        assert!(of().whole && of().state == "whole", "{}", of().state);
    }
}
