//! Files of one record: the first one and those that follow it, and what cannot be used of them.

use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};

use super::identity::METADATA;
use super::read_error::ReadError;
use super::reading::damage::Survey;
use super::reading::element::Map;
use super::reading::source::Source;
use super::reading::survey::survey;
use super::series::{further_parts, part_of};
use murmurate::config::regular;

/// One file of a record, with its survey.
pub(super) struct Part {
    /// Path of the file.
    pub path: PathBuf,
    /// The file's bytes.
    pub source: Source,
    /// Survey of the file: its intact and its damaged ranges.
    pub survey: Survey,
}

/// Opens the file at `path` and those that follow it in its record, if it is the first of several. Files between them
/// that are absent, or are of something else, are damage.
pub(super) fn of_record(path: &Path) -> Result<VecDeque<Part>, ReadError> {
    let first = one(path)?;
    let run = first.run().cloned();
    let is = |run: &Map, field: &str, value: &str| run.get(field).is_none_or(|found| found == value);
    let mut parts = VecDeque::from([first]);
    let Some(run) = run.filter(|run| is(run, "excerpt", "false") && is(run, "part", "0")) else { return Ok(parts) };
    let mut next = 1;
    for number in further_parts(path) {
        let path = part_of(path, number);
        if number > next {
            let what = format!("files of the record before this one are absent: {}", number - next);
            parts.push_back(lost(path.clone(), 0, what)?);
        }
        next = number.saturating_add(1);
        parts.push_back(match one(&path) {
            Ok(part) if part.is_of(&run, number) => part,
            Ok(other) => lost(path, other.survey.length, "it is of another record".to_owned())?,
            Err(ReadError::Strange { .. }) => {
                let length = path.metadata().map_or(0, |about| about.len());
                lost(path, length, "it is no MCAP file".to_owned())?
            }
            Err(error) => return Err(error),
        });
    }
    Ok(parts)
}

/// Opens the file at `path` alone.
pub(super) fn one(path: &Path) -> Result<Part, ReadError> {
    surveyed(path, regular::open(path).and_then(Source::new))
}

/// Looks at all of the bytes `source`, which are those of the file at `path`.
pub(super) fn surveyed(path: &Path, source: io::Result<Source>) -> Result<Part, ReadError> {
    let failed = |error| ReadError::Open { path: path.to_owned(), error };
    let mut source = source.map_err(failed)?;
    let survey = survey(&mut source).map_err(failed)?.ok_or_else(|| ReadError::Strange { path: path.to_owned() })?;
    Ok(Part { path: path.to_owned(), source, survey })
}

/// Returns a file of `length` bytes that cannot be used, for the reason `what`.
fn lost(path: PathBuf, length: u64, what: String) -> Result<Part, ReadError> {
    let source = Source::new(io::empty()).map_err(|error| ReadError::Open { path: path.clone(), error })?;
    Ok(Part { path, source, survey: Survey::lost(length, what) })
}

impl Part {
    /// Returns the metadata with the identity of the recorded run.
    fn run(&self) -> Option<&Map> {
        self.survey.metadata.iter().find(|(name, _)| name == METADATA).map(|(_, values)| values)
    }

    /// Returns whether the file is the one with the index `number` of the record of the run `run`. One that is damaged
    /// may have lost what says so.
    fn is_of(&self, run: &Map, number: u32) -> bool {
        let Some(own) = self.run() else { return !self.survey.is_whole() };
        let mut expected = run.clone();
        expected.insert("part".to_owned(), number.to_string());
        *own == expected
    }
}
