//! What the bodies move in: plants. A plant is one file and one line in `REGISTRY`.
//!
//! Nothing here knows a task, a policy or a network.

mod clamp;
pub mod kinematic;

pub use clamp::Clamp;

use crate::messages::geometry::{Motion, Vec2};
use crate::messages::local::Contacts;
use crate::scenario::Arena;
use crate::time::Span;

/// The true state of one robot.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct PlantState {
    /// Position and velocity, world frame.
    pub motion: Motion,
    /// What blocked it in the last step.
    pub contacts: Contacts,
}

/// How robots come to their starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Placement {
    /// The World puts them there, at rest, when an episode begins; there is no reset.
    Exact,
    /// They drive there during a reset.
    Drive,
}

/// What comes of a contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContactRule {
    /// The move is not made, as in training; robots are as wide as the arena says.
    Block,
    /// It is flagged for the judge and the move is made; robots are as wide as their hull.
    Judge,
}

/// What the robots of a simulated world are like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Physics {
    /// What comes of a contact.
    pub contacts: ContactRule,
    /// How near to a wall is a contact \[m\].
    pub wall_radius_m: f32,
    /// Largest acceleration along each axis \[m/s^2\]; may be infinite.
    pub acceleration_m_s2: f32,
    /// Time constant of the drivetrain, a first-order lag from commanded to true velocity \[s\]; zero for none.
    pub lag_s: f32,
}

impl Physics {
    /// As in the published training environment.
    pub fn published(arena: &Arena) -> Physics {
        Physics {
            contacts: ContactRule::Block,
            wall_radius_m: arena.robot_radius_m,
            acceleration_m_s2: kinematic::MAX_ACCELERATION_M_S2,
            lag_s: 0.0,
        }
    }

    /// The share of a change of velocity that a lagging drivetrain makes in a step: 1 - exp(-period / lag).
    pub fn gain(&self, period: Span) -> f32 {
        if self.lag_s > 0.0 { -(-period.as_secs() / f64::from(self.lag_s)).exp_m1() as f32 } else { 1.0 }
    }
}

/// A physical, or simulated, world that holds some robots, counted from zero without gaps.
pub trait Plant {
    /// How long a step is.
    fn period(&self) -> Span;

    /// Puts a robot at rest at a position \[m\], as a person would.
    fn place(&mut self, robot: usize, position: Vec2);

    /// Sets the velocity \[m/s\] that a robot is driven at from now on.
    fn drive(&mut self, robot: usize, velocity: Vec2);

    /// Moves time on by one step.
    fn advance(&mut self);

    /// The robots' states after the last step or placement.
    fn states(&self) -> &[PlantState];
}

/// A plant by name.
pub struct Entry {
    /// Its name in a deployment.
    pub name: &'static str,
    /// Makes it, for robots at rest at these positions \[m\].
    pub build: fn(&Arena, &Physics, &[Vec2]) -> Box<dyn Plant>,
}

/// All plants.
pub const REGISTRY: &[Entry] = &[Entry { name: "kinematic", build: kinematic::build }];
