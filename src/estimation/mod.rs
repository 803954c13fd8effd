//! Estimation: from a robot's readings to its state at a tick of its agent. An estimator is one file and one line in
//! `REGISTRY`.
//!
//! An estimator is pure. It uses arrival times on this host only, because a sensor's clock is compared with no other.

pub mod constant_velocity;
pub mod kalman;
pub mod none;

use crate::messages::geometry::Motion;
use crate::messages::wire::Reading;
use crate::time::{Span, Time};

/// Settings of an estimator.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Settings {
    /// Time from a measurement to its arrival that is known and constant: a property of the source. Arrival times and
    /// stamps alone do not show it.
    pub delay: Span,
}

/// Estimator of one robot. Its Cache limits the age of readings.
pub trait Estimator: std::fmt::Debug {
    /// Takes a reading that has arrived at `now`.
    fn take(&mut self, now: Time, reading: &Reading);

    /// Estimated position and velocity at `now`; none before the first reading.
    fn at(&self, now: Time) -> Option<Motion>;

    /// Standard deviation of the estimated position along each axis \[m\]; 0 for an estimator that does not know it.
    fn deviation_m(&self, _now: Time) -> f32 {
        0.0
    }
}

/// Estimator in a registry.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name in flags and team files.
    pub name: &'static str,
    /// Description in one line.
    pub about: &'static str,
    /// Makes one without readings.
    pub make: fn(&Settings) -> Box<dyn Estimator>,
}

impl PartialEq for Entry {
    fn eq(&self, other: &Entry) -> bool {
        self.name == other.name
    }
}

/// All estimators; the first is the default.
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
