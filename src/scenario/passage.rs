//! Scenario `passage`, the case study of the paper arXiv 2111.01777 (section V): a team crosses a 1 m gap in a wall.
//!
//! The x axis runs across the arena, the y axis through the gap. The wall lies on the x axis, and the gap is centred at
//! the origin. The team starts on alternate sides of the wall from episode to episode; in the policy frame, the start
//! is always at negative y and the goal at positive y.

use std::f32::consts::PI;
use std::sync::Arc;

use rand::RngExt;

use super::{Arena, Frame, KeepOut, Portal, Rules, Scenario, ScenarioError, Settings, Stage, TeamSizes};
use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::local::Contacts;
use crate::random::{Seed, Stream};
use crate::time::Span;

/// Half the size of the arena along x and y \[m\]; the whole arena is 4 m by 6 m (paper, section V).
const HALF_EXTENT: Vec2 = Vec2::new(2.0, 3.0);
/// Default width of the gap in the wall \[m\].
const GAP_M: f32 = 1.0;
/// Smallest and largest width of the gap in the wall that a user may set \[m\].
const GAPS_M: (f32, f32) = (0.6, 3.0);
/// Half the thickness of the wall \[m\].
const WALL_HALF_M: f32 = 0.15;
/// Radius of a robot \[m\].
const ROBOT_RADIUS_M: f32 = 0.25;
/// Spacing of the square lattice on which the robots of a formation stand \[m\]. They stand on points (column, row) of
/// the lattice with an even sum of column and row.
const SPACING_M: f32 = 0.6;
/// Largest |x| of the centre of the formation in which a team starts or ends \[m\].
const CENTRE_X_M: f32 = 1.0;
/// Smallest and largest |y| of the centre of the formation in which a team starts or ends \[m\].
const CENTRE_Y_M: (f32, f32) = (1.5, 2.0);
/// Smallest distance between a start or goal and the face of the wall \[m\]: a robot's radius and some room to move.
const WALL_CLEARANCE_M: f32 = 0.3;
/// |y| at which the straight part of the path through the gap begins and ends \[m\], as a robot there is just clear of
/// the wall's corners.
const MOUTH_M: f32 = WALL_HALF_M + ROBOT_RADIUS_M + 0.05;
/// Distance that a robot's hull keeps from both ends of the wall on the path through the gap \[m\].
const LANE_M: f32 = 0.1;
/// Team sizes that the scenario supports; the largest is limited by the lattice of formations and the room in half of
/// the arena.
const ROBOTS: TeamSizes = TeamSizes::new(2, 12);
/// Number of robots in the paper's case study, the default.
const PUBLISHED_ROBOTS: usize = 5;
/// |y| of the two waypoints of the reward, one on each side of the gap \[m\] (as in the paper authors' published
/// environment).
const WAYPOINT_M: f32 = 0.4;
/// Distance from a waypoint or the goal within which a robot goes on to the next stage of the reward \[m\] (as in the
/// paper authors' published environment).
const STAGE_M: f32 = 0.1;
/// The last stage of a robot's progress, which begins one step after that in which it was rewarded for its arrival.
const LAST_STAGE: Stage = Stage(4);

/// Scenario of the case study in the paper arXiv 2111.01777: a team crosses a narrow gap in a wall.
#[derive(Debug)]
pub struct Passage {
    robots: usize,
    /// Half the width of the range of x in which a robot's centre can pass the gap, by `distance_to_go` \[m\].
    lane_half_m: f32,
    arena: Arena,
}

/// Makes the scenario `passage` with a user's `settings`; by default, 5 robots and a gap of 1 m. An error says that the
/// team size or the gap width is not supported.
pub fn build(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let robots = ROBOTS.check("passage", settings.robots.unwrap_or(PUBLISHED_ROBOTS))?;
    let gap_m = settings.gap_m.unwrap_or(GAP_M);
    if !(GAPS_M.0..=GAPS_M.1).contains(&gap_m) {
        return Err(ScenarioError::Gap { scenario: "passage", gap_m, hint: "; it may be 0.6 to 3 m wide" });
    }
    Ok(Arc::new(Passage::new(robots, gap_m)))
}

impl Passage {
    fn new(robots: usize, gap_m: f32) -> Passage {
        let half = gap_m / 2.0;
        let right = KeepOut { min: Vec2::new(half, -WALL_HALF_M), max: Vec2::new(HALF_EXTENT.x, WALL_HALF_M) };
        let left = KeepOut { min: -right.max, max: -right.min };
        let mouth = Vec2::new(0.0, WALL_HALF_M + 2.0 * ROBOT_RADIUS_M);
        let arena = Arena {
            half_extent: HALF_EXTENT,
            keep_outs: vec![right, left],
            portals: vec![Portal { near: -mouth, far: mouth }],
            robot_radius_m: ROBOT_RADIUS_M,
        };
        Passage { robots, lane_half_m: (half - ROBOT_RADIUS_M - LANE_M).max(0.0), arena }
    }

    /// Returns the robots' positions \[m\] that are the goals of episode `index - 1` and the starts of episode `index`.
    /// They are at y < 0 for an even `index`, otherwise at y > 0.
    fn placement(&self, seed: u64, index: u32) -> Vec<Vec2> {
        let mut stream = Seed::of_run(seed).stream(&format!("passage/placement/{index}"));
        let formation = formation(self.robots);
        let side = if index.is_multiple_of(2) { -1.0 } else { 1.0 };
        loop {
            let angle = stream.random_range(-PI..=PI);
            if let Some(positions) = place(&formation, angle, side, &mut stream) {
                return positions;
            }
        }
    }
}

/// Returns a formation of `robots` robots: the lattice points nearest to the origin \[m\]. For five robots it is the
/// cross of the paper authors' published environment, with the robots in the same order.
fn formation(robots: usize) -> Vec<Vec2> {
    let reach = -3..=3i32;
    let mut points: Vec<(i32, i32)> =
        reach.clone().flat_map(|x| reach.clone().map(move |y| (x, y))).filter(|(x, y)| (x + y) % 2 == 0).collect();
    points.sort_by_key(|&(x, y)| (x * x + y * y, x, y));
    points.truncate(robots);
    points.sort();
    points.into_iter().map(|(x, y)| Vec2::new(x as f32, y as f32) * SPACING_M).collect()
}

/// Returns the positions \[m\] of a formation that is rotated by `angle` \[rad\] and moved to a random place on `side`
/// of the wall (the sign of y); `None` if it does not fit there at that angle.
fn place(formation: &[Vec2], angle: f32, side: f32, stream: &mut Stream) -> Option<Vec<Vec2>> {
    let (sin, cos) = libm::sincosf(angle);
    let turned: Vec<Vec2> = formation.iter().map(|p| Vec2::new(cos * p.x - sin * p.y, sin * p.x + cos * p.y)).collect();
    let low = turned.iter().fold(Vec2::zeros(), |low, p| low.inf(p));
    let high = turned.iter().fold(Vec2::zeros(), |high, p| high.sup(p));
    let nearest_y = WALL_HALF_M + WALL_CLEARANCE_M;
    let x = ((-HALF_EXTENT.x - low.x).max(-CENTRE_X_M), (HALF_EXTENT.x - high.x).min(CENTRE_X_M));
    // Computed for the side y > 0 and mirrored for the other.
    let (toward_wall, away) = if side > 0.0 { (-low.y, high.y) } else { (high.y, -low.y) };
    let y = ((nearest_y + toward_wall).max(CENTRE_Y_M.0), (HALF_EXTENT.y - away).min(CENTRE_Y_M.1));
    if x.0 > x.1 || y.0 > y.1 {
        return None;
    }
    let centre = Vec2::new(stream.random_range(x.0..=x.1), side * stream.random_range(y.0..=y.1));
    Some(turned.into_iter().map(|p| p + centre).collect())
}

impl Scenario for Passage {
    fn name(&self) -> &'static str {
        "passage"
    }

    fn robots(&self) -> usize {
        self.robots
    }

    fn arena(&self) -> &Arena {
        &self.arena
    }

    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task> {
        let (starts, goals) = (self.placement(seed, episode), self.placement(seed, episode + 1));
        starts.into_iter().zip(goals).map(|(start, goal)| Task { start, goal }).collect()
    }

    fn frame(&self, task: &Task) -> Frame {
        if task.start.y > 0.0 { Frame::HalfTurn } else { Frame::World }
    }

    /// Returns the reward of the paper authors' published environment: the speed toward the next waypoint or the goal
    /// \[m/s\], minus 1.5 for a contact with a robot and 0.25 for one with a wall, plus 10 on arrival.
    fn reward(&self, task: &Task, after: &Motion, contacts: Contacts, stage: &mut Stage) -> Option<f32> {
        let seen = self.observe(task, after);
        let target = match stage.0 {
            0 => Vec2::new(0.0, -WAYPOINT_M),
            1 => Vec2::new(0.0, WAYPOINT_M),
            _ => seen.goal,
        };
        let offset = target - seen.motion.position;
        let distance = offset.norm();
        *stage = match stage.0 {
            3 => LAST_STAGE,
            0..=2 if distance < STAGE_M => Stage(stage.0 + 1),
            _ => *stage,
        };
        let mut reward = 0.0;
        if contacts.robot {
            reward -= 1.5;
        }
        if contacts.wall {
            reward -= 0.25;
        }
        if seen.motion.velocity != Vec2::zeros() && distance > 0.0 {
            reward += (offset / distance).dot(&seen.motion.velocity);
        }
        if stage.0 == 3 {
            reward += 10.0;
        }
        Some(reward)
    }

    /// Returns the length of the path to the gap, straight through it, and on to the goal \[m\]. It decreases
    /// continuously along the path, wherever within `lane_half_m` of the gap's middle a robot passes.
    fn distance_to_go(&self, task: &Task, position: Vec2) -> f32 {
        let frame = self.frame(task);
        let (at, goal) = (frame.turn(position), frame.turn(task.goal));
        let lane = at.x.clamp(-self.lane_half_m, self.lane_half_m);
        let far = Vec2::new(lane, MOUTH_M);
        let behind = (goal - far).norm();
        if at.y < -MOUTH_M {
            (Vec2::new(lane, -MOUTH_M) - at).norm() + 2.0 * MOUTH_M + behind
        } else if at.y < MOUTH_M {
            (far - at).norm() + behind
        } else {
            (goal - at).norm()
        }
    }

    fn rules(&self) -> Rules {
        // 500 steps of 0.05 s; two radii of the published robots' hull (0.16 m) are a collision.
        Rules { arrival_m: 0.25, separation_m: 0.32, limit: Span::from_millis(25_000) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn five_robots_form_the_published_cross() {
        let cross = [(-1.0, -1.0), (-1.0, 1.0), (0.0, 0.0), (1.0, -1.0), (1.0, 1.0)];
        let expected: Vec<Vec2> = cross.iter().map(|&(x, y)| Vec2::new(x, y) * SPACING_M).collect();
        assert_eq!(formation(5), expected);
    }

    #[test]
    fn the_path_length_decreases_through_the_gap_without_jumps() {
        let passage = Passage::new(5, GAP_M);
        let task = Task { start: Vec2::new(1.0, 1.7), goal: Vec2::new(-1.0, -1.7) };
        let mut last = passage.distance_to_go(&task, task.start);
        assert!(last > (task.goal - task.start).norm());
        // From y > 0: to the lane, through it, and on to the goal, 5 cm a step.
        let path = [task.start, Vec2::new(0.1, MOUTH_M), Vec2::new(0.1, -MOUTH_M), task.goal];
        for leg in path.windows(2) {
            let steps = ((leg[1] - leg[0]).norm() / 0.05).ceil();
            for step in 1..=steps as usize {
                let left = passage.distance_to_go(&task, leg[0] + (leg[1] - leg[0]) * (step as f32 / steps));
                assert!(left < last && last - left < 0.06, "{last} m, then {left} m");
                last = left;
            }
        }
        assert!(last < 1e-6);
    }

    #[test]
    fn the_stages_lead_through_the_gap() {
        let passage = Passage::new(5, GAP_M);
        let task = Task { start: Vec2::new(0.3, 1.7), goal: Vec2::new(-0.3, -1.7) };
        let mut stage = Stage(0);
        // For a start at y > 0 everything is mirrored: the first waypoint is at y = +0.4.
        let at = |y| Motion { position: Vec2::new(0.0, y), velocity: Vec2::new(0.0, -1.0) };
        let reward = passage.reward(&task, &at(0.9), Contacts::default(), &mut stage).unwrap();
        assert!((reward - 1.0).abs() < 1e-6, "moving straight to the waypoint is rewarded by its speed, not {reward}");
        passage.reward(&task, &at(0.45), Contacts::default(), &mut stage).unwrap();
        assert_eq!(stage, Stage(1));
    }
}
