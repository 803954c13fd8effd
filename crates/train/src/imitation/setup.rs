//! Setup of a training by imitation: what policy and expert take of the scenario, and the errors of what does not fit.

use std::sync::Arc;

use crate::channels::Channels;
use crate::experts::known;
use murmurate::observation::Request;
use murmurate::scenario::{Scenario, ScenarioError};

/// Error of a training by imitation that cannot be set up or resumed.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// The scenario cannot be built.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The scenario is not one in which training by imitation is supported; the text says why.
    #[error("the scenario '{scenario}': {why}")]
    Unsupported {
        /// Name of the scenario.
        scenario: String,
        /// Reason.
        why: &'static str,
    },
    /// The expert cannot be made.
    #[error("expert: '{name}': {why}")]
    Expert {
        /// Name of the expert in the configuration.
        name: String,
        /// Reason.
        why: String,
    },
    /// The scenario has not what the policy observes; the text names the field.
    #[error("policy.observation: {0}")]
    Observation(String),
    /// The bytes are not a checkpoint of this training by imitation.
    #[error("not a complete checkpoint of this version of the program: {0}")]
    Format(String),
    /// The file is of another kind than a checkpoint; the text says of which, and what to give instead.
    #[error("it is {0}")]
    Foreign(&'static str),
    /// The checkpoint is of a processor with other vector instructions, so results would be those of neither.
    #[error("it is of another processor: its vector instructions are {theirs} there and {ours} here")]
    Processor {
        /// Instructions in the checkpoint.
        theirs: String,
        /// Instructions of this processor.
        ours: String,
    },
}

/// Joins the channels that a policy takes with those of the scenario; `None` if it takes none. An error says which the
/// scenario has not, or that one of them has no value in training.
pub(super) fn channels(requests: &[Request], scenario: &Arc<dyn Scenario>) -> Result<Option<Channels>, String> {
    let channels = Channels::of_scenario(requests, scenario).map_err(|error| error.to_string())?;
    match known(channels.as_ref(), &**scenario) {
        true => Ok(channels),
        false => {
            Err("a channel has no value in training by imitation, which knows no heading; leave it out".to_owned())
        }
    }
}
