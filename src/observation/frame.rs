//! Frames of what a policy observes and commands.

use serde::{Deserialize, Serialize};

use crate::messages::geometry::{Motion, Vec2};

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
    #[inline]
    pub fn turn(self, v: Vec2) -> Vec2 {
        match self {
            PolicyFrame::World => v,
            PolicyFrame::HalfTurn => -v,
        }
    }

    /// Transforms an angle \[rad\] from -pi to pi, counter-clockwise from the x axis, from the world frame to the
    /// policy frame, or back. The result is from -pi to pi.
    #[inline]
    pub fn turn_angle(self, angle: f32) -> f32 {
        use std::f32::consts::PI;
        match self {
            PolicyFrame::World => angle,
            PolicyFrame::HalfTurn => angle + if angle > 0.0 { -PI } else { PI },
        }
    }

    /// Transforms position and velocity of a robot from the world frame to the policy frame, or back.
    #[inline]
    pub fn turn_motion(self, motion: &Motion) -> Motion {
        Motion { position: self.turn(motion.position), velocity: self.turn(motion.velocity) }
    }
}

/// Frame in which a policy takes a channel's values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Frame {
    /// The policy frame of the scenario: the world frame, possibly rotated by half a turn.
    #[default]
    Policy,
    /// The world frame.
    World,
    /// The robot's own frame: x ahead, y to the left, and points relative to the robot's position.
    Body,
}
