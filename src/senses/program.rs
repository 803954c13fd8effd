//! Sense that runs a program of the user's, in any language, with one JSON object per line: embeddings of a camera, a
//! ring of infrared sensors, a lidar with a driver of its own.
//!
//! The program writes `{"stamp_s": 12.34, "values": [0.1, 0.2]}`: time of measurement on its own clock \[s\], and the
//! values in the unit of the settings, the last axis running fastest. `null` stands for no echo.

use std::f64::consts::{PI, TAU};

use serde::Deserialize;

use super::{In, Layout, Out, Parts, Sense, WHOLE_RAD};
use crate::config::ConfigError;
use crate::edge::Settings;
use crate::edge::child::Program;
use crate::messages::ids::RobotId;
use crate::messages::wire::MAX_SENSED;
use crate::observation::{Sweep, Unit};
use crate::time::{Span, Time};

/// Description of the sense `program` in one line, for lists of all kinds.
pub(super) const ABOUT: &str = "a program of yours: JSON lines on its stdout";

/// Room for a value in a line, with all digits of a 64-bit float, and for the rest of the line \[bytes\].
const VALUE_BYTES: usize = 28;
const LINE_BYTES: usize = 200;

/// Settings of an example.
pub(super) const EXAMPLE: &str = "command = [\"./camera\"]\nshape = [2, 3]\nunit = \"1\"";

/// Settings of the sense `program` in a deployment.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// The program and its arguments.
    command: Vec<String>,
    /// Number of values along each axis of the array.
    shape: Vec<usize>,
    /// Unit of the values.
    unit: Unit,
    /// Largest distance at which something is seen \[m\], for values that are distances along rays.
    range_m: Option<f32>,
    /// Angle of the first ray \[rad\], counter-clockwise from the direction ahead.
    from_rad: Option<f64>,
    /// Angle from the first to the last ray \[rad\]; if it is a whole turn, or left out, the rays divide it evenly.
    opening_rad: Option<f64>,
}

/// Line of JSON that the user's program writes.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    stamp_s: f64,
    values: Vec<Option<f32>>,
}

impl Config {
    /// Returns the directions of the rays, if the values are distances along rays. An error names the wrong setting.
    fn sweep(&self) -> Result<Option<Sweep>, ConfigError> {
        let wrong = |field: &str, why: String| Err(ConfigError::field(field, why));
        let Some(range_m) = self.range_m else {
            let field = [("from_rad", self.from_rad), ("opening_rad", self.opening_rad)];
            return match field.into_iter().find(|(_, given)| given.is_some()) {
                Some((field, _)) => wrong(field, "it is for rays, which have a range_m too".to_owned()),
                None => Ok(None),
            };
        };
        if !(0.01..=1000.0).contains(&range_m) {
            return wrong("range_m", format!("{range_m} is not 0.01 to 1000"));
        }
        if self.unit != Unit::Metre || self.shape.len() != 1 {
            return wrong("range_m", "distances along rays are one row in m: shape = [N], unit = \"m\"".to_owned());
        }
        let (from_rad, opening) = (self.from_rad.unwrap_or(-PI), self.opening_rad.unwrap_or(TAU));
        if !(-TAU..=TAU).contains(&from_rad) {
            return wrong("from_rad", format!("{from_rad} is not within one turn"));
        }
        if !(0.001..=TAU + WHOLE_RAD).contains(&opening) {
            return wrong("opening_rad", format!("{opening} is not 0.001 to a whole turn"));
        }
        Ok(Some(Sweep::new(self.shape[0], (from_rad, opening), range_m)))
    }
}

/// Makes the parts of a sense that gets its values from a user's program, and the worker that runs the program. The
/// error names the wrong setting.
pub(super) fn make(settings: &Settings, _: RobotId) -> Result<Parts, ConfigError> {
    let config: Config = settings.read()?;
    let within = |error: ConfigError| error.within(&settings.name);
    if config.command.is_empty() {
        let why = "it is empty; name a program and its arguments";
        return Err(within(ConfigError::field("command", why)));
    }
    let sweep = config.sweep().map_err(within)?;
    let layout = Layout { shape: config.shape, unit: config.unit, sweep };
    let longest = VALUE_BYTES.saturating_mul(layout.floats().min(MAX_SENSED)) + LINE_BYTES;
    Ok(Parts {
        layout,
        sense: Box::new(|_| Box::new(Lines)),
        worker: Some(Box::new(Program::new(config.command).with_lines_of(longest))),
    })
}

/// Reader of the lines of a user's program.
struct Lines;

impl Sense for Lines {
    fn take(&mut self, _: Time, input: In, out: &mut Vec<Out>) {
        let In::Packet(packet) = input else { return };
        out.push(match serde_json::from_slice::<Line>(packet) {
            Err(_) => Out::Refused("it is not a line {\"stamp_s\": .., \"values\": [..]} with numbers or null"),
            Ok(line) if !(0.0..1e10).contains(&line.stamp_s) => Out::Refused("its stamp is not 0 to 1e10 s"),
            Ok(Line { values, .. }) if values.iter().flatten().any(|value| value.abs() > 1e6 || value.is_nan()) => {
                Out::Refused("a value is beyond a million")
            }
            Ok(Line { stamp_s, values }) => Out::Values {
                stamp_ns: Span::from_secs(stamp_s).as_nanos(),
                values: values.into_iter().map(|value| value.unwrap_or(f32::INFINITY)).collect(),
            },
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> Settings {
        Settings { name: "eyes".to_owned(), table: text.parse().expect("it is TOML") }
    }

    fn taken(line: &str) -> Out {
        let mut out = Vec::new();
        Lines.take(Time::ZERO, In::Packet(line.as_bytes()), &mut out);
        out.pop().expect("one answer to each line")
    }

    #[test]
    fn a_line_has_a_stamp_and_values_of_which_null_is_no_echo() {
        let values = vec![1.0, f32::INFINITY, -2.5];
        let expected = Out::Values { stamp_ns: 1_500_000_000, values };
        assert_eq!(taken("{\"stamp_s\": 1.5, \"values\": [1, null, -2.5]}"), expected);
        for wrong in [
            "{\"stamp_s\": -1, \"values\": [1]}",
            "{\"values\": [1]}",
            "{\"stamp_s\": 1, \"values\": [NaN]}",
            "{\"stamp_s\": 1, \"values\": [1e39]}",
            "{\"stamp_s\": 1, \"values\": [2e6]}",
            "{\"stamp_s\": 1, \"values\": [1], \"robot\": 2}",
            "\u{1}",
        ] {
            assert!(matches!(taken(wrong), Out::Refused(_)), "{wrong}");
        }
    }

    #[test]
    fn rays_have_a_range_and_other_values_have_none() {
        let parts = |text: &str| make(&settings(text), RobotId(0));
        let refused = |text: &str| parts(text).err().expect("it is refused").to_string();
        let plain = parts("command = [\"x\"]\nshape = [2, 3]\nunit = \"1\"").expect("it is valid");
        assert_eq!((plain.layout.floats(), plain.layout.sweep), (6, None));
        let ring = parts("command = [\"x\"]\nshape = [8]\nunit = \"m\"\nrange_m = 0.3\nfrom_rad = 0.0").expect("valid");
        let expected = Sweep::new(8, (0.0, TAU), 0.3);
        assert_eq!(ring.layout.sweep, Some(expected));
        assert!(refused("command = []\nshape = [2]\nunit = \"1\"").starts_with("eyes.command"));
        assert!(refused("command = [\"x\"]\nshape = [2]\nunit = \"1\"\nfrom_rad = 1.0").starts_with("eyes.from_rad"));
        assert!(refused("command = [\"x\"]\nshape = [2]\nunit = \"1\"\nrange_m = 1.0").starts_with("eyes.range_m"));
        assert!(refused("command = [\"x\"]\nshape = [2]\nunit = \"V\"").starts_with("eyes.unit"));
    }
}
