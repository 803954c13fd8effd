//! What stays between the actors of one host. Frames and units as in `wire`.

use std::sync::Arc;

use super::geometry::{Motion, Vec2};
use super::ids::RobotId;
use super::wire::{Features, Phase, Round};
use crate::time::{Span, Time};

/// What a robot knows at one tick of its agent: Cache to Agent.
#[derive(Clone, Debug, PartialEq)]
pub struct Percept {
    /// The robot.
    pub robot: RobotId,
    /// When the tick was due, on this host's clock.
    pub due: Time,
    /// Its own filtered estimate.
    pub estimate: Motion,
    /// Its usable neighbours, by robot id.
    pub heard: Vec<Heard>,
}

/// One neighbour's newest latent, as the Cache holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct Heard {
    /// The neighbour.
    pub robot: RobotId,
    /// The round that it acts in.
    pub round: Round,
    /// The phase that it acts in.
    pub phase: Phase,
    /// Its own estimate when it spoke.
    pub motion: Motion,
    /// Its policy's message.
    pub features: Features,
    /// Age since arrival here.
    pub age: Span,
}

/// Robots that are farther away than this are of no account to each other's safety \[m\].
pub const NEAR_M: f32 = 5.0;

/// Where another robot was last known to be, whatever it has said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Other {
    /// The other robot.
    pub robot: RobotId,
    /// Its own estimate then, world frame.
    pub motion: Motion,
    /// Age since arrival here.
    pub age: Span,
}

/// Whether a robot is where it is to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Not there yet.
    Underway,
    /// At its start when resetting, at its goal when running.
    Reached,
}

/// What the policy wants of one robot: Agent to Controller.
#[derive(Clone, Debug, PartialEq)]
pub struct Action {
    /// The robot.
    pub robot: RobotId,
    /// The round that it was computed in.
    pub round: Round,
    /// The phase that it was computed in.
    pub phase: Phase,
    /// When the tick was due that it comes of, on this host's clock.
    pub due: Time,
    /// Wanted velocity \[m/s\], world frame; not yet limited. NaN if the policy came apart.
    pub velocity: Vec2,
    /// The robot's own estimate for this step, world frame.
    pub estimate: Motion,
    /// The other robots within `NEAR_M` that are known of.
    pub others: Vec<Other>,
    /// Whether the robot is where it is to be.
    pub progress: Progress,
}

/// What a body asks of its world: Body to World.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// The robot.
    pub robot: RobotId,
    /// Commanded velocity \[m/s\], world frame.
    pub velocity: Vec2,
    /// When the world stops the robot by itself, should its body fall silent.
    pub until: Time,
}

/// What the world did with a robot in its last step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Contacts {
    /// A move was blocked by another robot.
    pub robot: bool,
    /// A move was blocked by a wall.
    pub wall: bool,
}

/// The true state of one robot: World to its Body, and to the Recorder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The robot.
    pub robot: RobotId,
    /// When.
    pub time: Time,
    /// True position and velocity.
    pub motion: Motion,
    /// True heading \[rad\], counter-clockwise from the x axis.
    pub heading: f32,
    /// True yaw rate \[rad/s\], counter-clockwise.
    pub yaw_rate: f32,
    /// The velocity that the world was told to drive it at \[m/s\]: zero once a command has lapsed.
    pub command: Vec2,
    /// What got in its way.
    pub contacts: Contacts,
}

/// The true state of all robots of one world after a step: World to Recorder.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// When.
    pub time: Time,
    /// By robot id.
    pub samples: Arc<[Sample]>,
}
