//! Tensors of policy files: their names and shapes, their checks and their hash, and test data among them.

use std::collections::BTreeMap;

use data_encoding::HEXLOWER;
use hmac_sha256::Hash;

use super::manifest::{self, Manifest};
use super::mlp::Layer;
use super::safetensors::{self, Dtype, SafeTensors, TensorView};
use crate::config::kinds::FileKind;
use crate::config::objects;

/// Tensor name prefixes of the three networks, in the order of use.
pub(super) const NAMES: [&str; 3] = ["encoder", "message", "update"];
/// Tensor name prefixes of the three networks in the policy file published with the paper, in the order of use:
/// encoder, message network, update network.
pub(super) const PUBLISHED_NAMES: [&str; 3] = ["encoder", "gnn", "post"];

/// Prefix of the names of the tensors in a policy file that hold its test data ([`Probe`]: inputs and correct outputs).
pub(super) const PROBE: &str = "probe.";
/// Names of the tensors that hold the test data of each policy file, in the order of [`Probe`]'s fields; each tensor
/// has one row per robot.
const PROBE_TENSORS: [&str; 6] =
    ["probe.position", "probe.velocity", "probe.goal", "probe.age", "probe.latent", "probe.output"];

/// Tensor of a probe of format 2 with a number above 0 for each message that was received: the row is the receiver, the
/// column the sender.
const HEARD: &str = "probe.heard";
/// Tensor of a probe with the whole observation of each robot, for a policy that takes channels.
const OBSERVATION: &str = "probe.observation";
/// Tensor of a probe with the state of each robot before the step, for a policy with a memory.
const MEMORY: &str = "probe.memory";

/// Test data in a policy file: inputs for a team of robots and the network's correct outputs for them, in one step in
/// which all hops are computed one after the other. The program that exported the policy stored them. All lists are
/// row-major, with one row per robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// Positions of the robots \[m\], with shape \[robots, 2\], in the policy frame (the world frame, possibly rotated
    /// by half a turn).
    pub(crate) position: Vec<f32>,
    /// Velocities of the robots \[m/s\], with shape \[robots, 2\], in the policy frame (the world frame, possibly
    /// rotated by half a turn).
    pub(crate) velocity: Vec<f32>,
    /// Goals of the robots \[m\], with shape \[robots, 2\], in the policy frame (the world frame, possibly rotated by
    /// half a turn).
    pub(crate) goal: Vec<f32>,
    /// Ages of the messages \[s\], with shape \[robots, robots\]: the row is the receiver, the column the sender.
    pub(crate) age_s: Vec<f32>,
    /// Correct latents (the messages that the encoder makes of a robot's observation), with shape \[robots, features\].
    pub(crate) latent: Vec<f32>,
    /// Correct raw outputs of the network, mean_x, mean_y, log_std_x and log_std_y of a velocity \[m/s\], with shape
    /// \[robots, 4\].
    pub output: Vec<f32>,
    /// Whether a message was received, with shape \[robots, robots\]: the row is the receiver, the column the sender. A
    /// robot's message to itself does not count. In format 1 every robot has a message of every other one.
    pub heard: Vec<bool>,
    /// Observation of each robot, the encoder's input, with shape \[robots, inputs\], of a policy that takes channels;
    /// `None` for one whose observation follows from positions, velocities and goals.
    pub(crate) observation: Option<Vec<f32>>,
    /// State of each robot before the step, with shape \[robots, floats\]; empty for a policy without state.
    pub(crate) memory: Vec<f32>,
}

/// Numbers of floats of the test data of a policy, and the tensors that its kind of policy has among them.
#[derive(Debug)]
pub(super) struct Probed {
    /// Floats of a latent, which holds the inputs of all hops.
    pub latent: usize,
    /// Whether the test data say who has received whom.
    pub heard: bool,
    /// Floats of an observation, if the test data have it.
    pub observation: Option<usize>,
    /// Floats of the state, for a policy with one.
    pub memory: Option<usize>,
}

impl Probed {
    /// Returns the names of all tensors of the test data.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        let more = [self.heard.then_some(HEARD), self.observation.map(|_| OBSERVATION), self.memory.map(|_| MEMORY)];
        PROBE_TENSORS.into_iter().chain(more.into_iter().flatten())
    }
}

impl Probe {
    /// Largest number of robots in a policy file's test data.
    pub(crate) const MOST_ROBOTS: usize = 64;
}

/// Error of a file that is not a valid policy file.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The file is of another kind than a policy file; the text says which, and what to do.
    #[error("it is {0}")]
    Foreign(&'static str),
    /// The file has tensors that are not those of the published network, and no manifest, which describes them.
    #[error(
        "it has no manifest: put the network's description into its metadata under '{key}', as {PAGE} shows (only the \
         published passage network is known without one: {0})", key = manifest::KEY
    )]
    NoManifest(Box<WeightsError>),
    /// The file is not in the safetensors format, or is truncated; the text describes the fault.
    #[error("not a complete safetensors file: {0}")]
    Format(String),
    /// The manifest (the file's metadata about the policy) cannot be parsed or is inconsistent; the text describes the
    /// fault.
    #[error("the manifest (metadata key '{key}') is wrong: {0}", key = manifest::KEY)]
    Manifest(String),
    /// The file lacks a tensor of the network.
    #[error("the tensor '{name}' is missing; expected one of shape {expected:?}{hint}")]
    Missing {
        /// Name of the missing tensor.
        name: String,
        /// Shape that the tensor should have: its size along each axis.
        expected: Vec<usize>,
        /// Possible cause, which ends the error message; may be empty.
        hint: &'static str,
    },
    /// A tensor does not have the shape that the manifest requires.
    #[error("the tensor '{name}' has shape {found:?}; expected {expected:?}")]
    Shape {
        /// Name of the tensor.
        name: String,
        /// Shape of the tensor in the file: its size along each axis.
        found: Vec<usize>,
        /// Shape that the tensor should have: its size along each axis.
        expected: Vec<usize>,
    },
    /// A tensor does not consist of 32-bit floats.
    #[error("the tensor '{name}' holds {found}; expected F32 of shape {expected:?}")]
    Type {
        /// Name of the tensor.
        name: String,
        /// Data type of the tensor in the file, such as `F16`.
        found: String,
        /// Shape that the tensor should have: its size along each axis.
        expected: Vec<usize>,
    },
    /// A tensor contains NaN or infinity.
    #[error("the tensor '{name}' of shape {expected:?} holds {value} at index {index}; expected finite numbers")]
    NotFinite {
        /// Name of the tensor.
        name: String,
        /// Shape of the tensor: its size along each axis.
        expected: Vec<usize>,
        /// Index of the first number that is not finite, in row-major order from zero.
        index: usize,
        /// The number that is not finite.
        value: f32,
    },
    /// The file contains a tensor, named here, that is not part of the network.
    #[error("the tensor '{0}' is not part of the network; remove it from the file")]
    Unknown(String),
    /// The network computes other numbers than those that the exporter of the policy stored in the file.
    #[error(
        "its probe does not match: the network's {what} differ by up to {difference:.1e} from those in the file, more \
         than {tolerance:.0e}; the usual causes are another activation, another aggregation, or inputs in another order"
    )]
    Probe {
        /// Kind of numbers that differ: `latents` (the broadcast messages) or `outputs` (the parameters of the action).
        what: &'static str,
        /// Largest difference found; each is divided by the magnitude of the stored number if that is above 1.
        difference: f32,
        /// Largest difference that is accepted; each is divided by the magnitude of the stored number if that is above
        /// 1.
        tolerance: f32,
    },
    /// The hash of the file's tensors differs from the hash in the manifest, so the file was changed.
    #[error("the tensors' SHA-256 begins with {found:.16} and is not that of the manifest: the file was changed")]
    Hash {
        /// SHA-256 of the tensors in the file, in hexadecimal.
        found: String,
        /// SHA-256 that the manifest states, in hexadecimal.
        expected: String,
    },
}

/// Page on how to write policy files.
const PAGE: &str = "docs/bring-your-policy.md";

/// Parses a safetensors file. The error of a file of a known other kind says what it is, and what to do with it.
pub(super) fn tensors(bytes: &[u8]) -> Result<SafeTensors<'_>, WeightsError> {
    let foreign = match FileKind::of(bytes) {
        Some(FileKind::Zip) => {
            "a zip archive, as torch.save writes PyTorch checkpoints (.pt, .pth), and no policy file: write its \
             network as safetensors, with 'murmurate.export' in Python or as docs/bring-your-policy.md shows"
        }
        Some(FileKind::Pickle) => {
            "a Python pickle, as torch.save wrote PyTorch checkpoints before 1.6, and no policy file: write its \
             network as safetensors, with 'murmurate.export' in Python or as docs/bring-your-policy.md shows"
        }
        Some(FileKind::Hdf5) => {
            "a file of HDF5, as Keras writes, and no policy file: write its network as safetensors, as \
             docs/bring-your-policy.md shows"
        }
        Some(FileKind::Record) => "a record of a run, and no policy file; 'murmurate record info' shows it",
        Some(FileKind::Checkpoint) => {
            "the checkpoint of a training, and no policy file: the policy is 'policy.safetensors' in the same folder"
        }
        Some(FileKind::Text) => "a text, and no policy file: a policy is a safetensors file",
        Some(FileKind::Safetensors | FileKind::Empty) | None => {
            return safetensors::read(bytes).map_err(WeightsError::Format);
        }
    };
    Err(WeightsError::Foreign(foreign))
}

/// Returns the version of the format that the manifest `text` says; 1 if it is no object. It is an error if this
/// program does not read that: the other fields of another format would be errors that say less.
pub(super) fn format(text: &str) -> Result<u32, WeightsError> {
    let [first, second] = manifest::FORMATS;
    let Ok(serde_json::Value::Object(fields)) = serde_json::from_str(text) else { return Ok(first) };
    let expected = format!("this program reads {first} and {second}");
    let wrong = |why: String| Err(WeightsError::Manifest(format!("format: {why}")));
    match fields.get("format") {
        None => wrong(format!("it is missing; {expected}")),
        Some(format) => match manifest::FORMATS.into_iter().find(|ours| format == ours) {
            Some(format) => Ok(format),
            None => wrong(format!("{}; {expected}, as a number", objects::shown(format))),
        },
    }
}

/// Reads a policy file's test data from the file's tensors. It is an error if a tensor of the test data is missing or
/// has another shape.
pub(super) fn probe(tensors: &TensorsByName, probed: &Probed) -> Result<Probe, WeightsError> {
    let first = tensors.get(PROBE_TENSORS[0]).and_then(|tensor| tensor.shape().first()).copied();
    // A wrong number of robots is refused as a shape below.
    let robots = first.filter(|robots| (1..=Probe::MOST_ROBOTS).contains(robots)).unwrap_or(1);
    let of = |name: &str, width: usize, hint: &'static str| floats(tensors, name, &[robots, width], hint);
    let widths = [2, 2, 2, robots, probed.latent, 4];
    let mut read =
        PROBE_TENSORS.iter().zip(widths).map(|(name, width)| of(name, width, " (a probe has all six of its tensors)"));
    let mut next = || read.next().expect("there are six tensors");
    let (position, velocity, goal) = (next()?, next()?, next()?);
    let (age_s, latent, output) = (next()?, next()?, next()?);
    let heard = match probed.heard {
        true => of(HEARD, robots, " (a probe of format 2 says who received whom)")?,
        false => vec![1.0; robots * robots],
    };
    let observed = |width| of(OBSERVATION, width, " (the policy takes channels)");
    let observation = probed.observation.map(observed).transpose()?;
    let memory = probed.memory.map(|width| of(MEMORY, width, " (the policy has a memory)")).transpose()?;
    let (heard, memory) = (heard.into_iter().map(|heard| heard > 0.0).collect(), memory.unwrap_or_default());
    Ok(Probe { position, velocity, goal, age_s, latent, output, heard, observation, memory })
}

/// Tensors of a layer in a policy file: the name of the weights, the name of the biases, and the shape \[out, in\].
pub(crate) type LayerTensors = (String, String, [usize; 2]);

/// Returns the tensors of each layer of the network `name`. `widths` are the numbers of inputs and of each layer's
/// outputs.
pub(super) fn layer_names<'a>(name: &'a str, widths: &'a [usize]) -> impl Iterator<Item = LayerTensors> + 'a {
    widths.windows(2).enumerate().map(move |(depth, pair)| {
        let at = 2 * depth;
        (format!("{name}.{at}.weight"), format!("{name}.{at}.bias"), [pair[1], pair[0]])
    })
}

/// Tensors of a policy file, by name.
pub(super) type TensorsByName<'a> = BTreeMap<String, TensorView<'a>>;

/// Returns the layers of the three networks of a policy of format 1, called `names`.
pub(super) fn layout(manifest: &Manifest, names: [&str; 3]) -> Vec<Vec<LayerTensors>> {
    let widths = [&manifest.encoder, &manifest.message, &manifest.update];
    names.iter().zip(widths).map(|(name, widths)| layer_names(name, widths).collect()).collect()
}

/// Returns the layer of these tensors. It is an error if one is missing or wrong.
pub(super) fn layer(tensors: &TensorsByName, (weight, bias, shape): &LayerTensors) -> Result<Layer, WeightsError> {
    let weight = floats(tensors, weight, shape, "")?;
    Ok(Layer::new(&weight, &floats(tensors, bias, &shape[..1], " (zeros, if the layer has no bias)")?))
}

/// Returns the numbers of the tensor `name`. It is an error if the tensor is missing, is not of finite 32-bit floats,
/// or does not have the shape `shape`. `hint` is a possible cause, which ends the message if the tensor is missing.
fn floats(tensors: &TensorsByName, name: &str, shape: &[usize], hint: &'static str) -> Result<Vec<f32>, WeightsError> {
    let (name, expected) = (name.to_owned(), shape.to_vec());
    let Some(tensor) = tensors.get(&name) else { return Err(WeightsError::Missing { name, expected, hint }) };
    if tensor.dtype() != Dtype::F32 {
        return Err(WeightsError::Type { name, found: tensor.dtype().to_string(), expected });
    }
    if tensor.shape() != shape {
        return Err(WeightsError::Shape { name, found: tensor.shape().to_vec(), expected });
    }
    let floats: Vec<f32> = tensor.data().as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)).collect();
    if let Some(index) = floats.iter().position(|float| !float.is_finite()) {
        return Err(WeightsError::NotFinite { name, expected, index, value: floats[index] });
    }
    Ok(floats)
}

/// Checks that the hash that the manifest states is that of the tensors.
pub(super) fn check_hash(tensors: &TensorsByName, stated: &str) -> Result<(), WeightsError> {
    let found = hash(tensors);
    let wrong = |why: String| Err(WeightsError::Manifest(format!("sha256: {why}")));
    if found == stated {
        return Ok(());
    }
    if found.eq_ignore_ascii_case(stated) {
        return wrong("it is the tensors' hash in upper case; write its letters in lower case".to_owned());
    }
    if stated.len() != found.len() || !stated.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        let shown = objects::shown(&stated.into());
        return wrong(format!("{shown}; expected 64 hexadecimal digits, those of all tensors' bytes by their names"));
    }
    Err(WeightsError::Hash { found, expected: stated.to_owned() })
}

/// Returns the SHA-256 of all tensors' bytes in the order of their names, in hexadecimal.
fn hash(tensors: &TensorsByName) -> String {
    let mut hash = Hash::new();
    tensors.values().for_each(|tensor| hash.update(tensor.data()));
    HEXLOWER.encode(&hash.finalize())
}

/// Weights and biases of a policy's three networks: encoder, message network and update network. Each network is a list
/// of layers, and each layer a pair of row-major weights \[out, in\] and biases \[out\].
pub type Tensors = [Network; 3];
/// Weights and biases of a network: a list of layers, each a pair of row-major weights \[out, in\] and biases \[out\].
pub type Network = Vec<(Vec<f32>, Vec<f32>)>;

/// Returns the bytes of a policy file of format 1 with this manifest and these weights. The field `sha256` of the
/// manifest is replaced by the hash of the weights.
///
/// # Panics
/// If the weights do not have the shapes that the manifest states.
pub fn write(manifest: &Manifest, tensors: &Tensors) -> Vec<u8> {
    let described = |sha256: String| {
        let manifest = Manifest { sha256, ..manifest.clone() };
        serde_json::to_string(&manifest).expect("a manifest is JSON")
    };
    serialized(layout(manifest, NAMES), tensors, described)
}

/// Returns the bytes of a policy file whose networks have the layers `layout` with these weights. `manifest` returns
/// the text of the manifest with the hash of the weights.
///
/// # Panics
/// If the weights do not have the shapes of the layout.
pub(super) fn serialized(
    layout: Vec<Vec<LayerTensors>>,
    networks: &[Network],
    manifest: impl FnOnce(String) -> String,
) -> Vec<u8> {
    let bytes = |floats: &[f32]| floats.iter().flat_map(|float| float.to_le_bytes()).collect::<Vec<u8>>();
    let mut entries: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
    assert_eq!(layout.len(), networks.len(), "there are weights for each network");
    for (network, layers) in layout.into_iter().zip(networks) {
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
    safetensors::write(Some((manifest::KEY.to_owned(), manifest(hash(&tensors)))), &tensors)
}
