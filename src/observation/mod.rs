//! Observations: what a robot's policy gets about its own robot at a step, in the policy frame.
//!
//! A policy of this crate reads the fields of an [`Observation`]. A policy from a file names the channels that it
//! takes, and gets their values as one array. The built-in channels are in `builtin.rs`, and a scenario adds its own
//! ([`Scenario::channels`](crate::scenario::Scenario::channels)), as does each sense of the team (`sense.rs`,
//! `taken.rs`).

pub mod bound;
pub mod builtin;
pub mod channel;
pub mod frame;
pub mod observed;
pub mod sense;
mod taken;

pub use bound::{Bound, ChannelError, Request};
pub use channel::{Channel, Known, Quantity, Unit};
pub use frame::{Frame, PolicyFrame};
pub use observed::Observed;
pub use sense::{IfStale, Miss, NamedMiss, Sweep, Taking};

use crate::messages::geometry::{Motion, Pose, Vec2, rotated};
use crate::time::Span;

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
    #[inline]
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

    /// Returns the observation of a robot with this policy frame and this goal \[m\], whose estimated state is
    /// `estimate`; goal and estimate are in the world frame.
    #[inline]
    pub fn in_frame(frame: PolicyFrame, goal: Vec2, estimate: &Motion) -> Observation<'static> {
        Observation { frame, ..Observation::new(frame.turn_motion(estimate), frame.turn(goal)) }
    }

    /// Transforms a direction from the policy frame into `frame`. It is NaN in the robot's own frame if the heading is
    /// not known.
    pub fn into_frame(&self, frame: Frame, direction: Vec2) -> Vec2 {
        let pose = Pose { position: self.motion.position, heading: self.heading };
        match frame {
            Frame::Policy => direction,
            Frame::World => self.frame.turn(direction),
            Frame::Body => pose.in_body_frame(direction).unwrap_or(Vec2::repeat(f32::NAN)),
        }
    }

    /// Transforms a direction from `frame` into the policy frame; the inverse of [`Observation::into_frame`].
    pub fn out_of_frame(&self, frame: Frame, direction: Vec2) -> Vec2 {
        match frame {
            Frame::Policy => direction,
            Frame::World => self.frame.turn(direction),
            Frame::Body => {
                let heading = self.heading.unwrap_or(f32::NAN);
                let (x, y) = rotated(f64::from(heading), f64::from(direction.x), f64::from(direction.y));
                Vec2::new(x as f32, y as f32)
            }
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
