//! Policy `flock-field`: scripted flocking with a migration, of the robots that a robot hears, around the obstacles
//! that it knows.
//!
//! It is the law of `flock-local`, with two terms of Olfati-Saber (2006): the velocity of the migration, and for each
//! near obstacle a robot that moves along its rim at the nearest point, which pushes the robot away and takes its
//! velocity towards the obstacle. Messages are positions and velocities, which every broadcast has.

use murmurate::messages::geometry::Vec2;
use murmurate::observation::Observation;
use murmurate::policy::flock::{accelerated, repulsion};
use murmurate::policy::{Entry, Interface, Model, ModelError, Neighbour, Origin, Policy};
use murmurate::random::Stream;
use murmurate::scenario::{Arena, KeepOut, Scenario};
use murmurate::time::Span;

use super::size::Size;
use crate::ground::size_of;

/// Entry of the policy.
pub const FLOCK_FIELD: Entry = Entry {
    name: "flock-field",
    about: "scripted flocking around obstacles; each robot knows its neighbours (for 'flocking-field')",
    build: model,
};

/// Time between two steps.
const PERIOD: Span = Span::from_millis(50);
/// Gain of the agreement on a velocity \[1/s\].
const AGREEMENT_PER_S: f32 = 2.0;
/// Gain of the velocity of the migration \[1/s\].
const MIGRATION_PER_S: f32 = 1.0;
/// Gain by which a robot near an obstacle loses its velocity towards it \[1/s\].
const BRAKING_PER_S: f32 = 4.0;
/// Factor on the potential of an obstacle, relative to that of a robot.
const OBSTACLE: f32 = 1.0;
/// Distance from a hull to an obstacle from which on it does not push, in the range of robots.
const REACH: f32 = 0.8;

fn model(scenario: &dyn Scenario) -> Result<Model, ModelError> {
    let size = size_of(scenario, Size::of(scenario.name()), "'flocking-field' and 'flocking-field-table'")?;
    let origin = Origin { requests: vec![size.channel().request()], ..Origin::default() };
    let interface = Interface {
        features: 0,
        radius_m: size.radius_of_communication_m,
        period: PERIOD,
        limit_m_s: 1.5,
        hold: Span::from_millis(200),
    };
    let instance = move |arena: &Arena, _, _| -> Box<dyn Policy> {
        Box::new(FlockField { size, interface, arena: arena.clone() })
    };
    Model::of_file((FLOCK_FIELD.name, interface), origin, None, instance).map_err(ModelError::Refused)
}

/// One robot's instance of the policy.
#[derive(Debug)]
struct FlockField {
    size: &'static Size,
    interface: Interface,
    arena: Arena,
}

impl FlockField {
    /// Returns the push \[m/s²\] of a robot or an obstacle on one that is `offset` \[m\] from it. It reaches as far as
    /// `range_m` \[m\].
    fn push(offset: Vec2, range_m: f32) -> Vec2 {
        repulsion(offset * (1.0 / range_m)) * range_m
    }

    /// Returns the acceleration \[m/s²\] away from an obstacle.
    fn around(&self, own: &Observation, block: &KeepOut) -> Vec2 {
        let (at, velocity) = (own.motion.position, own.motion.velocity);
        let offset = at - block.nearest(at);
        let Some(away) = offset.try_normalize(1e-6) else { return Vec2::zeros() };
        // Of two robots, both hulls are within their distance.
        let hull_m = self.arena.hull_m();
        let apart = away * (offset.norm() - hull_m).max(0.01 * hull_m);
        let reach_m = REACH * self.size.range_m;
        if apart.norm() >= reach_m {
            return Vec2::zeros();
        }
        let towards = velocity.dot(&away).min(0.0);
        FlockField::push(apart, reach_m) * OBSTACLE - away * (BRAKING_PER_S * towards)
    }
}

impl Policy for FlockField {
    fn interface(&self) -> Interface {
        self.interface
    }

    fn enter(&mut self, arena: &Arena) {
        self.arena.clone_from(arena);
    }

    fn encode(&mut self, _: &Observation, _: &mut [f32]) {}

    fn act(&mut self, own: &Observation, _: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
        let (at, velocity) = (own.motion.position, own.motion.velocity);
        let migration = Vec2::new(own.values[0], own.values[1]);
        let (mut difference, mut pushed) = (Vec2::zeros(), Vec2::zeros());
        for neighbour in neighbours {
            difference += neighbour.motion.velocity - velocity;
            pushed += FlockField::push(at - neighbour.motion.position, self.size.range_m);
        }
        for block in &self.arena.keep_outs {
            pushed += self.around(own, block);
        }
        let agreed = difference * (AGREEMENT_PER_S / neighbours.len().max(1) as f32);
        accelerated(velocity, agreed + pushed + (migration - velocity) * MIGRATION_PER_S, PERIOD)
    }
}

#[cfg(test)]
mod tests {
    use murmurate::messages::geometry::Motion;
    use murmurate::random::Seed;

    use super::super::size::FIELD;
    use super::*;

    #[test]
    fn a_robot_alone_migrates_and_before_an_obstacle_it_brakes_and_turns() {
        let disc = KeepOut::disc(Vec2::new(1.0, 0.1), 0.4);
        let arena = Arena::new(Vec2::from(FIELD.half_extent_m), vec![disc], 0.25);
        let interface =
            Interface { features: 0, radius_m: 2.0, period: PERIOD, limit_m_s: 1.5, hold: Span::from_millis(200) };
        let mut policy = FlockField { size: &FIELD, interface, arena };
        let mut act = |x: f32| {
            let motion = Motion { position: Vec2::new(x, 0.0), velocity: FIELD.migration() };
            let own = Observation { values: &[0.5, 0.0], ..Observation::new(motion, Vec2::zeros()) };
            policy.act(&own, &[], &[], &mut Seed::of_run(1).stream("none"))
        };
        assert_eq!(act(-3.0), FIELD.migration());
        let near = act(0.2);
        assert!(near.x < 0.5 && near.y < 0.0, "{near:?}");
    }
}
