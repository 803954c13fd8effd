//! The manifest of a policy file of format 2: one JSON object in the safetensors metadata, under the same key as that
//! of format 1.

use serde::{Deserialize, Serialize};

use super::action::Action;
use super::entry;
pub use super::entry::{Entry, Named};
use super::layers::check_layers;
pub use super::layers::{Input, Layers};
pub use super::memory::{Cell, Memory};
use crate::messages::wire::MAX_FEATURES;
use crate::policy::Draw;
use crate::policy::manifest::{self, EdgeField, Training, check_message_name};
use crate::policy::weights::{self, LayerTensors};

/// Version of the manifest's format of policies with several hops, which this module reads.
pub const FORMAT: u32 = manifest::FORMATS[1];
/// Largest number of hops of a policy.
pub(crate) const MAX_HOPS: usize = 8;
/// Largest number of heads of an attention, an aggregation that is weighted by scores.
pub(crate) const MAX_HEADS: usize = 64;
/// Number of raw outputs of the decoder: two means and two parameters of standard deviations.
pub const OUTPUTS: usize = 4;

/// One feature of an edge, the connection from a neighbour in range to the robot. All are in the policy frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EdgeFeature {
    /// Time since the neighbour's message arrived at the robot \[s\]; one float.
    Age,
    /// The neighbour's position when it sent its message, minus the robot's own position \[m\]; two floats.
    RelativePosition,
    /// Length of the relative position \[m\]; one float.
    Distance,
    /// The neighbour's velocity when it sent its message, minus the robot's own velocity \[m/s\]; two floats.
    RelativeVelocity,
}

impl From<EdgeField> for EdgeFeature {
    fn from(field: EdgeField) -> EdgeFeature {
        match field {
            EdgeField::Age => EdgeFeature::Age,
            EdgeField::RelativePosition => EdgeFeature::RelativePosition,
        }
    }
}

impl EdgeFeature {
    /// Returns the number of floats of this edge feature.
    pub const fn floats(self) -> usize {
        match self {
            EdgeFeature::Age | EdgeFeature::Distance => 1,
            EdgeFeature::RelativePosition | EdgeFeature::RelativeVelocity => 2,
        }
    }
}

/// Method by which the messages of a hop are combined into one vector. Without any message it is zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Aggregation {
    /// The aggregated message is the sum of the messages.
    Sum,
    /// The aggregated message is the mean of the messages.
    Mean,
    /// The aggregated message is the largest of the messages in each component.
    Max,
    /// Attention by scores: the sum of the messages, weighted for each head by the softmax of the scores that the
    /// network `score` computes (GAT, arXiv 1710.10903; GATv2, arXiv 2105.14491).
    Softmax,
    /// Scaled dot-product attention: the sum of the messages, weighted for each head by the softmax of the scores
    /// query . key / sqrt(width of a head's query). The networks `query` and `key` compute the factors from the robot's
    /// and the neighbour's input (arXiv 1706.03762; as a graph convolution arXiv 2009.03509).
    DotProduct,
}

/// Edge features of the robot itself, where it is one of its own neighbours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SelfLoop {
    /// All edge features of the robot itself are zero.
    ZeroEdge,
    /// The mean of the features of all edges from neighbours; zero without any. It is what PyTorch Geometric does.
    MeanEdge,
}

/// One hop in a manifest: the networks and the aggregation that turn the messages of a robot's neighbours into the
/// hop's output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hop {
    /// Network that makes the message of each neighbour, of the inputs `own`, `sender` and `edge`. `None`: the message
    /// is the neighbour's input of this hop, unchanged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub message: Option<Layers>,
    /// Method by which the messages of the neighbours are combined.
    pub aggregation: Aggregation,
    /// Number of heads of an attention: messages, queries and keys consist of as many equal parts, one for each head.
    /// `None`: one head.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heads: Option<usize>,
    /// Network of the scores, one for each head, of the inputs `own`, `sender` and `edge`; for `Aggregation::Softmax`
    /// only, otherwise `None`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub score: Option<Layers>,
    /// Network of the query, of the input `own`; for `Aggregation::DotProduct` only, otherwise `None`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub query: Option<Layers>,
    /// Network of the keys, of the inputs `own`, `sender` and `edge`; for `Aggregation::DotProduct` only, otherwise
    /// `None`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key: Option<Layers>,
    /// Edge of the robot to itself, if it is one of its own neighbours (the last one); `None`: it is not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub self_loop: Option<SelfLoop>,
    /// Network that makes the hop's output, of the inputs `own` and `messages`. `None`: the output is the aggregated
    /// messages.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub update: Option<Layers>,
}

impl Hop {
    /// Returns the number of floats of a neighbour's contribution to the aggregation: the outputs of the message
    /// network, or the neighbour's hop input itself, of `input` floats, if the hop has no message network.
    pub(crate) fn message_width(&self, input: usize) -> usize {
        self.message.as_ref().map_or(input, Layers::outputs)
    }

    /// Returns the number of floats of the hop's output, if its input has `input` floats.
    pub(crate) fn outputs(&self, input: usize) -> usize {
        self.update.as_ref().map_or(self.message_width(input), Layers::outputs)
    }

    /// Returns the possible networks of the hop, each with its name; `None` for one that the hop does not have.
    pub fn networks(&self) -> [(&'static str, Option<&Layers>); 5] {
        let Hop { message, score, query, key, update, .. } = self;
        [("message", message), ("score", score), ("query", query), ("key", key), ("update", update)]
            .map(|(name, layers)| (name, layers.as_ref()))
    }
}

/// Probability distribution of a robot's action, a velocity \[m/s\] or an acceleration, of which the decoder's outputs
/// are the parameters: mean_x, mean_y, and one parameter of the standard deviation of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Distribution {
    /// Independent normal distributions of both components of the velocity.
    DiagonalNormal,
    /// The velocity limit times the hyperbolic tangent of independent normal variables. A policy that takes the mean
    /// takes the limit times the tangent of their means.
    TanhNormal,
}

/// Meaning of the decoder's last two outputs, from which the standard deviations of an action are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Deviation {
    /// An output is the natural logarithm of a standard deviation.
    #[default]
    Log,
    /// A standard deviation is softplus(x + c) + 0.01 for the output x, with c such that x = 0 gives 1: TorchRL's
    /// `biased_softplus_1.0`.
    BiasedSoftplus,
}

/// Metadata of a policy file of format 2, with several hops: how its networks are built, what it observes, and how it
/// was trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of the manifest's format; must be `FORMAT`, which is 2.
    pub format: u32,
    /// Name of the scenario (the team's task) for which the policy was trained.
    pub scenario: String,
    /// Entries of the observation vector, in the order of the encoder's inputs.
    pub observation: Vec<Entry>,
    /// Features of an edge between two robots, in the order in which networks get them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub edge: Vec<EdgeFeature>,
    /// Network that turns an observation into the input of the first hop.
    pub encoder: Layers,
    /// State that the policy keeps from one step to the next, between the encoder and the first hop; `None` for a
    /// policy without state.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<Memory>,
    /// Hops in their order; the output of each is the input of the next.
    pub hops: Vec<Hop>,
    /// Network that turns the output of the last hop into the parameters of the action.
    pub decoder: Layers,
    /// Quantity that the action is; the velocity if left out.
    #[serde(default, skip_serializing_if = "Action::is_velocity")]
    pub action: Action,
    /// Probability distribution of a robot's action, of which the decoder's outputs are the parameters.
    pub distribution: Distribution,
    /// Meaning of the decoder's last two outputs, from which the standard deviations of an action are computed.
    #[serde(default)]
    pub deviation: Deviation,
    /// Default method of drawing an action from the distribution: its mean or a random sample.
    pub draw: Draw,
    /// Upper limit of the logarithm of the standard deviation, to which larger outputs are clamped when actions are
    /// sampled. `None` means no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_std_max: Option<f32>,
    /// Default communication radius \[m\]: a robot uses messages only of neighbours within this distance, unless the
    /// trial sets another range.
    pub radius_m: f32,
    /// Steps of the policy per second \[Hz\], each of which gives one action.
    pub rate_hz: f64,
    /// Largest commanded speed along each axis \[m/s\].
    pub limit_m_s: f32,
    /// Hold time \[s\]: age up to which a neighbour's newest message is used.
    pub hold_s: f64,
    /// Name of what the policy's messages mean, which policies have that were trained with each other's messages, such
    /// as those of the roles of a team; `None` for a policy that only understands itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub message_name: Option<String>,
    /// SHA-256 of all tensors' bytes, in the order of the tensors' names, in hexadecimal.
    pub sha256: String,
    /// Training run that made the file; `None` if the file does not state it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training: Option<Training>,
}

impl Manifest {
    /// Returns the number of floats of all edge features.
    pub fn edge_floats(&self) -> usize {
        self.edge.iter().map(|feature| feature.floats()).sum()
    }

    /// Returns the number of floats of each hop's input, in the order of the hops, and last that of the decoder's
    /// input.
    pub(crate) fn widths(&self) -> Vec<usize> {
        let first = self.memory.map_or(self.encoder.outputs(), |memory| memory.floats);
        let mut widths = vec![first];
        widths.extend(self.hops.iter().scan(first, |width, hop| {
            *width = hop.outputs(*width);
            Some(*width)
        }));
        widths
    }

    /// Returns the number of floats of a latent, which holds the inputs of all hops.
    pub(crate) fn latent(&self) -> usize {
        self.widths()[..self.hops.len()].iter().sum()
    }

    /// Returns the layers of all networks of the policy: encoder, memory, the networks of the hops, decoder.
    pub(crate) fn tensors(&self) -> Vec<Vec<LayerTensors>> {
        let network = |name: &str, layers: &Layers| weights::layer_names(name, &layers.widths).collect::<Vec<_>>();
        let mut networks = vec![network("encoder", &self.encoder)];
        networks.extend(self.memory.map(|memory| memory.tensors(self.encoder.outputs()).into()));
        for (at, hop) in self.hops.iter().enumerate() {
            let present = hop.networks().into_iter().filter_map(|(name, layers)| Some((name, layers?)));
            networks.extend(present.map(|(name, layers)| network(&format!("hops.{at}.{name}"), layers)));
        }
        networks.push(network("decoder", &self.decoder));
        networks
    }

    /// Checks the range of each field, and that the fields are consistent with each other. The error names the first
    /// wrong field.
    pub fn check(&self) -> Result<(), String> {
        if self.format != FORMAT {
            return Err(format!("format: {}; expected {FORMAT}", self.format));
        }
        check_message_name(self.message_name.as_deref())?;
        if self.hops.is_empty() || self.hops.len() > MAX_HOPS {
            return Err(format!("hops: {} of them; expected 1 to {MAX_HOPS}", self.hops.len()));
        }
        entry::check(&self.observation)?;
        let observed = ("the values of the observation: 2 for each field", entry::floats(&self.observation));
        check_layers("encoder", &self.encoder, &[], &|_| 0, Some(observed))?;
        let mut input = self.widths()[0];
        for (at, hop) in self.hops.iter().enumerate() {
            check_hop(&format!("hops.{at}"), hop, input, self.edge_floats())?;
            input = hop.outputs(input);
        }
        check_layers("decoder", &self.decoder, &[], &|_| 0, Some(("the output of the last hop", input)))?;
        if self.decoder.outputs() != OUTPUTS {
            return Err(format!("decoder: output of {}; the distribution needs {OUTPUTS}", self.decoder.outputs()));
        }
        if self.latent() > MAX_FEATURES {
            let widths = &self.widths()[..self.hops.len()];
            let field = match (widths.len(), self.memory) {
                (1, Some(_)) => "memory",
                (1, None) => "encoder",
                _ => "hops",
            };
            return Err(format!(
                "{field}: inputs of {widths:?} floats, {} together; a message carries {MAX_FEATURES}: narrow them",
                self.latent()
            ));
        }
        if self.action == Action::Acceleration && self.distribution != Distribution::DiagonalNormal {
            return Err("action: an acceleration needs the distribution 'diagonal-normal'".to_owned());
        }
        if self.deviation != Deviation::Log && self.log_std_max.is_some() {
            return Err("log_std_max: it limits a deviation of the kind 'log' only; leave it out".to_owned());
        }
        manifest::check_conditions(self.log_std_max, self.radius_m, self.limit_m_s, self.rate_hz, self.hold_s)?;
        self.memory.map_or(Ok(()), |memory| memory.check(self.rate_hz))
    }
}

/// Checks one hop, whose name in errors is `field`, with an input and with edges of these widths.
fn check_hop(field: &str, hop: &Hop, input: usize, edge: usize) -> Result<(), String> {
    let messages = hop.message_width(input);
    let width = |part: Input| match part {
        Input::Own | Input::Sender => input,
        Input::Edge => edge,
        Input::Messages => messages,
    };
    for (name, layers) in hop.networks() {
        let allowed: &[Input] = match name {
            "query" => &[Input::Own],
            "update" => &[Input::Own, Input::Messages],
            _ => &[Input::Own, Input::Sender, Input::Edge],
        };
        layers.map_or(Ok(()), |layers| check_layers(&format!("{field}.{name}"), layers, allowed, &width, None))?;
        let needed = match (hop.aggregation, name) {
            (Aggregation::Softmax, "score") | (Aggregation::DotProduct, "query" | "key") => Some(true),
            (_, "score" | "query" | "key") => Some(false),
            _ => None,
        };
        match needed {
            Some(true) if layers.is_none() => return Err(format!("{field}.{name}: the aggregation needs it; add it")),
            Some(false) if layers.is_some() => {
                return Err(format!("{field}.{name}: the aggregation does not use it; leave it out"));
            }
            _ => {}
        }
    }
    let heads = hop.heads.unwrap_or(1);
    if hop.heads.is_some() && !matches!(hop.aggregation, Aggregation::Softmax | Aggregation::DotProduct) {
        return Err(format!("{field}.heads: only 'softmax' and 'dot-product' have heads; leave it out"));
    }
    if !(1..=MAX_HEADS).contains(&heads) || !messages.is_multiple_of(heads) {
        return Err(format!(
            "{field}.heads: {heads}; expected 1 to {MAX_HEADS}, a divisor of the messages' {messages}"
        ));
    }
    if let Some(score) = hop.score.as_ref().filter(|score| score.outputs() != heads) {
        return Err(format!("{field}.score: output of {}; expected {heads}, one for each head", score.outputs()));
    }
    if let (Some(query), Some(key)) = (&hop.query, &hop.key) {
        let (query, key) = (query.outputs(), key.outputs());
        if query != key || !key.is_multiple_of(heads) {
            return Err(format!(
                "{field}.key: output of {key}; expected the query's {query}, a multiple of {heads} heads"
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::hops::perceptron::Activation;

    fn manifest() -> Manifest {
        let text = r#"{
            "format": 2, "scenario": "passage", "observation": ["position", "goal-minus-position"],
            "edge": ["age", "relative-position"],
            "encoder": {"widths": [4, 6], "output_activation": "tanh"},
            "hops": [
                {"aggregation": "max"},
                {
                    "message": {"inputs": ["sender"], "widths": [6, 8]}, "aggregation": "softmax", "heads": 2,
                    "score": {
                        "inputs": ["own", "sender", "edge"], "widths": [15, 5, 2], "activation": {"leaky-relu": 0.2}
                    },
                    "self_loop": "mean-edge",
                    "update": {"inputs": ["own", "messages"], "widths": [14, 7]}
                },
                {
                    "aggregation": "dot-product", "query": {"inputs": ["own"], "widths": [7, 3]},
                    "key": {"inputs": ["sender"], "widths": [7, 3]}
                }
            ],
            "decoder": {"widths": [7, 4]}, "distribution": "tanh-normal", "draw": "mean",
            "radius_m": 2.0, "rate_hz": 20.0, "limit_m_s": 1.5, "hold_s": 0.2, "sha256": ""
        }"#;
        serde_json::from_str(text).expect("it is a manifest")
    }

    #[test]
    fn a_latent_holds_the_inputs_of_all_hops() {
        let manifest = manifest();
        assert_eq!(manifest.check(), Ok(()));
        assert_eq!((manifest.widths(), manifest.latent()), (vec![6, 6, 7, 7], 19));
        let first = |network: &Vec<LayerTensors>| network[0].0.trim_end_matches(".0.weight").to_owned();
        let names: Vec<String> = manifest.tensors().iter().map(first).collect();
        let of_hops = ["hops.1.message", "hops.1.score", "hops.1.update", "hops.2.query", "hops.2.key"];
        assert_eq!(names, [&["encoder"], &of_hops[..], &["decoder"]].concat());
        let text = serde_json::to_string(&manifest).expect("a manifest is JSON");
        assert_eq!(serde_json::from_str::<Manifest>(&text).expect("it can be read"), manifest);
    }

    #[test]
    fn an_inconsistent_manifest_is_refused_with_the_name_of_the_field() {
        let refused = |field: &str, change: fn(&mut Manifest)| {
            let mut manifest = manifest();
            change(&mut manifest);
            let error = manifest.check().expect_err(field);
            assert!(error.starts_with(field), "{field}: {error}");
        };
        refused("format", |m| m.format = 3);
        refused("message_name", |m| m.message_name = Some("a\nb".to_owned()));
        refused("hops: 0", |m| m.hops.clear());
        refused("hops: 9", |m| m.hops = vec![m.hops[0].clone(); 9]);
        refused("encoder.widths", |m| m.encoder.widths[0] = 5);
        refused("encoder.widths", |m| m.encoder.widths[1] = 0);
        refused("encoder.inputs", |m| m.encoder.inputs = vec![Input::Own]);
        refused("hops.1.message.inputs", |m| m.hops[1].message.as_mut().unwrap().inputs = vec![Input::Messages]);
        refused("hops.1.message.inputs", |m| m.hops[1].message.as_mut().unwrap().inputs.clear());
        refused("hops.1.score.widths", |m| m.edge.truncate(1));
        refused("hops.1.score.activation", |m| m.hops[1].score.as_mut().unwrap().activation = None);
        refused("hops.1.score", |m| {
            m.hops[1].score.as_mut().unwrap().activation = Some(Activation::LeakyRelu(f32::NAN));
        });
        refused("hops.1.score: output", |m| m.hops[1].heads = None);
        refused("hops.1.heads", |m| m.hops[1].heads = Some(3));
        refused("hops.1.heads", |m| m.hops[1].heads = Some(0));
        refused("hops.1.score: the aggregation does not", |m| m.hops[1].aggregation = Aggregation::Sum);
        refused("hops.0.heads", |m| m.hops[0].heads = Some(2));
        refused("hops.0.score: the aggregation needs", |m| m.hops[0].aggregation = Aggregation::Softmax);
        refused("hops.1.update.inputs", |m| m.hops[1].update.as_mut().unwrap().inputs = vec![Input::Own, Input::Own]);
        refused("hops.2.query.inputs", |m| m.hops[2].query.as_mut().unwrap().inputs = vec![Input::Sender]);
        refused("hops.2.key", |m| m.hops[2].key.as_mut().unwrap().widths[1] = 2);
        refused("hops.2.query: the aggregation needs", |m| m.hops[2].query = None);
        refused("decoder.widths", |m| m.decoder.widths[0] = 6);
        refused("decoder: output", |m| m.decoder.widths[1] = 2);
        refused("hops: inputs of [6, 6, 250] floats, 262 together", |m| {
            m.hops[1].update.as_mut().unwrap().widths[1] = 250;
            m.hops[2].query.as_mut().unwrap().widths[0] = 250;
            m.hops[2].key.as_mut().unwrap().widths[0] = 250;
            m.decoder.widths[0] = 250;
        });
        refused("log_std_max", |m| (m.log_std_max, m.deviation) = (Some(0.0), Deviation::BiasedSoftplus));
        refused("radius_m", |m| m.radius_m = f32::NAN);
        refused("rate_hz", |m| m.rate_hz = 2.0);
        refused("hold_s", |m| m.hold_s = 0.0);
    }
}
