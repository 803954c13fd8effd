//! Backward pass of the network, with derivatives written by hand. The test `tests/learning/gradients.rs` compares them
//! with central differences.

use super::batch::Batch;
use super::matrix::{Output, Real, View, multiply};
use super::network::{Layer, Space, TrainableGnn, add, resize};
use murmurate::policy::mlp::Instructions;

impl TrainableGnn {
    /// Adds the gradient of a loss with respect to the parameters to `gradient`. `space` must hold the forward pass of
    /// the same batch. `d_outputs` are the derivatives of the loss with respect to the network's outputs, \[robots,
    /// outputs\], row-major.
    pub fn backward<T: Real>(
        &self,
        parameters: &[T],
        batch: &Batch<T>,
        d_outputs: &[T],
        space: &mut Space<T>,
        gradient: &mut [T],
    ) {
        Instructions::Detected.run(
            #[inline(always)]
            || self.backward_here(parameters, batch, d_outputs, space, gradient),
        );
    }

    #[inline(always)]
    fn backward_here<T: Real>(&self, p: &[T], batch: &Batch<T>, d_outputs: &[T], space: &mut Space<T>, g: &mut [T]) {
        let (nodes, sources, rows) = (batch.nodes, batch.sources(self.inputs()), self.rows(batch));
        // Derivatives with respect to the current layer's outputs, and a buffer for those with respect to its inputs.
        let mut back = std::mem::take(&mut space.back);
        back[0].clear();
        back[0].extend_from_slice(d_outputs);
        for (depth, layer) in self.update.iter().enumerate().skip(1).rev() {
            layer_back(p, layer, nodes, &space.update[depth - 1], &mut back, g);
        }
        self.folded_back(p, batch, space, &mut back, g);
        self.aggregate_back(batch, space, &mut back);
        // The layers between the first and the last, per edge.
        for (depth, layer) in self.message[1..self.message.len() - 1].iter().enumerate().rev() {
            layer_back(p, layer, rows, &space.message[depth], &mut back, g);
        }
        self.edges_back(batch, space, &back[0]);
        if self.is_full() {
            self.full_first_back(p, batch, space, &back[0], g);
        } else {
            self.published_first_back(p, batch, space, &back[0], g);
        }
        back[0].clear();
        back[0].extend_from_slice(&space.d_hidden);
        for (depth, layer) in self.encoder.iter().enumerate().skip(1).rev() {
            layer_back(p, layer, sources, &space.encoder[depth - 1], &mut back, g);
        }
        add_gradient(&self.encoder[0], &back[0], &batch.x, sources, g);
        space.back = back;
    }

    /// Backward pass of the folded layer; adds the gradients of the last message layer and the first update layer.
    #[inline(always)]
    fn folded_back<T: Real>(&self, p: &[T], batch: &Batch<T>, space: &mut Space<T>, back: &mut Back<T>, g: &mut [T]) {
        let (nodes, sources, h) = (batch.nodes, batch.sources(self.inputs()), self.hidden());
        let [d, spare] = back;
        let (first, last) = (self.update[0], self.message[self.message.len() - 1]);
        let (width, outputs) = (last.inputs, first.outputs);
        let d_view = View::new(d, nodes, outputs);
        resize(&mut space.d_hidden, sources * h);
        space.d_hidden[nodes * h..].fill(T::zero());
        let from = if self.is_full() { h } else { 0 };
        if self.is_full() {
            let own = View::new(&space.encoder[self.encoder.len() - 1][..nodes * h], nodes, h);
            multiply(&mut g[first.at..], first.inputs, Output::Add, d_view.t(), own);
            multiply(&mut space.d_hidden, h, Output::Replace, d_view, first.columns(p, 0, h));
        } else {
            space.d_hidden[..nodes * h].fill(T::zero());
        }
        add_rows(d, outputs, &mut g[first.bias()..first.end()]);

        resize(&mut space.d_folded, outputs * width);
        multiply(&mut space.d_folded, width, Output::Replace, d_view.t(), View::new(&space.sum, nodes, width));
        resize(&mut space.d_folded_bias, outputs);
        space.d_folded_bias.fill(T::zero());
        for (node, d) in d.chunks_exact(outputs).enumerate() {
            let terms = self.terms::<T>(batch, node);
            space.d_folded_bias.iter_mut().zip(d).for_each(|(sum, d)| *sum += terms * *d);
        }
        let d_folded = View::new(&space.d_folded, outputs, width);
        let d_bias = View::new(&space.d_folded_bias, outputs, 1);
        let aggregate = first.columns(p, from, last.outputs);
        multiply(&mut g[first.at + from..], first.inputs, Output::Add, d_folded, last.w(p).t());
        multiply(&mut g[first.at + from..], first.inputs, Output::Add, d_bias, View::new(last.b(p), 1, last.outputs));
        multiply(&mut g[last.at..last.bias()], width, Output::Add, aggregate.t(), d_folded);
        multiply(&mut g[last.bias()..last.end()], 1, Output::Add, aggregate.t(), d_bias);
        resize(spare, nodes * width);
        multiply(spare, width, Output::Replace, d_view, View::new(&space.folded, outputs, width));
        back.swap(0, 1);
    }

    /// Backward pass of the aggregation, from the sums to the messages.
    #[inline(always)]
    fn aggregate_back<T: Real>(&self, batch: &Batch<T>, space: &Space<T>, back: &mut Back<T>) {
        let edges = batch.sender.len();
        let [d, spare] = back;
        let (messages, width) = (&space.message[self.message.len() - 2], self.message[self.message.len() - 1].inputs);
        resize(spare, self.rows(batch) * width);
        for node in 0..batch.nodes {
            let d = &d[node * width..][..width];
            for edge in batch.first[node] as usize..batch.first[node + 1] as usize {
                write_masked(d, &messages[edge * width..][..width], &mut spare[edge * width..][..width]);
            }
        }
        if !self.is_full() {
            let own = &mut spare[edges * width..];
            own.fill(T::zero());
            d.chunks_exact(width).for_each(|d| add(own, d));
            mask(&messages[edges * width..], own);
        }
        back.swap(0, 1);
    }

    /// Backward pass of the first message layer, from the edges to their receivers and senders.
    #[inline(always)]
    fn edges_back<T: Real>(&self, batch: &Batch<T>, space: &mut Space<T>, d: &[T]) {
        let width = self.message[0].outputs;
        resize(&mut space.d_theirs, batch.sources(self.inputs()) * width);
        space.d_theirs.fill(T::zero());
        resize(&mut space.d_own, batch.nodes * width);
        space.d_own.fill(T::zero());
        for node in 0..batch.nodes {
            let own = &mut space.d_own[node * width..][..width];
            for edge in batch.first[node] as usize..batch.first[node + 1] as usize {
                let d = &d[edge * width..][..width];
                add(own, d);
                add(&mut space.d_theirs[batch.sender[edge] as usize * width..][..width], d);
            }
        }
    }

    /// Backward pass of the first message layer of the architecture `full`, from robots to its weights and the encoder.
    #[inline(always)]
    fn full_first_back<T: Real>(&self, p: &[T], batch: &Batch<T>, space: &mut Space<T>, d: &[T], g: &mut [T]) {
        let (nodes, sources, h) = (batch.nodes, batch.sources(self.inputs()), self.hidden());
        let (first, hidden) = (self.message[0], &space.encoder[self.encoder.len() - 1]);
        let width = first.outputs;
        add_rows(&space.d_own, width, &mut g[first.bias()..first.end()]);
        let (d_own, d_theirs) = (View::new(&space.d_own, nodes, width), View::new(&space.d_theirs, sources, width));
        let own = View::new(&hidden[..nodes * h], nodes, h);
        multiply(&mut g[first.at..], first.inputs, Output::Add, d_own.t(), own);
        multiply(&mut g[first.at + h..], first.inputs, Output::Add, d_theirs.t(), View::new(hidden, sources, h));
        if self.shape.edge > 0 {
            let edges = batch.sender.len();
            let (d, features) = (View::new(d, edges, width), View::new(&batch.e, edges, self.shape.edge));
            multiply(&mut g[first.at + 2 * h..], first.inputs, Output::Add, d.t(), features);
        }
        multiply(&mut space.d_hidden, h, Output::Add, d_own, first.columns(p, 0, h));
        multiply(&mut space.d_hidden, h, Output::Add, d_theirs, first.columns(p, h, h));
    }

    /// Backward pass of the first message layer of the published architecture, whose input is the difference theirs -
    /// own.
    #[inline(always)]
    fn published_first_back<T: Real>(&self, p: &[T], batch: &Batch<T>, space: &mut Space<T>, d: &[T], g: &mut [T]) {
        let (sources, h) = (batch.sources(self.inputs()), self.hidden());
        let (first, hidden) = (self.message[0], &space.encoder[self.encoder.len() - 1]);
        let width = first.outputs;
        add_rows(d, width, &mut g[first.bias()..first.end()]);
        for (theirs, own) in space.d_theirs.iter_mut().zip(&space.d_own) {
            *theirs -= *own;
        }
        let d_theirs = View::new(&space.d_theirs, sources, width);
        multiply(&mut g[first.at..], first.inputs, Output::Add, d_theirs.t(), View::new(hidden, sources, h));
        multiply(&mut space.d_hidden, h, Output::Add, d_theirs, first.w(p));
    }
}

/// Derivatives with respect to the current layer's outputs, and a buffer for the next ones.
type Back<T> = [Vec<T>; 2];

/// Backward pass of one layer, to the derivatives with respect to its inputs `x`, which are outputs of a ReLU.
#[inline(always)]
fn layer_back<T: Real>(p: &[T], layer: &Layer, rows: usize, x: &[T], back: &mut Back<T>, g: &mut [T]) {
    let [d, spare] = back;
    add_gradient(layer, d, x, rows, g);
    input_derivatives(p, layer, d, rows, x, spare);
    back.swap(0, 1);
}

/// Adds all rows to `sum`.
#[inline(always)]
fn add_rows<T: Real>(rows: &[T], width: usize, sum: &mut [T]) {
    rows.chunks_exact(width).for_each(|row| add(sum, row));
}

/// Writes the backward pass of a ReLU to `to`: `d` where the unit was active, zero elsewhere.
#[inline(always)]
fn write_masked<T: Real>(d: &[T], active: &[T], to: &mut [T]) {
    for ((to, d), active) in to.iter_mut().zip(d).zip(active) {
        *to = if *active > T::zero() { *d } else { T::zero() };
    }
}

/// Applies the backward pass of a ReLU in place: sets `d` to zero where the unit was not active.
#[inline(always)]
fn mask<T: Real>(active: &[T], d: &mut [T]) {
    for (d, active) in d.iter_mut().zip(active) {
        *d = if *active > T::zero() { *d } else { T::zero() };
    }
}

/// Adds the gradient of a layer's parameters, computed from the derivatives `d` with respect to the layer's outputs.
#[inline(always)]
fn add_gradient<T: Real>(layer: &Layer, d: &[T], x: &[T], rows: usize, g: &mut [T]) {
    let (d_view, x) = (View::new(d, rows, layer.outputs), View::new(x, rows, layer.inputs));
    multiply(&mut g[layer.at..layer.bias()], layer.inputs, Output::Add, d_view.t(), x);
    add_rows(d, layer.outputs, &mut g[layer.bias()..layer.end()]);
}

/// Computes the derivatives with respect to a layer's inputs, which are outputs of a ReLU.
#[inline(always)]
fn input_derivatives<T: Real>(p: &[T], layer: &Layer, d: &[T], rows: usize, before: &[T], to: &mut Vec<T>) {
    resize(to, rows * layer.inputs);
    multiply(to, layer.inputs, Output::Replace, View::new(d, rows, layer.outputs), layer.w(p));
    mask(before, to);
}
