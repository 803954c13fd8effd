//! Legs of the robots of training environments: from waypoint to waypoint, and to their goals.

use murmurate::messages::geometry::{Task, Vec2};
use murmurate::observation::PolicyFrame;
use murmurate::scenario::Scenario;
use murmurate::scenario::course::TURNING;
use murmurate::scenario::judge::Judge;

use super::environments::Environments;

impl Environments {
    /// Begins the courses of a team, whose robots have these `tasks`, in the episode with this seed and number. Of each
    /// robot, the waypoints were passed after the steps in `passed`, which may be empty.
    pub(super) fn set_out(&mut self, team: usize, tasks: &[Task], (seed, episode): (u64, u32), passed: &[Vec<u32>]) {
        let scenario = self.scenario_of(team);
        let mut waypoints = scenario.waypoints(seed, episode).into_iter();
        for (robot, task) in self.teams[team].range().zip(tasks) {
            let course = (waypoints.next().unwrap_or_default(), passed.get(robot).cloned().unwrap_or_default());
            let leg = self.courses.begin((robot, task), course, &*scenario);
            self.set_leg(robot, leg, &*scenario);
        }
    }

    fn set_leg(&mut self, robot: usize, leg: Task, scenario: &dyn Scenario) {
        (self.tasks[robot], self.frame[robot]) = (leg, scenario.frame(&leg));
    }

    /// Lets the robots of a team turn to their next waypoints where they have come to one in the last step.
    pub(super) fn turn(&mut self, team: usize) {
        if !self.courses.has_legs() {
            return;
        }
        let (scenario, step) = (self.scenario_of(team), self.teams[team].step);
        let within_m = TURNING * scenario.rules().arrival_m;
        for robot in self.teams[team].range() {
            let at = (self.point(robot).position, within_m);
            if let Some(leg) = self.courses.pass((robot, step), at, &*scenario) {
                self.set_leg(robot, leg, &*scenario);
            }
        }
    }

    /// Returns the policy frame that a robot had in `step` of its episode, and the goal \[m\], world frame, for which
    /// it was bound.
    pub(super) fn bound_in(&self, team: usize, robot: usize, step: u32) -> (PolicyFrame, Vec2) {
        if !self.courses.has_legs() {
            return (self.frame[robot], self.tasks[robot].goal);
        }
        let leg = self.courses.leg_in(robot, step);
        (self.scenario(team).frame(&leg), leg.goal)
    }

    /// Whether all robots of the team with index `team` have arrived.
    pub fn all_arrived(&self, team: usize) -> bool {
        self.arrived[self.teams[team].range()].iter().all(|&arrived| arrived)
    }

    /// Returns the judge of the present episode of a team, of whose steps it has seen none.
    pub fn judge(&self, team: usize) -> Judge {
        let scenario = self.scenario(team);
        let (goals, courses) = self.teams[team].range().map(|robot| self.courses.whole(robot)).unzip();
        let judge = Judge::new(scenario.rules(), goals).with_courses(courses);
        judge.with_cost(scenario.cost()).with_goals(scenario.goals())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::EpisodeConditions;
    use crate::config::Config;
    use murmurate::messages::geometry::Vec2;
    use murmurate::random::Seed;
    use murmurate::scenario::judge::JudgedRobot;
    use murmurate::scenario::{Settings, TaskFile};
    use murmurate::time::Span;

    #[test]
    fn robots_of_a_training_go_from_leg_to_leg_and_a_snapshot_has_their_courses() {
        let text = include_str!("../../../examples/tasks/errands.toml");
        let scenario = TaskFile::read(text).expect("it is sound").scenario(&Settings::of(2)).expect("it is sound");
        let mut all = Environments::new(1, &[vec![2]], std::slice::from_ref(&scenario));
        let mut stream = Seed::of_run(1).stream("courses");
        all.place(0, (5, 0), EpisodeConditions::perfect(2), &mut stream);
        let reward = Config::preset("any-size").expect("it is there").reward;
        let whole = scenario.tasks(5, 0)[0];
        let course = &scenario.waypoints(5, 0)[0];
        let mut judge = all.judge(0);
        assert_eq!(all.tasks[0].goal, course[0]);
        let legs = course[1] - course[0];
        assert!(
            all.to_go_m[0] >= (course[0] - whole.start).norm() + legs.norm() + (whole.goal - course[1]).norm() - 1e-3
        );
        let mut step = |all: &mut Environments, at: Vec2| {
            (all.position[0], all.velocity[0]) = (at, Vec2::zeros());
            all.step(0, &[Vec2::zeros(); 2], &reward, 1.0, &mut stream);
        };
        step(&mut all, whole.goal);
        assert!(!all.arrived[0], "it has passed no waypoint");
        step(&mut all, course[0]);
        assert_eq!((all.tasks[0].goal, all.courses.passed()[0].len()), (course[1], 1));
        assert_eq!((all.courses.leg_in(0, 1).goal, all.courses.leg_in(0, 2).goal), (course[0], course[1]));
        let mut again = Environments::new(1, &[vec![2]], &[scenario]);
        assert!(again.restore(all.snapshot()));
        assert_eq!((again.tasks[0], again.lengths_to_go_m(0)), (all.tasks[0], all.lengths_to_go_m(0)));
        for place in [course[1], whole.goal] {
            step(&mut all, place);
        }
        assert!(all.arrived[0] && all.to_go_m[0] < 0.3, "{}", all.to_go_m[0]);
        let seen =
            |at: Vec2| JudgedRobot { position: at, point: at, velocity: Vec2::zeros(), contacts: Default::default() };
        let others = all.courses.whole(1).1.waypoints().to_vec();
        for (after, (one, other)) in course.iter().zip(&others).enumerate() {
            assert!(judge.update(Span::from_millis(50 * after as u64), &[seen(*one), seen(*other)]).is_none());
        }
    }
}
