//! Settings of the driver and of the source `mavlink` in a team file.

use std::net::SocketAddrV4;

use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use murmurate::localization::alignment::Alignment;
use murmurate::localization::fix::Fix;
use murmurate::localization::geodesy::{Geodetic, LocalFrame};
use serde::Deserialize;

use super::address::Address;
use super::axes::Axes;

/// Firmware of an autopilot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Firmware {
    /// PX4: driven in its mode OFFBOARD.
    Px4,
    /// ArduPilot: driven in its mode GUIDED.
    ArduPilot,
}

/// Kind of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Vehicle {
    /// A rover or a boat.
    Rover,
    /// A helicopter with one or more rotors.
    Copter,
}

/// Form of the velocities that an autopilot gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Setpoints {
    /// Velocities along north and east; the autopilot turns the vehicle as it likes.
    World,
    /// A speed ahead and a yaw rate, as a differential drive has them; for rovers of ArduPilot.
    Body,
}

/// Settings of a link with an autopilot, of the driver and of the source alike, as checked.
#[derive(Clone, Debug)]
pub struct LinkSettings {
    /// Where the autopilot is.
    pub address: Address,
    /// Number of the autopilot's system.
    pub system: u8,
    /// Numbers of this host's system and component.
    pub own: (u8, u8),
    /// Version of MAVLink in which this host sends, 1 or 2. It reads both.
    pub version: u8,
    /// Path of the file with the key of the link's signatures; `None` for a link without them.
    pub key_file: Option<String>,
    /// Address to which the autopilot's frames are copied; `None` for none.
    pub forward: Option<SocketAddrV4>,
}

/// Settings of the driver `mavlink` as a table in a team file, not yet checked.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DriverFields {
    address: String,
    autopilot: Firmware,
    vehicle: Vehicle,
    #[serde(default = "first")]
    system: u8,
    own_system: Option<u8>,
    own_component: Option<u8>,
    #[serde(default = "newest")]
    version: u8,
    signing_key_file: Option<String>,
    forward: Option<String>,
    /// Whether this host arms the robot, once after its start.
    #[serde(default)]
    arm: bool,
    /// Direction of east in the team's frame \[rad\], counter-clockwise from its x axis.
    #[serde(default)]
    yaw_rad: f64,
    #[serde(default = "world")]
    setpoints: Setpoints,
    speed_m_s: f32,
    #[serde(default = "yaw_rate_rad_s")]
    yaw_rate_rad_s: f32,
    #[serde(default = "setpoint_hz")]
    setpoint_hz: u8,
    #[serde(default = "position_hz")]
    position_hz: u8,
}

fn first() -> u8 {
    1
}

fn newest() -> u8 {
    2
}

fn world() -> Setpoints {
    Setpoints::World
}

fn yaw_rate_rad_s() -> f32 {
    1.0
}

/// Returns the default rate of setpoints \[Hz\]: that of commands. PX4 asks for more than 2.
fn setpoint_hz() -> u8 {
    20
}

/// Returns the default rate of positions and attitudes \[Hz\]. Three of them are within `own_state_s` of 0.1 s.
fn position_hz() -> u8 {
    30
}

/// Number of the component of a driver: an onboard computer (MAV_COMP_ID_ONBOARD_COMPUTER).
const DRIVER: u8 = 191;
/// Number of the component of a source: the second onboard computer.
const SOURCE: u8 = 192;
/// Number of the component of an autopilot (MAV_COMP_ID_AUTOPILOT1).
pub const AUTOPILOT: u8 = 1;

/// Checked settings of the driver `mavlink`.
#[derive(Clone, Debug)]
pub struct DriverConfig {
    /// Link with the autopilot.
    pub link: LinkSettings,
    /// Firmware of the autopilot.
    pub firmware: Firmware,
    /// Kind of the vehicle.
    pub vehicle: Vehicle,
    /// Whether this host arms the robot, once after its start.
    pub arm: bool,
    /// Axes of the team's frame beside north and east.
    pub axes: Axes,
    /// Form of the velocities that the autopilot gets.
    pub setpoints: Setpoints,
    /// Largest speed \[m/s\].
    pub speed_m_s: f32,
    /// Largest yaw rate \[rad/s\].
    pub yaw_rate_rad_s: f32,
    /// Rate of setpoints \[Hz\].
    pub setpoint_hz: u8,
    /// Rate of positions and attitudes that the autopilot is asked for \[Hz\].
    pub position_hz: u8,
}

fn within(name: &str, value: f64, least: f64, most: f64, unit: &str) -> Result<(), ConfigError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(ConfigError::field(name, format!("{value} is out of range; give {least} to {most} {unit}")))
}

/// Checks the fields of a link.
fn link(
    address: &str,
    (system, own_system, own_component): (u8, Option<u8>, u8),
    version: u8,
    key_file: Option<String>,
    forward: Option<&str>,
) -> Result<LinkSettings, ConfigError> {
    let address: Address = address.parse().map_err(|why: String| ConfigError::field("address", why))?;
    within("system", system.into(), 1.0, 255.0, "")?;
    let own = (own_system.unwrap_or(system), own_component);
    within("own_system", own.0.into(), 1.0, 255.0, "")?;
    within("own_component", own.1.into(), 1.0, 255.0, "")?;
    if own == (system, AUTOPILOT) {
        let why = "1 is the autopilot's own component; onboard computers are 191 to 194";
        return Err(ConfigError::field("own_component", why));
    }
    within("version", version.into(), 1.0, 2.0, "")?;
    if version == 1 && key_file.is_some() {
        return Err(ConfigError::field(
            "signing_key_file",
            "frames of MAVLink 1 have no signature; leave out `version`",
        ));
    }
    if key_file.as_deref() == Some("") {
        return Err(ConfigError::field("signing_key_file", "it is empty; name the file of the key, or leave it out"));
    }
    let forward = match forward {
        None => None,
        Some(text) => {
            let to: Option<SocketAddrV4> = text.parse().ok().filter(|to: &SocketAddrV4| to.port() > 0);
            let why = || format!("'{text}' is no IPv4 address with a port, as in 127.0.0.1:14560");
            Some(to.ok_or_else(|| ConfigError::field("forward", why()))?)
        }
    };
    Ok(LinkSettings { address, system, own, version, key_file, forward })
}

impl DriverConfig {
    /// Reads and checks the settings of the driver. An error names the wrong setting.
    pub fn read(settings: &Settings) -> Result<DriverConfig, ConfigError> {
        let fields: DriverFields = settings.read()?;
        let own = (fields.system, fields.own_system, fields.own_component.unwrap_or(DRIVER));
        let link = link(&fields.address, own, fields.version, fields.signing_key_file, fields.forward.as_deref())?;
        within("speed_m_s", fields.speed_m_s.into(), 0.05, 30.0, "m/s")?;
        within("yaw_rate_rad_s", fields.yaw_rate_rad_s.into(), 0.05, 10.0, "rad/s")?;
        within("setpoint_hz", fields.setpoint_hz.into(), 5.0, 50.0, "Hz")?;
        within("position_hz", fields.position_hz.into(), 1.0, 50.0, "Hz")?;
        within("yaw_rad", fields.yaw_rad, -7.0, 7.0, "rad")?;
        let drives = (fields.autopilot, fields.vehicle) == (Firmware::ArduPilot, Vehicle::Rover);
        if fields.setpoints == Setpoints::Body && !drives {
            return Err(ConfigError::field("setpoints", "'body' is for rovers of ArduPilot; others take 'world'"));
        }
        Ok(DriverConfig {
            link,
            firmware: fields.autopilot,
            vehicle: fields.vehicle,
            arm: fields.arm,
            axes: Axes { yaw_rad: fields.yaw_rad },
            setpoints: fields.setpoints,
            speed_m_s: fields.speed_m_s,
            yaw_rate_rad_s: fields.yaw_rate_rad_s,
            setpoint_hz: fields.setpoint_hz,
            position_hz: fields.position_hz,
        })
    }
}

/// Position of an autopilot that a source uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Position {
    /// LOCAL_POSITION_NED, in metres from where the autopilot has its origin.
    Local,
    /// GLOBAL_POSITION_INT, latitude and longitude in steps of 1 cm.
    Global,
}

/// Settings of the source `mavlink` as a table in a team file, not yet checked.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SourceFields {
    address: String,
    #[serde(default = "first")]
    system: u8,
    own_system: Option<u8>,
    own_component: Option<u8>,
    #[serde(default = "newest")]
    version: u8,
    signing_key_file: Option<String>,
    #[serde(default = "local")]
    position: Position,
    origin_latitude_deg: Option<f64>,
    origin_longitude_deg: Option<f64>,
    #[serde(default)]
    origin_m: Option<[f64; 2]>,
    #[serde(default)]
    yaw_rad: f64,
    fix_least: Option<Fix>,
    #[serde(default = "position_hz")]
    position_hz: u8,
}

fn local() -> Position {
    Position::Local
}

/// Checked settings of the source `mavlink`.
#[derive(Clone, Debug)]
pub struct SourceConfig {
    /// Link with the autopilot.
    pub link: LinkSettings,
    /// Position that is used.
    pub position: Position,
    /// Local frame with axes east, north and up at the team's origin; `None` for a team without a place on the earth.
    pub frame: Option<LocalFrame>,
    /// Alignment of east and north with the team's frame, and for a team without a place on the earth the place of the
    /// autopilot's origin.
    pub alignment: Alignment,
    /// Axes of the team's frame beside north and east.
    pub axes: Axes,
    /// Lowest quality of a satellite fix; `None` for robots that are not localized by satellites.
    pub fix_least: Option<Fix>,
    /// Rate of positions and attitudes that the autopilot is asked for \[Hz\].
    pub position_hz: u8,
}

impl SourceConfig {
    /// Reads and checks the settings of the source. An error names the wrong setting.
    pub fn read(settings: &Settings) -> Result<SourceConfig, ConfigError> {
        let fields: SourceFields = settings.read()?;
        let own = (fields.system, fields.own_system, fields.own_component.unwrap_or(SOURCE));
        let link = link(&fields.address, own, fields.version, fields.signing_key_file, None)?;
        within("position_hz", fields.position_hz.into(), 1.0, 50.0, "Hz")?;
        let missing = |name: &str| {
            ConfigError::field(name, "it is missing; give the same origin on WGS 84 to all robots of the team")
        };
        let origin = match (fields.origin_latitude_deg, fields.origin_longitude_deg) {
            (None, None) if fields.position == Position::Global => return Err(missing("origin_latitude_deg")),
            (None, None) => None,
            (Some(_), None) => return Err(missing("origin_longitude_deg")),
            (None, Some(_)) => return Err(missing("origin_latitude_deg")),
            (Some(latitude_deg), Some(longitude_deg)) => {
                // East is undefined at the poles.
                within("origin_latitude_deg", latitude_deg, -89.0, 89.0, "deg")?;
                within("origin_longitude_deg", longitude_deg, -180.0, 180.0, "deg")?;
                Some(Geodetic { latitude_deg, longitude_deg, height_m: 0.0 })
            }
        };
        if origin.is_some() && fields.origin_m.is_some() {
            let why = "the origin on WGS 84 says where the autopilot's own is; leave one of them out";
            return Err(ConfigError::field("origin_m", why));
        }
        // Its error is smaller than the distance that the guard keeps between two robots.
        let fix_least = fields.fix_least.or(origin.map(|_| Fix::RtkFixed));
        Ok(SourceConfig {
            link,
            position: fields.position,
            frame: origin.as_ref().map(LocalFrame::at),
            alignment: Alignment::new(fields.yaw_rad, fields.origin_m.unwrap_or_default())?,
            axes: Axes { yaw_rad: fields.yaw_rad },
            fix_least,
            position_hz: fields.position_hz,
        })
    }
}

/// Returns the settings of a driver of a rover with PX4, with changes as lines of TOML, for tests of other files.
#[cfg(all(test, feature = "mavlink"))]
pub(crate) fn tests_config(changes: &str) -> DriverConfig {
    let base = "address = 'udpin://0.0.0.0:14540'\nautopilot = 'px4'\nvehicle = 'rover'\nspeed_m_s = 1.0";
    let mut table: toml::Table = base.parse().expect("TOML");
    table.extend(changes.parse::<toml::Table>().expect("TOML"));
    DriverConfig::read(&Settings { name: "mavlink".to_owned(), table }).expect("settings")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> Settings {
        Settings { name: "mavlink".to_owned(), table: text.parse().expect("TOML") }
    }

    const DRIVER: &str = "address = 'udpin://0.0.0.0:14540'\nautopilot = 'px4'\nvehicle = 'rover'\nspeed_m_s = 1.0\n";

    #[test]
    fn the_defaults_are_those_of_an_onboard_computer_that_does_not_arm() {
        let config = DriverConfig::read(&settings(DRIVER)).expect("settings");
        assert_eq!((config.link.system, config.link.own, config.arm), (1, (1, 191), false));
        assert_eq!((config.link.version, config.setpoint_hz, config.setpoints), (2, 20, Setpoints::World));
        let source = SourceConfig::read(&settings("address = 'udpin://127.0.0.1:14560'")).expect("settings");
        assert!(source.link.own == (1, 192) && source.fix_least.is_none() && source.frame.is_none());
    }

    #[test]
    fn each_wrong_setting_of_the_driver_is_named() {
        for (more, part) in [
            ("system = 0", "system: 0 is out of range"),
            ("own_component = 1", "own_component: 1 is the autopilot's own"),
            ("own_component = 0", "own_component: 0 is out of range"),
            ("version = 3", "version: 3 is out of range"),
            ("version = 1\nsigning_key_file = 'link.key'", "signing_key_file: frames of MAVLink 1"),
            ("signing_key_file = ''", "signing_key_file: it is empty"),
            ("forward = '127.0.0.1'", "forward: '127.0.0.1' is no IPv4 address"),
            ("setpoints = 'body'", "setpoints: 'body' is for rovers of ArduPilot"),
            ("setpoints = 'both'", "mavlink.setpoints: "),
            ("yaw_rate_rad_s = 0", "yaw_rate_rad_s: 0 is out of range"),
            ("setpoint_hz = 2", "setpoint_hz: 2 is out of range"),
            ("position_hz = 0", "position_hz: 0 is out of range"),
            ("yaw_rad = 90", "yaw_rad: 90 is out of range"),
            ("arm = 'yes'", "mavlink.arm: "),
            ("armed = true", "armed"),
        ] {
            let error = DriverConfig::read(&settings(&format!("{DRIVER}{more}"))).expect_err(more).to_string();
            assert!(error.contains(part), "{more}: {error}");
        }
        for (text, part) in [
            (DRIVER.replace("udpin://", ""), "address: it has no scheme"),
            (DRIVER.replace("px4", "betaflight"), "mavlink.autopilot: "),
            (DRIVER.replace("rover", "plane"), "mavlink.vehicle: "),
            (DRIVER.replace("speed_m_s = 1.0", "speed_m_s = nan"), "speed_m_s: NaN is out of range"),
            (DRIVER.replace("speed_m_s = 1.0", ""), "speed_m_s"),
        ] {
            let error = DriverConfig::read(&settings(&text)).expect_err(&text).to_string();
            assert!(error.contains(part) && !error.contains('\n'), "{text}: {error}");
        }
    }

    #[test]
    fn each_wrong_setting_of_the_source_is_named() {
        let address = "address = 'udpin://127.0.0.1:14560'\n";
        let origin = "origin_latitude_deg = 52.0\norigin_longitude_deg = 0.1\n";
        let earth = SourceConfig::read(&settings(&format!("{address}{origin}"))).expect("settings");
        assert_eq!(earth.fix_least, Some(Fix::RtkFixed));
        for (more, part) in [
            ("position = 'global'", "origin_latitude_deg: it is missing"),
            ("origin_latitude_deg = 52.0", "origin_longitude_deg: it is missing"),
            ("origin_longitude_deg = 0.1", "origin_latitude_deg: it is missing"),
            ("origin_latitude_deg = 90.0\norigin_longitude_deg = 0.1", "origin_latitude_deg: 90 is out of range"),
            (&format!("{origin}origin_m = [0.0, 0.0]"), "origin_m: the origin on WGS 84"),
            ("origin_m = [1e6, 0.0]", "origin_m: it is out of range"),
            ("yaw_rad = 90.0", "yaw_rad: it is out of range"),
            ("fix_least = 'rtk'", "mavlink.fix_least: "),
            ("position = 'odometry'", "mavlink.position: "),
            ("position_hz = 60", "position_hz: 60 is out of range"),
            ("forward = '127.0.0.1:1'", "forward"),
        ] {
            let error = SourceConfig::read(&settings(&format!("{address}{more}"))).expect_err(more).to_string();
            assert!(error.contains(part), "{more}: {error}");
        }
    }
}
