//! Scenario `passage`, the case study of the paper (section V): a team crosses a 1 m gap in a wall.
//!
//! The x axis runs across the arena, the y axis through the gap. The wall lies on the x axis, and the gap is centred at
//! the origin. The team starts on alternate sides of the wall from episode to episode; in the policy frame, the start
//! is always at negative y and the goal at positive y.
//!
//! Lengths are those at scale 1 and, of robots, with the hull of the paper's.

use std::f32::consts::PI;
use std::sync::Arc;

use rand::RngExt;

use super::{Arena, KeepOut, Portal, Progress, Rules, Scenario, ScenarioError, Settings, Size, TeamSizes, size};
use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::local::Contacts;
use crate::observation::{Channel, Observation, PolicyFrame, Quantity, Unit};
use crate::random::{Seed, Stream};
use crate::time::Span;

/// Half the size of the arena along x and y \[m\]; the whole arena is 4 m by 6 m (paper, section V).
const HALF_EXTENT: Vec2 = Vec2::new(2.0, 3.0);
/// Default width of the gap in the wall \[m\].
const GAP_M: f32 = 1.0;
/// Largest width of the gap in the wall that a user may set \[m\]. The smallest is what a robot needs, 0.6 m.
const WIDEST_GAP_M: f32 = 3.0;
/// Half the thickness of the wall \[m\].
const WALL_HALF_M: f32 = 0.15;
/// Spacing of the square lattice on which the robots of a formation stand \[m\]. They stand on points (column, row) of
/// the lattice with an even sum of column and row.
const SPACING_M: f32 = 0.6;
/// Largest |x| of the centre of the formation in which a team starts or ends \[m\].
const CENTRE_X_M: f32 = 1.0;
/// Smallest and largest |y| of the centre of the formation in which a team starts or ends \[m\].
const CENTRE_Y_M: (f32, f32) = (1.5, 2.0);
/// Room to move \[m\] of a robot between its start or goal and the wall, and at both ends of the straight part of the
/// path through the gap, where it is just clear of the wall's corners.
const ROOM_M: f32 = 0.05;
/// Distance that a robot's hull keeps from both ends of the wall on the path through the gap \[m\]; half of that in the
/// narrowest.
const LANE_M: f32 = 0.1;
/// Distance from its goal within which a robot has arrived \[m\].
const ARRIVAL_M: f32 = 0.25;
/// Time within which every robot must arrive at scale 1 and below: 500 steps of 0.05 s.
const LIMIT_S: f32 = 25.0;
/// Number of angles at which a formation is tried in the arena of an unusual size.
const ANGLES: usize = 72;
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
const LAST_STAGE: Progress = Progress(4);

/// Scenario of the case study in the paper: a team crosses a narrow gap in a wall.
#[derive(Debug)]
pub struct Passage {
    robots: usize,
    size: Size,
    /// |y| at which the straight part of the path through the gap begins and ends \[m\].
    mouth_m: f32,
    /// Half the width of the range of x in which a robot's centre can pass the gap, by `distance_to_go` \[m\].
    lane_half_m: f32,
    arena: Arena,
}

/// Makes the scenario `passage` with a user's `settings`; by default, 5 robots and a gap of 1 m. An error says that the
/// team size, the gap width, the scale or the hull is not supported.
pub fn build(settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
    let robots = ROBOTS.check("passage", settings.robots.unwrap_or(PUBLISHED_ROBOTS))?;
    let size = Size::of("passage", settings)?;
    let gap_m = settings.gap_m.unwrap_or(size.length(GAP_M));
    // Robots of a formation are on every second point of the lattice.
    let ground = format!("a gap of {gap_m} m and places");
    size.check_places(("passage", &ground), settings, SPACING_M * std::f32::consts::SQRT_2)?;
    let gaps_m = (2.0 * size.robot_radius_m() + size.length(LANE_M), size.length(WIDEST_GAP_M));
    if !(gaps_m.0..=gaps_m.1).contains(&gap_m) {
        let (least, most) = (size::up(gaps_m.0), size::down(gaps_m.1));
        let why = format!(
            "has no gap of {gap_m} m; it may be {least} to {most} m wide with a hull of {} m at scale {}",
            size.hull_m, size.scale
        );
        return Err(ScenarioError::Size { scenario: "passage".to_owned(), field: "gap_m", why });
    }
    let passage = Passage::new(robots, gap_m, size);
    if !passage.has_room() {
        let field = if settings.hull_m.is_some() { "hull_m" } else { "scale" };
        let why = format!(
            "has no room beside its wall at scale {} for {robots} robots with a hull of {} m: take a smaller hull \
             (hull_m), a larger scale or fewer robots",
            size.scale, size.hull_m
        );
        return Err(ScenarioError::Size { scenario: "passage".to_owned(), field, why });
    }
    Ok(Arc::new(passage))
}

impl Passage {
    fn new(robots: usize, gap_m: f32, size: Size) -> Passage {
        let (half, wall_half, radius) = (gap_m / 2.0, size.length(WALL_HALF_M), size.robot_radius_m());
        let half_extent = HALF_EXTENT * size.scale;
        let right = KeepOut::rect(Vec2::new(half, -wall_half), Vec2::new(half_extent.x, wall_half));
        let left = KeepOut::rect(-right.max, -right.min);
        let mouth = Vec2::new(0.0, wall_half + 2.0 * radius);
        let portals = vec![Portal { near: -mouth, far: mouth }];
        let arena = Arena { portals, ..Arena::new(half_extent, vec![right, left], radius) };
        let lane_half_m = (half - radius - size.length(LANE_M)).max(0.0);
        Passage { robots, size, mouth_m: wall_half + radius + size.length(ROOM_M), lane_half_m, arena }
    }

    /// Returns the robots' positions \[m\] that are the goals of episode `index - 1` and the starts of episode `index`.
    /// They are at y < 0 for an even `index`, otherwise at y > 0.
    fn placement(&self, seed: u64, index: u32) -> Vec<Vec2> {
        let mut stream = Seed::of_run(seed).stream(&format!("passage/placement/{index}"));
        let formation = formation(self.robots, self.size.length(SPACING_M));
        let side = if index.is_multiple_of(2) { -1.0 } else { 1.0 };
        loop {
            let angle = stream.random_range(-PI..=PI);
            if let Some(positions) = self.place(&formation, angle, side, &mut stream) {
                return positions;
            }
        }
    }

    /// Returns whether a formation fits in the arena on both sides of the wall.
    fn has_room(&self) -> bool {
        let formation = formation(self.robots, self.size.length(SPACING_M));
        let fits = |side| {
            (0..ANGLES).any(|k| self.room(&turned(&formation, k as f32 * 2.0 * PI / ANGLES as f32), side).is_some())
        };
        fits(1.0) && fits(-1.0)
    }

    /// Returns the range of x and that of |y| in which the centre of a turned formation may be on `side` of the wall
    /// (the sign of y) \[m\]; `None` if it does not fit there.
    fn room(&self, turned: &[Vec2], side: f32) -> Option<[(f32, f32); 2]> {
        let low = turned.iter().fold(Vec2::zeros(), |low, p| low.inf(p));
        let high = turned.iter().fold(Vec2::zeros(), |high, p| high.sup(p));
        let (half, size) = (self.arena.half_extent, self.size);
        let nearest_y = size.length(WALL_HALF_M) + (size.robot_radius_m() + size.length(ROOM_M));
        let centre_x = size.length(CENTRE_X_M);
        let x = ((-half.x - low.x).max(-centre_x), (half.x - high.x).min(centre_x));
        // Computed for the side y > 0 and mirrored for the other.
        let (toward_wall, away) = if side > 0.0 { (-low.y, high.y) } else { (high.y, -low.y) };
        let centre_y = [CENTRE_Y_M.0, CENTRE_Y_M.1].map(|y| size.length(y));
        let y = ((nearest_y + toward_wall).max(centre_y[0]), (half.y - away).min(centre_y[1]));
        (x.0 <= x.1 && y.0 <= y.1).then_some([x, y])
    }

    /// Returns the positions \[m\] of a formation that is rotated by `angle` \[rad\] and moved to a random place on
    /// `side` of the wall (the sign of y); `None` if it does not fit there at that angle.
    fn place(&self, formation: &[Vec2], angle: f32, side: f32, stream: &mut Stream) -> Option<Vec<Vec2>> {
        let turned = turned(formation, angle);
        let [x, y] = self.room(&turned, side)?;
        let centre = Vec2::new(stream.random_range(x.0..=x.1), side * stream.random_range(y.0..=y.1));
        Some(turned.into_iter().map(|p| p + centre).collect())
    }
}

/// Returns a formation of `robots` robots: the points nearest to the origin of a lattice with spacing `spacing_m`
/// \[m\]. For five robots it is the cross of the paper authors' published environment, with the robots in the same
/// order.
fn formation(robots: usize, spacing_m: f32) -> Vec<Vec2> {
    let reach = -3..=3i32;
    let mut points: Vec<(i32, i32)> =
        reach.clone().flat_map(|x| reach.clone().map(move |y| (x, y))).filter(|(x, y)| (x + y) % 2 == 0).collect();
    points.sort_by_key(|&(x, y)| (x * x + y * y, x, y));
    points.truncate(robots);
    points.sort();
    points.into_iter().map(|(x, y)| Vec2::new(x as f32, y as f32) * spacing_m).collect()
}

/// Returns the points of a formation \[m\], rotated by `angle` \[rad\] about the origin.
fn turned(formation: &[Vec2], angle: f32) -> Vec<Vec2> {
    let (sin, cos) = libm::sincosf(angle);
    formation.iter().map(|p| Vec2::new(cos * p.x - sin * p.y, sin * p.x + cos * p.y)).collect()
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

    fn channels(&self) -> Vec<Channel> {
        let shape = (vec![2, 2], Unit::Metre, Quantity::Vector);
        let [left, right] = [self.arena.keep_outs[1].max.x, self.arena.keep_outs[0].min.x];
        let gap =
            Channel::new("gap", "from the robot to both ends of the wall at the gap", shape, move |known, out| {
                let position = known.own.motion.position;
                for (end, values) in [left, right].into_iter().zip(out.chunks_exact_mut(2)) {
                    values.copy_from_slice((Vec2::new(end, 0.0) - position).as_slice());
                }
            });
        vec![gap]
    }

    fn frame(&self, task: &Task) -> PolicyFrame {
        if task.start.y > 0.0 { PolicyFrame::HalfTurn } else { PolicyFrame::World }
    }

    /// Returns the reward of the paper authors' published environment: the speed toward the next waypoint or the goal
    /// \[m/s\], minus 1.5 for a contact with a robot and 0.25 for one with a wall, plus 10 on arrival.
    fn reward(&self, task: &Task, after: &Motion, contacts: Contacts, stage: &mut Progress) -> Option<f32> {
        let seen = Observation::in_frame(self.frame(task), task.goal, after);
        let target = match stage.0 {
            0 => Vec2::new(0.0, -self.size.length(WAYPOINT_M)),
            1 => Vec2::new(0.0, self.size.length(WAYPOINT_M)),
            _ => seen.goal,
        };
        let offset = target - seen.motion.position;
        let distance = offset.norm();
        *stage = match stage.0 {
            3 => LAST_STAGE,
            0..=2 if distance < self.size.length(STAGE_M) => Progress(stage.0 + 1),
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
        let mouth = self.mouth_m;
        let far = Vec2::new(lane, mouth);
        let behind = (goal - far).norm();
        if at.y < -mouth {
            (Vec2::new(lane, -mouth) - at).norm() + 2.0 * mouth + behind
        } else if at.y < mouth {
            (far - at).norm() + behind
        } else {
            (goal - at).norm()
        }
    }

    fn rules(&self) -> Rules {
        Rules {
            arrival_m: self.size.length(ARRIVAL_M),
            separation_m: self.size.separation_m(),
            // Speeds do not grow with the scale.
            limit: Span::from_secs(f64::from(LIMIT_S * self.size.scale.max(1.0))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn published() -> Passage {
        Passage::new(5, GAP_M, Size { scale: 1.0, hull_m: size::HULL_M })
    }

    #[test]
    fn five_robots_form_the_published_cross() {
        let cross = [(-1.0, -1.0), (-1.0, 1.0), (0.0, 0.0), (1.0, -1.0), (1.0, 1.0)];
        let expected: Vec<Vec2> = cross.iter().map(|&(x, y)| Vec2::new(x, y) * SPACING_M).collect();
        assert_eq!(formation(5, SPACING_M), expected);
    }

    #[test]
    fn the_path_length_decreases_through_the_gap_without_jumps() {
        let passage = published();
        let task = Task { start: Vec2::new(1.0, 1.7), goal: Vec2::new(-1.0, -1.7) };
        let mut last = passage.distance_to_go(&task, task.start);
        assert!(last > (task.goal - task.start).norm());
        // From y > 0: to the lane, through it, and on to the goal, 5 cm a step.
        let mouth = passage.mouth_m;
        assert_eq!((mouth, passage.lane_half_m), (0.15 + 0.25 + 0.05, 0.15));
        let path = [task.start, Vec2::new(0.1, mouth), Vec2::new(0.1, -mouth), task.goal];
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
        let passage = published();
        let task = Task { start: Vec2::new(0.3, 1.7), goal: Vec2::new(-0.3, -1.7) };
        let mut stage = Progress(0);
        // For a start at y > 0 everything is mirrored: the first waypoint is at y = +0.4.
        let at = |y| Motion { position: Vec2::new(0.0, y), velocity: Vec2::new(0.0, -1.0) };
        let reward = passage.reward(&task, &at(0.9), Contacts::default(), &mut stage).unwrap();
        assert!((reward - 1.0).abs() < 1e-6, "moving straight to the waypoint is rewarded by its speed, not {reward}");
        passage.reward(&task, &at(0.45), Contacts::default(), &mut stage).unwrap();
        assert_eq!(stage, Progress(1));
    }
}
