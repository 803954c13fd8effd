//! Plants: the worlds, simulated or real, in which robots move.
//!
//! A plant is one file and one line in `REGISTRY`; in another crate, one line where its `Registry` is made. Nothing
//! here knows a task, a policy or a network.

mod clamp;
#[cfg(feature = "rigid")]
mod drivetrain;
pub mod kinematic;
mod physics;
#[cfg(feature = "rigid")]
pub mod rigid;
mod sensor;
mod wheels;

pub use clamp::Clamp;
pub use physics::{ContactRule, OverrideError, Overrides, Physics};
pub use sensor::Sensor;
pub use wheels::Wheels;

use crate::chassis::{Chassis, DriveKind};
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::local::Contacts;
use crate::random::Seed;
use crate::scenario::Arena;
use crate::time::Span;

/// The true state of one robot.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct PlantState {
    /// Position and velocity of the centre, world frame.
    pub motion: Motion,
    /// Heading \[rad\], counter-clockwise from the x axis; zero for robots that hold theirs.
    pub heading: f32,
    /// Yaw rate \[rad/s\], counter-clockwise.
    pub yaw_rate: f32,
    /// Contacts of the last step.
    pub contacts: Contacts,
}

/// Method by which robots are brought to their starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Placement {
    /// The World places them there, at rest, at the start of an episode; there is no reset.
    Exact,
    /// The robots drive there during a reset.
    Drive,
}

/// A real or simulated world with robots, numbered from zero without gaps.
pub trait Plant {
    /// Duration of a step.
    fn period(&self) -> Span;

    /// Gives a robot another chassis than a holonomic one without limits, and a heading \[rad\]. It is called before
    /// the first step, and only for drives that the plant's entry names.
    fn equip(&mut self, _robot: usize, _chassis: Chassis, _heading: f32) {}

    /// Places a robot's centre at rest at a position \[m\], world frame, as if by hand. A robot that cannot move
    /// sideways gets this heading \[rad\].
    fn place(&mut self, robot: usize, position: Vec2, heading: f32);

    /// Sets the velocity \[m/s\], world frame, of the point that a robot's chassis commands. It holds until the next
    /// call.
    fn drive(&mut self, robot: usize, velocity: Vec2);

    /// Sets the state of a robot that is moved from outside, such as a real one, before each step: position and
    /// velocity of its centre \[m, m/s\] and its heading \[rad\], world frame. The others touch it there, and no
    /// contact moves it.
    /// A plant that does not override this places the robot there at rest.
    fn carry(&mut self, robot: usize, motion: Motion, heading: f32) {
        self.drive(robot, Vec2::zeros());
        self.place(robot, motion.position, heading);
    }

    /// Advances the world by one step.
    fn advance(&mut self);

    /// The robots' true states after the last step or placement.
    fn states(&self) -> &[PlantState];
}

/// A registry entry of a plant.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name on the command line and in a deployment.
    pub name: &'static str,
    /// One line for the help.
    pub about: &'static str,
    /// Returns the default parameters of its robots.
    pub physics: fn(&Arena) -> Physics,
    /// Fields of `Overrides` that a user may not set, each with the reason.
    pub fixed: &'static [(&'static str, &'static str)],
    /// Drives that it simulates; for others than a holonomic one it implements `Plant::equip`.
    pub drives: &'static [DriveKind],
    /// Makes the plant with robots at rest at these positions \[m\]; it draws from streams of this seed alone.
    pub build: fn(&Arena, &Physics, &[Vec2], Seed) -> Box<dyn Plant>,
}

/// Name of the default plant, the training world.
pub const KINEMATIC: &str = "kinematic";

/// The plants of this crate.
pub const REGISTRY: &[Entry] = &[
    Entry {
        name: KINEMATIC,
        about: "the training world",
        physics: Physics::published,
        fixed: &[],
        drives: &[DriveKind::Holonomic, DriveKind::Differential],
        build: kinematic::build,
    },
    #[cfg(feature = "rigid")]
    Entry {
        name: "rigid",
        about: "rigid bodies with mass, friction and slipping wheels, measured by motion capture",
        physics: Physics::robomaster,
        fixed: rigid::FIXED,
        drives: &[DriveKind::Holonomic, DriveKind::Differential],
        build: rigid::build,
    },
];
