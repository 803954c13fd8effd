//! Plants: the simulated or real worlds in which robots move.
//!
//! A plant advances the true states of robots in steps, from the velocities that they are commanded. A new plant is one
//! file and one line in `REGISTRY`. In another crate it is one line where that crate makes its `Registry`. The code of
//! this folder knows no task, policy or network.

#[cfg(feature = "rigid")]
mod drivetrain;
pub mod kinematic;
mod physics;
#[cfg(feature = "rigid")]
mod rigid;
mod sensor;
mod wheels;

pub use physics::{ContactRule, OverrideError, Overrides, Physics};
pub use sensor::Sensor;
pub use wheels::Wheels;

use crate::chassis::{Chassis, DriveKind};
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::local::Contacts;
use crate::random::Seed;
use crate::scenario::Arena;
use crate::time::Span;

/// True state of one robot in a plant (a simulated or real world), without sensor noise.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct PlantState {
    /// Position \[m\] and velocity \[m/s\] of the robot's centre, world frame.
    pub motion: Motion,
    /// Heading \[rad\], counter-clockwise from the x axis of the world frame; zero for a holonomic robot that holds no
    /// particular heading.
    pub heading: f32,
    /// Yaw rate \[rad/s\], counter-clockwise.
    pub yaw_rate: f32,
    /// Contacts of the robot with other robots and with walls in the plant's last step.
    pub contacts: Contacts,
}

/// Method by which simulated robots are brought to their start positions before an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Placement {
    /// The World actor, which runs the plant, puts each robot at its start, at rest, when the episode begins. There is
    /// no reset, in which the robots would drive there.
    Exact,
    /// The robots drive to their starts by scripted navigation, in a reset before the episode.
    Drive,
}

/// A real or simulated world that moves robots in steps of constant duration. Robots have indices from zero without
/// gaps, which every method takes as `robot`.
pub trait Plant {
    /// Duration of one step, by which each call of `advance` moves the world.
    fn period(&self) -> Span;

    /// Gives the robot with index `robot` the drive and the limits of `chassis` and the initial `heading` \[rad\],
    /// counter-clockwise from the x axis. Without this call, a robot is holonomic and has no limits beyond those of the
    /// plant.
    ///
    /// The method is called before the first step, and only for kinds of drive that the plant's [`Entry`] lists. The
    /// default implementation does nothing.
    fn equip(&mut self, _robot: usize, _chassis: Chassis, _heading: f32) {}

    /// Places a robot at rest, as if by hand, at the start of an episode. `robot` is its index and `position` the new
    /// position of its centre \[m\], world frame. A robot that cannot move sideways also takes `heading` \[rad\],
    /// counter-clockwise from the x axis; a holonomic robot ignores it.
    fn place(&mut self, robot: usize, position: Vec2, heading: f32);

    /// Gives a robot that was just placed a `velocity` \[m/s\], world frame, at the start of an episode that begins in
    /// motion, and commands it to keep this velocity. `robot` is its index. A differential drive was placed with its
    /// heading along the velocity.
    ///
    /// The default implementation only commands the velocity: the robot starts at rest and accelerates.
    fn launch(&mut self, robot: usize, velocity: Vec2) {
        self.drive(robot, velocity);
    }

    /// Sets the commanded velocity \[m/s\], world frame, of the robot with index `robot`; it holds until the next call.
    /// The velocity is that of the commanded point: the centre of a holonomic robot, a point ahead of the axle of a
    /// differential drive.
    fn drive(&mut self, robot: usize, velocity: Vec2);

    /// Sets the state of a robot that is moved from outside the plant, such as a real robot beside simulated ones. The
    /// method is called before each step.
    ///
    /// `robot` is the robot's index. `motion` is the position \[m\] and velocity \[m/s\] of its centre, world frame.
    /// `heading` is its heading \[rad\], counter-clockwise from the x axis. The plant's other robots collide with the
    /// robot there, and no contact moves it. The default implementation places the robot there at rest.
    fn carry(&mut self, robot: usize, motion: Motion, heading: f32) {
        self.drive(robot, Vec2::zeros());
        self.place(robot, motion.position, heading);
    }

    /// Takes the arena of the episode that begins, world frame, in place of the one with which the plant was made:
    /// other solid blocks on the same ground. Returns whether the plant can do so. The default returns false, and a
    /// task whose obstacles change between episodes is then refused.
    fn enter(&mut self, _arena: &Arena) -> bool {
        false
    }

    /// Sets the time since the episode runs at the end of the next step, by which moving obstacles of the arena are
    /// where they are. While none runs, it is `None`, and there are no moving obstacles. The World calls it before each
    /// step. Returns whether the plant has moving obstacles. The default returns false, and a task with moving
    /// obstacles is then refused.
    fn elapse(&mut self, _elapsed: Option<Span>) -> bool {
        false
    }

    /// Advances the world by one step of duration `period`, with the velocities last set by `drive`.
    fn advance(&mut self);

    /// Returns the true states of all robots after the last step or placement, in the order of their indices.
    fn states(&self) -> &[PlantState];
}

/// Registry entry of a plant (a world in which robots move): its name, its properties and its constructor.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name by which a user selects the plant, on the command line (`--plant`) and in a deployment.
    pub name: &'static str,
    /// Description of the plant (a world in which robots move) in one line, for the program's help text.
    pub about: &'static str,
    /// Function that returns the default physical parameters of the plant's robots in an arena.
    pub physics: fn(&Arena) -> Physics,
    /// Fields of `Overrides`, the user's settings of robot parameters, that this plant does not let a user set. Each is
    /// a pair of the field's name and the reason; an empty list leaves all fields free.
    pub fixed: &'static [(&'static str, &'static str)],
    /// Kinds of drive that the plant simulates. For kinds other than `DriveKind::Holonomic` the plant implements
    /// `Plant::equip`.
    pub drives: &'static [DriveKind],
    /// Constructor of the plant. Its arguments are the arena, the physical parameters, the initial position of each
    /// robot \[m\] and the random seed. The robots start at rest, and the plant draws random numbers from streams of
    /// that seed only.
    pub build: fn(&Arena, &Physics, &[Vec2], Seed) -> Box<dyn Plant>,
}

/// Name of the default plant: the kinematic world of the paper, in which policies are also trained.
pub const KINEMATIC: &str = "kinematic";

/// All plants (worlds in which robots move) of this crate, from which a user selects one by name. The plant `rigid` is
/// present only with the feature `rigid`.
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
