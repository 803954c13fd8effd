//! Driver of the DJI RoboMaster EP over its plaintext SDK, by Wi-Fi or USB. A stock RoboMaster S1 has no such
//! interface.
//!
//! No watchdog of the robot is documented: assume that it keeps its last velocity when the link dies. The end of the
//! TCP connection stops it (DJI's guide, "quit"). So the driver belongs on a computer on the robot, connected by USB.

mod battery;
mod chassis;
pub mod link;
mod motion;
mod odometry;
pub mod protocol;
mod reporter;
mod session;
mod sockets;
mod times;
mod worker;

use std::net::Ipv4Addr;

use serde::Deserialize;

use self::session::Session;
use self::worker::Tcp;
use murmurate::config::ConfigError;
use murmurate::drivers::{Entry, Parts};
use murmurate::edge::Settings;
use murmurate::messages::ids::RobotId;

/// Entry of the RoboMaster driver in the registry of drivers.
pub const ENTRY: Entry = Entry { name: "robomaster", about: "RoboMaster EP: plaintext SDK over Wi-Fi or USB", make };

/// Address of the robot on its own Wi-Fi (DJI's guide, "Access Methods").
const DIRECT: Ipv4Addr = Ipv4Addr::new(192, 168, 2, 1);
/// Address of the robot on its USB port (DJI's guide, "Access Methods").
const USB: Ipv4Addr = Ipv4Addr::new(192, 168, 42, 2);
/// Largest speed along an axis that the robot takes \[m/s\] (DJI's guide, "chassis speed").
const FASTEST_M_S: f32 = 3.5;
/// Largest speed of a robot with a fitted arm \[m/s\] (DJI's guide).
const FASTEST_WITH_ARM_M_S: f32 = 0.8;
/// Largest yaw rate that the robot takes \[rad/s\]: 600 degrees/s (DJI's guide, "chassis speed").
const FASTEST_YAW_RAD_S: f32 = 600.0 * std::f32::consts::PI / 180.0;
/// Rates \[Hz\] at which the robot may be told to push its state: at these, a dead link is noticed in time. The robot
/// also supports 1, 5 and 10 Hz (DJI's guide).
const PUSH_RATES_HZ: [u8; 3] = [20, 30, 50];
/// Largest rate at which velocities may be sent to the robot \[Hz\], equal to the largest rate of a Body's commands.
const MOST_COMMANDS_HZ: u8 = 50;

/// Kind of network connection between the host and the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Connection {
    /// The host is on the robot's own Wi-Fi.
    Direct,
    /// The host is connected to the robot's USB port, which appears as a network interface.
    Usb,
    /// Host and robot are on the network of a router.
    Router,
}

/// Settings of the RoboMaster driver in the team file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Connection with the robot; `router` needs an address.
    connection: Connection,
    /// Address of the robot; `None` for the usual one of the kind of connection.
    address: Option<Ipv4Addr>,
    /// Whether an arm is fitted to the robot, which limits its speed to 0.8 m/s.
    #[serde(default)]
    arm: bool,
    /// Largest speed \[m/s\]; `None` for that of the robot: 3.5, or 0.8 with an arm.
    speed_m_s: Option<f32>,
    /// Largest yaw rate \[rad/s\]; at most 10.4.
    #[serde(default = "default_yaw_rate")]
    yaw_rate_rad_s: f32,
    /// Step to whose multiples speeds along each axis are rounded \[m/s\]. With zero, speeds of 0.1 m/s and more are
    /// sent without rounding.
    #[serde(default = "default_step")]
    speed_step_m_s: f32,
    /// Rate at which the robot sends (pushes) its position and attitude \[Hz\]: 20, 30 or 50.
    #[serde(default = "default_pushes")]
    push_hz: u8,
    /// Largest rate at which velocities are sent \[Hz\], 1 to 50. Each one is sent only after the robot has answered
    /// the one before.
    #[serde(default = "default_commands")]
    command_hz: u8,
    /// Charge of the battery at which the robot stops, 0 to 1.
    #[serde(default)]
    battery_least: f32,
    /// Period at which the robot is asked for its battery's charge \[s\], 1 to 60.
    #[serde(default = "default_battery_period")]
    battery_period_s: f64,
    /// Whether hits on the robot's armour are logged. This opens one more connection, to the robot's event port.
    #[serde(default)]
    events: bool,
}

fn default_yaw_rate() -> f32 {
    std::f32::consts::PI
}

/// Returns the default of `speed_step_m_s` \[m/s\]. DJI's script on the robot truncates each speed to tenths
/// (`rm_ctrl.py`).
fn default_step() -> f32 {
    0.1
}

fn default_pushes() -> u8 {
    50
}

fn default_commands() -> u8 {
    20
}

fn default_battery_period() -> f64 {
    5.0
}

impl Config {
    /// Checks the ranges of all settings; an error names the wrong field.
    fn check(&self) -> Result<(), ConfigError> {
        let fastest = if self.arm { FASTEST_WITH_ARM_M_S } else { FASTEST_M_S };
        let within = |field: &str, value: f64, least: f64, most: f64| {
            if (least..=most).contains(&value) {
                return Ok(());
            }
            Err(ConfigError::field(field, format!("{value} is not within {least} and {most}; choose a value that is")))
        };
        if self.connection == Connection::Router && self.address.is_none() {
            let why = "a robot on a router has no fixed address: give it, as the RoboMaster app shows it";
            return Err(ConfigError::field("address", why));
        }
        if let Some(address) = self.address.filter(|a| a.is_unspecified() || a.is_multicast() || a.is_broadcast()) {
            return Err(ConfigError::field(
                "address",
                format!("{address} is not the address of a robot; give its own"),
            ));
        }
        if let Some(speed) = self.speed_m_s {
            within("speed_m_s", f64::from(speed), 0.1, f64::from(fastest))?;
        }
        within("yaw_rate_rad_s", f64::from(self.yaw_rate_rad_s), 0.1, f64::from(FASTEST_YAW_RAD_S))?;
        within("speed_step_m_s", f64::from(self.speed_step_m_s), 0.0, 0.5)?;
        within("command_hz", f64::from(self.command_hz), 1.0, f64::from(MOST_COMMANDS_HZ))?;
        within("battery_least", f64::from(self.battery_least), 0.0, 1.0)?;
        within("battery_period_s", self.battery_period_s, 1.0, 60.0)?;
        if !PUSH_RATES_HZ.contains(&self.push_hz) {
            let why = format!(
                "{} Hz does not show a dead link in time, or is unknown to the robot; choose 20, 30 or 50",
                self.push_hz
            );
            return Err(ConfigError::field("push_hz", why));
        }
        Ok(())
    }

    /// Returns the address of the robot: the setting, or the usual one of the kind of connection.
    fn address(&self) -> Ipv4Addr {
        self.address.unwrap_or(match self.connection {
            Connection::Usb => USB,
            Connection::Direct | Connection::Router => DIRECT,
        })
    }

    /// Returns the largest speed of the robot \[m/s\]: the setting, or 3.5, or 0.8 with an arm.
    fn speed_m_s(&self) -> f32 {
        self.speed_m_s.unwrap_or(if self.arm { FASTEST_WITH_ARM_M_S } else { FASTEST_M_S })
    }
}

/// Makes the RoboMaster driver of `robot` and its worker; an error names the wrong setting.
fn make(settings: &Settings, robot: RobotId) -> Result<Parts, ConfigError> {
    let config: Config = settings.read()?;
    config.check()?;
    let worker = Tcp {
        robot,
        address: config.address(),
        events: config.events,
        announcements: config.connection == Connection::Router,
    };
    Ok(Parts {
        driver: Box::new(move || Box::new(Session::new(robot, config.clone()))),
        worker: Some(Box::new(worker)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(text: &str) -> Result<Config, ConfigError> {
        let table = text.parse().expect("TOML");
        let config: Config = Settings { name: "robomaster".to_owned(), table }.read()?;
        config.check().map(|()| config)
    }

    #[test]
    fn each_wrong_setting_is_refused_by_its_name() {
        for (text, named) in [
            ("connection = 'router'", "address"),
            ("connection = 'usb'\naddress = '0.0.0.0'", "address"),
            ("connection = 'usb'\naddress = '192.168.42'", "address"),
            ("connection = 'bluetooth'", "one of `direct`"),
            ("address = '10.0.0.2'", "connection"),
            ("connection = 'usb'\nspeed_m_s = 3.6", "speed_m_s"),
            ("connection = 'usb'\narm = true\nspeed_m_s = 0.9", "speed_m_s"),
            ("connection = 'usb'\nspeed_m_s = nan", "speed_m_s"),
            ("connection = 'usb'\nyaw_rate_rad_s = 11.0", "yaw_rate_rad_s"),
            ("connection = 'usb'\nspeed_step_m_s = -0.1", "speed_step_m_s"),
            ("connection = 'usb'\npush_hz = 10", "push_hz"),
            ("connection = 'usb'\ncommand_hz = 0", "command_hz"),
            ("connection = 'usb'\nbattery_least = 20", "battery_least"),
            ("connection = 'usb'\nbattery_period_s = 0.1", "battery_period_s"),
            ("connection = 'usb'\nspeed = 1.0", "speed"),
        ] {
            let error = config(text).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains(named), "{text}: {error}");
        }
    }

    #[test]
    fn the_connection_gives_the_address_and_the_arm_the_speed() {
        assert_eq!(config("connection = 'usb'").unwrap().address(), USB);
        assert_eq!(config("connection = 'direct'").unwrap().address(), DIRECT);
        let routed = config("connection = 'router'\naddress = '10.0.0.7'\narm = true").unwrap();
        assert_eq!((routed.address(), routed.speed_m_s()), (Ipv4Addr::new(10, 0, 0, 7), 0.8));
    }
}
