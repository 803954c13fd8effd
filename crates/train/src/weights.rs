//! Weights of the terms of the reward, as a configuration has them: their ranges, and which of them a task, an episode
//! or the size of the robots changes.

use serde::{Deserialize, Serialize};

use murmurate::config::{ConfigError, in_range};
use murmurate::scenario::size::HULL_M;
use murmurate::scenario::{Arena, Weights};

/// Weights of the terms of a robot's reward in a step. A weight of zero leaves a term out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reward {
    /// Factor on the sum of all terms of the reward.
    pub scale: f32,
    /// Weight of the scenario's own reward; 0 if the scenario has none.
    pub scenario: f32,
    /// Reward per metre by which the remaining path becomes shorter \[1/m\].
    pub progress: f32,
    /// Reward for the arrival at the goal, given once per episode.
    pub arrival: f32,
    /// Penalty per second until the robot has arrived at its goal \[1/s\].
    pub time: f32,
    /// Penalty per second for every robot of a team until the whole team has arrived \[1/s\], so that robots at their
    /// goals make room for the last one.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub team_time: f32,
    /// Penalty for each step in which the robot touches a wall.
    pub wall: f32,
    /// Penalty for each step in which the robot touches another robot.
    pub robot: f32,
    /// Penalty per second for another robot at distance zero \[1/s\]; decreases linearly to zero at distance
    /// `proximity_m`.
    pub proximity: f32,
    /// Distance between two robots' centres at which the proximity penalty becomes zero \[m\].
    pub proximity_m: f32,
    /// Penalty per second for a wall at distance zero \[1/s\]; decreases linearly to zero at distance
    /// `wall_proximity_m`.
    pub wall_proximity: f32,
    /// Distance between a robot's centre and a wall at which the wall's proximity penalty becomes zero \[m\].
    pub wall_proximity_m: f32,
    /// Penalty per second for the square of a robot's speed \[s/m²\].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub energy: f32,
    /// Penalty per second for a robot's distance from the middle of its team \[1/(m s)\].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub cohesion: f32,
    /// Penalty per second for the squared difference of a robot's velocity from the mean of its team \[s/m²\].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub matching: f32,
    /// Penalty per second, of every robot of a team, for the mean squared distance of the ground from the nearest robot
    /// \[1/(m² s)\]: the cost of coverage with a uniform density.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub coverage: f32,
    /// Whether a robot near its goal pays for nearness to a wall only where it is nearer than the goal itself.
    /// Otherwise a robot does not drive to a goal that is within `wall_proximity_m` of a wall.
    #[serde(default, skip_serializing_if = "is_false")]
    pub goals_near_walls: bool,
    /// Weight of the team's mean reward in a robot's reward, 0 to 1; the rest is the weight of the robot's own.
    pub shared: f32,
    /// Factor on the penalties for contacts and proximity in episodes with the safety filter, which keeps robots apart
    /// by itself.
    #[serde(default = "unchanged")]
    pub filtered: f32,
}

fn unchanged() -> f32 {
    1.0
}

fn is_false(switch: &bool) -> bool {
    !switch
}

fn is_zero(weight: &f32) -> bool {
    *weight == 0.0
}

impl Reward {
    /// Returns the weights with all penalties for contacts and proximity multiplied by `factor`.
    pub fn with_penalties(self, factor: f32) -> Reward {
        Reward {
            wall: factor * self.wall,
            robot: factor * self.robot,
            proximity: factor * self.proximity,
            wall_proximity: factor * self.wall_proximity,
            ..self
        }
    }

    /// Returns the weights with the distances at which robots pay for nearness those of robots with the hull in
    /// `arena`.
    pub fn about(self, arena: &Arena) -> Reward {
        let share = arena.hull_m() / HULL_M;
        let (proximity_m, wall_proximity_m) = (share * self.proximity_m, share * self.wall_proximity_m);
        Reward { proximity_m, wall_proximity_m, ..self }
    }

    /// Returns the weights for an episode; `filtered` says whether it has the safety filter.
    pub fn in_episode(self, filtered: bool) -> Reward {
        if filtered { self.with_penalties(self.filtered) } else { self }
    }

    /// Returns the reward with the weights that a scenario gives to its terms.
    pub fn weighted(self, weights: Weights) -> Reward {
        Reward {
            progress: weights.progress.unwrap_or(self.progress),
            arrival: weights.arrival.unwrap_or(self.arrival),
            time: weights.time.unwrap_or(self.time),
            wall: weights.contact.unwrap_or(self.wall),
            robot: weights.contact.unwrap_or(self.robot),
            proximity: weights.nearness.unwrap_or(self.proximity),
            wall_proximity: weights.nearness.unwrap_or(self.wall_proximity),
            energy: weights.energy.unwrap_or(self.energy),
            cohesion: weights.cohesion.unwrap_or(self.cohesion),
            matching: weights.matching.unwrap_or(self.matching),
            coverage: weights.coverage.unwrap_or(self.coverage),
            ..self
        }
    }

    /// Checks the values of all fields. The error names the first wrong one.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        let weights = [
            ("reward.scale", self.scale),
            ("reward.scenario", self.scenario),
            ("reward.progress", self.progress),
            ("reward.arrival", self.arrival),
            ("reward.time", self.time),
            ("reward.team_time", self.team_time),
            ("reward.wall", self.wall),
            ("reward.robot", self.robot),
            ("reward.proximity", self.proximity),
            ("reward.wall_proximity", self.wall_proximity),
            ("reward.energy", self.energy),
            ("reward.cohesion", self.cohesion),
            ("reward.matching", self.matching),
            ("reward.coverage", self.coverage),
            ("reward.filtered", self.filtered),
        ];
        for (field, value) in weights {
            in_range(field, value, (0.0, 1e4))?;
        }
        in_range("reward.proximity_m", self.proximity_m, (1e-3, 100.0))?;
        in_range("reward.wall_proximity_m", self.wall_proximity_m, (1e-3, 100.0))?;
        in_range("reward.shared", self.shared, (0.0, 1.0))
    }
}
