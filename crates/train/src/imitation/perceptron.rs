//! Multi-layer perceptrons of policies of several hops over many rows, forward and backward.

use crate::matrix::{Output, Real, View, multiply};
use crate::network::{Layer, resize};
use murmurate::policy::hops::manifest::Layers;
use murmurate::policy::hops::perceptron::Activation;

/// Activation that training supports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Linear,
    Relu,
    Tanh,
}

impl Kind {
    /// Returns the activation of a manifest; `None` if training does not support it.
    fn of(activation: Activation) -> Option<Kind> {
        match activation {
            Activation::Linear => Some(Kind::Linear),
            Activation::Relu => Some(Kind::Relu),
            Activation::Tanh => Some(Kind::Tanh),
            Activation::Elu | Activation::LeakyRelu(_) => None,
        }
    }

    #[inline(always)]
    fn apply<T: Real>(self, outputs: &mut [T]) {
        match self {
            Kind::Linear => {}
            Kind::Relu => outputs.iter_mut().for_each(|y| *y = if *y > T::zero() { *y } else { T::zero() }),
            Kind::Tanh => outputs.iter_mut().for_each(|y| {
                let two = T::one() + T::one();
                *y = T::one() - two / ((two * *y).exponential() + T::one());
            }),
        }
    }

    /// Replaces the derivatives `d` by the activation's outputs `y` by those by its inputs.
    #[inline(always)]
    fn back<T: Real>(self, y: &[T], d: &mut [T]) {
        match self {
            Kind::Linear => {}
            Kind::Relu => d.iter_mut().zip(y).filter(|(_, y)| **y <= T::zero()).for_each(|(d, _)| *d = T::zero()),
            Kind::Tanh => d.iter_mut().zip(y).for_each(|(d, y)| *d = *d * (T::one() - *y * *y)),
        }
    }
}

/// Layers of a perceptron, with the places of their weights among the parameters of a policy.
#[derive(Clone, Debug)]
pub struct Perceptron {
    layers: Vec<Layer>,
    between: Kind,
    last: Kind,
}

/// Buffers of a perceptron: outputs of its layers, and derivatives.
#[derive(Debug, Default)]
pub struct Space<T> {
    /// Outputs of each layer, \[rows, outputs\].
    outputs: Vec<Vec<T>>,
    /// Derivatives by the outputs of the current layer.
    d: Vec<T>,
    spare: Vec<T>,
}

impl<T> Space<T> {
    /// Returns the outputs of the last forward pass, \[rows, outputs\].
    pub fn outputs(&self) -> &[T] {
        self.outputs.last().map_or(&[], |outputs| outputs)
    }
}

impl Perceptron {
    /// Makes the perceptron of a manifest's `layers`. Its parameters begin at `at`, which is moved to their end. An
    /// error names the unsupported activation.
    pub fn new(layers: &Layers, at: &mut usize) -> Result<Perceptron, String> {
        let place = |pair: &[usize]| {
            let layer = Layer { inputs: pair[0], outputs: pair[1], at: *at };
            *at = layer.end();
            layer
        };
        let placed = layers.widths.windows(2).map(place).collect();
        let kind = |field: &str, activation: Activation| {
            Kind::of(activation)
                .ok_or_else(|| format!("{field}: training supports 'linear', 'relu' and 'tanh', not {activation:?}"))
        };
        let between = kind("activation", layers.activation.unwrap_or_default())?;
        Ok(Perceptron { layers: placed, between, last: kind("output_activation", layers.output_activation)? })
    }

    /// Returns the width of the input.
    pub fn inputs(&self) -> usize {
        self.layers[0].inputs
    }

    /// Returns the width of the output.
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs
    }

    /// Returns for each layer the number of its inputs, and the places of its weights and biases: the begin of the
    /// weights, the begin of the biases and their end.
    pub fn places(&self) -> impl Iterator<Item = [usize; 4]> + '_ {
        self.layers.iter().map(|layer| [layer.inputs, layer.at, layer.bias(), layer.end()])
    }

    fn activation(&self, depth: usize) -> Kind {
        if depth + 1 == self.layers.len() { self.last } else { self.between }
    }

    /// Applies all layers to `rows` inputs `x`, \[rows, inputs\]; the outputs are in `space`.
    #[inline(always)]
    pub fn forward<T: Real>(&self, p: &[T], x: &[T], rows: usize, space: &mut Space<T>) {
        space.outputs.resize_with(self.layers.len(), Vec::new);
        for (depth, layer) in self.layers.iter().enumerate() {
            let (from, to) = space.outputs.split_at_mut(depth);
            let x = if depth == 0 { x } else { &from[depth - 1] };
            let y = &mut to[0];
            resize(y, rows * layer.outputs);
            for row in y.chunks_exact_mut(layer.outputs) {
                row.copy_from_slice(layer.b(p));
            }
            multiply(y, layer.outputs, Output::Add, View::new(x, rows, layer.inputs), layer.w(p).t());
            self.activation(depth).apply(y);
        }
    }

    /// Adds the gradient of the parameters to `g`, for the derivatives `d_outputs` by the outputs of the last forward
    /// pass, whose inputs were `x`. Returns the derivatives by the inputs, \[rows, inputs\].
    #[inline(always)]
    pub fn backward<'a, T: Real>(
        &self,
        p: &[T],
        x: &[T],
        rows: usize,
        d_outputs: &[T],
        space: &'a mut Space<T>,
        g: &mut [T],
    ) -> &'a [T] {
        let Space { outputs, d, spare } = space;
        d.clear();
        d.extend_from_slice(d_outputs);
        if rows == 0 {
            return d;
        }
        for (depth, layer) in self.layers.iter().enumerate().rev() {
            self.activation(depth).back(&outputs[depth], d);
            let x = if depth == 0 { x } else { &outputs[depth - 1] };
            let derivatives = View::new(d, rows, layer.outputs);
            multiply(&mut g[layer.at..], layer.inputs, Output::Add, derivatives.t(), View::new(x, rows, layer.inputs));
            let bias = &mut g[layer.bias()..layer.end()];
            for row in d.chunks_exact(layer.outputs) {
                bias.iter_mut().zip(row).for_each(|(sum, d)| *sum += *d);
            }
            resize(spare, rows * layer.inputs);
            multiply(spare, layer.inputs, Output::Replace, derivatives, layer.w(p));
            std::mem::swap(d, spare);
        }
        d
    }
}
