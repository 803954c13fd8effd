//! Robots trade places on an open square whose side grows with the team, so that density stays constant.
//!
//! Places form a square grid; every episode deals them out anew, and no robot keeps its own. There are no walls
//! and one policy frame.

use std::sync::Arc;

use rand::RngExt;
use rand::seq::SliceRandom;

use super::{Arena, Frame, Rules, Scenario, ScenarioError, Settings, Stage};
use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::local::Contacts;
use crate::random::Seed;
use crate::time::Span;

/// Ground per robot along each axis \[m\]: five robots get about the ground of the passage's arena.
const PITCH_M: f32 = 2.0;
/// How far a place may lie off its grid point along each axis \[m\]: neighbours stay 1.2 m apart.
const JITTER_M: f32 = 0.4;
/// Radius of a robot \[m\], as in the passage.
const ROBOT_RADIUS_M: f32 = 0.25;
/// Speed that every robot can keep up across the square \[m/s\]: it sets the time limit.
const SLOWEST_M_S: f32 = 0.2;
/// Team sizes.
const ROBOTS: (usize, usize) = (2, 2000);
/// Nothing is left to earn.
const LAST_STAGE: Stage = Stage(2);

/// Robots trade places.
#[derive(Debug)]
pub struct Swap {
    robots: usize,
    per_row: usize,
    arena: Arena,
}

/// Makes the scenario.
pub fn build(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let robots = settings.robots.unwrap_or(8);
    if !(ROBOTS.0..=ROBOTS.1).contains(&robots) {
        return Err(ScenarioError::Robots { scenario: "swap", least: ROBOTS.0, most: ROBOTS.1, robots });
    }
    if let Some(gap_m) = settings.gap_m {
        return Err(ScenarioError::Gap { scenario: "swap", gap_m, hint: "; it has no walls" });
    }
    let per_row = robots.isqrt() + usize::from(robots.isqrt().pow(2) < robots);
    let half = per_row as f32 * PITCH_M / 2.0;
    let arena = Arena {
        half_extent: Vec2::new(half, half),
        keep_outs: Vec::new(),
        portals: Vec::new(),
        robot_radius_m: ROBOT_RADIUS_M,
    };
    Ok(Arc::new(Swap { robots, per_row, arena }))
}

impl Swap {
    /// The places of one run \[m\].
    fn places(&self, seed: u64) -> Vec<Vec2> {
        let mut stream = Seed::of_run(seed).stream("swap/places");
        let corner = Vec2::repeat(PITCH_M / 2.0) - self.arena.half_extent;
        let grid = (0..self.robots).map(|k| Vec2::new((k % self.per_row) as f32, (k / self.per_row) as f32));
        grid.map(|point| {
            let jitter =
                Vec2::new(stream.random_range(-JITTER_M..=JITTER_M), stream.random_range(-JITTER_M..=JITTER_M));
            corner + point * PITCH_M + jitter
        })
        .collect()
    }

    /// Which robot has which place between two episodes. Between two deals every robot moves: the places lie
    /// in a circle of random order, and everyone is the same random number of them from where the circle began.
    fn deal(&self, seed: u64, index: u32) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.robots).collect();
        order.shuffle(&mut Seed::of_run(seed).stream("swap/order"));
        // Even deals draw from one half of the circle and odd ones from the other, so no two in a row are equal.
        let half = self.robots / 2;
        let mut stream = Seed::of_run(seed).stream(&format!("swap/deal/{index}"));
        let gone = stream.random_range(if index.is_multiple_of(2) { 0..half } else { half..self.robots });
        (0..self.robots).map(|robot| order[(robot + gone) % self.robots]).collect()
    }
}

impl Scenario for Swap {
    fn name(&self) -> &'static str {
        "swap"
    }

    fn robots(&self) -> usize {
        self.robots
    }

    fn arena(&self) -> &Arena {
        &self.arena
    }

    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task> {
        let places = self.places(seed);
        let (starts, goals) = (self.deal(seed, episode), self.deal(seed, episode + 1));
        starts.into_iter().zip(goals).map(|(start, goal)| Task { start: places[start], goal: places[goal] }).collect()
    }

    fn frame(&self, _: &Task) -> Frame {
        Frame::World
    }

    /// Speed toward the goal, one off for a blocked move, ten for arriving.
    fn reward(&self, task: &Task, after: &Motion, contacts: Contacts, stage: &mut Stage) -> f32 {
        let offset = task.goal - after.position;
        let distance = offset.norm();
        let mut reward = if contacts.robot || contacts.wall { -1.0 } else { 0.0 };
        if distance > 0.0 {
            reward += (offset / distance).dot(&after.velocity);
        }
        *stage = match stage.0 {
            0 if self.reached(task, after.position) => Stage(1),
            1 => LAST_STAGE,
            _ => *stage,
        };
        if stage.0 == 1 {
            reward += 10.0;
        }
        reward
    }

    fn finished(&self, stage: Stage) -> bool {
        stage >= LAST_STAGE
    }

    fn rules(&self) -> Rules {
        let across = self.arena.half_extent.x * 2.0 * std::f32::consts::SQRT_2;
        Rules {
            arrival_m: 0.25,
            separation_m: 0.32,
            limit: Span::from_secs(f64::from(across / SLOWEST_M_S)).max(Span::from_millis(25_000)),
        }
    }
}
