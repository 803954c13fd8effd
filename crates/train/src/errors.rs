//! Errors of trainings by rewards: of one that cannot be set up or resumed, and of one that diverged.

use murmurate::config::ConfigError;
use murmurate::scenario::ScenarioError;

/// Error of a training that diverged and cannot continue.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "iteration {iteration} ({decisions} decisions): non-finite value in {what}; the likely cause is a learning rate \
     ({learning_rate:e}) or a reward scale that is too high"
)]
pub struct Diverged {
    /// Index of the failed iteration, from 1.
    pub iteration: u64,
    /// Number of decisions before the failed iteration.
    pub decisions: u64,
    /// Name of the first quantity that was not finite.
    pub what: &'static str,
    /// Learning rate of the failed update.
    pub learning_rate: f32,
}

/// Error of a training that cannot be set up or resumed.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// The scenario does not exist, or cannot be built with the configured settings.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The policy's observation has a channel that a scenario has not, or a sense has a wrong setting.
    #[error(transparent)]
    Observation(#[from] ConfigError),
    /// The bytes are not a checkpoint of this version of the program; the text says why.
    #[error("not a complete checkpoint of this version of the program: {0}")]
    Format(String),
    /// The file is of another kind than a checkpoint; the text says of which, and what to give instead.
    #[error("it is {0}")]
    Foreign(&'static str),
    /// The checkpoint is of a training with another network, or of a processor with other vector instructions.
    #[error("it is of another training: {what} is {theirs} there and {ours} here")]
    Other {
        /// Name of the property that differs.
        what: &'static str,
        /// Value of the property in the checkpoint.
        theirs: String,
        /// Value of the property in the requested training.
        ours: String,
    },
    /// The expert cannot be made; the text says why.
    #[error("expert.policy: '{name}': {why}")]
    Expert {
        /// Name of the expert in the configuration.
        name: String,
        /// Reason.
        why: String,
    },
    /// The groups of a stage have another number of robots than the scenario.
    #[error(
        "curriculum: its groups have {found} robots; the team has {robots}: change 'groups', or start from what \
         'murmurate train SCENARIO --print-config' prints"
    )]
    Groups {
        /// Number of robots in the groups of one environment together.
        found: usize,
        /// Number of robots in the scenario's team.
        robots: usize,
    },
    /// The scenario has no goals, so progress and arrival earn nothing, and its own reward has no weight.
    #[error(
        "reward.scenario: 0, but robots of the scenario '{scenario}' have no goals to be rewarded for; raise it, or \
         train by imitation: --preset imitation"
    )]
    NoGoals {
        /// Name of the scenario.
        scenario: String,
    },
    /// The configuration sets a weight for the scenario's own reward, but the scenario has none.
    #[error("reward.scenario: {weight}, but the scenario '{scenario}' has no reward of its own; set it to 0")]
    NoReward {
        /// Name of the scenario.
        scenario: String,
        /// Configured weight of the scenario's own reward.
        weight: f32,
    },
}
