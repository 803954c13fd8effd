//! Pace of a simulated sense: when it measures, and how long its values take.

use std::collections::VecDeque;

use super::{In, Out, Sense};
use crate::config::{ConfigError, in_range};
use crate::messages::local::Scene;
use crate::scenario::Arena;
use crate::time::{Span, Time};

/// Largest number of measurements that wait for the end of their delay.
const MAX_PENDING: usize = 256;

/// Settings of the pace of a simulated sense.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// Measurements in a second; as many as the World has steps if left out.
    pub rate_hz: Option<f64>,
    /// Delay of a measurement \[s\].
    pub delay_s: f64,
}

impl Pace {
    /// Checks the ranges of the settings. An error names the first wrong one.
    pub fn check(&self) -> Result<(), ConfigError> {
        if let Some(rate) = self.rate_hz {
            in_range("rate_hz", rate, (0.1, 1000.0))?;
        }
        in_range("delay_s", self.delay_s, (0.0, 2.0))
    }
}

/// Measurement of a simulated sense, without its schedule.
pub(super) trait Measure {
    /// Returns the values that the sense has in a scene; `None` if its robot is not in it.
    fn measure(&mut self, scene: &Scene) -> Option<Vec<f32>>;

    /// Takes the arena of the episode that begins, in place of the one with which the sense was made. The default does
    /// nothing, for measurements that do not depend on it.
    fn enter(&mut self, _arena: &Arena) {}
}

/// Simulated sense: a measurement with its schedule.
#[derive(Debug)]
pub(super) struct Simulated<M> {
    measurement: M,
    schedule: Schedule,
}

impl<M: Measure> Simulated<M> {
    /// Makes the sense at its start.
    pub fn new(measurement: M, pace: &Pace) -> Simulated<M> {
        Simulated { measurement, schedule: Schedule::new(pace) }
    }
}

impl<M: Measure> Sense for Simulated<M> {
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        let In::Scene(scene) = input else { return };
        if self.schedule.is_due(scene)
            && let Some(values) = self.measurement.measure(scene)
        {
            self.schedule.put(now, scene, values, out);
        }
    }

    fn enter(&mut self, arena: &Arena) {
        self.measurement.enter(arena);
    }

    fn wake_at(&self) -> Option<Time> {
        self.schedule.pending.front().map(|(due, _)| *due)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        let pending = &mut self.schedule.pending;
        while pending.front().is_some_and(|(due, _)| *due <= now) {
            out.extend(pending.pop_front().map(|(_, measured)| measured));
        }
    }
}

/// Schedule of a simulated sense.
#[derive(Debug)]
struct Schedule {
    period: Span,
    delay: Span,
    /// Earliest time of the next measurement.
    ready: Time,
    /// Measurements that wait for the end of their delay, each with the time at which it is due.
    pending: VecDeque<(Time, Out)>,
}

impl Schedule {
    /// Makes the schedule of a sense that has not measured yet.
    fn new(pace: &Pace) -> Schedule {
        let period = pace.rate_hz.map_or(Span::ZERO, |rate| Span::from_secs(1.0 / rate));
        Schedule { period, delay: Span::from_secs(pace.delay_s), ready: Time::ZERO, pending: VecDeque::new() }
    }

    /// Returns whether the sense measures in this scene. After a placement it does at once, and what it has measured
    /// before counts no longer.
    fn is_due(&mut self, scene: &Scene) -> bool {
        if scene.placed {
            self.pending.clear();
        } else if scene.time < self.ready {
            return false;
        }
        // On a grid, so that a rate holds that is no divisor of the World's.
        let next = if scene.placed { scene.time } else { self.ready } + self.period;
        self.ready = if next > scene.time { next } else { scene.time + self.period };
        true
    }

    /// Takes the values that were measured in a scene, and appends them to `out` unless they are delayed.
    fn put(&mut self, now: Time, scene: &Scene, values: Vec<f32>, out: &mut Vec<Out>) {
        let measured = Out::Values { stamp_ns: scene.time.as_nanos(), values };
        if self.delay == Span::ZERO {
            out.push(measured);
        } else if self.pending.len() < MAX_PENDING {
            self.pending.push_back((now + self.delay, measured));
        }
    }
}
