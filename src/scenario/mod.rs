//! Scenarios: arenas, tasks, policy frames, rewards and the rules of judging.
//!
//! A scenario is one file and one line in `REGISTRY`; `tests/graph/contracts.rs` then tests it. In another crate it is
//! one line where its `Registry` is made, and [`contract::check`] tests it. Nothing here knows a policy, a network or an actor.

pub mod arena;
pub mod contract;
pub mod judge;
pub mod layout;
pub mod passage;
pub mod sightings;
pub mod swap;

use std::fmt::{self, Debug};
use std::sync::Arc;

pub use arena::{Arena, KeepOut, Portal};

use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::local::Contacts;
use crate::time::Span;

/// Transformation between the world frame and the policy frame. Each is its own inverse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// Identity: the policy frame is the world frame.
    World,
    /// Rotation by half a turn about the origin.
    HalfTurn,
}

impl Frame {
    /// Transforms a point or velocity from the world frame to the policy frame, or back.
    pub fn turn(self, v: Vec2) -> Vec2 {
        match self {
            Frame::World => v,
            Frame::HalfTurn => -v,
        }
    }

    /// Transforms position and velocity of a motion likewise.
    pub fn turn_motion(self, motion: &Motion) -> Motion {
        Motion { position: self.turn(motion.position), velocity: self.turn(motion.velocity) }
    }
}

/// A policy's input about its own robot, in the policy frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Estimated position and velocity of the robot.
    pub motion: Motion,
    /// Goal position \[m\].
    pub goal: Vec2,
}

/// Progress of a robot in an episode, for the reward: zero at the start, incremented by the scenario.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Stage(pub u8);

/// Criteria for success and failure of an episode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Distance from its goal within which a robot has arrived \[m\]; an arrival latches.
    pub arrival_m: f32,
    /// Distance between two robots below which they have collided \[m\].
    pub separation_m: f32,
    /// Time limit for all arrivals, from the start of the episode.
    pub limit: Span,
}

/// State of a team after a step, one entry per robot in each slice, for the reward.
#[derive(Debug)]
pub struct TeamAfterStep<'a> {
    /// Tasks.
    pub tasks: &'a [Task],
    /// Positions \[m\], world frame.
    pub position: &'a [Vec2],
    /// Velocities \[m/s\], world frame.
    pub velocity: &'a [Vec2],
    /// Contacts in the step.
    pub contacts: &'a [Contacts],
    /// Stages, which the reward updates.
    pub stage: &'a mut [Stage],
}

/// A task for a team, with its arena, reward and rules.
pub trait Scenario: Debug + Send + Sync {
    /// Name on the command line.
    fn name(&self) -> &'static str;

    /// Number of robots.
    fn robots(&self) -> usize;

    /// The arena.
    fn arena(&self) -> &Arena;

    /// Start and goal of every robot in an episode. Starts are the goals of the episode before.
    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task>;

    /// The policy frame of a robot with this task.
    fn frame(&self, task: &Task) -> Frame;

    /// The policy's observation for an estimate in the world frame; the inverse of `steer`.
    fn observe(&self, task: &Task, estimate: &Motion) -> Observation {
        let frame = self.frame(task);
        Observation { motion: frame.turn_motion(estimate), goal: frame.turn(task.goal) }
    }

    /// Transforms the policy's velocity \[m/s\] to the world frame.
    fn steer(&self, task: &Task, velocity: Vec2) -> Vec2 {
        self.frame(task).turn(velocity)
    }

    /// Whether a robot at `position` \[m\] has arrived.
    fn reached(&self, task: &Task, position: Vec2) -> bool {
        (task.goal - position).norm() <= self.rules().arrival_m
    }

    /// The scenario's own reward of one robot for one step that ends in `after`; updates its stage. `None`, the
    /// default, if it has none: a training then rewards progress and arrival, which need no code here.
    fn reward(&self, _task: &Task, _after: &Motion, _contacts: Contacts, _stage: &mut Stage) -> Option<f32> {
        None
    }

    /// `reward` for all robots of a team: one dynamic call per team instead of one per robot, for fast rollouts.
    fn rewards(&self, team: TeamAfterStep, rewards: &mut [f32]) {
        let states = team.position.iter().zip(team.velocity).zip(team.contacts);
        for (((task, ((&position, &velocity), &contacts)), stage), reward) in
            team.tasks.iter().zip(states).zip(team.stage).zip(rewards)
        {
            *reward = self.reward(task, &Motion { position, velocity }, contacts, stage).unwrap_or(0.0);
        }
    }

    /// `reached` for all robots of a team, in one call.
    fn arrivals(&self, tasks: &[Task], position: &[Vec2], reached: &mut [bool]) {
        for ((task, position), reached) in tasks.iter().zip(position).zip(reached) {
            *reached = self.reached(task, *position);
        }
    }

    /// Length of the remaining path of a robot at `position` \[m\] to its goal \[m\].
    fn distance_to_go(&self, task: &Task, position: Vec2) -> f32 {
        (task.goal - position).norm()
    }

    /// Whether `stage` is the last one, after which the scenario's own reward pays for no more progress. Only tests
    /// call it.
    fn finished(&self, _stage: Stage) -> bool {
        true
    }

    /// Success rate that scripted navigation (`orca`) reaches at least with the default team in mode `sim`, 0 to 1.
    /// `tests/graph/contracts.rs` holds the scenario to it.
    fn scripted_success(&self) -> f64 {
        0.9
    }

    /// Criteria for success and failure of an episode.
    fn rules(&self) -> Rules;
}

/// The team sizes that a scenario supports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TeamSizes {
    /// Smallest number of robots.
    pub least: usize,
    /// Largest number of robots.
    pub most: usize,
    /// Divisor of every supported number: 1 for any number, 2 for even teams only.
    pub multiple_of: usize,
}

impl TeamSizes {
    /// All numbers of robots from `least` to `most`.
    pub const fn new(least: usize, most: usize) -> TeamSizes {
        TeamSizes { least, most, multiple_of: 1 }
    }

    /// The even numbers of robots among these sizes.
    pub const fn even(self) -> TeamSizes {
        TeamSizes { multiple_of: 2, ..self }
    }

    /// Returns `robots` if the scenario of this name supports that many.
    pub fn check(self, scenario: &'static str, robots: usize) -> Result<usize, ScenarioError> {
        let supported = (self.least..=self.most).contains(&robots) && robots.is_multiple_of(self.multiple_of);
        if supported { Ok(robots) } else { Err(ScenarioError::Robots { scenario, sizes: self, robots }) }
    }
}

impl fmt::Display for TeamSizes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {} robots", self.least, self.most)?;
        match self.multiple_of {
            1 => Ok(()),
            2 => f.write_str(", an even number"),
            of => write!(f, ", a multiple of {of}"),
        }
    }
}

/// The user's settings of a scenario.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// Team size; `None` for the scenario's default.
    pub robots: Option<usize>,
    /// Width of its bottleneck \[m\]; `None` for the scenario's default.
    pub gap_m: Option<f32>,
}

impl Settings {
    /// Settings with this team size and defaults otherwise.
    pub fn of(robots: usize) -> Settings {
        Settings { robots: Some(robots), ..Settings::default() }
    }
}

/// A registry entry of a scenario.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name on the command line.
    pub name: &'static str,
    /// One line for the help.
    pub about: &'static str,
    /// Makes the scenario, which has the same name as this entry.
    pub build: fn(&Settings) -> Result<Arc<dyn Scenario>, ScenarioError>,
}

/// The scenarios of this crate.
pub const REGISTRY: &[Entry] = &[
    Entry {
        name: "passage",
        about: "a team crosses a narrow gap in a wall (the paper's case study)",
        build: passage::build,
    },
    Entry { name: "swap", about: "robots exchange places on open ground of constant density", build: swap::build },
];

/// Error of a scenario that cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// No scenario has that name.
    #[error("there is no scenario '{name}'; there are: {known}")]
    Unknown {
        /// The requested name.
        name: String,
        /// The existing names.
        known: String,
    },
    /// The scenario does not support this number of robots.
    #[error("the scenario '{scenario}' takes {sizes}, not {robots}")]
    Robots {
        /// The scenario.
        scenario: &'static str,
        /// The supported numbers.
        sizes: TeamSizes,
        /// The requested number.
        robots: usize,
    },
    /// The scenario does not support this width of its bottleneck, or has none.
    #[error("the scenario '{scenario}' has no gap of {gap_m} m{hint}")]
    Gap {
        /// The scenario.
        scenario: &'static str,
        /// The requested width \[m\].
        gap_m: f32,
        /// The supported widths, as the end of the message.
        hint: &'static str,
    },
    /// The scenario refuses its settings for another reason.
    #[error("the scenario '{scenario}': {why}")]
    Refused {
        /// The scenario.
        scenario: &'static str,
        /// Reason.
        why: String,
    },
}

/// Makes the scenario of this name from this crate. `Registry::scenario` also knows those of other crates.
pub fn build(name: &str, settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    build_of(REGISTRY, name, settings)
}

/// Makes the scenario of this name from these entries.
pub fn build_of(all: &[Entry], name: &str, settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let unknown = || ScenarioError::Unknown {
        name: name.to_owned(),
        known: all.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", "),
    };
    (all.iter().find(|entry| entry.name == name).ok_or_else(unknown)?.build)(settings)
}
