//! The message-passing network of the paper (section III), evaluated for one robot, in its two architectures.
//!
//! Robot i encodes its observation x_i and broadcasts h_i = encoder(x_i). In the published architecture the action is
//! update(sum over j of message(h_j - h_i)). The sum includes the robot's own term message(0), a constant that is not
//! zero. In the full architecture, equation (1), the action is update(\[h_i, sum over j of message(\[h_i, h_j,
//! e_ij\])\]). Here e_ij are the features of the edge, and the sum has no own term.
//!
//! In both, the last message layer is linear, so it is applied once, after the sum. The first update layer is linear
//! too, so both are folded into one layer. In the full architecture, h_i contributes to the first layers of the message
//! and the update network. This part is computed once a step, and each neighbour's sums start from it.

use std::sync::Arc;

use super::manifest::{Architecture, EdgeField, Manifest};
use super::mlp::{Instructions, Layer, Mlp, Relu, Scratch};
use super::weights::PolicyFile;
use super::{Draw, Interface, Neighbour, Policy};
use crate::messages::geometry::{Planar, Vec2};
use crate::observation::Observation;
use crate::random;
use crate::random::Stream;
use crate::time::Span;

/// Weights and parameters of a trained message-passing network, which all robots of a team share.
#[derive(Debug)]
pub struct GnnWeights {
    manifest: Manifest,
    assumed: Option<String>,
    digest: String,
    interface: Interface,
    encoder: Mlp,
    own: OwnLatent,
    /// All message layers but the last, which is linear. Full: without the first as well.
    message: Option<Mlp>,
    /// The last message layer and the first update layer folded into one. Full: without the robot's own part.
    aggregate: Layer,
    /// Contribution of each term of the sum to the output of `aggregate`: the bias of the last message layer.
    term_bias: Vec<f32>,
    /// All update layers but the first.
    update: Option<Mlp>,
}

/// Use of the robot's own latent.
#[derive(Debug)]
enum OwnLatent {
    /// Published: it is subtracted from each neighbour's latent. Holds the robot's own term of the sum, message(0)
    /// before the last layer, which is the same at every step.
    Term(Vec<f32>),
    /// Full: it is an input of both networks.
    Parts {
        /// The first message layer; `None` if that is also the last, which is folded as a whole.
        message: Option<FirstLayer>,
        /// Part of the first update layer that takes the robot's own latent.
        update: Layer,
    },
}

/// The first message layer of the full architecture, split by its inputs.
#[derive(Debug)]
struct FirstLayer {
    /// The part for the robot's own latent, with the bias.
    own: Layer,
    /// The part for the neighbour's latent and the edge features.
    neighbour: Layer,
}

impl GnnWeights {
    /// Makes the network of a policy file that was read and checked. The file's test data are not compared with the
    /// network; `probe::network` does that.
    pub fn new(file: PolicyFile) -> GnnWeights {
        let PolicyFile { manifest, assumed, digest, networks: [encoder, message, update], .. } = file;
        let part = |layers: &[Layer]| (!layers.is_empty()).then(|| Mlp::new(layers.to_vec()));
        let (last, rest) = message.layers().split_last().expect("a perceptron has a layer");
        let (first, update_rest) = update.layers().split_first().expect("a perceptron has a layer");
        let (own, rest, first) = match manifest.architecture {
            Architecture::Published => (OwnLatent::Term(own_term(rest, message.inputs())), rest, first.clone()),
            Architecture::Full => {
                let split = |layer: &Layer| {
                    let (own, neighbour) = layer.split(encoder.outputs());
                    FirstLayer { own, neighbour }
                };
                let (update, aggregate) = first.split(encoder.outputs());
                let own = OwnLatent::Parts { message: rest.first().map(split), update };
                (own, rest.get(1..).unwrap_or_default(), aggregate)
            }
        };
        let (aggregate, term_bias) = first.fold_after(last);
        GnnWeights {
            interface: interface(&manifest, encoder.outputs()),
            manifest,
            assumed,
            digest,
            encoder,
            own,
            message: part(rest),
            aggregate,
            term_bias,
            update: part(update_rest),
        }
    }

    /// Returns the parameters that the rest of the system needs to run the network, such as message size and period.
    pub fn interface(&self) -> Interface {
        self.interface
    }

    /// Returns the manifest of the network's policy file. For a file without a manifest, it is that of the policy
    /// published with the paper.
    pub fn manifest(&self) -> &Manifest {
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

    fn first_message_layer(&self) -> Option<&FirstLayer> {
        match &self.own {
            OwnLatent::Term(_) => None,
            OwnLatent::Parts { message, .. } => message.as_ref(),
        }
    }

    /// Width of the input of `message`, or of the sum if there is no `message`.
    fn row_width(&self) -> usize {
        self.message.as_ref().map_or(self.aggregate.inputs(), Mlp::inputs)
    }
}

/// Output of all message layers but the last for an input of `width` zeros.
fn own_term(rest: &[Layer], width: usize) -> Vec<f32> {
    let zeros = vec![0.0; width];
    if rest.is_empty() {
        return zeros;
    }
    let rest = Mlp::new(rest.to_vec());
    let mut term = vec![0.0; rest.outputs()];
    rest.apply(1, &zeros, &mut term, &mut rest.scratch(1), Relu::After);
    term
}

fn interface(manifest: &Manifest, features: usize) -> Interface {
    Interface {
        features,
        radius_m: manifest.radius_m,
        period: Span::from_secs(1.0 / manifest.rate_hz),
        limit_m_s: manifest.limit_m_s,
        hold: Span::from_secs(manifest.hold_s),
    }
}

/// One robot's instance of a trained message-passing network, with buffers of its own.
#[derive(Debug)]
pub struct Gnn {
    network: Arc<GnnWeights>,
    draw: Draw,
    instructions: Instructions,
    space: Space,
}

/// Buffers for intermediate values. A step allocates nothing unless it has more neighbours than any before.
#[derive(Debug)]
struct Space {
    observation: Vec<f32>,
    encoder: Scratch,
    /// Full: latent and edge features, one row per neighbour.
    neighbours: Vec<f32>,
    /// Input of the network's `message`, one row per neighbour.
    rows: Vec<f32>,
    message: Scratch,
    /// Output of all message layers but the last, one row per neighbour.
    edges: Vec<f32>,
    sum: Vec<f32>,
    /// Output of the network's `aggregate`.
    aggregate: Vec<f32>,
    update: Scratch,
    /// Full: contribution of the robot's own latent to the first message layer.
    own_message: Vec<f32>,
    /// Full: contribution of the robot's own latent to the first update layer.
    own_update: Vec<f32>,
    /// Number of neighbours that the buffers have room for.
    capacity: usize,
}

impl Gnn {
    /// Makes one robot's instance of `network`, which draws actions from the output distribution by the method `draw`.
    pub fn new(network: Arc<GnnWeights>, draw: Draw) -> Gnn {
        Gnn::with_instructions(network, draw, Instructions::Detected)
    }

    /// Makes one robot's instance of `network` that runs on the given processor instructions; `draw` is the method of
    /// drawing actions. The instruction set changes the speed, and results are the same bit for bit.
    pub fn with_instructions(network: Arc<GnnWeights>, draw: Draw, instructions: Instructions) -> Gnn {
        let own_message = network.first_message_layer().map_or(0, |first| first.own.outputs());
        let space = Space {
            observation: vec![0.0; network.encoder.inputs()],
            encoder: network.encoder.scratch(1),
            neighbours: Vec::new(),
            rows: Vec::new(),
            message: Scratch::default(),
            edges: Vec::new(),
            sum: vec![0.0; network.aggregate.inputs()],
            aggregate: vec![0.0; network.aggregate.outputs()],
            update: network.update.as_ref().map(|update| update.scratch(1)).unwrap_or_default(),
            own_message: vec![0.0; own_message],
            own_update: vec![0.0; network.aggregate.outputs()],
            capacity: 0,
        };
        Gnn { network, draw, instructions, space }
    }

    /// Returns the network's raw outputs: mean_x, mean_y, log_std_x and log_std_y of the distribution of a velocity
    /// \[m/s\], policy frame. The manifest's upper limit of the log standard deviation is not applied.
    ///
    /// `own` is the robot's observation, `features` its own latent, which `encode` has just computed, and `neighbours`
    /// are the neighbours' messages in use.
    pub fn outputs(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour]) -> [f32; 4] {
        self.reserve(neighbours.len());
        let (network, space) = (&*self.network, &mut self.space);
        self.instructions.run(
            #[inline(always)]
            || outputs(network, space, own.motion.position, features, neighbours),
        )
    }

    fn reserve(&mut self, neighbours: usize) {
        if neighbours > self.space.capacity {
            let space = &mut self.space;
            space.capacity = neighbours;
            let width = self.network.first_message_layer().map_or(0, |first| first.neighbour.inputs());
            space.neighbours.resize(neighbours * width, 0.0);
            space.rows.resize(neighbours * self.network.row_width(), 0.0);
            space.edges.resize(neighbours * self.network.aggregate.inputs(), 0.0);
            if let Some(message) = &self.network.message {
                space.message = message.scratch(neighbours);
            }
        }
    }
}

#[inline(always)]
fn outputs(
    network: &GnnWeights,
    space: &mut Space,
    position: Vec2,
    features: &[f32],
    neighbours: &[Neighbour],
) -> [f32; 4] {
    let (count, width) = (neighbours.len(), network.row_width());
    match &network.own {
        OwnLatent::Term(term) => {
            for (row, neighbour) in space.rows.chunks_exact_mut(width).zip(neighbours) {
                for ((to, theirs), mine) in row.iter_mut().zip(neighbour.features).zip(features) {
                    *to = theirs - mine;
                }
            }
            space.sum.copy_from_slice(term);
        }
        OwnLatent::Parts { message, .. } => {
            let edge = &network.manifest.edge;
            match message {
                Some(FirstLayer { own, neighbour: layer }) => {
                    own.apply(1, features, &mut space.own_message, Relu::None);
                    for (row, neighbour) in space.neighbours.chunks_exact_mut(layer.inputs()).zip(neighbours) {
                        write_neighbour(edge, position, neighbour, row);
                    }
                    layer.apply_from(&space.own_message, count, &space.neighbours, &mut space.rows, Relu::After);
                }
                None => {
                    for (row, neighbour) in space.rows.chunks_exact_mut(width).zip(neighbours) {
                        let (mine, theirs) = row.split_at_mut(features.len());
                        mine.copy_from_slice(features);
                        write_neighbour(edge, position, neighbour, theirs);
                    }
                }
            }
            space.sum.fill(0.0);
        }
    }
    let rows = &space.rows[..count * width];
    match &network.message {
        Some(message) => message.apply(count, rows, &mut space.edges, &mut space.message, Relu::After),
        None => space.edges[..rows.len()].copy_from_slice(rows),
    }
    for edge in space.edges.chunks_exact(space.sum.len()).take(count) {
        space.sum.iter_mut().zip(edge).for_each(|(sum, term)| *sum += term);
    }
    network.aggregate.apply(1, &space.sum, &mut space.aggregate, Relu::None);
    let terms = match &network.own {
        OwnLatent::Term(_) => count + 1,
        OwnLatent::Parts { update, .. } => {
            update.apply(1, features, &mut space.own_update, Relu::None);
            space.aggregate.iter_mut().zip(&space.own_update).for_each(|(sum, own)| *sum += own);
            count
        }
    };
    let terms = terms as f32;
    space.aggregate.iter_mut().zip(&network.term_bias).for_each(|(sum, bias)| *sum += terms * bias);
    let mut out = [0.0; 4];
    match &network.update {
        None => out.copy_from_slice(&space.aggregate),
        Some(update) => {
            space.aggregate.iter_mut().for_each(|sum| *sum = sum.max(0.0));
            update.apply(1, &space.aggregate, &mut out, &mut space.update, Relu::None);
        }
    }
    out
}

/// Writes the input row of a neighbour: its latent, then the features of the edge from a robot at `position` \[m\].
#[inline(always)]
fn write_neighbour(edge: &[EdgeField], position: Vec2, neighbour: &Neighbour, row: &mut [f32]) {
    let (latent, mut row) = row.split_at_mut(neighbour.features.len());
    latent.copy_from_slice(neighbour.features);
    for field in edge {
        let (to, rest) = row.split_at_mut(field.floats());
        match field {
            EdgeField::Age => to[0] = neighbour.age.as_secs() as f32,
            EdgeField::RelativePosition => to.copy_from_slice(&(neighbour.motion.position - position).to_array()),
        }
        row = rest;
    }
}

impl Policy for Gnn {
    fn interface(&self) -> Interface {
        self.network.interface
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        let (network, space) = (&*self.network, &mut self.space);
        for (entry, field) in space.observation.chunks_exact_mut(2).zip(&network.manifest.observation) {
            entry.copy_from_slice(&field.of(own).to_array());
        }
        self.instructions.run(
            #[inline(always)]
            || network.encoder.apply(1, &space.observation, features, &mut space.encoder, Relu::None),
        );
    }

    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2 {
        let [mean_x, mean_y, log_std_x, log_std_y] = self.outputs(own, features, neighbours);
        match self.draw {
            Draw::Mean => Vec2::new(mean_x, mean_y),
            Draw::Sample => {
                let max = self.network.manifest.log_std_max;
                let [x, y] = random::normals(stream);
                let normal = |mean: f32, log_std: f32, unit: f64| -> f32 {
                    mean + unit as f32 * libm::expf(max.map_or(log_std, |max| log_std.min(max)))
                };
                Vec2::new(normal(mean_x, log_std_x, x), normal(mean_y, log_std_y, y))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::policy::manifest::Training;
    use crate::policy::weights::Tensors;
    use crate::policy::{random_tensors, weights};
    use crate::random::Seed;
    use rand::RngExt;

    fn network(manifest: &Manifest, tensors: &Tensors) -> Arc<GnnWeights> {
        let file = weights::read(&weights::write(manifest, tensors)).expect("the file can be read");
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
            let [mut baseline, mut detected] = [Instructions::Baseline, Instructions::Detected]
                .map(|instructions| Gnn::with_instructions(Arc::clone(&network), Draw::Mean, instructions));
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
    fn log_std_max_clamps_the_log_standard_deviation_of_samples() {
        let action = |log_std_max: Option<f32>, log_std: f32| {
            let manifest = Manifest { log_std_max, ..Manifest::full() };
            let mut tensors = random_tensors(&manifest, 1);
            let (weight, bias) = tensors[2].last_mut().expect("there are layers");
            weight.fill(0.0);
            bias.copy_from_slice(&[0.0, 0.0, log_std, log_std]);
            let mut gnn = Gnn::new(network(&manifest, &tensors), Draw::Sample);
            let own = Observation::new(Motion::default(), Vec2::zeros());
            assert_eq!(gnn.outputs(&own, &[0.5; 32], &[])[2], log_std, "the raw outputs are not clamped");
            gnn.act(&own, &[0.5; 32], &[], &mut Seed::of_run(1).stream("draw"))
        };
        assert_ne!(action(Some(-1.0), 2.0), action(None, 2.0));
        assert_eq!(action(Some(-1.0), 2.0), action(None, -1.0));
        assert_eq!(action(Some(-1.0), -3.0), action(None, -3.0));
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
        let sha256 = network.manifest().sha256.clone();
        assert_eq!(sha256.len(), 64);
        assert_eq!(*network.manifest(), Manifest { sha256, ..manifest });
    }
}
