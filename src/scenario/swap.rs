//! Scenario `swap`: robots exchange places on open ground with a constant area per robot.
//!
//! The places form a grid, about as wide as deep. In every episode each robot gets another place as its goal. There are
//! no walls, and the policy frame is the world frame. Without a scale, the grid grows with the robots.

use std::sync::Arc;

use rand::RngExt;
use rand::seq::SliceRandom;

use super::{Arena, Progress, Rules, Scenario, ScenarioError, Settings, Size, TeamSizes};
use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::local::Contacts;
use crate::observation::PolicyFrame;
use crate::random::Seed;
use crate::time::Span;

/// Side of the square of ground per robot \[m\] at scale 1; five robots have about the area of the scenario `passage`.
/// It is the width of a place in the grid. The depth of a place is less by up to a quarter if the last row is not full.
const PITCH_M: f32 = 2.0;
/// Largest random offset of a place from its grid point along each axis, as a fraction of the spacing of the grid.
/// Neighbouring places stay 0.9 m apart at scale 1.
const JITTER: f32 = 0.2;
/// Distance from its goal within which a robot has arrived \[m\], at scale 1.
const ARRIVAL_M: f32 = 0.25;
/// Average speed \[m/s\] at which a robot crosses the arena's diagonal just within the time limit, in a large arena.
const SLOWEST_M_S: f32 = 0.2;
/// Team sizes that the scenario supports: 2 to 2000 robots.
const ROBOTS: TeamSizes = TeamSizes::new(2, 2000);
/// The last stage of a robot's progress, which begins one step after that in which it was rewarded for its arrival.
const LAST_STAGE: Progress = Progress(2);

/// Scenario in which robots exchange places on open ground without walls, with a constant area per robot.
#[derive(Debug)]
pub struct Swap {
    robots: usize,
    per_row: usize,
    /// Width and depth of a place \[m\].
    pitch: Vec2,
    size: Size,
    arena: Arena,
}

/// Makes the scenario `swap` with a user's `settings`; the default team has 8 robots. An error says that the team size,
/// the scale or the hull is not supported, or that a gap width is set, although the scenario has no walls.
pub fn build(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let robots = ROBOTS.check("swap", settings.robots.unwrap_or(8))?;
    if let Some(gap_m) = settings.gap_m {
        return Err(ScenarioError::Gap { scenario: "swap".to_owned(), gap_m, hint: "; it has no walls" });
    }
    let size = Size::of("swap", settings)?.by_hull(settings);
    let per_row = robots.isqrt() + usize::from(robots.isqrt().pow(2) < robots);
    let rows = robots.div_ceil(per_row);
    let pitch_m = size.length(PITCH_M);
    let pitch = Vec2::new(pitch_m, pitch_m * robots as f32 / (per_row * rows) as f32);
    size.check_places(("swap", "places"), settings, (1.0 - 2.0 * JITTER) * pitch.y / size.scale)?;
    let half_extent = Vec2::new(per_row as f32 * pitch.x, rows as f32 * pitch.y) / 2.0;
    let arena = Arena::new(half_extent, Vec::new(), size.robot_radius_m());
    Ok(Arc::new(Swap { robots, per_row, pitch, size, arena }))
}

impl Swap {
    /// Returns the places of all episodes in the run with this seed \[m\], world frame: grid points with random
    /// offsets.
    fn places(&self, seed: u64) -> Vec<Vec2> {
        let mut stream = Seed::of_run(seed).stream("swap/places");
        let corner = self.pitch / 2.0 - self.arena.half_extent;
        let grid = (0..self.robots).map(|k| Vec2::new((k % self.per_row) as f32, (k / self.per_row) as f32));
        grid.map(|point| {
            let off = Vec2::new(stream.random_range(-JITTER..=JITTER), stream.random_range(-JITTER..=JITTER));
            corner + (point + off).component_mul(&self.pitch)
        })
        .collect()
    }

    /// Returns for each robot the index of the place that is its goal in episode `index - 1` and its start in episode
    /// `index`: a cyclic shift, by a random number, of places in a random order. Consecutive shifts differ, so every
    /// robot moves.
    fn assignment(&self, seed: u64, index: u32) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.robots).collect();
        order.shuffle(&mut Seed::of_run(seed).stream("swap/order"));
        // Even shifts are in the lower half of their range and odd ones in the upper, so no two in a row are equal.
        let half = self.robots / 2;
        let mut stream = Seed::of_run(seed).stream(&format!("swap/deal/{index}"));
        let shift = stream.random_range(if index.is_multiple_of(2) { 0..half } else { half..self.robots });
        (0..self.robots).map(|robot| order[(robot + shift) % self.robots]).collect()
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
        let (starts, goals) = (self.assignment(seed, episode), self.assignment(seed, episode + 1));
        starts.into_iter().zip(goals).map(|(start, goal)| Task { start: places[start], goal: places[goal] }).collect()
    }

    fn frame(&self, _: &Task) -> PolicyFrame {
        PolicyFrame::World
    }

    /// Returns the reward: the speed toward the goal \[m/s\], minus 1 for a contact, plus 10 on arrival.
    fn reward(&self, task: &Task, after: &Motion, contacts: Contacts, stage: &mut Progress) -> Option<f32> {
        let offset = task.goal - after.position;
        let distance = offset.norm();
        let mut reward = if contacts.robot || contacts.wall { -1.0 } else { 0.0 };
        if distance > 0.0 {
            reward += (offset / distance).dot(&after.velocity);
        }
        *stage = match stage.0 {
            0 if self.reached(task, after.position) => Progress(1),
            1 => LAST_STAGE,
            _ => *stage,
        };
        if stage.0 == 1 {
            reward += 10.0;
        }
        Some(reward)
    }

    fn rules(&self) -> Rules {
        let across = self.arena.half_extent.norm() * 2.0;
        Rules {
            arrival_m: self.size.length(ARRIVAL_M),
            separation_m: self.size.separation_m(),
            limit: Span::from_secs(f64::from(across / SLOWEST_M_S)).max(Span::from_millis(25_000)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_per_robot_does_not_depend_on_the_team_size() {
        for robots in (2..60).chain([200, 1000, 2000]) {
            let swap = build(&Settings::of(robots)).unwrap();
            let half = swap.arena().half_extent;
            let each = 4.0 * half.x * half.y / robots as f32;
            assert!((each - PITCH_M * PITCH_M).abs() < 1e-3, "{each} m^2 for each of {robots}");
            let tasks: Vec<Task> = swap.tasks(1, 0);
            for (robot, task) in tasks.iter().enumerate().take(100) {
                let near = |other: &Task| (other.start - task.start).norm() < 0.89;
                assert!(!tasks[..robot].iter().any(near), "robot {robot} of {robots} starts beside another");
            }
        }
    }
}
