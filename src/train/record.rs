//! The rollout data of a chunk of teams between two updates, with values and advantages.

use super::batch::Graphs;

/// Half of log(2 pi), a term of the normal density's logarithm.
pub const HALF_LOG_TWO_PI: f32 = 0.918_938_5;

/// State of a robot's episode after a decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EpisodeState {
    /// The episode continues.
    Continues,
    /// All robots of the team have arrived: the value of the next state is zero.
    Terminated,
    /// The time limit was reached: the value of the next state is that of this graph after the record's decisions.
    Truncated(u32),
}

/// All decisions of a chunk since the last update: by decision, then by row, then by robot.
#[derive(Debug, Default)]
pub struct Record {
    /// Observations of the policy.
    pub actor: Graphs,
    /// Observations of the critic: those of the decisions, then the last states, then the last states of truncated
    /// episodes.
    pub critic: Graphs,
    /// Actions as drawn \[m/s\], policy frame.
    pub action: Vec<[f32; 2]>,
    /// Log densities of the actions.
    pub log_density: Vec<f32>,
    /// Rewards of the actions.
    pub reward: Vec<f32>,
    /// State of the episode after each action.
    pub state: Vec<EpisodeState>,
    /// Estimates of the critic for each robot of all graphs in `critic`.
    pub value: Vec<f32>,
    /// Advantages of the actions.
    pub advantage: Vec<f32>,
    /// Targets for the critic's estimates.
    pub target: Vec<f32>,
    /// Totals of the episodes that ended.
    pub ended: EpisodeTotals,
}

/// Totals over the episodes that ended during a record.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EpisodeTotals {
    /// Number of episodes.
    pub episodes: u32,
    /// Number of episodes in which all robots arrived and touched nothing.
    pub clean: u32,
    /// Number of episodes in which all robots arrived.
    pub arrived: u32,
    /// Sum of the episodes' lengths \[s\].
    pub length_s: f32,
    /// Sum of the episodes' returns, each the mean over the robots.
    pub returns: f32,
}

impl EpisodeTotals {
    /// Adds the totals of other episodes.
    pub fn add(&mut self, other: &EpisodeTotals) {
        self.episodes += other.episodes;
        self.clean += other.clean;
        self.arrived += other.arrived;
        self.length_s += other.length_s;
        self.returns += other.returns;
    }
}

impl Record {
    /// Removes all data and keeps the allocated memory.
    pub fn clear(&mut self) {
        self.actor.clear();
        self.critic.clear();
        self.action.clear();
        self.log_density.clear();
        self.reward.clear();
        self.state.clear();
        self.ended = EpisodeTotals::default();
    }

    /// Computes generalised advantage estimates (Schulman et al., arXiv 1506.02438, equation 16) of each robot, and the
    /// critic's targets.
    ///
    /// Every decision has `width` robots. `gamma` is the discount per decision, `decay` the factor on the next
    /// advantage, gamma * lambda.
    pub fn compute_advantages(&mut self, width: usize, gamma: f32, decay: f32) {
        let (count, robots) = (self.reward.len(), self.actor.robots);
        self.advantage.resize(count, 0.0);
        self.target.resize(count, 0.0);
        // After the decisions come one graph per row for the last states, then those of truncated episodes.
        let truncated = |graph: u32, robot: usize| count + width + graph as usize * robots + robot % robots;
        for robot in 0..width {
            let mut advantage = 0.0;
            for at in (robot..count).step_by(width).rev() {
                let (next_value, next_advantage) = match self.state[at] {
                    EpisodeState::Continues => (self.value[at + width], advantage),
                    EpisodeState::Terminated => (0.0, 0.0),
                    EpisodeState::Truncated(graph) => (self.value[truncated(graph, robot)], 0.0),
                };
                advantage = self.reward[at] + gamma * next_value - self.value[at] + decay * next_advantage;
                self.advantage[at] = advantage;
                self.target[at] = advantage + self.value[at];
            }
        }
    }
}
