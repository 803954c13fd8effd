//! Settings of the source `gpsd` in a team file.

use murmurate::config::ConfigError;
use murmurate::config::fields::FieldType;
use murmurate::edge::Settings;
use murmurate::localization::alignment::Alignment;
use murmurate::localization::fix::Fix;
use murmurate::localization::geodesy::{Geodetic, LocalFrame};
use murmurate::time::Span;
use serde::Deserialize;

/// Default TCP port of gpsd (registered with IANA).
const PORT: u16 = 2947;

/// Setting that says how the source `gpsd` obtains a robot's heading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Heading {
    /// The course over ground at speeds of at least 0.3 m/s. Only valid for robots that drive forwards.
    Track,
    /// The direction from one antenna of the receiver to the other, by ATT reports; also at rest.
    Att,
    /// Readings of the source have no heading.
    None,
}

/// Settings of the source `gpsd` as a table in a team file, not yet checked.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Fields {
    /// Address, or name of a host, and TCP port of gpsd.
    address: String,
    /// Path of the receiver's device at gpsd; if left out, reports of all its devices are used.
    device: Option<String>,
    /// Latitude of the team's origin on WGS 84 \[deg\].
    origin_latitude_deg: Option<f64>,
    /// Longitude of the team's origin on WGS 84 \[deg\].
    origin_longitude_deg: Option<f64>,
    /// Direction of east in the team's frame \[rad\], counter-clockwise from its x axis.
    yaw_rad: f64,
    /// Lowest quality of a fix that gives a reading.
    fix_least: Fix,
    /// Largest standard deviation of the position by GST \[m\]. A fix with a larger one, or without GST, gives no
    /// reading. No limit if left out.
    deviation_most_m: Option<f64>,
    /// Source of the robot's heading.
    heading: Heading,
    /// Direction of the receiver's heading relative to the robot's front \[rad\], counter-clockwise, for `att`.
    antennas_rad: f64,
    /// Time for which positions by dead reckoning alone are used after the last fix from satellites \[s\].
    dead_reckoning_s: f64,
}

impl Default for Fields {
    fn default() -> Fields {
        Fields {
            address: format!("127.0.0.1:{PORT}"),
            device: None,
            origin_latitude_deg: None,
            origin_longitude_deg: None,
            yaw_rad: 0.0,
            // Its error is smaller than the distance that the guard keeps between two robots.
            fix_least: Fix::RtkFixed,
            deviation_most_m: None,
            heading: Heading::Track,
            antennas_rad: 0.0,
            // Its error grows, and how fast no report says.
            dead_reckoning_s: 0.0,
        }
    }
}

/// Checked settings of the source `gpsd`, which localizes a robot by its own satellite receiver.
#[derive(Clone, Debug)]
pub struct Config {
    /// Address and TCP port of gpsd, the daemon that reads the receiver; or name of its host, with the port.
    pub address: String,
    /// Path of the receiver's device at gpsd; `None` for all its devices.
    pub device: Option<String>,
    /// Local frame with axes east, north and up at the team's origin.
    pub frame: LocalFrame,
    /// Alignment of the axes east and north with the team's frame.
    pub axes: Alignment,
    /// Lowest quality of a fix that gives a reading.
    pub fix_least: Fix,
    /// Largest standard deviation of the position by GST \[m\]; `None` for no limit.
    pub deviation_most_m: Option<f64>,
    /// Source of the robot's heading.
    pub heading: Heading,
    /// Direction of the receiver's heading relative to the robot's front \[rad\], counter-clockwise.
    pub antennas_rad: f64,
    /// Time for which positions by dead reckoning alone are used after the last fix from satellites; zero for never.
    pub(crate) dead_reckoning: Span,
}

impl Config {
    /// Reads and checks the settings of the source `gpsd`. An error names the wrong setting.
    pub fn read(settings: &Settings) -> Result<Config, ConfigError> {
        let fields: Fields = settings.read()?;
        let given = |name: &str, value: Option<f64>| {
            value.ok_or_else(|| {
                ConfigError::field(name, "it is missing; give the same origin to all robots of the team")
            })
        };
        let latitude_deg = given("origin_latitude_deg", fields.origin_latitude_deg)?;
        let longitude_deg = given("origin_longitude_deg", fields.origin_longitude_deg)?;
        let deviation_most_m = fields.deviation_most_m.unwrap_or(1.0);
        let within = [
            // The direction east is undefined at the poles.
            ("origin_latitude_deg", latitude_deg, -89.0, 89.0, "deg"),
            ("origin_longitude_deg", longitude_deg, -180.0, 180.0, "deg"),
            ("deviation_most_m", deviation_most_m, 0.001, 100.0, "m"),
            ("antennas_rad", fields.antennas_rad, -7.0, 7.0, "rad"),
            ("dead_reckoning_s", fields.dead_reckoning_s, 0.0, 60.0, "s"),
        ];
        for (name, value, least, most, unit) in within {
            if !(least..=most).contains(&value) {
                return Err(ConfigError::field(name, format!("it is out of range; give {least} to {most} {unit}")));
            }
        }
        if let Err(why) = FieldType::HostAddress.read(&fields.address) {
            return Err(ConfigError::field("address", format!("{why}; gpsd listens on port {PORT}")));
        }
        Ok(Config {
            address: fields.address,
            device: fields.device,
            // Height zero, because the origin's height changes only the vertical coordinate.
            frame: LocalFrame::at(&Geodetic { latitude_deg, longitude_deg, height_m: 0.0 }),
            axes: Alignment::new(fields.yaw_rad, [0.0; 2])?,
            fix_least: fields.fix_least,
            deviation_most_m: fields.deviation_most_m,
            heading: fields.heading,
            antennas_rad: fields.antennas_rad,
            dead_reckoning: Span::from_secs(fields.dead_reckoning_s),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Config, String> {
        let settings = Settings { name: "gpsd".to_owned(), table: text.parse().unwrap() };
        Config::read(&settings).map_err(|error| error.to_string())
    }

    #[test]
    fn a_wrong_field_is_named() {
        let origin = "origin_latitude_deg = 52\norigin_longitude_deg = 0.1";
        let config = read(origin).unwrap();
        assert_eq!((config.address.as_str(), config.fix_least), ("127.0.0.1:2947", Fix::RtkFixed));
        let named = read(&format!("{origin}\naddress = 'robot-2.local:2947'")).unwrap();
        assert_eq!(named.address, "robot-2.local:2947");
        for (text, part) in [
            ("origin_latitude_deg = 52.0", "origin_longitude_deg: it is missing"),
            ("origin_longitude_deg = 0.1", "origin_latitude_deg: it is missing"),
            ("origin_latitude_deg = 90.5\norigin_longitude_deg = 0.1", "origin_latitude_deg: it is out of range"),
            (&format!("{origin}\nfix_least = 'rtk'"), "gpsd.fix_least: "),
            (&format!("{origin}\naddress = 'robot'"), "address: "),
            (&format!("{origin}\naddress = 2947"), "gpsd.address: "),
            (&format!("{origin}\naddress = '10.0.0.1:0'"), "address: "),
            (&format!("{origin}\nyaw_rad = nan"), "yaw_rad: "),
            (&format!("{origin}\ndeviation_most_m = 0"), "deviation_most_m: "),
            (&format!("{origin}\nantennas_rad = 90"), "antennas_rad: "),
            (&format!("{origin}\ndead_reckoning_s = -1"), "dead_reckoning_s: it is out of range; give 0 to 60 s"),
            (&format!("{origin}\nheading = 'gps'"), "gpsd.heading: "),
            (&format!("{origin}\ncolour = 1"), "colour"),
        ] {
            let error = read(text).expect_err(text);
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
