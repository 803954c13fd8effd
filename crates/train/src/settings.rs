//! Settings of a rollout, which all chunks of environments share.

use super::config::{Config, Reward};
use super::experts::Expert;
use super::network::{Network, TeamNetwork};

/// Largest number of rows (environments) in a chunk, which one thread steps together. The network evaluates all rows of
/// a chunk at once, and their activations fit into a processor core's private cache.
pub const CHUNK: usize = 32;

/// Number of successive decisions of a row that are learnt together if a policy is recurrent, unless configured.
const WINDOW: usize = 8;
/// Number of decisions before these that count, too, unless configured.
const LOOKBACK: usize = 1;

/// Settings of a rollout that are the same for all chunks. A chunk is a group of environments that one thread steps
/// together.
#[derive(Debug)]
pub struct RolloutSettings<'a> {
    /// Configuration of the training.
    pub config: &'a Config,
    /// Layout of the policy's network, or of those of all roles; the weights are passed separately.
    pub actor: &'a TeamNetwork,
    /// Layout of the critic's network; its weights are passed separately.
    pub critic: &'a Network,
    /// Weights of the terms of a robot's reward in the current stage of the curriculum.
    pub reward: Reward,
    /// Number of simulated steps of 50 ms for which an action is held.
    pub repeat: u32,
    /// Upper limit of the actions' log standard deviation.
    pub log_std_max: f32,
    /// Policy that is imitated besides; `None` for rewards alone.
    pub expert: Option<WeightedExperts<'a>>,
}

/// Experts whose velocities are recorded in a rollout, with the weight of the difference from them.
#[derive(Clone, Copy, Debug)]
pub struct WeightedExperts<'a> {
    /// Expert for each team size that occurs, indexed by it.
    pub experts: &'a [Option<Expert>],
    /// Weight in the policy's loss of the squared difference from the expert's velocity \[s²/m²\], above 0.
    pub weight: f32,
}

impl RolloutSettings<'_> {
    /// Returns the number of steps that the policy takes for each decision. One that is recurrent takes one in every
    /// step of 50 ms, as a robot does, and its action is held; another only makes decisions.
    pub fn policy_steps(&self) -> u32 {
        if self.actor.is_recurrent() { self.repeat } else { 1 }
    }

    /// Returns the number of successive decisions of a row that are learnt together, and of those before them that
    /// count, too.
    pub fn window(&self) -> (usize, usize) {
        let ppo = &self.config.ppo;
        if self.actor.is_recurrent() {
            (ppo.window.unwrap_or(WINDOW), ppo.lookback.unwrap_or(LOOKBACK))
        } else {
            (1, 0)
        }
    }
}
