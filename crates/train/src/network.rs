//! Forward pass of the message-passing network over a batch of graphs. The backward pass is in `gradient`.
//!
//! Linear parts are computed once per robot: the first message layer before messages are combined per edge, the last
//! message layer after the aggregation. Only the message layers between are computed per edge. The equations are in
//! `docs/training.md`.

use std::fmt;

use super::batch::Batch;
use super::matrix::{Output, Real, View, multiply};
use murmurate::policy::manifest::Architecture;
use murmurate::policy::mlp::Instructions;

/// Layer widths of a network. Each list begins with the number of inputs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Layout of the message-passing network.
    pub architecture: Architecture,
    /// Widths of the encoder's layers, preceded by the number of its inputs.
    pub encoder: Vec<usize>,
    /// Widths of the message network's layers, preceded by the number of its inputs. The network has at least two
    /// layers.
    pub message: Vec<usize>,
    /// Widths of the update network's layers, preceded by the number of its inputs.
    pub update: Vec<usize>,
    /// Number of edge features, which are inputs of the message network.
    pub edge: usize,
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Shape { architecture, encoder, message, update, .. } = self;
        write!(f, "{architecture:?} {encoder:?} {message:?} {update:?}")
    }
}

/// Position of a layer in the parameter vector: weight \[outputs, inputs\], then bias \[outputs\].
#[derive(Clone, Copy, Debug)]
pub(super) struct Layer {
    /// Number of inputs of the layer.
    pub(super) inputs: usize,
    /// Number of outputs of the layer.
    pub(super) outputs: usize,
    /// Index of the layer's first weight in the parameter vector.
    pub(super) at: usize,
}

impl Layer {
    /// Returns the index of the layer's first bias in the parameter vector.
    pub(super) fn bias(&self) -> usize {
        self.at + self.inputs * self.outputs
    }

    /// Returns the index after the layer's last bias in the parameter vector.
    pub(super) fn end(&self) -> usize {
        self.bias() + self.outputs
    }

    /// Returns the layer's weight matrix, \[outputs, inputs\].
    pub(super) fn w<'a, T>(&self, parameters: &'a [T]) -> View<'a, T> {
        View::new(&parameters[self.at..self.bias()], self.outputs, self.inputs)
    }

    /// Returns the columns `from..from + width` of the layer's weight matrix, \[outputs, width\].
    pub(super) fn columns<'a, T>(&self, parameters: &'a [T], from: usize, width: usize) -> View<'a, T> {
        View::strided(&parameters[self.at + from..self.bias()], self.outputs, width, self.inputs)
    }

    /// Returns the layer's biases, \[outputs\].
    pub(super) fn b<'a, T>(&self, parameters: &'a [T]) -> &'a [T] {
        &parameters[self.bias()..self.end()]
    }
}

/// Layer widths of a message-passing network, with the place of each layer in its parameters. The parameters are one
/// flat vector, which the caller passes to each function.
#[derive(Clone, Debug)]
pub struct TrainableGnn {
    /// Layer widths of the network.
    pub(super) shape: Shape,
    /// Layers of the encoder, in the order of application.
    pub(super) encoder: Vec<Layer>,
    /// Layers of the message network, in the order of application.
    pub(super) message: Vec<Layer>,
    /// Layers of the update network, in the order of application.
    pub(super) update: Vec<Layer>,
    parameters: usize,
}

/// Buffers for the activations of a network and the derivatives of a loss on one batch; all matrices are row-major.
#[derive(Debug, Default)]
pub struct Space<T> {
    /// Outputs of each layer of the encoder, \[sources, outputs\].
    pub(super) encoder: Vec<Vec<T>>,
    /// Each source's contribution to the first message layer as a sender.
    theirs: Vec<T>,
    /// Each robot's contribution to the first message layer as the receiver.
    own: Vec<T>,
    edge_weight: Vec<T>,
    /// Outputs of each message layer but the last, \[messages, outputs\].
    pub(super) message: Vec<Vec<T>>,
    /// Sum of the messages that each robot receives, before the last message layer.
    pub(super) sum: Vec<T>,
    /// Weights of the last message layer and the first update layer, folded into one layer.
    pub(super) folded: Vec<T>,
    folded_bias: Vec<T>,
    /// Derivatives of the loss with respect to `folded`.
    pub(super) d_folded: Vec<T>,
    /// Derivatives of the loss with respect to the bias of the folded layer.
    pub(super) d_folded_bias: Vec<T>,
    /// Outputs of each layer of the update network, \[robots, outputs\].
    pub(super) update: Vec<Vec<T>>,
    /// Derivatives with respect to the outputs of the current layer in the backward pass, and a buffer for the next
    /// ones.
    pub(super) back: [Vec<T>; 2],
    /// Derivatives of the loss with respect to the latents, \[sources, latent\].
    pub(super) d_hidden: Vec<T>,
    /// Derivatives with respect to each source's contribution to the first message layer as a sender.
    pub(super) d_theirs: Vec<T>,
    /// Derivatives with respect to each robot's contribution to the first message layer as the receiver.
    pub(super) d_own: Vec<T>,
}

impl<T> Space<T> {
    /// Returns the network's outputs of the last forward pass, \[robots, outputs\], row-major.
    pub fn outputs(&self) -> &[T] {
        self.update.last().map_or(&[], |outputs| outputs)
    }
}

impl TrainableGnn {
    /// Makes a network with the layer widths `shape`, and gives each layer its place in the parameter vector.
    ///
    /// # Panics
    /// If the widths of encoder, message and update network do not fit each other; those of a checked configuration do.
    pub fn new(shape: Shape) -> TrainableGnn {
        let mut at = 0;
        let mut layers = |widths: &[usize]| -> Vec<Layer> {
            let place = |pair: &[usize]| {
                let layer = Layer { inputs: pair[0], outputs: pair[1], at };
                at = layer.end();
                layer
            };
            widths.windows(2).map(place).collect()
        };
        let (encoder, message, update) = (layers(&shape.encoder), layers(&shape.message), layers(&shape.update));
        let network = TrainableGnn { encoder, message, update, parameters: at, shape };
        let (hidden, messages) = (network.hidden(), network.message[network.message.len() - 1].outputs);
        let (message, update) = match network.shape.architecture {
            Architecture::Published => (hidden, messages),
            Architecture::Full => (2 * hidden + network.shape.edge, hidden + messages),
        };
        assert!(network.message.len() >= 2, "a message network that is trained has at least two layers");
        assert_eq!((network.message[0].inputs, network.update[0].inputs), (message, update), "layers fit each other");
        network
    }

    /// Returns the number of weights and biases of the network.
    pub fn parameters(&self) -> usize {
        self.parameters
    }

    /// Returns the number of floats in an observation, the input of the encoder.
    pub fn inputs(&self) -> usize {
        self.encoder[0].inputs
    }

    /// Returns the number of outputs of the network for each robot.
    pub fn outputs(&self) -> usize {
        self.update[self.update.len() - 1].outputs
    }

    /// Returns the layer widths of the network.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Returns the number of floats of a latent, the output of the encoder.
    pub(super) fn hidden(&self) -> usize {
        self.encoder[self.encoder.len() - 1].outputs
    }

    /// Returns the layers of the encoder, message and update network. Each layer is (number of inputs, index of its
    /// first weight, index of its first bias, index after its last bias), with indices in the parameter vector.
    pub fn layers(&self) -> [Vec<(usize, usize, usize, usize)>; 3] {
        [&self.encoder, &self.message, &self.update]
            .map(|layers| layers.iter().map(|layer| (layer.inputs, layer.at, layer.bias(), layer.end())).collect())
    }

    /// Whether the network has the full architecture of the paper's equation (1), and not the published one.
    pub(super) fn is_full(&self) -> bool {
        self.shape.architecture == Architecture::Full
    }

    /// Computes all activations and outputs of the network for `batch`, with the weights and biases `parameters`, and
    /// stores them in `space`.
    pub fn forward<T: Real>(&self, parameters: &[T], batch: &Batch<T>, space: &mut Space<T>) {
        Instructions::Detected.run(
            #[inline(always)]
            || self.forward_here(parameters, batch, space),
        );
    }

    /// Returns the number of rows of messages: one per edge. The published architecture has one row more, the message
    /// of each robot to itself: its input, a difference, is zero, so it is the same for all robots.
    #[inline(always)]
    pub(super) fn rows<T>(&self, batch: &Batch<T>) -> usize {
        batch.sender.len() + usize::from(!self.is_full())
    }

    #[inline(always)]
    fn forward_here<T: Real>(&self, p: &[T], batch: &Batch<T>, space: &mut Space<T>) {
        run(p, &self.encoder, &batch.x, batch.sources(self.inputs()), &mut space.encoder);
        space.message.resize_with(self.message.len() - 1, Vec::new);
        self.first_layer_per_robot(p, batch, space);
        self.first_layer_per_edge(p, batch, space);
        // The message layers between the first and the last, per edge.
        for (depth, layer) in self.message[1..self.message.len() - 1].iter().enumerate() {
            let (from, to) = space.message.split_at_mut(depth + 1);
            apply(p, layer, &from[depth], self.rows(batch), &mut to[0], true);
        }
        self.aggregate(batch, space);
        space.update.resize_with(self.update.len(), Vec::new);
        self.folded(p, batch, space);
        for (depth, layer) in self.update.iter().enumerate().skip(1) {
            let (from, to) = space.update.split_at_mut(depth);
            apply(p, layer, &from[depth - 1], batch.nodes, &mut to[0], depth + 1 < self.update.len());
        }
    }

    /// Computes the parts of the first message layer that depend on one robot only.
    #[inline(always)]
    fn first_layer_per_robot<T: Real>(&self, p: &[T], batch: &Batch<T>, space: &mut Space<T>) {
        let (nodes, sources, h) = (batch.nodes, batch.sources(self.inputs()), self.hidden());
        let (first, hidden) = (self.message[0], &space.encoder[self.encoder.len() - 1]);
        let width = first.outputs;
        resize(&mut space.theirs, sources * width);
        let hidden_view = View::new(hidden, sources, h);
        if self.is_full() {
            multiply(&mut space.theirs, width, Output::Replace, hidden_view, first.columns(p, h, h).t());
            resize(&mut space.own, nodes * width);
            fill_rows(first.b(p), &mut space.own);
            let own = View::new(&hidden[..nodes * h], nodes, h);
            multiply(&mut space.own, width, Output::Add, own, first.columns(p, 0, h).t());
            transpose_columns(p, &first, 2 * h, &mut space.edge_weight);
        } else {
            multiply(&mut space.theirs, width, Output::Replace, hidden_view, first.w(p).t());
        }
    }

    /// Combines both robots' parts of the first message layer for every edge.
    #[inline(always)]
    fn first_layer_per_edge<T: Real>(&self, p: &[T], batch: &Batch<T>, space: &mut Space<T>) {
        let first = self.message[0];
        let (width, edges) = (first.outputs, batch.sender.len());
        let messages = &mut space.message[0];
        resize(messages, self.rows(batch) * width);
        for node in 0..batch.nodes {
            for edge in batch.first[node] as usize..batch.first[node + 1] as usize {
                let to = &mut messages[edge * width..][..width];
                let theirs = &space.theirs[batch.sender[edge] as usize * width..][..width];
                if self.is_full() {
                    let own = &space.own[node * width..][..width];
                    for k in 0..width {
                        to[k] = theirs[k] + own[k];
                    }
                    let features = &batch.e[edge * self.shape.edge..][..self.shape.edge];
                    for (feature, weight) in features.iter().zip(space.edge_weight.chunks_exact(width)) {
                        for k in 0..width {
                            to[k] += *feature * weight[k];
                        }
                    }
                    to.iter_mut().for_each(|x| *x = relu(*x));
                } else {
                    let (own, bias) = (&space.theirs[node * width..][..width], first.b(p));
                    for k in 0..width {
                        to[k] = relu(theirs[k] - own[k] + bias[k]);
                    }
                }
            }
        }
        if !self.is_full() {
            messages[edges * width..].copy_from_slice(first.b(p));
            messages[edges * width..].iter_mut().for_each(|x| *x = relu(*x));
        }
    }

    /// Sums the messages that each robot receives.
    #[inline(always)]
    fn aggregate<T: Real>(&self, batch: &Batch<T>, space: &mut Space<T>) {
        let edges = batch.sender.len();
        let (messages, width) = (&space.message[self.message.len() - 2], self.message[self.message.len() - 1].inputs);
        resize(&mut space.sum, batch.nodes * width);
        for (node, sum) in space.sum.chunks_exact_mut(width).enumerate() {
            sum.fill(T::zero());
            let range = batch.first[node] as usize..batch.first[node + 1] as usize;
            for term in messages[range.start * width..range.end * width].chunks_exact(width) {
                add(sum, term);
            }
            if !self.is_full() {
                add(sum, &messages[edges * width..]);
            }
        }
    }

    /// Folds the last message layer and the first update layer into one layer, as no activation is between them, and
    /// applies that layer.
    #[inline(always)]
    fn folded<T: Real>(&self, p: &[T], batch: &Batch<T>, space: &mut Space<T>) {
        let (nodes, h) = (batch.nodes, self.hidden());
        let (first, last) = (self.update[0], self.message[self.message.len() - 1]);
        let width = last.inputs;
        let from = if self.is_full() { h } else { 0 };
        let aggregate = first.columns(p, from, last.outputs);
        resize(&mut space.folded, first.outputs * width);
        resize(&mut space.folded_bias, first.outputs);
        multiply(&mut space.folded, width, Output::Replace, aggregate, last.w(p));
        multiply(&mut space.folded_bias, 1, Output::Replace, aggregate, View::new(last.b(p), last.outputs, 1));
        let to = &mut space.update[0];
        resize(to, nodes * first.outputs);
        let folded = View::new(&space.folded, first.outputs, width);
        multiply(to, first.outputs, Output::Replace, View::new(&space.sum, nodes, width), folded.t());
        if self.is_full() {
            let own = View::new(&space.encoder[self.encoder.len() - 1][..nodes * h], nodes, h);
            multiply(to, first.outputs, Output::Add, own, first.columns(p, 0, h).t());
        }
        for (node, to) in to.chunks_exact_mut(first.outputs).enumerate() {
            let terms = self.terms::<T>(batch, node);
            to.iter_mut().zip(&space.folded_bias).for_each(|(to, bias)| *to += terms * *bias);
        }
        add_bias(first.b(p), to, self.update.len() > 1);
    }

    /// Returns the number of messages in the sum of the robot with index `node` in the batch, including its own in the
    /// published architecture.
    #[inline(always)]
    pub(super) fn terms<T: Real>(&self, batch: &Batch<T>, node: usize) -> T {
        let terms = batch.first[node + 1] - batch.first[node] + u32::from(!self.is_full());
        T::of(terms as f32)
    }
}

#[inline(always)]
fn relu<T: Real>(x: T) -> T {
    if x > T::zero() { x } else { T::zero() }
}

/// Resizes a buffer whose content the caller overwrites.
#[inline(always)]
pub(super) fn resize<T: Real>(vector: &mut Vec<T>, length: usize) {
    vector.resize(length, T::zero());
}

/// Adds each number of `from` to the number of `to` at the same index.
#[inline(always)]
pub(super) fn add<T: Real>(to: &mut [T], from: &[T]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += *from);
}

/// Copies `bias` into every row of `rows`.
#[inline(always)]
fn fill_rows<T: Real>(bias: &[T], rows: &mut [T]) {
    rows.chunks_exact_mut(bias.len()).for_each(|row| row.copy_from_slice(bias));
}

/// Adds `bias` to every row of `rows`, then applies ReLU if `rectify` is set.
#[inline(always)]
fn add_bias<T: Real>(bias: &[T], rows: &mut [T], rectify: bool) {
    let width = bias.len();
    for row in rows.chunks_exact_mut(width) {
        if rectify {
            for k in 0..width {
                row[k] = relu(row[k] + bias[k]);
            }
        } else {
            for k in 0..width {
                row[k] += bias[k];
            }
        }
    }
}

/// Applies one layer to all rows of `x`, then ReLU if `rectify` is set, and writes the result to `y`.
#[inline(always)]
fn apply<T: Real>(p: &[T], layer: &Layer, x: &[T], rows: usize, y: &mut Vec<T>, rectify: bool) {
    resize(y, rows * layer.outputs);
    multiply(y, layer.outputs, Output::Replace, View::new(x, rows, layer.inputs), layer.w(p).t());
    add_bias(layer.b(p), y, rectify);
}

/// Applies layers one after the other, with ReLU between them, and keeps the output of each layer.
#[inline(always)]
fn run<T: Real>(p: &[T], layers: &[Layer], x: &[T], rows: usize, outputs: &mut Vec<Vec<T>>) {
    outputs.resize_with(layers.len(), Vec::new);
    for (depth, layer) in layers.iter().enumerate() {
        let (from, to) = outputs.split_at_mut(depth);
        let x = if depth == 0 { x } else { &from[depth - 1] };
        apply(p, layer, x, rows, &mut to[0], depth + 1 < layers.len());
    }
}

/// Writes each column of a layer's weight matrix, from column `from` on, as a row of `to`.
#[inline(always)]
fn transpose_columns<T: Real>(p: &[T], layer: &Layer, from: usize, to: &mut Vec<T>) {
    to.clear();
    for column in from..layer.inputs {
        to.extend((0..layer.outputs).map(|row| p[layer.at + row * layer.inputs + column]));
    }
}
