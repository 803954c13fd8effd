//! Rays of a range finder in the plane: how far each goes until it meets a disc, a box, or the rails about the ground.
//!
//! Each obstacle within reach is intersected with all rays in one loop without branches, in 32-bit floats, so the
//! compiler computes several rays at once. A box is met by the slab method (Kay and Kajiya, 1986), a disc where the
//! ray's line passes its centre closer than its radius. No call allocates.

use crate::messages::geometry::Vec2;
use crate::scenario::KeepOut;

/// Largest number of rays of one scan, as many as fit into one datagram.
pub const MAX_RAYS: usize = 256;

/// Component of a direction that stands for zero, so that its inverse is finite.
const ALMOST_ZERO: f32 = 1e-12;

/// Number of which the number of rays that are computed is a multiple, so that no ray of a loop is left over.
const LANES: usize = 8;

/// Share of a distance that a ray along it has at least, for all rounding of its direction.
const ROUNDING: f32 = 0.999;

/// Fan of rays from one point, at fixed angles to each other, and the distances along them until they meet something.
#[derive(Clone, Debug)]
pub struct Rays {
    /// Cosine and sine of each ray's angle in the frame of the fan.
    fan: Vec<[f32; 2]>,
    /// Components of each ray's direction in the world frame, and their inverses. The last ray is there several times,
    /// up to a multiple of `LANES`.
    x: Vec<f32>,
    y: Vec<f32>,
    per_x: Vec<f32>,
    per_y: Vec<f32>,
    /// Distance along each of these rays, once something is `met`.
    ranges: Vec<f32>,
    /// Whether something is within reach of the rays.
    met: bool,
    origin: Vec2,
    /// Heading to which the fan was turned last \[rad\].
    heading: Option<f32>,
    range_m: f32,
}

impl Rays {
    /// Makes `rays` rays, at least one; the first is at the angle `from_rad` and each next one `step_rad` further,
    /// counter-clockwise \[rad\]. They see as far as `range_m` \[m\].
    pub fn new(rays: usize, (from_rad, step_rad): (f64, f64), range_m: f32) -> Rays {
        let angle = |ray: usize| libm::sincos(from_rad + step_rad * ray as f64);
        let fan: Vec<[f32; 2]> = (0..rays).map(angle).map(|(sin, cos)| [cos as f32, sin as f32]).collect();
        let [x, y, per_x, per_y, ranges] = [(); 5].map(|()| vec![0.0; rays.next_multiple_of(LANES)]);
        Rays { fan, x, y, per_x, per_y, ranges, met: false, origin: Vec2::zeros(), heading: None, range_m }
    }

    /// Returns the number of rays.
    pub fn count(&self) -> usize {
        self.fan.len()
    }

    /// Puts the fan at `origin` \[m\], world frame, turned by `heading` \[rad\], into an empty world.
    #[inline]
    pub fn place(&mut self, origin: Vec2, heading: f32) {
        (self.origin, self.met) = (origin, false);
        if self.heading.map(f32::to_bits) != Some(heading.to_bits()) {
            self.turn(heading);
        }
    }

    fn turn(&mut self, heading: f32) {
        self.heading = Some(heading);
        let (sin, cos) = libm::sincosf(heading);
        let away_from_zero = |d: f32| if d.abs() < ALMOST_ZERO { ALMOST_ZERO } else { d };
        let last = self.fan.len() - 1;
        let directions = self.x.iter_mut().zip(&mut self.y).zip(self.per_x.iter_mut().zip(&mut self.per_y));
        for (ray, ((x, y), (per_x, per_y))) in directions.enumerate() {
            let [c, s] = self.fan[ray.min(last)];
            (*x, *y) = (cos * c - sin * s, sin * c + cos * s);
            (*per_x, *per_y) = (1.0 / away_from_zero(*x), 1.0 / away_from_zero(*y));
        }
    }

    /// Shortens each ray to the distance that `met` returns for its direction and the inverses of that, where it is
    /// shorter.
    #[inline(always)]
    fn shorten(&mut self, met: impl Fn([f32; 2], [f32; 2]) -> f32) {
        if !self.met {
            self.met = true;
            self.ranges.fill(f32::INFINITY);
        }
        let directions = self.x.iter().zip(&self.y).zip(self.per_x.iter().zip(&self.per_y));
        for (((x, y), (per_x, per_y)), range) in directions.zip(&mut self.ranges) {
            // What is not a number is below no range.
            *range = smaller(met([*x, *y], [*per_x, *per_y]), *range);
        }
    }

    /// Shortens the rays that meet discs in front of their origin; to zero if the origin is inside. The discs have
    /// these centres \[m\], world frame, and one radius.
    #[inline]
    pub fn meet_discs(&mut self, centres: impl Iterator<Item = Vec2>, radius_m: f32) {
        let (origin, farthest) = (self.origin, self.range_m + radius_m);
        let farthest_square = farthest * farthest;
        for centre in centres {
            let to = centre - origin;
            if to.norm_squared() <= farthest_square {
                self.meet_near_disc(to, radius_m);
            }
        }
    }

    /// Shortens the rays that meet a disc whose centre is `to` \[m\] from their origin.
    fn meet_near_disc(&mut self, to: Vec2, radius: f32) {
        if to.norm_squared() <= radius * radius {
            self.met = true;
            self.ranges.fill(0.0);
            return;
        }
        self.shorten(|[x, y], _| {
            let along = to.x * x + to.y * y;
            let beside = to.x * y - to.y * x;
            // The difference of squares as a product, which keeps the digits of a ray that passes near the edge.
            let half_chord = (radius - beside) * (radius + beside);
            // The root of a negative number is not a number.
            let met = along - half_chord.sqrt();
            if along > 0.0 { met } else { f32::INFINITY }
        });
    }

    /// Shortens the rays that meet the box in front of their origin; to zero if the origin is inside.
    fn meet_box(&mut self, block: &KeepOut) {
        let nearest = self.origin.sup(&block.min).inf(&block.max);
        if (nearest - self.origin).norm_squared() > self.range_m * self.range_m {
            return;
        }
        let (low, high) = (block.min - self.origin, block.max - self.origin);
        self.shorten(|_, [per_x, per_y]| {
            let (x0, x1) = (low.x * per_x, high.x * per_x);
            let (y0, y1) = (low.y * per_y, high.y * per_y);
            let enters = larger(smaller(x0, x1), smaller(y0, y1));
            let leaves = smaller(larger(x0, x1), larger(y0, y1));
            let met = larger(enters, 0.0);
            if met <= leaves { met } else { f32::INFINITY }
        });
    }

    /// Shortens the rays that meet a block in front of their origin; to zero if the origin is inside.
    pub fn meet_block(&mut self, block: &KeepOut) {
        if block.is_rect() {
            self.meet_box(block);
        } else if block.radius_m() > 0.0 {
            self.meet_discs(block.corners(), block.radius_m());
        } else if block.distance(self.origin) <= self.range_m {
            self.meet_polygon(block);
        }
    }

    /// Shortens the rays that meet a convex polygon (Cyrus and Beck, 1978).
    fn meet_polygon(&mut self, block: &KeepOut) {
        let origin = self.origin;
        self.shorten(|[x, y], _| {
            let (mut enters, mut leaves) = (0.0, f32::INFINITY);
            for [from, to] in block.sides() {
                let outward = Vec2::new(to.y - from.y, from.x - to.x);
                let along = outward.x * x + outward.y * y;
                let meets = |along: f32| outward.dot(&(from - origin)) / along;
                if along >= ALMOST_ZERO {
                    leaves = smaller(leaves, meets(along));
                } else {
                    // A ray beside the side enters never, or long ago.
                    enters = larger(enters, meets(smaller(along, -ALMOST_ZERO)));
                }
            }
            if enters <= leaves { enters } else { f32::INFINITY }
        });
    }

    /// Shortens the rays to the rails about a ground whose middle is the origin of the world frame; `half` is half the
    /// inner length of the rails along x and y \[m\]. Rays from outside do not meet them.
    #[inline]
    pub fn meet_rails(&mut self, half: Vec2) {
        let (low, high) = (-half - self.origin, half - self.origin);
        let nearest_m = smaller(-larger(low.x, low.y), smaller(high.x, high.y));
        if nearest_m >= 0.0 && nearest_m * ROUNDING <= self.range_m {
            self.meet_near_rails(low, high);
        }
    }

    /// Shortens the rays to rails, of which `low` and `high` are two opposite corners as seen from their origin \[m\].
    fn meet_near_rails(&mut self, low: Vec2, high: Vec2) {
        self.shorten(|_, [per_x, per_y]| {
            let along_x = larger(low.x * per_x, high.x * per_x);
            let along_y = larger(low.y * per_y, high.y * per_y);
            smaller(along_x, along_y)
        });
    }

    /// Writes the distance along each ray \[m\] into `ranges`, which has one entry for each; infinite beyond the
    /// range, as no echo.
    #[inline]
    pub fn write(&self, ranges: &mut [f32]) {
        if self.met { self.write_met(ranges) } else { ranges.fill(f32::INFINITY) }
    }

    fn write_met(&self, ranges: &mut [f32]) {
        for (range, met) in ranges.iter_mut().zip(&self.ranges) {
            *range = if *met <= self.range_m { *met } else { f32::INFINITY };
        }
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

    fn four(origin: Vec2, heading: f32) -> Rays {
        let mut rays = Rays::new(4, (0.0, FRAC_PI_2), 5.0);
        rays.place(origin, heading);
        rays
    }

    fn meet(rays: &mut Rays, centre: Vec2, radius_m: f32) {
        rays.meet_discs(std::iter::once(centre), radius_m);
    }

    fn written(rays: &Rays) -> Vec<f32> {
        let mut ranges = vec![0.0; rays.count()];
        rays.write(&mut ranges);
        ranges
    }

    fn near(rays: &Rays, expected: [f32; 4]) {
        let found = written(rays);
        let same = |(one, other): (&f32, &f32)| (one - other).abs() < 1e-5 || (one == other);
        assert!(found.iter().zip(&expected).all(same), "{found:?}, not {expected:?}");
    }

    const NONE: f32 = f32::INFINITY;

    #[test]
    fn rays_meet_what_is_in_front_of_them_and_the_nearest_of_it() {
        let mut rays = four(Vec2::new(1.0, 1.0), 0.0);
        meet(&mut rays, Vec2::new(3.0, 1.0), 0.5);
        rays.meet_box(&KeepOut::rect(Vec2::new(0.0, 2.0), Vec2::new(2.0, 3.0)));
        near(&rays, [1.5, 1.0, NONE, NONE]);
        meet(&mut rays, Vec2::new(2.0, 1.0), 0.25);
        meet(&mut rays, Vec2::new(1.0, 4.0), 0.25);
        near(&rays, [0.75, 1.0, NONE, NONE]);
    }

    #[test]
    fn a_fan_is_turned_with_its_robot_and_sees_no_farther_than_its_range() {
        let mut rays = four(Vec2::zeros(), FRAC_PI_2 as f32);
        meet(&mut rays, Vec2::new(0.0, 2.0), 0.5);
        meet(&mut rays, Vec2::new(-5.4, 0.0), 0.5);
        rays.meet_box(&KeepOut::rect(Vec2::new(-1.0, -6.0), Vec2::new(1.0, -5.1)));
        near(&rays, [1.5, 4.9, NONE, NONE]);
    }

    #[test]
    fn from_inside_an_obstacle_every_ray_ends_at_once_and_rails_are_met_from_inside() {
        for inside in [Vec2::new(0.1, 0.0), Vec2::zeros()] {
            let mut rays = four(inside, 0.3);
            meet(&mut rays, Vec2::zeros(), 0.5);
            near(&rays, [0.0; 4]);
            let mut rays = four(inside, 0.3);
            rays.meet_box(&KeepOut::rect(Vec2::new(-1.0, -1.0), Vec2::new(1.0, 1.0)));
            near(&rays, [0.0; 4]);
        }
        let mut rays = four(Vec2::new(1.0, 0.0), 0.0);
        rays.meet_rails(Vec2::new(2.0, 3.0));
        near(&rays, [1.0, 3.0, 3.0, 3.0]);
        let mut rays = four(Vec2::new(3.0, 0.0), 0.0);
        rays.meet_rails(Vec2::new(2.0, 3.0));
        near(&rays, [NONE; 4]);
    }

    #[test]
    fn a_fan_that_was_elsewhere_sees_what_a_new_one_sees() {
        let mut stream = Seed::of_run(4).stream("rays");
        let (mut used, mut near) = (Rays::new(13, (0.1, TAU / 13.0), 1.5), 0);
        for step in 0..200 {
            let mut at = || Vec2::new(stream.random_range(-3.0..3.0), stream.random_range(-3.0..3.0));
            let (origin, centres, heading) = (at(), [at(), at()], if step % 3 > 0 { 0.7 } else { -0.0 });
            let [seen, expected] = [&mut used, &mut Rays::new(13, (0.1, TAU / 13.0), 1.5)].map(|rays| {
                rays.place(origin, heading);
                rays.meet_discs(centres.into_iter(), 0.3);
                rays.meet_rails(Vec2::new(3.1, 4.0));
                written(rays)
            });
            assert_eq!(seen, expected, "step {step}");
            near += usize::from(seen.iter().any(|range| range.is_finite()));
        }
        assert!((100..200).contains(&near), "some see something and some nothing: {near}");
    }

    #[test]
    fn a_ray_along_the_face_of_a_box_is_no_error() {
        let mut rays = four(Vec2::new(0.0, 1.0), 0.0);
        rays.meet_box(&KeepOut::rect(Vec2::new(1.0, 0.0), Vec2::new(2.0, 1.0)));
        let ranges = written(&rays);
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
        let mut rays = Rays::new(97, (0.1, TAU / 97.0), 3.0);
        for origin in [[0.0, 0.0], [1.3, 0.2], [3.0, 1.0], [-1.0, -2.0]].map(Vec2::from) {
            rays.place(origin, 0.4);
            blocks.iter().for_each(|block| rays.meet_block(block));
            for (ray, range) in written(&rays).iter().enumerate() {
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
            let (origin, centre, corner) = (at(), at(), at());
            let block = KeepOut::rect(corner, corner + Vec2::new(0.7, 0.4));
            let mut rays = Rays::new(16, (0.1, TAU / 16.0), 4.0);
            rays.place(origin, 0.0);
            meet(&mut rays, centre, 0.3);
            rays.meet_box(&block);
            for (ray, range) in written(&rays).iter().enumerate() {
                let walked = walked(origin, 0.1 + TAU / 16.0 * ray as f64, |x, y| {
                    let point = Vec2::new(x as f32, y as f32);
                    (point - centre).norm() <= 0.3 || block.nearest(point) == point
                });
                let both_none = walked > 4.0 && !range.is_finite();
                assert!(both_none || (walked - f64::from(*range)).abs() < 2e-3, "{walked} and {range}");
            }
        }
    }
}
