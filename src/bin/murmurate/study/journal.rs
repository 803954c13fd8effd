//! The journal of a study: one file a finished trial, each whole or not there, so that no moment of an interruption
//! loses more than the trials that were running.

use std::path::PathBuf;

use anyhow::{Context, Result};
use murmurate::study::record::Record;
use murmurate::study::{Job, Study};

use crate::output::WholeFile;

/// A folder of finished trials.
pub struct Journal(pub PathBuf);

impl Journal {
    /// Where a trial's record is.
    fn path(&self, study: &Study, job: Job) -> PathBuf {
        let column = study.columns[job.column].name.replace(['/', '%'], "");
        self.0.join(format!("{column}.{}.{:03}.json", job.entrant + 1, job.repeat))
    }

    /// The record of a trial; `None` if there is none that is whole, and then the trial is run again.
    pub fn read(&self, study: &Study, job: Job) -> Option<Record> {
        let text = std::fs::read_to_string(self.path(study, job)).ok()?;
        let record: Record = serde_json::from_str(&text).ok()?;
        record.is_of(study, job).then_some(record)
    }

    /// Keeps the record of a trial.
    pub fn write(&self, study: &Study, job: Job, record: &Record) -> Result<()> {
        let path = self.path(study, job);
        let text = serde_json::to_string(record).context("a record is JSON")?;
        let mut file = WholeFile::create(&path)?;
        let wrong = || format!("cannot write '{}'; what was finished before is kept", path.display());
        file.writer().write_all(text.as_bytes()).with_context(wrong)?;
        file.keep().with_context(wrong)
    }
}
