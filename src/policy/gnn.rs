//! The message-passing network of the paper (section III), evaluated for one robot.
//!
//! h_i = encoder(x_i) is broadcast; the action is update(sum over j of message(h_j - h_i)), with the robot's
//! own term among the sum: message(0), a constant that is not zero. The last message layer is linear, so it
//! is applied once, after the sum; and as the first update layer is linear too, the two are one.

use std::sync::Arc;

use rand_distr::{Distribution, StandardNormal};

use super::manifest::{Field, Manifest};
use super::mlp::{Instructions, Layer, Mlp, Relu, Scratch};
use super::weights::PolicyFile;
use super::{Draw, Interface, Neighbour, Policy};
use crate::messages::geometry::Vec2;
use crate::random::Stream;
use crate::scenario::Observation;
use crate::time::Span;

/// The weights that a whole team shares.
#[derive(Debug)]
pub struct Network {
    observation: Vec<Field>,
    encoder: Mlp,
    /// All message layers but the last, which is linear.
    message: Option<Mlp>,
    /// What the robot's own zero difference adds to the sum.
    own_term: Vec<f32>,
    /// The last message layer and the first update layer in one.
    heard: Layer,
    /// What each term of the sum adds behind it: the last message layer's bias.
    term_bias: Vec<f32>,
    /// All update layers but the first.
    update: Option<Mlp>,
    interface: Interface,
}

impl Network {
    /// The network of a checked file.
    pub fn new(file: PolicyFile) -> Network {
        let PolicyFile { manifest, networks: [encoder, message, update], .. } = file;
        let part = |layers: &[Layer]| (!layers.is_empty()).then(|| Mlp::new(layers.to_vec()));
        let (last, rest) = message.layers().split_last().expect("a perceptron has a layer");
        let message_rest = part(rest);
        let (first, update_rest) = update.layers().split_first().expect("a perceptron has a layer");
        let (heard, term_bias) = first.after(last);
        let zeros = vec![0.0; message.inputs()];
        let own_term = match &message_rest {
            None => zeros,
            Some(rest) => {
                let mut term = vec![0.0; rest.outputs()];
                rest.apply(1, &zeros, &mut term, &mut rest.scratch(1), Relu::After);
                term
            }
        };
        Network {
            interface: interface(&manifest, encoder.outputs()),
            observation: manifest.observation,
            encoder,
            message: message_rest,
            own_term,
            heard,
            term_bias,
            update: part(update_rest),
        }
    }

    /// What the rest of the system has to know.
    pub fn interface(&self) -> Interface {
        self.interface
    }
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

/// One robot's part of the network.
#[derive(Debug)]
pub struct Gnn {
    network: Arc<Network>,
    draw: Draw,
    instructions: Instructions,
    space: Space,
}

/// Room for everything in between, so that a step allocates nothing once it has seen its most neighbours.
#[derive(Debug)]
struct Space {
    seen: Vec<f32>,
    encoder: Scratch,
    difference: Vec<f32>,
    message: Scratch,
    edges: Vec<f32>,
    sum: Vec<f32>,
    heard: Vec<f32>,
    update: Scratch,
    /// How many neighbours there is room for.
    rows: usize,
}

impl Gnn {
    /// One robot's instance.
    pub fn new(network: Arc<Network>, draw: Draw) -> Gnn {
        Gnn::with_instructions(network, draw, Instructions::Detected)
    }

    /// The same, compiled for chosen instructions; the results are equal bit for bit.
    pub fn with_instructions(network: Arc<Network>, draw: Draw, instructions: Instructions) -> Gnn {
        let space = Space {
            seen: vec![0.0; network.encoder.inputs()],
            encoder: network.encoder.scratch(1),
            difference: Vec::new(),
            message: Scratch::default(),
            edges: Vec::new(),
            sum: vec![0.0; network.heard.inputs()],
            heard: vec![0.0; network.heard.outputs()],
            update: network.update.as_ref().map(|update| update.scratch(1)).unwrap_or_default(),
            rows: 0,
        };
        Gnn { network, draw, instructions, space }
    }

    /// The network's outputs, \[mean_x, mean_y, log_std_x, log_std_y\] \[m/s\].
    pub fn outputs(&mut self, own: &[f32], neighbours: &[Neighbour]) -> [f32; 4] {
        self.make_room(neighbours.len());
        let (network, space) = (&*self.network, &mut self.space);
        self.instructions.run(
            #[inline(always)]
            || outputs(network, space, own, neighbours),
        )
    }

    fn make_room(&mut self, rows: usize) {
        if rows > self.space.rows {
            let space = &mut self.space;
            space.rows = rows;
            space.difference.resize(rows * self.network.encoder.outputs(), 0.0);
            space.edges.resize(rows * self.network.heard.inputs(), 0.0);
            if let Some(message) = &self.network.message {
                space.message = message.scratch(rows);
            }
        }
    }
}

#[inline(always)]
fn outputs(network: &Network, space: &mut Space, own: &[f32], neighbours: &[Neighbour]) -> [f32; 4] {
    let (rows, width) = (neighbours.len(), own.len());
    for (difference, neighbour) in space.difference.chunks_exact_mut(width).zip(neighbours) {
        for ((to, theirs), mine) in difference.iter_mut().zip(neighbour.features).zip(own) {
            *to = theirs - mine;
        }
    }
    match &network.message {
        Some(message) => message.apply(rows, &space.difference, &mut space.edges, &mut space.message, Relu::After),
        None => space.edges[..rows * width].copy_from_slice(&space.difference[..rows * width]),
    }
    space.sum.copy_from_slice(&network.own_term);
    for edge in space.edges.chunks_exact(space.sum.len()).take(rows) {
        space.sum.iter_mut().zip(edge).for_each(|(sum, term)| *sum += term);
    }
    network.heard.apply(1, &space.sum, &mut space.heard, Relu::None);
    // The own term and every neighbour's.
    let terms = (rows + 1) as f32;
    space.heard.iter_mut().zip(&network.term_bias).for_each(|(heard, bias)| *heard += terms * bias);
    let mut out = [0.0; 4];
    match &network.update {
        None => out.copy_from_slice(&space.heard),
        Some(update) => {
            space.heard.iter_mut().for_each(|heard| *heard = heard.max(0.0));
            update.apply(1, &space.heard, &mut out, &mut space.update, Relu::None);
        }
    }
    out
}

impl Policy for Gnn {
    fn interface(&self) -> Interface {
        self.network.interface
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        let (network, space) = (&*self.network, &mut self.space);
        let (position, velocity) = (own.motion.position, own.motion.velocity);
        for (two, field) in space.seen.chunks_exact_mut(2).zip(&network.observation) {
            let value = match field {
                Field::GoalMinusPosition => own.goal - position,
                Field::Position => position,
                // The velocity counts as metres, that is, times one second.
                Field::PositionPlusVelocity => position + velocity,
            };
            two.copy_from_slice(value.as_slice());
        }
        self.instructions.run(
            #[inline(always)]
            || network.encoder.apply(1, &space.seen, features, &mut space.encoder, Relu::None),
        );
    }

    fn act(&mut self, _: &Observation, features: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2 {
        let [mean_x, mean_y, log_std_x, log_std_y] = self.outputs(features, neighbours);
        match self.draw {
            Draw::Mean => Vec2::new(mean_x, mean_y),
            Draw::Sample => {
                let mut normal = |mean: f32, log_std: f32| -> f32 {
                    let unit: f32 = StandardNormal.sample(stream);
                    mean + unit * log_std.exp()
                };
                Vec2::new(normal(mean_x, log_std_x), normal(mean_y, log_std_y))
            }
        }
    }
}
