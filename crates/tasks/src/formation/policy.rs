//! Policy `follow-leader`: scripted formation. The robot with the least number of those that are heard leads past the
//! waypoints, and the others keep their places behind it.
//!
//! Each robot broadcasts its number and the waypoint to which the team is under way. A robot that was not heard for a
//! second is lost: the robot with the next number leads on to the same waypoint, and all keep clear of the place where
//! the lost one was heard last.

use std::collections::BTreeMap;

use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::observation::Observation;
use murmurate::policy::{Entry, Interface, Model, ModelError, Neighbour, Origin, Policy};
use murmurate::random::Stream;
use murmurate::scenario::{Arena, Scenario};
use murmurate::time::Span;

use super::size::Size;
use crate::ground::size_of;

/// Entry of the policy.
pub const FOLLOW_LEADER: Entry = Entry {
    name: "follow-leader",
    about: "scripted formation; the robot with the least number that is heard leads (for 'formation')",
    build: model,
};

/// Time between two steps.
const PERIOD: Span = Span::from_millis(50);
/// Number of steps without a message after which a robot is lost: a second.
const LOST_STEPS: u32 = 20;
/// Gain towards a robot's place \[1/s\].
const GAIN_PER_S: f32 = 0.8;
/// Largest speed, in speeds of the leader.
const FASTEST: f32 = 2.0;
/// Distance from a waypoint at which the next one is taken, in distances of two rows.
const REACHED: f32 = 0.4;
/// Distance within which robots push each other away, in radii that tasks keep free about them, and gain of that push
/// \[1/s\].
const APART: (f32, f32) = (2.8, 2.0);

fn model(scenario: &dyn Scenario) -> Result<Model, ModelError> {
    let size = size_of(scenario, Size::of(scenario.name()), "'formation' and 'formation-table'")?;
    let interface =
        Interface { features: 2, radius_m: 12.0, period: PERIOD, limit_m_s: 1.5, hold: Span::from_millis(200) };
    let instance = move |arena: &Arena, robot: RobotId, _| -> Box<dyn Policy> {
        Box::new(FollowLeader {
            size,
            interface,
            apart_m: APART.0 * arena.robot_radius_m,
            robot: robot.index(),
            waypoint: 1,
            step: 0,
            heard: BTreeMap::new(),
        })
    };
    Model::of_file((FOLLOW_LEADER.name, interface), Origin::default(), None, instance).map_err(ModelError::Refused)
}

/// Last message of another robot.
#[derive(Clone, Copy, Debug)]
struct Heard {
    step: u32,
    position: Vec2,
    velocity: Vec2,
    waypoint: usize,
}

/// One robot's instance of the policy.
#[derive(Debug)]
struct FollowLeader {
    size: &'static Size,
    interface: Interface,
    /// Distance within which robots push each other away \[m\].
    apart_m: f32,
    robot: usize,
    /// Number of the waypoint to which the team is under way.
    waypoint: usize,
    /// Number of the step in the episode.
    step: u32,
    /// Other robots, by their numbers, as they were heard last.
    heard: BTreeMap<usize, Heard>,
}

impl FollowLeader {
    /// Takes what the neighbours say. Numbers that no robot has are ignored.
    fn hear(&mut self, neighbours: &[Neighbour]) {
        for neighbour in neighbours {
            let [number, waypoint] = [neighbour.features[0], neighbour.features[1]];
            let is_number = |value: f32| (0.0..=1e6).contains(&value) && value.fract() == 0.0;
            if !is_number(number) || !is_number(waypoint) || number as usize == self.robot {
                continue;
            }
            let velocity = neighbour.motion.velocity;
            let position = neighbour.motion.position + velocity * neighbour.age.as_secs() as f32;
            let heard = Heard { step: self.step, position, velocity, waypoint: waypoint as usize };
            self.heard.insert(number as usize, heard);
        }
    }

    /// Returns the robot that leads, if it is another one.
    fn leader(&self) -> Option<(usize, Heard)> {
        let is_there = |heard: &Heard| self.step - heard.step < LOST_STEPS;
        let first = self.heard.iter().find(|(_, heard)| is_there(heard));
        first.filter(|(number, _)| **number < self.robot).map(|(number, heard)| (*number, *heard))
    }

    /// Returns the velocity \[m/s\] that the robot would have without others near it.
    fn wanted(&mut self, at: Vec2) -> Vec2 {
        let (size, place) = (self.size, self.size.place(self.robot));
        if let Some((number, heard)) = self.leader() {
            self.waypoint = heard.waypoint;
            let since_s = (self.step - heard.step) as f32 * PERIOD.as_secs() as f32;
            let point = heard.position + heard.velocity * since_s - size.place(number);
            return heard.velocity + (point + place - at) * GAIN_PER_S;
        }
        let point = at - place;
        if (size.waypoint(self.waypoint) - point).norm() < REACHED * size.wedge_m[0] {
            self.waypoint += 1;
        }
        let way = size.waypoint(self.waypoint) - point;
        way.try_normalize(1e-6).unwrap_or_else(Vec2::zeros) * size.speed_m_s
    }
}

impl Policy for FollowLeader {
    fn interface(&self) -> Interface {
        self.interface
    }

    fn reset(&mut self, _: u64) {
        (self.waypoint, self.step) = (1, 0);
        self.heard.clear();
    }

    fn encode(&mut self, _: &Observation, features: &mut [f32]) {
        features.copy_from_slice(&[self.robot as f32, self.waypoint as f32]);
    }

    fn act(&mut self, own: &Observation, _: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
        self.step += 1;
        self.hear(neighbours);
        let at = own.motion.position;
        let mut velocity = self.wanted(at);
        for other in self.heard.values() {
            let offset = at - other.position;
            let near_m = self.apart_m - offset.norm();
            if near_m > 0.0 {
                velocity += offset.try_normalize(1e-6).unwrap_or_else(Vec2::x) * (near_m * APART.1);
            }
        }
        let fastest_m_s = FASTEST * self.size.speed_m_s;
        velocity * (fastest_m_s / velocity.norm().max(fastest_m_s))
    }
}

#[cfg(test)]
mod tests {
    use murmurate::messages::geometry::Motion;
    use murmurate::random::Seed;

    use super::super::size::FORMATION;
    use super::*;

    fn robot(robot: usize) -> FollowLeader {
        let interface =
            Interface { features: 2, radius_m: 12.0, period: PERIOD, limit_m_s: 1.5, hold: Span::from_millis(200) };
        FollowLeader { size: &FORMATION, interface, apart_m: 0.7, robot, waypoint: 1, step: 0, heard: BTreeMap::new() }
    }

    #[test]
    fn the_next_number_leads_on_once_the_leader_is_lost() {
        let mut second = robot(1);
        let own = Observation::new(Motion::at_rest(Vec2::new(-0.7, 0.7)), Vec2::zeros());
        let leader = Neighbour {
            motion: Motion { position: Vec2::zeros(), velocity: Vec2::new(0.0, 0.4) },
            features: &[0.0, 2.0],
            age: Span::ZERO,
        };
        let mut act = |heard: &[Neighbour]| second.act(&own, &[], heard, &mut Seed::of_run(1).stream("none"));
        let follows = act(&[leader]);
        assert!((follows - Vec2::new(0.0, 0.4)).norm() < 1e-5, "it is at its place: {follows:?}");
        for _ in 0..LOST_STEPS {
            act(&[]);
        }
        let leads = act(&[]);
        // To waypoint 2, which the lost leader has named, with the point of the wedge at the origin.
        let way = FORMATION.waypoint(2).normalize() * FORMATION.speed_m_s;
        assert!((leads - way).norm() < 1e-4, "{leads:?}, not {way:?}");
        assert_eq!(second.waypoint, 2);
    }
}
