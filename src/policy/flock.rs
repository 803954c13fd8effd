//! Scripted flocking: robots agree on a velocity and push each other away when they are near. After Tanner, Jadbabaie
//! and Pappas, "Stable flocking of mobile agents, part I: fixed topology", CDC 2003, as Tolstaya et al., CoRL 2019
//! (arXiv 1903.10527, section 5), use it.
//!
//! Robot i accelerates by `u_i = c * mean_j(v_j - v_i) - sum_j grad V(r_ij)`. The mean is over the robots that it
//! knows, so that the law does not depend on the size of the team, where the source has the sum. V is the potential of
//! the source, `1 / r^2 + log r^2` with r in metres, up to its minimum at 1 m and constant beyond: robots that are
//! farther apart are not pulled near. The commanded velocity is the measured one plus the acceleration times the
//! period.
//!
//! The law is a policy with two sights. One knows all robots, which is the upper bound of what a policy can do that
//! hears only its neighbours. The other is the lower bound: the same law with the neighbours alone.

use super::{Interface, Model, ModelError, Neighbour, Policy};
use crate::messages::geometry::Vec2;
use crate::observation::Observation;
use crate::random::Stream;
use crate::scenario::Scenario;
use crate::time::Span;

/// Name of scripted flocking in which each robot knows all others.
pub(crate) const GLOBAL: &str = "flock-global";
/// Name of scripted flocking in which each robot knows its neighbours.
pub(crate) const LOCAL: &str = "flock-local";

/// Largest acceleration along each axis \[m/s²\].
pub const MAX_ACCELERATION_M_S2: f32 = 1.0;
/// Gain of the agreement on a velocity \[1/s\].
const AGREEMENT_PER_S: f32 = 5.0;
/// Gain of the potential \[m/s²\].
const REPULSION_M_S2: f32 = 1.0;
/// Distance from which on robots do not push each other away \[m\]: the minimum of the potential.
const RANGE_M: f32 = 1.0;
/// Smallest distance for the potential \[m\]: nearer robots push as strongly.
const LEAST_M: f32 = 0.1;
/// Distance up to which `Sight::Near` hears other robots \[m\].
const RADIUS_M: f32 = 2.0;
/// Period of the policy.
const PERIOD: Span = Span::from_millis(50);

/// Robots that a robot knows in scripted flocking.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sight {
    /// All robots of the team.
    All,
    /// The neighbours within 2 m.
    Near,
}

/// Makes scripted flocking for a scenario without goals; an error says that the scenario has goals.
pub(crate) fn model(scenario: &dyn Scenario, sight: Sight) -> Result<Model, ModelError> {
    if scenario.cost().is_none() {
        let name = scenario.name();
        return Err(ModelError::Refused(format!("robots of the scenario '{name}' have goals, which it does not know")));
    }
    let name = if sight == Sight::All { GLOBAL } else { LOCAL };
    Ok(Model::custom(name, interface(sight), move |_| Box::new(Flock { sight })))
}

fn interface(sight: Sight) -> Interface {
    Interface {
        // A message's own position and velocity are all that the law needs.
        features: 0,
        radius_m: if sight == Sight::All { f32::INFINITY } else { RADIUS_M },
        period: PERIOD,
        limit_m_s: 1.5,
        hold: Span::from_millis(200),
    }
}

/// One robot's instance of scripted flocking.
#[derive(Debug)]
struct Flock {
    sight: Sight,
}

/// Returns the acceleration \[m/s²\] that the potential of another robot gives a robot; `offset` is the position of the
/// robot minus that of the other \[m\].
pub fn repulsion(offset: Vec2) -> Vec2 {
    let distance = offset.norm();
    if distance >= RANGE_M || distance == 0.0 {
        return Vec2::zeros();
    }
    let near = distance.max(LEAST_M);
    offset / distance * (REPULSION_M_S2 * 2.0 * (1.0 / (near * near * near) - 1.0 / near))
}

impl Policy for Flock {
    fn interface(&self) -> Interface {
        interface(self.sight)
    }

    fn encode(&mut self, _: &Observation, _: &mut [f32]) {}

    fn act(&mut self, own: &Observation, _: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
        let (mut difference, mut pushed) = (Vec2::zeros(), Vec2::zeros());
        for neighbour in neighbours {
            difference += neighbour.motion.velocity - own.motion.velocity;
            pushed += repulsion(own.motion.position - neighbour.motion.position);
        }
        let wanted = difference * (AGREEMENT_PER_S / neighbours.len().max(1) as f32) + pushed;
        accelerated(own.motion.velocity, wanted, PERIOD)
    }
}

/// Returns the velocity to command \[m/s\] for a robot that moves at `velocity` \[m/s\] and is to accelerate by
/// `wanted` \[m/s²\], limited along each axis, for one period.
pub fn accelerated(velocity: Vec2, wanted: Vec2, period: Span) -> Vec2 {
    let limited = wanted.map(|axis| axis.clamp(-MAX_ACCELERATION_M_S2, MAX_ACCELERATION_M_S2));
    velocity + limited * period.as_secs() as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::{Motion, Planar};
    use crate::random::Seed;

    fn act(own: Motion, others: &[Motion]) -> Vec2 {
        let heard = |motion: &Motion| Neighbour { motion: *motion, features: &[], age: Span::ZERO };
        let neighbours: Vec<Neighbour> = others.iter().map(heard).collect();
        let seen = Observation::new(own, Vec2::zeros());
        Flock { sight: Sight::Near }.act(&seen, &[], &neighbours, &mut Seed::of_run(0).stream("none"))
    }

    #[test]
    fn robots_approach_the_mean_velocity_within_their_acceleration() {
        let at = |x: f32, vx: f32, vy: f32| Motion { position: Vec2::new(x, 0.0), velocity: Vec2::new(vx, vy) };
        let own = at(0.0, 0.5, 0.2);
        assert_eq!(act(own, &[]), own.velocity, "alone, it keeps its velocity");
        let [x, y] = (act(own, &[at(1.5, 0.5, 0.0), at(-1.8, 0.9, 0.4)]) - own.velocity).to_array();
        assert!((x - 0.05 * 5.0 * 0.2).abs() < 1e-6 && y.abs() < 1e-6, "{x} {y}");
        let fast = act(own, &[at(1.5, -0.5, 0.2)]) - own.velocity;
        assert!((fast.x + 0.05).abs() < 1e-6, "limited: {fast:?}");
    }

    #[test]
    fn near_robots_push_each_other_away_by_the_slope_of_the_potential() {
        assert_eq!(repulsion(Vec2::new(1.0, 0.0)), Vec2::zeros());
        assert_eq!(repulsion(Vec2::zeros()), Vec2::zeros());
        let potential = |r: f64| 1.0 / (r * r) + (r * r).ln();
        for r in [0.3, 0.6, 0.9] {
            let slope = (potential(r + 1e-6) - potential(r - 1e-6)) / 2e-6;
            let pushed = repulsion(Vec2::new(0.0, r as f32));
            assert!(pushed.x == 0.0 && (f64::from(pushed.y) + slope).abs() < 1e-3 * slope.abs(), "{r}: {pushed:?}");
        }
    }
}
