//! Replacement for the module `recording` in a program without the feature `record`: nothing is recorded.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;

use crate::bad;
use murmurate::deploy::team::Team;
use murmurate::graph::event::Event;
use murmurate::live::LiveHost;
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::key::Key;
use murmurate::time::Time;

/// Flags for the record of a run. There are none in a program without the feature `record`.
#[derive(clap::Args, Clone, Default)]
pub struct RecordFlags {}

/// Stand-in for the record of a running process, in a program without the feature `record`. It has no values.
pub enum LiveRecord {}

impl LiveRecord {
    /// Fails if the team file names a folder for records; otherwise returns `None`, since this program cannot record.
    pub fn of_host(
        _: &RecordFlags,
        (team, _): (&Team, &LiveHost),
        _: (Instant, Option<&Key>),
        _: (Vec<PathBuf>, &str),
    ) -> Result<Option<LiveRecord>> {
        match &team.record {
            None => Ok(None),
            Some(_) => {
                bad("record: this program was built without the feature 'record'; leave the field out".to_owned())
            }
        }
    }

    /// Never called, because the type has no values.
    pub fn push(&self, _: HostId, _: Event) {
        match *self {}
    }

    /// Never called, because the type has no values.
    pub fn keep(&self) {
        match *self {}
    }

    /// Never called, because the type has no values.
    pub fn turn(&self, _: Time, _: Option<u64>) {
        match *self {}
    }

    /// Never called, because the type has no values.
    pub fn dropped(&self) -> u64 {
        match *self {}
    }

    /// Never called, because the type has no values.
    pub fn finish(&self) -> Result<()> {
        match *self {}
    }
}
