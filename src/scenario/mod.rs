//! Scenarios: tasks for robot teams, each with its arena, policy frames, reward and rules of judging.
//!
//! To add a scenario, add one file and one line in `REGISTRY`; `tests/graph/contracts.rs` then tests it. Another crate
//! adds its scenario in the line where it makes its `Registry`, and tests it with [`contract::check`]. The code of this
//! folder uses no policy, network or actor. `task_file` makes scenarios from data.

pub mod arena;
mod block;
pub mod contract;
pub(crate) mod cost;
pub mod course;
mod error;
mod flocking;
pub mod goals;
pub mod judge;
pub mod layout;
mod mover;
mod passage;
mod polygon;
pub mod sightings;
pub mod size;
mod swap;
pub mod task_file;
pub(crate) mod watched;
mod weights;

use std::fmt::{self, Debug};
use std::sync::Arc;

pub use arena::{Arena, Portal};
pub use block::{KeepOut, Solid};
pub use cost::Cost;
pub use error::ScenarioError;
pub use goals::Goals;
pub use mover::{DrawnMover, Mover};
pub use size::Size;
pub use task_file::TaskFile;
pub use weights::Weights;

use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::local::Contacts;
use crate::observation::{Channel, PolicyFrame};
use crate::time::Span;

/// Stage of a robot's progress in an episode, as a number that only the reward uses. It is zero at the start of an
/// episode, and the scenario increments it, for example when the robot reaches a waypoint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Progress(pub u8);

/// Criteria for success and failure of an episode, by which the judge decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Distance \[m\] from its goal within which a robot has arrived. A robot that leaves its goal again still counts
    /// as arrived.
    pub arrival_m: f32,
    /// Distance \[m\] between the centres of two robots below which they have collided.
    pub separation_m: f32,
    /// Time since the start of an episode within which every robot must arrive. An episode without goals lasts as long.
    pub limit: Span,
}

/// State of a team after a simulation step, from which a scenario computes rewards. Each slice has one entry per robot,
/// in the order of robot ids.
#[derive(Debug)]
pub struct TeamAfterStep<'a> {
    /// Start and goal of each robot in this episode \[m\], world frame.
    pub tasks: &'a [Task],
    /// Position \[m\], world frame, of the point of each robot that its policy commands: the centre, unless its drive
    /// is differential.
    pub position: &'a [Vec2],
    /// Velocity \[m/s\], world frame, of the point of each robot that its policy commands: the centre, unless its drive
    /// is differential.
    pub velocity: &'a [Vec2],
    /// Contacts of each robot with walls and other robots in the step.
    pub contacts: &'a [Contacts],
    /// Stage of progress of each robot, which the computation of the reward updates.
    pub stage: &'a mut [Progress],
}

/// Task for a team of robots, with its arena, its reward and its rules of success. Positions passed to the methods are
/// those of the commanded point. It is the centre of a holonomic robot, and a point ahead of the axle of a differential
/// drive.
pub trait Scenario: Debug + Send + Sync {
    /// Returns the name of the scenario, by which a user selects it on the command line. That of a task file is the
    /// name in the file, and it is selected by the file's path.
    fn name(&self) -> &str;

    /// Returns the number of robots in the team.
    fn robots(&self) -> usize;

    /// Returns the arena: ground, walls and bottlenecks, in the world frame. It has what is the same in all episodes.
    fn arena(&self) -> &Arena;

    /// Returns the arena of an episode: that of `arena`, with the obstacles that are drawn for this episode alone, and
    /// moving obstacles where they begin in it.
    /// `seed` is the seed of the run, and `episode` counts from 0. `None`, the default, means that every episode has
    /// the arena of `arena`. It must not depend on the episode whether there is one.
    ///
    /// The obstacles leave room for the robots: each start and goal of the episode is free.
    fn drawn_arena(&self, _seed: u64, _episode: u32) -> Option<Arena> {
        None
    }

    /// Returns start and goal of every robot \[m\], world frame, in the order of robot ids. `seed` is the seed of the
    /// run, and `episode` counts from 0. The starts of an episode are the goals of the previous episode, unless the
    /// scenario has no goals (`cost`), or a task's behaviour draws its layouts (`TaskFile::draws_apart`).
    /// Robots are then placed at their starts where a world simulates them.
    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task>;

    /// Returns the waypoints of every robot \[m\], world frame, in the order of robot ids: the places that it passes in
    /// this order before its goal, equally many for each. `seed` and `episode` are as in `tasks`. Empty, the default,
    /// means that robots go straight to their goals.
    ///
    /// A robot with waypoints gets the tasks of its legs, one after the other: its own start, with the next waypoint as
    /// the goal (`course::Course`). So what the methods here say of a goal is of the next waypoint, too.
    fn waypoints(&self, _seed: u64, _episode: u32) -> Vec<Vec<Vec2>> {
        Vec::new()
    }

    /// Returns to whom the goals of the tasks belong. The default is that each robot has its own.
    ///
    /// If the goals are unlabelled, the tasks have them in an order that means nothing, and an episode succeeds once
    /// every goal has a robot. The start of a robot in the next episode is the goal of its task all the same. The
    /// scenario then has the channels `goals::channel` and `goals::nearest`.
    fn goals(&self) -> Goals {
        Goals::Labelled
    }

    /// Returns the cost by which an episode is judged, in a scenario without goals. Its episodes end by time,
    /// `Rules::limit`, and their verdict is the cost, with collisions. `None`, the default, means that each robot has
    /// to arrive at its goal.
    ///
    /// In a scenario without goals no robot is ever at its goal: `reached` is false, and `distance_to_go` is zero.
    fn cost(&self) -> Option<Cost> {
        None
    }

    /// Returns the velocity \[m/s\], world frame, that a robot with start and goal `_task` has at the start of an
    /// episode, if a simulated world places it there. Robots that drive to their starts begin at rest. The default is
    /// zero.
    fn start_velocity(&self, _task: &Task) -> Vec2 {
        Vec2::zeros()
    }

    /// Returns the policy frame of a robot with start and goal `task`: the world frame, or that frame rotated by half a
    /// turn. In this frame the robot's policy observes (`Observation::in_frame`) and commands.
    fn frame(&self, task: &Task) -> PolicyFrame;

    /// Returns the channels that the scenario adds to the observation, besides the built-in ones. A policy takes them
    /// by their names. The default is none.
    fn channels(&self) -> Vec<Channel> {
        Vec::new()
    }

    /// Returns true if a robot with start and goal `task` has arrived when it is at `position` \[m\], world frame. In
    /// the default implementation that means within `Rules::arrival_m` of the goal, and never in a scenario without
    /// goals.
    fn reached(&self, task: &Task, position: Vec2) -> bool {
        self.cost().is_none() && (task.goal - position).norm() <= self.rules().arrival_m
    }

    /// Returns the scenario's own reward of one robot for one step of training, and updates the robot's `_stage`.
    /// `_task` is the robot's start and goal. `_after` is the robot's state after the step, world frame, and
    /// `_contacts` its contacts in the step.
    ///
    /// `None`, the default, means that the scenario has no reward of its own. Training then rewards only progress and
    /// arrival, by `distance_to_go` and `reached`.
    fn reward(&self, _task: &Task, _after: &Motion, _contacts: Contacts, _stage: &mut Progress) -> Option<f32> {
        None
    }

    /// Writes the reward of each robot of a team, by the method `reward`, into `rewards`, in the order of robot ids;
    /// zero where that method returns `None`. The trainer calls it once per team and step, which is faster than one
    /// dynamic call per robot.
    fn rewards(&self, team: TeamAfterStep, rewards: &mut [f32]) {
        let states = team.position.iter().zip(team.velocity).zip(team.contacts);
        for (((task, ((&position, &velocity), &contacts)), stage), reward) in
            team.tasks.iter().zip(states).zip(team.stage).zip(rewards)
        {
            *reward = self.reward(task, &Motion { position, velocity }, contacts, stage).unwrap_or(0.0);
        }
    }

    /// Writes into `reached` for each robot of a team whether it has arrived: by the method `reached` or, where goals
    /// are unlabelled, all at once when every goal has a robot. All slices are in the order of robot ids; `position` is
    /// in \[m\], world frame. The trainer calls this method once per team and step.
    fn arrivals(&self, tasks: &[Task], position: &[Vec2], reached: &mut [bool]) {
        if self.goals().are_unlabelled() {
            let goals = tasks.iter().map(|task| task.goal);
            let held = goals::held(goals, position.iter().copied(), self.rules().arrival_m);
            return reached.fill(!held.contains(&false));
        }
        for ((task, position), reached) in tasks.iter().zip(position).zip(reached) {
            *reached = self.reached(task, *position);
        }
    }

    /// Returns the length \[m\] of the remaining path to the goal, for a robot with start and goal `task` at `position`
    /// \[m\], world frame. Training rewards its decrease. The default implementation is the straight distance, and zero
    /// in a scenario without goals.
    fn distance_to_go(&self, task: &Task, position: Vec2) -> f32 {
        if self.cost().is_none() { (task.goal - position).norm() } else { 0.0 }
    }

    /// Writes the length \[m\] of the remaining path of each robot of a team at `position` \[m\] into `to_go_m`, by the
    /// method `distance_to_go`. Unlabelled goals are those of the assignment with the least sum of squared lengths. All
    /// slices are in the order of robot ids.
    fn distances_to_go(&self, tasks: &[Task], position: &[Vec2], to_go_m: &mut [f32]) {
        if self.goals().are_unlabelled() {
            return goals::shared_out(to_go_m, |robot, goal| self.distance_to_go(&tasks[goal], position[robot]));
        }
        for ((task, position), to_go_m) in tasks.iter().zip(position).zip(to_go_m) {
            *to_go_m = self.distance_to_go(task, *position);
        }
    }

    /// Returns the success rate, 0 to 1, that the scripted policy (`policy::scripted`) must reach with the scenario's
    /// default team in mode `sim`. The test `tests/graph/contracts.rs` requires it of scenarios with goals.
    fn scripted_success(&self) -> f64 {
        0.9
    }

    /// Returns the criteria for success and failure of an episode.
    fn rules(&self) -> Rules;

    /// Returns the weights that the scenario gives to terms of the reward, which replace those of a training's preset.
    /// The default is none.
    fn weights(&self) -> Weights {
        Weights::default()
    }

    /// Returns the task file from which the scenario was made; `None`, the default, for one that is written in Rust.
    fn task_file(&self) -> Option<&TaskFile> {
        None
    }
}

/// Team sizes that a scenario supports: a range of numbers of robots, possibly only the multiples of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TeamSizes {
    /// Smallest supported number of robots.
    pub least: usize,
    /// Largest supported number of robots.
    pub most: usize,
    /// Divisor of every supported number of robots: 1 if every number is supported, 2 for even numbers only.
    pub(crate) multiple_of: usize,
}

impl TeamSizes {
    /// Returns all team sizes from `least` to `most` robots, both included.
    pub const fn new(least: usize, most: usize) -> TeamSizes {
        TeamSizes { least, most, multiple_of: 1 }
    }

    /// Returns this range of team sizes, restricted to even numbers of robots.
    pub const fn even(self) -> TeamSizes {
        TeamSizes { multiple_of: 2, ..self }
    }

    /// Returns `robots` if it is a supported team size. Otherwise the error names the supported sizes and the scenario,
    /// whose name is `scenario`.
    pub fn check(self, scenario: &str, robots: usize) -> Result<usize, ScenarioError> {
        let supported = (self.least..=self.most).contains(&robots) && robots.is_multiple_of(self.multiple_of);
        if supported {
            Ok(robots)
        } else {
            Err(ScenarioError::Robots { scenario: scenario.to_owned(), sizes: self, robots })
        }
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

/// A user's settings of a scenario: team size, width of the bottleneck, scale, and hull of the robots.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Settings {
    /// Number of robots in the team; `None` for the scenario's default.
    pub robots: Option<usize>,
    /// Width of the scenario's bottleneck \[m\]; `None` for the scenario's default.
    pub gap_m: Option<f32>,
    /// Factor on the lengths of the task, but for the robots; `None` for 1.
    pub scale: Option<f32>,
    /// Radius of a robot's hull \[m\]; `None` for that of the paper's robots, 0.16 m.
    pub hull_m: Option<f32>,
}

impl Settings {
    /// Returns settings with a team of `robots` robots and the scenario's defaults otherwise.
    pub fn of(robots: usize) -> Settings {
        Settings { robots: Some(robots), ..Settings::default() }
    }
}

/// Registry entry of a scenario (a task for a robot team): its name and its constructor.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name by which a user selects the scenario on the command line; the scenario itself must have the same name.
    pub name: &'static str,
    /// Description of the scenario in one line, for the program's help text.
    pub about: &'static str,
    /// Constructor of the scenario from a user's settings. An error says which setting the scenario does not support.
    pub build: fn(&Settings) -> Result<Arc<dyn Scenario>, ScenarioError>,
}

/// All scenarios of this crate, from which a user selects one by name.
pub const REGISTRY: &[Entry] = &[
    Entry {
        name: "passage",
        about: "a team crosses a narrow gap in a wall (the paper's case study)",
        build: passage::build,
    },
    Entry {
        name: "flocking",
        about: "a team that starts with random velocities agrees on one; robots have no goals",
        build: flocking::build,
    },
    Entry { name: "swap", about: "robots exchange places on open ground of constant density", build: swap::build },
];

/// Makes the scenario of this crate that has the name `name`, with a user's `settings`. `Registry::scenario` also knows
/// the scenarios of other crates. An error says that the name is unknown or a setting not supported.
pub fn build(name: &str, settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    build_of(REGISTRY, name, settings)
}

/// Makes the scenario named `name` from the registry entries `all`, with a user's `settings`. An error says that the
/// name is unknown or a setting not supported. A scenario whose author has given it one size refuses another one.
pub(crate) fn build_of(all: &[Entry], name: &str, settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let unknown = || ScenarioError::Unknown {
        name: name.to_owned(),
        known: all.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", "),
    };
    let entry = all.iter().find(|entry| entry.name == name).ok_or_else(unknown)?;
    let scenario = (entry.build)(settings)?;
    let size = Size::of(entry.name, settings)?;
    let one_size = |field, what: &str| {
        let why = format!("has one {what} only: leave {field} out, or let its author read it (Settings::{field})");
        Err(ScenarioError::Size { scenario: entry.name.to_owned(), field, why })
    };
    let arena = scenario.arena();
    if settings.hull_m.is_some() && (arena.robot_radius_m / size.robot_radius_m() - 1.0).abs() > 1e-4 {
        return one_size("hull_m", "size of robots");
    }
    // What has the same ground at another scale does not know of it.
    let other =
        settings.scale.filter(|scale| *scale != 1.0).map(|scale| Settings { scale: Some(0.99 * scale), ..*settings });
    let other = other.and_then(|settings| (entry.build)(&settings).ok());
    if other.is_some_and(|other| other.arena().half_extent == arena.half_extent) {
        return one_size("scale", "size");
    }
    Ok(scenario)
}
