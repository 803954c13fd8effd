//! Reward of a robot for a step: the scenario's own reward, and the terms that the configuration adds.

use super::config::Reward;
use murmurate::messages::geometry::{Motion, Task, Vec2};
use murmurate::messages::local::Contacts;
use murmurate::scenario::{Arena, Progress, Scenario};
use murmurate::world::kinematic::PERIOD;

/// Distance of a robot from its goal within which the goal's own distance from a wall matters \[m\].
const NEAR_GOAL_M: f32 = 0.5;
/// Number of points along each axis of the ground at which its distance from the nearest robot is taken.
const GROUND_POINTS: u8 = 16;

/// States of the robots of a team before and after a step, as inputs of their rewards. Slices have one entry per robot.
#[derive(Debug)]
pub struct TeamStep<'a> {
    /// Start and goal of each robot \[m\], world frame.
    pub tasks: &'a [Task],
    /// Position of each robot's centre after the step \[m\], world frame.
    pub position: &'a [Vec2],
    /// Position of each robot's commanded point after the step \[m\], world frame.
    pub points: &'a [Vec2],
    /// Velocity of each robot's commanded point after the step \[m/s\], world frame.
    pub velocity: &'a [Vec2],
    /// Contacts of each robot with walls and other robots in the step.
    pub contacts: &'a [Contacts],
    /// The scenario's own reward of each robot for the step, before weighting.
    pub scenario_reward: &'a [f32],
    /// Whether each robot is at its goal after the step.
    pub reached: &'a [bool],
    /// Length of each robot's remaining path after the step \[m\], if the reward uses it.
    pub left_m: &'a [f32],
    /// Length of each robot's remaining path before the step \[m\]. It is replaced by the length after the step if the
    /// reward uses it.
    pub to_go_m: &'a mut [f32],
    /// Whether each robot had arrived before the step. It is set for robots that arrive in the step.
    pub arrived: &'a mut [bool],
    /// Output: reward of each robot for the step.
    pub reward: &'a mut [f32],
    /// Scratch space.
    pub near: &'a mut [f32],
}

/// Whether the scenario has a reward of its own: whether its method `reward` returns one.
pub fn has_reward(scenario: &dyn Scenario) -> bool {
    let tasks = scenario.tasks(0, 0);
    let reward = |task: &Task| {
        scenario.reward(task, &Motion::at_rest(task.start), Contacts::default(), &mut Progress::default())
    };
    tasks.first().and_then(reward).is_some()
}

impl TeamStep<'_> {
    /// Writes the reward of each robot in the arena of its episode, with these `weights`. Returns their mean.
    pub fn score(mut self, weights: &Reward, arena: &Arena) -> f32 {
        let robots = self.reward.len();
        self.cut(robots);
        let means = TeamMeans::of(weights, self.points, self.velocity);
        if weights.proximity > 0.0 {
            nearness(weights.proximity_m, self.position, self.near);
        }
        let mut sum = 0.0;
        for robot in 0..robots {
            let mut reward = self.own(weights, arena, robot);
            if weights.proximity > 0.0 {
                reward -= weights.scale * weights.proximity * self.near[robot] * PERIOD.as_secs() as f32;
            }
            if let Some(means) = &means {
                let motion = Motion { position: self.points[robot], velocity: self.velocity[robot] };
                reward -= means.penalty(weights, &motion);
            }
            self.reward[robot] = reward;
            sum += reward;
        }
        let waiting = team_penalty(weights, self.arrived) + coverage_penalty(weights, arena, self.points);
        let mean = sum / robots as f32;
        for reward in self.reward {
            *reward += weights.shared * (mean - *reward) - waiting;
        }
        mean - waiting
    }

    /// Cuts all lists to one length, so that what follows looks nowhere for the end of one of them.
    #[inline(always)]
    fn cut(&mut self, robots: usize) {
        (self.tasks, self.position) = (&self.tasks[..robots], &self.position[..robots]);
        (self.points, self.velocity) = (&self.points[..robots], &self.velocity[..robots]);
        (self.contacts, self.reached) = (&self.contacts[..robots], &self.reached[..robots]);
        (self.scenario_reward, self.left_m) = (&self.scenario_reward[..robots], &self.left_m[..robots]);
    }

    /// Returns the reward of a robot without the terms that depend on other robots' positions or rewards, and notes its
    /// arrival and the length of its path.
    #[inline(always)]
    fn own(&mut self, weights: &Reward, arena: &Arena, robot: usize) -> f32 {
        let mut reward = 0.0;
        if weights.scenario > 0.0 {
            reward += weights.scenario * self.scenario_reward[robot];
        }
        if weights.progress > 0.0 {
            reward += weights.progress * (self.to_go_m[robot] - self.left_m[robot]);
            self.to_go_m[robot] = self.left_m[robot];
        }
        if !self.arrived[robot] {
            if self.reached[robot] {
                self.arrived[robot] = true;
                reward += weights.arrival;
            } else {
                reward -= weights.time * PERIOD.as_secs() as f32;
            }
        }
        if self.contacts[robot].wall {
            reward -= weights.wall;
        }
        if self.contacts[robot].robot {
            reward -= weights.robot;
        }
        if weights.wall_proximity > 0.0 && !arena.keep_outs.is_empty() {
            let position = self.position[robot];
            let near_m = wall_proximity_m(weights, arena, self.tasks[robot].goal, position);
            let near = 1.0 - arena.clearance(position) / near_m;
            reward -= weights.wall_proximity * near.max(0.0) * PERIOD.as_secs() as f32;
        }
        reward * weights.scale
    }
}

/// Returns the distance from a wall at which a robot at `position` with the goal `goal` begins to pay for its nearness
/// \[m\].
fn wall_proximity_m(weights: &Reward, arena: &Arena, goal: Vec2, position: Vec2) -> f32 {
    if weights.goals_near_walls && (goal - position).norm_squared() < NEAR_GOAL_M * NEAR_GOAL_M {
        return weights.wall_proximity_m.min(arena.clearance(goal)).max(f32::EPSILON);
    }
    weights.wall_proximity_m
}

/// Writes for each robot how near the other robots of its team are: the sum over those within `within_m` \[m\] of 1 at
/// distance zero to 0 at that distance. `positions` are those of the centres of the team's robots \[m\].
fn nearness(within_m: f32, positions: &[Vec2], near: &mut [f32]) {
    near.fill(0.0);
    // Pairs in this order add to each robot in the order of the others' ids.
    for (robot, position) in positions.iter().enumerate() {
        for (other, other_position) in positions.iter().enumerate().skip(robot + 1) {
            let distance_squared = (other_position - position).norm_squared();
            if distance_squared < within_m * within_m {
                let nearness = 1.0 - distance_squared.sqrt() / within_m;
                near[robot] += nearness;
                near[other] += nearness;
            }
        }
    }
}

/// Mean position \[m\] and velocity \[m/s\] of a team.
#[derive(Clone, Copy, Debug)]
pub struct TeamMeans {
    /// Mean of the robots' positions \[m\], world frame.
    pub position: Vec2,
    /// Mean of the robots' velocities \[m/s\], world frame.
    pub velocity: Vec2,
}

impl TeamMeans {
    /// Returns the means of a team, summed in the order of the robots' ids; `None` if no term with these weights
    /// depends on the robots' motion.
    pub fn of(weights: &Reward, positions: &[Vec2], velocities: &[Vec2]) -> Option<TeamMeans> {
        if [weights.energy, weights.cohesion, weights.matching] == [0.0; 3] {
            return None;
        }
        let mean = |all: &[Vec2]| all.iter().fold(Vec2::zeros(), |sum, one| sum + *one) * (1.0 / all.len() as f32);
        Some(TeamMeans { position: mean(positions), velocity: mean(velocities) })
    }

    /// Returns the penalty, zero or more, of a robot with this motion in a step: for its speed, for its distance from
    /// the middle of the team, and for the difference of its velocity from the team's.
    pub fn penalty(&self, weights: &Reward, own: &Motion) -> f32 {
        let energy = weights.energy * own.velocity.norm_squared();
        let cohesion = weights.cohesion * (own.position - self.position).norm();
        let matching = weights.matching * (own.velocity - self.velocity).norm_squared();
        weights.scale * (energy + cohesion + matching) * PERIOD.as_secs() as f32
    }
}

/// Returns the penalty, zero or more, of every robot of a team in a step for the ground that is far from all of them:
/// the cost of coverage of Cortés et al., IEEE Transactions on Robotics and Automation 20(2), 2004, with a uniform
/// density, at points of a grid that are in no block of `arena`. `positions` are those of the robots \[m\].
pub fn coverage_penalty(weights: &Reward, arena: &Arena, positions: &[Vec2]) -> f32 {
    if weights.coverage == 0.0 {
        return 0.0;
    }
    let middle = |at: u8| (2.0 * f32::from(at) + 1.0) / f32::from(GROUND_POINTS) - 1.0;
    let (mut sum, mut count) = (0.0, 0.0);
    for (x, y) in (0..GROUND_POINTS).flat_map(|x| (0..GROUND_POINTS).map(move |y| (x, y))) {
        let point = arena.half_extent.component_mul(&Vec2::new(middle(x), middle(y)));
        if arena.keep_outs.iter().all(|block| block.distance(point) > 0.0) {
            let squares = positions.iter().map(|position| (position - point).norm_squared());
            sum += squares.fold(f32::INFINITY, f32::min);
            count += 1.0;
        }
    }
    weights.scale * weights.coverage * (sum / f32::max(count, 1.0)) * PERIOD.as_secs() as f32
}

/// Returns the penalty, zero or more, of every robot of a team in a step; `arrived` says which robots have arrived at
/// their goals.
pub fn team_penalty(weights: &Reward, arrived: &[bool]) -> f32 {
    if arrived.iter().all(|&arrived| arrived) {
        return 0.0;
    }
    weights.scale * weights.team_time * PERIOD.as_secs() as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use murmurate::scenario::KeepOut;

    #[test]
    fn a_goal_near_a_wall_costs_nothing_if_the_configuration_says_so() {
        let passage = murmurate::scenario::build("passage", &Default::default()).expect("the default is sound");
        let reward = Config::preset("robust").expect("it is a preset").reward;
        let from = |goals_near_walls, goal, position| {
            let weights = Reward { wall_proximity_m: 0.4, goals_near_walls, ..reward };
            wall_proximity_m(&weights, passage.arena(), goal, position)
        };
        // The face of the wall is at y = 0.15.
        let (near, far) = (Vec2::new(1.0, 0.45), Vec2::new(1.0, 2.0));
        assert!((from(true, near, Vec2::new(1.2, 0.4)) - 0.3).abs() < 1e-5);
        assert_eq!(from(true, near, Vec2::new(0.4, 0.4)), 0.4, "a robot that has not come near its goal");
        assert_eq!(from(true, far, far), 0.4);
        assert_eq!(from(false, near, near), 0.4);
    }

    #[test]
    fn motion_costs_by_speed_by_distance_from_the_middle_and_by_difference_from_the_mean() {
        let reward = Config::preset("robust").expect("it is a preset").reward;
        let (positions, velocities) = ([Vec2::zeros(), Vec2::new(4.0, 0.0)], [Vec2::zeros(), Vec2::new(0.0, 2.0)]);
        let own = Motion { position: positions[1], velocity: velocities[1] };
        let cost = |weights: Reward| {
            TeamMeans::of(&weights, &positions, &velocities).map_or(0.0, |means| means.penalty(&weights, &own))
        };
        let step_s = PERIOD.as_secs() as f32;
        assert_eq!(cost(Reward { scale: 1.0, ..reward }), 0.0);
        assert_eq!(cost(Reward { scale: 1.0, energy: 3.0, ..reward }), 3.0 * 4.0 * step_s);
        assert_eq!(cost(Reward { scale: 1.0, cohesion: 3.0, ..reward }), 3.0 * 2.0 * step_s);
        assert_eq!(cost(Reward { scale: 0.5, matching: 3.0, ..reward }), 0.5 * 3.0 * step_s);
    }

    #[test]
    fn uncovered_ground_costs_the_mean_squared_distance_from_the_nearest_robot() {
        let reward = Config::preset("robust").expect("it is a preset").reward;
        let cost = |coverage, arena: &Arena, positions: &[Vec2]| {
            coverage_penalty(&Reward { scale: 1.0, coverage, ..reward }, arena, positions) / PERIOD.as_secs() as f32
        };
        let square = Arena::new(Vec2::new(3.0, 3.0), Vec::new(), 0.1);
        // The mean of x² + y² over a square from -3 to 3 is 2 · 3² / 3.
        assert!((cost(2.0, &square, &[Vec2::zeros()]) - 12.0).abs() < 0.05);
        let halves = [Vec2::new(-1.5, 0.0), Vec2::new(1.5, 0.0)];
        assert!((cost(1.0, &square, &halves) - (0.75 + 3.0)).abs() < 0.03, "each covers its half");
        assert_eq!(cost(0.0, &square, &halves), 0.0);
        let block = KeepOut::rect(Vec2::new(0.0, -3.0), Vec2::new(3.0, 3.0));
        let half = Arena::new(Vec2::new(3.0, 3.0), vec![block], 0.1);
        assert!((cost(1.0, &half, &halves[..1]) - (0.75 + 3.0)).abs() < 0.03, "a block need not be covered");
    }

    #[test]
    fn robots_are_near_to_each_other_by_what_distances_lack() {
        let positions = [Vec2::zeros(), Vec2::new(0.25, 0.0), Vec2::new(5.0, 0.0), Vec2::new(0.0, 0.125)];
        let mut near = [f32::NAN; 4];
        nearness(0.5, &positions, &mut near);
        let apart = 1.0 - (positions[3] - positions[1]).norm() / 0.5;
        assert_eq!(near, [0.5 + 0.75, 0.5 + apart, 0.0, 0.75 + apart]);
    }

    #[test]
    fn a_team_pays_until_its_last_robot_has_arrived() {
        let reward = Config::preset("robust").expect("it is a preset").reward;
        let weights = Reward { scale: 0.1, team_time: 2.0, ..reward };
        let per_step = 0.1 * 2.0 * PERIOD.as_secs() as f32;
        assert_eq!(team_penalty(&weights, &[true, false, true]), per_step);
        assert_eq!(team_penalty(&weights, &[true, true, true]), 0.0);
        assert_eq!(team_penalty(&reward, &[false]), 0.0);
    }
}
