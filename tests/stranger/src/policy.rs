//! The policy `give-way`: straight to the goal, slower the nearer a robot ahead is. Robots broadcast their distances to
//! their goals, and the one nearer to its goal goes first.

use murmurate::messages::geometry::{Planar, Vec2};
use murmurate::observation::Observation;
use murmurate::policy::{Entry, Interface, Model, Neighbour, Policy};
use murmurate::random::Stream;
use murmurate::time::Span;

/// Entry in a registry.
pub const GIVE_WAY: Entry = Entry {
    name: "give-way",
    about: "straight to the goal; the robot nearer to its goal goes first",
    build: |_| Ok(Model::custom("give-way", INTERFACE, |_| Box::new(GiveWay))),
};

const INTERFACE: Interface = Interface {
    features: 1,
    radius_m: 2.0,
    period: Span::from_millis(50),
    limit_m_s: 0.8,
    hold: Span::from_millis(200),
};

/// Distance below which another robot is in the way \[m\].
const NEAR_M: f32 = 0.9;

struct GiveWay;

impl Policy for GiveWay {
    fn interface(&self) -> Interface {
        INTERFACE
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        features[0] = (own.goal - own.motion.position).norm();
    }

    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
        let way = own.goal - own.motion.position;
        let ahead = |other: &&Neighbour| way.dot(&(other.motion.position - own.motion.position)) > 0.0;
        let first = |other: &&Neighbour| other.features[0] < features[0];
        let near = neighbours.iter().filter(ahead).filter(first);
        let nearest = near.map(|other| (other.motion.position - own.motion.position).norm()).fold(NEAR_M, f32::min);
        way.capped(INTERFACE.limit_m_s * nearest / NEAR_M)
    }
}
