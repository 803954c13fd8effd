//! Messages between the actors of one host. They are never sent over a network. Units are SI.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::floats;
use super::geometry::{Motion, Vec2};
use super::ids::RobotId;
use super::wire::{Features, Phase, Round};
use crate::time::{Span, Time};

/// Inputs of a robot's policy at one control tick, sent from the robot's Cache (store of received messages) to its
/// Agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Percept {
    /// Number of the robot whose policy gets these inputs.
    pub(crate) robot: RobotId,
    /// Time at which the control tick was due, on this host's clock.
    pub due: Time,
    /// Estimated position \[m\] and velocity \[m/s\] of the robot in the world frame.
    pub estimate: Motion,
    /// Standard deviation of the estimated position along each axis \[m\]; 0 if unknown.
    pub(crate) deviation_m: f32,
    /// Heading \[rad\] of the robot's newest reading, world frame, counter-clockwise from the x axis; `None` if it has
    /// none.
    pub heading: Option<f32>,
    /// Yaw rate \[rad/s\] of the robot's newest reading, counter-clockwise; `None` if it has none.
    pub yaw_rate: Option<f32>,
    /// Newest messages of the neighbours, as far as the policy may still use them, in the order of robot ids.
    pub(crate) heard: Vec<NeighbourLatent>,
    /// Motions of other robots that take the place of those in their messages for avoidance, as a tracker measures
    /// them; in the order of robot ids, and several of one robot whose place is in doubt. Empty without a witness.
    pub(crate) measured: Vec<OtherRobot>,
    /// Newest values of each sense of the robot, in the order of the senses; empty in a team without senses.
    pub(crate) sensed: Vec<Option<Sensation>>,
}

impl Percept {
    /// Returns whether `measured` has the motion of this robot.
    pub(crate) fn measures(&self, robot: RobotId) -> bool {
        self.measured.binary_search_by_key(&robot, |other| other.robot).is_ok()
    }
}

/// Newest latent (policy message with the sender's motion) of one neighbour, as stored by a robot's Cache.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct NeighbourLatent {
    /// Number of the neighbour that sent the latent.
    pub(crate) robot: RobotId,
    /// Round, the number of the state server's instruction, in which the neighbour computed the latent.
    pub(crate) round: Round,
    /// Phase of the episode in which the neighbour computed the latent.
    pub(crate) phase: Phase,
    /// The neighbour's estimate of its own position and velocity when it sent the latent, or its measured ones where a
    /// tracker measures it for this host; world frame.
    pub(crate) motion: Motion,
    /// Numbers from the neighbour's policy, such as the encoder's output of a graph neural network.
    pub(crate) features: Features,
    /// Time since the latent arrived at this host.
    pub(crate) age: Span,
}

/// Distance beyond which two robots do not affect each other's safety \[m\].
pub(crate) const NEAR_M: f32 = 5.0;

/// Last known position and velocity of another robot. It is kept even if that robot is in another round or phase of the
/// episode, since the two may still collide.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OtherRobot {
    /// Number of the other robot.
    pub robot: RobotId,
    /// The other robot's last received estimate of its own position and velocity, or a measurement of them, world
    /// frame.
    pub motion: Motion,
    /// Time since the estimate arrived at this host.
    pub age: Span,
}

/// Whether a robot has reached its target: its start position during a reset, its goal while an episode runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Progress {
    /// The robot has not reached its target (start position in a reset, goal in an episode) yet.
    Underway,
    /// The robot has reached its target: its start position in a reset, its goal in an episode.
    Reached,
}

/// Output of the policy for one robot, sent from the robot's Agent to its Controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Action {
    /// Number of the robot that is to be driven.
    pub robot: RobotId,
    /// Round, the number of the state server's instruction, in which the action was computed.
    pub round: Round,
    /// Phase of the episode in which the action was computed.
    pub phase: Phase,
    /// Time at which the control tick of this action was due, on this host's clock.
    pub due: Time,
    /// Desired velocity \[m/s\] in the world frame, before the Controller limits it; NaN if the policy has diverged.
    /// `None` if the policy's step counts as none, because it has failed or was late: the robot stands for this tick.
    #[serde(with = "floats::optional_vec2")]
    pub velocity: Option<Vec2>,
    /// Estimated position and velocity of the robot in the world frame, from which the action was computed.
    pub estimate: Motion,
    /// Last known motions of the other robots that are within `NEAR_M` (5 m) of this robot; several of one robot whose
    /// place is in doubt.
    pub others: Vec<OtherRobot>,
    /// Whether the robot has reached its target: its start position in a reset, its goal in an episode.
    pub progress: Progress,
}

/// Digest of what the policy of a robot remembers after a step, which tells whether two runs have come to the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Remembered {
    /// Number of the robot.
    pub robot: RobotId,
    /// First 64 bits of the BLAKE3 hash of the numbers, as 32-bit floats in the order of the policy.
    pub digest: u64,
}

/// Newest values of one sense of a robot, as stored by the robot's Cache.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensation {
    /// Values in the unit of the sense; positive infinity stands for no echo.
    pub values: Features,
    /// Time since the values arrived at this host.
    pub age: Span,
}

/// True poses of all robots that a World knows, sent to the senses of the robots that it simulates.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Simulation time of the poses.
    pub time: Time,
    /// Whether a robot was just placed, so that what was seen before counts no longer.
    pub placed: bool,
    /// Index of the episode, from zero, whose obstacles stand.
    pub episode: u32,
    /// Time since the episode runs, by which moving obstacles are where they are; `None` while none runs.
    pub elapsed: Option<Span>,
    /// Poses of the robots, in the order of robot ids.
    pub robots: Arc<[Standing]>,
    /// Values of the sense `task` of all robots, in the order of robot ids; empty without it.
    pub observed: Arc<[f32]>,
}

/// True pose of one robot in a [`Scene`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// Number of the robot.
    pub robot: RobotId,
    /// Position of the robot's centre \[m\], world frame.
    pub centre: Vec2,
    /// Heading \[rad\], counter-clockwise from the x axis of the world frame.
    pub heading: f32,
}

/// Velocity command for one simulated robot, sent from the robot's Body to its World.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Number of the robot that is to be moved.
    pub robot: RobotId,
    /// Commanded velocity \[m/s\], world frame.
    pub velocity: Vec2,
    /// Time at which the World stops the robot if no later command arrives from its Body.
    pub until: Time,
}

/// Velocity and yaw rate of a robot in its own frame: x forward, y left, counter-clockwise rotation (REP-103).
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct BodyTwist {
    /// Speed forward \[m/s\], along the robot's heading; negative backward.
    pub forward: f32,
    /// Speed to the left of the robot's heading \[m/s\]; negative to the right.
    pub left: f32,
    /// Yaw rate \[rad/s\], counter-clockwise.
    pub yaw_rate: f32,
}

/// Contacts of a simulated robot during the last step of its World, the simulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Contacts {
    /// Whether the robot touched another robot. In a plant that blocks colliding moves: whether its move was blocked by
    /// another robot.
    pub robot: bool,
    /// Whether the robot touched a wall. In a plant that blocks colliding moves: whether its move was blocked by a
    /// wall.
    pub wall: bool,
}

/// True state of one simulated robot, sent from the World to the robot's Localizer, which makes readings of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Number of the robot.
    pub robot: RobotId,
    /// Simulation time of the state.
    pub time: Time,
    /// True position and velocity in the world frame.
    pub motion: Motion,
    /// True heading \[rad\], counter-clockwise from the x axis.
    pub heading: f32,
    /// True yaw rate \[rad/s\], counter-clockwise.
    pub yaw_rate: f32,
    /// Velocity \[m/s\], world frame, that the World was commanded to move the robot with; zero after the command has
    /// expired.
    pub command: Vec2,
    /// Contacts of the robot with other robots and walls in the last simulation step.
    pub contacts: Contacts,
}

/// True state of all robots of one World after a step, sent to the Recorder.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Simulation time of the states.
    pub time: Time,
    /// True states of the robots, in the order of robot ids.
    pub samples: Arc<[Sample]>,
}
