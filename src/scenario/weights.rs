//! Weights that a task gives to the terms of the reward in training.

use serde::Deserialize;

/// Weights of terms of the reward in training, in place of those of a preset; `None` leaves a term as the preset has
/// it. `docs/training.md` says what each term is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// Reward per metre by which the remaining path becomes shorter \[1/m\].
    pub progress: Option<f32>,
    /// Reward for the arrival at the goal, given once per episode.
    pub arrival: Option<f32>,
    /// Penalty for each step in which the robot touches a wall or another robot.
    pub contact: Option<f32>,
    /// Penalty per second until the robot has arrived at its goal \[1/s\].
    pub time: Option<f32>,
    /// Penalty per second for another robot, or a wall, at distance zero \[1/s\].
    pub nearness: Option<f32>,
    /// Penalty per second for the square of the robot's speed \[s/m²\].
    pub energy: Option<f32>,
    /// Penalty per second for the distance from the middle of the team \[1/(m s)\].
    pub cohesion: Option<f32>,
    /// Penalty per second for the squared difference of the velocity from the mean of the team \[s/m²\].
    pub matching: Option<f32>,
    /// Penalty per second for the mean squared distance of the ground from the nearest robot \[1/(m² s)\].
    pub coverage: Option<f32>,
}

impl Weights {
    /// Returns the weights that are given, each with the name of its term.
    pub fn given(&self) -> impl Iterator<Item = (&'static str, f32)> + use<> {
        let all = [
            ("progress", self.progress),
            ("arrival", self.arrival),
            ("contact", self.contact),
            ("time", self.time),
            ("nearness", self.nearness),
            ("energy", self.energy),
            ("cohesion", self.cohesion),
            ("matching", self.matching),
            ("coverage", self.coverage),
        ];
        all.into_iter().filter_map(|(term, weight)| Some((term, weight?)))
    }
}
