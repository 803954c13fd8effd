//! The judge of an episode, which turns the states of the robots, step by step, into one verdict.
//!
//! An episode succeeds if every robot arrives in time, no two robots come nearer than the rules allow, and no robot
//! touches a wall. Where goals are unlabelled, robots arrive all at once: when every goal has a robot. Distances
//! between robots are those of their centres. A robot has arrived once the point that its policy commands has been at
//! the goal; where there are waypoints, once it has been at each of them before, in their order. Judging ends with the
//! last arrival or at the time limit; later states do not count. The code does no I/O, and the Recorder (an actor) and
//! the trainer both use it.
//!
//! In a scenario without goals no robot arrives: judging ends at the time limit, and the result is the mean cost of all
//! steps, with collisions.
//!
//! The states are the true ones of the whole team at each step, or measured ones of those robots that were seen in the
//! step (module `sightings`).

use serde::{Deserialize, Serialize};

use super::Rules;
use super::cost::{Cost, MeanCost};
use super::course::Course;
use super::goals::{self, Goals};
use crate::cells::{self, Cells};
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::ids::RobotId;
use crate::messages::local::Contacts;
use crate::time::Span;

/// Outcome of an episode. An episode with several failures has the outcome of the first one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Every robot arrived in time without a collision.
    Success,
    /// The episode of a scenario without goals lasted its time without a collision. Its result is its cost.
    Completed,
    /// Two robots came nearer to each other than the rules allow.
    RobotCollision,
    /// A robot touched a wall.
    WallCollision,
    /// Not every robot arrived within the time limit.
    Timeout,
    /// The state server, which leads the episodes, aborted the episode.
    Aborted,
    /// A robot was not measured for more than one second, so that its motion is unknown. This outcome exists only where
    /// measured states are judged, not true ones.
    Unseen,
}

impl Verdict {
    /// Returns the word for the verdict in reports, JSON and CSV, such as `robot-collision`.
    pub fn word(self) -> &'static str {
        match self {
            Verdict::Success => "success",
            Verdict::Completed => "completed",
            Verdict::RobotCollision => "robot-collision",
            Verdict::WallCollision => "wall-collision",
            Verdict::Timeout => "timeout",
            Verdict::Aborted => "aborted",
            Verdict::Unseen => "unseen",
        }
    }

    /// Returns whether the episode failed: it is neither a success nor completed.
    pub fn is_failure(self) -> bool {
        !matches!(self, Verdict::Success | Verdict::Completed)
    }
}

/// State of one robot in one step, as input to the judge of an episode.
#[derive(Clone, Copy, Debug)]
pub struct JudgedRobot {
    /// Position of the centre of the robot's hull \[m\], world frame.
    pub position: Vec2,
    /// Position of the point that the robot's policy commands \[m\], world frame: the centre, unless its drive is
    /// differential.
    pub point: Vec2,
    /// Velocity of the robot \[m/s\], world frame: that of the centre if true states are judged, that of the point if
    /// readings are.
    pub velocity: Vec2,
    /// Contacts of the robot with walls and other robots in this step.
    pub contacts: Contacts,
}

/// Result of judging an episode: outcome, duration and smallest distance between robots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judgement {
    /// Outcome of the episode: success, or the first failure.
    pub verdict: Verdict,
    /// Time from the start of the episode to the end of judging, which for a success is the last arrival.
    pub after: Span,
    /// Smallest distance between the centres of two robots during the episode \[m\]; infinite for a single robot.
    pub min_separation_m: f32,
    /// Mean cost of the steps until then, in the unit of the scenario's cost; `None` in a scenario with goals, and
    /// before the first step.
    pub cost: Option<f64>,
}

/// Judge of one episode, which processes the robots' states step by step and then returns the outcome.
#[derive(Clone, Debug)]
pub struct Judge {
    rules: Rules,
    goals: Vec<Vec2>,
    labels: Goals,
    /// Last point of each robot \[m\], where goals are unlabelled; not a number before the first.
    points: Vec<Vec2>,
    /// Waypoints of each robot, where goals are labelled.
    courses: Vec<Course>,
    arrived: Vec<bool>,
    failure: Option<Verdict>,
    min_separation_m: f32,
    /// Cost of the episode so far; `None` in a scenario with goals.
    cost: Option<MeanCost>,
}

impl Judge {
    /// Makes the judge of an episode with criteria `rules` and the robots' `goals` \[m\], world frame, in the order of
    /// robot ids.
    pub fn new(rules: Rules, goals: Vec<Vec2>) -> Judge {
        let (arrived, points) = (vec![false; goals.len()], vec![Vec2::repeat(f32::NAN); goals.len()]);
        let (labels, min_separation_m) = (Goals::Labelled, f32::INFINITY);
        let courses = vec![Course::default(); goals.len()];
        Judge { rules, goals, labels, points, courses, arrived, failure: None, min_separation_m, cost: None }
    }

    /// Returns the judge for goals that belong to whom `labels` says.
    pub fn with_goals(self, labels: Goals) -> Judge {
        Judge { labels, ..self }
    }

    /// Returns the judge for robots that have these courses before their goals, in the order of robot ids.
    ///
    /// # Panics
    /// If there is not one course per goal.
    pub fn with_courses(self, courses: Vec<Course>) -> Judge {
        assert_eq!(courses.len(), self.goals.len(), "each robot has its course");
        Judge { courses, ..self }
    }

    /// Returns the judge with this cost: with one the goals do not count, and the episode ends by time. `None` changes
    /// nothing.
    pub fn with_cost(self, cost: Option<Cost>) -> Judge {
        Judge { cost: cost.map(MeanCost::new), ..self }
    }

    /// Processes the states of all robots at one step, in the order of robot ids. `after` is the time since the start
    /// of the episode. Returns the finding once judging has ended, by the last arrival or the time limit; `None`
    /// before.
    ///
    /// # Panics
    /// If `robots` does not have one state per goal.
    pub fn update(&mut self, after: Span, robots: &[JudgedRobot]) -> Option<Judgement> {
        assert_eq!(robots.len(), self.goals.len(), "the judge gets the states of the whole team");
        self.process(after, robots, |at| at)
    }

    /// Processes the states of some robots at one step, each with its id; robots that are left out stay as they were.
    /// `after` is the time since the start of the episode. Returns the finding once judging has ended, by the last
    /// arrival or the time limit; `None` before.
    pub(crate) fn update_some(&mut self, after: Span, robots: &[(RobotId, JudgedRobot)]) -> Option<Judgement> {
        let states: Vec<JudgedRobot> = robots.iter().map(|(_, state)| *state).collect();
        self.process(after, &states, |at| robots[at].0.index())
    }

    /// Returns whether each robot has arrived, in the order of robot ids; where goals are unlabelled, whether every
    /// goal has a robot.
    pub(crate) fn arrived(&self) -> &[bool] {
        &self.arrived
    }

    /// Marks the episode as failed with `verdict`, for a reason that the robots' states do not show. It has no effect
    /// if the episode has already failed.
    pub(crate) fn fail(&mut self, verdict: Verdict) {
        self.failure.get_or_insert(verdict);
    }

    /// Processes the states of some or all robots at one step, the time `after` since the start of the episode.
    /// `index` maps a position in `robots` to the robot's index in the team. Returns the finding once judging has
    /// ended; `None` before.
    fn process(&mut self, after: Span, robots: &[JudgedRobot], index: impl Fn(usize) -> usize) -> Option<Judgement> {
        self.min_separation_m = self.min_separation_m.min(separation(robots, self.min_separation_m));
        if self.failure.is_none() {
            if robots.iter().any(|robot| robot.contacts.wall) {
                self.failure = Some(Verdict::WallCollision);
            } else if self.min_separation_m < self.rules.separation_m {
                self.failure = Some(Verdict::RobotCollision);
            }
        }
        if let Some(cost) = &mut self.cost {
            let motion = |robot: &JudgedRobot| Motion { position: robot.position, velocity: robot.velocity };
            cost.add(&robots.iter().map(motion).collect::<Vec<_>>(), &self.goals);
            return (after >= self.rules.limit).then(|| self.end(after, Verdict::Completed));
        }
        for (at, robot) in robots.iter().enumerate() {
            let at = index(at);
            match self.labels {
                Goals::Labelled => {
                    let arrival_m = self.rules.arrival_m;
                    self.courses[at].pass(robot.point, arrival_m);
                    let is_through = self.courses[at].is_through();
                    self.arrived[at] |= is_through && (self.goals[at] - robot.point).norm() <= arrival_m;
                }
                Goals::Unlabelled => self.points[at] = robot.point,
            }
        }
        if self.labels.are_unlabelled() {
            let (goals, points) = (self.goals.iter().copied(), self.points.iter().copied());
            let held = goals::held(goals, points, self.rules.arrival_m);
            self.arrived.fill(!held.contains(&false));
        }
        let all_arrived = self.arrived.iter().all(|&arrived| arrived);
        if !all_arrived && after < self.rules.limit {
            return None;
        }
        let without_failure = if all_arrived { Verdict::Success } else { Verdict::Timeout };
        Some(self.end(after, without_failure))
    }

    /// Returns the finding for an episode that ends now, at the time `after` since its start. The outcome is the first
    /// failure, or `without_failure` if there was none.
    pub(crate) fn end(&self, after: Span, without_failure: Verdict) -> Judgement {
        let verdict = self.failure.unwrap_or(without_failure);
        let cost = self.cost.and_then(|cost| cost.mean());
        Judgement { verdict, after, min_separation_m: self.min_separation_m, cost }
    }
}

/// Returns the smallest distance between the centres of two of the robots \[m\]. In a large team, only pairs closer
/// than about `bound_m` are compared; the result is infinite if there are none.
fn separation(robots: &[JudgedRobot], bound_m: f32) -> f32 {
    let mut smallest = f32::INFINITY;
    let mut between = |one: usize, other: usize| {
        smallest = smallest.min((robots[one].position - robots[other].position).norm_squared());
    };
    let all = || robots.iter().map(|robot| robot.position);
    match Cells::new(bound_m, all()).filter(|_| robots.len() > cells::LINEAR_SEARCH_MAX) {
        None => (0..robots.len()).for_each(|one| (one + 1..robots.len()).for_each(|other| between(one, other))),
        Some(grid) => {
            let mut near = Vec::new();
            for (one, at) in all().enumerate() {
                grid.near(at, &mut near);
                near.iter().filter(|&&other| other > one).for_each(|&other| between(one, other));
            }
        }
    }
    smallest.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: Rules = Rules { arrival_m: 0.25, separation_m: 0.32, limit: Span::from_millis(1000) };

    fn seen(x: f32) -> JudgedRobot {
        let position = Vec2::new(x, 0.0);
        JudgedRobot { position, point: position, velocity: Vec2::zeros(), contacts: Contacts::default() }
    }

    fn judge() -> Judge {
        Judge::new(RULES, vec![Vec2::new(0.0, 0.0), Vec2::new(5.0, 0.0)])
    }

    #[test]
    fn a_robot_arrives_after_its_waypoints_alone() {
        let at = |x| Vec2::new(x, 0.0);
        let courses = vec![Course::new(vec![at(2.0), at(1.0)]), Course::default()];
        let mut judge = judge().with_courses(courses);
        let states = [0.0, 1.0, 2.0, 0.1, 1.1, 0.1].map(|x| [seen(x), seen(5.0)]);
        for (step, state) in states.iter().enumerate() {
            let judged = judge.update(Span::from_millis(50 * step as u64), state);
            assert_eq!(judge.arrived(), [step == 5, true], "after step {step}");
            assert_eq!(judged.map(|judged| judged.verdict), (step == 5).then_some(Verdict::Success));
        }
    }

    #[test]
    fn words_of_verdicts_are_those_of_json() {
        let all = [
            Verdict::Success,
            Verdict::RobotCollision,
            Verdict::WallCollision,
            Verdict::Timeout,
            Verdict::Aborted,
            Verdict::Unseen,
        ];
        for verdict in all {
            assert_eq!(serde_json::to_value(verdict).expect("a verdict is JSON"), verdict.word());
        }
    }

    #[test]
    fn an_arrival_latches_and_the_last_one_ends_a_success() {
        let mut judge = judge();
        assert_eq!(judge.update(Span::from_millis(50), &[seen(0.2), seen(4.0)]), None);
        let finding = judge.update(Span::from_millis(100), &[seen(1.0), seen(4.8)]).unwrap();
        assert_eq!((finding.verdict, finding.after), (Verdict::Success, Span::from_millis(100)));
    }

    #[test]
    fn unlabelled_goals_are_reached_by_any_robots_at_one_instant() {
        let mut judge = judge().with_goals(Goals::Unlabelled);
        assert_eq!(judge.update(Span::from_millis(50), &[seen(4.8), seen(4.0)]), None);
        assert_eq!(judge.update(Span::from_millis(100), &[seen(4.0), seen(0.0)]), None, "one has left its goal");
        assert_eq!(judge.update(Span::from_millis(150), &[seen(0.2), seen(-0.2)]), None, "both are at one goal");
        let finding = judge.update(Span::from_millis(200), &[seen(5.2), seen(0.2)]).expect("each goal has a robot");
        assert_eq!((finding.verdict, finding.after), (Verdict::Success, Span::from_millis(200)));
    }

    #[test]
    fn a_robot_arrives_with_its_point_and_collides_with_its_hull() {
        let mut judge = judge();
        let ahead = |x: f32, ahead_m: f32| JudgedRobot { point: Vec2::new(x + ahead_m, 0.0), ..seen(x) };
        let finding = judge.update(Span::from_millis(50), &[ahead(-0.3, 0.1), ahead(4.7, 0.1)]).unwrap();
        assert_eq!(finding.verdict, Verdict::Success);
        let mut judge = self::judge();
        assert_eq!(judge.update(Span::from_millis(50), &[ahead(1.0, -0.2), ahead(1.3, 0.2)]), None);
        let finding = judge.update(Span::from_millis(100), &[seen(0.0), seen(5.0)]).unwrap();
        assert_eq!(finding.verdict, Verdict::RobotCollision, "their points were 0.7 m apart");
    }

    #[test]
    fn the_first_failure_counts_and_judging_goes_on_to_the_last_arrival() {
        let mut judge = judge();
        let blocked = JudgedRobot { contacts: Contacts { wall: true, robot: false }, ..seen(1.0) };
        assert_eq!(judge.update(Span::from_millis(50), &[blocked, seen(4.0)]), None);
        assert_eq!(judge.update(Span::from_millis(100), &[seen(1.0), seen(1.1)]), None);
        let finding = judge.update(Span::from_millis(150), &[seen(0.0), seen(5.0)]).unwrap();
        assert_eq!(finding.verdict, Verdict::WallCollision);
        assert!((finding.min_separation_m - 0.1).abs() < 1e-6);
    }

    #[test]
    fn the_smallest_separation_of_a_large_team_equals_that_of_all_pairs() {
        use rand::RngExt;
        let mut stream = crate::random::Seed::of_run(3).stream("judge");
        let mut judge = Judge::new(RULES, vec![Vec2::repeat(99.0); 100]);
        let mut smallest = f32::INFINITY;
        for step in 0..20 {
            let mut point = || Vec2::new(stream.random_range(0.0..20.0), stream.random_range(0.0..20.0));
            let robot = |at| JudgedRobot { position: at, ..seen(0.0) };
            let robots: Vec<JudgedRobot> = (0..100).map(|_| robot(point())).collect();
            for (index, robot) in robots.iter().enumerate() {
                for other in &robots[..index] {
                    smallest = smallest.min((robot.position - other.position).norm());
                }
            }
            judge.update(Span::from_millis(step), &robots);
            assert_eq!(judge.min_separation_m, smallest);
        }
    }

    #[test]
    fn robots_too_near_are_a_collision_and_a_late_robot_is_a_timeout() {
        let mut near = judge();
        let finding = near.update(Span::from_millis(1000), &[seen(1.0), seen(1.3)]).unwrap();
        assert_eq!(finding.verdict, Verdict::RobotCollision);
        let finding = judge().update(Span::from_millis(1000), &[seen(1.0), seen(4.0)]).unwrap();
        assert_eq!(finding.verdict, Verdict::Timeout);
    }
}
