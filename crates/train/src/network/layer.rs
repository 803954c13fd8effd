//! Layers of a network: their places among its parameters, their activations, and both passes over many rows.

use std::ops::Range;

use crate::matrix::{Output, Real, View, multiply};

/// Activation after a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// No activation.
    Linear,
    /// Rectified linear unit: max(x, 0).
    Relu,
    /// Hyperbolic tangent.
    Tanh,
}

impl Activation {
    /// Applies the activation in place.
    #[inline(always)]
    pub(super) fn apply<T: Real>(self, outputs: &mut [T]) {
        match self {
            Activation::Linear => {}
            Activation::Relu => outputs.iter_mut().for_each(|y| *y = relu(*y)),
            Activation::Tanh => outputs.iter_mut().for_each(|y| *y = tanh(*y)),
        }
    }

    /// Adds `bias` to every row of `rows`, then applies the activation.
    #[inline(always)]
    pub(super) fn apply_with_bias<T: Real>(self, bias: &[T], rows: &mut [T]) {
        let width = bias.len();
        for row in rows.chunks_exact_mut(width) {
            if self == Activation::Relu {
                for k in 0..width {
                    row[k] = relu(row[k] + bias[k]);
                }
            } else {
                for k in 0..width {
                    row[k] += bias[k];
                }
                self.apply(row);
            }
        }
    }

    /// Writes the derivatives with respect to the activation's inputs to `to`, from those with respect to its outputs
    /// `y`.
    #[inline(always)]
    pub(super) fn write_back<T: Real>(self, y: &[T], d: &[T], to: &mut [T]) {
        match self {
            Activation::Linear => to.copy_from_slice(d),
            Activation::Relu => {
                for ((to, d), y) in to.iter_mut().zip(d).zip(y) {
                    *to = if *y > T::zero() { *d } else { T::zero() };
                }
            }
            Activation::Tanh => {
                to.iter_mut().zip(d).zip(y).for_each(|((to, d), y)| *to = *d * (T::one() - *y * *y));
            }
        }
    }

    /// Replaces the derivatives `d` with respect to the activation's outputs `y` by those with respect to its inputs.
    #[inline(always)]
    pub(super) fn back<T: Real>(self, y: &[T], d: &mut [T]) {
        match self {
            Activation::Linear => {}
            Activation::Relu => {
                d.iter_mut().zip(y).for_each(|(d, y)| *d = if *y > T::zero() { *d } else { T::zero() });
            }
            Activation::Tanh => d.iter_mut().zip(y).for_each(|(d, y)| *d = *d * (T::one() - *y * *y)),
        }
    }
}

#[inline(always)]
fn relu<T: Real>(x: T) -> T {
    if x > T::zero() { x } else { T::zero() }
}

/// Returns the hyperbolic tangent, with the same result on every platform.
#[inline(always)]
pub(super) fn tanh<T: Real>(x: T) -> T {
    let two = T::one() + T::one();
    T::one() - two / ((two * x).exponential() + T::one())
}

/// Returns the logistic function 1 / (1 + exp(-x)), with the same result on every platform.
#[inline(always)]
pub(super) fn sigmoid<T: Real>(x: T) -> T {
    T::one() / (T::one() + (-x).exponential())
}

/// Layer with its position in the parameter vector: weight \[outputs, inputs\], then bias \[outputs\].
#[derive(Clone, Copy, Debug)]
pub struct Layer {
    /// Number of inputs of the layer.
    pub inputs: usize,
    /// Number of outputs of the layer.
    pub outputs: usize,
    /// Activation after the layer.
    pub activation: Activation,
    /// Index of the layer's first weight in the parameter vector.
    pub at: usize,
}

impl Layer {
    /// Places a layer in the parameter vector at the index `at`, which moves to the layer's end.
    pub(super) fn placed(inputs: usize, outputs: usize, activation: Activation, at: &mut usize) -> Layer {
        let layer = Layer { inputs, outputs, activation, at: *at };
        *at = layer.end();
        layer
    }

    /// Returns the index of the layer's first bias in the parameter vector.
    pub fn bias(&self) -> usize {
        self.at + self.inputs * self.outputs
    }

    /// Returns the index after the layer's last bias in the parameter vector.
    pub fn end(&self) -> usize {
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

    /// Writes each of the columns `from..from + width` of the layer's weight matrix as a row of `to`.
    #[inline(always)]
    pub(super) fn transpose_columns<T: Real>(&self, p: &[T], from: usize, width: usize, to: &mut Vec<T>) {
        to.clear();
        for column in from..from + width {
            to.extend((0..self.outputs).map(|row| p[self.at + row * self.inputs + column]));
        }
    }

    /// Applies the layer and its activation to all rows of `x`, and writes the result to `y`.
    #[inline(always)]
    pub(super) fn apply<T: Real>(&self, p: &[T], x: &[T], rows: usize, y: &mut Vec<T>) {
        resize(y, rows * self.outputs);
        multiply(y, self.outputs, Output::Replace, View::new(x, rows, self.inputs), self.w(p).t());
        self.activation.apply_with_bias(self.b(p), y);
    }

    /// Adds the gradient of the layer's parameters, computed from the derivatives `d` with respect to its outputs.
    #[inline(always)]
    pub(super) fn add_gradient<T: Real>(&self, d: &[T], x: &[T], rows: usize, g: &mut [T]) {
        let (d_view, x) = (View::new(d, rows, self.outputs), View::new(x, rows, self.inputs));
        multiply(&mut g[self.at..self.bias()], self.inputs, Output::Add, d_view.t(), x);
        add_rows(d, self.outputs, &mut g[self.bias()..self.end()]);
    }

    /// Computes the derivatives with respect to the layer's inputs.
    #[inline(always)]
    pub(super) fn input_derivatives<T: Real>(&self, p: &[T], d: &[T], rows: usize, to: &mut Vec<T>) {
        resize(to, rows * self.inputs);
        multiply(to, self.inputs, Output::Replace, View::new(d, rows, self.outputs), self.w(p));
    }
}

/// Derivatives with respect to the current layer's outputs, and a buffer for the next ones.
pub(super) type Back<T> = [Vec<T>; 2];

/// Layers that are applied one after the other, with the places of their weights among the parameters of a network.
#[derive(Clone, Debug)]
pub(super) struct Perceptron {
    /// Layers in the order of application.
    pub(super) layers: Vec<Layer>,
}

impl Perceptron {
    /// Places layers of these widths in the parameter vector at the index `at`, which moves to their end. There is the
    /// activation `between` between layers, and `last` after the last one.
    pub(super) fn placed(widths: &[usize], (between, last): (Activation, Activation), at: &mut usize) -> Perceptron {
        let depth = widths.len() - 1;
        let activation = |index: usize| if index + 1 == depth { last } else { between };
        let pairs = widths.windows(2).enumerate();
        let layers = pairs.map(|(index, pair)| Layer::placed(pair[0], pair[1], activation(index), at)).collect();
        Perceptron { layers }
    }

    /// Returns the width of the input.
    pub(super) fn inputs(&self) -> usize {
        self.layers[0].inputs
    }

    /// Returns the width of the output.
    pub(super) fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs
    }

    /// Returns the activation after the layer with the index `depth`.
    pub(super) fn activation(&self, depth: usize) -> Activation {
        self.layers[depth].activation
    }

    /// Applies the layer with the index `depth`, which is not the first, to the outputs of the one before it.
    #[inline(always)]
    pub(super) fn apply<T: Real>(&self, depth: usize, p: &[T], rows: usize, outputs: &mut [Vec<T>]) {
        let (from, to) = outputs.split_at_mut(depth);
        self.layers[depth].apply(p, &from[depth - 1], rows, &mut to[0]);
    }

    /// Applies all layers to `x`, \[rows, inputs\], and keeps the output of each layer.
    #[inline(always)]
    pub(super) fn forward<T: Real>(&self, p: &[T], x: &[T], rows: usize, outputs: &mut Vec<Vec<T>>) {
        outputs.resize_with(self.layers.len(), Vec::new);
        self.layers[0].apply(p, x, rows, &mut outputs[0]);
        (1..self.layers.len()).for_each(|depth| self.apply(depth, p, rows, outputs));
    }

    /// Backward pass of the layers with the indices `depths`, none of which is the first. `back` holds the derivatives
    /// with respect to the last one's outputs before its activation, and then those of the layer before the first.
    #[inline(always)]
    pub(super) fn back<T: Real>(
        &self,
        depths: Range<usize>,
        p: &[T],
        rows: usize,
        outputs: &[Vec<T>],
        back: &mut Back<T>,
        g: &mut [T],
    ) {
        for depth in depths.rev() {
            let (layer, x) = (&self.layers[depth], &outputs[depth - 1]);
            let [d, spare] = back;
            layer.add_gradient(d, x, rows, g);
            layer.input_derivatives(p, d, rows, spare);
            self.activation(depth - 1).back(x, spare);
            back.swap(0, 1);
        }
    }

    /// Backward pass of all layers but for the derivatives with respect to the inputs `x`. `back` holds the derivatives
    /// with respect to the outputs, and then those with respect to the first layer's outputs before its activation.
    #[inline(always)]
    pub(super) fn backward<T: Real>(
        &self,
        p: &[T],
        x: &[T],
        rows: usize,
        outputs: &[Vec<T>],
        back: &mut Back<T>,
        g: &mut [T],
    ) {
        let depth = self.layers.len();
        self.activation(depth - 1).back(&outputs[depth - 1], &mut back[0]);
        self.back(1..depth, p, rows, outputs, back, g);
        self.layers[0].add_gradient(&back[0], x, rows, g);
    }
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

/// Adds all rows to `sum`.
#[inline(always)]
pub(super) fn add_rows<T: Real>(rows: &[T], width: usize, sum: &mut [T]) {
    rows.chunks_exact(width).for_each(|row| add(sum, row));
}
