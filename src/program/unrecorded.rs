//! Stands in for `recording` in a program without the feature `record`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;

use crate::deploy::team::Team;
use crate::graph::process::ProcessEvent;
use crate::live::LiveHost;
use crate::messages::ids::HostId;
use crate::program::bad;
use crate::time::Time;

/// Flags for records: none.
#[derive(clap::Args, Clone, Default)]
pub struct RecordFlags {}

/// Record of a host in real time: never made.
pub enum OfHost {}

impl OfHost {
    /// Refuses a team file that asks for records.
    pub fn open(
        _: &RecordFlags,
        (team, _): (&Team, &LiveHost),
        _: (Instant, bool),
        _: (Vec<PathBuf>, &str),
    ) -> Result<Option<OfHost>> {
        match &team.record {
            None => Ok(None),
            Some(_) => {
                bad("record: this program was built without the feature 'record'; leave the field out".to_owned())
            }
        }
    }

    /// Takes an event.
    pub fn push(&self, _: HostId, _: ProcessEvent) {
        match *self {}
    }

    /// Keeps the last seconds.
    pub fn keep(&self) {
        match *self {}
    }

    /// Ends a turn.
    pub fn turn(&self, _: Time) {
        match *self {}
    }

    /// Number of events that the record lacks so far.
    pub fn dropped(&self) -> u64 {
        match *self {}
    }

    /// Ends the record.
    pub fn finish(&self) -> Result<()> {
        match *self {}
    }
}
