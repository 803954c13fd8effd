//! State of a record's files: whole, cut or damaged, with the places that are lost, in words.

use std::fmt;
use std::path::{Path, PathBuf};

use super::digest;
use super::identity::METADATA;
use super::reading::damage::{Damage, End, Loss, Survey};

/// Damaged or cut place of a record's file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// File that is damaged.
    pub path: PathBuf,
    /// First damaged byte of the file, from 0.
    pub from: u64,
    /// Place behind the last damaged byte.
    pub to: u64,
    /// Description of the damage.
    pub what: String,
    /// Time of the last intact message before the damage \[ns\]; `None` if it is the first or does not concern
    /// messages.
    pub after: Option<u64>,
    /// Time of the first intact message behind the damage \[ns\]; `None` if there is none.
    pub before: Option<u64>,
}

impl Fault {
    /// Returns the fault in words, with times since `zero` \[ns\], such as the start of the run.
    pub fn since(&self, zero: u64) -> String {
        let seconds = |at: u64| at.saturating_sub(zero) as f64 / 1e9;
        let span = match (self.after, self.before) {
            (Some(after), Some(before)) => format!(", {:.3} s to {:.3} s", seconds(after), seconds(before)),
            (Some(after), None) => format!(", after {:.3} s", seconds(after)),
            (None, Some(before)) => format!(", before {:.3} s", seconds(before)),
            (None, None) => String::new(),
        };
        format!("bytes {} to {}{span}: {}", self.from, self.to, self.what)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.since(0))
    }
}

/// State of the files of a record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// Length of all files \[bytes\].
    pub bytes: u64,
    /// Damaged places in the files, in order, without the end of a file that was cut.
    pub faults: Vec<Fault>,
    /// Place at which the first file without the mark of its end was cut; `None` if all have it.
    pub cut: Option<Fault>,
    /// Whether nothing was written: no bytes, or only zeros.
    pub nothing: bool,
    /// Whether a part of the files has no checksum, so that damage to it is not noticed.
    pub unchecked: bool,
    /// Whether the metadata that say what the record is of were there and are damaged.
    pub loses_identity: bool,
    /// Whether attached files or other metadata are lost.
    pub loses_files: bool,
    /// Number of places of each file at which messages are lost.
    pub(super) losses: Vec<usize>,
}

impl Health {
    /// Returns the state of files, each with its survey.
    pub(super) fn of<'a>(parts: impl Iterator<Item = (&'a Path, &'a Survey)>) -> Health {
        let mut health = Health { nothing: true, ..Health::default() };
        for (path, survey) in parts {
            let fault = |damage: &Damage| Fault {
                path: path.to_owned(),
                from: damage.range.start,
                to: damage.range.end,
                what: damage.what.clone(),
                after: damage.times.0,
                before: damage.times.1,
            };
            health.bytes += survey.length;
            health.nothing &= survey.is_nothing();
            health.unchecked |= survey.unchecked;
            health.faults.extend(survey.damage.iter().map(fault));
            let known = survey.metadata.iter().any(|(name, _)| name == METADATA);
            let has_digests = survey.metadata.iter().any(|(name, _)| name == digest::METADATA);
            let others = survey.damage.iter().any(|damage| damage.loss == Loss::Other);
            // Something before the first message.
            let begins = |damage: &Damage| damage.times.0.is_none() && damage.loss == Loss::Messages;
            health.loses_identity |= !known && (has_digests || others || survey.damage.iter().any(begins));
            health.loses_files |= others;
            health.losses.push(survey.losses_before(u64::MAX));
            let cut = match survey.end {
                End::Marked => None,
                End::Empty => Some((0, "nothing was written".to_owned())),
                End::Zeros => Some((0, "nothing but zeros was written".to_owned())),
                End::Cut { at, zeros: 0 } => Some((at, "the file was cut here".to_owned())),
                End::Cut { at, zeros } => Some((at, format!("the file was cut here; its last {zeros} bytes are zero"))),
            };
            let end = cut.map(|(from, what)| {
                let (path, to) = (path.to_owned(), survey.length);
                Fault { path, from, to, what, after: survey.last, before: None }
            });
            health.cut = health.cut.or(end);
        }
        health
    }

    /// Whether everything that was written is there and intact.
    pub fn is_whole(&self) -> bool {
        self.cut.is_none() && self.faults.is_empty()
    }

    /// Returns all damaged places and the cut, in words, each with the name of its file and with times since `zero`
    /// \[ns\].
    pub fn lines(&self, zero: u64) -> Vec<String> {
        let all = self.faults.iter().chain(&self.cut);
        all.map(|fault| format!("'{}' is damaged: {}", fault.path.display(), fault.since(zero))).collect()
    }
}
