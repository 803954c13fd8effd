//! Forward pass of one hop over a batch of graphs. The backward pass is in `hop_back`.
//!
//! Nothing quadratic is computed for each edge that can be computed for each robot: the first message layer is split
//! into a part for each sender, one for each receiver and one for each edge feature. A last message layer without
//! activation is folded with the first update layer, as combining messages is linear. Only the message layers between
//! are computed for each edge. The equations are in `docs/training.md`.

use std::ops::Range;

use super::layer::{Activation, Layer, Perceptron, add, resize};
use super::shape::{Aggregation, HopShape, MessagePart, UpdatePart};
use crate::matrix::{Output, Real, View, multiply};

/// Edges of a batch as a hop uses them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edges<'a, T> {
    /// Number of nodes whose output is computed.
    pub(super) nodes: usize,
    /// Index of each node's first edge in `sender`, and last the number of edges.
    pub(super) first: &'a [u32],
    /// Row of each edge's sender in the input of the hop.
    pub(super) sender: &'a [u32],
    /// Edge features, \[edges, features\].
    pub(super) features: &'a [T],
}

impl<T> Edges<'_, T> {
    /// Returns the number of edges.
    pub(super) fn count(&self) -> usize {
        self.first[self.nodes] as usize
    }

    /// Returns the edges to a node.
    pub(super) fn of(&self, node: usize) -> Range<usize> {
        self.first[node] as usize..self.first[node + 1] as usize
    }
}

/// One hop: its layers, and the columns of their weights at which the parts of inputs begin.
#[derive(Clone, Debug)]
pub(super) struct Hop {
    /// Width of the hop's input.
    pub(super) input: usize,
    /// Message network.
    pub(super) message: Perceptron,
    /// First column of the part of the first message layer for the receiver; `None` if there is none.
    pub(super) own: Option<usize>,
    /// First column of the part of the first message layer for the sender, or for the difference.
    pub(super) sender: Option<usize>,
    /// Whether `sender` is for the difference between the sender's input and the receiver's.
    pub(super) difference: bool,
    /// First column of the part of the first message layer for edge features, and their number; zero if unused.
    pub(super) edge: (usize, usize),
    pub(super) aggregation: Aggregation,
    pub(super) self_loop: bool,
    /// Update network.
    pub(super) update: Perceptron,
    /// First column of the part of the first update layer for the robot's own input.
    pub(super) update_own: Option<usize>,
    /// First column of the part of the first update layer for the combined messages.
    pub(super) update_messages: usize,
}

/// Buffers of one hop; all matrices are row-major.
#[derive(Debug, Default)]
pub(super) struct HopSpace<T> {
    /// Each row's contribution to the first message layer as a sender.
    pub(super) theirs: Vec<T>,
    /// Each node's contribution to the first message layer as the receiver, with the layer's bias.
    pub(super) own: Vec<T>,
    edge_weight: Vec<T>,
    /// Outputs of each message layer that is computed for each edge, \[messages, outputs\].
    pub(super) message: Vec<Vec<T>>,
    /// Combined messages of each node, before a last message layer that is folded.
    pub(super) combined: Vec<T>,
    /// Weights of the last message layer and the first update layer, folded into one layer.
    pub(super) folded: Vec<T>,
    folded_bias: Vec<T>,
    /// Derivatives of the loss with respect to `folded`.
    pub(super) d_folded: Vec<T>,
    /// Derivatives of the loss with respect to the bias of the folded layer.
    pub(super) d_folded_bias: Vec<T>,
    /// Outputs of each layer of the update network, \[nodes, outputs\].
    pub(super) update: Vec<Vec<T>>,
    /// Derivatives with respect to each row's contribution to the first message layer as a sender.
    pub(super) d_theirs: Vec<T>,
    /// Derivatives with respect to each node's contribution to the first message layer as the receiver.
    pub(super) d_own: Vec<T>,
}

impl Hop {
    /// Places a hop of this shape, with an input of `input` floats and `edge` edge features, in the parameter vector at
    /// the index `at`, which moves to the hop's end. The shape has been checked.
    pub(super) fn placed(shape: &HopShape, input: usize, edge: usize, at: &mut usize) -> Hop {
        let HopShape { message, message_inputs, aggregation, self_loop, update, update_inputs } = shape;
        let begin = |wanted: MessagePart| {
            let place = message_inputs.iter().position(|part| *part == wanted)?;
            let before = message_inputs[..place].iter();
            Some(before.map(|part| if *part == MessagePart::Edge { edge } else { input }).sum::<usize>())
        };
        let update_begin = |wanted: UpdatePart| {
            let place = update_inputs.iter().position(|part| *part == wanted)?;
            let width = |part: &UpdatePart| if *part == UpdatePart::Own { input } else { message.outputs() };
            Some(update_inputs[..place].iter().map(width).sum::<usize>())
        };
        let difference = begin(MessagePart::Difference);
        Hop {
            input,
            message: Perceptron::placed(&message.widths, (message.between, message.last), at),
            own: begin(MessagePart::Own),
            sender: begin(MessagePart::Sender).or(difference),
            difference: difference.is_some(),
            edge: begin(MessagePart::Edge).map_or((0, 0), |begin| (begin, edge)),
            aggregation: *aggregation,
            self_loop: *self_loop,
            update: Perceptron::placed(&update.widths, (update.between, update.last), at),
            update_own: update_begin(UpdatePart::Own),
            update_messages: update_begin(UpdatePart::Messages).expect("a checked hop uses its messages"),
        }
    }

    /// Returns the last message layer if it is folded with the first update layer.
    pub(super) fn folds(&self) -> Option<Layer> {
        let last = self.message.layers[self.message.layers.len() - 1];
        (self.message.layers.len() > 1 && last.activation == Activation::Linear).then_some(last)
    }

    /// Returns the number of message layers that are computed for each edge.
    pub(super) fn computed(&self) -> usize {
        self.message.layers.len() - usize::from(self.folds().is_some())
    }

    /// Returns the width of the combined messages.
    pub(super) fn combined(&self) -> usize {
        self.message.layers[self.computed() - 1].outputs
    }

    /// Returns the number of rows of messages: one for each edge, and then the robots' messages to themselves: one for
    /// each node, or one for all, where the only input that is not zero for all is a difference.
    pub(super) fn rows<T>(&self, edges: &Edges<T>) -> usize {
        let own = if self.difference { 1 } else { edges.nodes };
        edges.count() + if self.self_loop { own } else { 0 }
    }

    /// Returns the row of a node's message to itself; `None` without one.
    pub(super) fn own_row<T>(&self, edges: &Edges<T>, node: usize) -> Option<usize> {
        self.self_loop.then(|| edges.count() + if self.difference { 0 } else { node })
    }

    /// Returns the number of messages that a node receives, with its own, as a factor.
    pub(super) fn messages<T: Real>(&self, edges: &Edges<T>, node: usize) -> T {
        T::of((edges.of(node).len() + usize::from(self.self_loop)) as f32)
    }

    /// Returns the weight of each message of a node in the combined message; `None` if it is one.
    pub(super) fn share<T: Real>(&self, edges: &Edges<T>, node: usize) -> Option<T> {
        (self.aggregation == Aggregation::Mean).then(|| T::one() / self.messages::<T>(edges, node).max(T::one()))
    }

    /// Returns the factor of the last message layer's bias in the combined message of a node.
    pub(super) fn terms<T: Real>(&self, edges: &Edges<T>, node: usize) -> T {
        let messages = self.messages::<T>(edges, node);
        if self.aggregation == Aggregation::Mean { messages.min(T::one()) } else { messages }
    }

    /// Computes all activations of the hop. `input` has the inputs of all senders, those of the nodes first.
    #[inline(always)]
    pub(super) fn forward<T: Real>(&self, p: &[T], input: &[T], edges: Edges<T>, space: &mut HopSpace<T>) {
        space.message.resize_with(self.computed(), Vec::new);
        space.update.resize_with(self.update.layers.len(), Vec::new);
        if edges.nodes == 0 {
            space.update.iter_mut().for_each(Vec::clear);
            return;
        }
        self.first_layer_per_robot(p, input, &edges, space);
        self.first_layer_per_edge(p, &edges, space);
        let rows = self.rows(&edges);
        (1..self.computed()).for_each(|depth| self.message.apply(depth, p, rows, &mut space.message));
        self.combine(&edges, space);
        self.first_update_layer(p, input, &edges, space);
        (1..self.update.layers.len()).for_each(|depth| self.update.apply(depth, p, edges.nodes, &mut space.update));
    }

    /// Computes the parts of the first message layer that depend on one robot only.
    #[inline(always)]
    fn first_layer_per_robot<T: Real>(&self, p: &[T], input: &[T], edges: &Edges<T>, space: &mut HopSpace<T>) {
        let (first, nodes, h) = (self.message.layers[0], edges.nodes, self.input);
        let width = first.outputs;
        if let Some(from) = self.sender {
            let rows = input.len() / h;
            resize(&mut space.theirs, rows * width);
            let weights = first.columns(p, from, h).t();
            multiply(&mut space.theirs, width, Output::Replace, View::new(input, rows, h), weights);
        }
        if let Some(from) = self.own {
            resize(&mut space.own, nodes * width);
            space.own.chunks_exact_mut(width).for_each(|row| row.copy_from_slice(first.b(p)));
            let own = View::new(&input[..nodes * h], nodes, h);
            multiply(&mut space.own, width, Output::Add, own, first.columns(p, from, h).t());
        }
        first.transpose_columns(p, self.edge.0, self.edge.1, &mut space.edge_weight);
    }

    /// Combines the parts of the first message layer for every edge, and for the robots' messages to themselves.
    #[inline(always)]
    fn first_layer_per_edge<T: Real>(&self, p: &[T], edges: &Edges<T>, space: &mut HopSpace<T>) {
        let HopSpace { theirs, own, edge_weight, message, .. } = space;
        let first = self.message.layers[0];
        let (width, bias, features) = (first.outputs, first.b(p), self.edge.1);
        let messages = &mut message[0];
        resize(messages, self.rows(edges) * width);
        let theirs = self.sender.map(|_| &theirs[..]);
        let own = self.own.map(|_| &own[..]);
        for node in 0..edges.nodes {
            for edge in edges.of(node) {
                let to = &mut messages[edge * width..][..width];
                self.parts_of_robots((theirs, own, bias), (edges.sender[edge] as usize, node), to);
                let features = &edges.features[edge * features..][..features];
                for (feature, weight) in features.iter().zip(edge_weight.chunks_exact(width)) {
                    for k in 0..width {
                        to[k] += *feature * weight[k];
                    }
                }
                first.activation.apply(to);
            }
        }
        if self.self_loop && self.difference {
            messages[edges.count() * width..].copy_from_slice(bias);
        } else if self.self_loop {
            for (node, to) in messages[edges.count() * width..].chunks_exact_mut(width).enumerate() {
                self.parts_of_robots((theirs, own, bias), (node, node), to);
            }
        }
        first.activation.apply(&mut messages[edges.count() * width..]);
    }

    /// Writes the parts of sender and receiver of the first message layer, with its bias, to `to`.
    #[inline(always)]
    fn parts_of_robots<T: Real>(
        &self,
        (theirs, own, bias): (Option<&[T]>, Option<&[T]>, &[T]),
        (sender, node): (usize, usize),
        to: &mut [T],
    ) {
        let width = to.len();
        let row = |row: usize| row * width..(row + 1) * width;
        match (theirs, own) {
            (Some(theirs), Some(own)) => {
                let (theirs, own) = (&theirs[row(sender)], &own[row(node)]);
                for k in 0..width {
                    to[k] = theirs[k] + own[k];
                }
            }
            (Some(theirs), None) if self.difference => {
                let (theirs, own) = (&theirs[row(sender)], &theirs[row(node)]);
                for k in 0..width {
                    to[k] = theirs[k] - own[k] + bias[k];
                }
            }
            (Some(theirs), None) => {
                let theirs = &theirs[row(sender)];
                for k in 0..width {
                    to[k] = theirs[k] + bias[k];
                }
            }
            (None, Some(own)) => to.copy_from_slice(&own[row(node)]),
            (None, None) => to.copy_from_slice(bias),
        }
    }

    /// Combines the messages that each node receives.
    #[inline(always)]
    fn combine<T: Real>(&self, edges: &Edges<T>, space: &mut HopSpace<T>) {
        let (messages, width) = (&space.message[self.computed() - 1], self.combined());
        resize(&mut space.combined, edges.nodes * width);
        for (node, sum) in space.combined.chunks_exact_mut(width).enumerate() {
            sum.fill(T::zero());
            let range = edges.of(node);
            for term in messages[range.start * width..range.end * width].chunks_exact(width) {
                add(sum, term);
            }
            if let Some(row) = self.own_row(edges, node) {
                add(sum, &messages[row * width..][..width]);
            }
            if let Some(share) = self.share::<T>(edges, node) {
                sum.iter_mut().for_each(|sum| *sum = *sum * share);
            }
        }
    }

    /// Applies the first update layer, with the last message layer folded into it if no activation is between them.
    #[inline(always)]
    fn first_update_layer<T: Real>(&self, p: &[T], input: &[T], edges: &Edges<T>, space: &mut HopSpace<T>) {
        let (first, nodes, h, width) = (self.update.layers[0], edges.nodes, self.input, self.combined());
        let folds = self.folds();
        if let Some(last) = folds {
            let messages = first.columns(p, self.update_messages, last.outputs);
            resize(&mut space.folded, first.outputs * width);
            resize(&mut space.folded_bias, first.outputs);
            multiply(&mut space.folded, width, Output::Replace, messages, last.w(p));
            let bias = View::new(last.b(p), last.outputs, 1);
            multiply(&mut space.folded_bias, 1, Output::Replace, messages, bias);
        }
        let to = &mut space.update[0];
        resize(to, nodes * first.outputs);
        let weights = match folds {
            Some(_) => View::new(&space.folded, first.outputs, width),
            None => first.columns(p, self.update_messages, width),
        };
        multiply(to, first.outputs, Output::Replace, View::new(&space.combined, nodes, width), weights.t());
        if let Some(from) = self.update_own {
            let own = View::new(&input[..nodes * h], nodes, h);
            multiply(to, first.outputs, Output::Add, own, first.columns(p, from, h).t());
        }
        if folds.is_some() {
            for (node, to) in to.chunks_exact_mut(first.outputs).enumerate() {
                let terms = self.terms::<T>(edges, node);
                to.iter_mut().zip(&space.folded_bias).for_each(|(to, bias)| *to += terms * *bias);
            }
        }
        first.activation.apply_with_bias(first.b(p), to);
    }
}
