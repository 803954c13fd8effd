//! Driver that runs a program of the user's, in any language, with one JSON object per line.
//!
//! The program reads `{"robot": 0, "vx": 0.1, "vy": 0.0, "ahead": 0.1, "left": 0.0, "yaw_rate": 0.0, "for_s": 0.2}`.
//! `vx` and `vy` are the velocity in the world frame \[m/s\]. `ahead`, `left` and `yaw_rate` are the same as a motion
//! in the robot's own frame \[m/s, rad/s\], null while its heading is unknown or old. `for_s` is the validity \[s\]:
//! after it, and at the end of its input, the robot must stand. The program may write
//! `{"health": "faulty", "battery": 87, "temperature_c": 41.5, "reason": "bumper pressed"}` at any time; `health` is
//! `ready`, `faulty` or `silent`, and the others may be left out.
//!
//! The program of a robot that flies (`flies = true`) also reads `{"robot": 0, "fly": "rise", "height_m": 0.5}`, and
//! the same with `"land"` and `"cut"` (switch the motors off now), whose height is null. It writes the state of the
//! flight with its health: `"flight": "grounded"`, `"rising"`, `"flying"` or `"landing"`.

use serde::{Deserialize, Serialize};

use super::{Command, Driver, Limits, Out, Parts, Vertical};
use crate::config::ConfigError;
use crate::edge::Settings;
use crate::edge::child::Program;
use crate::messages::geometry::{Planar, Vec2, limit_below};
use crate::messages::ids::RobotId;
use crate::messages::wire::{Celsius, Flight, Hardware, Health, Reason};
use crate::time::Time;

/// Description of the driver in one line, for lists of all drivers.
pub const ABOUT: &str = "a program of yours: JSON lines on its stdin and stdout";

/// Settings in the team file of the driver that runs a user's program.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Program file to run, followed by its arguments.
    command: Vec<String>,
    /// Largest speed of the robot \[m/s\].
    #[serde(default = "unlimited")]
    speed_m_s: f32,
    /// Whether the robot flies, and so gets orders about its height.
    #[serde(default)]
    flies: bool,
}

fn unlimited() -> f32 {
    f32::INFINITY
}

/// Line of JSON that the user's program reads: a command for its robot.
#[derive(Debug, Serialize)]
struct Line {
    robot: u16,
    vx: f32,
    vy: f32,
    ahead: Option<f32>,
    left: Option<f32>,
    yaw_rate: Option<f32>,
    for_s: f64,
}

/// Line of JSON that the user's program reads: an order about the height of a robot that flies.
#[derive(Debug, Serialize)]
struct Order {
    robot: u16,
    fly: &'static str,
    height_m: Option<f32>,
}

/// Line of JSON that the user's program writes: the condition of its robot's hardware.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Word {
    health: Condition,
    battery: Option<i64>,
    temperature_c: Option<f32>,
    reason: Option<String>,
    flight: Option<State>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Condition {
    Ready,
    Faulty,
    Silent,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum State {
    Grounded,
    Rising,
    Flying,
    Landing,
}

struct Lines {
    robot: RobotId,
    limits: Limits,
    flies: bool,
}

impl Lines {
    fn send(&self, line: &impl Serialize, out: &mut Vec<Out>) {
        let mut bytes = serde_json::to_vec(line).expect("plain numbers are JSON");
        bytes.push(b'\n');
        out.push(Out::Send(bytes.into()));
    }
}

/// Makes the driver that controls `robot` through a user's program, and its worker; an error names the wrong setting.
pub fn make(settings: &Settings, robot: RobotId) -> Result<Parts, ConfigError> {
    let config: Config = settings.read()?;
    if config.command.is_empty() {
        return Err(ConfigError::field("command", "it is empty; name a program and its arguments".to_owned()));
    }
    if config.speed_m_s.is_nan() || config.speed_m_s <= 0.0 {
        return Err(ConfigError::field("speed_m_s", format!("{} is not a speed above zero", config.speed_m_s)));
    }
    let (limits, flies) = (Limits { speed_m_s: limit_below(config.speed_m_s) }, config.flies);
    Ok(Parts {
        driver: Box::new(move || Box::new(Lines { robot, limits, flies })),
        worker: Some(Box::new(Program::new(config.command))),
    })
}

impl Driver for Lines {
    fn limits(&self) -> Limits {
        self.limits
    }

    fn drive(&mut self, now: Time, command: &Command, out: &mut Vec<Out>) {
        let Command { drive, body } = command;
        // Within the limit of the velocity, it is beyond it by no more than the rounding of the turn.
        let planar = body.map(|body| Vec2::new(body.forward, body.left).capped(self.limits.speed_m_s));
        let line = Line {
            robot: self.robot.0,
            vx: drive.velocity.x,
            vy: drive.velocity.y,
            ahead: planar.map(|planar| planar.x),
            left: planar.map(|planar| planar.y),
            yaw_rate: body.map(|body| body.yaw_rate),
            for_s: drive.until.since(now).as_secs(),
        };
        self.send(&line, out);
    }

    fn flies(&self) -> bool {
        self.flies
    }

    fn fly(&mut self, _: Time, order: Vertical, out: &mut Vec<Out>) {
        let (fly, height_m) = match order {
            Vertical::Rise { height_m } => ("rise", Some(height_m)),
            Vertical::Land => ("land", None),
            Vertical::Cut => ("cut", None),
        };
        self.send(&Order { robot: self.robot.0, fly, height_m }, out);
    }

    fn receive(&mut self, _: Time, packet: &[u8], out: &mut Vec<Out>) {
        match serde_json::from_slice::<Word>(packet) {
            // A value that is out of range is unknown; the rest of the line counts, above all a fault.
            Ok(Word { health, battery, temperature_c, reason, flight }) => {
                let health = match health {
                    Condition::Ready => Health::Ready,
                    Condition::Faulty => Health::Faulty,
                    Condition::Silent => Health::Silent,
                };
                let temperature = temperature_c.and_then(Celsius::of);
                let charge = battery.and_then(|battery| u8::try_from(battery).ok()).filter(|charge| *charge <= 100);
                let reason = reason.as_deref().and_then(Reason::new);
                out.push(Out::Condition(Hardware { health, battery: charge, temperature, reason }));
                match flight {
                    None => {}
                    Some(_) if !self.flies => out.push(Out::Refused("it flies, and its driver has no flies = true")),
                    Some(State::Grounded) => out.push(Out::Flight(Flight::Grounded)),
                    Some(State::Rising) => out.push(Out::Flight(Flight::Rising)),
                    Some(State::Flying) => out.push(Out::Flight(Flight::Flying)),
                    Some(State::Landing) => out.push(Out::Flight(Flight::Landing)),
                }
                if charge.is_none() && battery.is_some() {
                    out.push(Out::Refused("a battery is not 0 to 100 %"));
                }
                if temperature.is_none() && temperature_c.is_some() {
                    out.push(Out::Refused("a temperature is not -40 to 215 \u{b0}C"));
                }
            }
            Err(_) => out.push(Out::Refused("it is not a line in the driver's format")),
        }
    }
}
