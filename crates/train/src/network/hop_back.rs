//! Backward pass of one hop, with derivatives written by hand. The test `tests/learning/gradients.rs` compares them
//! with central differences.

use super::hop::{Edges, Hop, HopSpace};
use super::layer::{Back, add, add_rows, resize};
use crate::matrix::{Output, Real, View, multiply};

impl Hop {
    /// Adds the gradient of the hop's parameters to `g`. `back` holds the derivatives with respect to the outputs of
    /// the hop, \[nodes, outputs\]; those with respect to all rows of `input` are written to `d_input`. `space` must
    /// hold the forward pass with the same input.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "they are the parts of one pass")]
    pub(super) fn backward<T: Real>(
        &self,
        p: &[T],
        input: &[T],
        edges: Edges<T>,
        space: &mut HopSpace<T>,
        back: &mut Back<T>,
        d_input: &mut Vec<T>,
        g: &mut [T],
    ) {
        let layers = self.update.layers.len();
        self.update.activation(layers - 1).back(&space.update[layers - 1], &mut back[0]);
        self.update.back(1..layers, p, edges.nodes, &space.update, back, g);
        self.first_update_back(p, input, &edges, space, back, d_input, g);
        self.combine_back(&edges, space, back);
        self.message.back(1..self.computed(), p, self.rows(&edges), &space.message, back, g);
        self.edges_back(input, &edges, space, &back[0]);
        self.first_message_back(p, input, &edges, space, &back[0], d_input, g);
    }

    /// Backward pass of the first update layer and of a last message layer that is folded with it.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "they are the parts of one pass")]
    fn first_update_back<T: Real>(
        &self,
        p: &[T],
        input: &[T],
        edges: &Edges<T>,
        space: &mut HopSpace<T>,
        back: &mut Back<T>,
        d_input: &mut Vec<T>,
        g: &mut [T],
    ) {
        let (first, nodes, h, width) = (self.update.layers[0], edges.nodes, self.input, self.combined());
        let [d, spare] = back;
        let (outputs, from) = (first.outputs, self.update_messages);
        let d_view = View::new(d, nodes, outputs);
        resize(d_input, input.len());
        match self.update_own {
            Some(own_from) => {
                let own = View::new(&input[..nodes * h], nodes, h);
                multiply(&mut g[first.at + own_from..], first.inputs, Output::Add, d_view.t(), own);
                d_input[nodes * h..].fill(T::zero());
                multiply(d_input, h, Output::Replace, d_view, first.columns(p, own_from, h));
            }
            None => d_input.fill(T::zero()),
        }
        add_rows(d, outputs, &mut g[first.bias()..first.end()]);
        let combined = View::new(&space.combined, nodes, width);
        resize(spare, nodes * width);
        let Some(last) = self.folds() else {
            multiply(&mut g[first.at + from..], first.inputs, Output::Add, d_view.t(), combined);
            multiply(spare, width, Output::Replace, d_view, first.columns(p, from, width));
            back.swap(0, 1);
            return;
        };
        resize(&mut space.d_folded, outputs * width);
        multiply(&mut space.d_folded, width, Output::Replace, d_view.t(), combined);
        resize(&mut space.d_folded_bias, outputs);
        space.d_folded_bias.fill(T::zero());
        for (node, d) in d.chunks_exact(outputs).enumerate() {
            let terms = self.terms::<T>(edges, node);
            space.d_folded_bias.iter_mut().zip(d).for_each(|(sum, d)| *sum += terms * *d);
        }
        let d_folded = View::new(&space.d_folded, outputs, width);
        let d_bias = View::new(&space.d_folded_bias, outputs, 1);
        let messages = first.columns(p, from, last.outputs);
        multiply(&mut g[first.at + from..], first.inputs, Output::Add, d_folded, last.w(p).t());
        multiply(&mut g[first.at + from..], first.inputs, Output::Add, d_bias, View::new(last.b(p), 1, last.outputs));
        multiply(&mut g[last.at..last.bias()], width, Output::Add, messages.t(), d_folded);
        multiply(&mut g[last.bias()..last.end()], 1, Output::Add, messages.t(), d_bias);
        multiply(spare, width, Output::Replace, d_view, View::new(&space.folded, outputs, width));
        back.swap(0, 1);
    }

    /// Backward pass of the combination, from the combined messages to the messages before their activation.
    #[inline(always)]
    fn combine_back<T: Real>(&self, edges: &Edges<T>, space: &HopSpace<T>, back: &mut Back<T>) {
        let [d, spare] = back;
        let (messages, width) = (&space.message[self.computed() - 1], self.combined());
        let activation = self.message.layers[self.computed() - 1].activation;
        resize(spare, self.rows(edges) * width);
        let own = edges.count() * width;
        spare[own..].fill(T::zero());
        for node in 0..edges.nodes {
            let d = &mut d[node * width..][..width];
            if let Some(share) = self.share::<T>(edges, node) {
                d.iter_mut().for_each(|d| *d = *d * share);
            }
            for edge in edges.of(node) {
                let row = edge * width..(edge + 1) * width;
                activation.write_back(&messages[row.clone()], d, &mut spare[row]);
            }
            if let Some(row) = self.own_row(edges, node) {
                add(&mut spare[row * width..][..width], d);
            }
        }
        activation.back(&messages[own..], &mut spare[own..]);
        back.swap(0, 1);
    }

    /// Backward pass of the first message layer, from the messages to their receivers and senders.
    #[inline(always)]
    fn edges_back<T: Real>(&self, input: &[T], edges: &Edges<T>, space: &mut HopSpace<T>, d: &[T]) {
        let width = self.message.layers[0].outputs;
        let HopSpace { d_theirs, d_own, .. } = space;
        resize(d_theirs, input.len() / self.input * width);
        d_theirs.fill(T::zero());
        resize(d_own, edges.nodes * width);
        d_own.fill(T::zero());
        if self.sender.is_none() && self.own.is_none() {
            return;
        }
        for node in 0..edges.nodes {
            let own = &mut d_own[node * width..][..width];
            for edge in edges.of(node) {
                let d = &d[edge * width..][..width];
                add(own, d);
                add(&mut d_theirs[edges.sender[edge] as usize * width..][..width], d);
            }
            if let Some(row) = self.own_row(edges, node).filter(|_| !self.difference) {
                let d = &d[row * width..][..width];
                add(own, d);
                add(&mut d_theirs[node * width..][..width], d);
            }
        }
    }

    /// Backward pass of the first message layer, from robots and edges to its weights and the hop's input.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "they are the parts of one pass")]
    fn first_message_back<T: Real>(
        &self,
        p: &[T],
        input: &[T],
        edges: &Edges<T>,
        space: &mut HopSpace<T>,
        d: &[T],
        d_input: &mut [T],
        g: &mut [T],
    ) {
        let (first, nodes, h) = (self.message.layers[0], edges.nodes, self.input);
        let (width, rows, edge) = (first.outputs, input.len() / h, self.edge.1);
        // Where there is a part of the receiver, the bias is in it.
        let of_bias = if self.own.is_some() { &space.d_own } else { d };
        add_rows(of_bias, width, &mut g[first.bias()..first.end()]);
        if self.difference {
            for (theirs, own) in space.d_theirs.iter_mut().zip(&space.d_own) {
                *theirs -= *own;
            }
        }
        let (d_own, d_theirs) = (View::new(&space.d_own, nodes, width), View::new(&space.d_theirs, rows, width));
        if let Some(from) = self.own {
            let own = View::new(&input[..nodes * h], nodes, h);
            multiply(&mut g[first.at + from..], first.inputs, Output::Add, d_own.t(), own);
        }
        if let Some(from) = self.sender {
            let theirs = View::new(input, rows, h);
            multiply(&mut g[first.at + from..], first.inputs, Output::Add, d_theirs.t(), theirs);
        }
        if edge > 0 {
            let (d, features) = (View::new(d, edges.count(), width), View::new(edges.features, edges.count(), edge));
            multiply(&mut g[first.at + self.edge.0..], first.inputs, Output::Add, d.t(), features);
        }
        if let Some(from) = self.own {
            multiply(d_input, h, Output::Add, d_own, first.columns(p, from, h));
        }
        if let Some(from) = self.sender {
            multiply(d_input, h, Output::Add, d_theirs, first.columns(p, from, h));
        }
    }
}
