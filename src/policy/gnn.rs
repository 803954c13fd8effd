//! Message-passing networks, evaluated for one robot: policies of formats 1 and 2.
//!
//! A policy is an encoder, a memory if it has one, one or more hops of message passing (`hops`), and a decoder. Robot i
//! broadcasts the inputs of all hops in one message. The two architectures of format 1 are policies of one hop without
//! a decoder. With h_i = encoder(observation of robot i) they are:
//!
//! - published: update(sum over j of message(h_j - h_i)), a sum with the robot's own term message(0);
//! - full, equation (1) of arXiv 2111.01777: update(\[h_i, sum over j of message(\[h_i, h_j, e_ij\])\]), a sum without
//!   an own term.

use std::sync::Arc;

use super::failures::Failures;
use super::file::{AnyManifest, Networks, PolicyFile};
use super::hops::entry::{self, Entry};
use super::hops::gru::Gru;
use super::hops::hop::{Hop, Space};
use super::hops::manifest::OUTPUTS;
use super::hops::output::Meaning;
use super::hops::perceptron::Buffers;
use super::mlp::Instructions;
use super::{Broadcast, Draw, Interface, Neighbour, Policy};
use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::observation::{Observation, Request};
use crate::random::Stream;
use crate::time::Span;

/// Weights and parameters of a trained message-passing network, which all robots of a team share.
#[derive(Debug)]
pub struct GnnWeights {
    manifest: AnyManifest,
    assumed: Option<String>,
    digest: String,
    parameters: usize,
    networks: Networks,
    interface: Interface,
    meaning: Meaning,
    forgets_after: Option<Span>,
    entries: Vec<Entry>,
    requests: Vec<Request>,
}

impl GnnWeights {
    /// Makes the network of a policy file that was read and checked. The file's test data are not compared with the
    /// network; `probe::network` does that.
    pub fn new(file: PolicyFile) -> GnnWeights {
        let PolicyFile { manifest, assumed, digest, parameters, networks, .. } = file;
        let entries = manifest.observation();
        let features = networks.hops.iter().map(Hop::inputs).sum();
        GnnWeights {
            interface: manifest.interface(features),
            meaning: manifest.meaning(),
            forgets_after: manifest.forgets_after(),
            requests: entry::requests(&entries),
            entries,
            manifest,
            assumed,
            digest,
            parameters,
            networks,
        }
    }

    /// Returns the parameters that the rest of the system needs to run the network, such as message size and period.
    pub fn interface(&self) -> Interface {
        self.interface
    }

    /// Returns the manifest of the network's policy file. For a file without a manifest, it is that of the policy
    /// published with the paper.
    pub fn manifest(&self) -> &AnyManifest {
        &self.manifest
    }

    /// Returns the assumptions made because the network's policy file has no manifest or an incomplete one, as text for
    /// the user. `None` means that nothing was assumed.
    pub fn assumed(&self) -> Option<&str> {
        self.assumed.as_deref()
    }

    /// Returns the digest of the network's policy file: the first 64 bits of its BLAKE3 hash, in hexadecimal.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Returns the number of weights and biases of all networks.
    pub fn parameters(&self) -> usize {
        self.parameters
    }

    /// Returns the channels that the policy takes, in the order in which it gets their values.
    pub fn requests(&self) -> &[Request] {
        &self.requests
    }
}

/// State of a robot from one step to the next; all is empty for a policy without one.
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

/// One robot's instance of a trained message-passing network, with buffers of its own. A step allocates nothing unless
/// it has more neighbours than any before.
#[derive(Debug)]
pub struct Gnn {
    network: Arc<GnnWeights>,
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

impl Gnn {
    /// Makes the instance of `robot` of `network`, which draws actions from the output distribution by the method
    /// `draw`.
    pub fn new(network: Arc<GnnWeights>, draw: Draw, robot: RobotId) -> Gnn {
        let Networks { encoder, memory, hops, decoder } = &network.networks;
        let mut buffers = Buffers::default();
        [Some(encoder), decoder.as_ref()].into_iter().flatten().for_each(|part| buffers.reserve(part, 1));
        Gnn {
            observation: vec![0.0; encoder.inputs()],
            state: State::new(memory.as_ref(), encoder.outputs()),
            fails: false,
            failures: Failures::new(robot),
            last: vec![0.0; hops.last().map_or(0, Hop::outputs)],
            buffers,
            spaces: hops.iter().map(|_| Space::default()).collect(),
            draw,
            instructions: Instructions::Detected,
            network,
        }
    }

    /// Returns the instance, to run on the given processor instructions. They change the speed, and results are the
    /// same bit for bit.
    pub fn with_instructions(self, instructions: Instructions) -> Gnn {
        Gnn { instructions, ..self }
    }

    /// Returns the network's raw outputs, the parameters of the distribution of a velocity or an acceleration in the
    /// policy frame: mean_x, mean_y, and a parameter of each standard deviation. The manifest's upper limit of the log
    /// standard deviation is not applied.
    ///
    /// `own` is the robot's observation, `features` its own latent, which holds the inputs of all hops, and
    /// `neighbours` are the neighbours' messages in use.
    pub fn outputs(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour]) -> [f32; OUTPUTS] {
        let Networks { hops, decoder, .. } = &self.network.networks;
        let at = hops.len() - 1;
        let (hop, space) = (&hops[at], &mut self.spaces[at]);
        hop.reserve(space, neighbours.len());
        let (last, buffers, mut out) = (&mut self.last, &mut self.buffers, [0.0; OUTPUTS]);
        self.instructions.run(
            #[inline(always)]
            || {
                hop.apply(&own.motion, features, neighbours, space, last);
                match decoder {
                    Some(decoder) => decoder.apply(1, last, &mut out, buffers),
                    None => out.copy_from_slice(last),
                }
            },
        );
        out
    }

    /// Computes the input of the first hop from the observation, and the state after the step with it, and writes it
    /// into `features`, whose inputs of later hops become zero.
    fn encode_observed(&mut self, features: &mut [f32]) {
        let Networks { encoder, memory, hops, .. } = &self.network.networks;
        let (observation, state, buffers) = (&self.observation, &mut self.state, &mut self.buffers);
        let (first, later) = features.split_at_mut(hops[0].inputs());
        later.fill(0.0);
        self.instructions.run(
            #[inline(always)]
            || match memory {
                None => encoder.apply(1, observation, first, buffers),
                Some(gru) => {
                    encoder.apply(1, observation, &mut state.encoded, buffers);
                    std::mem::swap(&mut state.now, &mut state.before);
                    gru.apply(&state.encoded, &state.before, &mut state.now, &mut state.gates);
                    first.copy_from_slice(&state.now);
                }
            },
        );
    }

    /// Encodes an observation of test data: that of `own`, or the first values of `observation` for a policy that takes
    /// channels. The first floats of `memory` are the state before.
    pub(super) fn encode_probed(
        &mut self,
        own: &Observation,
        observation: Option<&[f32]>,
        memory: &[f32],
        features: &mut [f32],
    ) {
        match observation {
            Some(values) => self.observation.iter_mut().zip(values).for_each(|(to, value)| *to = *value),
            None => entry::write(&self.network.entries, own, &mut self.observation),
        }
        self.state.now.iter_mut().zip(memory).for_each(|(to, value)| *to = *value);
        self.encode_observed(features);
    }
}

impl Policy for Gnn {
    fn interface(&self) -> Interface {
        self.network.interface
    }

    fn hops(&self) -> usize {
        self.network.networks.hops.len()
    }

    fn reset(&mut self, _seed: u64) {
        self.state.now.fill(0.0);
        self.state.before.fill(0.0);
    }

    fn undo(&mut self) {
        self.state.now.copy_from_slice(&self.state.before);
    }

    fn forgets_after(&self) -> Option<Span> {
        self.network.forgets_after
    }

    fn memory(&self) -> Option<&[f32]> {
        self.network.networks.memory.as_ref().map(|_| &*self.state.now)
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        let network = &*self.network;
        self.fails = !own.values.iter().all(|value| value.is_finite());
        if self.fails {
            self.state.before.copy_from_slice(&self.state.now);
            self.failures.fail(&network.digest, &entry::unknown(&network.entries, own.values));
            return;
        }
        self.failures.succeed();
        entry::write(&network.entries, own, &mut self.observation);
        self.encode_observed(features);
    }

    fn broadcast(&self) -> Broadcast<'_> {
        if self.fails { Broadcast::Failed } else { Broadcast::Encoded }
    }

    fn relay(&mut self, hop: usize, own: &Observation, features: &mut [f32], neighbours: &[Neighbour]) {
        let (hops, space) = (&self.network.networks.hops, &mut self.spaces[hop - 1]);
        let before = &hops[hop - 1];
        before.reserve(space, neighbours.len());
        let (inputs, rest) = features.split_at_mut(hops[hop].begins());
        let out = &mut rest[..before.outputs()];
        self.instructions.run(
            #[inline(always)]
            || before.apply(&own.motion, inputs, neighbours, space, out),
        );
    }

    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2 {
        let outputs = self.outputs(own, features, neighbours);
        self.network.meaning.velocity(&outputs, own.motion.velocity, self.draw, stream)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::policy::manifest::{Architecture, EdgeField, Manifest, Training};
    use crate::policy::weights::Tensors;
    use crate::policy::{file, random_tensors, weights};
    use crate::random::Seed;
    use rand::RngExt;

    fn network(manifest: &Manifest, tensors: &Tensors) -> Arc<GnnWeights> {
        let file = file::read(&weights::write(manifest, tensors)).expect("the file can be read");
        Arc::new(GnnWeights::new(file))
    }

    /// Applies all layers in turn, with ReLU between them.
    fn perceptron(layers: &[(Vec<f32>, Vec<f32>)], mut x: Vec<f64>) -> Vec<f64> {
        for (depth, (weight, bias)) in layers.iter().enumerate() {
            let row = |(row, bias): (&[f32], &f32)| -> f64 {
                f64::from(*bias) + row.iter().zip(&x).map(|(weight, x)| f64::from(*weight) * x).sum::<f64>()
            };
            let y: Vec<f64> = weight.chunks_exact(x.len()).zip(bias).map(row).collect();
            let last = depth + 1 == layers.len();
            x = y.into_iter().map(|y| if last { y } else { y.max(0.0) }).collect();
        }
        x
    }

    fn to_f64(floats: &[f32]) -> Vec<f64> {
        floats.iter().map(|float| f64::from(*float)).collect()
    }

    /// Direct evaluation of the architectures' formulas, in f64.
    fn naive(manifest: &Manifest, tensors: &Tensors, at: Vec2, own: &[f32], neighbours: &[Neighbour]) -> Vec<f64> {
        let [_, message, update] = tensors;
        let mut inputs: Vec<Vec<f64>> = Vec::new();
        for neighbour in neighbours {
            let theirs = neighbour.features;
            inputs.push(match manifest.architecture {
                Architecture::Published => {
                    own.iter().zip(theirs).map(|(h, hj)| f64::from(*hj) - f64::from(*h)).collect()
                }
                Architecture::Full => {
                    let mut input = [to_f64(own), to_f64(theirs)].concat();
                    for field in &manifest.edge {
                        match field {
                            EdgeField::Age => input.push(neighbour.age.as_secs()),
                            EdgeField::RelativePosition => {
                                input.push(f64::from(neighbour.motion.position.x) - f64::from(at.x));
                                input.push(f64::from(neighbour.motion.position.y) - f64::from(at.y));
                            }
                        }
                    }
                    input
                }
            });
        }
        let mut start = to_f64(own);
        if manifest.architecture == Architecture::Published {
            inputs.push(vec![0.0; own.len()]);
            start.clear();
        }
        let mut sum = vec![0.0; *manifest.message.last().expect("there are layers")];
        for input in inputs {
            sum.iter_mut().zip(perceptron(message, input)).for_each(|(sum, term)| *sum += term);
        }
        perceptron(update, [start, sum].concat())
    }

    /// Manifests of both architectures, with the published widths, with two layers and with one.
    fn manifests() -> Vec<Manifest> {
        let (published, full) = (Manifest::published(), Manifest::full());
        let small = |manifest: &Manifest, message: &[usize], update: &[usize]| Manifest {
            message: message.to_vec(),
            update: update.to_vec(),
            ..manifest.clone()
        };
        let aged = Manifest { edge: vec![EdgeField::Age], ..full.clone() };
        let bare = Manifest { edge: Vec::new(), ..full.clone() };
        vec![
            small(&published, &[32, 40], &[40, 7, 4]),
            small(&published, &[32, 40], &[40, 4]),
            small(&full, &[67, 40], &[72, 7, 4]),
            small(&full, &[67, 40], &[72, 4]),
            small(&aged, &[65, 37, 40], &[72, 7, 4]),
            small(&bare, &[64, 37, 40], &[72, 4]),
            published,
            full,
        ]
    }

    #[test]
    fn a_step_equals_the_formula_and_has_the_same_bits_on_all_instruction_sets() {
        let mut stream = Seed::of_run(3).stream("test");
        let mut random = |max: f32| stream.random_range(-max..max);
        for (seed, manifest) in manifests().into_iter().enumerate() {
            assert_eq!(manifest.check(), Ok(()));
            let tensors = random_tensors(&manifest, seed as u64);
            let network = network(&manifest, &tensors);
            let [mut baseline, mut detected] = [Instructions::Baseline, Instructions::Detected].map(|instructions| {
                Gnn::new(Arc::clone(&network), Draw::Mean, RobotId(0)).with_instructions(instructions)
            });
            // More and then fewer neighbours, so that stale values in the buffers would show.
            for count in [0, 1, 2, 6, 3, 5, 4, 0] {
                let motion = Motion::at_rest(Vec2::new(random(3.0), random(3.0)));
                let own = Observation::new(motion, Vec2::new(random(3.0), random(3.0)));
                let mut features = vec![0.0; network.interface().features];
                detected.encode(&own, &mut features);
                let broadcasts: Vec<(Vec2, Vec<f32>)> = (0..count)
                    .map(|_| (Vec2::new(random(3.0), random(3.0)), features.iter().map(|_| random(1.0)).collect()))
                    .collect();
                let neighbours = broadcasts.iter().enumerate().map(|(k, (position, features))| Neighbour {
                    motion: Motion::at_rest(*position),
                    features,
                    age: Span::from_millis(37 * k as u64),
                });
                let neighbours: Vec<Neighbour> = neighbours.collect();
                let found = detected.outputs(&own, &features, &neighbours);
                assert_eq!(found, baseline.outputs(&own, &features, &neighbours));
                for (found, expected) in
                    found.iter().zip(naive(&manifest, &tensors, motion.position, &features, &neighbours))
                {
                    let off = (f64::from(*found) - expected).abs();
                    assert!(off <= 1e-4, "{manifest:?}: {found} is not {expected}");
                }
            }
        }
    }

    #[test]
    fn a_manifest_is_unchanged_after_writing_and_reading() {
        let training = Training {
            program: "a-trainer 0.1".to_owned(),
            preset: "passage".to_owned(),
            seed: 3,
            decisions: 4_000_000_000,
            env_steps: 800_000_000,
            configuration: serde_json::json!({"rate": 3e-4, "drop": [0.1, null]}),
        };
        let manifest = Manifest { log_std_max: Some(-0.3), training: Some(training), ..Manifest::full() };
        let network = network(&manifest, &random_tensors(&manifest, 1));
        let AnyManifest::Format1(read) = network.manifest() else { panic!("it is of format 1") };
        let sha256 = read.sha256.clone();
        assert_eq!(sha256.len(), 64);
        assert_eq!(*read, Manifest { sha256, ..manifest });
    }
}
