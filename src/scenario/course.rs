//! Course of a robot in an episode: the waypoints that it passes in order before its goal, and how many of them it has
//! passed.

use super::Scenario;
use crate::messages::geometry::{Task, Vec2};

/// Share of `Rules::arrival_m` within which a robot, which knows its own place by measurements, turns to the next
/// waypoint. The judge, which knows the true places, counts a waypoint from the whole distance on, so that both agree.
pub const TURNING: f32 = 0.5;

/// Waypoints of a robot in an episode \[m\], world frame, and the number of those that it has passed. Without waypoints
/// the robot goes straight to its goal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    waypoints: Vec<Vec2>,
    passed: usize,
}

impl Course {
    /// Returns the course through these waypoints \[m\], world frame, of which none has been passed.
    pub fn new(waypoints: Vec<Vec2>) -> Course {
        Course { waypoints, passed: 0 }
    }

    /// Returns all waypoints \[m\], world frame, in their order.
    pub fn waypoints(&self) -> &[Vec2] {
        &self.waypoints
    }

    /// Returns the number of waypoints that the robot has passed.
    pub fn passed(&self) -> usize {
        self.passed
    }

    /// Returns the course of which the first `passed` waypoints have been passed.
    pub fn after(self, passed: usize) -> Course {
        Course { passed: passed.min(self.waypoints.len()), ..self }
    }

    /// Returns whether the robot has passed all waypoints.
    pub fn is_through(&self) -> bool {
        self.passed == self.waypoints.len()
    }

    /// Passes the next waypoint if `point` \[m\] is within `within_m` of it. Returns whether it has.
    pub fn pass(&mut self, point: Vec2, within_m: f32) -> bool {
        let passes = self.waypoints.get(self.passed).is_some_and(|next| (next - point).norm() <= within_m);
        self.passed += usize::from(passes);
        passes
    }

    /// Returns the task of the present leg: `task` with the next waypoint as its goal, or `task` itself once all have
    /// been passed.
    pub fn leg(&self, task: &Task) -> Task {
        Task { goal: self.waypoints.get(self.passed).copied().unwrap_or(task.goal), ..*task }
    }

    /// Returns the length \[m\] of the path of a robot with start and goal `task` from the next waypoint through all
    /// others to its goal; zero once all have been passed.
    pub fn beyond_m(&self, scenario: &dyn Scenario, task: &Task) -> f32 {
        let ends = self.waypoints.iter().copied().chain([task.goal]).skip(self.passed + 1);
        let legs = self.waypoints.iter().skip(self.passed).zip(ends);
        legs.map(|(from, goal)| scenario.distance_to_go(&Task { goal, ..*task }, *from)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Settings, build};

    #[test]
    fn a_course_goes_through_its_waypoints_in_order_and_then_to_the_goal() {
        let swap = build("swap", &Settings::of(4)).expect("it is there");
        let at = |x: f32, y: f32| Vec2::new(x, y);
        let task = Task { start: at(0.0, 0.0), goal: at(0.0, 2.0) };
        let mut course = Course::new(vec![at(1.0, 0.0), at(1.0, 2.0)]);
        assert_eq!((course.leg(&task).goal, course.beyond_m(&*swap, &task)), (at(1.0, 0.0), 3.0));
        assert!(!course.pass(at(1.0, 2.0), 0.1), "the second is not next");
        assert!(course.pass(at(0.95, 0.0), 0.1) && !course.is_through());
        assert_eq!((course.leg(&task).goal, course.beyond_m(&*swap, &task)), (at(1.0, 2.0), 1.0));
        assert!(course.pass(at(1.0, 2.0), 0.1) && course.is_through() && !course.pass(at(1.0, 2.0), 0.1));
        assert_eq!((course.leg(&task), course.beyond_m(&*swap, &task)), (task, 0.0));
        assert_eq!((Course::default().leg(&task), Course::default().is_through()), (task, true));
    }
}
