//! Message of a policy in its contract: its size, and how it travels.

use murmurate::messages::wire::{Encoding, Form, Missing};
use serde::{Deserialize, Serialize};

/// Message that a robot broadcasts in each step.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Message {
    /// Number of floats; zero if a robot's position and velocity are all that its neighbours use.
    pub floats: usize,
    /// Name of what the floats mean, which other policies that were made for the same team have, too; `None` if only
    /// robots of this very policy understand them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Encoding of the floats, to which they are rounded before they are sent.
    #[serde(default)]
    pub encoding: Encoding,
    /// Use of a message of which some parts have not arrived, if it travels in parts.
    #[serde(default)]
    pub missing: Missing,
}

impl Message {
    /// Returns the form in which the message travels.
    pub fn form(&self) -> Form {
        Form { encoding: self.encoding, missing: self.missing }
    }

    /// Returns the number of bytes of the floats of a message.
    pub fn bytes(&self) -> usize {
        self.floats * self.encoding.bytes()
    }
}
