//! Neighbours of a robot at a step of its Agent: senders in its percept, and other robots of the same Agent.

use crate::hearing::CommRange;
use crate::messages::geometry::Motion;
use crate::messages::ids::RobotId;
use crate::messages::local::{NeighbourLatent, Percept};
use crate::messages::wire::{Phase, Round};
use crate::observation::PolicyFrame;
use crate::policy::Neighbour;
use crate::random::Stream;
use crate::time::Span;

/// Data of one robot that the other robots of its Agent read in the current step. Small and contiguous, because each
/// robot reads it for all robots nearby.
#[derive(Clone, Copy)]
pub(super) struct SharedData {
    /// Id of the robot.
    pub robot: RobotId,
    /// Estimate of the robot's position \[m\] and velocity \[m/s\] in the world frame.
    pub motion: Motion,
    /// The estimate in the step that has made the features, which is what the robot says of itself.
    pub said: Motion,
    /// Start and end of the robot's latent features within the list of all latents of the Agent's current step; `None`
    /// if the robot broadcasts nothing.
    pub features: Option<[u32; 2]>,
    /// Time since the step in which the features were computed; zero if that is the current one.
    pub age: Span,
}

/// Data of an Agent's current step that decide which messages the policy of one robot gets.
pub(super) struct Step<'a> {
    /// Communication range within which the robot hears the others of its Agent.
    pub range: CommRange,
    /// Round that the Agent follows; messages that were sent in another round are not used.
    pub round: Round,
    /// Phase of the episode that the Agent follows; messages that were sent in another phase are not used.
    pub phase: Phase,
    /// Number of floats in a latent of the policy; messages of another length are not used.
    pub width: usize,
    /// Age up to which messages of the others of the Agent are used.
    pub hold: Span,
    /// Policy frame of the robot, into which neighbours' motions are rotated.
    pub frame: PolicyFrame,
    /// Latent features of the Agent's robots, one after the other.
    pub shared: &'a [f32],
}

impl<'a> Step<'a> {
    /// Returns the neighbours of the robot with this percept, in the order of their ids: the senders of usable messages
    /// in its percept, and those of `companions`, robots of the same Agent, that are within the communication range. A
    /// random range is drawn from `ranges`.
    pub fn neighbours(
        &self,
        percept: &'a Percept,
        companions: impl Iterator<Item = SharedData>,
        ranges: &mut Stream,
    ) -> Vec<Neighbour<'a>> {
        let Step { range, round, phase, width, hold, frame, shared } = *self;
        let usable =
            |heard: &&NeighbourLatent| heard.round == round && heard.phase == phase && heard.features.0.len() == width;
        let cached = percept.heard.iter().filter(usable).map(|heard| {
            (
                heard.robot,
                Neighbour { motion: frame.turn_motion(&heard.motion), features: &heard.features.0, age: heard.age },
            )
        });
        let own = percept.estimate;
        let joint = companions.filter(|other| other.age <= hold).filter_map(|other| {
            let [begins, ends] = other.features?.map(|at| at as usize);
            range.admits(own.position, other.said.position, ranges).then(|| {
                let motion = frame.turn_motion(&other.said);
                (other.robot, Neighbour { motion, features: &shared[begins..ends], age: other.age })
            })
        });
        let mut neighbours: Vec<(RobotId, Neighbour)> = cached.chain(joint).collect();
        neighbours.sort_by_key(|(robot, _)| *robot);
        neighbours.into_iter().map(|(_, neighbour)| neighbour).collect()
    }
}
