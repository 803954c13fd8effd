//! Goals that belong to no robot: which of them have a robot, and how they are shared out at the least cost.
//!
//! Robots that may choose their goals are the concurrent assignment and planning of trajectories of Turpin, Michael and
//! Kumar, "CAPT: Concurrent assignment and planning of trajectories for multiple robots", International Journal of
//! Robotics Research 33 (1), 2014.

use pathfinding::prelude::{Matrix, kuhn_munkres_min};
use serde::Deserialize;

use crate::messages::geometry::{Task, Vec2};
use crate::observation::{Channel, Known, Quantity, Unit};

/// Name of the channel that has the goals of the team, in a scenario whose goals are unlabelled.
pub const CHANNEL: &str = "goals";

/// Name of the channel that has the goals nearest to the robot.
pub const NEAREST: &str = "near-goals";
/// Number of goals of the channel [`NEAREST`] that lists of channels show, whatever the size of the team.
pub const NEAREST_GOALS: usize = 4;
/// Largest number of goals that a policy may take of it.
const MOST_NEAREST: usize = 64;

/// Robots to which the goals of a scenario belong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Goals {
    /// Each robot has to arrive at the goal of its own task.
    #[default]
    Labelled,
    /// Any robot may go to any goal of the team. An episode succeeds once every goal has a robot.
    Unlabelled,
}

impl Goals {
    /// Returns whether the goals belong to no robot.
    pub fn are_unlabelled(self) -> bool {
        self == Goals::Unlabelled
    }
}

/// Returns the index of the goal at which a robot at `point` is: the nearest, if it is within `arrival_m`. All are
/// \[m\], in one frame.
pub fn goal_at(goals: impl Iterator<Item = Vec2>, point: Vec2, arrival_m: f32) -> Option<usize> {
    let distances = goals.map(|goal| (goal - point).norm()).enumerate();
    let nearest = distances.min_by(|(_, one), (_, other)| one.total_cmp(other));
    nearest.filter(|(_, distance_m)| *distance_m <= arrival_m).map(|(goal, _)| goal)
}

/// Returns for each of the goals whether a robot is there. The robots are at `points`, as `goal_at` says.
pub fn held(
    goals: impl ExactSizeIterator<Item = Vec2> + Clone,
    points: impl IntoIterator<Item = Vec2>,
    arrival_m: f32,
) -> Vec<bool> {
    let mut held = vec![false; goals.len()];
    let at = points.into_iter().filter_map(|point| goal_at(goals.clone(), point, arrival_m));
    at.for_each(|goal| held[goal] = true);
    held
}

/// Returns for each robot the index of a goal of its own, so that the sum of `costs` is the least (Kuhn, "The Hungarian
/// method for the assignment problem", Naval Research Logistics Quarterly 2, 1955). `costs` returns that of a robot at
/// a goal, in whole units; there are at least as many goals as robots.
pub fn assigned([robots, goals]: [usize; 2], costs: impl Fn(usize, usize) -> i64) -> Vec<usize> {
    let all = (0..robots * goals).map(|at| costs(at / goals, at % goals)).collect();
    let costs = Matrix::from_vec(robots, goals, all).expect("there is a cost for each robot and goal");
    kuhn_munkres_min(&costs).1
}

/// Returns the square of a length \[mm²\], as a cost of an assignment: so that a sum over a team has room.
pub fn squared_mm(length_m: f32) -> i64 {
    (f64::from(length_m) * f64::from(length_m) * 1e6).min(1e15) as i64
}

/// Writes for each robot the length \[m\] of its path to its goal in the assignment with the least sum of squares.
/// `length_m` returns that of a robot to a goal; there are as many goals as robots.
pub fn shared_out(lengths_m: &mut [f32], length_m: impl Fn(usize, usize) -> f32) {
    let robots = lengths_m.len();
    let all: Vec<f32> = (0..robots * robots).map(|at| length_m(at / robots, at % robots)).collect();
    let chosen = assigned([robots; 2], |robot, goal| squared_mm(all[robot * robots + goal]));
    for (robot, (length_m, goal)) in lengths_m.iter_mut().zip(chosen).enumerate() {
        *length_m = all[robot * robots + goal];
    }
}

/// Returns the channel [`CHANNEL`] of a team of `robots` robots: from the robot to each goal \[m\], \[R, 2\]. The goals
/// are in the order of their x, then y, in the world frame, which says nothing of the robots. They are unknown while
/// one of them is.
pub fn channel(robots: usize) -> Channel {
    let form = (vec![robots, 2], Unit::Metre, Quantity::Vector);
    Channel::new(CHANNEL, "from the robot to each goal of the team, in an order of their places", form, write)
}

/// Returns the channel [`NEAREST`]: from the robot to the goals that are nearest to it \[m\], \[n, 2\] with as many as
/// the policy takes, [`NEAREST_GOALS`] for instance, the nearest first. In a smaller team the farthest goal is there
/// several times. They are unknown while a goal of the team is.
pub fn nearest() -> Channel {
    let form = (vec![NEAREST_GOALS, 2], Unit::Metre, Quantity::Vector);
    Channel::new(
        NEAREST,
        "from the robot to the goals of the team that are nearest to it, the nearest first",
        form,
        near,
    )
    .up_to(MOST_NEAREST)
}

fn near(known: &Known, values: &mut [f32]) {
    let Some(mut ways) = ways(known) else { return values.fill(f32::NAN) };
    ways.sort_by(|one, other| one.norm_squared().total_cmp(&other.norm_squared()));
    for (index, pair) in values.chunks_exact_mut(2).enumerate() {
        pair.copy_from_slice(ways[index.min(ways.len() - 1)].as_slice());
    }
}

fn write(known: &Known, values: &mut [f32]) {
    let Some(ways) = ways(known) else { return values.fill(f32::NAN) };
    for (pair, way) in values.chunks_exact_mut(2).zip(ways) {
        pair.copy_from_slice(way.as_slice());
    }
}

/// Returns the ways from the robot to the goals of its team \[m\], policy frame, in the order of their places; `None`
/// while a goal is unknown.
fn ways(known: &Known) -> Option<Vec<Vec2>> {
    let way = |goal| known.own.frame.turn(goal) - known.own.motion.position;
    Some(in_order(known.team)?.into_iter().map(way).collect())
}

/// Returns the goals of a team \[m\], world frame, in the order of their x, then y; `None` while one is unknown.
fn in_order(team: &[Option<Task>]) -> Option<Vec<Vec2>> {
    let mut goals: Vec<Vec2> = team.iter().map(|task| task.map(|task| task.goal)).collect::<Option<_>>()?;
    goals.sort_by(|one, other| one.x.total_cmp(&other.x).then(one.y.total_cmp(&other.y)));
    Some(goals)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::observation::{Bound, Observation};

    #[test]
    fn a_robot_is_at_the_nearest_goal_and_two_robots_at_one_goal_hold_one() {
        let goals = [Vec2::new(0.0, 0.0), Vec2::new(0.4, 0.0)];
        let at = |x: f32| goal_at(goals.into_iter(), Vec2::new(x, 0.0), 0.25);
        assert_eq!((at(0.1), at(0.21), at(-0.3)), (Some(0), Some(1), None));
        let held = |points: [f32; 2]| held(goals.into_iter(), points.map(|x| Vec2::new(x, 0.0)), 0.25);
        assert_eq!((held([0.1, -0.1]), held([0.1, 0.3])), (vec![true, false], vec![true, true]));
    }

    #[test]
    fn goals_are_shared_out_at_the_least_cost_also_if_there_are_more_of_them() {
        let (robots, goals) = ([0.0f32, 1.0], [1.1f32, 9.0, 0.9]);
        let cost = |robot: usize, goal: usize| squared_mm(goals[goal] - robots[robot]);
        assert_eq!(assigned([2, 3], cost), [2, 0]);
        assert_eq!(assigned([2, 2], cost)[0], 0, "a long way costs more than two short ones");
    }

    #[test]
    fn the_channel_does_not_tell_whose_a_goal_is() {
        let task = |x: f32, y: f32| Some(Task { start: Vec2::zeros(), goal: Vec2::new(x, y) });
        let own = Observation::new(Motion::at_rest(Vec2::new(1.0, 0.0)), Vec2::zeros());
        let seen = |team: &[Option<Task>]| {
            let mut values = [0.0; 6];
            write(&Known { task: &task(0.0, 0.0).expect("a task"), team, own: &own, sensed: &[] }, &mut values);
            values
        };
        let goals = [task(3.0, 1.0), task(2.0, 5.0), task(2.0, -5.0)];
        assert_eq!(seen(&goals), [1.0, -5.0, 1.0, 5.0, 2.0, 1.0]);
        assert_eq!(seen(&[goals[2], goals[0], goals[1]]), seen(&goals));
        assert!(seen(&[goals[0], None, goals[1]]).iter().all(|value| value.is_nan()));
    }

    #[test]
    fn the_nearest_goal_is_the_first_of_its_channel() {
        let goals = [[3.0, 1.0], [2.0, 5.0], [0.0, -1.0]].map(Vec2::from);
        let team = goals.map(|goal| Some(Task { start: Vec2::zeros(), goal }));
        let nearest = nearest();
        let bound = Bound::new(&[nearest.request()], &[nearest]).expect("the channel is there");
        let seen = |team: &[Option<Task>]| {
            let own = Observation::new(Motion::at_rest(Vec2::new(1.0, 0.0)), Vec2::zeros());
            let (task, mut values) = (Task { start: Vec2::zeros(), goal: goals[0] }, [0.0; 8]);
            bound.write(&mut [], &Known { task: &task, team, own: &own, sensed: &[] }, &mut values);
            values
        };
        assert_eq!(seen(&team), [-1.0, -1.0, 2.0, 1.0, 1.0, 5.0, 1.0, 5.0]);
        assert!(seen(&[team[0], None, team[1]]).iter().all(|value| value.is_nan()));
    }
}
