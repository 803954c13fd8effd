//! Probes: inputs and outputs that the exporter of a policy stored in its file. When a policy file is loaded, a network
//! that computes other outputs is refused. Two networks of equal shapes can differ, for example by their activation.

use std::sync::Arc;

use super::file::PolicyFile;
use super::gnn::{Gnn, GnnWeights};
use super::weights::{Probe, WeightsError};
use super::{Draw, Neighbour, Policy};
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::ids::RobotId;
use crate::observation::Observation;
use crate::time::Span;

/// Largest differences between the test data (probe) of a policy file and the numbers that the loaded network computes.
/// Each difference is divided by the magnitude of the stored number if that is above 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Number of robots in the test data.
    pub robots: usize,
    /// Largest difference of a feature of a latent, the message that a robot broadcasts.
    pub latent: f32,
    /// Largest difference of a raw output of the network, a parameter of the velocity's distribution.
    pub output: f32,
}

impl Probe {
    /// Largest relative difference between a stored and a computed number that is accepted. Sums of 32-bit floats in
    /// another order differ by less.
    pub const TOLERANCE: f32 = 1e-4;

    /// Runs `network` on the inputs of this test data and returns the largest differences of its latents and outputs
    /// from the correct ones, which the test data contain.
    pub(crate) fn compare(&self, network: &Arc<GnnWeights>) -> Difference {
        let robots = self.position.len() / 2;
        let at = |floats: &[f32], robot: usize| Vec2::new(floats[2 * robot], floats[2 * robot + 1]);
        let own: Vec<Observation> =
            (0..robots).map(|robot| Observation::new(self.motion(robot), at(&self.goal, robot))).collect();
        let mut policy = Gnn::new(Arc::clone(network), Draw::Mean, RobotId(0));
        let mut latents = vec![vec![0.0; network.interface().features]; robots];
        for (robot, (own, latent)) in own.iter().zip(&mut latents).enumerate() {
            let observation = self.observation.as_ref().map(|all| &all[robot * (all.len() / robots)..]);
            let memory = &self.memory[robot * (self.memory.len() / robots)..];
            policy.encode_probed(own, observation, memory, latent);
        }
        for hop in 1..policy.hops() {
            let before = latents.clone();
            for (robot, latent) in latents.iter_mut().enumerate() {
                policy.relay(hop, &own[robot], latent, &self.neighbours(robot, &before));
            }
        }
        let mut outputs = Vec::new();
        for robot in 0..robots {
            outputs.extend(policy.outputs(&own[robot], &latents[robot], &self.neighbours(robot, &latents)));
        }
        Difference { robots, latent: largest(&latents.concat(), &self.latent), output: largest(&outputs, &self.output) }
    }

    fn motion(&self, robot: usize) -> Motion {
        let at = |floats: &[f32]| Vec2::new(floats[2 * robot], floats[2 * robot + 1]);
        Motion { position: at(&self.position), velocity: at(&self.velocity) }
    }

    /// Returns the messages that a robot has received, in the order of the senders.
    fn neighbours<'a>(&self, robot: usize, latents: &'a [Vec<f32>]) -> Vec<Neighbour<'a>> {
        let robots = latents.len();
        let heard = |other: &usize| *other != robot && self.heard[robot * robots + other];
        let neighbour = |other: usize| Neighbour {
            motion: self.motion(other),
            features: &latents[other],
            age: Span::from_secs(f64::from(self.age_s[robot * robots + other])),
        };
        (0..robots).filter(heard).map(neighbour).collect()
    }

    /// Runs `network` on the inputs of this test data and compares its latents and outputs with the correct ones, which
    /// the test data contain. Returns the largest differences, or an error if one exceeds `TOLERANCE` or is NaN.
    pub fn check(&self, network: &Arc<GnnWeights>) -> Result<Difference, WeightsError> {
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
pub fn network(mut file: PolicyFile) -> Result<(Arc<GnnWeights>, Option<Difference>), WeightsError> {
    let probe = file.probe.take();
    let network = Arc::new(GnnWeights::new(file));
    let difference = probe.map(|probe| probe.check(&network)).transpose()?;
    Ok((network, difference))
}

/// Returns the largest difference between the numbers of `found` and those of `stored` at the same index. Each is
/// divided by the magnitude of the stored number if that is above 1. The result is NaN if a difference is NaN.
fn largest(found: &[f32], stored: &[f32]) -> f32 {
    let off = |(found, stored): (&f32, &f32)| (found - stored).abs() / stored.abs().max(1.0);
    found
        .iter()
        .zip(stored)
        .map(off)
        .fold(0.0, |most: f32, off: f32| if most.is_nan() || off <= most { most } else { off })
}
