//! Scripted navigation to unlabelled goals, which robots claim by messages.
//!
//! Each robot broadcasts its number and the goal that it claims, besides what scripted navigation does. From the places
//! that it has heard in the episode, its own, and the goals, it computes the assignment with the least sum of squared
//! distances, which keeps paths from crossing (Turpin, Michael and Kumar, "CAPT", International Journal of Robotics
//! Research 33 (1), 2014), and claims its own part of it. Robots that have heard the same claim different goals. A
//! claimed goal counts as nearer than it is, so that small changes of places do not change claims. Walls do not count.

use std::collections::BTreeMap;

use super::orca::{self, Orca};
use super::{Interface, Model, ModelError, Neighbour, Origin, Policy};
use crate::messages::geometry::{Vec2, is_finite};
use crate::messages::ids::RobotId;
use crate::observation::Observation;
use crate::random::Stream;
use crate::scenario::{Arena, Scenario, goals};

/// Name of the policy.
pub(crate) const NAME: &str = "claim";
/// Number of floats of a broadcast: those of scripted navigation, the number of the robot, and that of its goal.
const FEATURES: usize = orca::INTERFACE.features + 2;
/// Share of the distance to a claimed goal that counts in an assignment.
const CLAIMED: f32 = 0.9;

/// Parameters of the policy. Robots hear each other farther than for navigation alone: who is not heard is not known.
const INTERFACE: Interface = Interface { features: FEATURES, radius_m: 12.0, ..orca::INTERFACE };

/// Makes the policy for a scenario whose goals are unlabelled; an error says that they are not.
pub(crate) fn model(scenario: &dyn Scenario) -> Result<Model, ModelError> {
    if !scenario.goals().are_unlabelled() {
        let name = scenario.name();
        return Err(ModelError::Refused(format!(
            "each robot of the scenario '{name}' has a goal of its own; use 'orca'"
        )));
    }
    let origin = Origin { requests: vec![goals::channel(scenario.robots()).request()], ..Origin::default() };
    let instance = |arena: &Arena, robot: RobotId, _| -> Box<dyn Policy> { Box::new(Claim::new(arena, robot)) };
    Model::of_file((NAME, INTERFACE), origin, None, instance).map_err(ModelError::Refused)
}

/// Place of a robot when it was last heard, and the goal that it claimed.
#[derive(Clone, Copy, Debug)]
struct Place {
    at: Vec2,
    claim: Option<usize>,
}

/// One robot's instance of the policy.
#[derive(Debug)]
struct Claim {
    orca: Orca,
    robot: u16,
    /// Goal that the robot claims, by its index in the channel; `None` before the goals are known.
    claim: Option<usize>,
    /// Robots that were heard in the episode, by their numbers.
    heard: BTreeMap<u16, Place>,
}

impl Claim {
    fn new(arena: &Arena, robot: RobotId) -> Claim {
        Claim { orca: Orca::new(arena), robot: robot.0, claim: None, heard: BTreeMap::new() }
    }

    /// Returns the observation with the claimed goal for the robot's own; without one the robot stays where it is.
    fn bound<'a>(&self, own: &Observation<'a>) -> Observation<'a> {
        let position = own.motion.position;
        let goal = self.claim.and_then(|claim| goals_of(own).nth(claim));
        Observation { goal: goal.unwrap_or(position), ..*own }
    }

    /// Returns the robot's goal in the cheapest assignment of what it knows to the goals.
    fn assigned(&self, own: &Observation) -> Option<usize> {
        let goals: Vec<Vec2> = goals_of(own).collect();
        if goals.is_empty() || !goals.iter().all(|goal| is_finite(*goal)) {
            return None;
        }
        let mut all = self.heard.clone();
        all.insert(self.robot, Place { at: own.motion.position, claim: self.claim });
        let (numbers, places): (Vec<u16>, Vec<Place>) = all.into_iter().unzip();
        let cost = |robot: usize, goal: usize| {
            let share = if places[robot].claim == Some(goal) { CLAIMED } else { 1.0 };
            goals::squared_mm(share * (goals[goal] - places[robot].at).norm())
        };
        let mine = numbers.iter().position(|number| *number == self.robot).expect("it is among them");
        Some(goals::assigned([places.len(), goals.len()], cost)[mine])
    }

    /// Takes what the neighbours have said of themselves. Numbers that no robot of the team can have are ignored:
    /// messages can be corrupted.
    fn hear(&mut self, robots: usize, neighbours: &[Neighbour]) {
        for neighbour in neighbours {
            let [number, claim] = [FEATURES - 2, FEATURES - 1].map(|at| neighbour.features[at]);
            let index = |number: f32| (0..robots).find(|index| *index as f32 == number);
            let Some(number) = index(number).and_then(|number| u16::try_from(number).ok()) else { continue };
            if number != self.robot {
                self.heard.insert(number, Place { at: neighbour.motion.position, claim: index(claim) });
            }
        }
    }
}

/// Returns the goals of the team \[m\], policy frame, in the order of the channel.
fn goals_of<'a>(own: &Observation<'a>) -> impl Iterator<Item = Vec2> + use<'a> {
    let position = own.motion.position;
    own.values.chunks_exact(2).map(move |offset| position + Vec2::new(offset[0], offset[1]))
}

impl Policy for Claim {
    fn interface(&self) -> Interface {
        INTERFACE
    }

    fn reset(&mut self, _: u64) {
        (self.claim, self.heard) = (None, BTreeMap::new());
    }

    fn enter(&mut self, arena: &Arena) {
        self.orca.enter(arena);
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        self.claim = self.assigned(own);
        let (navigation, own_claim) = features.split_at_mut(orca::INTERFACE.features);
        self.orca.encode(&self.bound(own), navigation);
        own_claim.copy_from_slice(&[f32::from(self.robot), self.claim.map_or(-1.0, |claim| claim as f32)]);
    }

    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2 {
        self.hear(own.values.len() / 2, neighbours);
        self.orca.act(&self.bound(own), features, neighbours, stream)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::random::Seed;
    use crate::time::Span;

    /// Claims of robots on a line that hear each other for two steps, at goals on another line.
    fn claims(places: [f32; 3], goals: [f32; 3]) -> [Option<usize>; 3] {
        let arena = Arena::new(Vec2::repeat(20.0), Vec::new(), 0.25);
        let mut team = [0, 1, 2].map(|robot| Claim::new(&arena, RobotId(robot)));
        let motion = |robot: usize| Motion::at_rest(Vec2::new(places[robot], 0.0));
        let values = |robot: usize| goals.iter().flat_map(|x| [x - places[robot], 3.0]).collect::<Vec<f32>>();
        for _ in 0..2 {
            let mut said = [[0.0; FEATURES]; 3];
            for robot in 0..3 {
                let own = Observation { values: &values(robot), ..Observation::new(motion(robot), Vec2::zeros()) };
                team[robot].encode(&own, &mut said[robot]);
            }
            for robot in 0..3 {
                let own = Observation { values: &values(robot), ..Observation::new(motion(robot), Vec2::zeros()) };
                let heard = |other: usize| Neighbour { motion: motion(other), features: &said[other], age: Span::ZERO };
                let others: Vec<Neighbour> = (0..3).filter(|other| *other != robot).map(heard).collect();
                team[robot].act(&own, &said[robot], &others, &mut Seed::of_run(1).stream("none"));
            }
        }
        team.map(|claim| claim.claim)
    }

    #[test]
    fn robots_that_hear_each_other_claim_different_goals_and_paths_do_not_cross() {
        assert_eq!(claims([0.0, 1.0, 2.0], [2.0, 1.0, 3.0]), [Some(1), Some(0), Some(2)]);
        assert_eq!(claims([0.0, 5.0, 1.0], [0.5, 0.6, 0.7]), [Some(0), Some(2), Some(1)]);
    }

    #[test]
    fn what_no_robot_can_have_said_is_ignored() {
        let arena = Arena::new(Vec2::repeat(20.0), Vec::new(), 0.25);
        let mut claim = Claim::new(&arena, RobotId(1));
        let motion = Motion::at_rest(Vec2::zeros());
        for number in [1.0, -1.0, 3.0, 0.5, f32::NAN, f32::INFINITY] {
            claim.hear(3, &[Neighbour { motion, features: &[0.25, 0.0, 0.0, number, 0.0], age: Span::ZERO }]);
        }
        assert!(claim.heard.is_empty());
        claim.hear(3, &[Neighbour { motion, features: &[0.25, 0.0, 0.0, 2.0, 9.0], age: Span::ZERO }]);
        assert!(claim.heard[&2].claim.is_none(), "there is no such goal");
    }
}
