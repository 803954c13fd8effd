//! What the robots are to do: arenas, tasks, policy frames, rewards and the rules of judging. A scenario is
//! one file and one line in `REGISTRY`; `tests/graph/contracts.rs` then tests it. In a crate of one's own it is one
//! line where its `Registry` is made.
//!
//! Nothing here knows a policy, a network or an actor.

pub mod arena;
pub mod judge;
pub mod layout;
pub mod passage;
pub mod sightings;
pub mod swap;

use std::fmt::Debug;
use std::sync::Arc;

pub use arena::{Arena, KeepOut, Portal};

use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::local::Contacts;
use crate::time::Span;

/// The frame in which a policy sees the world. Each is its own inverse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// The world frame itself.
    World,
    /// The world turned by half a turn about the origin.
    HalfTurn,
}

impl Frame {
    /// Takes a point or velocity from the world frame to this one, or back.
    pub fn turn(self, v: Vec2) -> Vec2 {
        match self {
            Frame::World => v,
            Frame::HalfTurn => -v,
        }
    }

    /// The same for position and velocity.
    pub fn turn_motion(self, motion: &Motion) -> Motion {
        Motion { position: self.turn(motion.position), velocity: self.turn(motion.velocity) }
    }
}

/// What a policy sees of its own robot, in the policy frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Own estimate.
    pub motion: Motion,
    /// Where to go \[m\].
    pub goal: Vec2,
}

/// How far a robot has come in an episode, for the reward: zero at the start, counted up by the scenario.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Stage(pub u8);

/// When an episode succeeds and when it fails.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// A robot has arrived when it first comes within this distance of its goal \[m\].
    pub arrival_m: f32,
    /// Two robots nearer than this have collided \[m\].
    pub separation_m: f32,
    /// All must have arrived by then.
    pub limit: Span,
}

/// A team after a step, by robot.
#[derive(Debug)]
pub struct Scored<'a> {
    /// What each is to do.
    pub tasks: &'a [Task],
    /// Positions \[m\].
    pub position: &'a [Vec2],
    /// Velocities \[m/s\].
    pub velocity: &'a [Vec2],
    /// What each touched.
    pub contacts: &'a [Contacts],
    /// How far each has come; moved on.
    pub stage: &'a mut [Stage],
}

/// A task for a team, and the place where it is done.
pub trait Scenario: Debug + Send + Sync {
    /// Its name on the command line.
    fn name(&self) -> &'static str;

    /// How many robots take part.
    fn robots(&self) -> usize;

    /// Where it happens.
    fn arena(&self) -> &Arena;

    /// Start and goal of every robot in an episode. Starts are the goals of the episode before.
    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task>;

    /// The frame in which a policy sees a robot with this task.
    fn frame(&self, task: &Task) -> Frame;

    /// What a robot's policy sees: the inverse of `steer`.
    fn observe(&self, task: &Task, estimate: &Motion) -> Observation {
        let frame = self.frame(task);
        Observation { motion: frame.turn_motion(estimate), goal: frame.turn(task.goal) }
    }

    /// The policy's velocity \[m/s\] in the world frame.
    fn steer(&self, task: &Task, velocity: Vec2) -> Vec2 {
        self.frame(task).turn(velocity)
    }

    /// Whether a robot at `position` \[m\] has arrived.
    fn reached(&self, task: &Task, position: Vec2) -> bool {
        (task.goal - position).norm() <= self.rules().arrival_m
    }

    /// The reward of one robot for one step that has brought it to `after`; moves its stage on.
    fn reward(&self, task: &Task, after: &Motion, contacts: Contacts, stage: &mut Stage) -> f32;

    /// `reward` for all robots of a team: mass rollouts ask once a team where they would ask once a robot.
    fn rewards(&self, team: Scored, rewards: &mut [f32]) {
        let states = team.position.iter().zip(team.velocity).zip(team.contacts);
        for (((task, ((&position, &velocity), &contacts)), stage), reward) in
            team.tasks.iter().zip(states).zip(team.stage).zip(rewards)
        {
            *reward = self.reward(task, &Motion { position, velocity }, contacts, stage);
        }
    }

    /// `reached` for all robots of a team.
    fn arrivals(&self, tasks: &[Task], position: &[Vec2], reached: &mut [bool]) {
        for ((task, position), reached) in tasks.iter().zip(position).zip(reached) {
            *reached = self.reached(task, *position);
        }
    }

    /// How far a robot at `position` \[m\] still has to go, along the way that it is to take \[m\].
    fn distance_to_go(&self, task: &Task, position: Vec2) -> f32 {
        (task.goal - position).norm()
    }

    /// Whether a robot at `stage` has nothing left to earn.
    fn finished(&self, stage: Stage) -> bool;

    /// How an episode is judged.
    fn rules(&self) -> Rules;
}

/// What a user may choose about a scenario.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// Team size; `None` for the scenario's own.
    pub robots: Option<usize>,
    /// Width of its bottleneck \[m\]; `None` for the scenario's own.
    pub gap_m: Option<f32>,
}

impl Settings {
    /// A team of this size; everything else as the scenario has it.
    pub fn of(robots: usize) -> Settings {
        Settings { robots: Some(robots), ..Settings::default() }
    }
}

/// A scenario by name.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name on the command line.
    pub name: &'static str,
    /// One line for the help.
    pub about: &'static str,
    /// Makes it; its `name` is this entry's.
    pub build: fn(&Settings) -> Result<Arc<dyn Scenario>, ScenarioError>,
}

/// The scenarios of this crate.
pub const REGISTRY: &[Entry] = &[
    Entry {
        name: "passage",
        about: "a team crosses a narrow gap in a wall (the paper's case study)",
        build: passage::build,
    },
    Entry { name: "swap", about: "robots trade places on an open square of constant density", build: swap::build },
];

/// Why a scenario cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// No scenario has that name.
    #[error("there is no scenario '{name}'; there are: {known}")]
    Unknown {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// The scenario is not for that many robots.
    #[error("the scenario '{scenario}' takes {least} to {most} robots, not {robots}")]
    Robots {
        /// The scenario.
        scenario: &'static str,
        /// The fewest.
        least: usize,
        /// The most.
        most: usize,
        /// What was asked for.
        robots: usize,
    },
    /// The scenario has no bottleneck of that width.
    #[error("the scenario '{scenario}' has no gap of {gap_m} m{hint}")]
    Gap {
        /// The scenario.
        scenario: &'static str,
        /// What was asked for \[m\].
        gap_m: f32,
        /// What there could be.
        hint: &'static str,
    },
    /// What else a scenario has against its settings.
    #[error("the scenario '{scenario}': {why}")]
    Refused {
        /// The scenario.
        scenario: &'static str,
        /// Why not.
        why: String,
    },
}

/// Makes the scenario of that name of this crate. Where there may be others, `Registry::scenario` does.
pub fn build(name: &str, settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    build_of(REGISTRY, name, settings)
}

/// Makes the scenario of that name among these.
pub fn build_of(all: &[Entry], name: &str, settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let unknown = || ScenarioError::Unknown {
        name: name.to_owned(),
        known: all.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", "),
    };
    (all.iter().find(|entry| entry.name == name).ok_or_else(unknown)?.build)(settings)
}
