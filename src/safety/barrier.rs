//! Barriers: limits of the velocity of a robot's stopping point that keep it apart from neighbours and walls.
//!
//! This is the pairwise safety barrier certificate of Wang, Ames, Egerstedt (IEEE T-RO 2017), with the lag of the
//! drives in place of their braking at the largest deceleration, and half-planes shared like the cells of Zhou et al.
//! (IEEE RA-L 2017). If two robots with the same lag are commanded to stand, their offset moves along the straight line
//! from that of their positions to that of their stopping points. While this line stays clear of the disc of the least
//! distance, both can stop in time. Each robot may use its share of what room is left along the line's nearest point.

use super::limits::{Limit, geofence};
use super::stopping::Model;
use crate::messages::geometry::{Motion, Vec2};
use crate::scenario::{KeepOut, Mover};
use crate::time::Span;

/// Length below which an offset has no direction \[m\].
const LEAST_M: f32 = 1e-6;

/// How often the room that is left is reduced by the distance between a robot's way to its stopping point and the
/// straight line: once for the way itself, and once for a robot that does not brake but slides along its limits.
const BENDS: f32 = 2.0;

/// Longest time for which a robot hears later than others that the episode runs, and moving obstacles with it.
const LATE: Span = Span::from_millis(200);

/// Share of what its drive can do with which a robot gets out of the way of a moving obstacle, so that there is a
/// choice of directions.
const AWAY: f32 = 0.8;

/// Parameters from which the safety filter of one robot computes the limits that neighbours and walls set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Barrier {
    /// Model of how the velocities of the robot and of its neighbours follow their commands.
    pub(crate) model: Model,
    /// Least distance between the positions of two robots \[m\].
    pub distance_min_m: f32,
    /// Least distance of the robot's position from a wall \[m\].
    pub wall_min_m: f32,
    /// Largest speed at which the robot's stopping point may approach a neighbour, for each metre of distance beyond
    /// the least one \[1/s\]; twice that for a wall.
    pub gain_per_s: f32,
    /// Longest time from a neighbour's estimate of its own state to the arrival of the message with it \[s\].
    pub delay_s: f32,
}

impl Barrier {
    /// Returns the limits, one in each direction along both axes, within which the drive of a robot that moves at
    /// `velocity` \[m/s\], world frame, can move the robot's stopping point. Its neighbours rely on these limits.
    pub fn drive(&self, velocity: Vec2) -> [Limit; 4] {
        let ((left, right), (down, up)) = (self.model.reach(velocity.x), self.model.reach(velocity.y));
        [(-Vec2::x(), -left), (Vec2::x(), right), (-Vec2::y(), -down), (Vec2::y(), up)]
            .map(|(along, most_m_s)| Limit { along, most_m_s })
    }

    /// Returns the limits that a neighbour sets to the velocity of a robot's stopping point. `own` is the robot's
    /// motion, `other` that of the neighbour in its newest message, which arrived `age_s` \[s\] ago; world frame.
    ///
    /// The message took an unknown time to arrive, so there is one limit for a delay of zero and one for the longest
    /// delay: a few centimetres along the way of a fast neighbour change the direction to it.
    pub fn neighbour(&self, own: &Motion, other: &Motion, age_s: f32) -> [Limit; 2] {
        [age_s, age_s + self.delay_s].map(|known_s| self.neighbour_since(own, other, known_s))
    }

    /// Returns the limit that a neighbour sets whose motion was `other` at a time `known_s` \[s\] ago.
    fn neighbour_since(&self, own: &Motion, other: &Motion, known_s: f32) -> Limit {
        let position = other.position + other.velocity * known_s - own.position;
        let stopping = position + self.model.travel(other.velocity) - self.model.travel(own.velocity);
        let nearest = nearest_on(position, stopping, Vec2::zeros());
        let direction = nearest.try_normalize(LEAST_M).or_else(|| position.try_normalize(LEAST_M));
        // Coincident centres define no direction; any will do.
        let along = direction.unwrap_or_else(Vec2::x);
        // Distance by which the neighbour's stopping point may have come nearer than predicted since its message.
        let nearer = |n: f32, v: f32| {
            let (low, high) = self.model.reach(v);
            (n * (v - low)).max(n * (v - high))
        };
        let drift_m = known_s * (nearer(along.x, other.velocity.x) + nearer(along.y, other.velocity.y));
        let bend_m = BENDS * (self.model.bend(own.velocity) + self.model.bend(other.velocity));
        let room_m = along.dot(&stopping) - drift_m - bend_m - self.distance_min_m;
        Limit { along, most_m_s: self.gain_per_s * room_m.max(0.0) }
    }

    /// Returns the limits that a moving obstacle sets to the velocity of a robot's stopping point, at the time
    /// `elapsed` since the episode runs. `own` is the robot's motion, world frame.
    ///
    /// There is one limit for where the obstacle is, and one for where it will be once the robot has followed its
    /// command: as long after as the robot's drive lags, and as the robot may have heard late that the episode runs.
    pub fn mover(&self, own: &Motion, mover: &Mover, elapsed: Span) -> [Limit; 2] {
        [Span::ZERO, Span::from_secs(f64::from(self.model.lag_s())) + LATE].map(|ahead| {
            let (block, velocity) = (mover.block(elapsed + ahead), mover.motion(elapsed + ahead).velocity);
            let (along, room_m) = self.room(own, &block);
            // What moves away is not followed, since it may turn.
            let most_m_s = 2.0 * self.gain_per_s * room_m + along.dot(&velocity).min(0.0);
            Limit { along, most_m_s: most_m_s.max(self.fastest_away(own.velocity, along)) }
        })
    }

    /// Returns the component along a direction with which the stopping point of a robot that moves at `velocity` gets
    /// away from it fastest \[m/s\]: zero or less.
    fn fastest_away(&self, velocity: Vec2, along: Vec2) -> f32 {
        let axis = |n: f32, v: f32| {
            let (low, high) = self.model.reach(v);
            (n * low).min(n * high)
        };
        AWAY * (axis(along.x, velocity.x) + axis(along.y, velocity.y))
    }

    /// Returns the limit that a solid block sets to the velocity of a robot's stopping point. `own` is the robot's
    /// motion, world frame.
    pub fn wall(&self, own: &Motion, block: &KeepOut) -> Limit {
        let (along, room_m) = self.room(own, block);
        Limit { along, most_m_s: 2.0 * self.gain_per_s * room_m.max(0.0) }
    }

    /// Returns the direction from a robot and its way to its stopping point to a block, and the room along it that is
    /// left to the stopping point \[m\].
    fn room(&self, own: &Motion, block: &KeepOut) -> (Vec2, f32) {
        let from = own.position;
        let to = from + self.model.travel(own.velocity);
        let (point, solid) = nearest_pair(from, to, block);
        let centre = (block.min + block.max) * 0.5;
        let along = (solid - point).try_normalize(LEAST_M).or_else(|| (centre - from).try_normalize(LEAST_M));
        let along = along.unwrap_or_else(Vec2::x);
        (along, along.dot(&(solid - to)) - BENDS * self.model.bend(own.velocity) - self.wall_min_m)
    }

    /// Returns the limits that the four edges of the ground set to the velocity of a robot's stopping point. `own` is
    /// the robot's motion, world frame, and `half_extent` the distance of the edges from the origin along x and y
    /// \[m\].
    pub fn edge(&self, own: &Motion, half_extent: Vec2) -> [Limit; 4] {
        geofence(half_extent, 0.5 / self.gain_per_s, own.position + self.model.travel(own.velocity))
    }
}

/// Returns the point of the straight line between two points that is nearest to `to`.
fn nearest_on(from: Vec2, until: Vec2, to: Vec2) -> Vec2 {
    let way = until - from;
    let square = way.norm_squared();
    if square <= LEAST_M * LEAST_M {
        return from;
    }
    from + way * ((to - from).dot(&way) / square).clamp(0.0, 1.0)
}

/// Returns the nearest points of a straight line and a block. If they intersect, both are one point of the block.
fn nearest_pair(from: Vec2, until: Vec2, block: &KeepOut) -> (Vec2, Vec2) {
    if block.blocks(from, until, 0.0) {
        let inside = block.nearest(until);
        return (inside, inside);
    }
    let ends = [from, until].map(|end| (end, block.nearest(end)));
    let others = block.corners().map(|corner| {
        let point = nearest_on(from, until, corner);
        (point, if block.is_rect() { corner } else { block.nearest(point) })
    });
    let length = |pair: &(Vec2, Vec2)| (pair.0 - pair.1).norm_squared();
    ends.into_iter().chain(others).fold(ends[0], |best, pair| if length(&pair) < length(&best) { pair } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn barrier() -> Barrier {
        let model = Model::new(0.5, 100.0, 0.05, 0.25);
        Barrier { model, distance_min_m: 0.4, wall_min_m: 0.2, gain_per_s: 5.0, delay_s: 0.0 }
    }

    fn motion(x: f32, vx: f32) -> Motion {
        Motion { position: Vec2::new(x, 0.0), velocity: Vec2::new(vx, 0.0) }
    }

    #[test]
    fn what_is_left_counts_from_where_both_can_stop() {
        let most = |own: Motion, other: Motion, age_s: f32| barrier().neighbour(&own, &other, age_s)[0].most_m_s;
        assert!((most(motion(0.0, 0.0), motion(1.0, 0.0), 0.0) - 3.0).abs() < 1e-5);
        assert!((most(motion(0.0, 0.4), motion(1.0, 0.0), 0.0) - 2.0).abs() < 1e-5, "it stops after 0.2 m");
        assert!((most(motion(0.0, 0.4), motion(1.0, -0.4), 0.0) - 1.0).abs() < 1e-5, "and so does the other");
        assert!((most(motion(0.0, 0.4), motion(0.5, 0.4), 0.0) - 0.5).abs() < 1e-5, "one behind the other");
        assert!((most(motion(0.0, 0.0), motion(1.0, 0.0), 0.4) - 2.5).abs() < 1e-5, "it may have started since");
        assert_eq!(most(motion(0.0, 0.0), motion(0.3, 0.0), 0.0), 0.0);
    }

    #[test]
    fn robots_that_pass_each_other_are_limited_where_they_are_nearest() {
        let own = Motion { position: Vec2::zeros(), velocity: Vec2::new(1.0, 0.0) };
        let other = Motion { position: Vec2::new(0.5, 0.6), velocity: Vec2::new(-1.0, 0.0) };
        let limit = barrier().neighbour(&own, &other, 0.0)[0];
        assert!((limit.along - Vec2::y()).norm() < 1e-5 && (limit.most_m_s - 1.0).abs() < 1e-5, "{limit:?}");
    }

    #[test]
    fn a_wall_is_met_at_its_nearest_point() {
        let block = KeepOut::rect(Vec2::new(0.5, -0.15), Vec2::new(2.0, 0.15));
        let limit = barrier().wall(&motion(0.0, 0.2), &block);
        assert!((limit.along - Vec2::x()).norm() < 1e-6 && (limit.most_m_s - 2.0).abs() < 1e-4, "{limit:?}");
        let past = Motion { position: Vec2::new(0.2, -0.45), velocity: Vec2::new(0.0, 0.1) };
        let corner = barrier().wall(&past, &block).along;
        assert!(corner.x > 0.7 && corner.y > 0.6, "{corner:?}");
        let through = Motion { position: Vec2::new(0.4, 0.0), velocity: Vec2::new(1.0, 0.0) };
        assert_eq!(barrier().wall(&through, &block).most_m_s, 0.0);
    }
}
