//! Limits of a velocity as half-planes, and the velocity nearest to a wanted one that satisfies them all.
//!
//! Where no bound is below zero, zero satisfies all limits. One below zero asks to get out of the way. Where no
//! velocity satisfies all limits, the answer is zero.

use crate::messages::geometry::Vec2;

/// Tolerated violation of a limit \[m/s\].
const TOLERANCE_M_S: f32 = 1e-4;
/// Largest number of limits that are considered at once.
const MOST: usize = 64;

/// Upper bound of the component of a velocity along one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Direction of the bounded component: a unit vector, world frame.
    pub along: Vec2,
    /// Upper bound of the component \[m/s\]; below zero, if the robot has to get out of the way.
    pub most_m_s: f32,
}

impl Limit {
    fn excess(&self, velocity: Vec2) -> f32 {
        velocity.dot(&self.along) - self.most_m_s
    }
}

/// Limits of one velocity, up to 64, stored without memory allocation.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    limits: [Limit; MOST],
    len: usize,
    /// Whether a limit was left out for want of room.
    full: bool,
}

impl Default for Limits {
    fn default() -> Limits {
        Limits { limits: [Limit { along: Vec2::zeros(), most_m_s: 0.0 }; MOST], len: 0, full: false }
    }
}

impl Limits {
    /// Adds a limit. If there is no room for it, the only velocity that satisfies all is zero.
    pub fn push(&mut self, limit: Limit) {
        match self.limits.get_mut(self.len) {
            Some(place) => (*place, self.len) = (limit, self.len + 1),
            None => self.full = true,
        }
    }

    /// Adds limits. If there is no room for all, the only velocity that satisfies all is zero.
    pub fn extend(&mut self, limits: impl IntoIterator<Item = Limit>) {
        limits.into_iter().for_each(|limit| self.push(limit));
    }

    /// Returns the limits that were added, in their order.
    pub fn as_slice(&self) -> &[Limit] {
        &self.limits[..self.len]
    }

    /// Returns the velocity nearest to `wanted` \[m/s\], world frame, that satisfies all limits; `wanted` itself if it
    /// does, and zero if there was no room for all limits.
    ///
    /// This is the incremental quadratic program in two dimensions, as in ORCA (van den Berg et al., 2011, section
    /// 5.3): if the solution so far violates the next limit, the new one is on its boundary.
    pub fn nearest(&self, wanted: Vec2) -> Vec2 {
        if self.full {
            return Vec2::zeros();
        }
        let limits = self.as_slice();
        let mut result = wanted;
        for (at, limit) in limits.iter().enumerate() {
            if limit.excess(result) > TOLERANCE_M_S {
                match on_boundary(*limit, &limits[..at], wanted) {
                    Some(nearest) => result = nearest,
                    None => return Vec2::zeros(),
                }
            }
        }
        result
    }
}

/// Returns the velocity on the boundary of `limit` that satisfies `others` and is nearest to `wanted`; `None` if there
/// is none but for rounding errors.
fn on_boundary(limit: Limit, others: &[Limit], wanted: Vec2) -> Option<Vec2> {
    let foot = limit.along * limit.most_m_s;
    let line = Vec2::new(-limit.along.y, limit.along.x);
    let (mut low, mut high) = (f32::NEG_INFINITY, f32::INFINITY);
    for other in others {
        let (across, room) = (other.along.dot(&line), -other.excess(foot));
        if across.abs() < 1e-6 {
            if room < -TOLERANCE_M_S {
                return None;
            }
        } else if across > 0.0 {
            high = high.min(room / across);
        } else {
            low = low.max(room / across);
        }
    }
    if low > high {
        return (low - high < TOLERANCE_M_S).then(|| foot + line * ((low + high) / 2.0));
    }
    Some(foot + line * wanted.dot(&line).clamp(low, high))
}

/// Returns the distance of `point` beyond a ground centred at the origin, the larger of both axes \[m\]; negative
/// inside. `half_extent` is half the size of the ground along x and y \[m\].
pub fn distance_outside(half_extent: Vec2, point: Vec2) -> f32 {
    (point.x.abs() - half_extent.x).max(point.y.abs() - half_extent.y)
}

/// Returns the limits of velocity that keep a point from passing a rectangular boundary (geofence) within `horizon_s`
/// \[s\], one for each side. `edge` is the distance of the boundary from the origin along x and y \[m\], and `position`
/// the point's position \[m\], world frame. A point outside may still return.
pub fn geofence(edge: Vec2, horizon_s: f32, position: Vec2) -> [Limit; 4] {
    [Vec2::x(), -Vec2::x(), Vec2::y(), -Vec2::y()].map(|along| {
        let room = edge.dot(&along.abs()) - position.dot(&along);
        Limit { along, most_m_s: (room / horizon_s).max(0.0) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits(all: impl IntoIterator<Item = Limit>) -> Limits {
        let mut limits = Limits::default();
        limits.extend(all);
        limits
    }

    fn towards(angle: f32, most_m_s: f32) -> Limit {
        let (y, x) = angle.sin_cos();
        Limit { along: Vec2::new(x, y), most_m_s }
    }

    #[test]
    fn only_the_part_beyond_a_limit_is_taken_away() {
        let one = |most| limits([towards(0.0, most)]);
        assert_eq!(one(0.0).nearest(Vec2::new(1.0, 0.5)), Vec2::new(0.0, 0.5));
        assert_eq!(one(0.5).nearest(Vec2::new(1.0, 0.5)), Vec2::new(0.5, 0.5));
        assert_eq!(one(3.0).nearest(Vec2::new(1.0, 0.5)), Vec2::new(1.0, 0.5));
        assert_eq!(one(0.1).nearest(Vec2::new(-1.0, 0.5)), Vec2::new(-1.0, 0.5));
    }

    #[test]
    fn the_answer_satisfies_all_limits_and_none_on_a_fine_grid_is_nearer() {
        for case in 0..400u32 {
            let number = |k: u32| (case * 7919 + k * 104_729) as f32 * 0.618_034 % 1.0;
            let all: Vec<Limit> = (0..1 + case % 7).map(|k| towards(number(k) * 6.3, number(k + 50) * 0.6)).collect();
            let wanted = Vec2::new(number(101) * 3.0 - 1.5, number(102) * 3.0 - 1.5);
            let result = limits(all.iter().copied()).nearest(wanted);
            assert!(all.iter().all(|limit| limit.excess(result) <= 2.0 * TOLERANCE_M_S), "{case}: {result:?}");
            let away = (result - wanted).norm();
            for x in -40..=40 {
                for y in -40..=40 {
                    let other = Vec2::new(x as f32, y as f32) * 0.04;
                    let allowed = all.iter().all(|limit| limit.excess(other) <= 0.0);
                    assert!(!allowed || (other - wanted).norm() >= away - 1e-3, "{case}: {other:?} is nearer");
                }
            }
        }
    }

    #[test]
    fn more_limits_than_there_is_room_for_leave_zero_alone() {
        let many = limits((0..=MOST).map(|k| towards(k as f32, 1.0)));
        assert_eq!(many.nearest(Vec2::new(0.1, 0.0)), Vec2::zeros());
    }

    #[test]
    fn a_geofence_stops_outward_motion_only() {
        let edge = Vec2::new(2.0, 3.0);
        let filtered = |position, velocity| limits(geofence(edge, 0.5, position)).nearest(velocity);
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
