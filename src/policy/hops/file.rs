//! Reading and writing of policy files of format 2: safetensors with a manifest, checked completely.
//!
//! The tensors of a network are `NAME.N.weight` \[out, in\] and `NAME.N.bias` \[out\], with N = 0, 2, 4, ... as in a
//! PyTorch `Sequential` with activations between. NAME is `encoder`, `decoder`, or `hops.K.` with `message`, `score`,
//! `query`, `key` or `update`, with K = 0, 1, ... No file is opened here: the caller passes the bytes of the file.

use serde::Deserialize;

use super::entry;
use super::gru::Gru;
use super::hop::Hop;
use super::manifest::{FORMAT, Layers, Manifest};
use super::perceptron::Perceptron;
use crate::config::objects;
use crate::policy::manifest::KEY;
use crate::policy::mlp::Layer;
use crate::policy::safetensors::{self, Dtype, SafeTensors, TensorView};
use crate::policy::weights::{self, LayerTensors, Probe, TensorsByName, WeightsError};

/// Tensor of a probe with a number above 0 for each message that was received: the row is the receiver, the column the
/// sender.
const HEARD: &str = "probe.heard";
/// Tensor of a probe with the whole observation of each robot, for a policy that takes channels.
const OBSERVATION: &str = "probe.observation";
/// Tensor of a probe with the state of each robot before the step, for a policy with a memory.
const MEMORY: &str = "probe.memory";

/// Content of a policy file of format 2 that has been checked: metadata, weights and test data.
#[derive(Debug)]
pub struct PolicyFile {
    /// Manifest of the policy file.
    pub manifest: Manifest,
    /// Digest of the whole file: the first 64 bits of its BLAKE3 hash, in hexadecimal.
    pub(crate) digest: String,
    /// Network that turns an observation into the input of the first hop.
    pub(crate) encoder: Perceptron,
    /// State between the encoder and the first hop; `None` for a policy without state.
    pub(crate) memory: Option<Gru>,
    /// Hops of the policy in the order in which they are computed.
    pub(crate) hops: Vec<Hop>,
    /// Network that turns the output of the last hop into the parameters of the action.
    pub(crate) decoder: Perceptron,
    /// Test data with which the networks are to be compared; `None` if the file has none.
    pub probe: Option<TeamProbe>,
}

/// Test data of a policy file of format 2: inputs and correct outputs of a team, in which all hops are computed one
/// after the other from messages of the same step.
#[derive(Clone, Debug, PartialEq)]
pub struct TeamProbe {
    /// Inputs and correct outputs of the team's robots; each latent holds the inputs of all hops, one after the other.
    pub(crate) team: Probe,
    /// Whether a message was received, with shape \[robots, robots\]: the row is the receiver, the column the sender. A
    /// robot's message to itself does not count.
    pub heard: Vec<bool>,
    /// Observation of each robot, the encoder's input, with shape \[robots, inputs\], of a policy that takes channels;
    /// `None` for one whose observation follows from positions, velocities and goals.
    pub(crate) observation: Option<Vec<f32>>,
    /// State of each robot before the step, with shape \[robots, floats\]; empty for a policy without state.
    pub(crate) memory: Vec<f32>,
}

/// Version of a manifest's format, without any other field.
#[derive(Deserialize)]
struct Version {
    format: u32,
}

/// Returns whether `bytes` is a policy file whose manifest says that it is of format 2.
pub fn is_format_2(bytes: &[u8]) -> bool {
    let Ok(file) = safetensors::read(bytes) else { return false };
    let version = file.metadata.get(KEY).and_then(|text| serde_json::from_str::<Version>(text).ok());
    version.is_some_and(|version| version.format == FORMAT)
}

/// Parses and checks a policy file of format 2, of which `bytes` is the whole content. An error describes the first
/// fault found. The networks are not compared with the file's test data; `probe::network` does that.
pub fn read(bytes: &[u8]) -> Result<PolicyFile, WeightsError> {
    let SafeTensors { metadata, tensors } = weights::tensors(bytes)?;
    let text = metadata.get(KEY).ok_or_else(|| WeightsError::Manifest("it is missing".to_owned()))?;
    let manifest: Manifest = objects::parse(text).map_err(WeightsError::Manifest)?;
    manifest.check().map_err(WeightsError::Manifest)?;
    let load = |name: &str, layers: &Layers| perceptron(&tensors, name, layers);
    let encoder = load("encoder", &manifest.encoder)?;
    let decoder = load("decoder", &manifest.decoder)?;
    let memory = manifest.memory.map(|memory| gru(&tensors, memory.tensors(manifest.encoder.outputs()))).transpose()?;
    let (mut hops, mut begins) = (Vec::new(), 0);
    for (at, (form, input)) in manifest.hops.iter().zip(manifest.widths()).enumerate() {
        let load = |name: &str, layers: &Layers| load(&format!("hops.{at}.{name}"), layers);
        hops.push(Hop::new(form, (begins, input), &manifest.edge, load)?);
        begins += input;
    }
    let probe = tensors.keys().any(|name| name.starts_with(weights::PROBE));
    let probe = probe.then(|| team_probe(&tensors, &manifest)).transpose()?;
    if let Some(unknown) = unknown(&tensors, &manifest) {
        return Err(WeightsError::Unknown(unknown));
    }
    weights::check_hash(&tensors, &manifest.sha256)?;
    let digest = blake3::hash(bytes).to_hex()[..16].to_owned();
    Ok(PolicyFile { manifest, digest, encoder, memory, hops, decoder, probe })
}

fn perceptron(tensors: &TensorsByName, name: &str, layers: &Layers) -> Result<Perceptron, WeightsError> {
    let read = weights::layer_names(name, &layers.widths).map(|names| layer(tensors, &names));
    let read = read.collect::<Result<_, WeightsError>>()?;
    Ok(Perceptron::new(read, layers.activation.unwrap_or_default(), layers.output_activation))
}

fn gru(tensors: &TensorsByName, [input, state]: [LayerTensors; 2]) -> Result<Gru, WeightsError> {
    Ok(Gru::new(layer(tensors, &input)?, layer(tensors, &state)?))
}

fn layer(tensors: &TensorsByName, (weight, bias, shape): &LayerTensors) -> Result<Layer, WeightsError> {
    let weight = weights::floats(tensors, weight, shape, "")?;
    Ok(Layer::new(&weight, &weights::floats(tensors, bias, &shape[..1], " (zeros, if the layer has no bias)")?))
}

fn team_probe(tensors: &TensorsByName, manifest: &Manifest) -> Result<TeamProbe, WeightsError> {
    let team = weights::probe(tensors, manifest.latent())?;
    let robots = team.position.len() / 2;
    let of = |name: &str, width: usize, hint: &'static str| weights::floats(tensors, name, &[robots, width], hint);
    let heard = of(HEARD, robots, " (a probe of format 2 says who received whom)")?;
    let inputs = entry::floats(&manifest.observation);
    let takes_channels = !entry::requests(&manifest.observation).is_empty();
    let observation = takes_channels.then(|| of(OBSERVATION, inputs, " (the policy takes channels)")).transpose()?;
    let memory = manifest.memory.map(|memory| of(MEMORY, memory.floats, " (the policy has a memory)")).transpose()?;
    let heard = heard.into_iter().map(|heard| heard > 0.0).collect();
    Ok(TeamProbe { team, heard, observation, memory: memory.unwrap_or_default() })
}

/// Returns the name of a tensor that is neither of a network nor of a probe.
fn unknown(tensors: &TensorsByName, manifest: &Manifest) -> Option<String> {
    let mut known: Vec<String> = weights::PROBE_TENSORS.iter().map(|name| (*name).to_owned()).collect();
    known.push(HEARD.to_owned());
    known.extend((!entry::requests(&manifest.observation).is_empty()).then(|| OBSERVATION.to_owned()));
    known.extend(manifest.memory.map(|_| MEMORY.to_owned()));
    known.extend(manifest.tensors().into_iter().flatten().flat_map(|(weight, bias, _)| [weight, bias]));
    tensors.keys().find(|name| !known.contains(name)).cloned()
}

/// Weights of a policy: for each network its layers, each a pair of row-major weights \[out, in\] and biases \[out\]. The
/// networks are the encoder, the memory, those of each hop (`manifest::Hop::networks`), and the decoder. The memory has
/// two layers, of its input and of its state.
pub type Tensors = Vec<Vec<(Vec<f32>, Vec<f32>)>>;

/// Returns the bytes of a policy file of format 2 with this manifest and these weights. The field `sha256` of the
/// manifest is replaced by the hash of the weights.
///
/// # Panics
/// If the weights do not have the shapes that the manifest states.
pub fn write(manifest: &Manifest, tensors: &Tensors) -> Vec<u8> {
    let bytes = |floats: &[f32]| floats.iter().flat_map(|float| float.to_le_bytes()).collect::<Vec<u8>>();
    let mut entries: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
    let networks = manifest.tensors();
    assert_eq!(networks.len(), tensors.len(), "there are weights for each network");
    for (network, layers) in networks.into_iter().zip(tensors) {
        assert_eq!(network.len(), layers.len(), "{} has all its layers", network[0].0);
        for ((weight_name, bias_name, shape), (weight, bias)) in network.into_iter().zip(layers) {
            assert_eq!((weight.len(), bias.len()), (shape[0] * shape[1], shape[0]), "{weight_name} has its shape");
            entries.push((weight_name, shape.to_vec(), bytes(weight)));
            entries.push((bias_name, vec![shape[0]], bytes(bias)));
        }
    }
    let tensor =
        |shape: &[usize], data| TensorView::new(Dtype::F32, shape.to_vec(), data).expect("a tensor has its shape");
    let tensors: TensorsByName =
        entries.iter().map(|(name, shape, data)| (name.clone(), tensor(shape, data.as_slice()))).collect();
    let manifest = Manifest { sha256: weights::hash(&tensors), ..manifest.clone() };
    let json = serde_json::to_string(&manifest).expect("a manifest is JSON");
    safetensors::write(Some((KEY.to_owned(), json)), &tensors)
}
