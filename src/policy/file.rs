//! Policy files of formats 1 and 2: manifest, networks and test data, read and checked completely.
//!
//! The tensors of a network are `NAME.N.weight` \[out, in\] and `NAME.N.bias` \[out\], with N = 0, 2, 4, ... as in a
//! PyTorch `Sequential` with activations between. In format 1, NAME is `encoder`, `message` or `update`. The file
//! published with the paper calls the last two `gnn` and `post` and has no manifest. In format 2, NAME is `encoder`,
//! `decoder`, or `hops.K.` with `message`, `score`, `query`, `key` or `update`, with K = 0, 1, ... The tensors of a
//! memory are `memory.input` and `memory.state`. Tensors `probe.*` are a [`Probe`]. No file is opened here: the caller
//! passes the bytes of the file.

use serde::Serialize;

use super::hops::entry::{self, Entry};
use super::hops::gru::Gru;
use super::hops::hop::Hop;
use super::hops::manifest::{self as hops, Deviation, Distribution, Layers};
use super::hops::output::Meaning;
use super::hops::perceptron::{Activation, Perceptron};
use super::manifest::{Architecture, KEY, Manifest, Training};
use super::mlp::Layer;
use super::safetensors::SafeTensors;
use super::weights::{self, LayerTensors, NAMES, PUBLISHED_NAMES, Probe, Probed, TensorsByName, WeightsError};
use super::{Draw, Interface};
use crate::config::objects;
use crate::time::Span;

/// Manifest of a policy file: how its networks are built, what the policy observes, and how it was trained.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum AnyManifest {
    /// Manifest of a file of format 1, or of one without a manifest.
    Format1(Manifest),
    /// Manifest of a file of format 2.
    Format2(hops::Manifest),
}

impl AnyManifest {
    /// Returns the manifest of a file of format 1, or of one without a manifest; `None` for one of another format.
    pub fn format_1(&self) -> Option<&Manifest> {
        match self {
            AnyManifest::Format1(manifest) => Some(manifest),
            AnyManifest::Format2(_) => None,
        }
    }

    /// Returns the name of the policy's kind in reports.
    pub fn kind(&self) -> &'static str {
        match self {
            AnyManifest::Format1(Manifest { architecture: Architecture::Published, .. }) => "gnn",
            AnyManifest::Format1(_) => "gnn-full",
            AnyManifest::Format2(_) => "gnn-hops",
        }
    }

    /// Returns the name of the scenario for which the policy was trained.
    pub fn scenario(&self) -> &str {
        match self {
            AnyManifest::Format1(manifest) => &manifest.scenario,
            AnyManifest::Format2(manifest) => &manifest.scenario,
        }
    }

    /// Returns the default method of drawing an action.
    pub fn draw(&self) -> Draw {
        match self {
            AnyManifest::Format1(manifest) => manifest.draw,
            AnyManifest::Format2(manifest) => manifest.draw,
        }
    }

    /// Returns the training run that made the file; `None` if the file does not state it.
    pub fn training(&self) -> Option<&Training> {
        match self {
            AnyManifest::Format1(manifest) => manifest.training.as_ref(),
            AnyManifest::Format2(manifest) => manifest.training.as_ref(),
        }
    }

    /// Returns the name of what the policy's messages mean; empty if no other policy understands them.
    pub fn message_name(&self) -> &str {
        let name = match self {
            AnyManifest::Format1(manifest) => &manifest.message_name,
            AnyManifest::Format2(manifest) => &manifest.message_name,
        };
        name.as_deref().unwrap_or_default()
    }

    /// Returns the manifest with this name of what the policy's messages mean.
    pub fn with_message_name(self, message_name: Option<String>) -> AnyManifest {
        match self {
            AnyManifest::Format1(manifest) => AnyManifest::Format1(Manifest { message_name, ..manifest }),
            AnyManifest::Format2(manifest) => AnyManifest::Format2(hops::Manifest { message_name, ..manifest }),
        }
    }

    /// Returns the entries of the observation, in the order of the encoder's inputs.
    pub fn observation(&self) -> Vec<Entry> {
        match self {
            AnyManifest::Format1(manifest) => manifest.observation.iter().copied().map(Entry::from).collect(),
            AnyManifest::Format2(manifest) => manifest.observation.clone(),
        }
    }

    /// Returns the longest time between two steps after which the policy goes on from its state; `None` for a policy
    /// without state.
    pub(crate) fn forgets_after(&self) -> Option<Span> {
        match self {
            AnyManifest::Format1(_) => None,
            AnyManifest::Format2(manifest) => manifest.memory.map(|memory| Span::from_secs(memory.after_gap_s)),
        }
    }

    /// Returns the parameters that the rest of the system needs to run the policy, of a message of `features` floats.
    pub(crate) fn interface(&self, features: usize) -> Interface {
        let (radius_m, rate_hz, limit_m_s, hold_s) = match self {
            AnyManifest::Format1(m) => (m.radius_m, m.rate_hz, m.limit_m_s, m.hold_s),
            AnyManifest::Format2(m) => (m.radius_m, m.rate_hz, m.limit_m_s, m.hold_s),
        };
        let (period, hold) = (Span::from_secs(1.0 / rate_hz), Span::from_secs(hold_s));
        Interface { features, radius_m, period, limit_m_s, hold }
    }

    /// Returns the meaning of the network's outputs.
    pub(crate) fn meaning(&self) -> Meaning {
        let Interface { period, limit_m_s, .. } = self.interface(0);
        let (action, distribution, deviation, log_std_max) = match self {
            AnyManifest::Format1(m) => {
                (Default::default(), Distribution::DiagonalNormal, Deviation::Log, m.log_std_max)
            }
            AnyManifest::Format2(m) => (m.action, m.distribution, m.deviation, m.log_std_max),
        };
        Meaning { action, distribution, deviation, log_std_max, limit_m_s, period }
    }
}

/// Content of a policy file that has been checked: metadata, weights and test data.
#[derive(Debug)]
pub struct PolicyFile {
    /// Manifest of the policy file. For a file without a manifest, it is that of the policy published with the paper.
    pub manifest: AnyManifest,
    /// Assumptions made because the file has no manifest or an incomplete one, as text for the user; `None` if nothing
    /// was assumed.
    pub assumed: Option<String>,
    /// Digest of the whole file: the first 64 bits of its BLAKE3 hash, in hexadecimal.
    pub(crate) digest: String,
    /// Number of weights and biases of all networks.
    pub(crate) parameters: usize,
    pub(crate) networks: Networks,
    /// Test data with which the networks are to be compared; `None` if the file has none.
    pub probe: Option<Probe>,
}

/// Networks of a policy.
#[derive(Debug)]
pub(crate) struct Networks {
    /// Network that turns an observation into the input of the first hop, or of the memory.
    pub encoder: Perceptron,
    /// State between the encoder and the first hop; `None` for a policy without state.
    pub memory: Option<Gru>,
    /// Hops of the policy in the order in which they are computed.
    pub hops: Vec<Hop>,
    /// Network that turns the output of the last hop into the parameters of the action; `None` if the output is these.
    pub decoder: Option<Perceptron>,
}

/// Parses and checks a policy file, of which `bytes` is the whole content. An error describes the first fault found.
/// The networks are not compared with the file's test data; `probe::network` does that.
pub fn read(bytes: &[u8]) -> Result<PolicyFile, WeightsError> {
    let SafeTensors { metadata, tensors } = weights::tensors(bytes)?;
    let Some(text) = metadata.get(KEY) else {
        // Whatever is wrong, the cause is the missing manifest.
        let file = format_1(bytes, &tensors, None);
        return file.map_err(|error| WeightsError::NoManifest(Box::new(error)));
    };
    if weights::format(text)? == hops::FORMAT {
        let manifest: hops::Manifest = objects::parse(text).map_err(WeightsError::Manifest)?;
        manifest.check().map_err(WeightsError::Manifest)?;
        return format_2(bytes, &tensors, manifest);
    }
    let manifest: Manifest = objects::parse(text).map_err(WeightsError::Manifest)?;
    manifest.check().map_err(WeightsError::Manifest)?;
    format_1(bytes, &tensors, Some(manifest))
}

/// Reads the tensors of a file of format 1 with the manifest `given`; without one, those of the published network.
fn format_1(bytes: &[u8], tensors: &TensorsByName, given: Option<Manifest>) -> Result<PolicyFile, WeightsError> {
    let stated = given.as_ref().map(|manifest| manifest.sha256.clone());
    let (manifest, names, assumed) = match given {
        Some(manifest) => {
            let assumed = assumed(&manifest);
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
    let layout = weights::layout(&manifest, names);
    let read = |network: &Vec<LayerTensors>| -> Result<Vec<Layer>, WeightsError> {
        network.iter().map(|layer| weights::layer(tensors, layer)).collect()
    };
    let (encoder, message, update) = (read(&layout[0])?, read(&layout[1])?, read(&layout[2])?);
    let latent = manifest.encoder.last().copied().unwrap_or(0);
    let hop = Hop::of_format_1(manifest.architecture, latent, &manifest.edge, [&message, &update]);
    let encoder = Perceptron::new(encoder, Activation::Relu, Activation::Linear);
    let networks = Networks { encoder, memory: None, hops: vec![hop], decoder: None };
    let probed = Probed { latent, heard: false, observation: None, memory: None };
    let (parameters, probe) = complete(tensors, &layout, &probed, stated.as_deref())?;
    let (manifest, digest) = (AnyManifest::Format1(manifest), digest(bytes));
    Ok(PolicyFile { manifest, assumed, digest, parameters, networks, probe })
}

/// Reads the tensors of a file of format 2 with this checked manifest.
fn format_2(bytes: &[u8], tensors: &TensorsByName, manifest: hops::Manifest) -> Result<PolicyFile, WeightsError> {
    let network = |name: &str, layers: &Layers| {
        let read = weights::layer_names(name, &layers.widths).map(|layer| weights::layer(tensors, &layer));
        let read = read.collect::<Result<_, WeightsError>>()?;
        Ok(Perceptron::new(read, layers.activation.unwrap_or_default(), layers.output_activation))
    };
    let encoder = network("encoder", &manifest.encoder)?;
    let decoder = Some(network("decoder", &manifest.decoder)?);
    let cell = |[input, state]: [LayerTensors; 2]| -> Result<Gru, WeightsError> {
        Ok(Gru::new(weights::layer(tensors, &input)?, weights::layer(tensors, &state)?))
    };
    let memory = manifest.memory.map(|memory| cell(memory.tensors(encoder.outputs()))).transpose()?;
    let (mut hops, mut begins) = (Vec::new(), 0);
    for (at, (form, input)) in manifest.hops.iter().zip(manifest.widths()).enumerate() {
        let load = |name: &str, layers: &Layers| network(&format!("hops.{at}.{name}"), layers);
        hops.push(Hop::new(form, (begins, input), &manifest.edge, load)?);
        begins += input;
    }
    let takes_channels = manifest.observation.iter().any(|entry| entry.request().is_some());
    let probed = Probed {
        latent: manifest.latent(),
        heard: true,
        observation: takes_channels.then(|| entry::floats(&manifest.observation)),
        memory: manifest.memory.map(|memory| memory.floats),
    };
    let (parameters, probe) = complete(tensors, &manifest.tensors(), &probed, Some(&manifest.sha256))?;
    let (manifest, digest) = (AnyManifest::Format2(manifest), digest(bytes));
    let networks = Networks { encoder, memory, hops, decoder };
    Ok(PolicyFile { manifest, assumed: None, digest, parameters, networks, probe })
}

/// Reads the test data of a file, and checks that it has no tensor beside them and the layers of `layout`, and that the
/// tensors have the hash that its manifest states. Returns the number of weights and biases, too.
fn complete(
    tensors: &TensorsByName,
    layout: &[Vec<LayerTensors>],
    probed: &Probed,
    stated: Option<&str>,
) -> Result<(usize, Option<Probe>), WeightsError> {
    let layers = || layout.iter().flatten();
    let probe = tensors.keys().any(|name| name.starts_with(weights::PROBE));
    let probe = probe.then(|| weights::probe(tensors, probed)).transpose()?;
    let known = |name: &&String| {
        layers().any(|(weight, bias, _)| *name == weight || *name == bias)
            || probed.names().any(|probed| probed == *name)
    };
    if let Some(unknown) = tensors.keys().find(|name| !known(name)) {
        return Err(WeightsError::Unknown(unknown.clone()));
    }
    stated.map_or(Ok(()), |stated| weights::check_hash(tensors, stated))?;
    Ok((layers().map(|(_, _, [outputs, inputs])| (inputs + 1) * outputs).sum(), probe))
}

fn digest(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex()[..16].to_owned()
}

/// Returns the assumptions made about entries that a manifest of format 1 leaves out (activation, aggregation), as text
/// for the user; `None` if nothing is assumed. For files of this crate's trainer nothing is: it has one activation and
/// one aggregation only.
fn assumed(manifest: &Manifest) -> Option<String> {
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
