//! Source that runs a program of the user's, in any language, with one JSON object per line.
//!
//! The program writes `{"robot": 0, "stamp_s": 12.34, "x": 0.1, "y": -2.0, "vx": 0.0, "vy": 0.3}`: time of measurement
//! on its own clock \[s\], position \[m\] and velocity \[m/s\] in the world frame. It may add `"heading"` \[rad\],
//! counter-clockwise from the x axis, `"yaw_rate"` \[rad/s\], and standard deviations `"position_m"`, `"heading_rad"`,
//! `"velocity_m_s"`, `"yaw_rate_rad_s"`.

use serde::Deserialize;

use super::{In, Out, Parts, Source};
use crate::config::ConfigError;
use crate::edge::Settings;
use crate::edge::child::Program;
use crate::messages::geometry::{Deviation, Pose, Twist, Vec2};
use crate::messages::ids::RobotId;
use crate::messages::wire::Reading;
use crate::time::{Span, Time};

/// Description of the source `program` in one line, for lists of all sources.
pub(crate) const ABOUT: &str = "a program of yours: JSON lines on its stdout";

/// Settings of the source `program`, which runs a program of the user's, in the team file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// The program and its arguments.
    command: Vec<String>,
}

/// Line of JSON that the user's program writes: one reading of one robot.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    robot: u16,
    stamp_s: f64,
    x: f32,
    y: f32,
    vx: f32,
    vy: f32,
    heading: Option<f32>,
    yaw_rate: Option<f32>,
    position_m: Option<f32>,
    heading_rad: Option<f32>,
    velocity_m_s: Option<f32>,
    yaw_rate_rad_s: Option<f32>,
}

struct Lines {
    robots: Vec<RobotId>,
}

/// Makes the source that gets readings from a user's program, and the worker that runs the program. The error names the
/// wrong setting.
pub fn make(settings: &Settings, robots: &[RobotId]) -> Result<Parts, ConfigError> {
    let config: Config = settings.read()?;
    if config.command.is_empty() {
        return Err(ConfigError::field("command", "it is empty; name a program and its arguments".to_owned()));
    }
    let robots = robots.to_vec();
    Ok(Parts {
        source: Box::new(move || Box::new(Lines { robots: robots.clone() })),
        worker: Box::new(Program::new(config.command)),
    })
}

impl Source for Lines {
    fn take(&mut self, _: Time, input: In, out: &mut Vec<Out>) {
        let In::Packet(packet) = input else { return };
        out.push(match serde_json::from_slice::<Line>(packet) {
            Err(_) => match named(packet).filter(|robot| self.robots.contains(robot)) {
                Some(robot) => Out::RefusedOf(robot, misread(packet)),
                None => Out::Refused(misread(packet)),
            },
            Ok(line) if !self.robots.contains(&RobotId(line.robot)) => Out::Refused("its robot is not of this source"),
            Ok(line) if !(0.0..1e10).contains(&line.stamp_s) => {
                Out::RefusedOf(RobotId(line.robot), "its stamp is not 0 to 1e10 s")
            }
            Ok(line) => {
                let reading = reading(&line);
                reading.unfit().map_or(Out::Reading(reading), |why| Out::RefusedOf(RobotId(line.robot), why))
            }
        });
    }
}

/// Returns the robot that a line names although it is not in the source's format; `None` if it names none.
fn named(packet: &[u8]) -> Option<RobotId> {
    let (_, rest) = std::str::from_utf8(packet).ok()?.split_once("\"robot\"")?;
    let number = rest.trim_start().strip_prefix(':')?.trim_start();
    let end = number.find(|digit: char| !digit.is_ascii_digit()).unwrap_or(number.len());
    number[..end].parse().ok().map(RobotId)
}

/// Returns the reason why a line is not in the source's format.
fn misread(packet: &[u8]) -> &'static str {
    let has = |word: &[u8]| packet.windows(word.len()).any(|part| part == word);
    match () {
        // As Python's `json` writes them.
        () if has(b"NaN") || has(b"Infinity") => "its line has NaN or Infinity, which JSON has not; leave it out",
        () => "it is not a line in the source's format",
    }
}

fn reading(line: &Line) -> Reading {
    Reading {
        robot: RobotId(line.robot),
        stamp_ns: Span::from_secs(line.stamp_s).as_nanos(),
        pose: Pose { position: Vec2::new(line.x, line.y), heading: line.heading },
        twist: Twist { velocity: Vec2::new(line.vx, line.vy), yaw_rate: line.yaw_rate },
        deviation: Deviation {
            position_m: line.position_m,
            heading_rad: line.heading_rad,
            velocity_m_s: line.velocity_m_s,
            yaw_rate_rad_s: line.yaw_rate_rad_s,
        },
    }
}
