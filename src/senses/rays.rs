//! Rays of a range finder in the plane: how far each goes until it meets a disc, a box, or the rails about the ground.
//!
//! Each obstacle is intersected with all rays in one loop without branches, in 32-bit floats, so the compiler computes
//! several rays at once. A box is met by the slab method (Kay and Kajiya, 1986), a disc where the ray's line passes
//! its centre closer than its radius. No call allocates.

use crate::messages::geometry::Vec2;
use crate::scenario::KeepOut;

/// Largest number of rays of one scan, as many as fit into one datagram.
pub const MAX_RAYS: usize = 256;

/// Component of a direction that stands for zero, so that its inverse is finite.
const ALMOST_ZERO: f32 = 1e-12;

/// Disc in the plane, such as the hull of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Centre \[m\], world frame.
    pub centre: Vec2,
    /// Radius \[m\].
    pub radius_m: f32,
}

/// Fan of rays from one point, at fixed angles to each other.
#[derive(Clone, Debug)]
pub struct Rays {
    /// Cosine and sine of each ray's angle in the frame of the fan.
    fan: Vec<[f32; 2]>,
    /// Components of each ray's direction in the world frame, and their inverses.
    x: Vec<f32>,
    y: Vec<f32>,
    per_x: Vec<f32>,
    per_y: Vec<f32>,
    origin: Vec2,
    range_m: f32,
}

impl Rays {
    /// Makes `rays` rays; the first is at the angle `from_rad` and each next one `step_rad` further, counter-clockwise
    /// \[rad\]. They see as far as `range_m` \[m\].
    pub fn new(rays: usize, (from_rad, step_rad): (f64, f64), range_m: f32) -> Rays {
        let angle = |ray: usize| libm::sincos(from_rad + step_rad * ray as f64);
        let fan = (0..rays).map(angle).map(|(sin, cos)| [cos as f32, sin as f32]).collect();
        let [x, y, per_x, per_y] = [(); 4].map(|()| vec![0.0; rays]);
        Rays { fan, x, y, per_x, per_y, origin: Vec2::zeros(), range_m }
    }

    /// Returns the number of rays.
    pub fn count(&self) -> usize {
        self.fan.len()
    }

    /// Puts the fan at `origin` \[m\], world frame, turned by `heading` \[rad\], and writes the distance along each ray
    /// into `ranges` for an empty world: infinite. `ranges` has one entry for each ray.
    pub fn place(&mut self, origin: Vec2, heading: f32, ranges: &mut [f32]) {
        self.origin = origin;
        let (sin, cos) = libm::sincosf(heading);
        let away_from_zero = |d: f32| if d.abs() < ALMOST_ZERO { ALMOST_ZERO } else { d };
        let directions = self.x.iter_mut().zip(&mut self.y).zip(self.per_x.iter_mut().zip(&mut self.per_y));
        for (([c, s], ((x, y), (per_x, per_y))), range) in self.fan.iter().zip(directions).zip(ranges) {
            (*x, *y) = (cos * c - sin * s, sin * c + cos * s);
            (*per_x, *per_y) = (1.0 / away_from_zero(*x), 1.0 / away_from_zero(*y));
            *range = f32::INFINITY;
        }
    }

    /// Shortens the rays that meet the disc in front of their origin; to zero if the origin is inside.
    pub fn meet_disc(&self, disc: &Disc, ranges: &mut [f32]) {
        let to = disc.centre - self.origin;
        let (square, radius) = (to.norm_squared(), disc.radius_m);
        let farthest = self.range_m + radius;
        if square > farthest * farthest {
            return;
        }
        if square <= radius * radius {
            ranges.fill(0.0);
            return;
        }
        for ((x, y), range) in self.x.iter().zip(&self.y).zip(ranges) {
            let along = to.x * x + to.y * y;
            let beside = to.x * y - to.y * x;
            // The difference of squares as a product, which keeps the digits of a ray that passes near the edge.
            let half_chord = (radius - beside) * (radius + beside);
            // The root of a negative number is not a number, which is below no range.
            let met = along - half_chord.sqrt();
            *range = if (along > 0.0) & (met < *range) { met } else { *range };
        }
    }

    /// Shortens the rays that meet the box in front of their origin; to zero if the origin is inside.
    fn meet_box(&self, block: &KeepOut, ranges: &mut [f32]) {
        let nearest = self.origin.sup(&block.min).inf(&block.max);
        if (nearest - self.origin).norm_squared() > self.range_m * self.range_m {
            return;
        }
        let (low, high) = (block.min - self.origin, block.max - self.origin);
        for ((per_x, per_y), range) in self.per_x.iter().zip(&self.per_y).zip(ranges) {
            let (x0, x1) = (low.x * per_x, high.x * per_x);
            let (y0, y1) = (low.y * per_y, high.y * per_y);
            let enters = larger(smaller(x0, x1), smaller(y0, y1));
            let leaves = smaller(larger(x0, x1), larger(y0, y1));
            let met = larger(enters, 0.0);
            *range = if (met <= leaves) & (met < *range) { met } else { *range };
        }
    }

    /// Shortens the rays that meet a block in front of their origin; to zero if the origin is inside.
    pub fn meet_block(&self, block: &KeepOut, ranges: &mut [f32]) {
        if block.is_rect() {
            self.meet_box(block, ranges);
        } else if block.radius_m() > 0.0 {
            block.corners().for_each(|centre| self.meet_disc(&Disc { centre, radius_m: block.radius_m() }, ranges));
        } else if block.distance(self.origin) <= self.range_m {
            self.meet_polygon(block, ranges);
        }
    }

    /// Shortens the rays that meet a convex polygon (Cyrus and Beck, 1978).
    fn meet_polygon(&self, block: &KeepOut, ranges: &mut [f32]) {
        for ((x, y), range) in self.x.iter().zip(&self.y).zip(ranges) {
            let (mut enters, mut leaves) = (0.0, f32::INFINITY);
            for [from, to] in block.sides() {
                let outward = Vec2::new(to.y - from.y, from.x - to.x);
                let along = outward.x * x + outward.y * y;
                let meets = |along: f32| outward.dot(&(from - self.origin)) / along;
                if along >= ALMOST_ZERO {
                    leaves = smaller(leaves, meets(along));
                } else {
                    // A ray beside the side enters never, or long ago.
                    enters = larger(enters, meets(smaller(along, -ALMOST_ZERO)));
                }
            }
            *range = if (enters <= leaves) & (enters < *range) { enters } else { *range };
        }
    }

    /// Shortens the rays to the rails about a ground whose middle is the origin of the world frame; `half` is half the
    /// inner length of the rails along x and y \[m\]. Rays from outside do not meet them.
    pub fn meet_rails(&self, half: Vec2, ranges: &mut [f32]) {
        let (low, high) = (-half - self.origin, half - self.origin);
        if !(low.max() <= 0.0 && high.min() >= 0.0) {
            return;
        }
        for ((per_x, per_y), range) in self.per_x.iter().zip(&self.per_y).zip(ranges) {
            let along_x = larger(low.x * per_x, high.x * per_x);
            let along_y = larger(low.y * per_y, high.y * per_y);
            let met = smaller(along_x, along_y);
            *range = if met < *range { met } else { *range };
        }
    }

    /// Makes all distances beyond the range infinite, as no echo.
    pub fn limit(&self, ranges: &mut [f32]) {
        let most = self.range_m;
        ranges.iter_mut().for_each(|range| *range = if *range <= most { *range } else { f32::INFINITY });
    }
}

/// Returns the smaller number; one instruction, unlike `f32::min`, which looks for what is not a number.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Returns the larger number, as `smaller` does the smaller one.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, TAU};

    use super::*;
    use crate::random::{RngExt, Seed};

    fn four(origin: Vec2, heading: f32) -> (Rays, Vec<f32>) {
        let (mut rays, mut ranges) = (Rays::new(4, (0.0, FRAC_PI_2), 5.0), vec![0.0; 4]);
        rays.place(origin, heading, &mut ranges);
        (rays, ranges)
    }

    fn near(found: &[f32], expected: [f32; 4]) {
        let same = |(one, other): (&f32, &f32)| (one - other).abs() < 1e-5 || (one == other);
        assert!(found.iter().zip(&expected).all(same), "{found:?}, not {expected:?}");
    }

    const NONE: f32 = f32::INFINITY;

    #[test]
    fn rays_meet_what_is_in_front_of_them_and_the_nearest_of_it() {
        let (rays, mut ranges) = four(Vec2::new(1.0, 1.0), 0.0);
        rays.meet_disc(&Disc { centre: Vec2::new(3.0, 1.0), radius_m: 0.5 }, &mut ranges);
        rays.meet_box(&KeepOut::rect(Vec2::new(0.0, 2.0), Vec2::new(2.0, 3.0)), &mut ranges);
        rays.limit(&mut ranges);
        near(&ranges, [1.5, 1.0, NONE, NONE]);
        rays.meet_disc(&Disc { centre: Vec2::new(2.0, 1.0), radius_m: 0.25 }, &mut ranges);
        rays.meet_disc(&Disc { centre: Vec2::new(1.0, 4.0), radius_m: 0.25 }, &mut ranges);
        near(&ranges, [0.75, 1.0, NONE, NONE]);
    }

    #[test]
    fn a_fan_is_turned_with_its_robot_and_sees_no_farther_than_its_range() {
        let (rays, mut ranges) = four(Vec2::zeros(), FRAC_PI_2 as f32);
        rays.meet_disc(&Disc { centre: Vec2::new(0.0, 2.0), radius_m: 0.5 }, &mut ranges);
        rays.meet_disc(&Disc { centre: Vec2::new(-5.4, 0.0), radius_m: 0.5 }, &mut ranges);
        rays.meet_box(&KeepOut::rect(Vec2::new(-1.0, -6.0), Vec2::new(1.0, -5.1)), &mut ranges);
        rays.limit(&mut ranges);
        near(&ranges, [1.5, 4.9, NONE, NONE]);
    }

    #[test]
    fn from_inside_an_obstacle_every_ray_ends_at_once_and_rails_are_met_from_inside() {
        for inside in [Vec2::new(0.1, 0.0), Vec2::zeros()] {
            let (rays, mut ranges) = four(inside, 0.3);
            rays.meet_disc(&Disc { centre: Vec2::zeros(), radius_m: 0.5 }, &mut ranges);
            near(&ranges, [0.0; 4]);
            let (rays, mut ranges) = four(inside, 0.3);
            rays.meet_box(&KeepOut::rect(Vec2::new(-1.0, -1.0), Vec2::new(1.0, 1.0)), &mut ranges);
            near(&ranges, [0.0; 4]);
        }
        let (rays, mut ranges) = four(Vec2::new(1.0, 0.0), 0.0);
        rays.meet_rails(Vec2::new(2.0, 3.0), &mut ranges);
        near(&ranges, [1.0, 3.0, 3.0, 3.0]);
        let (rays, mut ranges) = four(Vec2::new(3.0, 0.0), 0.0);
        rays.meet_rails(Vec2::new(2.0, 3.0), &mut ranges);
        near(&ranges, [NONE; 4]);
    }

    #[test]
    fn a_ray_along_the_face_of_a_box_is_no_error() {
        let (rays, mut ranges) = four(Vec2::new(0.0, 1.0), 0.0);
        rays.meet_box(&KeepOut::rect(Vec2::new(1.0, 0.0), Vec2::new(2.0, 1.0)), &mut ranges);
        assert!(ranges.iter().all(|range| !range.is_nan()), "{ranges:?}");
    }

    /// Distance to an obstacle by small steps along the ray, in 64-bit floats.
    fn walked(origin: Vec2, angle: f64, solid: impl Fn(f64, f64) -> bool) -> f64 {
        let (sin, cos) = angle.sin_cos();
        let at = |along: f64| (f64::from(origin.x) + along * cos, f64::from(origin.y) + along * sin);
        let steps = (0..60_000).map(|step| f64::from(step) * 1e-4);
        steps.into_iter().find(|along| solid(at(*along).0, at(*along).1)).unwrap_or(f64::INFINITY)
    }

    #[test]
    fn a_ray_meets_a_polygon_and_a_disc_as_small_steps_do() {
        let corners = [[1.0, -0.5], [2.0, 0.0], [1.5, 1.0], [0.6, 0.7]].map(Vec2::from);
        let blocks = [KeepOut::polygon(corners.to_vec()), KeepOut::disc(Vec2::new(-1.0, 0.4), 0.6)];
        let (mut rays, mut ranges) = (Rays::new(97, (0.1, TAU / 97.0), 3.0), vec![0.0; 97]);
        for origin in [[0.0, 0.0], [1.3, 0.2], [3.0, 1.0], [-1.0, -2.0]].map(Vec2::from) {
            rays.place(origin, 0.4, &mut ranges);
            blocks.iter().for_each(|block| rays.meet_block(block, &mut ranges));
            rays.limit(&mut ranges);
            for (ray, range) in ranges.iter().enumerate() {
                let at = |step: u32| origin + Vec2::new(rays.x[ray], rays.y[ray]) * (step as f32 * 1e-3);
                let solid = |step: &u32| blocks.iter().any(|block| block.distance(at(*step)) == 0.0);
                let walked = (0..3000).find(solid).map_or(f32::INFINITY, |step| step as f32 * 1e-3);
                let same = (walked - range).abs() < 3e-3 || walked == *range;
                assert!(same, "ray {ray} from {origin:?}: {range}, not {walked}");
            }
        }
    }

    #[test]
    fn distances_are_those_of_a_walk_along_each_ray() {
        let mut stream = Seed::of_run(3).stream("rays");
        for _ in 0..20 {
            let mut at = || Vec2::new(stream.random_range(-2.0..2.0), stream.random_range(-2.0..2.0));
            let (origin, disc, corner) = (at(), Disc { centre: at(), radius_m: 0.3 }, at());
            let block = KeepOut::rect(corner, corner + Vec2::new(0.7, 0.4));
            let (mut rays, mut ranges) = (Rays::new(16, (0.1, TAU / 16.0), 4.0), vec![0.0; 16]);
            rays.place(origin, 0.0, &mut ranges);
            rays.meet_disc(&disc, &mut ranges);
            rays.meet_box(&block, &mut ranges);
            rays.limit(&mut ranges);
            for (ray, range) in ranges.iter().enumerate() {
                let walked = walked(origin, 0.1 + TAU / 16.0 * ray as f64, |x, y| {
                    let point = Vec2::new(x as f32, y as f32);
                    (point - disc.centre).norm() <= 0.3 || block.nearest(point) == point
                });
                let both_none = walked > 4.0 && !range.is_finite();
                assert!(both_none || (walked - f64::from(*range)).abs() < 2e-3, "{walked} and {range}");
            }
        }
    }
}
