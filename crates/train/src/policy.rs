//! The policy in the configuration of a training: its network and limits, as one of policy format 1 where they fit it,
//! otherwise as one of format 2.

use serde::{Deserialize, Serialize};

use murmurate::policy::Draw;
use murmurate::policy::file::AnyManifest;
use murmurate::policy::hops::action::Action;
use murmurate::policy::hops::entry::{self, Entry};
use murmurate::policy::hops::file::{self, Tensors};
use murmurate::policy::hops::manifest::{
    self as hops, Aggregation, Deviation, Distribution, EdgeFeature, Hop, Input, Layers, Memory, OUTPUTS,
};
use murmurate::policy::hops::perceptron::Activation;
use murmurate::policy::manifest::{self, Architecture, EdgeField, Field, Manifest, Training};
use murmurate::policy::weights;

/// Steps per second of the training world \[Hz\].
const RATE_HZ: f64 = 20.0;

/// Network of the policy, and the parameters written to the policy's manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Policy {
    /// Number of hops.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub hops: usize,
    /// Layout of the hops. If it is left out, the messages of the first hop are of edges alone, so that nothing that
    /// all robots have in common changes an action; there is no encoder then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub architecture: Option<Architecture>,
    /// Entries of a robot's observation, in the order of the network's inputs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub observation: Vec<Entry>,
    /// Features of an edge, in the order of the network's inputs.
    #[serde(default)]
    pub edge: Vec<EdgeFeature>,
    /// Widths of the encoder's layers. The last width is that of the latent that a robot broadcasts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub encoder: Vec<usize>,
    /// Memory between encoder and first hop; none if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<Memory>,
    /// Widths of the layers of a message network.
    pub message: Vec<usize>,
    /// Method of combining messages: sum, which is the default, or mean.
    #[serde(default = "sum", skip_serializing_if = "is_sum")]
    pub aggregation: Aggregation,
    /// Widths of the layers of an update network, without the output layer. The last one is that of a hop's output,
    /// which robots broadcast unless the hop is the last.
    pub update: Vec<usize>,
    /// Activation of the layers: relu, which is the default, or tanh.
    #[serde(default = "relu", skip_serializing_if = "is_relu")]
    pub activation: Activation,
    /// Largest distance between two robots that receive each other's messages \[m\].
    pub radius_m: f32,
    /// Steps of the policy per second \[Hz\]: that of the training world, 20.
    #[serde(default = "rate_hz", skip_serializing_if = "is_rate_hz")]
    pub rate_hz: f64,
    /// Largest commanded velocity along each axis \[m/s\].
    pub limit_m_s: f32,
    /// Age, counted from its arrival, up to which a deployed robot uses a message \[s\].
    pub hold_s: f64,
    /// Method by which a deployed robot takes an action from the policy's distribution: its mean, or a random sample.
    #[serde(default = "mean")]
    pub draw: Draw,
}

fn one() -> usize {
    1
}

fn sum() -> Aggregation {
    Aggregation::Sum
}

fn relu() -> Activation {
    Activation::Relu
}

fn rate_hz() -> f64 {
    RATE_HZ
}

fn mean() -> Draw {
    Draw::Mean
}

fn is_one(hops: &usize) -> bool {
    *hops == 1
}

fn is_sum(aggregation: &Aggregation) -> bool {
    *aggregation == Aggregation::Sum
}

fn is_relu(activation: &Activation) -> bool {
    *activation == Activation::Relu
}

fn is_rate_hz(rate_hz: &f64) -> bool {
    (*rate_hz - RATE_HZ).abs() < 1e-9
}

/// Returns the bytes of a policy file with this manifest, the data of a training, and these weights: for each part of
/// the network its layers, as `Network::tensors` returns them.
///
/// # Panics
/// If the weights are not those of such a policy.
pub fn file(manifest: AnyManifest, training: Training, tensors: Tensors) -> Vec<u8> {
    let training = Some(training);
    match manifest {
        AnyManifest::Format1(manifest) => {
            let tensors = tensors.try_into().expect("a network of format 1 has three parts");
            weights::write(&Manifest { training, ..manifest }, &tensors)
        }
        AnyManifest::Format2(manifest) => file::write(&hops::Manifest { training, ..manifest }, &tensors),
    }
}

impl Policy {
    /// Returns the manifest of the policy for a scenario, without the data of a training and the hash of the weights.
    /// `log_std_max` is the upper limit of the log standard deviation of a policy that acts by velocities.
    ///
    /// # Errors
    /// If a policy cannot have these fields together; the error names one of them. The widths are not checked.
    pub fn manifest(&self, scenario: &str, action: Action, log_std_max: Option<f32>) -> Result<AnyManifest, String> {
        let fields = |feature: &EdgeFeature| match feature {
            EdgeFeature::Age => Some(EdgeField::Age),
            EdgeFeature::RelativePosition => Some(EdgeField::RelativePosition),
            EdgeFeature::Distance | EdgeFeature::RelativeVelocity => None,
        };
        let edge: Option<Vec<EdgeField>> = self.edge.iter().map(fields).collect();
        let is_plain = self.hops == 1 && self.memory.is_none() && action == Action::Velocity;
        let is_plain = is_plain && self.observation.iter().all(|entry| entry.field().is_some());
        let is_plain = is_plain && is_sum(&self.aggregation) && is_relu(&self.activation);
        match (self.architecture, edge) {
            (Some(architecture), Some(edge)) if is_plain => {
                Ok(AnyManifest::Format1(self.format_1(scenario, (architecture, edge), log_std_max)))
            }
            (Some(Architecture::Published), _) => {
                let why =
                    "'published' is one hop with sums and relu, without memory, distances and velocities of edges";
                Err(format!("architecture: {why}; use 'full'"))
            }
            (None, _) if self.memory.is_some() || !self.encoder.is_empty() || !self.observation.is_empty() => {
                let why = "without it there is no encoder, observation or memory";
                Err(format!("architecture: {why}; add architecture = \"full\""))
            }
            _ => Ok(AnyManifest::Format2(self.format_2(scenario, action, log_std_max))),
        }
    }

    fn format_1(
        &self,
        scenario: &str,
        (architecture, edge): (Architecture, Vec<EdgeField>),
        log_std_max: Option<f32>,
    ) -> Manifest {
        let widths = |input: usize, rest: &[usize]| [&[input], rest].concat();
        let (hidden, messages) = (last(&self.encoder), last(&self.message));
        let edge_floats: usize = edge.iter().map(|field| field.floats()).sum();
        let (message_inputs, update_inputs) = match architecture {
            Architecture::Published => (hidden, messages),
            // Of a configuration that is not checked yet: a width that does not fit is refused as too large.
            Architecture::Full => {
                (hidden.saturating_mul(2).saturating_add(edge_floats), hidden.saturating_add(messages))
            }
        };
        Manifest {
            scenario: scenario.to_owned(),
            architecture,
            observation: self.observation.iter().filter_map(Entry::field).collect(),
            edge,
            activation: Some(manifest::Activation::Relu),
            aggregation: Some(manifest::Aggregation::Sum),
            encoder: widths(entry::floats(&self.observation), &self.encoder),
            message: widths(message_inputs, &self.message),
            update: [&widths(update_inputs, &self.update)[..], &[OUTPUTS]].concat(),
            draw: self.draw,
            radius_m: self.radius_m,
            rate_hz: self.rate_hz,
            limit_m_s: self.limit_m_s,
            hold_s: self.hold_s,
            log_std_max,
            ..Manifest::published()
        }
    }

    fn format_2(&self, scenario: &str, action: Action, log_std_max: Option<f32>) -> hops::Manifest {
        let of_edges = self.architecture.is_none();
        let (observation, encoder) = match of_edges {
            // The format has an encoder; nothing uses its one output, as the first hop takes edges alone.
            true => (vec![Field::Velocity.into()], vec![1]),
            false => (self.observation.clone(), self.encoder.clone()),
        };
        hops::Manifest {
            format: hops::FORMAT,
            scenario: scenario.to_owned(),
            encoder: self.layers(&[], entry::floats(&observation), &encoder, Activation::Linear),
            observation,
            edge: self.edge.clone(),
            memory: self.memory,
            hops: (0..self.hops).map(|hop| self.hop(hop)).collect(),
            decoder: self.layers(&[], last(&self.update), &[OUTPUTS], Activation::Linear),
            action,
            distribution: Distribution::DiagonalNormal,
            deviation: Deviation::Log,
            draw: self.draw,
            log_std_max,
            radius_m: self.radius_m,
            rate_hz: self.rate_hz,
            limit_m_s: self.limit_m_s,
            hold_s: self.hold_s,
            message_name: None,
            sha256: String::new(),
            training: None,
        }
    }

    fn hop(&self, index: usize) -> Hop {
        let of_edges = self.architecture.is_none();
        let edge_floats: usize = self.edge.iter().map(|feature| feature.floats()).sum();
        let input = match (index, &self.memory) {
            (0, _) if of_edges => 0,
            (0, Some(memory)) => memory.floats,
            (0, None) => last(&self.encoder),
            _ => last(&self.update),
        };
        let (message_inputs, update_inputs): (&[Input], &[Input]) = match (of_edges, index) {
            (true, 0) => (&[Input::Edge], &[Input::Messages]),
            (true, _) => (&[Input::Sender, Input::Edge], &[Input::Own, Input::Messages]),
            (false, _) if edge_floats == 0 => (&[Input::Own, Input::Sender], &[Input::Own, Input::Messages]),
            (false, _) => (&[Input::Own, Input::Sender, Input::Edge], &[Input::Own, Input::Messages]),
        };
        // In the architecture of the paper a message has no activation of its own, so that its last layer is computed
        // once for each robot; the activation is that of the hop's output.
        let (of_message, of_update) = match of_edges {
            true => (self.activation, Activation::Linear),
            false => (Activation::Linear, self.activation),
        };
        let width = |part: &Input| match part {
            Input::Own | Input::Sender => input,
            Input::Edge => edge_floats,
            Input::Messages => last(&self.message),
        };
        let inputs = |parts: &[Input]| parts.iter().fold(0, |sum: usize, part| sum.saturating_add(width(part)));
        Hop {
            message: Some(self.layers(message_inputs, inputs(message_inputs), &self.message, of_message)),
            aggregation: self.aggregation,
            heads: None,
            score: None,
            query: None,
            key: None,
            self_loop: None,
            update: Some(self.layers(update_inputs, inputs(update_inputs), &self.update, of_update)),
        }
    }

    fn layers(&self, inputs: &[Input], first: usize, widths: &[usize], output_activation: Activation) -> Layers {
        Layers {
            inputs: inputs.to_vec(),
            widths: [first].into_iter().chain(widths.iter().copied()).collect(),
            activation: (widths.len() > 1).then_some(self.activation),
            output_activation,
        }
    }
}

fn last(widths: &[usize]) -> usize {
    widths.last().copied().unwrap_or(0)
}
