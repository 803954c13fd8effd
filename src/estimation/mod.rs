//! Estimation: from a robot's readings to what is known of it at a tick of its agent. An estimator is one file and one
//! line in `REGISTRY`.
//!
//! An estimator is pure: it counts on arrival times of this host alone, because the clock of a sensor is compared with
//! no other.

pub mod constant_velocity;
pub mod none;

use crate::messages::geometry::Motion;
use crate::messages::wire::Reading;
use crate::time::Time;

/// One robot's estimator. How old a reading may be is its Cache's to say.
pub trait Estimator: std::fmt::Debug {
    /// The robot was measured anew: `reading` has arrived at `now`.
    fn take(&mut self, now: Time, reading: &Reading);

    /// Where the robot is at `now`, and how it moves; none before the first reading.
    fn at(&self, now: Time) -> Option<Motion>;
}

/// An estimator by name.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name in flags and team files.
    pub name: &'static str,
    /// What it does, in a line.
    pub about: &'static str,
    /// Makes one that knows nothing yet.
    pub make: fn() -> Box<dyn Estimator>,
}

impl PartialEq for Entry {
    fn eq(&self, other: &Entry) -> bool {
        self.name == other.name
    }
}

/// All estimators; the first is the one that is used unless someone says otherwise.
pub const REGISTRY: &[Entry] = &[
    Entry { name: "none", about: "the last reading as it is", make: none::make },
    Entry {
        name: "constant-velocity",
        about: "the last reading, moved on by its velocity since it arrived",
        make: constant_velocity::make,
    },
];
