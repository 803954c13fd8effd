//! Multi-layer perceptrons with the activations of format 2: linear layers, each followed by an activation.
//!
//! The layers are those of `policy::mlp`, so results are the same bits on every machine; so are the activations, which
//! use `libm` and not the platform's mathematics.

use serde::{Deserialize, Serialize};

use crate::policy::mlp::{Layer, Relu};

/// Activation function after a linear layer, applied to each of its outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Activation {
    /// No activation: outputs stay as they are.
    #[default]
    Linear,
    /// Rectified linear unit: max(x, 0).
    Relu,
    /// Hyperbolic tangent.
    Tanh,
    /// Exponential linear unit: x if that is above 0, otherwise exp(x) - 1.
    Elu,
    /// Leaky rectified linear unit: x if that is above 0, otherwise x times this slope.
    LeakyRelu(f32),
}

impl Activation {
    /// Replaces each number of `outputs` by its activation.
    #[inline(always)]
    pub(crate) fn apply(self, outputs: &mut [f32]) {
        match self {
            Activation::Linear => {}
            Activation::Relu => outputs.iter_mut().for_each(|y| *y = y.max(0.0)),
            Activation::Tanh => outputs.iter_mut().for_each(|y| *y = libm::tanhf(*y)),
            Activation::Elu => outputs.iter_mut().filter(|y| **y <= 0.0).for_each(|y| *y = libm::expm1f(*y)),
            Activation::LeakyRelu(slope) => outputs.iter_mut().filter(|y| **y <= 0.0).for_each(|y| *y *= slope),
        }
    }
}

/// Linear layers applied one after the other, with one activation between them and one after the last.
#[derive(Clone, Debug)]
pub(crate) struct Perceptron {
    layers: Vec<Layer>,
    between: Activation,
    last: Activation,
}

/// Two buffers for the values between the layers of perceptrons, used alternately.
#[derive(Clone, Debug, Default)]
pub(crate) struct Buffers(Vec<f32>, Vec<f32>);

impl Buffers {
    /// Enlarges the buffers so that `perceptron` can be applied to `rows` independent inputs at once.
    pub(crate) fn reserve(&mut self, perceptron: &Perceptron, rows: usize) {
        let widest = perceptron.layers.iter().map(Layer::outputs).max().unwrap_or(0) * rows;
        [&mut self.0, &mut self.1]
            .into_iter()
            .filter(|buffer| buffer.len() < widest)
            .for_each(|b| b.resize(widest, 0.0));
    }
}

impl Perceptron {
    /// Makes a perceptron of `layers` in the order of application, with the activation `between` them and `last` after
    /// the last one.
    ///
    /// # Panics
    /// If there is no layer, or if a layer does not have as many inputs as the layer before it has outputs.
    pub(crate) fn new(layers: Vec<Layer>, between: Activation, last: Activation) -> Perceptron {
        assert!(!layers.is_empty(), "a perceptron has a layer");
        assert!(layers.windows(2).all(|pair| pair[0].outputs() == pair[1].inputs()), "layers fit each other");
        Perceptron { layers, between, last }
    }

    /// Returns the number of inputs of the first layer.
    pub(crate) fn inputs(&self) -> usize {
        self.layers[0].inputs()
    }

    /// Returns the number of outputs of the last layer.
    pub(crate) fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs()
    }

    /// Returns the number of weights and biases of all layers.
    pub(crate) fn parameters(&self) -> usize {
        self.layers.iter().map(|layer| (layer.inputs() + 1) * layer.outputs()).sum()
    }

    /// Applies all layers to `rows` independent inputs: `x` is \[rows, inputs\], and `y` receives \[rows, outputs\],
    /// both row-major. `buffers` has room for as many rows of this perceptron, made by [`Buffers::reserve`].
    #[inline(always)]
    pub(crate) fn apply(&self, rows: usize, x: &[f32], y: &mut [f32], buffers: &mut Buffers) {
        let (mut from, mut to) = (&mut buffers.0, &mut buffers.1);
        for (depth, layer) in self.layers.iter().enumerate() {
            let x = if depth == 0 { x } else { &from[..] };
            let (y, activation) =
                if depth + 1 == self.layers.len() { (&mut *y, self.last) } else { (&mut to[..], self.between) };
            layer.apply(rows, x, y, Relu::None);
            activation.apply(&mut y[..rows * layer.outputs()]);
            std::mem::swap(&mut from, &mut to);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_activation_is_its_formula() {
        let of = |activation: Activation| {
            let mut y = [-1.0, 0.0, 2.0];
            activation.apply(&mut y);
            y
        };
        assert_eq!(of(Activation::Linear), [-1.0, 0.0, 2.0]);
        assert_eq!(of(Activation::Relu), [0.0, 0.0, 2.0]);
        assert_eq!(of(Activation::LeakyRelu(0.25)), [-0.25, 0.0, 2.0]);
        let [a, b, c] = of(Activation::Tanh);
        assert!((a + 0.761_594_2).abs() < 1e-6 && b == 0.0 && (c - 0.964_027_6).abs() < 1e-6);
        let [a, b, c] = of(Activation::Elu);
        assert!((a + 0.632_120_6).abs() < 1e-6 && b == 0.0 && c == 2.0);
    }

    #[test]
    fn activations_come_between_layers_and_after_the_last() {
        let layers = vec![Layer::new(&[1.0, -1.0], &[0.0, 0.0]), Layer::new(&[1.0, 10.0], &[-30.0])];
        let perceptron = Perceptron::new(layers, Activation::Relu, Activation::LeakyRelu(0.5));
        let mut buffers = Buffers::default();
        buffers.reserve(&perceptron, 2);
        let mut y = [0.0; 2];
        perceptron.apply(2, &[2.0, -4.0], &mut y, &mut buffers);
        // relu(2, -2) = (2, 0): 2 - 30 = -28, halved; relu(-4, 4) = (0, 4): 40 - 30 = 10.
        assert_eq!(y, [-14.0, 10.0]);
        assert_eq!((perceptron.inputs(), perceptron.outputs(), perceptron.parameters()), (1, 1, 7));
    }
}
