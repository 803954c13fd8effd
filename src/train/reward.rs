//! What a robot earns in a step: the scenario's own reward and what the configuration adds to it.

use super::config::Reward;
use crate::messages::geometry::{Task, Vec2};
use crate::messages::local::Contacts;
use crate::scenario::Scenario;
use crate::world::kinematic::PERIOD;

/// One robot's part of a step, as its reward sees it.
#[derive(Debug)]
pub struct Part<'a> {
    /// What it was to do.
    pub task: &'a Task,
    /// Where it is now \[m\].
    pub position: Vec2,
    /// What it touched.
    pub contacts: Contacts,
    /// The scenario's own reward of the step.
    pub reward: f32,
    /// Whether it is where it is to go.
    pub reached: bool,
    /// How far it had to go \[m\]; brought up to date.
    pub to_go_m: &'a mut f32,
    /// Whether it has arrived; brought up to date.
    pub arrived: &'a mut bool,
}

/// What one robot earns by itself in a step.
pub fn earn(weights: &Reward, scenario: &dyn Scenario, part: Part) -> f32 {
    let position = part.position;
    let mut earned = 0.0;
    if weights.scenario > 0.0 {
        earned += weights.scenario * part.reward;
    }
    if weights.progress > 0.0 {
        let to_go_m = scenario.distance_to_go(part.task, position);
        earned += weights.progress * (*part.to_go_m - to_go_m);
        *part.to_go_m = to_go_m;
    }
    if !*part.arrived {
        if part.reached {
            *part.arrived = true;
            earned += weights.arrival;
        } else {
            earned -= weights.time * PERIOD.as_secs() as f32;
        }
    }
    if part.contacts.wall {
        earned -= weights.wall;
    }
    if part.contacts.robot {
        earned -= weights.robot;
    }
    if weights.wall_proximity > 0.0 {
        let near = 1.0 - scenario.arena().clearance(position) / weights.wall_proximity_m;
        earned -= weights.wall_proximity * near.max(0.0) * PERIOD.as_secs() as f32;
    }
    earned * weights.scale
}

/// What a robot pays for coming near to others of its team, which are at `positions`.
pub fn crowding(weights: &Reward, robot: usize, positions: &[Vec2]) -> f32 {
    let mut near = 0.0;
    for (other, position) in positions.iter().enumerate() {
        let apart = (position - positions[robot]).norm_squared();
        if other != robot && apart < weights.proximity_m * weights.proximity_m {
            near += 1.0 - apart.sqrt() / weights.proximity_m;
        }
    }
    weights.scale * weights.proximity * near * PERIOD.as_secs() as f32
}
