//! Errors of a trial that cannot be set up.

use crate::config::ConfigError;
use crate::scenario::ScenarioError;

/// Error of a trial that cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// The scenario cannot be made: its name is unknown, or its settings do not fit.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A setting of the deployment is invalid; the error names the field.
    #[error(transparent)]
    Deployment(#[from] ConfigError),
    /// No preset deployment mode has the given name.
    #[error("there is no mode '{name}'; there are: {}", crate::deploy::MODES.join(", "))]
    Mode {
        /// The name that was not found.
        name: String,
    },
}
