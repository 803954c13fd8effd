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

/// Linear layers applied one after the other, with one activation between them and one after the last. Without any
/// layer it returns its input.
#[derive(Clone, Debug)]
pub(crate) struct Perceptron {
    inputs: usize,
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
        Perceptron { inputs: layers[0].inputs(), layers, between, last }
    }

    /// Makes what returns its input of `inputs` floats.
    pub(crate) fn unchanged(inputs: usize) -> Perceptron {
        Perceptron { inputs, layers: Vec::new(), between: Activation::Linear, last: Activation::Linear }
    }

    /// Returns the number of inputs.
    pub(crate) fn inputs(&self) -> usize {
        self.inputs
    }

    /// Returns the number of outputs.
    pub(crate) fn outputs(&self) -> usize {
        self.layers.last().map_or(self.inputs, Layer::outputs)
    }

    /// Splits the first layer by its inputs: returns the part that takes the inputs before index `at`, and the
    /// perceptron of all other inputs, for `apply_from` with the output of that part; `None` if there is no layer, or
    /// no other input.
    pub(crate) fn split(&self, at: usize) -> Option<(Layer, Perceptron)> {
        let (first, rest) = self.layers.split_first().filter(|_| at < self.inputs)?;
        let (part, other) = first.split(at);
        let layers = [&[other], rest].concat();
        Some((part, Perceptron { inputs: self.inputs - at, layers, ..*self }))
    }

    /// Applies all layers to `rows` independent inputs: `x` is \[rows, inputs\], and `y` receives \[rows, outputs\],
    /// both row-major. `buffers` has room for as many rows of this perceptron, made by [`Buffers::reserve`].
    #[inline(always)]
    pub(crate) fn apply(&self, rows: usize, x: &[f32], y: &mut [f32], buffers: &mut Buffers) {
        self.apply_from(None, rows, x, y, buffers);
    }

    /// Applies all layers like `apply`. The numbers `start`, one for each output of the first layer, take the place of
    /// that layer's bias if they are given.
    #[inline(always)]
    pub(crate) fn apply_from(
        &self,
        start: Option<&[f32]>,
        rows: usize,
        x: &[f32],
        y: &mut [f32],
        buffers: &mut Buffers,
    ) {
        if self.layers.is_empty() {
            y[..rows * self.inputs].copy_from_slice(&x[..rows * self.inputs]);
        }
        let (mut from, mut to) = (&mut buffers.0, &mut buffers.1);
        for (depth, layer) in self.layers.iter().enumerate() {
            let x = if depth == 0 { x } else { &from[..] };
            let (y, activation) =
                if depth + 1 == self.layers.len() { (&mut *y, self.last) } else { (&mut to[..], self.between) };
            let relu = if matches!(activation, Activation::Relu) { Relu::After } else { Relu::None };
            match start.filter(|_| depth == 0) {
                Some(start) => layer.apply_from(start, rows, x, y, relu),
                None => layer.apply(rows, x, y, relu),
            }
            if relu == Relu::None {
                activation.apply(&mut y[..rows * layer.outputs()]);
            }
            std::mem::swap(&mut from, &mut to);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::mlp::Instructions;

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
        assert_eq!((perceptron.inputs(), perceptron.outputs()), (1, 1));
        Perceptron::unchanged(2).apply(1, &[3.0, 4.0], &mut y, &mut buffers);
        assert_eq!(y, [3.0, 4.0]);
    }

    #[test]
    fn the_bits_depend_neither_on_instructions_nor_on_the_number_of_rows_nor_on_a_split() {
        let pseudo = |k: usize| ((k * 7919 + 13) % 1009) as f32 / 500.0 - 1.0;
        let layer = |inputs: usize, outputs: usize| {
            let weight: Vec<f32> = (0..inputs * outputs).map(pseudo).collect();
            Layer::new(&weight, &weight[..outputs])
        };
        let layers = vec![layer(6, 37), layer(37, 64), layer(64, 5)];
        let perceptron = Perceptron::new(layers, Activation::Relu, Activation::Linear);
        let x: Vec<f32> = (0..6 * 7).map(pseudo).collect();
        let mut buffers = Buffers::default();
        buffers.reserve(&perceptron, 7);
        let mut apply = |instructions: Instructions| {
            let mut y = vec![0.0; 35];
            instructions.run(|| perceptron.apply(7, &x, &mut y, &mut buffers));
            y
        };
        let all = apply(Instructions::Baseline);
        assert_eq!(all, apply(Instructions::Detected));
        let mut alone = [0.0; 5];
        perceptron.apply(1, &x[6..12], &mut alone, &mut buffers);
        assert_eq!(alone, all[5..10]);
        let (part, rest) = perceptron.split(4).expect("there are other inputs");
        let (mut start, mut split) = ([0.0; 37], [0.0; 5]);
        part.apply(1, &x[6..10], &mut start, Relu::None);
        rest.apply_from(Some(&start), 1, &x[10..12], &mut split, &mut buffers);
        assert_eq!(split, alone);
        assert!(perceptron.split(6).is_none());
    }
}
