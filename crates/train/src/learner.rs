//! A network that learns: its parameters, their initial values, and steps of the optimiser from gradients of shards.

use rand::RngExt;

use super::adam::{Adam, clip};
use super::network::layer::{Activation, Layer};
use super::network::{Network, TeamNetwork};
use murmurate::random;
use murmurate::random::Stream;

/// Number of shards of a minibatch, each with a gradient of its own: more than the useful number of threads, and few
/// enough that adding them is cheap. They are added in their order, so the sum does not depend on the number of
/// threads.
pub const SHARDS: usize = 8;

/// A network, or the networks of a team, with its parameters and its optimiser's state.
#[derive(Clone, Debug)]
pub struct Learner<N = Network> {
    /// Layer widths of the network, and the places of its layers in `parameters`.
    pub network: N,
    /// All weights and biases of the network, in one vector.
    pub parameters: Vec<f32>,
    /// State of the network's optimiser.
    pub adam: Adam,
}

/// Distribution of the initial weights of a network. The biases are zero, but for those of the output layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Initial<'a> {
    /// Normal distributions whose variance preserves the size of activations (He et al., arXiv 1502.01852), and nearly
    /// zero in the output layer, so that an untrained policy stands still. The biases are those of the output layer.
    Normal(&'a [f32]),
    /// Uniform distributions of the variance for ReLU in the same paper, and a tenth as wide in the output layer, so
    /// that the first actions are small.
    Uniform,
}

impl Learner {
    /// Returns a learner with random weights of this distribution from `stream`.
    pub fn new(network: Network, initial: Initial, stream: &mut Stream) -> Learner {
        let parameters = parameters(&network, initial, stream);
        Learner { adam: Adam::new(parameters.len()), parameters, network }
    }
}

impl Learner<TeamNetwork> {
    /// Returns a learner of the networks of a team, with random weights of this distribution for each role from its
    /// `stream`.
    pub fn of_team(network: TeamNetwork, initial: Initial, stream: impl Fn(usize) -> Stream) -> Learner<TeamNetwork> {
        let networks = network.networks().iter().enumerate();
        let of_roles = networks.map(|(role, of_role)| parameters(of_role, initial, &mut stream(role)));
        let parameters = of_roles.collect::<Vec<_>>().concat();
        Learner { adam: Adam::new(parameters.len()), parameters, network }
    }
}

impl<N> Learner<N> {
    /// Adds the gradients of shards, which are sums over `samples` samples, and takes one step of the optimiser with
    /// their mean, clipped to the norm `max_norm`. Returns the norm before clipping; `None` without a step if it is not
    /// finite.
    pub fn step<'a>(
        &mut self,
        mut gradients: impl Iterator<Item = &'a mut Vec<f32>>,
        samples: f32,
        max_norm: f32,
        learning_rate: f32,
    ) -> Option<f32> {
        let sum = gradients.next().expect("there are shards");
        for shard in gradients {
            sum.iter_mut().zip(shard).for_each(|(sum, gradient)| *sum += *gradient);
        }
        sum.iter_mut().for_each(|gradient| *gradient /= samples);
        let norm = clip(sum, max_norm);
        if !norm.is_finite() {
            return None;
        }
        self.adam.step(&mut self.parameters, sum, learning_rate);
        Some(norm)
    }
}

/// Returns initial parameters of `network`, with weights of the distribution `initial` drawn from `stream`.
pub fn parameters(network: &Network, initial: Initial, stream: &mut Stream) -> Vec<f32> {
    let mut parameters = vec![0.0; network.parameters()];
    let layers = network.layers().concat();
    let (output, inner) = layers.split_last().expect("a network has layers");
    let mut fill = |layer: &Layer, is_output: bool| {
        let weights = &mut parameters[layer.at..layer.bias()];
        match initial {
            Initial::Normal(_) => {
                let gain = if layer.activation == Activation::Relu { 2.0 } else { 1.0f32 };
                let std = if is_output { 0.01 } else { (gain / layer.inputs as f32).sqrt() };
                weights.iter_mut().for_each(|weight| *weight = std * random::normals(stream)[0] as f32);
            }
            Initial::Uniform => {
                let bound = (6.0 / layer.inputs as f32).sqrt();
                let bound = if is_output { 0.1 * bound } else { bound };
                weights.iter_mut().for_each(|weight| *weight = stream.random_range(-bound..bound));
            }
        }
    };
    inner.iter().for_each(|layer| fill(layer, false));
    fill(output, true);
    if let Initial::Normal(bias) = initial {
        parameters[output.bias()..output.end()].copy_from_slice(bias);
    }
    parameters
}
