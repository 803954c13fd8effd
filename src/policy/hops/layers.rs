//! Networks in a manifest of format 2: multi-layer perceptrons with the parts of their inputs.

use serde::{Deserialize, Serialize};

use super::perceptron::Activation;

/// One part of the input of a hop's network; the parts of an input lie one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Input {
    /// The robot's own input of this hop, called h_i in equations.
    Own,
    /// The neighbour's input of this hop as the neighbour broadcast it, called h_j in equations.
    Sender,
    /// The features of the edge from the neighbour to the robot, called e_ij in equations.
    Edge,
    /// The aggregated messages of all neighbours, an input of the update network only.
    Messages,
}

/// Multi-layer perceptron of a policy: its inputs, the widths of its layers and their activations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layers {
    /// Parts of the input, in this order. The list is empty for the encoder, whose input is the observation, and for
    /// the decoder, whose input is the output of the last hop.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inputs: Vec<Input>,
    /// Layer widths, from the input to the output; one layer for each pair of neighbouring widths.
    pub widths: Vec<usize>,
    /// Activation function between layers; required if there is more than one layer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub activation: Option<Activation>,
    /// Activation function after the last layer; `linear`, that is none, if left out.
    #[serde(default, skip_serializing_if = "is_linear")]
    pub output_activation: Activation,
}

fn is_linear(activation: &Activation) -> bool {
    *activation == Activation::Linear
}

impl Layers {
    /// Returns the number of outputs of the last layer.
    pub(crate) fn outputs(&self) -> usize {
        self.widths.last().copied().unwrap_or(0)
    }
}

/// Checks a network: `allowed` are the parts that its input may have, `width` gives the width of each. The encoder and
/// the decoder have none, and an input of the width `whole` with its description.
pub(super) fn check_layers(
    field: &str,
    layers: &Layers,
    allowed: &[Input],
    width: &dyn Fn(Input) -> usize,
    whole: Option<(&str, usize)>,
) -> Result<(), String> {
    let Layers { inputs, widths, activation, output_activation } = layers;
    if widths.len() < 2 || widths.iter().any(|&width| width == 0 || width > 4096) {
        return Err(format!("{field}.widths: {widths:?} are not valid layer widths (two or more, each 1 to 4096)"));
    }
    let repeated = |at: usize| inputs[..at].contains(&inputs[at]);
    if (0..inputs.len()).any(|at| repeated(at) || !allowed.contains(&inputs[at])) {
        return Err(match allowed {
            [] => format!("{field}.inputs: this network has one input; leave it out"),
            _ => format!("{field}.inputs: expected some of {}, each once", names(allowed)),
        });
    }
    if inputs.is_empty() && whole.is_none() {
        return Err(format!("{field}.inputs: expected one or more of {}", names(allowed)));
    }
    let parts = || (names(inputs), inputs.iter().map(|part| width(*part)).sum());
    let (what, expected) = whole.map_or_else(parts, |(what, expected)| (what.to_owned(), expected));
    if widths[0] != expected {
        return Err(format!("{field}.widths: input of {}; expected {expected}, {what}", widths[0]));
    }
    if widths.len() > 2 && activation.is_none() {
        return Err(format!("{field}.activation: it has more than one layer; say which activation is between them"));
    }
    for activation in [activation.as_ref(), Some(output_activation)].into_iter().flatten() {
        if matches!(activation, Activation::LeakyRelu(slope) if !slope.is_finite()) {
            return Err(format!("{field}: a slope of leaky-relu is not finite"));
        }
    }
    Ok(())
}

/// Returns the names of `parts` as a list, as in the manifest.
fn names(parts: &[Input]) -> String {
    let name = |part: &Input| match part {
        Input::Own => "own",
        Input::Sender => "sender",
        Input::Edge => "edge",
        Input::Messages => "messages",
    };
    parts.iter().map(name).collect::<Vec<_>>().join(", ")
}
