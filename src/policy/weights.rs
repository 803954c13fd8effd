//! Reading and writing of policy files: safetensors with a manifest, checked completely.
//!
//! The tensors of the encoder are `encoder.N.weight` \[out, in\] and `encoder.N.bias` \[out\]; those of the networks
//! `message` and `update` are named likewise. N counts 0, 2, 4, ... as in a PyTorch `Sequential` with its ReLUs. The
//! file published with the paper calls these two networks `gnn` and `post` and has no manifest. Tensors `probe.*` are a
//! [`Probe`]. No file is opened here: the caller passes the bytes of the file.

use std::collections::BTreeMap;

use data_encoding::HEXLOWER;
use hmac_sha256::Hash;

use super::manifest::{self, Manifest};
use super::mlp::{Layer, Mlp};
use super::safetensors::{self, Dtype, SafeTensors, TensorView};
use crate::config::kinds::FileKind;
use crate::config::objects;

/// Tensor name prefixes of the three networks, in the order of use.
const NAMES: [&str; 3] = ["encoder", "message", "update"];
/// Tensor name prefixes of the three networks in the policy file published with the paper, in the order of use:
/// encoder, message network, update network.
const PUBLISHED_NAMES: [&str; 3] = ["encoder", "gnn", "post"];

/// Prefix of the names of the tensors in a policy file that hold its test data ([`Probe`]: inputs and correct outputs).
pub(super) const PROBE: &str = "probe.";
/// Names of the tensors that hold a policy file's test data, in the order of [`Probe`]'s fields; each tensor has one
/// row per robot.
pub(super) const PROBE_TENSORS: [&str; 6] =
    ["probe.position", "probe.velocity", "probe.goal", "probe.age", "probe.latent", "probe.output"];

/// Test data in a policy file: inputs for a team of robots and the network's correct outputs for them. The program that
/// exported the policy stored them. Every robot has a message of every other one. All lists are row-major, with one row
/// per robot.
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
}

impl Probe {
    /// Largest number of robots in a policy file's test data.
    pub(crate) const MOST_ROBOTS: usize = 64;
}

/// Content of a policy file of format 1 that has been checked: metadata, weights and test data.
#[derive(Debug)]
pub struct PolicyFile {
    /// Manifest of the policy file. For a file without a manifest, it is that of the policy published with the paper.
    pub manifest: Manifest,
    /// Assumptions made because the file has no manifest or an incomplete one, as text for the user; `None` if nothing
    /// was assumed.
    pub assumed: Option<String>,
    /// Digest of the whole file: the first 64 bits of its BLAKE3 hash, in hexadecimal.
    pub(crate) digest: String,
    /// The three networks of the policy: encoder, message network and update network.
    pub networks: [Mlp; 3],
    /// Test data with which the networks are to be compared; `None` if the file has none.
    pub probe: Option<Probe>,
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

/// Checks that the manifest `text` says of which format it is, and that this program reads that. The other fields of
/// another format would be errors that say less.
fn check_format(text: &str) -> Result<(), WeightsError> {
    let Ok(serde_json::Value::Object(fields)) = serde_json::from_str(text) else { return Ok(()) };
    let [first, second] = manifest::FORMATS;
    let expected = format!("this program reads {first} and {second}");
    let wrong = |why: String| Err(WeightsError::Manifest(format!("format: {why}")));
    match fields.get("format") {
        None => wrong(format!("it is missing; {expected}")),
        Some(format) if manifest::FORMATS.into_iter().any(|ours| *format == ours) => Ok(()),
        Some(format) => wrong(format!("{}; {expected}, as a number", objects::shown(format))),
    }
}

/// Parses and checks a policy file of format 1, of which `bytes` is the whole content. An error describes the first
/// fault found. The networks are not compared with the file's test data; `probe::network` does that.
pub fn read(bytes: &[u8]) -> Result<PolicyFile, WeightsError> {
    let file = tensors(bytes)?;
    let Some(text) = file.metadata.get(manifest::KEY) else {
        // Whatever is wrong, the cause is the missing manifest.
        return of_manifest(bytes, file.tensors, None).map_err(|error| WeightsError::NoManifest(Box::new(error)));
    };
    check_format(text)?;
    let manifest: Manifest = objects::parse(text).map_err(WeightsError::Manifest)?;
    manifest.check().map_err(WeightsError::Manifest)?;
    of_manifest(bytes, file.tensors, Some(manifest))
}

/// Checks the tensors of a policy file of format 1 against its manifest; without one, against the published network.
fn of_manifest(bytes: &[u8], tensors: TensorsByName, given: Option<Manifest>) -> Result<PolicyFile, WeightsError> {
    let has_manifest = given.is_some();
    let (manifest, names, assumed) = match given {
        Some(manifest) => {
            let assumed = assumed_of(&manifest);
            (manifest, NAMES, assumed)
        }
        None => {
            let manifest = Manifest::published();
            let assumed = format!(
                "it has no manifest; its tensors are those of the published passage network, so the published \
                 conditions are assumed: observation (goal - position, position, position + velocity), radius {} m, \
                 {} Hz, limit {} m/s, actions sampled, messages held {} s",
                manifest.radius_m, manifest.rate_hz, manifest.limit_m_s, manifest.hold_s
            );
            (manifest, PUBLISHED_NAMES, Some(assumed))
        }
    };
    let network = |name: &str, widths: &[usize]| network(&tensors, name, widths);
    let networks = [
        network(names[0], &manifest.encoder)?,
        network(names[1], &manifest.message)?,
        network(names[2], &manifest.update)?,
    ];
    let latent = manifest.encoder.last().copied().unwrap_or(0);
    let probe = tensors.keys().any(|name| name.starts_with(PROBE)).then(|| probe(&tensors, latent)).transpose()?;
    let layers = networks.iter().map(|network| 2 * network.layers().len()).sum::<usize>();
    if tensors.len() > layers + probe.as_ref().map_or(0, |_| PROBE_TENSORS.len()) {
        let widths = [&manifest.encoder, &manifest.message, &manifest.update];
        let known = |name: &str| {
            PROBE_TENSORS.contains(&name)
                || (0..3).any(|k| layer_names(names[k], widths[k]).any(|(w, b, _)| w == name || b == name))
        };
        let unknown = tensors.keys().find(|name| !known(name));
        return Err(WeightsError::Unknown(unknown.cloned().unwrap_or_default()));
    }
    if has_manifest {
        check_hash(&tensors, &manifest.sha256)?;
    }
    let digest = blake3::hash(bytes).to_hex()[..16].to_owned();
    Ok(PolicyFile { manifest, assumed, digest, networks, probe })
}

/// Returns the assumptions made about entries that a manifest leaves out (activation, aggregation), as text for the
/// user; `None` if nothing is assumed. For files of this crate's trainer nothing is: it has one activation and one
/// aggregation only.
fn assumed_of(manifest: &Manifest) -> Option<String> {
    let ours = manifest.training.as_ref().is_some_and(|training| training.program.starts_with(env!("CARGO_PKG_NAME")));
    let left_out: Vec<&str> = [
        manifest.activation.is_none().then_some("\"activation\": \"relu\""),
        manifest.aggregation.is_none().then_some("\"aggregation\": \"sum\""),
    ]
    .into_iter()
    .flatten()
    .collect();
    (!ours && !left_out.is_empty()).then(|| {
        format!("its manifest does not say {0}, which is assumed; if that is right, add it", left_out.join(", "))
    })
}

/// Reads a policy file's test data ([`Probe`]) from the file's tensors; each latent has `latent` floats. It is an error
/// if a tensor of the test data is missing or has another shape.
pub(super) fn probe(tensors: &TensorsByName, latent: usize) -> Result<Probe, WeightsError> {
    let first = tensors.get(PROBE_TENSORS[0]).and_then(|tensor| tensor.shape().first()).copied();
    // A wrong number of robots is refused as a shape below.
    let robots = first.filter(|robots| (1..=Probe::MOST_ROBOTS).contains(robots)).unwrap_or(1);
    let widths = [2, 2, 2, robots, latent, 4];
    let mut read = PROBE_TENSORS
        .iter()
        .zip(widths)
        .map(|(name, width)| floats(tensors, name, &[robots, width], " (a probe has all six of its tensors)"));
    let mut next = || read.next().expect("there are six tensors");
    Ok(Probe { position: next()?, velocity: next()?, goal: next()?, age_s: next()?, latent: next()?, output: next()? })
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

fn network(tensors: &TensorsByName, name: &str, widths: &[usize]) -> Result<Mlp, WeightsError> {
    let layers = layer_names(name, widths).map(|(weight, bias, shape)| {
        Ok(Layer::new(&floats(tensors, &weight, &shape, "")?, &floats(tensors, &bias, &shape[..1], "")?))
    });
    Ok(Mlp::new(layers.collect::<Result<_, WeightsError>>()?))
}

/// Returns the numbers of the tensor `name`. It is an error if the tensor is missing, is not of finite 32-bit floats,
/// or does not have the shape `shape`. `hint` is a possible cause, which ends the message if the tensor is missing.
pub(super) fn floats(
    tensors: &TensorsByName,
    name: &str,
    shape: &[usize],
    hint: &'static str,
) -> Result<Vec<f32>, WeightsError> {
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
pub(super) fn hash(tensors: &TensorsByName) -> String {
    let mut hash = Hash::new();
    tensors.values().for_each(|tensor| hash.update(tensor.data()));
    HEXLOWER.encode(&hash.finalize())
}

/// Weights and biases of a policy's three networks: encoder, message network and update network. Each network is a list
/// of layers, and each layer a pair of row-major weights \[out, in\] and biases \[out\].
pub type Tensors = [Vec<(Vec<f32>, Vec<f32>)>; 3];

/// Returns the bytes of a policy file of format 1 with this manifest and these weights. The field `sha256` of the
/// manifest is replaced by the hash of the weights.
///
/// # Panics
/// If the weights do not have the shapes that the manifest states.
pub fn write(manifest: &Manifest, tensors: &Tensors) -> Vec<u8> {
    let widths = [&manifest.encoder, &manifest.message, &manifest.update];
    let mut entries: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
    for (network, layers) in tensors.iter().enumerate() {
        for ((weight_name, bias_name, shape), (weight, bias)) in
            layer_names(NAMES[network], widths[network]).zip(layers)
        {
            let bytes = |floats: &[f32]| floats.iter().flat_map(|float| float.to_le_bytes()).collect::<Vec<u8>>();
            assert_eq!((weight.len(), bias.len()), (shape[0] * shape[1], shape[0]), "{weight_name} has its shape");
            entries.push((weight_name, shape.to_vec(), bytes(weight)));
            entries.push((bias_name, vec![shape[0]], bytes(bias)));
        }
    }
    let tensors = entries.iter().map(|(name, shape, data)| {
        let tensor = TensorView::new(Dtype::F32, shape.clone(), data).expect("a tensor has its shape");
        (name.clone(), tensor)
    });
    let tensors: TensorsByName = tensors.collect();
    let sha256 = hash(&tensors);
    let manifest = Manifest { sha256, ..manifest.clone() };
    let json = serde_json::to_string(&manifest).expect("a manifest is JSON");
    safetensors::write(Some((manifest::KEY.to_owned(), json)), &tensors)
}
