//! A scenario of your own: robots face each other in two rows and change sides, with scripted navigation.
//! `tests/stranger/` shows how to add a scenario to the command line.
//!
//!     cargo run --release --example scenario

use std::sync::Arc;

use murmurate::messages::geometry::{Task, Vec2};
use murmurate::observation::PolicyFrame;
use murmurate::registry::Registry;
use murmurate::scenario::{Arena, Entry, Rules, Scenario, ScenarioError, Settings, TeamSizes};
use murmurate::time::Span;
use murmurate::trial::Trial;

const ROWS: Entry = Entry { name: "rows", about: "two rows change sides", build };

#[derive(Debug)]
struct Rows {
    robots: usize,
    arena: Arena,
}

fn build(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let robots = TeamSizes::new(2, 12).even().check(ROWS.name, settings.robots.unwrap_or(6))?;
    let half_extent = Vec2::new(2.0 + robots as f32 / 2.0, 3.0);
    Ok(Arc::new(Rows { robots, arena: Arena::new(half_extent, Vec::new(), 0.25) }))
}

impl Scenario for Rows {
    fn name(&self) -> &'static str {
        ROWS.name
    }

    fn robots(&self) -> usize {
        self.robots
    }

    fn arena(&self) -> &Arena {
        &self.arena
    }

    /// Returns the tasks of an episode; its goals are the starts of the next.
    fn tasks(&self, _: u64, episode: u32) -> Vec<Task> {
        let place = |robot: usize, episode: u32| {
            let side = if (robot + episode as usize).is_multiple_of(2) { 1.0 } else { -1.0 };
            Vec2::new(robot as f32 - (self.robots - 1) as f32 / 2.0, 1.5 * side)
        };
        let task = |robot| Task { start: place(robot, episode), goal: place(robot, episode + 1) };
        (0..self.robots).map(task).collect()
    }

    fn frame(&self, _: &Task) -> PolicyFrame {
        PolicyFrame::World
    }

    fn rules(&self) -> Rules {
        Rules { arrival_m: 0.25, separation_m: 0.32, limit: Span::from_secs(25.0) }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let registry = Registry::builtin().with_scenario(ROWS);
    let report = Trial::from_registry(&registry, "offboard", "rows", 8)?.episodes(3).run();
    println!("{} of {} episodes succeeded", report.successes(), report.episodes.len());
    assert_eq!(report.successes(), 3);
    Ok(())
}
