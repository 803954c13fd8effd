//! Counts of the activations of a guard.

use std::iter::Sum;

use serde::{Deserialize, Serialize};

/// Number of activations of each safety trigger, for one robot or summed over robots.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SafetyCounts {
    /// Number of times that the emergency stop became active.
    pub stop: u64,
    /// Number of times that the state server fell silent.
    pub silence: u64,
    /// Number of times that a policy's output became not finite.
    pub output: u64,
    /// Number of times that control ticks began to be late or missing.
    pub late_tick: u64,
    /// Number of times that a robot's own state became too old.
    pub own_state: u64,
    /// Number of times that a robot's battery or temperature went beyond its limit.
    pub hardware: u64,
    /// Number of times that a robot came far outside its ground.
    pub outside: u64,
    /// Number of times that the geofence began to limit commands.
    pub fence: u64,
    /// Number of times that the minimum distance to neighbours began to limit commands.
    pub distance: u64,
    /// Number of times that the minimum distance to walls began to limit commands.
    pub walls: u64,
}

impl SafetyCounts {
    /// Returns the counts above zero, each with a short name of its trigger for reports.
    pub fn reasons(&self) -> impl Iterator<Item = (u64, &'static str)> {
        let all = [
            (self.stop, "emergency stops"),
            (self.silence, "server silent"),
            (self.output, "invalid outputs"),
            (self.late_tick, "late ticks"),
            (self.own_state, "own state too old"),
            (self.hardware, "battery or temperature"),
            (self.outside, "far outside"),
            (self.fence, "geofence"),
            (self.distance, "minimum distance"),
            (self.walls, "walls"),
        ];
        all.into_iter().filter(|(times, _)| *times > 0)
    }

    /// Returns the short names of the triggers that have acted since `before`, earlier counts of the same guard.
    pub fn begun_since(&self, before: &SafetyCounts) -> impl Iterator<Item = &'static str> {
        let before: Vec<_> = before.reasons().collect();
        let times = move |name: &str| before.iter().find(|(_, other)| *other == name).map_or(0, |(times, _)| *times);
        self.reasons().filter(move |(now, name)| *now > times(name)).map(|(_, name)| name)
    }
}

impl Sum for SafetyCounts {
    fn sum<I: Iterator<Item = SafetyCounts>>(all: I) -> SafetyCounts {
        all.fold(SafetyCounts::default(), |sum, one| SafetyCounts {
            stop: sum.stop + one.stop,
            silence: sum.silence + one.silence,
            output: sum.output + one.output,
            late_tick: sum.late_tick + one.late_tick,
            own_state: sum.own_state + one.own_state,
            hardware: sum.hardware + one.hardware,
            outside: sum.outside + one.outside,
            fence: sum.fence + one.fence,
            distance: sum.distance + one.distance,
            walls: sum.walls + one.walls,
        })
    }
}
