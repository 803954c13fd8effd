//! Comparison of a network of several hops with the inputs and outputs that its exporter stored in the file.

use std::sync::Arc;

use super::file::{PolicyFile, TeamProbe};
use super::network::{Hops, HopsWeights};
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::ids::RobotId;
use crate::observation::Observation;
use crate::policy::probe::{Difference, largest};
use crate::policy::weights::{Probe, WeightsError};
use crate::policy::{Draw, Neighbour, Policy};
use crate::time::Span;

impl TeamProbe {
    /// Runs `network` on the inputs of these test data and returns the largest differences of its latents and outputs
    /// from the correct ones.
    pub(crate) fn compare(&self, network: &Arc<HopsWeights>) -> Difference {
        let team = &self.team;
        let at = |floats: &[f32], robot: usize| Vec2::new(floats[2 * robot], floats[2 * robot + 1]);
        let robots = team.position.len() / 2;
        let motion = |robot| Motion { position: at(&team.position, robot), velocity: at(&team.velocity, robot) };
        let own: Vec<Observation> =
            (0..robots).map(|robot| Observation::new(motion(robot), at(&team.goal, robot))).collect();
        let mut policy = Hops::new(Arc::clone(network), Draw::Mean, RobotId(0));
        let mut latents = vec![vec![0.0; network.interface().features]; robots];
        for (robot, (own, latent)) in own.iter().zip(&mut latents).enumerate() {
            let observation = self.observation.as_ref().map(|all| &all[robot * (all.len() / robots)..]);
            let memory = &self.memory[robot * (self.memory.len() / robots)..];
            policy.encode_probed(own, observation, memory, latent);
        }
        for hop in 1..policy.hops() {
            let before = latents.clone();
            for (robot, latent) in latents.iter_mut().enumerate() {
                policy.relay(hop, &own[robot], latent, &self.neighbours(robot, &motion, &before));
            }
        }
        let mut outputs = Vec::new();
        for robot in 0..robots {
            let neighbours = self.neighbours(robot, &motion, &latents);
            outputs.extend(policy.outputs(&own[robot], &latents[robot], &neighbours));
        }
        Difference { robots, latent: largest(&latents.concat(), &team.latent), output: largest(&outputs, &team.output) }
    }

    /// Returns the messages that a robot has received, in the order of the senders.
    fn neighbours<'a>(
        &self,
        robot: usize,
        motion: &dyn Fn(usize) -> Motion,
        latents: &'a [Vec<f32>],
    ) -> Vec<Neighbour<'a>> {
        let robots = latents.len();
        let heard = |other: &usize| *other != robot && self.heard[robot * robots + other];
        let neighbour = |other: usize| Neighbour {
            motion: motion(other),
            features: &latents[other],
            age: Span::from_secs(f64::from(self.team.age_s[robot * robots + other])),
        };
        (0..robots).filter(heard).map(neighbour).collect()
    }

    /// Runs `network` on the inputs of these test data and compares its latents and outputs with the correct ones.
    /// Returns the largest differences, or an error if one exceeds `Probe::TOLERANCE` or is NaN.
    pub fn check(&self, network: &Arc<HopsWeights>) -> Result<Difference, WeightsError> {
        let difference = self.compare(network);
        for (what, difference) in [("latents", difference.latent), ("outputs", difference.output)] {
            if difference.is_nan() || difference > Probe::TOLERANCE {
                return Err(WeightsError::Probe { what, difference, tolerance: Probe::TOLERANCE });
            }
        }
        Ok(difference)
    }
}

/// Makes the network of a checked policy file and compares its outputs with the file's test data (probe). The second
/// value has the differences found; it is `None` if the file has no test data.
///
/// # Errors
/// If the network's outputs differ from the correct ones of the test data by more than `Probe::TOLERANCE`.
pub fn network(mut file: PolicyFile) -> Result<(Arc<HopsWeights>, Option<Difference>), WeightsError> {
    let probe = file.probe.take();
    let network = Arc::new(HopsWeights::new(file));
    let difference = probe.map(|probe| probe.check(&network)).transpose()?;
    Ok((network, difference))
}
