//! Safety on the robot's side: what stops or slows a robot whatever its policy and its operator want. `guard` is the
//! one state machine, `filter` the safety filter of commands; here is what may be configured.
//!
//! `docs/safety.md` has every trigger in one table. No actor lives here, and no clock: the Controller owns a guard.

pub mod filter;
pub mod guard;

use serde::{Deserialize, Serialize};

use crate::config::{self, ConfigError};

/// Whether a trigger is watched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Switch {
    /// It is.
    On,
    /// It is not.
    Off,
}

/// When a robot is stopped or slowed. What is left out of a file is as on a real host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Safety {
    /// Without a new own reading for longer than this a robot has no estimate: its agent does not step \[s\].
    pub own_state_s: f64,
    /// Whether it is then stopped at once; otherwise its last command lapses.
    pub own_state: Switch,
    /// How much later than it was due a control tick may reach the wheels \[s\].
    pub late_tick_s: f64,
    /// Whether later ones, and those that never come, stop the robot.
    pub late_tick: Switch,
    /// How long the state server may be silent \[s\].
    pub silence_s: f64,
    /// Whether a robot is kept on its ground.
    pub geofence: Switch,
    /// How far beyond the ground's edge a robot's centre may be driven \[m\].
    pub geofence_margin_m: f32,
    /// Within which time no command may carry it farther \[s\].
    pub geofence_horizon_s: f32,
    /// How far beyond the ground's edge its estimate stops it \[m\].
    pub geofence_stop_m: f32,
    /// Whether robots are kept apart.
    pub distance: Switch,
    /// The least distance between two centres that a command may lead to \[m\].
    pub distance_min_m: f32,
    /// The largest speed toward a neighbour, for each metre beyond that distance \[1/s\].
    pub distance_gain_per_s: f32,
    /// How old a neighbour's last known position may be to count \[s\].
    pub distance_age_s: f64,
}

impl Default for Safety {
    fn default() -> Safety {
        Safety::deployed()
    }
}

impl Safety {
    /// On real hosts: everything is watched.
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
            distance_gain_per_s: 1.0,
            distance_age_s: 0.5,
        }
    }

    /// As in the paper's experiments: nothing comes between the policy and the wheels that was not there.
    pub const fn emulated() -> Safety {
        Safety {
            own_state: Switch::Off,
            late_tick: Switch::Off,
            geofence: Switch::Off,
            distance: Switch::Off,
            ..Safety::deployed()
        }
    }

    /// Reads it from TOML and checks it.
    pub fn from_toml(text: &str) -> Result<Safety, ConfigError> {
        let safety: Safety = config::from_toml(text)?;
        safety.check()?;
        Ok(safety)
    }

    /// Checks that every number makes sense; the error names the field.
    pub fn check(&self) -> Result<(), ConfigError> {
        // The state server speaks every 0.1 s, and eight of its words may be missed.
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
        ];
        for (field, value, least, most, unit) in ranges {
            if !(least..=most).contains(&value) {
                return Err(ConfigError::field(field, format!("{value} is not {least} to {most} {unit}")));
            }
        }
        if self.geofence_stop_m < self.geofence_margin_m {
            let reason = format!("{} m is nearer than geofence_margin_m", self.geofence_stop_m);
            return Err(ConfigError::field("geofence_stop_m", reason));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_presets_are_sound_and_what_is_wrong_is_named() {
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
        ] {
            let error = Safety::from_toml(text).expect_err(text).to_string();
            assert!(error.contains(field), "{error}");
        }
    }
}
