//! Layers of perceptrons for the control path: small, without memory allocation, and with bit-identical results on
//! every machine.
//!
//! Every output is a sum over the inputs in their order, with multiplications and additions only (none fused). So
//! blocking and vector width change the speed, not the result. `Instructions` selects the vector width at run time.

/// Number of outputs computed at once: eight 128-bit or four 256-bit registers per row.
const BLOCK: usize = 32;

type Lanes = [f32; BLOCK];

/// Processor instruction set for which the loops of a network's layers are compiled. The choice changes the speed, not
/// the results.
#[derive(Clone, Copy, Debug)]
pub enum Instructions {
    /// The instructions that every machine of the compilation target has.
    Baseline,
    /// The widest vector instructions that this machine has. In a program built without the feature `wide`, these are
    /// the baseline instructions.
    Detected,
}

impl Instructions {
    /// Calls `work`, compiled for this instruction set, and returns its result.
    #[inline(always)]
    pub fn run<R>(self, work: impl FnOnce() -> R) -> R {
        match self {
            #[cfg(feature = "wide")]
            Instructions::Detected => {
                // The result is returned through an option, because the dispatched closure's type is not generic.
                let mut result = None;
                pulp::Arch::new().dispatch(
                    #[inline(always)]
                    || result = Some(work()),
                );
                result.expect("a dispatched operation runs once")
            }
            _ => work(),
        }
    }
}

/// One linear layer of a perceptron, y = W x + b, with its weights W and biases b.
#[derive(Clone, Debug)]
pub struct Layer {
    inputs: usize,
    outputs: usize,
    /// Weights by block of outputs, then by input, then by output in the block; padded with zeros.
    weight: Vec<Lanes>,
    bias: Vec<Lanes>,
}

impl Layer {
    /// Makes a layer. `weight` is the row-major matrix \[outputs, inputs\], and `bias` has one number per output.
    ///
    /// # Panics
    /// If the length of `weight` is not a multiple of the number of outputs, or if there are no outputs.
    pub(crate) fn new(weight: &[f32], bias: &[f32]) -> Layer {
        let outputs = bias.len();
        let inputs = weight.len() / outputs;
        assert_eq!(weight.len(), inputs * outputs, "a layer's matrix has outputs x inputs entries");
        let blocks = outputs.div_ceil(BLOCK);
        let at = |block: usize, lane: usize| block * BLOCK + lane;
        let mut packed = Layer { inputs, outputs, weight: Vec::new(), bias: Vec::new() };
        for block in 0..blocks {
            let lanes = |pick: &dyn Fn(usize) -> f32| {
                std::array::from_fn(|lane| if at(block, lane) < outputs { pick(at(block, lane)) } else { 0.0 })
            };
            packed.bias.push(lanes(&|output| bias[output]));
            for input in 0..inputs {
                packed.weight.push(lanes(&|output| weight[output * inputs + input]));
            }
        }
        packed
    }

    /// Returns the number of inputs of the layer.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Returns the number of outputs of the layer.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Applies the layer to `rows` independent inputs: `x` is \[rows, inputs\], and `y` receives \[rows, outputs\],
    /// both row-major. `relu` is the activation of the outputs.
    #[inline(always)]
    pub(crate) fn apply(&self, rows: usize, x: &[f32], y: &mut [f32], relu: Relu) {
        for (block, bias) in self.bias.iter().enumerate() {
            self.apply_block(block, bias, rows, x, y, relu);
        }
    }

    /// Applies the layer like `apply`, but adds `start`, one number per output, to each row instead of the layer's
    /// bias. `x` is \[rows, inputs\], `y` receives \[rows, outputs\], both row-major; `relu` is the activation of the
    /// outputs.
    #[inline(always)]
    pub(crate) fn apply_from(&self, start: &[f32], rows: usize, x: &[f32], y: &mut [f32], relu: Relu) {
        for (block, start) in start[..self.outputs].chunks(BLOCK).enumerate() {
            let mut padded = [0.0; BLOCK];
            padded[..start.len()].copy_from_slice(start);
            self.apply_block(block, &padded, rows, x, y, relu);
        }
    }

    #[inline(always)]
    fn apply_block(&self, block: usize, start: &Lanes, rows: usize, x: &[f32], y: &mut [f32], relu: Relu) {
        let (x, y) = (&x[..rows * self.inputs], &mut y[..rows * self.outputs]);
        let weight = &self.weight[block * self.inputs..(block + 1) * self.inputs];
        let from = block * BLOCK;
        let to = self.outputs.min(from + BLOCK);
        // Two rows at once, so that each loaded weight is used twice; then the odd row.
        let (mut x_pairs, mut y_pairs) = (x.chunks_exact(2 * self.inputs), y.chunks_exact_mut(2 * self.outputs));
        for (x, y) in (&mut x_pairs).zip(&mut y_pairs) {
            let (x, y) = (x.split_at(self.inputs), y.split_at_mut(self.outputs));
            let (first, second) = two_rows(weight, start, x);
            relu.store(first, &mut y.0[from..to]);
            relu.store(second, &mut y.1[from..to]);
        }
        let (x, y) = (x_pairs.remainder(), y_pairs.into_remainder());
        if !x.is_empty() {
            relu.store(one_row(weight, start, x), &mut y[from..to]);
        }
    }

    /// Returns the weight with which the input with index `input` enters the output with index `output`.
    fn entry(&self, output: usize, input: usize) -> f32 {
        self.weight[output / BLOCK * self.inputs + input][output % BLOCK]
    }

    /// Splits the layer by its inputs into two layers, of which the sum of outputs equals this layer's output. The
    /// first takes the inputs before index `at` and has the bias. The second takes the remaining inputs and has a bias
    /// of zero.
    ///
    /// To get the same bits as with one layer, pass the first layer's output as `start` to the second layer's
    /// `apply_from`.
    pub(crate) fn split(&self, at: usize) -> (Layer, Layer) {
        let part = |inputs: std::ops::Range<usize>, bias: &[f32]| {
            let row = |output: usize| inputs.clone().map(move |input| self.entry(output, input));
            Layer::new(&(0..self.outputs).flat_map(row).collect::<Vec<f32>>(), bias)
        };
        let bias = &self.bias.as_flattened()[..self.outputs];
        (part(0..at, bias), part(at..self.inputs, &vec![0.0; self.outputs]))
    }

    /// Folds two layers into one: `inner` followed by this layer, without an activation between them. Returns the
    /// folded layer, which has the bias of this layer only. The second value is the bias of `inner` multiplied by this
    /// layer's weights, one number per output.
    ///
    /// The products are computed in f64, so that a network keeps its accuracy.
    ///
    /// # Panics
    /// If `inner` does not have as many outputs as this layer has inputs.
    pub(crate) fn fold_after(&self, inner: &Layer) -> (Layer, Vec<f32>) {
        assert_eq!(inner.outputs, self.inputs, "layers fit each other");
        let sum = |output: usize, term: &dyn Fn(usize) -> f32| -> f32 {
            (0..self.inputs).map(|k| f64::from(self.entry(output, k)) * f64::from(term(k))).sum::<f64>() as f32
        };
        let weight: Vec<f32> = (0..self.outputs)
            .flat_map(|output| (0..inner.inputs).map(move |input| (output, input)))
            .map(|(output, input)| sum(output, &|k| inner.entry(k, input)))
            .collect();
        let bias = |layer: &Layer, k: usize| layer.bias[k / BLOCK][k % BLOCK];
        let own: Vec<f32> = (0..self.outputs).map(|output| bias(self, output)).collect();
        let inner_bias = (0..self.outputs).map(|output| sum(output, &|k| bias(inner, k))).collect();
        (Layer::new(&weight, &own), inner_bias)
    }
}

#[inline(always)]
fn one_row(weight: &[Lanes], bias: &Lanes, x: &[f32]) -> Lanes {
    let mut sum = *bias;
    for (lanes, &x) in weight.iter().zip(x) {
        for lane in 0..BLOCK {
            sum[lane] += lanes[lane] * x;
        }
    }
    sum
}

#[inline(always)]
fn two_rows(weight: &[Lanes], bias: &Lanes, x: (&[f32], &[f32])) -> (Lanes, Lanes) {
    let (mut first, mut second) = (*bias, *bias);
    for ((lanes, &x0), &x1) in weight.iter().zip(x.0).zip(x.1) {
        for lane in 0..BLOCK {
            first[lane] += lanes[lane] * x0;
            second[lane] += lanes[lane] * x1;
        }
    }
    (first, second)
}

/// Activation function that a layer applies to its outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Relu {
    /// Rectified linear unit: an output y becomes max(0, y).
    After,
    /// No activation: outputs stay as they are.
    None,
}

impl Relu {
    #[inline(always)]
    fn store(self, mut sum: Lanes, y: &mut [f32]) {
        if self == Relu::After {
            sum.iter_mut().for_each(|lane| *lane = lane.max(0.0));
        }
        match <&mut Lanes>::try_from(&mut *y) {
            // A length known at compile time avoids a call to memcpy.
            Ok(whole) => *whole = sum,
            Err(_) => y.copy_from_slice(&sum[..y.len()]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layer_is_a_matrix_a_bias_and_relu() {
        let layer = Layer::new(&[1.0, 2.0, -3.0, 4.0, 0.0, 1.0], &[0.5, 0.0, -1.0]);
        let (x, mut y) = ([1.0, 1.0, 2.0, -1.0], [0.0; 6]);
        layer.apply(2, &x, &mut y, Relu::None);
        assert_eq!(y, [3.5, 1.0, 0.0, 0.5, -10.0, -2.0]);
        layer.apply(2, &x, &mut y, Relu::After);
        assert_eq!(y, [3.5, 1.0, 0.0, 0.5, 0.0, 0.0]);
    }

    #[test]
    fn a_split_layer_gives_the_same_bits_as_the_whole() {
        let pseudo = |k: usize| ((k * 7919 + 13) % 1009) as f32 / 500.0 - 1.0;
        let weight: Vec<f32> = (0..37 * 9).map(pseudo).collect();
        let layer = Layer::new(&weight, &weight[5..42]);
        let x: Vec<f32> = (40..49).map(pseudo).collect();
        let (mut whole, mut start, mut parts) = ([0.0; 37], [0.0; 37], [0.0; 37]);
        layer.apply(1, &x, &mut whole, Relu::After);
        let (first, second) = layer.split(4);
        assert_eq!((first.inputs(), second.inputs()), (4, 5));
        first.apply(1, &x[..4], &mut start, Relu::None);
        second.apply_from(&start, 1, &x[4..], &mut parts, Relu::After);
        assert_eq!(parts, whole);
    }
}
