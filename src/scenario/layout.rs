//! Layouts of a trial's episodes: start and goal of every robot, drawn at random by a scenario or read from a file, and
//! the obstacles that the scenario draws for an episode.
//!
//! A file is JSON: `{"episodes": [[{"start": [x, y], "goal": [x, y]}, ...], ...]}`, in metres, world frame.

use std::sync::Arc;

use serde::Deserialize;

use super::course::Course;
use super::{Arena, DrawnMover, KeepOut, Scenario, Solid};
use crate::config;
use crate::config::shown::counted;
use crate::messages::geometry::{Planar, Task, Vec2, is_finite};
use crate::messages::ids::RobotId;

/// Largest distance \[m\] between a robot's start in an episode and its goal in the previous episode at which both
/// count as equal.
const CHAIN_M: f32 = 1e-3;

/// Start and goal of every robot in every episode of a trial (a run of several episodes), and the arenas of the
/// episodes where these differ.
#[derive(Clone, Debug, Default)]
pub struct Layouts {
    episodes: Arc<[Vec<Task>]>,
    /// Arena of each episode; empty if all have the arena of the scenario.
    arenas: Arc<[Arc<Arena>]>,
    /// Waypoints of each robot in each episode; empty if there are none.
    waypoints: Arc<[Vec<Vec<Vec2>>]>,
}

/// Error of a layout file (starts and goals of a trial's episodes) that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LayoutError {
    /// The text is not JSON, or a field is missing, unknown or of the wrong type; the text describes the fault.
    #[error("{0}")]
    Syntax(String),
    /// The file holds fewer episodes than are requested.
    #[error("it holds {}; {wanted} are wanted (use --episodes {held} or fewer)", counted(held, "episode"))]
    TooFew {
        /// Number of episodes in the file.
        held: usize,
        /// Number of episodes requested.
        wanted: usize,
    },
    /// The scenario draws obstacles or waypoints for each episode, which a file of starts and goals does not have.
    #[error("the {what} of '{scenario}' are drawn with the starts and goals: leave the file out")]
    Drawn {
        /// Name of the scenario.
        scenario: String,
        /// Word for the things that are drawn, such as `obstacles`.
        what: &'static str,
    },
    /// An episode has a wrong number of robots, or a start or goal that no robot can have.
    #[error("episodes[{episode}]: {reason}")]
    Episode {
        /// Index of the wrong episode in the file, from zero.
        episode: usize,
        /// Description of the fault.
        reason: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    episodes: Vec<Vec<Entry>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    start: [f32; 2],
    goal: [f32; 2],
}

impl Layouts {
    /// Returns the layouts of the first `episodes` episodes, which `scenario` draws at random from `seed`.
    pub fn of_scenario(scenario: &dyn Scenario, seed: u64, episodes: u32) -> Layouts {
        Layouts {
            episodes: (0..episodes).map(|episode| scenario.tasks(seed, episode)).collect(),
            arenas: (0..episodes).map_while(|episode| scenario.drawn_arena(seed, episode)).map(Arc::new).collect(),
            waypoints: (0..episodes)
                .map(|episode| scenario.waypoints(seed, episode))
                .take_while(|waypoints| !waypoints.is_empty())
                .collect(),
        }
    }

    /// Reads the first `episodes` layouts of a JSON text and checks them against `scenario`: team size, free starts and
    /// goals. The text is `{"episodes": [[{"start": [x, y], "goal": [x, y]}, ...], ...]}` in metres, world frame.
    pub fn from_json(text: &str, scenario: &dyn Scenario, episodes: u32) -> Result<Layouts, LayoutError> {
        let has_waypoints = !scenario.waypoints(0, 0).is_empty();
        let drawn = [(scenario.drawn_arena(0, 0).is_some(), "obstacles"), (has_waypoints, "waypoints")];
        if let Some((_, what)) = drawn.into_iter().find(|(is_drawn, _)| *is_drawn) {
            return Err(LayoutError::Drawn { scenario: scenario.name().to_owned(), what });
        }
        let file: File = serde_json::from_str(text).map_err(|e| LayoutError::Syntax(config::json(&e)))?;
        let wanted = episodes as usize;
        if file.episodes.len() < wanted {
            return Err(LayoutError::TooFew { held: file.episodes.len(), wanted });
        }
        let parse = |(episode, entries): (usize, Vec<Entry>)| {
            let tasks: Vec<Task> =
                entries.iter().map(|entry| Task { start: entry.start.into(), goal: entry.goal.into() }).collect();
            check(scenario, &tasks).map_err(|reason| LayoutError::Episode { episode, reason })?;
            Ok(tasks)
        };
        let episodes: Result<_, LayoutError> = file.episodes.into_iter().take(wanted).enumerate().map(parse).collect();
        Ok(Layouts { episodes: episodes?, ..Layouts::default() })
    }

    /// Returns the number of episodes in a JSON text; `None` if there are none or it is not such a text.
    pub fn held_in(text: &str) -> Option<u32> {
        let file: File = serde_json::from_str(text).ok()?;
        u32::try_from(file.episodes.len()).ok().filter(|held| *held > 0)
    }

    /// Returns the layouts of the episodes from index `first` (from zero) to the last.
    pub fn since(&self, first: u32) -> Layouts {
        let skipped = first as usize;
        Layouts {
            episodes: self.episodes.iter().skip(skipped).cloned().collect(),
            arenas: self.arenas.iter().skip(skipped).cloned().collect(),
            waypoints: self.waypoints.iter().skip(skipped).cloned().collect(),
        }
    }

    /// Returns the layouts of the first `count` episodes.
    pub fn first(&self, count: u32) -> Layouts {
        let taken = count as usize;
        Layouts {
            episodes: self.episodes.iter().take(taken).cloned().collect(),
            arenas: self.arenas.iter().take(taken).cloned().collect(),
            waypoints: self.waypoints.iter().take(taken).cloned().collect(),
        }
    }

    /// Returns the number of episodes for which there are starts and goals.
    pub fn len(&self) -> u32 {
        u32::try_from(self.episodes.len()).expect("episodes were counted in u32")
    }

    /// Returns true if there are no episodes.
    pub fn is_empty(&self) -> bool {
        self.episodes.is_empty()
    }

    /// Returns start and goal of each robot in the episode with index `episode` (from zero), in the order of robot ids.
    ///
    /// # Panics
    /// If there is no such episode.
    pub fn episode(&self, episode: u32) -> &[Task] {
        &self.episodes[episode as usize]
    }

    /// Returns the arena of the episode with index `episode` (from zero), with the obstacles that are drawn for it;
    /// `None` if all episodes have the arena of the scenario, or if there is no such episode.
    pub fn arena(&self, episode: u32) -> Option<&Arc<Arena>> {
        self.arenas.get(episode as usize)
    }

    /// Returns the waypoints \[m\], world frame, of each robot in each episode; empty if there are none.
    pub fn waypoints(&self) -> Vec<Vec<Vec<[f32; 2]>>> {
        let course = |waypoints: &Vec<Vec2>| waypoints.iter().map(Planar::to_array).collect();
        self.waypoints.iter().map(|robots| robots.iter().map(course).collect()).collect()
    }

    /// Returns the course of a robot in the episode with index `episode` (from zero): straight to its goal if there are
    /// no waypoints, or no such episode.
    pub fn course(&self, episode: u32, robot: RobotId) -> Course {
        let waypoints = self.waypoints.get(episode as usize).and_then(|robots| robots.get(robot.index()));
        waypoints.cloned().map_or_else(Course::default, Course::new)
    }

    /// Returns the shapes of the solid blocks of each episode. Empty if all episodes have the arena of the scenario.
    pub fn drawn_blocks(&self) -> Vec<Vec<Solid>> {
        self.arenas.iter().map(|arena| arena.keep_outs.iter().map(KeepOut::solid).collect()).collect()
    }

    /// Returns the obstacles that move in the scenario with the arena `arena`, with where they begin in each episode.
    pub fn movers(&self, arena: &Arena) -> Vec<DrawnMover> {
        DrawnMover::of_run(&arena.movers, self.arenas.iter().map(|arena| arena.movers.as_slice()))
    }

    /// Returns true if every robot's start in an episode is its goal in the previous episode (within 1 mm), so that
    /// robots which have reached their goals are already at their next starts.
    pub fn chained(&self) -> bool {
        self.episodes.windows(2).all(|pair| {
            pair[0].iter().zip(&pair[1]).all(|(before, after)| (before.goal - after.start).norm() <= CHAIN_M)
        })
    }
}

/// Checks that robots with these `tasks` have room at their starts and goals in `scenario`, apart from each other. An
/// error says which robot has not, and where.
pub fn check(scenario: &dyn Scenario, tasks: &[Task]) -> Result<(), String> {
    if tasks.len() != scenario.robots() {
        return Err(format!("{} robots; the team has {}", tasks.len(), scenario.robots()));
    }
    // Without goals, only the starts are places of robots.
    let ends = [("start", (|task| task.start) as fn(&Task) -> Vec2), ("goal", |task| task.goal)];
    let ends = if scenario.cost().is_some() { &ends[..1] } else { &ends[..] };
    for &(end, pick) in ends {
        for (robot, task) in tasks.iter().enumerate() {
            let at = pick(task);
            if !is_finite(at) || !scenario.arena().has_room(at) {
                return Err(format!("robot {robot} cannot have its {end} at ({}, {})", at.x, at.y));
            }
            let near = |other: &&Task| (pick(other) - at).norm() < 2.0 * scenario.arena().robot_radius_m;
            if let Some(other) = tasks[..robot].iter().position(|task| near(&task)) {
                return Err(format!("robots {other} and {robot} overlap at their {end}s"));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Settings, build};

    #[test]
    fn layouts_of_a_scenario_chain_and_a_bad_file_is_refused() {
        let passage = build("passage", &Settings::of(2)).unwrap();
        let layouts = Layouts::of_scenario(&*passage, 1, 4);
        assert!(layouts.chained());
        let robot = |sx: f32, gx: f32| format!("{{\"start\":[{sx},-1.5],\"goal\":[{gx},1.5]}}");
        let file = |a: String, b: String| format!("{{\"episodes\":[[{a},{b}]]}}");
        let read = |text: &str, n| Layouts::from_json(text, &*passage, n).map_err(|e| e.to_string());
        assert!(read(&file(robot(0.0, 0.0), robot(1.0, 1.0)), 1).is_ok());
        assert!(read(&file(robot(0.0, 0.0), robot(1.0, 1.0)), 2).unwrap_err().contains("1 episode"));
        assert!(
            read(&file(robot(0.0, 0.0), robot(0.1, 1.0)), 1)
                .unwrap_err()
                .contains("robots 0 and 1 overlap at their starts")
        );
        assert!(read(&file(robot(0.0, 0.0), robot(1.0, 9.0)), 1).unwrap_err().contains("robot 1 cannot have its goal"));
        assert!(read("{}", 1).unwrap_err().contains("episodes"));
    }
}
