//! Observations: what a robot's policy gets about its own robot at a step, in the policy frame.
//!
//! A policy of this crate reads the fields of an [`Observation`]. A policy from a file names the channels that it
//! takes, and gets their values as one array. The built-in channels are in `builtin.rs`, and a scenario adds its own
//! ([`Scenario::channels`](crate::scenario::Scenario::channels)).

pub mod bound;
pub mod builtin;
pub mod channel;

pub use bound::{Bound, ChannelError, Request};
pub use channel::{Channel, Frame, Known, Quantity, Unit};

use crate::messages::geometry::{Motion, Vec2};
use crate::time::Span;

/// Transformation between the world frame and the policy frame. A policy's inputs and outputs are given in the policy
/// frame, which is the world frame, possibly rotated by half a turn. Each transformation is its own inverse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolicyFrame {
    /// Identity: the policy frame is the world frame.
    World,
    /// Rotation by half a turn (180 degrees) about the origin of the world frame.
    HalfTurn,
}

impl PolicyFrame {
    /// Transforms a point \[m\] or a velocity \[m/s\] from the world frame to the policy frame, or back.
    pub fn turn(self, v: Vec2) -> Vec2 {
        match self {
            PolicyFrame::World => v,
            PolicyFrame::HalfTurn => -v,
        }
    }

    /// Transforms an angle \[rad\] from -pi to pi, counter-clockwise from the x axis, from the world frame to the
    /// policy frame, or back. The result is from -pi to pi.
    pub fn turn_angle(self, angle: f32) -> f32 {
        use std::f32::consts::PI;
        match self {
            PolicyFrame::World => angle,
            PolicyFrame::HalfTurn => angle + if angle > 0.0 { -PI } else { PI },
        }
    }

    /// Transforms position and velocity of a robot from the world frame to the policy frame, or back.
    pub(crate) fn turn_motion(self, motion: &Motion) -> Motion {
        Motion { position: self.turn(motion.position), velocity: self.turn(motion.velocity) }
    }
}

/// Reduces an angle \[rad\] by whole turns to the range from -pi to pi.
fn wrapped(angle: f32) -> f32 {
    crate::messages::geometry::wrapped(f64::from(angle)) as f32
}

/// Input of a policy about its own robot, in the policy frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation<'a> {
    /// Estimated position \[m\] and velocity \[m/s\] of the robot, in the policy frame (the world frame, possibly
    /// rotated by half a turn).
    pub motion: Motion,
    /// Position of the robot's goal \[m\], in the policy frame.
    pub goal: Vec2,
    /// How the robot follows the velocities that its policy commands.
    pub dynamics: Dynamics,
    /// Policy frame of the robot.
    pub frame: PolicyFrame,
    /// Heading of the robot \[rad\] in the policy frame, counter-clockwise from its x axis, as it was last measured;
    /// `None` if the readings of the robot have none.
    pub heading: Option<f32>,
    /// Yaw rate of the robot \[rad/s\], counter-clockwise, as it was last measured; `None` if the readings of the robot
    /// have none.
    pub yaw_rate: Option<f32>,
    /// Time since the robot's Agent heard that the episode runs.
    pub elapsed: Span,
    /// Values of the channels that the policy takes, one channel after the other in the policy's order. A value that is
    /// not known is NaN. Empty for a policy that takes no channel.
    pub values: &'a [f32],
}

impl Observation<'_> {
    /// Returns the observation of a robot without safety filter and without lag, at the start of an episode. Nothing
    /// else is known of it.
    pub fn new(motion: Motion, goal: Vec2) -> Observation<'static> {
        Observation {
            motion,
            goal,
            dynamics: Dynamics::default(),
            frame: PolicyFrame::World,
            heading: None,
            yaw_rate: None,
            elapsed: Span::ZERO,
            values: &[],
        }
    }
}

/// How a robot follows the velocities that its policy commands, as its team file says or its simulator knows it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Dynamics {
    /// Whether the safety filter may change the commands, so that the robot keeps its distance from others and walls.
    pub filtered: bool,
    /// Time constant of the first-order lag of the robot's velocity behind its commands \[s\].
    pub lag_s: f32,
    /// Distance of the commanded point ahead of the robot's axle \[m\]; zero for a holonomic drive, whose commanded
    /// point is its centre.
    pub point_ahead_m: f32,
}
