//! State that a policy of format 2 keeps from one step to the next: a recurrent cell between encoder and first hop.

use serde::{Deserialize, Serialize};

use crate::policy::weights::LayerTensors;

/// Largest number of floats of a memory.
const MAX_FLOATS: usize = 4096;

/// Memory in a manifest: the robot's state h, which the cell changes in each step by h' = cell(encoder's output, h).
/// The input of the first hop is h'. It is zero at the start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Memory {
    /// Kind of the cell; `gru` if left out.
    #[serde(default)]
    pub cell: Cell,
    /// Number of floats of the state.
    pub floats: usize,
    /// Longest time between two steps after which the policy goes on from its state \[s\]; after a longer gap it
    /// begins at its start. Half a second if left out.
    #[serde(default = "half_a_second")]
    pub after_gap_s: f64,
}

fn half_a_second() -> f64 {
    0.5
}

/// Kind of a recurrent cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cell {
    /// Gated recurrent unit (arXiv 1406.1078) in the form of PyTorch's `GRUCell`.
    #[default]
    Gru,
}

impl Memory {
    /// Returns the tensors of the cell, of which the input is `input` floats: the layer that takes the input, and the
    /// layer that takes the state. Each has the outputs of the reset gate, the update gate and the new state.
    pub(crate) fn tensors(&self, input: usize) -> [LayerTensors; 2] {
        let layer = |name: &str, inputs: usize| {
            (format!("memory.{name}.weight"), format!("memory.{name}.bias"), [3 * self.floats, inputs])
        };
        [layer("input", input), layer("state", self.floats)]
    }

    /// Checks the ranges of the fields for a policy of `rate_hz` steps a second. The error names the first wrong field.
    pub(super) fn check(&self, rate_hz: f64) -> Result<(), String> {
        let Memory { cell: Cell::Gru, floats, after_gap_s } = *self;
        if !(1..=MAX_FLOATS).contains(&floats) {
            return Err(format!("memory.floats: {floats} is not 1 to {MAX_FLOATS}; leave 'memory' out for none"));
        }
        if !(after_gap_s >= 1.0 / rate_hz && after_gap_s.is_finite()) {
            return Err(format!("memory.after_gap_s: {after_gap_s} s is less than one step ({} s)", 1.0 / rate_hz));
        }
        Ok(())
    }
}
