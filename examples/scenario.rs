//! A scenario of one's own: robots face each other in two rows and change sides. Scripted navigation does it at once.
//! `tests/stranger/` shows how a scenario comes to the command line.
//!
//!     cargo run --release --example scenario

use std::sync::Arc;

use murmurate::messages::geometry::{Motion, Task, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::registry::Registry;
use murmurate::scenario::{Arena, Entry, Frame, Rules, Scenario, ScenarioError, Settings, Stage};
use murmurate::time::Span;
use murmurate::trial::Trial;

const ROWS: Entry = Entry { name: "rows", about: "two rows change sides", build };

#[derive(Debug)]
struct Rows {
    robots: usize,
    arena: Arena,
}

fn build(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let robots = settings.robots.unwrap_or(6);
    if !(2..=12).contains(&robots) {
        return Err(ScenarioError::Robots { scenario: ROWS.name, min: 2, max: 12, robots });
    }
    let half_extent = Vec2::new(2.0 + robots as f32 / 2.0, 3.0);
    let arena = Arena { half_extent, keep_outs: Vec::new(), portals: Vec::new(), robot_radius_m: 0.25 };
    Ok(Arc::new(Rows { robots, arena }))
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

    /// The goals of one episode are the starts of the next.
    fn tasks(&self, _: u64, episode: u32) -> Vec<Task> {
        let place = |robot: usize, episode: u32| {
            let side = if (robot + episode as usize).is_multiple_of(2) { 1.0 } else { -1.0 };
            Vec2::new(robot as f32 - (self.robots - 1) as f32 / 2.0, 1.5 * side)
        };
        let task = |robot| Task { start: place(robot, episode), goal: place(robot, episode + 1) };
        (0..self.robots).map(task).collect()
    }

    fn frame(&self, _: &Task) -> Frame {
        Frame::World
    }

    /// For training alone: speed along y toward the goal.
    fn reward(&self, task: &Task, after: &Motion, _: Contacts, stage: &mut Stage) -> f32 {
        *stage = Stage(u8::from(self.reached(task, after.position)));
        (task.goal - after.position).y.signum() * after.velocity.y
    }

    fn finished(&self, stage: Stage) -> bool {
        stage == Stage(1)
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
