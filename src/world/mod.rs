//! What the bodies move in: plants. A plant is one file and one line in `REGISTRY`.
//!
//! Nothing here knows a task, a policy or a network.

pub mod kinematic;

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
    pub build: fn(&Arena, &[Vec2]) -> Box<dyn Plant>,
}

/// All plants.
pub const REGISTRY: &[Entry] = &[Entry { name: "kinematic", build: kinematic::build }];
