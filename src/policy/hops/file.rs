//! Writing of policy files of format 2.

use super::manifest::Manifest;
use crate::policy::weights::{self, Network};

/// Weights of a policy, network by network. The networks are the encoder, the memory, those of each hop
/// (`manifest::Hop::networks`), and the decoder. The memory has two layers, of its input and of its state.
pub type Tensors = Vec<Network>;

/// Returns the bytes of a policy file of format 2 with this manifest and these weights. The field `sha256` of the
/// manifest is replaced by the hash of the weights.
///
/// # Panics
/// If the weights do not have the shapes that the manifest states.
pub fn write(manifest: &Manifest, tensors: &Tensors) -> Vec<u8> {
    weights::serialized(manifest.tensors(), tensors, |sha256| {
        serde_json::to_string(&Manifest { sha256, ..manifest.clone() }).expect("a manifest is JSON")
    })
}
