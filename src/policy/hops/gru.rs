//! Gated recurrent unit (arXiv 1406.1078) in the form of PyTorch's `GRUCell`.

use crate::policy::mlp::{Layer, Relu};

/// Gated recurrent unit with its weights. Both layers have the outputs of the reset gate, the update gate and the new
/// state, one after the other.
#[derive(Clone, Debug)]
pub struct Gru {
    input: Layer,
    state: Layer,
}

impl Gru {
    /// Makes a unit of the layer that takes the input and of the layer that takes the state.
    ///
    /// # Panics
    /// If the layers have not three outputs for each float of the state.
    pub(crate) fn new(input: Layer, state: Layer) -> Gru {
        assert_eq!(
            (input.outputs(), state.outputs()),
            (3 * state.inputs(), 3 * state.inputs()),
            "layers fit each other"
        );
        Gru { input, state }
    }

    /// Returns the number of floats of the state.
    pub(crate) fn floats(&self) -> usize {
        self.state.inputs()
    }

    /// Computes the state after a step from the `input` and the state `before` it, and writes it into `after`. `gates`
    /// is a buffer of six times their length.
    #[inline(always)]
    pub(crate) fn apply(&self, input: &[f32], before: &[f32], after: &mut [f32], gates: &mut [f32]) {
        let floats = self.floats();
        let (of_input, of_state) = gates.split_at_mut(3 * floats);
        self.input.apply(1, input, of_input, Relu::None);
        self.state.apply(1, before, of_state, Relu::None);
        for (at, after) in after.iter_mut().enumerate() {
            let gate = |k: usize| [of_input[k * floats + at], of_state[k * floats + at]];
            let [reset, update] = [gate(0), gate(1)].map(|[input, state]| sigmoid(input + state));
            let [input, state] = gate(2);
            let new = libm::tanhf(input + reset * state);
            *after = (1.0 - update) * new + update * before[at];
        }
    }
}

/// Returns the logistic function 1 / (1 + exp(-x)).
fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + libm::expf(-x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_the_equations_of_the_unit() {
        let pseudo = |k: usize| ((k * 7919 + 13) % 1009) as f32 / 500.0 - 1.0;
        let numbers = |from: usize, count: usize| (from..from + count).map(pseudo).collect::<Vec<f32>>();
        let (weight, bias) = (numbers(0, 6 * 3), numbers(100, 6));
        let (state_weight, state_bias) = (numbers(200, 6 * 2), numbers(300, 6));
        let unit = Gru::new(Layer::new(&weight, &bias), Layer::new(&state_weight, &state_bias));
        let (input, before) = (numbers(400, 3), numbers(500, 2));
        let (mut after, mut gates) = ([0.0; 2], [0.0; 12]);
        unit.apply(&input, &before, &mut after, &mut gates);
        let row = |weight: &[f32], bias: &[f32], x: &[f32], row: usize| -> f64 {
            let of_row = &weight[row * x.len()..][..x.len()];
            of_row.iter().zip(x).map(|(w, x)| f64::from(*w) * f64::from(*x)).sum::<f64>() + f64::from(bias[row])
        };
        let logistic = |x: f64| 1.0 / (1.0 + (-x).exp());
        for at in 0..2 {
            let [from_input, from_state] = [0, 1].map(|which| {
                [at, at + 2, at + 4].map(|gate| match which {
                    0 => row(&weight, &bias, &input, gate),
                    _ => row(&state_weight, &state_bias, &before, gate),
                })
            });
            let [reset, update] = [0, 1].map(|gate| logistic(from_input[gate] + from_state[gate]));
            let new = (from_input[2] + reset * from_state[2]).tanh();
            let expected = (1.0 - update) * new + update * f64::from(before[at]);
            assert!((f64::from(after[at]) - expected).abs() < 1e-6, "{after:?}: {expected}");
        }
        assert_eq!(unit.floats(), 2);
    }
}
