//! Safety on the robot's side: stopping and slowing a robot, independently of policy and operator.
//!
//! `guard` is the state machine between policy and motors, and `filter` the safety filter, which limits its commands:
//! `stopping` has where a robot can stop, `barrier` the limits that neighbours and walls set, `limits` the velocity
//! nearest to the wanted one within them, `yielding` the way out of deadlocks. `clamp` is the limit on what a policy
//! commands. `counts` has how often the triggers have acted, `hardware` the limits of battery and temperature; this
//! file has the configuration.
//! `docs/safety.md` has every trigger in one table. There is no actor and no clock here: the Controller, an actor, owns
//! a guard.

mod barrier;
mod clamp;
pub(crate) mod counts;
pub mod filter;
pub mod guard;
pub(crate) mod hardware;
pub(crate) mod limits;
mod stopping;
pub mod yielding;

pub use clamp::Clamp;

use serde::{Deserialize, Serialize};

use crate::config::{self, ConfigError};
use crate::scenario::size::HULL_M;

/// Largest lag of a robot's drive in the settings \[s\].
const MOST_LAG_S: f32 = 5.0;
/// Smallest and largest acceleration of a robot in the settings \[m/s^2\].
const LEAST_ACCELERATION_M_S2: f32 = 0.05;
const MOST_ACCELERATION_M_S2: f32 = 1e3;

/// Least room between the hull of a simulated robot and walls, and half of that between two hulls \[m\].
const HULL_MARGIN_M: f32 = 0.02;

/// State of a safety trigger, a condition that stops or slows a robot: monitored or ignored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Switch {
    /// The trigger is monitored, and acts on the robot.
    On,
    /// The trigger is ignored, and never acts on the robot.
    Off,
}

/// Thresholds of the safety triggers, the conditions that stop or slow a robot. A field that is missing in a file has
/// its value for real hosts (`Safety::deployed`).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Safety {
    /// Maximum age \[s\] of the newest measurement of the robot's own state. Beyond it there is no estimate of the
    /// state, and the policy does not step.
    pub own_state_s: f64,
    /// Whether a robot whose own state is too old (`own_state_s`) is stopped at once. If off, the robot drives on until
    /// its last command expires.
    pub own_state: Switch,
    /// Maximum delay \[s\] of a policy's command behind the time at which its control tick (periodic step) was due.
    pub late_tick_s: f64,
    /// Whether a control tick that is missing or later than `late_tick_s` stops the robot.
    pub late_tick: Switch,
    /// Maximum time \[s\] without a message of the state server, which leads the episodes. After it the robot is
    /// stopped.
    pub silence_s: f64,
    /// Whether the geofence is enforced: a boundary outside the ground that a robot may not cross.
    pub geofence: Switch,
    /// Distance of the geofence beyond the edge of the robot's ground \[m\].
    pub geofence_margin_m: f32,
    /// Time horizon of the geofence \[s\]: no command may carry the robot's stopping point past it within this time.
    pub geofence_horizon_s: f32,
    /// Distance of the robot's estimated position beyond the edge of its ground \[m\] from which the robot is stopped,
    /// if `geofence` is on.
    pub geofence_stop_m: f32,
    /// Whether a minimum distance to neighbouring robots (`distance_min_m`) is enforced.
    pub distance: Switch,
    /// Minimum distance between the centres of two robots \[m\], for the limit of their approach.
    pub distance_min_m: f32,
    /// Maximum speed at which the robot's stopping point may approach a neighbour, for each metre of distance beyond
    /// the minimum \[1/s\]; twice that for a wall. Above 1 / (2 control periods), two robots that approach each other
    /// may come closer than the minimum.
    pub distance_gain_per_s: f32,
    /// Maximum age of a neighbour's last known position \[s\], since the arrival of the message with it. An older
    /// position is ignored in keeping the minimum distance.
    pub distance_age_s: f64,
    /// Longest time from a neighbour's measurement of itself to the arrival of its message \[s\], which the minimum
    /// distance allows for in addition to the age since the arrival.
    pub distance_delay_s: f32,
    /// Distance between two robots \[m\] at which they have heard each other. A robot drives no faster than two robots
    /// that approach each other can stop in, from this distance to the minimum.
    pub distance_heard_m: f32,
    /// Whether a minimum distance to the walls of the arena (`walls_min_m`) is enforced, and the edge of the ground.
    pub walls: Switch,
    /// Minimum distance of the robot's centre from a wall \[m\].
    pub walls_min_m: f32,
    /// Time constant of the first-order lag of a robot's velocity behind its commands \[s\], for the distance in which
    /// it can stop.
    pub lag_s: f32,
    /// Largest acceleration of a robot along each axis of the world frame \[m/s^2\], for the distance in which it can
    /// stop.
    pub acceleration_m_s2: f32,
}

impl Default for Safety {
    fn default() -> Safety {
        Safety::deployed()
    }
}

impl Safety {
    /// Returns the settings for real hosts: every trigger is monitored.
    pub const fn deployed() -> Safety {
        Safety {
            own_state_s: 0.1,
            own_state: Switch::On,
            late_tick_s: 0.05,
            late_tick: Switch::On,
            silence_s: 1.0,
            geofence: Switch::On,
            geofence_margin_m: 0.25,
            geofence_horizon_s: 0.5,
            geofence_stop_m: 1.0,
            distance: Switch::On,
            distance_min_m: 0.4,
            distance_gain_per_s: 5.0,
            distance_age_s: 1.0,
            distance_delay_s: 0.1,
            distance_heard_m: 1.8,
            walls: Switch::On,
            walls_min_m: 0.2,
            lag_s: 0.5,
            acceleration_m_s2: 1.0,
        }
    }

    /// Returns the settings for emulation, in which only the triggers of the experiments in the paper are monitored.
    /// Age of the own state, late ticks, geofence, minimum distance and walls are off.
    pub const fn emulated() -> Safety {
        Safety {
            own_state: Switch::Off,
            late_tick: Switch::Off,
            geofence: Switch::Off,
            distance: Switch::Off,
            walls: Switch::Off,
            ..Safety::deployed()
        }
    }

    /// Returns the settings for emulation with the safety filter: geofence, minimum distance and walls are on.
    pub const fn filter() -> Safety {
        Safety { geofence: Switch::On, distance: Switch::On, walls: Switch::On, ..Safety::emulated() }
    }

    /// Returns these settings for robots with a hull of the radius `hull_m` \[m\], in place of that of the paper's
    /// robots: the minimum distances to walls and other robots leave as much room between hulls as before.
    pub fn of_hull(self, hull_m: f32) -> Safety {
        let larger_m = hull_m - HULL_M;
        let distance_min_m = self.distance_min_m + 2.0 * larger_m;
        Safety { distance_min_m, walls_min_m: self.walls_min_m + larger_m, ..self }
    }

    /// Returns these settings for robots that follow their commands with the lag `lag_s` \[s\] and accelerate by
    /// `acceleration_m_s2` \[m/s^2\] at the most. Values outside the ranges of the settings are clamped to them.
    pub fn driving(self, lag_s: f32, acceleration_m_s2: f32) -> Safety {
        let acceleration_m_s2 = acceleration_m_s2.clamp(LEAST_ACCELERATION_M_S2, MOST_ACCELERATION_M_S2);
        Safety { lag_s: lag_s.clamp(0.0, MOST_LAG_S), acceleration_m_s2, ..self }
    }

    /// Returns these settings for robots that touch a wall at the distance `radius_m` \[m\] of their centres from it,
    /// and each other at twice that: the minimum distances to walls and to other robots are at least 2 and 4 cm more.
    pub(crate) fn clear_of_contacts(self, radius_m: f32) -> Safety {
        let walls_min_m = self.walls_min_m.max(radius_m + HULL_MARGIN_M);
        let distance_min_m = self.distance_min_m.max(2.0 * (radius_m + HULL_MARGIN_M));
        Safety { walls_min_m, distance_min_m, ..self }
    }

    /// Returns these settings for a robot whose commanded point is `own_m` \[m\] ahead of its centre, among robots
    /// whose points are `others_m` \[m\] ahead at the most. The minimum distances are larger by that, since they are
    /// then distances of points.
    pub fn about_point(self, own_m: f32, others_m: f32) -> Safety {
        let distance_min_m = self.distance_min_m + own_m + others_m;
        Safety { distance_min_m, walls_min_m: self.walls_min_m + own_m, ..self }
    }

    /// Reads settings from TOML and checks them. Missing fields have their values for real hosts (`Safety::deployed`);
    /// an error names the wrong field.
    pub fn from_toml(text: &str) -> Result<Safety, ConfigError> {
        let safety: Safety = config::from_toml(text)?;
        safety.check()?;
        Ok(safety)
    }

    /// Checks the range of every number, and that the robot is not stopped inside the geofence. An error names the
    /// wrong field.
    pub fn check(&self) -> Result<(), ConfigError> {
        // The state server sends every 0.1 s, and eight messages in a row may be lost.
        let (least, most) = (LEAST_ACCELERATION_M_S2, MOST_ACCELERATION_M_S2);
        let ranges = [
            ("own_state_s", self.own_state_s, 0.01, 1.0, "s"),
            ("late_tick_s", self.late_tick_s, 0.001, 1.0, "s"),
            ("silence_s", self.silence_s, 0.9, 60.0, "s"),
            ("geofence_margin_m", self.geofence_margin_m.into(), 0.0, 1e3, "m"),
            ("geofence_horizon_s", self.geofence_horizon_s.into(), 0.05, 10.0, "s"),
            ("geofence_stop_m", self.geofence_stop_m.into(), 0.0, 1e3, "m"),
            ("distance_min_m", self.distance_min_m.into(), 0.0, 2.0, "m"),
            ("distance_gain_per_s", self.distance_gain_per_s.into(), 0.5, 20.0, "1/s"),
            ("distance_age_s", self.distance_age_s, 0.01, 5.0, "s"),
            ("distance_delay_s", self.distance_delay_s.into(), 0.0, 5.0, "s"),
            ("distance_heard_m", self.distance_heard_m.into(), 0.1, 1e3, "m"),
            ("walls_min_m", self.walls_min_m.into(), 0.0, 2.0, "m"),
            ("lag_s", self.lag_s.into(), 0.0, MOST_LAG_S.into(), "s"),
            ("acceleration_m_s2", self.acceleration_m_s2.into(), least.into(), most.into(), "m/s^2"),
        ];
        for (field, value, least, most, unit) in ranges {
            if !(least..=most).contains(&value) {
                return Err(ConfigError::field(field, format!("{value} is not {least} to {most} {unit}")));
            }
        }
        if self.geofence_stop_m < self.geofence_margin_m {
            let reason = format!("{} m is less than geofence_margin_m", self.geofence_stop_m);
            return Err(ConfigError::field("geofence_stop_m", reason));
        }
        if self.distance_heard_m <= self.distance_min_m {
            let reason = format!("{} m is not more than distance_min_m", self.distance_heard_m);
            return Err(ConfigError::field("distance_heard_m", reason));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_presets_pass_their_check_and_an_error_names_the_field() {
        assert_eq!((Safety::deployed().check(), Safety::emulated().check()), (Ok(()), Ok(())));
        assert_eq!(Safety::from_toml(""), Ok(Safety::deployed()));
        let set = Safety::from_toml("distance = \"off\"\nown_state_s = 0.2").expect("two fields");
        assert_eq!(set, Safety { distance: Switch::Off, own_state_s: 0.2, ..Safety::deployed() });
        let text = toml::to_string(&Safety::emulated()).expect("it is TOML");
        assert_eq!(Safety::from_toml(&text), Ok(Safety::emulated()));
        for (text, field) in [
            ("silence_s = 0.5", "silence_s"),
            ("late_tick_s = nan", "late_tick_s"),
            ("geofence_stop_m = 0.1", "geofence_stop_m"),
            ("distance_m = 0.1", "distance_m"),
            ("distance = true", "distance"),
            ("distance_heard_m = 0.3", "distance_heard_m"),
        ] {
            let error = Safety::from_toml(text).expect_err(text).to_string();
            assert!(error.contains(field), "{error}");
        }
    }
}
