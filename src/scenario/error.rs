//! Error of a scenario that cannot be made.

use super::TeamSizes;
use crate::config::ConfigError;

/// Error of a scenario that cannot be made from its name and settings.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// There is no scenario with the requested name.
    #[error("there is no scenario '{name}'; there are: {known}")]
    Unknown {
        /// Name of the requested scenario.
        name: String,
        /// Names of the existing scenarios, separated by commas.
        known: String,
    },
    /// The scenario does not support the requested number of robots.
    #[error("the scenario '{scenario}' takes {sizes}, not {robots}")]
    Robots {
        /// Name of the scenario.
        scenario: String,
        /// Numbers of robots that the scenario supports.
        sizes: TeamSizes,
        /// Number of robots that was requested.
        robots: usize,
    },
    /// The scenario does not support the requested width of its bottleneck, or has no bottleneck.
    #[error("the scenario '{scenario}' has no gap of {gap_m} m{hint}")]
    Gap {
        /// Name of the scenario.
        scenario: String,
        /// Width of the bottleneck that was requested \[m\].
        gap_m: f32,
        /// Supported widths, or the reason why there are none; a text that ends the error message.
        hint: &'static str,
    },
    /// The scenario does not support the requested scale, hull or width of its bottleneck.
    #[error("the scenario '{scenario}' {why}")]
    Size {
        /// Name of the scenario.
        scenario: String,
        /// Name of the setting: `scale`, `hull_m` or `gap_m`.
        field: &'static str,
        /// Supported values, or the reason why there are none; a text that ends the error message.
        why: String,
    },
    /// The scenario refuses its settings for a reason that the other errors do not cover.
    #[error("the scenario '{scenario}': {why}")]
    Refused {
        /// Name of the scenario.
        scenario: String,
        /// Reason of the refusal, for the user.
        why: String,
    },
    /// A task file cannot be read.
    #[error("{0}")]
    Unreadable(String),
    /// The text of a task file is none of a task.
    #[error("the task file '{file}': {why}")]
    Unread {
        /// Path of the file, as it was given.
        file: String,
        /// Description of the fault.
        why: String,
    },
    /// A field of a task file is wrong, or cannot be with the others and with the settings.
    #[error("the task '{scenario}': {error}")]
    TaskFile {
        /// Name of the task.
        scenario: String,
        /// Error that names the field.
        error: ConfigError,
    },
}

impl ScenarioError {
    /// Returns the name of the setting that is wrong: `scenario`, `robots`, `gap_m`, `scale` or `hull_m`.
    pub fn field(&self) -> &'static str {
        match self {
            ScenarioError::Robots { .. } => "robots",
            ScenarioError::Gap { .. } => "gap_m",
            ScenarioError::Size { field, .. } => field,
            ScenarioError::Unknown { .. }
            | ScenarioError::Refused { .. }
            | ScenarioError::Unreadable(_)
            | ScenarioError::Unread { .. }
            | ScenarioError::TaskFile { .. } => "scenario",
        }
    }
}
