//! Localization: sources of robots' readings. A source is one file and one line in `REGISTRY`.
//!
//! A source is pure: it turns its worker's packets, or the samples of a World, into readings.

pub mod fusion;
pub mod gpsd;
pub mod natnet;
pub mod odometry;
pub mod program;
pub mod ros2;
pub mod simulated;

use crate::config::ConfigError;
use crate::edge::{Settings, Worker};
use crate::messages::ids::RobotId;
use crate::messages::local::Sample;
use crate::messages::wire::Reading;
use crate::time::Time;

/// Input of a source.
#[derive(Clone, Debug)]
pub enum In<'a> {
    /// True state of a simulated robot.
    Sample(&'a Sample),
    /// Packet from its worker.
    Packet(&'a [u8]),
    /// Pose and velocity that a robot of this host has measured itself, in a frame of its own that drifts.
    Odometry(&'a Reading),
}

/// Output of a source.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// Reading of a robot.
    Reading(Reading),
    /// Packet that was not understood, with the reason.
    Refused(&'static str),
}

/// Source of readings of some robots.
pub trait Source {
    /// Takes an input.
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>);

    /// Time of its next wake-up; none if it needs none.
    fn wake_at(&self) -> Option<Time> {
        None
    }

    /// Does what is due at `now`.
    fn wake(&mut self, _now: Time, _out: &mut Vec<Out>) {}
}

/// Parts of a source made from settings: a constructor of the pure part, called at each start of its actor, and the
/// worker.
pub struct Parts {
    /// Makes a new source.
    pub source: Box<dyn Fn() -> Box<dyn Source>>,
    /// Does its I/O.
    pub worker: Box<dyn Worker>,
}

/// Source in a registry.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name in a deployment.
    pub name: &'static str,
    /// Description in one line.
    pub about: &'static str,
    /// Makes it for some robots; an error names the wrong setting.
    pub make: fn(&Settings, &[RobotId]) -> Result<Parts, ConfigError>,
}

/// All sources of readings of real robots.
pub const REGISTRY: &[Entry] = &[
    Entry { name: "gpsd", about: gpsd::ABOUT, make: gpsd::make },
    Entry { name: "natnet", about: natnet::ABOUT, make: natnet::make },
    Entry { name: "odometry", about: odometry::ABOUT, make: odometry::make },
    Entry { name: "program", about: program::ABOUT, make: program::make },
    Entry { name: "ros2", about: ros2::ABOUT, make: ros2::make },
];
