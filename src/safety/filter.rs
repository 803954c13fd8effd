//! The safety filter: limits of a velocity along directions, from the edge of the ground and from neighbours.
//!
//! A limit is never below zero: the filter takes motion away and adds none that nobody has wanted. So standing is
//! always within all limits. After the velocity barriers of Wang, Ames, Egerstedt, IEEE T-RO 2017, in first order.

use crate::messages::geometry::{Motion, Vec2};

/// How often all limits are applied in turn before a robot that still breaks one has to stand.
const ROUNDS: usize = 8;
/// A limit that is broken by less is kept \[m/s\].
const TOLERANCE_M_S: f32 = 1e-4;

/// The most that a velocity may have along a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// The direction, of length one.
    pub along: Vec2,
    /// The most \[m/s\], zero or more.
    pub most_m_s: f32,
}

impl Limit {
    fn excess(&self, velocity: Vec2) -> f32 {
        velocity.dot(&self.along) - self.most_m_s
    }
}

/// The velocity without what breaks the limits; zero if taking that away for one keeps breaking another.
pub fn within(velocity: Vec2, limits: &[Limit]) -> Vec2 {
    let mut kept = velocity;
    for _ in 0..ROUNDS {
        let mut broken = false;
        for limit in limits {
            let excess = limit.excess(kept);
            if excess > TOLERANCE_M_S {
                kept -= limit.along * excess;
                broken = true;
            }
        }
        if !broken {
            return kept;
        }
    }
    Vec2::zeros()
}

/// How far beyond a ground of this half extent a point is, along the axis where it is farthest; negative inside \[m\].
pub fn beyond(half_extent: Vec2, point: Vec2) -> f32 {
    (point.x.abs() - half_extent.x).max(point.y.abs() - half_extent.y)
}

/// No axis may carry a robot at `position` past an edge at plus or minus `edge` within `horizon_s`; who is past it
/// may come back.
pub fn fence(edge: Vec2, horizon_s: f32, position: Vec2) -> [Limit; 4] {
    [Vec2::x(), -Vec2::x(), Vec2::y(), -Vec2::y()].map(|along| {
        let room = edge.dot(&along.abs()) - position.dot(&along);
        Limit { along, most_m_s: (room / horizon_s).max(0.0) }
    })
}

/// How fast a robot at `position` may approach a neighbour: as fast as that one moves away, and in addition by
/// `gain_per_s` times the distance that is left between them beyond `min_m`.
pub fn apart(position: Vec2, neighbour: Motion, min_m: f32, gain_per_s: f32) -> Limit {
    let offset = neighbour.position - position;
    // Of two in one place there is no direction apart: any will do.
    let along = offset.try_normalize(1e-6).unwrap_or_else(Vec2::x);
    let room = (offset.norm() - min_m).max(0.0);
    // Nearer than the least distance nobody follows either.
    let leaves = if room > 0.0 { neighbour.velocity.dot(&along).max(0.0) } else { 0.0 };
    Limit { along, most_m_s: leaves + gain_per_s * room }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: Vec2 = Vec2::new(1.0, 0.0);

    #[test]
    fn only_the_part_toward_a_neighbour_is_taken_away() {
        let limit = |x: f32| apart(AT, Motion::at_rest(Vec2::new(1.0 + x, 0.0)), 0.4, 1.0);
        assert_eq!(within(Vec2::new(1.0, 0.5), &[limit(0.3)]), Vec2::new(0.0, 0.5));
        assert!((within(Vec2::new(1.0, 0.5), &[limit(0.9)]) - Vec2::new(0.5, 0.5)).norm() < 1e-6);
        assert_eq!(within(Vec2::new(1.0, 0.5), &[limit(3.0)]), Vec2::new(1.0, 0.5));
        assert_eq!(within(Vec2::new(-1.0, 0.5), &[limit(0.1)]), Vec2::new(-1.0, 0.5), "it may leave");
    }

    #[test]
    fn whoever_moves_away_may_be_followed() {
        let ahead = |x: f32| Motion { position: AT + Vec2::new(0.6, 0.0), velocity: Vec2::new(x, 0.0) };
        assert!((apart(AT, ahead(0.5), 0.4, 1.0).most_m_s - 0.7).abs() < 1e-6);
        assert!((apart(AT, ahead(-0.5), 0.4, 1.0).most_m_s - 0.2).abs() < 1e-6);
        assert_eq!(apart(AT, ahead(0.5), 0.7, 1.0).most_m_s, 0.0);
    }

    #[test]
    fn between_many_a_robot_stands_rather_than_break_a_limit() {
        let around = (0..7).map(|k| (k as f32).sin_cos()).map(|(y, x)| Motion::at_rest(AT + Vec2::new(x, y) * 0.35));
        let limits: Vec<Limit> = around.map(|other| apart(AT, other, 0.4, 1.0)).collect();
        for k in 0..16 {
            let (y, x) = (k as f32 * 0.4).sin_cos();
            let kept = within(Vec2::new(x, y), &limits);
            assert!(limits.iter().all(|limit| limit.excess(kept) <= TOLERANCE_M_S), "{kept}");
        }
    }

    #[test]
    fn a_fence_lets_in_and_not_out() {
        let edge = Vec2::new(2.0, 3.0);
        let kept = |position, velocity| within(velocity, &fence(edge, 0.5, position));
        assert_eq!(kept(Vec2::zeros(), Vec2::new(1.0, 1.0)), Vec2::new(1.0, 1.0));
        assert!((kept(Vec2::new(1.9, 0.0), Vec2::new(1.0, 1.0)) - Vec2::new(0.2, 1.0)).norm() < 1e-5);
        assert_eq!(kept(Vec2::new(-2.5, 0.0), Vec2::new(-1.0, -1.0)), Vec2::new(0.0, -1.0));
        assert_eq!(kept(Vec2::new(-2.5, 0.0), Vec2::new(1.0, 0.0)), Vec2::new(1.0, 0.0));
        assert!((beyond(edge, Vec2::new(0.0, -3.5)) - 0.5).abs() < 1e-6 && beyond(edge, Vec2::zeros()) < 0.0);
    }
}
