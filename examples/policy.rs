//! A policy of your own: robots broadcast their distances to their goals, and the nearest one goes first. Scripted
//! navigation runs in the same scenario. `tests/stranger/` shows how to add a policy to the command line.
//!
//!     cargo run --release --example policy

use murmurate::messages::geometry::{Planar, Vec2};
use murmurate::observation::Observation;
use murmurate::policy::{Interface, Model, Neighbour, Policy};
use murmurate::random::Stream;
use murmurate::time::Span;
use murmurate::trial::Trial;

const INTERFACE: Interface = Interface {
    features: 1,
    radius_m: 1.5,
    period: Span::from_millis(50),
    limit_m_s: 0.8,
    // Hold time: a neighbour's last message is used this long, because some are lost.
    hold: Span::from_millis(200),
};

/// Policy of one robot. It has no state, so that a restarted robot needs none.
struct NearestFirst;

impl Policy for NearestFirst {
    fn interface(&self) -> Interface {
        INTERFACE
    }

    /// Encodes the message to broadcast.
    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        features[0] = (own.goal - own.motion.position).norm();
    }

    /// Returns the velocity, from the neighbours' messages.
    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
        let mut wanted = (own.goal - own.motion.position).capped(INTERFACE.limit_m_s);
        for other in neighbours {
            let apart = own.motion.position - other.motion.position;
            let near = (1.2 - apart.norm()).max(0.0);
            // The robot farther from its goal makes more room; both pass on the same side.
            let yields = if other.features[0] < features[0] { 3.0 } else { 1.5 };
            wanted += (apart + Vec2::new(-apart.y, apart.x)).normalize() * near * yields;
        }
        wanted.capped(INTERFACE.limit_m_s)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let custom = Model::custom("nearest-first", INTERFACE, |_arena| Box::new(NearestFirst));
    for model in [custom, Model::Orca] {
        let report = Trial::of_team("onboard-adhoc", "swap", 4)?.model(model.clone()).seed(3).episodes(10).run();
        println!("{:14} {} of {} episodes succeeded", model.name(), report.successes(), report.episodes.len());
    }
    Ok(())
}
