//! Behaviour of a task that its file cannot say: layouts, ends of episodes and rewards that a caller of the library
//! computes, such as a class in Python.

use std::fmt::Debug;

use crate::messages::geometry::Task;
use crate::scenario::judge::JudgedRobot;
use crate::time::Span;

/// Behaviour of a task beyond its file. The file still has ground, walls, team sizes and rules.
pub trait Behaviour: Debug + Send + Sync {
    /// Returns whether [`Behaviour::tasks`] draws the layouts of episodes. Otherwise the areas of the file do.
    fn draws(&self) -> bool;

    /// Returns start and goal of each of `robots` robots \[m\], world frame, as `Scenario::tasks` does; equal arguments
    /// give equal layouts. The starts of an episode need not be the goals of the one before. Called only if
    /// [`Behaviour::draws`].
    fn tasks(&self, robots: usize, seed: u64, episode: u32) -> Vec<Task>;

    /// Returns whether [`Behaviour::judge`] is to be called.
    fn judges(&self) -> bool;

    /// Takes the state of the team after a step of an episode that is judged by true states. Returns whether the
    /// episode ends with it: as if the last robot had arrived.
    fn judge(&self, step: &EpisodeStep) -> bool;

    /// Returns whether [`Behaviour::observe`] gives the values of the sense `task`.
    fn observes(&self) -> bool;

    /// Returns what the robots observe at a step of an episode that one World simulates: equally many floats for each,
    /// in the order of robot ids.
    fn observe(&self, step: &EpisodeStep) -> Vec<f32>;
}

/// State of a team after a step of an episode. Each slice has one entry per robot, in the order of robot ids.
#[derive(Clone, Copy, Debug)]
pub struct EpisodeStep<'a> {
    /// Index of the trial among the repeats of the experiment, from zero.
    pub repeat: u32,
    /// Index of the episode, from zero.
    pub episode: u32,
    /// Time since the start of the episode.
    pub after: Span,
    /// Start and goal of each robot \[m\], world frame.
    pub tasks: &'a [Task],
    /// True state of each robot, world frame.
    pub robots: &'a [JudgedRobot],
    /// Whether each robot has arrived in this episode.
    pub arrived: &'a [bool],
    /// Length \[m\] of each robot's remaining path.
    pub to_go_m: &'a [f32],
    /// Length \[m\] by which that path became shorter in the step.
    pub progress_m: &'a [f32],
    /// Whether this is the first step of the episode that its receiver gets.
    pub is_first: bool,
}
