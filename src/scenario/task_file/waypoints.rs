//! Waypoints of a task file's episodes: the places that each robot passes in order before its goal.

use super::areas::Area;
use super::fields::Fields;
use crate::config::ConfigError;
use crate::messages::geometry::{Task, Vec2};
use crate::random::Seed;
use crate::scenario::Arena;

/// Number of episodes for which waypoints are drawn to see whether there is room for them.
const TRIED: u32 = 8;

/// Areas in which waypoints are drawn.
#[derive(Clone, Debug)]
pub struct Waypoints {
    areas: Vec<Area>,
    /// Whether the team comes back in every second episode, and passes the areas in the reverse order then.
    returns: bool,
}

impl Waypoints {
    /// Returns the waypoints of a task file whose lengths are multiplied by `scale`.
    pub fn of(fields: &Fields, scale: f32) -> Waypoints {
        let areas = fields.waypoints.iter().map(|shape| Area::of(shape, scale)).collect();
        Waypoints { areas, returns: fields.start.is_some() }
    }

    /// Checks that every robot has places beside the goals of the others. `tasks` returns the starts and goals of an
    /// episode of the run with seed 0. An error names the field.
    pub fn check(&self, arena: &Arena, tasks: impl Fn(u32) -> Vec<Task>) -> Result<(), ConfigError> {
        for episode in (0..TRIED).filter(|_| !self.areas.is_empty()) {
            let goals: Vec<Vec2> = tasks(episode).iter().map(|task| task.goal).collect();
            for (at, area) in self.areas.iter().enumerate() {
                let stream = &mut Seed::of_run(0).stream(&format!("task-file/waypoints/{at}/{episode}"));
                if area.draw_beside(arena, &goals, stream).is_none() {
                    let why =
                        "no robot fits there beside the goals, where others may stand: make it larger, or elsewhere";
                    return Err(ConfigError::field(format!("waypoints[{at}]"), why));
                }
            }
        }
        Ok(())
    }

    /// Returns the waypoints \[m\] of each robot in an episode of the run with this seed, whose starts and goals are
    /// `tasks`. Empty if the file has none.
    pub fn draw(&self, arena: &Arena, tasks: &[Task], (seed, episode): (u64, u32)) -> Vec<Vec<Vec2>> {
        if self.areas.is_empty() {
            return Vec::new();
        }
        let goals: Vec<Vec2> = tasks.iter().map(|task| task.goal).collect();
        let mut ways = vec![Vec::with_capacity(self.areas.len()); tasks.len()];
        let backwards = self.returns && !episode.is_multiple_of(2);
        for turn in 0..self.areas.len() {
            let at = if backwards { self.areas.len() - 1 - turn } else { turn };
            let stream = &mut Seed::of_run(seed).stream(&format!("task-file/waypoints/{at}/{episode}"));
            for way in &mut ways {
                // Where goals leave no room, a waypoint may be beside one.
                let place = self.areas[at].draw_beside(arena, &goals, stream);
                way.push(place.unwrap_or_else(|| self.areas[at].draw(arena, 1, stream)[0]));
            }
        }
        ways
    }
}
