//! What a chunk of teams did between two updates, and what it was worth.

use super::batch::Graphs;

/// Half of log(2 pi), of the normal density.
pub const HALF_LOG_TWO_PI: f32 = 0.918_938_5;

/// What a robot's episode did after a decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum After {
    /// It went on.
    On,
    /// All robots of the team had arrived: nothing is left to be earned.
    Done,
    /// The time was up: what was left is estimated, from this graph beyond the record.
    Cut(u32),
}

/// All decisions of a chunk since the last update: by decision, then by row, then by robot.
#[derive(Debug, Default)]
pub struct Record {
    /// What the policy saw.
    pub actor: Graphs,
    /// What the critic saw; beyond the decisions, the states that cut episodes ended in, and the last states.
    pub critic: Graphs,
    /// What was done \[m/s\], policy frame, as drawn.
    pub action: Vec<[f32; 2]>,
    /// Log density of it.
    pub log_density: Vec<f32>,
    /// What was earned for it.
    pub reward: Vec<f32>,
    /// What came after.
    pub after: Vec<After>,
    /// The critic's estimate, by robot of all its graphs.
    pub value: Vec<f32>,
    /// How much better than estimated it was to do this.
    pub advantage: Vec<f32>,
    /// What the critic should have estimated.
    pub target: Vec<f32>,
    /// Of the episodes that ended.
    pub ended: Ended,
}

/// Episodes that ended during a record.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ended {
    /// How many.
    pub episodes: u32,
    /// In how many of them all arrived and touched nothing.
    pub clean: u32,
    /// In how many all arrived.
    pub arrived: u32,
    /// Sum of their lengths \[s\].
    pub length_s: f32,
    /// Sum of what they earned, mean over robots.
    pub earned: f32,
}

impl Ended {
    /// Adds others.
    pub fn add(&mut self, other: &Ended) {
        self.episodes += other.episodes;
        self.clean += other.clean;
        self.arrived += other.arrived;
        self.length_s += other.length_s;
        self.earned += other.earned;
    }
}

impl Record {
    /// Forgets everything and keeps the room.
    pub fn clear(&mut self) {
        self.actor.clear();
        self.critic.clear();
        self.action.clear();
        self.log_density.clear();
        self.reward.clear();
        self.after.clear();
        self.ended = Ended::default();
    }

    /// Generalised advantages (Schulman et al., arXiv 1506.02438, equation 16), each robot by itself.
    ///
    /// Every decision has `width` robots; `gamma` discounts one decision, `decay` a later advantage.
    pub fn weigh(&mut self, width: usize, gamma: f32, decay: f32) {
        let (count, robots) = (self.reward.len(), self.actor.robots);
        self.advantage.resize(count, 0.0);
        self.target.resize(count, 0.0);
        // Behind the decisions lie one graph a row for the last states, then the cut ones.
        let cut = |graph: u32, robot: usize| count + width + graph as usize * robots + robot % robots;
        for robot in 0..width {
            let mut carried = 0.0;
            for at in (robot..count).step_by(width).rev() {
                let (next, carry) = match self.after[at] {
                    After::On => (self.value[at + width], carried),
                    After::Done => (0.0, 0.0),
                    After::Cut(graph) => (self.value[cut(graph, robot)], 0.0),
                };
                carried = self.reward[at] + gamma * next - self.value[at] + decay * carry;
                self.advantage[at] = carried;
                self.target[at] = carried + self.value[at];
            }
        }
    }
}
