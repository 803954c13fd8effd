//! Flags for the drive of robots, shared by `sim`, `train` and the studies of policies.

use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};

use murmurate::chassis::{DriveKind, Settings};
use murmurate::config::ConfigError;
use murmurate_robot::BadInput;

/// Flags for the drive of all robots.
#[derive(clap::Args, Clone, Debug)]
pub struct DriveFlags {
    /// Drive of the robots: 'holonomic' moves in every direction; 'differential' has two driven wheels, and a point
    /// ahead of its axle follows the policy (docs/world.md) [default: as the configuration or the deployment says, or
    /// else holonomic]
    #[arg(long, value_parser = PossibleValuesParser::new(["holonomic", "differential"]).map(kind))]
    drive: Option<DriveKind>,
    /// Distance of the commanded point ahead of the axle of a differential drive [m]
    #[arg(long)]
    point_ahead_m: Option<f32>,
    /// Largest speed of a robot's centre [m/s] [default: none but that of the policy]
    #[arg(long)]
    speed_m_s: Option<f32>,
    /// Largest yaw rate of a robot [rad/s] [default: none]
    #[arg(long)]
    yaw_rate_rad_s: Option<f32>,
}

fn kind(name: String) -> DriveKind {
    if name == "differential" { DriveKind::Differential } else { DriveKind::Holonomic }
}

impl DriveFlags {
    /// Returns true if none of the flags about the robots' drive (`--drive`, `--speed-m-s`, ...) is given.
    pub fn is_empty(&self) -> bool {
        self.settings().is_empty()
    }

    /// Returns the flags that are given, without `--`, each with its value.
    pub fn given(&self) -> impl Iterator<Item = (&'static str, String)> {
        let kind = self.drive.map(|kind| match kind {
            DriveKind::Holonomic => "holonomic".to_owned(),
            DriveKind::Differential => "differential".to_owned(),
        });
        let number = |value: Option<f32>| value.map(|value| value.to_string());
        let [ahead, speed, yaw] = [self.point_ahead_m, self.speed_m_s, self.yaw_rate_rad_s].map(number);
        let flags = [("drive", kind), ("point-ahead-m", ahead), ("speed-m-s", speed), ("yaw-rate-rad-s", yaw)];
        flags.into_iter().filter_map(|(flag, value)| Some((flag, value?)))
    }

    fn settings(&self) -> Settings {
        let DriveFlags { drive, point_ahead_m, speed_m_s, yaw_rate_rad_s } = *self;
        Settings { drive, point_ahead_m, speed_m_s, yaw_rate_rad_s, ..Settings::default() }
    }

    /// Returns `settings` with the values of the given flags in place of those of its fields. If the result is not a
    /// valid chassis, the error names the flag.
    pub fn over(&self, settings: &Settings) -> Result<Settings> {
        let all = self.settings().or(settings);
        let flag = |error: ConfigError| match error {
            ConfigError::Field { field, reason } => BadInput(format!("--{}: {reason}", field.replace('_', "-"))),
            other => BadInput(other.to_string()),
        };
        if !self.is_empty() {
            all.chassis().map_err(flag)?;
        }
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_replace_settings_and_a_wrong_one_is_named() {
        let none = DriveFlags { drive: None, point_ahead_m: None, speed_m_s: None, yaw_rate_rad_s: None };
        let file = Settings { drive: Some(DriveKind::Differential), point_ahead_m: Some(0.2), ..Settings::default() };
        assert_eq!(none.over(&file).unwrap(), file);
        let near = DriveFlags { point_ahead_m: Some(0.1), ..none.clone() };
        assert_eq!(near.over(&file).unwrap(), Settings { point_ahead_m: Some(0.1), ..file });
        let error = near.over(&Settings::default()).unwrap_err().to_string();
        assert!(error.starts_with("--point-ahead-m: ") && error.contains("differential"), "{error}");
        let slow = DriveFlags { yaw_rate_rad_s: Some(-1.0), ..none };
        assert!(slow.over(&Settings::default()).unwrap_err().to_string().starts_with("--yaw-rate-rad-s: "));
    }
}
