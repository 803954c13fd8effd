//! A policy of several hops with its weights, and its evaluation for one robot.

use std::sync::Arc;

use super::action::Action;
use super::file::PolicyFile;
use super::hop::{Hop, Space};
use super::manifest::{Deviation, Distribution, Manifest, OUTPUTS};
use super::perceptron::{Buffers, Perceptron};
use crate::messages::geometry::{Planar, Vec2};
use crate::observation::Observation;
use crate::policy::flock::accelerated;
use crate::policy::mlp::Instructions;
use crate::policy::{Draw, Interface, Neighbour, Policy};
use crate::random::{self, Stream};
use crate::time::Span;

/// Weights and parameters of a policy of several hops, which all robots of a team share.
#[derive(Debug)]
pub struct HopsWeights {
    /// Manifest of the policy file.
    pub(super) manifest: Manifest,
    /// Digest of the policy file: the first 64 bits of its BLAKE3 hash, in hexadecimal.
    pub(super) digest: String,
    /// Network that turns an observation into the input of the first hop.
    pub(super) encoder: Perceptron,
    /// Hops of the policy in the order in which they are computed.
    pub(super) hops: Vec<Hop>,
    /// Network that turns the output of the last hop into the parameters of the action.
    pub(super) decoder: Perceptron,
    interface: Interface,
}

impl HopsWeights {
    /// Makes the network of a policy file that was read and checked. The file's test data are not compared with the
    /// network; `probe::network` does that.
    pub fn new(file: PolicyFile) -> HopsWeights {
        let PolicyFile { manifest, digest, encoder, hops, decoder, .. } = file;
        let interface = Interface {
            features: manifest.latent(),
            radius_m: manifest.radius_m,
            period: Span::from_secs(1.0 / manifest.rate_hz),
            limit_m_s: manifest.limit_m_s,
            hold: Span::from_secs(manifest.hold_s),
        };
        HopsWeights { manifest, digest, encoder, hops, decoder, interface }
    }

    /// Returns the parameters that the rest of the system needs to run the network, such as message size and period.
    pub fn interface(&self) -> Interface {
        self.interface
    }

    /// Returns the manifest of the network's policy file.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Returns the digest of the network's policy file: the first 64 bits of its BLAKE3 hash, in hexadecimal.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Returns the number of weights and biases of all networks.
    pub fn parameters(&self) -> usize {
        let hops: usize = self.hops.iter().map(Hop::parameters).sum();
        self.encoder.parameters() + hops + self.decoder.parameters()
    }
}

/// One robot's instance of a policy of several hops, with buffers of its own.
#[derive(Debug)]
pub(crate) struct Hops {
    network: Arc<HopsWeights>,
    draw: Draw,
    instructions: Instructions,
    observation: Vec<f32>,
    /// Output of the last hop.
    last: Vec<f32>,
    buffers: Buffers,
    /// Buffers of each hop.
    spaces: Vec<Space>,
}

impl Hops {
    /// Makes one robot's instance of `network`, which draws actions from the output distribution by the method `draw`.
    pub(crate) fn new(network: Arc<HopsWeights>, draw: Draw) -> Hops {
        Hops::with_instructions(network, draw, Instructions::Detected)
    }

    /// Makes one robot's instance of `network` that runs on the given processor instructions; `draw` is the method of
    /// drawing actions. The instruction set changes the speed, and results are the same bit for bit.
    pub(crate) fn with_instructions(network: Arc<HopsWeights>, draw: Draw, instructions: Instructions) -> Hops {
        let mut buffers = Buffers::default();
        buffers.reserve(&network.encoder, 1);
        buffers.reserve(&network.decoder, 1);
        Hops {
            observation: vec![0.0; network.encoder.inputs()],
            last: vec![0.0; network.decoder.inputs()],
            buffers,
            spaces: network.hops.iter().map(|_| Space::default()).collect(),
            network,
            draw,
            instructions,
        }
    }

    /// Returns the decoder's raw outputs, the parameters of the distribution of a velocity in the policy frame: mean_x,
    /// mean_y, and a parameter of each standard deviation. The manifest's limit `log_std_max` is not applied.
    ///
    /// `own` is the robot's observation, `features` its own latent, which holds the inputs of all hops, and
    /// `neighbours` are the neighbours' messages in use.
    pub(crate) fn outputs(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour]) -> [f32; OUTPUTS] {
        let at = self.network.hops.len() - 1;
        let (network, space) = (&*self.network, &mut self.spaces[at]);
        let hop = &network.hops[at];
        hop.reserve(space, neighbours.len());
        let (last, buffers, mut out) = (&mut self.last, &mut self.buffers, [0.0; OUTPUTS]);
        self.instructions.run(
            #[inline(always)]
            || {
                hop.apply(&own.motion, features, neighbours, space, last);
                network.decoder.apply(1, last, &mut out, buffers);
            },
        );
        out
    }
}

impl Policy for Hops {
    fn interface(&self) -> Interface {
        self.network.interface
    }

    fn hops(&self) -> usize {
        self.network.hops.len()
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        let (network, observation, buffers) = (&*self.network, &mut self.observation, &mut self.buffers);
        for (entry, field) in observation.chunks_exact_mut(2).zip(&network.manifest.observation) {
            entry.copy_from_slice(&field.of(own).to_array());
        }
        let (first, later) = features.split_at_mut(network.encoder.outputs());
        later.fill(0.0);
        self.instructions.run(
            #[inline(always)]
            || network.encoder.apply(1, observation, first, buffers),
        );
    }

    fn relay(&mut self, hop: usize, own: &Observation, features: &mut [f32], neighbours: &[Neighbour]) {
        let (network, space) = (&*self.network, &mut self.spaces[hop - 1]);
        let before = &network.hops[hop - 1];
        before.reserve(space, neighbours.len());
        let (inputs, rest) = features.split_at_mut(network.hops[hop].begins());
        let out = &mut rest[..before.outputs()];
        self.instructions.run(
            #[inline(always)]
            || before.apply(&own.motion, inputs, neighbours, space, out),
        );
    }

    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2 {
        let outputs = self.outputs(own, features, neighbours);
        let HopsWeights { manifest, interface, .. } = &*self.network;
        let normal = match self.draw {
            Draw::Mean => Vec2::new(outputs[0], outputs[1]),
            Draw::Sample => {
                let [x, y] = random::normals(stream);
                let drawn = |mean: f32, parameter: f32, unit: f64| mean + unit as f32 * deviation(manifest, parameter);
                Vec2::new(drawn(outputs[0], outputs[2], x), drawn(outputs[1], outputs[3], y))
            }
        };
        if manifest.action == Action::Acceleration {
            return accelerated(own.motion.velocity, normal, interface.period);
        }
        match manifest.distribution {
            Distribution::DiagonalNormal => normal,
            Distribution::TanhNormal => normal.map(|axis| manifest.limit_m_s * libm::tanhf(axis)),
        }
    }
}

/// Returns the standard deviation for the decoder's output `parameter`.
fn deviation(manifest: &Manifest, parameter: f32) -> f32 {
    match manifest.deviation {
        Deviation::Log => libm::expf(manifest.log_std_max.map_or(parameter, |max| parameter.min(max))),
        Deviation::BiasedSoftplus => {
            /// Smallest standard deviation.
            const LEAST: f32 = 0.01;
            // softplus(shift) = 1 - LEAST, so that an output of zero gives a deviation of one.
            let shift = libm::logf(libm::expm1f(1.0 - LEAST));
            softplus(parameter + shift) + LEAST
        }
    }
}

/// Returns ln(1 + exp(x)), without overflow.
fn softplus(x: f32) -> f32 {
    x.max(0.0) + libm::log1pf(libm::expf(-x.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::policy::hops::file;
    use crate::random::Seed;

    /// Network with these raw outputs, whatever its inputs are.
    fn constant(distribution: &str, deviation: &str, outputs: [f32; OUTPUTS]) -> Arc<HopsWeights> {
        let manifest = serde_json::json!({
            "format": 2, "scenario": "passage", "observation": ["position"], "encoder": {"widths": [2, 1]},
            "hops": [{"aggregation": "sum"}], "decoder": {"widths": [1, 4]}, "distribution": distribution,
            "deviation": deviation, "draw": "mean", "radius_m": 2.0, "rate_hz": 20.0, "limit_m_s": 1.5,
            "hold_s": 0.2, "sha256": ""
        });
        let manifest: Manifest = serde_json::from_value(manifest).expect("it is a manifest");
        let tensors = vec![vec![(vec![1.0, 1.0], vec![0.0])], vec![(vec![0.0; 4], outputs.to_vec())]];
        Arc::new(HopsWeights::new(file::read(&file::write(&manifest, &tensors)).expect("it is sound")))
    }

    fn action(network: &Arc<HopsWeights>, draw: Draw) -> Vec2 {
        let own = Observation::new(Motion::default(), Vec2::zeros());
        Hops::new(Arc::clone(network), draw).act(&own, &[0.0], &[], &mut Seed::of_run(1).stream("draw"))
    }

    #[test]
    fn a_tanh_normal_is_the_limit_times_the_tangent_of_its_normal() {
        let raw = [0.5, -2.0, -0.3, 0.2];
        for draw in [Draw::Mean, Draw::Sample] {
            let normal = action(&constant("diagonal-normal", "log", raw), draw);
            let squashed = action(&constant("tanh-normal", "log", raw), draw);
            assert_eq!(squashed, normal.map(|axis| 1.5 * libm::tanhf(axis)));
        }
        assert_eq!(action(&constant("diagonal-normal", "log", raw), Draw::Mean), Vec2::new(0.5, -2.0));
    }

    #[test]
    fn an_acceleration_changes_the_measured_velocity_within_its_limit() {
        let mut network =
            Arc::into_inner(constant("diagonal-normal", "log", [0.4, -7.0, 0.0, 0.0])).expect("it is new");
        network.manifest.action = Action::Acceleration;
        let motion = Motion { position: Vec2::zeros(), velocity: Vec2::new(0.5, 0.5) };
        let own = Observation::new(motion, Vec2::zeros());
        let mut policy = Hops::new(Arc::new(network), Draw::Mean);
        let velocity = policy.act(&own, &[0.0], &[], &mut Seed::of_run(1).stream("draw"));
        assert!((velocity - Vec2::new(0.52, 0.45)).norm() < 1e-6, "{velocity:?}");
    }

    #[test]
    fn deviations_are_exponentials_or_a_softplus_that_is_one_at_zero() {
        let deviation = |kind: &str, x: f32| super::deviation(constant("tanh-normal", kind, [0.0; 4]).manifest(), x);
        assert!((deviation("log", 0.5) - 0.5f64.exp() as f32).abs() < 1e-6);
        assert!((deviation("biased-softplus", 0.0) - 1.0).abs() < 1e-6);
        // The formula of TorchRL, in 64 bits.
        let formula = |x: f64| (x + 0.99f64.exp_m1().ln()).exp().ln_1p() + 0.01;
        for x in [-3.0, 2.0, 50.0] {
            assert!((f64::from(deviation("biased-softplus", x as f32)) - formula(x)).abs() < 1e-4, "{x}");
        }
    }
}
