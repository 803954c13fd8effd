//! Courses of the robots of training environments through the waypoints of their episodes.

use std::ops::Range;

use murmurate::messages::geometry::{Task, Vec2};
use murmurate::scenario::Scenario;
use murmurate::scenario::course::Course;

/// Courses of all robots. The lists have one entry per robot, by its index among all robots.
#[derive(Clone, Debug)]
pub(super) struct Courses {
    /// Start and goal of each robot in its episode \[m\], world frame.
    whole: Vec<Task>,
    courses: Vec<Course>,
    /// Step of the episode after which each robot has passed each of its waypoints.
    passed: Vec<Vec<u32>>,
    /// Length of the path from the next waypoint of each robot to its goal \[m\].
    beyond_m: Vec<f32>,
    /// Whether a robot has waypoints: the others are on the only legs of their courses.
    has_legs: bool,
}

impl Courses {
    /// Returns the courses of `robots` robots, whose episodes have not begun.
    pub fn new(robots: usize) -> Courses {
        let whole = vec![Task { start: Vec2::zeros(), goal: Vec2::zeros() }; robots];
        let (courses, passed) = (vec![Course::default(); robots], vec![Vec::new(); robots]);
        Courses { whole, courses, passed, beyond_m: vec![0.0; robots], has_legs: false }
    }

    /// Begins the course of a robot with start and goal `task` through these waypoints \[m\], world frame, which were
    /// passed after the steps in `passed`, as far as they were. Returns the task of its present leg.
    pub fn begin(
        &mut self,
        (robot, task): (usize, &Task),
        (waypoints, passed): (Vec<Vec2>, Vec<u32>),
        scenario: &dyn Scenario,
    ) -> Task {
        self.whole[robot] = *task;
        self.has_legs |= !waypoints.is_empty();
        self.courses[robot] = Course::new(waypoints).after(passed.len());
        self.passed[robot] = passed;
        self.leg(robot, scenario)
    }

    /// Returns whether a robot has, or had in an earlier episode, waypoints to pass.
    pub fn has_legs(&self) -> bool {
        self.has_legs
    }

    /// Returns the task of the leg that begins where a robot at `point` \[m\] passes its next waypoint, within
    /// `within_m` \[m\] of it, in `step` of its episode; `None` if it passes none.
    pub fn pass(
        &mut self,
        (robot, step): (usize, u32),
        (point, within_m): (Vec2, f32),
        scenario: &dyn Scenario,
    ) -> Option<Task> {
        self.courses[robot].pass(point, within_m).then(|| {
            self.passed[robot].push(step);
            self.leg(robot, scenario)
        })
    }

    /// Returns the goal of a robot \[m\], world frame, and its course, of which it has passed nothing.
    pub fn whole(&self, robot: usize) -> (Vec2, Course) {
        (self.whole[robot].goal, self.courses[robot].clone().after(0))
    }

    fn leg(&mut self, robot: usize, scenario: &dyn Scenario) -> Task {
        let (course, whole) = (&self.courses[robot], &self.whole[robot]);
        self.beyond_m[robot] = course.beyond_m(scenario, whole);
        course.leg(whole)
    }

    /// Returns the steps after which each robot has passed its waypoints; empty if no robot has passed any.
    pub fn passed(&self) -> Vec<Vec<u32>> {
        if self.passed.iter().all(Vec::is_empty) { Vec::new() } else { self.passed.clone() }
    }

    /// Leaves of the robots that have `reached` the ends of their legs those that have passed all waypoints.
    pub fn keep_through(&self, range: Range<usize>, reached: &mut [bool]) {
        if self.has_legs {
            self.courses[range].iter().zip(reached).for_each(|(course, reached)| *reached &= course.is_through());
        }
    }

    /// Adds the lengths of the remaining paths beyond the present legs to those of the legs, `to_go_m` \[m\].
    pub fn add_beyond(&self, range: Range<usize>, to_go_m: &mut [f32]) {
        if self.has_legs {
            self.beyond_m[range].iter().zip(to_go_m).for_each(|(beyond_m, to_go_m)| *to_go_m += beyond_m);
        }
    }

    /// Returns the task of the leg on which a robot was in `step` of its episode.
    pub fn leg_in(&self, robot: usize, step: u32) -> Task {
        let passed = self.passed[robot].iter().filter(|passed| **passed <= step).count();
        if passed == self.passed[robot].len() {
            return self.courses[robot].leg(&self.whole[robot]);
        }
        self.courses[robot].clone().after(passed).leg(&self.whole[robot])
    }
}
