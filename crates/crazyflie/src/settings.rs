//! Settings of the driver `crazyflie` in a team file, and their checks.

use std::net::SocketAddr;

use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use serde::Deserialize;

use crate::axes::Setpoint;

/// Poses of the team's source that are sent to the robot's estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Poses {
    /// Positions.
    #[default]
    Extpos,
    /// Positions and headings.
    Extpose,
    /// None: the robot knows by itself where it is in the team's frame, as by the Lighthouse.
    None,
}

/// Way in which the robot knows its height above the ground, which readings of the team's source do not have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Height {
    /// By a deck that measures it: one without such a deck does not fly.
    #[default]
    Deck,
    /// In another way that the user knows of.
    Estimate,
}

/// Settings of one robot.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Address of the robot, as `udp://127.0.0.1:19850`.
    uri: String,
    /// Largest speed in the plane \[m/s\].
    #[serde(default = "default_speed")]
    pub speed_m_s: f32,
    /// Speed of rising and landing \[m/s\].
    #[serde(default = "default_climb")]
    pub climb_m_s: f32,
    /// Kind of setpoint by which velocities are sent.
    #[serde(default)]
    pub setpoint: Setpoint,
    /// Rate at which the newest setpoint is sent while the robot flies \[Hz\].
    #[serde(default = "default_setpoints")]
    pub setpoint_hz: u8,
    /// Rate of the robot's own estimate \[Hz\].
    #[serde(default = "default_estimates")]
    pub estimate_hz: u8,
    /// Poses that are sent to the robot's estimator.
    #[serde(default)]
    pub poses: Poses,
    /// Largest rate at which they are sent \[Hz\].
    #[serde(default = "default_poses")]
    pub pose_hz: u8,
    /// Way in which the robot knows its height.
    #[serde(default)]
    pub height: Height,
    /// Whether the robot is armed before it rises, where its firmware does not arm itself.
    #[serde(default)]
    pub arm: bool,
}

fn default_speed() -> f32 {
    1.0
}

fn default_climb() -> f32 {
    0.4
}

fn default_setpoints() -> u8 {
    50
}

fn default_estimates() -> u8 {
    50
}

fn default_poses() -> u8 {
    50
}

impl Config {
    /// Reads and checks the settings of a robot; an error names the wrong field.
    pub fn of(settings: &Settings) -> Result<Config, ConfigError> {
        let config: Config = settings.read()?;
        config.check().map(|()| config)
    }

    /// Returns the address of the robot; an error names the field.
    pub fn address(&self) -> Result<SocketAddr, ConfigError> {
        let wrong = |why: &str| ConfigError::field("uri", format!("'{}' {why}", self.uri));
        if let Some(address) = self.uri.strip_prefix("udp://") {
            let address: Option<SocketAddr> = address.parse().ok();
            return address
                .filter(|address| address.port() != 0 && !address.ip().is_unspecified() && !address.ip().is_multicast())
                .ok_or_else(|| wrong("is no address and port, as udp://127.0.0.1:19850"));
        }
        if self.uri.starts_with("radio://") {
            let why =
                "needs a driver of the Crazyradio, which is not here: bridge the radio to UDP (docs/crazyflie.md)";
            return Err(wrong(why));
        }
        Err(wrong("is none that this driver speaks to: say udp://ADDRESS:PORT"))
    }

    /// Checks the ranges of all settings; an error names the wrong field.
    fn check(&self) -> Result<(), ConfigError> {
        for (field, value, least, most) in [
            ("speed_m_s", self.speed_m_s, 0.05, 5.0),
            ("climb_m_s", self.climb_m_s, 0.1, 1.0),
            ("setpoint_hz", f32::from(self.setpoint_hz), 10.0, 100.0),
            ("estimate_hz", f32::from(self.estimate_hz), 10.0, 100.0),
            ("pose_hz", f32::from(self.pose_hz), 5.0, 100.0),
        ] {
            if !(least..=most).contains(&value) {
                let why = format!("{value} is not within {least} and {most}; choose a value that is");
                return Err(ConfigError::field(field, why));
            }
        }
        self.address().map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        let table = text.parse().expect("TOML");
        let read = Config::of(&Settings { name: "crazyflie".to_owned(), table });
        read.map(drop).expect_err("it is refused").to_string()
    }

    #[test]
    fn each_wrong_setting_is_refused_by_its_name_in_one_line() {
        let uri = "uri = 'udp://127.0.0.1:19850'\n";
        for (text, named) in [
            ("", "uri"),
            ("uri = 'udp://127.0.0.1'", "uri"),
            ("uri = 'udp://robot:19850'", "uri"),
            ("uri = 'udp://0.0.0.0:19850'", "uri"),
            ("uri = 'udp://127.0.0.1:0'", "uri"),
            ("uri = 'radio://0/80/2M/E7E7E7E7E7'", "uri"),
            ("uri = 'usb://0'", "uri"),
            (&format!("{uri}speed_m_s = 0.0"), "speed_m_s"),
            (&format!("{uri}speed_m_s = nan"), "speed_m_s"),
            (&format!("{uri}climb_m_s = 3.0"), "climb_m_s"),
            (&format!("{uri}setpoint_hz = 2"), "setpoint_hz"),
            (&format!("{uri}setpoint = 'position'"), "setpoint"),
            (&format!("{uri}estimate_hz = 200"), "estimate_hz"),
            (&format!("{uri}poses = 'gps'"), "poses"),
            (&format!("{uri}pose_hz = 0"), "pose_hz"),
            (&format!("{uri}height = 'barometer'"), "height"),
            (&format!("{uri}arm = 'yes'"), "arm"),
            (&format!("{uri}colour = 'red'"), "colour"),
        ] {
            let error = refused(text);
            assert!(error.contains(named) && !error.trim().contains('\n'), "{text}: {error}");
        }
        assert!(refused("uri = 'radio://0/80/2M'").contains("Crazyradio"));
    }
}
