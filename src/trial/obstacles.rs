//! Checks that the world of a trial can take the obstacles of its task.

use super::Trial;
use crate::config::ConfigError;
use crate::messages::geometry::Vec2;
use crate::random::Seed;
use crate::world;

impl Trial {
    /// Checks that the plant can take the obstacles that are drawn for each episode, and those that move. An error
    /// names the field.
    pub(super) fn check_obstacles(&self, entry: &world::Entry) -> Result<(), ConfigError> {
        let (fixed, drawn) = (self.scenario.arena(), self.layouts.arena(0));
        if self.layouts.is_empty() || drawn.is_none() && fixed.movers.is_empty() {
            return Ok(());
        }
        let starts: Vec<Vec2> = self.layouts.episode(0).iter().map(|task| task.start).collect();
        let mut plant = (entry.build)(fixed, &self.physics, &starts, Seed::of_run(0));
        let why = if !fixed.movers.is_empty() && !plant.elapse(None) {
            format!("'{}' has no moving obstacles, and this task has some", entry.name)
        } else if drawn.is_some_and(|arena| !plant.enter(arena)) {
            format!("'{}' has one arena for all episodes, and this task draws obstacles for each", entry.name)
        } else {
            return Ok(());
        };
        Err(ConfigError::field("plant", why))
    }
}
