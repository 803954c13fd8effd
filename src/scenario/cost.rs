//! Cost of a team over time, by which an episode of a scenario without goals is judged.

use super::Scenario;
use crate::messages::geometry::{Motion, Planar, Vec2};

/// Cost of a scenario without goals: what a team keeps low for the whole time of an episode.
#[derive(Clone, Copy, Debug)]
pub struct Cost {
    /// Name of the cost in reports, such as `velocity variance`.
    pub name: &'static str,
    /// Unit of the cost, such as `m2/s2`.
    pub unit: &'static str,
    /// Function that returns the cost of a team at one instant, from the true states of its robots and the goals of
    /// their tasks \[m\], both in the world frame. The states are never empty. The cost of an episode is the mean of
    /// this function over the steps of the episode.
    pub of: fn(&[Motion], &[Vec2]) -> f64,
}

/// Mean of a cost over the steps of one episode so far.
#[derive(Clone, Copy, Debug)]
pub struct MeanCost {
    cost: Cost,
    sum: f64,
    steps: u32,
}

impl MeanCost {
    /// Makes the mean of `cost` over no steps yet.
    pub fn new(cost: Cost) -> MeanCost {
        MeanCost { cost, sum: 0.0, steps: 0 }
    }

    /// Adds a step with these states of the team, world frame, whose tasks have these `goals` \[m\]. A step without
    /// robots does not count.
    pub fn add(&mut self, team: &[Motion], goals: &[Vec2]) {
        if !team.is_empty() {
            self.sum += (self.cost.of)(team, goals);
            self.steps += 1;
        }
    }

    /// Returns the mean cost of a step; `None` before the first one.
    pub fn mean(&self) -> Option<f64> {
        (self.steps > 0).then(|| self.sum / f64::from(self.steps))
    }
}

/// Returns the mean squared distance of the robots' velocities from their mean \[m²/s²\]: the cost of a flock (Tolstaya
/// et al., CoRL 2019, arXiv 1903.10527, section 5).
pub fn velocity_variance(team: &[Motion]) -> f64 {
    let velocities = || team.iter().map(|motion| motion.velocity.to_array().map(f64::from));
    let robots = team.len() as f64;
    let [x, y] = velocities().fold([0.0, 0.0], |[x, y], v| [x + v[0], y + v[1]]).map(|sum| sum / robots);
    velocities().map(|v| (v[0] - x).powi(2) + (v[1] - y).powi(2)).sum::<f64>() / robots
}

/// Way in which an episode ends if it is not aborted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The episode ends once every robot has arrived at its goal.
    Arrival,
    /// The episode ends by time, in a scenario without goals: half a second (the state server's `GRACE`) after its
    /// longest duration, so that it is judged by then.
    Time,
}

impl Ending {
    /// Returns how the episodes of a scenario end.
    pub fn of(scenario: &dyn Scenario) -> Ending {
        if scenario.cost().is_some() { Ending::Time } else { Ending::Arrival }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flock_costs_the_variance_of_its_velocities_over_robots_and_time() {
        let at = |x: f32, y: f32| Motion { position: Vec2::new(9.0, x), velocity: Vec2::new(x, y) };
        assert_eq!(velocity_variance(&[at(0.5, 1.0), at(0.5, 1.0)]), 0.0);
        // Distances of 1 and 1 from the mean (1, 0), then of 2 and 2 from (0, 0).
        let mut mean = MeanCost::new(Cost { name: "variance", unit: "m2/s2", of: |team, _| velocity_variance(team) });
        assert_eq!(mean.mean(), None);
        mean.add(&[at(0.0, 0.0), at(2.0, 0.0)], &[]);
        mean.add(&[], &[]);
        mean.add(&[at(0.0, -2.0), at(0.0, 2.0)], &[]);
        assert_eq!(mean.mean(), Some(2.5));
    }
}
