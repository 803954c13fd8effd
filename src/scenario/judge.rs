//! The judge of an episode: from the states of the robots, step by step, to one verdict.
//!
//! An episode succeeds when every robot has arrived in time, no pair was ever nearer than the rules allow,
//! and no move was ever blocked by a wall. Judging ends with the last arrival or at the limit; what happens
//! afterwards is not the episode's. Pure, and the same for the Recorder and for training.
//!
//! States are true ones, of the whole team at each step, or measured ones, of the robots that were seen in it
//! (`sightings`).

use serde::{Deserialize, Serialize};

use super::Rules;
use crate::cells::{self, Cells};
use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::messages::local::Contacts;
use crate::time::Span;

/// How an episode ended. A failed one counts under what happened first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Every robot arrived in time and nothing was touched.
    Success,
    /// Two robots came too near to each other.
    RobotCollision,
    /// A move was blocked by a wall.
    WallCollision,
    /// Not every robot arrived in time.
    Timeout,
    /// The state server gave the episode up.
    Aborted,
    /// A robot was out of sight for too long: what it did then, nobody knows. Only where readings are judged.
    Unseen,
}

/// One robot as the judge sees it.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Position \[m\], world frame.
    pub position: Vec2,
    /// What it touched in this step.
    pub contacts: Contacts,
}

/// What the judge found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finding {
    /// How the episode ended.
    pub verdict: Verdict,
    /// When judging ended, since the start of the episode: for a success, when the last robot arrived.
    pub after: Span,
    /// The smallest distance between two robots \[m\].
    pub min_separation_m: f32,
}

/// Judges one episode.
#[derive(Clone, Debug)]
pub struct Judge {
    rules: Rules,
    goals: Vec<Vec2>,
    arrived: Vec<bool>,
    failure: Option<Verdict>,
    min_separation_m: f32,
}

impl Judge {
    /// A judge of an episode with these goals \[m\], one a robot.
    pub fn new(rules: Rules, goals: Vec<Vec2>) -> Judge {
        Judge { rules, arrived: vec![false; goals.len()], goals, failure: None, min_separation_m: f32::INFINITY }
    }

    /// Sees all robots, by id, `after` the start of the episode; the finding once there is one.
    pub fn see(&mut self, after: Span, robots: &[Seen]) -> Option<Finding> {
        assert_eq!(robots.len(), self.goals.len(), "the judge sees the whole team");
        self.consider(after, robots, |at| at)
    }

    /// Sees the robots that there is something to see of, each with its id; of the others nothing changes.
    pub fn see_some(&mut self, after: Span, robots: &[(RobotId, Seen)]) -> Option<Finding> {
        let seen: Vec<Seen> = robots.iter().map(|(_, seen)| *seen).collect();
        self.consider(after, &seen, |at| robots[at].0.index())
    }

    /// The episode has failed in a way that the judge cannot see, if it has not failed before.
    pub fn fail(&mut self, verdict: Verdict) {
        self.failure.get_or_insert(verdict);
    }

    /// Sees robots, each of which has its index in the team.
    fn consider(&mut self, after: Span, robots: &[Seen], index: impl Fn(usize) -> usize) -> Option<Finding> {
        self.min_separation_m = self.min_separation_m.min(separation(robots, self.min_separation_m));
        if self.failure.is_none() {
            if robots.iter().any(|robot| robot.contacts.wall) {
                self.failure = Some(Verdict::WallCollision);
            } else if self.min_separation_m < self.rules.separation_m {
                self.failure = Some(Verdict::RobotCollision);
            }
        }
        for (at, robot) in robots.iter().enumerate() {
            let at = index(at);
            self.arrived[at] |= (self.goals[at] - robot.position).norm() <= self.rules.arrival_m;
        }
        let all_arrived = self.arrived.iter().all(|&arrived| arrived);
        if !all_arrived && after < self.rules.limit {
            return None;
        }
        let otherwise = if all_arrived { Verdict::Success } else { Verdict::Timeout };
        Some(self.end(after, otherwise))
    }

    /// The finding when the episode ends now, for a reason that the judge cannot see.
    pub fn end(&self, after: Span, otherwise: Verdict) -> Finding {
        Finding { verdict: self.failure.unwrap_or(otherwise), after, min_separation_m: self.min_separation_m }
    }
}

/// The smallest distance between two robots \[m\]; of a large team, if it is smaller than `bound_m`.
fn separation(robots: &[Seen], bound_m: f32) -> f32 {
    let mut least = f32::INFINITY;
    let mut between = |one: usize, other: usize| {
        least = least.min((robots[one].position - robots[other].position).norm_squared());
    };
    let all = || robots.iter().map(|robot| robot.position);
    match Cells::new(bound_m, all()).filter(|_| robots.len() > cells::FEW) {
        None => (0..robots.len()).for_each(|one| (one + 1..robots.len()).for_each(|other| between(one, other))),
        Some(grid) => {
            let mut near = Vec::new();
            for (one, at) in all().enumerate() {
                grid.near(at, &mut near);
                near.iter().filter(|&&other| other > one).for_each(|&other| between(one, other));
            }
        }
    }
    least.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: Rules = Rules { arrival_m: 0.25, separation_m: 0.32, limit: Span::from_millis(1000) };

    fn seen(x: f32) -> Seen {
        Seen { position: Vec2::new(x, 0.0), contacts: Contacts::default() }
    }

    fn judge() -> Judge {
        Judge::new(RULES, vec![Vec2::new(0.0, 0.0), Vec2::new(5.0, 0.0)])
    }

    #[test]
    fn the_last_arrival_ends_a_success_and_an_arrival_stays() {
        let mut judge = judge();
        assert_eq!(judge.see(Span::from_millis(50), &[seen(0.2), seen(4.0)]), None);
        let finding = judge.see(Span::from_millis(100), &[seen(1.0), seen(4.8)]).unwrap();
        assert_eq!((finding.verdict, finding.after), (Verdict::Success, Span::from_millis(100)));
    }

    #[test]
    fn the_first_failure_counts_and_judging_goes_on_to_the_last_arrival() {
        let mut judge = judge();
        let blocked = Seen { contacts: Contacts { wall: true, robot: false }, ..seen(1.0) };
        assert_eq!(judge.see(Span::from_millis(50), &[blocked, seen(4.0)]), None);
        assert_eq!(judge.see(Span::from_millis(100), &[seen(1.0), seen(1.1)]), None);
        let finding = judge.see(Span::from_millis(150), &[seen(0.0), seen(5.0)]).unwrap();
        assert_eq!(finding.verdict, Verdict::WallCollision);
        assert!((finding.min_separation_m - 0.1).abs() < 1e-6);
    }

    #[test]
    fn the_least_separation_of_a_large_team_is_that_of_any_pair() {
        use rand::RngExt;
        let mut stream = crate::random::Seed::of_run(3).stream("judge");
        let mut judge = Judge::new(RULES, vec![Vec2::repeat(99.0); 100]);
        let mut least = f32::INFINITY;
        for step in 0..20 {
            let mut point = || Vec2::new(stream.random_range(0.0..20.0), stream.random_range(0.0..20.0));
            let robots: Vec<Seen> =
                (0..100).map(|_| Seen { position: point(), contacts: Contacts::default() }).collect();
            for (index, robot) in robots.iter().enumerate() {
                for other in &robots[..index] {
                    least = least.min((robot.position - other.position).norm());
                }
            }
            judge.see(Span::from_millis(step), &robots);
            assert_eq!(judge.min_separation_m, least);
        }
    }

    #[test]
    fn too_near_is_a_collision_and_too_late_a_timeout() {
        let mut near = judge();
        let finding = near.see(Span::from_millis(1000), &[seen(1.0), seen(1.3)]).unwrap();
        assert_eq!(finding.verdict, Verdict::RobotCollision);
        let finding = judge().see(Span::from_millis(1000), &[seen(1.0), seen(4.0)]).unwrap();
        assert_eq!(finding.verdict, Verdict::Timeout);
    }
}
