//! What robots measure, say to each other, and do: readings, latents and motor commands.

use serde::{Deserialize, Serialize};

use super::body::{Body, Unfit};
use super::floats;
use super::floats::{Features, MAX_FEATURES, all_sound};
use super::geometry::{Deviation, Motion, Pose, Twist, Vec2, is_sound};
use super::ids::RobotId;
use super::parts::Part;
use super::phase::Phase;
use super::round::{MAX_TERM, Round};
use crate::time::Span;

/// Longest validity of a motor command: 1 s. A robot that no longer receives commands must stop within this time.
pub const MAX_VALIDITY: Span = Span::from_millis(1000);

/// Measurement of a robot's pose and velocity by a sensor, in the world frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Number of the robot that was measured.
    pub robot: RobotId,
    /// Time of measurement \[ns\] on the sensor's clock, whose offset from other clocks is unknown. The stamp
    /// distinguishes a new reading from a repeated one and gives the interval between two readings.
    pub stamp_ns: u64,
    /// Measured position and heading in the world frame.
    pub pose: Pose,
    /// Measured velocity and yaw rate in the world frame.
    pub twist: Twist,
    /// Standard deviations of the measured quantities, `None` for each that is unknown.
    pub deviation: Deviation,
}

impl Reading {
    /// Makes a reading of a sensor that measures only a point. Heading, yaw rate and standard deviations are `None`.
    /// `stamp_ns` is the time of measurement on the sensor's clock, `motion` the measured position and velocity in the
    /// world frame.
    pub fn of_point(robot: RobotId, stamp_ns: u64, motion: Motion) -> Reading {
        Reading {
            robot,
            stamp_ns,
            pose: Pose { position: motion.position, heading: None },
            twist: Twist { velocity: motion.velocity, yaw_rate: None },
            deviation: Deviation::default(),
        }
    }

    /// Returns the reason why a number of the reading is out of range; `None` if the reading is valid and may be
    /// published.
    pub fn unfit(&self) -> Option<&'static str> {
        match () {
            () if !is_sound(self.pose.position) => Some("a position is not finite, or beyond 100 km"),
            () if !self.pose.is_sound() => Some("a heading is not within -pi and pi: wrap it"),
            () if !self.twist.is_sound() => Some("a velocity or a yaw rate is not finite, or beyond any robot's"),
            () if !self.deviation.is_sound() => Some("a standard deviation is negative or not finite"),
            () => None,
        }
    }

    /// Returns the measured position and velocity, without heading and yaw rate, which policies do not use.
    pub fn motion(&self) -> Motion {
        Motion { position: self.pose.position, velocity: self.twist.velocity }
    }
}

/// Message that a robot broadcasts to its neighbours: the numbers from its policy and its own motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Latent {
    /// Number of the robot that sends the message.
    pub robot: RobotId,
    /// Round, the number of the state server's instruction, that the sender follows. A receiver in another round
    /// ignores the message.
    pub round: Round,
    /// Phase of the episode that the sender is in. It keeps messages of the reset policy apart from those of the policy
    /// under test.
    pub phase: Phase,
    /// The sender's estimate of its own position and velocity in the world frame.
    pub motion: Motion,
    /// Numbers from the sender's policy, such as the encoder's output of a graph neural network; empty in a part.
    pub features: Features,
    /// Piece of the numbers, if they travel in parts. Actors get whole messages alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<Part>,
}

/// Velocity command for a robot, sent from its Controller to its Body, the actor that drives the motors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorCommand {
    /// Number of the robot that is to move.
    pub robot: RobotId,
    /// Commanded velocity \[m/s\], world frame.
    #[serde(with = "floats::vec2")]
    pub velocity: Vec2,
    /// Time after arrival for which the command is valid. The Body stops the robot when the time is over without a
    /// newer command.
    pub valid_for: Span,
}

impl Body for Reading {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        let sound = self.pose.is_sound() && self.twist.is_sound() && self.deviation.is_sound();
        sound.then_some(()).ok_or(Unfit::Number)
    }
}

impl Body for Latent {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        match () {
            () if !self.motion.is_sound() || !all_sound(&self.features.0) => Err(Unfit::Number),
            () if self.round.term > MAX_TERM => Err(Unfit::Term),
            () if self.features.0.len() > MAX_FEATURES => Err(Unfit::Length),
            () if self.part.is_some() && !self.features.0.is_empty() => Err(Unfit::Length),
            () => self.part.as_ref().map_or(Ok(()), Part::check),
        }
    }
}

impl Body for MotorCommand {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        match () {
            () if !is_sound(self.velocity) => Err(Unfit::Number),
            () if self.valid_for > MAX_VALIDITY => Err(Unfit::Validity),
            () => Ok(()),
        }
    }
}
