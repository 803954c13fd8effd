//! The safety filter: limits of a robot's velocity along directions, from the geofence and from neighbours.
//!
//! A limit is never below zero: the filter removes velocity and never adds any, so standing still satisfies all limits.
//! The filter is a first-order form of the safety barrier certificates of Wang, Ames, Egerstedt, IEEE T-RO 2017.

use crate::messages::geometry::{Motion, Vec2};

/// Maximum number of passes over all limits; a velocity that still violates one becomes zero.
const ROUNDS: usize = 8;
/// Tolerated violation of a limit \[m/s\].
const TOLERANCE_M_S: f32 = 1e-4;

/// Upper bound of the component of a robot's velocity along one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Direction of the bounded component: a unit vector, world frame.
    pub along: Vec2,
    /// Upper bound of the component \[m/s\], zero or more.
    pub most_m_s: f32,
}

impl Limit {
    fn excess(&self, velocity: Vec2) -> f32 {
        velocity.dot(&self.along) - self.most_m_s
    }
}

/// Returns `velocity` \[m/s\], world frame, reduced until it satisfies all `limits`. The function projects the velocity
/// onto each limit in turn. If eight passes over all limits do not suffice, it returns zero.
pub fn limited(velocity: Vec2, limits: &[Limit]) -> Vec2 {
    let mut result = velocity;
    for _ in 0..ROUNDS {
        let mut broken = false;
        for limit in limits {
            let excess = limit.excess(result);
            if excess > TOLERANCE_M_S {
                result -= limit.along * excess;
                broken = true;
            }
        }
        if !broken {
            return result;
        }
    }
    Vec2::zeros()
}

/// Returns the distance of `point` beyond a ground centred at the origin, the larger of both axes \[m\]; negative
/// inside. `half_extent` is half the size of the ground along x and y \[m\].
pub fn distance_outside(half_extent: Vec2, point: Vec2) -> f32 {
    (point.x.abs() - half_extent.x).max(point.y.abs() - half_extent.y)
}

/// Returns the limits of velocity that keep a robot from passing a rectangular boundary (geofence) within `horizon_s`
/// \[s\]. `edge` is the distance of the boundary from the origin along x and y \[m\], and `position` the robot's
/// position \[m\], world frame. A robot outside may still return.
pub fn geofence(edge: Vec2, horizon_s: f32, position: Vec2) -> [Limit; 4] {
    [Vec2::x(), -Vec2::x(), Vec2::y(), -Vec2::y()].map(|along| {
        let room = edge.dot(&along.abs()) - position.dot(&along);
        Limit { along, most_m_s: (room / horizon_s).max(0.0) }
    })
}

/// Returns the limit of a robot's velocity toward a neighbour. `position` is the robot's position \[m\], and
/// `neighbour` the neighbour's position and velocity \[m, m/s\], world frame.
///
/// The bound is the speed at which the neighbour moves away, plus `gain_per_s` \[1/s\] times the distance beyond
/// `min_m` \[m\]. At or below the distance `min_m` the bound is zero.
pub fn separation(position: Vec2, neighbour: Motion, min_m: f32, gain_per_s: f32) -> Limit {
    let offset = neighbour.position - position;
    // Coincident centres define no direction; any will do.
    let along = offset.try_normalize(1e-6).unwrap_or_else(Vec2::x);
    let room = (offset.norm() - min_m).max(0.0);
    // Below the minimum distance the robot may not follow either.
    let leaves = if room > 0.0 { neighbour.velocity.dot(&along).max(0.0) } else { 0.0 };
    Limit { along, most_m_s: leaves + gain_per_s * room }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: Vec2 = Vec2::new(1.0, 0.0);

    #[test]
    fn only_the_part_toward_a_neighbour_is_taken_away() {
        let limit = |x: f32| separation(AT, Motion::at_rest(Vec2::new(1.0 + x, 0.0)), 0.4, 1.0);
        assert_eq!(limited(Vec2::new(1.0, 0.5), &[limit(0.3)]), Vec2::new(0.0, 0.5));
        assert!((limited(Vec2::new(1.0, 0.5), &[limit(0.9)]) - Vec2::new(0.5, 0.5)).norm() < 1e-6);
        assert_eq!(limited(Vec2::new(1.0, 0.5), &[limit(3.0)]), Vec2::new(1.0, 0.5));
        assert_eq!(limited(Vec2::new(-1.0, 0.5), &[limit(0.1)]), Vec2::new(-1.0, 0.5), "it may leave");
    }

    #[test]
    fn a_neighbour_that_moves_away_may_be_followed() {
        let ahead = |x: f32| Motion { position: AT + Vec2::new(0.6, 0.0), velocity: Vec2::new(x, 0.0) };
        assert!((separation(AT, ahead(0.5), 0.4, 1.0).most_m_s - 0.7).abs() < 1e-6);
        assert!((separation(AT, ahead(-0.5), 0.4, 1.0).most_m_s - 0.2).abs() < 1e-6);
        assert_eq!(separation(AT, ahead(0.5), 0.7, 1.0).most_m_s, 0.0);
    }

    #[test]
    fn no_limit_is_violated_among_many_neighbours() {
        let around = (0..7).map(|k| (k as f32).sin_cos()).map(|(y, x)| Motion::at_rest(AT + Vec2::new(x, y) * 0.35));
        let limits: Vec<Limit> = around.map(|other| separation(AT, other, 0.4, 1.0)).collect();
        for k in 0..16 {
            let (y, x) = (k as f32 * 0.4).sin_cos();
            let result = limited(Vec2::new(x, y), &limits);
            assert!(limits.iter().all(|limit| limit.excess(result) <= TOLERANCE_M_S), "{result}");
        }
    }

    #[test]
    fn a_geofence_stops_outward_motion_only() {
        let edge = Vec2::new(2.0, 3.0);
        let filtered = |position, velocity| limited(velocity, &geofence(edge, 0.5, position));
        assert_eq!(filtered(Vec2::zeros(), Vec2::new(1.0, 1.0)), Vec2::new(1.0, 1.0));
        assert!((filtered(Vec2::new(1.9, 0.0), Vec2::new(1.0, 1.0)) - Vec2::new(0.2, 1.0)).norm() < 1e-5);
        assert_eq!(filtered(Vec2::new(-2.5, 0.0), Vec2::new(-1.0, -1.0)), Vec2::new(0.0, -1.0));
        assert_eq!(filtered(Vec2::new(-2.5, 0.0), Vec2::new(1.0, 0.0)), Vec2::new(1.0, 0.0));
        assert!(
            (distance_outside(edge, Vec2::new(0.0, -3.5)) - 0.5).abs() < 1e-6
                && distance_outside(edge, Vec2::zeros()) < 0.0
        );
    }
}
