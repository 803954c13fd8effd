//! Memory of a network, a gated recurrent unit (GRU; Cho et al., arXiv 1406.1078), through successive steps: forward
//! and backward pass. The equations are those of PyTorch's `GRUCell`.
//!
//! With x the encoded observation, h the state before and s the logistic function, the state after is
//! h' = (1 - z) n + z h, with r = s(W_ir x + b_ir + W_hr h + b_hr), z = s(W_iz x + b_iz + W_hz h + b_hz) and
//! n = tanh(W_in x + b_in + r (W_hn h + b_hn)). The rows of the weights are those of r, z and n in this order.

use super::layer::{Activation, Back, Layer, add, add_rows, resize, sigmoid, tanh};
use crate::batch::Scan;
use crate::matrix::{Output, Real, View, multiply};

/// Layers of the memory in the parameter vector.
#[derive(Clone, Debug)]
pub(super) struct Memory {
    /// Number of floats of the state.
    pub(super) floats: usize,
    /// Layer of the encoded observation, with three outputs for each float.
    pub(super) input: Layer,
    /// Layer of the state before, with three outputs for each float.
    pub(super) state: Layer,
}

/// Buffers of the memory; all matrices are row-major, and in the order of the scan unless said.
#[derive(Debug, Default)]
pub(super) struct MemorySpace<T> {
    /// States after each step, \[nodes, floats\], in the order of the nodes.
    pub(super) after: Vec<T>,
    /// Outputs of the layer of the encoded observation, in the order of the nodes.
    of_input: Vec<T>,
    /// Outputs of the layer of the state before, without its bias.
    of_state: Vec<T>,
    before: Vec<T>,
    /// Values of r, z and n.
    gates: Vec<T>,
    d_after: Vec<T>,
    /// Derivatives with respect to `of_input`, in the order of the nodes.
    d_of_input: Vec<T>,
    d_of_state: Vec<T>,
    d_before: Vec<T>,
}

impl Memory {
    /// Places a memory of `floats` floats, of an input of `inputs`, in the parameter vector at the index `at`, which
    /// moves to its end.
    pub(super) fn placed(inputs: usize, floats: usize, at: &mut usize) -> Memory {
        let input = Layer::placed(inputs, 3 * floats, Activation::Linear, at);
        Memory { floats, input, state: Layer::placed(floats, 3 * floats, Activation::Linear, at) }
    }

    /// Computes the states after each step from the encoded observations `x` of all nodes.
    #[inline(always)]
    pub(super) fn forward<T: Real>(&self, p: &[T], x: &[T], scan: &Scan<T>, space: &mut MemorySpace<T>) {
        let (nodes, n, bias) = (scan.order.len(), self.floats, self.state.b(p));
        let MemorySpace { after, of_input, of_state, before, gates, .. } = space;
        self.input.apply(p, x, nodes, of_input);
        resize(after, nodes * n);
        resize(before, nodes * n);
        resize(of_state, nodes * 3 * n);
        resize(gates, nodes * 3 * n);
        for step in scan.start.windows(2) {
            let (from, to) = (step[0] as usize, step[1] as usize);
            for (row, node) in scan.order[from..to].iter().enumerate() {
                let source = scan.before[*node as usize] as usize;
                let source = match source.checked_sub(nodes) {
                    None => &after[source * n..][..n],
                    Some(recorded) => &scan.state[recorded * n..][..n],
                };
                before[(from + row) * n..][..n].copy_from_slice(source);
            }
            let states = View::new(&before[from * n..to * n], to - from, n);
            let outputs = &mut of_state[from * 3 * n..to * 3 * n];
            multiply(outputs, 3 * n, Output::Replace, states, self.state.w(p).t());
            for at in from..to {
                let node = scan.order[at] as usize;
                let (x, h) = (&of_input[node * 3 * n..][..3 * n], &mut of_state[at * 3 * n..][..3 * n]);
                add(h, bias);
                let (gates, before) = (&mut gates[at * 3 * n..][..3 * n], &before[at * n..][..n]);
                for k in 0..2 * n {
                    gates[k] = sigmoid(x[k] + h[k]);
                }
                for k in 0..n {
                    gates[2 * n + k] = tanh(x[2 * n + k] + gates[k] * h[2 * n + k]);
                }
                for (k, after) in after[node * n..][..n].iter_mut().enumerate() {
                    let z = gates[n + k];
                    *after = (T::one() - z) * gates[2 * n + k] + z * before[k];
                }
            }
        }
    }

    /// Adds the gradient of the memory's parameters to `g`. `back` holds the derivatives with respect to the states
    /// after each step as inputs of the first hop, and then those with respect to the encoded observations `x`.
    #[inline(always)]
    pub(super) fn backward<T: Real>(
        &self,
        p: &[T],
        x: &[T],
        scan: &Scan<T>,
        space: &mut MemorySpace<T>,
        back: &mut Back<T>,
        g: &mut [T],
    ) {
        let (nodes, n) = (scan.order.len(), self.floats);
        let MemorySpace { of_state, before, gates, d_after, d_of_input, d_of_state, d_before, .. } = space;
        std::mem::swap(d_after, &mut back[0]);
        resize(d_of_input, nodes * 3 * n);
        resize(d_of_state, nodes * 3 * n);
        for step in scan.start.windows(2).rev() {
            let (from, to) = (step[0] as usize, step[1] as usize);
            resize(d_before, (to - from) * n);
            for at in from..to {
                let node = scan.order[at] as usize;
                let (gates, h) = (&gates[at * 3 * n..][..3 * n], &of_state[at * 3 * n..][..3 * n]);
                let (d_x, d_h) = (&mut d_of_input[node * 3 * n..][..3 * n], &mut d_of_state[at * 3 * n..][..3 * n]);
                let (d, before) = (&d_after[node * n..][..n], &before[at * n..][..n]);
                for k in 0..n {
                    let (r, z, new) = (gates[k], gates[n + k], gates[2 * n + k]);
                    let d_new = d[k] * (T::one() - z) * (T::one() - new * new);
                    let d_r = d_new * h[2 * n + k] * r * (T::one() - r);
                    let d_z = d[k] * (before[k] - new) * z * (T::one() - z);
                    (d_x[k], d_x[n + k], d_x[2 * n + k]) = (d_r, d_z, d_new);
                    (d_h[k], d_h[n + k], d_h[2 * n + k]) = (d_r, d_z, d_new * r);
                    d_before[(at - from) * n + k] = d[k] * z;
                }
            }
            let derivatives = View::new(&d_of_state[from * 3 * n..to * 3 * n], to - from, 3 * n);
            multiply(d_before, n, Output::Add, derivatives, self.state.w(p));
            for (d, node) in d_before.chunks_exact(n).zip(&scan.order[from..to]) {
                let source = scan.before[*node as usize] as usize;
                if source < nodes {
                    add(&mut d_after[source * n..][..n], d);
                }
            }
        }
        let derivatives = View::new(d_of_state, nodes, 3 * n);
        let states = View::new(before, nodes, n);
        multiply(&mut g[self.state.at..self.state.bias()], n, Output::Add, derivatives.t(), states);
        add_rows(d_of_state, 3 * n, &mut g[self.state.bias()..self.state.end()]);
        self.input.add_gradient(d_of_input, x, nodes, g);
        self.input.input_derivatives(p, d_of_input, nodes, &mut back[0]);
    }
}
