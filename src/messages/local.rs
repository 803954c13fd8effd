//! Messages between the actors of one host. Frames and units as in `wire`.

use std::sync::Arc;

use super::geometry::{Motion, Vec2};
use super::ids::RobotId;
use super::wire::{Features, Phase, Round};
use crate::time::{Span, Time};

/// Inputs of a robot's policy at one tick of its agent: Cache to Agent.
#[derive(Clone, Debug, PartialEq)]
pub struct Percept {
    /// The robot.
    pub robot: RobotId,
    /// Time at which the tick was due, on this host's clock.
    pub due: Time,
    /// Its own filtered estimate.
    pub estimate: Motion,
    /// Standard deviation of the estimated position along each axis \[m\]; 0 if unknown.
    pub deviation_m: f32,
    /// Its usable neighbours, by robot id.
    pub heard: Vec<NeighbourLatent>,
}

/// Newest latent of one neighbour, as held by the Cache.
#[derive(Clone, Debug, PartialEq)]
pub struct NeighbourLatent {
    /// The neighbour.
    pub robot: RobotId,
    /// Round in which it was computed.
    pub round: Round,
    /// Phase in which it was computed.
    pub phase: Phase,
    /// The neighbour's own estimate when it was sent.
    pub motion: Motion,
    /// Message of its policy.
    pub features: Features,
    /// Age since arrival on this host.
    pub age: Span,
}

/// Distance beyond which two robots do not affect each other's safety \[m\].
pub const NEAR_M: f32 = 5.0;

/// Last known position and velocity of another robot, whatever round and phase it is in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OtherRobot {
    /// The other robot.
    pub robot: RobotId,
    /// Its own estimate at that time, world frame.
    pub motion: Motion,
    /// Age since arrival on this host.
    pub age: Span,
}

/// Whether a robot has reached its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Not reached yet.
    Underway,
    /// At its start when resetting, at its goal when running.
    Reached,
}

/// Output of the policy for one robot: Agent to Controller.
#[derive(Clone, Debug, PartialEq)]
pub struct Action {
    /// The robot.
    pub robot: RobotId,
    /// Round in which it was computed.
    pub round: Round,
    /// Phase in which it was computed.
    pub phase: Phase,
    /// Time at which its tick was due, on this host's clock.
    pub due: Time,
    /// Desired velocity \[m/s\], world frame; not yet limited. NaN if the policy has diverged.
    pub velocity: Vec2,
    /// The robot's own estimate for this step, world frame.
    pub estimate: Motion,
    /// Other known robots within `NEAR_M`.
    pub others: Vec<OtherRobot>,
    /// Whether the robot has reached its target.
    pub progress: Progress,
}

/// Command of a body to its world: Body to World.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// The robot.
    pub robot: RobotId,
    /// Commanded velocity \[m/s\], world frame.
    pub velocity: Vec2,
    /// Time at which the world stops the robot, should its body send nothing more.
    pub until: Time,
}

/// Motion of a robot in its own frame (REP-103).
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct BodyTwist {
    /// Speed ahead \[m/s\].
    pub forward: f32,
    /// Speed to the left \[m/s\].
    pub left: f32,
    /// Yaw rate \[rad/s\], counter-clockwise.
    pub yaw_rate: f32,
}

/// Contacts of a robot in the last step of its world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Contacts {
    /// A move was blocked by another robot.
    pub robot: bool,
    /// A move was blocked by a wall.
    pub wall: bool,
}

/// True state of one robot: World to its Body, and to the Recorder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The robot.
    pub robot: RobotId,
    /// Time of the state.
    pub time: Time,
    /// True position and velocity.
    pub motion: Motion,
    /// True heading \[rad\], counter-clockwise from the x axis.
    pub heading: f32,
    /// True yaw rate \[rad/s\], counter-clockwise.
    pub yaw_rate: f32,
    /// Velocity that the world was commanded to drive it at \[m/s\]: zero once a command has lapsed.
    pub command: Vec2,
    /// Contacts in the last step.
    pub contacts: Contacts,
}

/// True state of all robots of one world after a step: World to Recorder.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Time of the state.
    pub time: Time,
    /// By robot id.
    pub samples: Arc<[Sample]>,
}
