//! Localization: where readings of robots come from. A source is one file and one line in `REGISTRY`.
//!
//! A source is pure: it turns what its worker says, or what a World samples, into readings.

pub mod program;
pub mod simulated;

use crate::config::ConfigError;
use crate::edge::{Settings, Worker};
use crate::messages::ids::RobotId;
use crate::messages::local::Sample;
use crate::messages::wire::Reading;
use crate::time::Time;

/// What a source takes.
#[derive(Clone, Debug)]
pub enum In<'a> {
    /// The true state of a simulated robot.
    Sample(&'a Sample),
    /// Something that its worker has said.
    Packet(&'a [u8]),
}

/// What a source says.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// A robot was measured.
    Reading(Reading),
    /// What has come is not to be understood; why.
    Refused(&'static str),
}

/// Where readings of some robots come from.
pub trait Source {
    /// Something has come.
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>);

    /// When it next has something to say by itself.
    fn wake_at(&self) -> Option<Time> {
        None
    }

    /// Says what is due.
    fn wake(&mut self, _now: Time, _out: &mut Vec<Out>) {}
}

/// What is made of settings: the pure part, as often as its actor is started, and the one that does the I/O.
pub struct Made {
    /// Makes the source afresh.
    pub source: Box<dyn Fn() -> Box<dyn Source>>,
    /// Does its I/O.
    pub worker: Box<dyn Worker>,
}

/// A source by name.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name in a deployment.
    pub name: &'static str,
    /// What it listens to, in a line.
    pub about: &'static str,
    /// Makes it for some robots; wrong settings are named.
    pub make: fn(&Settings, &[RobotId]) -> Result<Made, ConfigError>,
}

/// All sources of readings of robots that are not simulated.
pub const REGISTRY: &[Entry] = &[Entry { name: "program", about: program::ABOUT, make: program::make }];
