//! Settings of the source `natnet` in a team file.

use std::net::Ipv4Addr;

use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use murmurate::localization::alignment::Alignment;
use murmurate::messages::ids::RobotId;
use serde::Deserialize;

use super::TrackerFrame;

/// Default multicast group of frames in Motive, the server of OptiTrack (its manual).
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 42, 99);
/// Default UDP port of frames in Motive (its manual).
const DATA_PORT: u16 = 1511;
/// Default UDP port of commands in Motive (its manual).
const COMMAND_PORT: u16 = 1510;

/// Axis of the tracker's frame that points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Up {
    /// The y axis points up: (x, y, z) of the tracker is (x, -z, y) before the rotation to the team's frame.
    Y,
    /// The z axis points up.
    Z,
}

/// Method by which the motion capture server sends frames to its clients.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transmission {
    /// Frames of motion capture data are sent to a multicast group.
    Multicast,
    /// Frames of motion capture data are sent to each client that requests them.
    Unicast,
}

/// Reference to a rigid body of the tracker: its name or its streaming ID.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum BodyName {
    /// Name of the body in the tracker. Model definitions give its streaming ID.
    Name(String),
    /// Streaming ID of the body: the number by which the tracker identifies it.
    Id(i32),
}

/// Network addresses of the tracker's server and of its frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Addresses {
    /// Address of the server. Datagrams from other addresses are ignored.
    pub server: Ipv4Addr,
    /// Name of the network interface on which multicast frames arrive, such as `eth0`; used for multicast only. `None`
    /// selects the interface of the operating system's route to the server.
    pub interface: Option<String>,
    /// Method by which the motion capture server sends frames.
    pub transmission: Transmission,
    /// Multicast group to which the server sends frames; used for multicast only.
    pub group: Ipv4Addr,
    /// UDP port of the frames; used for multicast only.
    pub data_port: u16,
    /// UDP port of the server for requests of clients.
    pub command_port: u16,
}

/// Settings of the source `natnet` as a table in a team file, not yet checked.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Fields {
    /// IPv4 address of the computer that runs the tracker's server.
    server: Option<Ipv4Addr>,
    /// Name of this machine's network interface to the tracker, for multicast; if left out, that of the route to the
    /// server.
    interface: Option<String>,
    /// Method by which the server sends frames, as in its streaming settings.
    transmission: Transmission,
    /// Multicast group of the frames.
    group: Ipv4Addr,
    /// UDP port of the frames, for multicast.
    data_port: u16,
    /// UDP port of the server for commands.
    command_port: u16,
    /// Vertical axis of the tracker's frame, as in the server's streaming settings.
    up: Up,
    /// Direction of the tracker's x axis in the team's frame \[rad\], counter-clockwise from the team's x axis.
    yaw_rad: f64,
    /// Position of the tracker's origin in the team's frame \[m\].
    origin_m: [f64; 2],
    /// Rigid body of each robot: its name or its streaming ID. A robot without an entry has the body `robot-N`.
    bodies: toml::Table,
    /// Length of the window whose mean velocity is reported \[s\]. The mean lags the true velocity by half the window.
    velocity_window_s: f64,
    /// Highest rate of readings for each robot \[Hz\].
    rate_hz: f64,
}

impl Default for Fields {
    fn default() -> Fields {
        Fields {
            server: None,
            interface: None,
            transmission: Transmission::Multicast,
            group: GROUP,
            data_port: DATA_PORT,
            command_port: COMMAND_PORT,
            up: Up::Y,
            yaw_rad: 0.0,
            origin_m: [0.0; 2],
            bodies: toml::Table::new(),
            // Position noise of 0.2 mm gives a velocity noise of 6 mm/s, at a lag of 25 ms.
            velocity_window_s: 0.05,
            // Twice the rate of the policies; trackers send at 100 Hz or more.
            rate_hz: 50.0,
        }
    }
}

/// Checked settings of the source `natnet`, which localizes robots by motion capture.
#[derive(Clone, Debug)]
pub struct Config {
    /// Network addresses of the server and of its frames.
    pub network: Addresses,
    /// Position and rotation of the tracker's frame in the team's frame.
    pub frame: TrackerFrame,
    /// Robots by ascending number, each with its rigid body.
    pub bodies: Vec<(RobotId, BodyName)>,
    /// Length of the window over which velocities are computed \[s\].
    pub window_s: f64,
    /// Shortest mean time between two readings of a robot \[s\]; the tracker's frames in between serve only to
    /// compute the velocity.
    pub period_s: f64,
}

impl Config {
    /// Reads and checks the settings of a source that localizes `robots`. An error names the wrong setting.
    pub fn read(settings: &Settings, robots: &[RobotId]) -> Result<Config, ConfigError> {
        let fields: Fields = settings.read()?;
        let server = fields.server.ok_or_else(|| {
            ConfigError::field("server", "it is missing; give the IPv4 address of the computer that runs the tracker")
        })?;
        if !fields.group.is_multicast() {
            return Err(ConfigError::field(
                "group",
                "it is no multicast address; give one of 224.0.0.0 to 239.255.255.255",
            ));
        }
        for (name, port) in [("data_port", fields.data_port), ("command_port", fields.command_port)] {
            if port == 0 {
                return Err(ConfigError::field(name, "it is 0; give the port of the tracker's streaming settings"));
            }
        }
        if fields.interface.as_ref().is_some_and(String::is_empty) {
            return Err(ConfigError::field("interface", "it is empty; give the name of a network interface, or none"));
        }
        let within = [
            ("velocity_window_s", fields.velocity_window_s, 0.005, 0.5, "s"),
            ("rate_hz", fields.rate_hz, 1.0, 1000.0, "Hz"),
        ];
        for (name, value, least, most, unit) in within {
            if !(least..=most).contains(&value) {
                return Err(ConfigError::field(name, format!("it is out of range; give {least} to {most} {unit}")));
            }
        }
        Ok(Config {
            network: Addresses {
                server,
                interface: fields.interface,
                transmission: fields.transmission,
                group: fields.group,
                data_port: fields.data_port,
                command_port: fields.command_port,
            },
            frame: TrackerFrame { up: fields.up, level: Alignment::new(fields.yaw_rad, fields.origin_m)? },
            bodies: bodies(&fields.bodies, robots)?,
            window_s: fields.velocity_window_s,
            period_s: 1.0 / fields.rate_hz,
        })
    }
}

/// Returns the robots by ascending number, each with its rigid body from `table`, or the body `robot-N` without an
/// entry. An error names a wrong entry, such as one of a robot that is not in `robots`.
fn bodies(table: &toml::Table, robots: &[RobotId]) -> Result<Vec<(RobotId, BodyName)>, ConfigError> {
    let mut all: Vec<(RobotId, BodyName)> = Vec::new();
    for robot in robots {
        all.push((*robot, BodyName::Name(format!("robot-{}", robot.0))));
    }
    all.sort_by_key(|(robot, _)| *robot);
    for (key, value) in table {
        let wrong = |why: &str| ConfigError::field(format!("bodies.{key}"), why);
        let robot = key.parse().map(RobotId).map_err(|_| wrong("it is no robot; give the number of a robot"))?;
        let place = all.iter().position(|(known, _)| *known == robot);
        let place = place.ok_or_else(|| wrong("this source does not localize that robot; see `localizes`"))?;
        all[place].1 = match value {
            toml::Value::String(name) if !name.is_empty() => BodyName::Name(name.clone()),
            toml::Value::Integer(id) => BodyName::Id(
                i32::try_from(*id).map_err(|_| wrong("it is out of range; give the streaming ID of the rigid body"))?,
            ),
            _ => return Err(wrong("give the name of a rigid body, in quotes, or its streaming ID")),
        };
    }
    for (at, (robot, name)) in all.iter().enumerate() {
        if let Some((other, _)) = all[..at].iter().find(|(_, other)| other == name) {
            let why = format!("{robot} and {other} have the same rigid body; give each its own");
            return Err(ConfigError::field("bodies", why));
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Config, String> {
        let settings = Settings { name: "natnet".to_owned(), table: text.parse().unwrap() };
        Config::read(&settings, &[RobotId(3), RobotId(0)]).map_err(|error| error.to_string())
    }

    #[test]
    fn a_server_is_all_that_has_to_be_given() {
        let config = read("server = '10.0.0.2'").unwrap();
        let name = |text: &str| BodyName::Name(text.to_owned());
        assert_eq!(config.bodies, [(RobotId(0), name("robot-0")), (RobotId(3), name("robot-3"))]);
        let config = read("server = '10.0.0.2'\nvelocity_window_s = 0.1\nbodies = { 0 = 'jackal', 3 = 8 }").unwrap();
        assert_eq!(config.bodies, [(RobotId(0), name("jackal")), (RobotId(3), BodyName::Id(8))]);
        assert_eq!(config.window_s, 0.1);
    }

    #[test]
    fn a_wrong_field_is_named() {
        for (text, part) in [
            ("", "server: it is missing"),
            ("server = 'tracker'", "natnet.server: "),
            ("colour = 'red'", "colour"),
            ("up = 'x'", "natnet.up: "),
            ("group = '10.0.0.1'", "group: "),
            ("data_port = 0", "data_port: "),
            ("interface = ''", "interface: "),
            ("rate_hz = 0.0", "rate_hz: it is out of range; give 1 to 1000 Hz"),
            ("yaw_rad = nan", "yaw_rad: "),
            ("origin_m = [0.0, inf]", "origin_m: "),
            ("bodies = { 7 = 'a' }", "bodies.7: "),
            ("bodies = { a = 7 }", "bodies.a: "),
            ("bodies = { 0 = 1.5 }", "bodies.0: "),
            ("bodies = { 0 = 99999999999 }", "bodies.0: "),
            ("bodies = { 0 = 'robot-3' }", "bodies: robot 3 and robot 0"),
        ] {
            let text = if text.is_empty() { String::new() } else { format!("server = '127.0.0.1'\n{text}") };
            let text = text.replacen("server = '127.0.0.1'\nserver", "server", 1);
            let error = read(&text).expect_err(&text);
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
