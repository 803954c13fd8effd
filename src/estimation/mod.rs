//! Estimators: compute a robot's state at a tick of its agent from the robot's readings. An estimator is one file and
//! one line in `REGISTRY`.
//!
//! An estimator does no I/O. Ages of readings count from their arrival on this host: an estimator that uses a sensor's
//! stamps estimates the offset of the sensor's clock from arrival times.

mod constant_velocity;
mod kalman;
mod none;

use crate::messages::geometry::Motion;
use crate::messages::wire::Reading;
use crate::time::{Span, Time};

/// Settings from which an estimator of a robot's state is made.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Settings {
    /// Known, constant part of the delay from a measurement to the arrival of its reading: a property of the source,
    /// which cannot be computed from arrival times and stamps.
    pub delay: Span,
}

/// Estimator of one robot: computes the robot's position and velocity at a given time from its readings. The robot's
/// Cache stops using it when the newest reading is too old.
pub trait Estimator: std::fmt::Debug {
    /// Updates the estimate with a reading that has arrived at `now`.
    fn take(&mut self, now: Time, reading: &Reading);

    /// Returns the estimated position and velocity at `now`, in the frame of the readings; `None` before the first
    /// reading.
    fn at(&self, now: Time) -> Option<Motion>;

    /// Returns the standard deviation of the estimated position along each axis at `now` \[m\]; 0 for an estimator that
    /// does not know it.
    fn deviation_m(&self, _now: Time) -> f32 {
        0.0
    }

    /// Returns true if the estimator finds velocities from positions alone, where a reading does not state how accurate
    /// its velocity is. Then a source may put out positions without a velocity.
    fn finds_velocities(&self) -> bool {
        false
    }
}

/// Entry of a kind of estimator in the registry: its name, its description, and the function that makes it.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name of the estimator in flags and team files.
    pub name: &'static str,
    /// Description of the estimator in one line, for lists of all estimators.
    pub about: &'static str,
    /// Makes an estimator of this kind that has received no reading yet.
    pub make: fn(&Settings) -> Box<dyn Estimator>,
}

impl PartialEq for Entry {
    fn eq(&self, other: &Entry) -> bool {
        self.name == other.name
    }
}

/// All estimators of this crate, from which a user selects one by name; the first is the default.
pub const REGISTRY: &[Entry] = &[
    Entry { name: "none", about: "the last reading, unchanged", make: none::make },
    Entry {
        name: "constant-velocity",
        about: "the last reading, moved on by its velocity since it arrived",
        make: constant_velocity::make,
    },
    Entry {
        name: "kalman",
        about: "a filter of constant velocity, from the time of measurement to the tick; ignores outliers",
        make: kalman::make,
    },
];
