//! A policy of several hops with its weights, and its evaluation for one robot.

use std::sync::Arc;

use super::action::Action;
use super::entry;
use super::file::PolicyFile;
use super::gru::Gru;
use super::hop::{Hop, Space};
use super::manifest::{Deviation, Distribution, Manifest, OUTPUTS};
use super::perceptron::{Buffers, Perceptron};
use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::observation::{Observation, Request};
use crate::policy::failures::Failures;
use crate::policy::flock::accelerated;
use crate::policy::mlp::Instructions;
use crate::policy::{Broadcast, Draw, Interface, Neighbour, Policy};
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
    /// State between the encoder and the first hop; `None` for a policy without state.
    pub(super) memory: Option<Gru>,
    /// Hops of the policy in the order in which they are computed.
    pub(super) hops: Vec<Hop>,
    /// Network that turns the output of the last hop into the parameters of the action.
    pub(super) decoder: Perceptron,
    interface: Interface,
    requests: Vec<Request>,
}

impl HopsWeights {
    /// Makes the network of a policy file that was read and checked. The file's test data are not compared with the
    /// network; `probe::network` does that.
    pub fn new(file: PolicyFile) -> HopsWeights {
        let PolicyFile { manifest, digest, encoder, memory, hops, decoder, .. } = file;
        let interface = Interface {
            features: manifest.latent(),
            radius_m: manifest.radius_m,
            period: Span::from_secs(1.0 / manifest.rate_hz),
            limit_m_s: manifest.limit_m_s,
            hold: Span::from_secs(manifest.hold_s),
        };
        let requests = entry::requests(&manifest.observation);
        HopsWeights { manifest, digest, encoder, memory, hops, decoder, interface, requests }
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

    /// Returns the number of floats of the first hop's input.
    fn first(&self) -> usize {
        self.memory.as_ref().map_or(self.encoder.outputs(), Gru::floats)
    }

    /// Returns the channels that the policy takes, in the order in which it gets their values.
    pub fn requests(&self) -> &[Request] {
        &self.requests
    }

    /// Returns the number of weights and biases of all networks.
    pub fn parameters(&self) -> usize {
        let hops: usize = self.hops.iter().map(Hop::parameters).sum();
        self.encoder.parameters() + self.memory.as_ref().map_or(0, Gru::parameters) + hops + self.decoder.parameters()
    }
}

/// What a robot remembers from one step to the next; all is empty for a policy without state.
#[derive(Debug, Default)]
struct State {
    /// State after the last step.
    now: Vec<f32>,
    /// State before the last step.
    before: Vec<f32>,
    /// Output of the encoder.
    encoded: Vec<f32>,
    /// Buffer of the cell.
    gates: Vec<f32>,
}

impl State {
    /// Returns the state at the start, of a policy whose encoder has `encoded` outputs.
    fn new(memory: Option<&Gru>, encoded: usize) -> State {
        let Some(gru) = memory else { return State::default() };
        let zeros = |floats: usize| vec![0.0; floats];
        let [now, before, gates] = [1, 1, 6].map(|times| zeros(times * gru.floats()));
        State { now, before, encoded: zeros(encoded), gates }
    }
}

/// One robot's instance of a policy of several hops, with buffers of its own.
#[derive(Debug)]
pub(crate) struct Hops {
    network: Arc<HopsWeights>,
    draw: Draw,
    instructions: Instructions,
    observation: Vec<f32>,
    state: State,
    /// Whether the present step counts as none: a value of a channel is not known.
    fails: bool,
    failures: Failures,
    /// Output of the last hop.
    last: Vec<f32>,
    buffers: Buffers,
    /// Buffers of each hop.
    spaces: Vec<Space>,
}

impl Hops {
    /// Makes the instance of `robot` of `network`, which draws actions from the output distribution by the method
    /// `draw`.
    pub(crate) fn new(network: Arc<HopsWeights>, draw: Draw, robot: RobotId) -> Hops {
        let mut buffers = Buffers::default();
        buffers.reserve(&network.encoder, 1);
        buffers.reserve(&network.decoder, 1);
        Hops {
            observation: vec![0.0; network.encoder.inputs()],
            state: State::new(network.memory.as_ref(), network.encoder.outputs()),
            fails: false,
            failures: Failures::new(robot),
            last: vec![0.0; network.decoder.inputs()],
            buffers,
            spaces: network.hops.iter().map(|_| Space::default()).collect(),
            network,
            draw,
            instructions: Instructions::Detected,
        }
    }

    /// Computes the input of the first hop from the observation, and the state after the step with it, and writes it
    /// into `features`, whose inputs of later hops become zero.
    fn encode_observed(&mut self, features: &mut [f32]) {
        let (network, state, buffers) = (&*self.network, &mut self.state, &mut self.buffers);
        let (first, later) = features.split_at_mut(network.first());
        later.fill(0.0);
        let observation = &self.observation;
        self.instructions.run(
            #[inline(always)]
            || match &network.memory {
                None => network.encoder.apply(1, observation, first, buffers),
                Some(gru) => {
                    network.encoder.apply(1, observation, &mut state.encoded, buffers);
                    std::mem::swap(&mut state.now, &mut state.before);
                    gru.apply(&state.encoded, &state.before, &mut state.now, &mut state.gates);
                    first.copy_from_slice(&state.now);
                }
            },
        );
    }

    /// Encodes an observation of test data: that of `own`, or the first values of `observation` for a policy that takes
    /// channels. The first floats of `memory` are the state before.
    pub(crate) fn encode_probed(
        &mut self,
        own: &Observation,
        observation: Option<&[f32]>,
        memory: &[f32],
        features: &mut [f32],
    ) {
        match observation {
            Some(values) => self.observation.iter_mut().zip(values).for_each(|(to, value)| *to = *value),
            None => entry::write(&self.network.manifest.observation, own, &mut self.observation),
        }
        self.state.now.iter_mut().zip(memory).for_each(|(to, value)| *to = *value);
        self.encode_observed(features);
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

    fn reset(&mut self, _seed: u64) {
        self.state.now.fill(0.0);
        self.state.before.fill(0.0);
    }

    fn undo(&mut self) {
        self.state.now.copy_from_slice(&self.state.before);
    }

    fn forgets_after(&self) -> Option<Span> {
        self.network.manifest.memory.map(|memory| Span::from_secs(memory.after_gap_s))
    }

    fn memory(&self) -> Option<&[f32]> {
        self.network.manifest.memory.map(|_| &*self.state.now)
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        let network = &*self.network;
        self.fails = !own.values.iter().all(|value| value.is_finite());
        if self.fails {
            self.state.before.copy_from_slice(&self.state.now);
            self.failures.fail(&network.digest, &entry::unknown(&network.manifest.observation, own.values));
            return;
        }
        self.failures.succeed();
        entry::write(&network.manifest.observation, own, &mut self.observation);
        self.encode_observed(features);
    }

    fn broadcast(&self) -> Broadcast<'_> {
        if self.fails { Broadcast::Failed } else { Broadcast::Encoded }
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
        Hops::new(Arc::clone(network), draw, RobotId(0)).act(&own, &[0.0], &[], &mut Seed::of_run(1).stream("draw"))
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
        let mut policy = Hops::new(Arc::new(network), Draw::Mean, RobotId(0));
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
