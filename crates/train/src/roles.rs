//! Roles in the configuration of a training: robots with networks and observations of their own, which are trained
//! together with those whose messages they hear.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use murmurate::policy::hops::entry::Entry;

/// Roles of a team, by their names. The index of a role is its place in their order.
pub type Roles = BTreeMap<String, Role>;

/// Robots of one role, and what their policy has in place of the fields of `policy` with the same names. All other
/// fields are those of all roles, since robots of all roles hear each other.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Role {
    /// Ids of the robots that have the role: in smaller teams of the curriculum, of those that are there.
    pub robots: Vec<u16>,
    /// Entries of a robot's observation, in the order of the network's inputs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub observation: Option<Vec<Entry>>,
    /// Widths of the encoder's layers. The last width is that of all roles: the latent that robots broadcast.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encoder: Option<Vec<usize>>,
    /// Widths of the layers of the network that makes messages from the latents that robots of the role hear.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub message: Option<Vec<usize>>,
    /// Widths of the layers of the update network, without the output layer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub update: Option<Vec<usize>>,
}

impl Role {
    /// Whether the role has a field of a policy of its own.
    pub(super) fn has(&self, field: &str) -> bool {
        match field {
            "observation" => self.observation.is_some(),
            "encoder" => self.encoder.is_some(),
            "message" => self.message.is_some(),
            "update" => self.update.is_some(),
            _ => false,
        }
    }
}

/// Returns the name of what robots of all roles mean by their messages, with these weights of all roles.
pub(super) fn message_name(weights: &[f32]) -> String {
    let mut hasher = blake3::Hasher::new();
    for weight in weights {
        hasher.update(&weight.to_le_bytes());
    }
    format!("roles of one training, {}", &hasher.finalize().to_hex()[..16])
}
