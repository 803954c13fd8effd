//! Rollout data of a chunk of teams between two updates, with values and advantages.

use super::graphs::{Graphs, Window};

/// Half of the natural logarithm of 2 pi, a term of the normal density's logarithm.
pub const HALF_LOG_TWO_PI: f32 = 0.918_938_5;

/// State of a robot's episode after an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EpisodeState {
    /// The episode continues.
    Continues,
    /// All robots of the team have arrived. The value of the next state is zero.
    Terminated,
    /// The time limit was reached. The critic estimates the value of the next state from the graph with this index
    /// among those of truncated episodes.
    Truncated(u32),
}

/// All decisions of a chunk (rows of robots that one thread steps together) since the last update. Lists with one entry
/// per action are ordered by decision, then by row, then by robot.
#[derive(Debug, Default)]
pub struct Experience {
    /// Number of rows (environments).
    pub rows: usize,
    /// Number of the policy's graphs per row and decision: one for each step of a recurrent policy, otherwise one.
    pub steps: usize,
    /// Observations of the policy, by decision, then by step of the decision, then by row.
    pub actor: Graphs,
    /// Observations of the critic: those of the decisions, then each row's state after the last decision, then the last
    /// states of truncated episodes.
    pub critic: Graphs,
    /// Actions as drawn from the policy's distribution \[m/s\], policy frame.
    pub action: Vec<[f32; 2]>,
    /// Velocities that an expert would have commanded in place of the actions \[m/s\], policy frame; empty without one.
    pub taught: Vec<[f32; 2]>,
    /// Natural logarithms of the actions' probability densities under the policy that drew them.
    pub log_density: Vec<f32>,
    /// Rewards from each action until the next decision.
    pub reward: Vec<f32>,
    /// State of the robot's episode after each action.
    pub state: Vec<EpisodeState>,
    /// Values that the critic estimates, one for each robot of each graph in `critic`.
    pub value: Vec<f32>,
    /// Advantages of the actions, one per action.
    pub advantage: Vec<f32>,
    /// Targets for the critic's estimates at the decisions, one per action.
    pub target: Vec<f32>,
    /// Totals of the episodes that ended during the record.
    pub ended: EpisodeTotals,
}

/// Totals over the episodes that ended during a record.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EpisodeTotals {
    /// Number of episodes that ended.
    pub episodes: u32,
    /// Number of episodes that ended with the arrival of all robots, without a contact that makes an episode fail.
    pub clean: u32,
    /// Number of episodes that ended with the arrival of all robots.
    pub arrived: u32,
    /// Sum of the durations of the episodes that ended \[s\].
    pub length_s: f32,
    /// Sum of the returns of the episodes that ended. An episode's return is the mean over its robots.
    pub returns: f32,
}

impl EpisodeTotals {
    /// Adds the totals `other` of other episodes to these.
    pub fn add(&mut self, other: &EpisodeTotals) {
        self.episodes += other.episodes;
        self.clean += other.clean;
        self.arrived += other.arrived;
        self.length_s += other.length_s;
        self.returns += other.returns;
    }
}

impl Experience {
    /// Removes all decisions and totals, and keeps the allocated memory.
    pub fn clear(&mut self) {
        self.actor.clear();
        self.critic.clear();
        self.action.clear();
        self.taught.clear();
        self.log_density.clear();
        self.reward.clear();
        self.state.clear();
        self.ended = EpisodeTotals::default();
    }

    /// Returns the number of windows of `length` successive decisions of a row. The last ones may be shorter.
    pub fn windows(&self, length: usize) -> usize {
        self.rows * self.decisions().div_ceil(length)
    }

    /// Returns the number of decisions of a row.
    fn decisions(&self) -> usize {
        self.actor.len() / (self.rows * self.steps)
    }

    /// Returns the decisions of a window of `length` decisions, each by its place among those of all rows: that of its
    /// graph in `critic`.
    pub fn decisions_of(&self, window: usize, length: usize) -> impl Iterator<Item = usize> + Clone + use<> {
        let (row, rows, begin) = (window % self.rows, self.rows, window / self.rows * length);
        (begin..(begin + length).min(self.decisions())).map(move |decision| decision * rows + row)
    }

    /// Returns the policy's graphs of a window of `length` decisions, and of up to `lookback` decisions before it.
    pub fn window(&self, window: usize, (length, lookback): (usize, usize)) -> Window<'_> {
        let (row, begin) = (window % self.rows, window / self.rows * length);
        let (first, last) = (begin.saturating_sub(lookback), (begin + length).min(self.decisions()) - 1);
        Window {
            graphs: &self.actor,
            first: first * self.steps * self.rows + row,
            steps: (last - first) * self.steps + 1,
            lookback: (begin - first) * self.steps,
            every: self.steps,
        }
    }

    /// Computes each robot's generalised advantage estimates (Schulman et al., arXiv 1506.02438, equation 16), and the
    /// critic's targets.
    ///
    /// `width` is the number of robots in all rows of the chunk together. `gamma` is the discount factor per decision,
    /// and `decay` the factor on the next advantage, gamma * lambda.
    pub fn compute_advantages(&mut self, width: usize, gamma: f32, decay: f32) {
        let (count, robots) = (self.reward.len(), self.actor.robots);
        self.advantage.resize(count, 0.0);
        self.target.resize(count, 0.0);
        // After the decisions' graphs come one graph per row for the last state, then those of truncated episodes.
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
