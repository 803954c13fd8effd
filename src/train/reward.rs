//! The reward of a robot for a step: the scenario's own reward and the terms that the configuration adds.

use super::config::Reward;
use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::local::Contacts;
use crate::scenario::{Scenario, Stage};
use crate::world::kinematic::PERIOD;

/// One robot's step, as input to the reward.
#[derive(Debug)]
pub struct RobotStep<'a> {
    /// The robot's task.
    pub task: &'a Task,
    /// Position of the centre after the step \[m\], world frame.
    pub position: Vec2,
    /// Position of the point that the policy commands after the step \[m\], world frame.
    pub point: Vec2,
    /// Contacts in the step.
    pub contacts: Contacts,
    /// The scenario's own reward of the step.
    pub scenario_reward: f32,
    /// Whether the robot is at its goal.
    pub reached: bool,
    /// Length of the remaining path \[m\]: before the step, and afterwards replaced by that after the step.
    pub to_go_m: &'a mut f32,
    /// Whether the robot had arrived before the step; set if it arrives in the step.
    pub arrived: &'a mut bool,
}

/// Whether `Scenario::reward` returns a reward for this scenario.
pub fn has_reward(scenario: &dyn Scenario) -> bool {
    let tasks = scenario.tasks(0, 0);
    let reward =
        |task: &Task| scenario.reward(task, &Motion::at_rest(task.start), Contacts::default(), &mut Stage::default());
    tasks.first().and_then(reward).is_some()
}

/// The reward of one robot for a step, without the terms that depend on other robots.
pub fn robot_reward(weights: &Reward, scenario: &dyn Scenario, step: RobotStep) -> f32 {
    let position = step.position;
    let mut reward = 0.0;
    if weights.scenario > 0.0 {
        reward += weights.scenario * step.scenario_reward;
    }
    if weights.progress > 0.0 {
        let to_go_m = scenario.distance_to_go(step.task, step.point);
        reward += weights.progress * (*step.to_go_m - to_go_m);
        *step.to_go_m = to_go_m;
    }
    if !*step.arrived {
        if step.reached {
            *step.arrived = true;
            reward += weights.arrival;
        } else {
            reward -= weights.time * PERIOD.as_secs() as f32;
        }
    }
    if step.contacts.wall {
        reward -= weights.wall;
    }
    if step.contacts.robot {
        reward -= weights.robot;
    }
    if weights.wall_proximity > 0.0 {
        let near = 1.0 - scenario.arena().clearance(position) / weights.wall_proximity_m;
        reward -= weights.wall_proximity * near.max(0.0) * PERIOD.as_secs() as f32;
    }
    reward * weights.scale
}

/// The penalty of the robot with index `robot` for being near to other robots of its team. `positions` are those of the
/// team \[m\].
pub fn proximity_penalty(weights: &Reward, robot: usize, positions: &[Vec2]) -> f32 {
    let mut near = 0.0;
    for (other, position) in positions.iter().enumerate() {
        let distance_squared = (position - positions[robot]).norm_squared();
        if other != robot && distance_squared < weights.proximity_m * weights.proximity_m {
            near += 1.0 - distance_squared.sqrt() / weights.proximity_m;
        }
    }
    weights.scale * weights.proximity * near * PERIOD.as_secs() as f32
}
