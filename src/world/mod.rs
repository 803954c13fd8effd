//! What the bodies move in: plants. A plant is one file and one line in `REGISTRY`; in a crate of one's own, one line
//! where its `Registry` is made.
//!
//! Nothing here knows a task, a policy or a network.

mod clamp;
#[cfg(feature = "rigid")]
mod drivetrain;
pub mod kinematic;
mod physics;
#[cfg(feature = "rigid")]
pub mod rigid;
mod sensor;

pub use clamp::Clamp;
pub use physics::{ContactRule, Given, GivenError, Physics};
pub use sensor::Sensor;

use crate::messages::geometry::{Motion, Vec2};
use crate::messages::local::Contacts;
use crate::random::Seed;
use crate::scenario::Arena;
use crate::time::Span;

/// The true state of one robot.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct PlantState {
    /// Position and velocity, world frame.
    pub motion: Motion,
    /// Heading \[rad\], counter-clockwise from the x axis; zero for robots that hold theirs.
    pub heading: f32,
    /// Yaw rate \[rad/s\], counter-clockwise.
    pub yaw_rate: f32,
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
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name on the command line and in a deployment.
    pub name: &'static str,
    /// One line for the help.
    pub about: &'static str,
    /// What its robots are like unless someone says otherwise.
    pub physics: fn(&Arena) -> Physics,
    /// What nobody may say otherwise, by its field, and why.
    pub fixed: &'static [(&'static str, &'static str)],
    /// Makes it, for robots at rest at these positions \[m\]; it draws from streams of this seed alone.
    pub build: fn(&Arena, &Physics, &[Vec2], Seed) -> Box<dyn Plant>,
}

/// The name of the plant of a deployment that names none: the training world.
pub const KINEMATIC: &str = "kinematic";

/// The plants of this crate.
pub const REGISTRY: &[Entry] = &[
    Entry {
        name: KINEMATIC,
        about: "the training world",
        physics: Physics::published,
        fixed: &[],
        build: kinematic::build,
    },
    #[cfg(feature = "rigid")]
    Entry {
        name: "rigid",
        about: "rigid bodies with mass, friction and slipping wheels, seen by motion capture",
        physics: Physics::robomaster,
        fixed: rigid::FIXED,
        build: rigid::build,
    },
];
