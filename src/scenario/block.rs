//! Solid blocks of an arena: rectangles along the axes, discs and convex polygons.
//!
//! This is the one place that knows their shapes: nearest points, lines that meet them, and the places at which paths
//! turn around them. A block that is no rectangle along the axes is a convex polygon whose corners are rounded by a
//! radius; a disc is one of a single corner.

use std::f32::consts::PI;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::messages::geometry::{Planar, Vec2};

/// Length \[m\] below which two lengths are one.
const SAME_M: f32 = 1e-5;
/// Number of points for which the rim of a disc is drawn.
const RIM: u32 = 32;
/// Largest turn \[rad\] of a path at one place on its way around a corner.
const TURN_RAD: f32 = PI / 3.0;

/// Solid convex block in an arena, such as a part of a wall.
#[derive(Clone, Debug, PartialEq)]
pub struct KeepOut {
    /// Corner of the block's bounds with the smallest x and y \[m\], world frame.
    pub min: Vec2,
    /// Corner of the block's bounds with the largest x and y \[m\], world frame.
    pub max: Vec2,
    /// Outline of a block that does not fill its bounds; `None` for a rectangle along the axes.
    outline: Option<Arc<Outline>>,
}

/// Convex polygon with rounded corners.
#[derive(Debug, PartialEq)]
struct Outline {
    /// Corners of the polygon \[m\], counter-clockwise; a single one for a disc.
    corners: Vec<Vec2>,
    /// Distance \[m\] from the polygon within which points are in the block.
    radius_m: f32,
}

/// Shape of a block, as records and pictures have it \[m\], world frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Solid {
    /// Rectangle: smallest x and y, then largest x and y.
    Rect([f32; 4]),
    /// Disc.
    Disc {
        /// Coordinates x and y of the centre, then the radius.
        disc: [f32; 3],
    },
    /// Convex polygon.
    Polygon {
        /// Corners, counter-clockwise.
        polygon: Vec<[f32; 2]>,
    },
}

impl Solid {
    /// Returns the corners of the shape \[m\], counter-clockwise; points of the rim of a disc.
    pub fn rim(&self) -> Vec<[f32; 2]> {
        match self {
            Solid::Rect([x, y, far_x, far_y]) => vec![[*x, *y], [*far_x, *y], [*far_x, *far_y], [*x, *far_y]],
            Solid::Polygon { polygon } => polygon.clone(),
            Solid::Disc { disc: [x, y, radius_m] } => {
                let point = |at: u32| {
                    let (sin, cos) = libm::sincosf(2.0 * PI * at as f32 / RIM as f32);
                    [x + radius_m * cos, y + radius_m * sin]
                };
                (0..RIM).map(point).collect()
            }
        }
    }

    /// Returns the shape, moved by an offset \[m\].
    pub fn moved(&self, [x, y]: [f32; 2]) -> Solid {
        match self {
            Solid::Rect([near_x, near_y, far_x, far_y]) => Solid::Rect([near_x + x, near_y + y, far_x + x, far_y + y]),
            Solid::Disc { disc: [middle_x, middle_y, radius_m] } => {
                Solid::Disc { disc: [middle_x + x, middle_y + y, *radius_m] }
            }
            Solid::Polygon { polygon } => {
                Solid::Polygon { polygon: polygon.iter().map(|at| [at[0] + x, at[1] + y]).collect() }
            }
        }
    }

    /// Returns the triangles of the sides and the top of a prism over the shape: three corners of each \[m\].
    pub fn prism(&self, height_m: f32) -> Vec<[f32; 3]> {
        let rim = self.rim();
        let next = |at: usize| rim[(at + 1) % rim.len()];
        let of_side = |at: usize| {
            let ([x, y], [far_x, far_y]) = (rim[at], next(at));
            let [low, far_low] = [[x, y, 0.0], [far_x, far_y, 0.0]];
            let [high, far_high, top] = [[x, y, height_m], [far_x, far_y, height_m], [rim[0][0], rim[0][1], height_m]];
            [low, far_low, far_high, low, far_high, high, top, high, far_high]
        };
        (0..rim.len()).flat_map(of_side).collect()
    }
}

impl KeepOut {
    /// Returns the rectangle along the axes with these corners \[m\]: smallest x and y, and largest.
    pub const fn rect(min: Vec2, max: Vec2) -> KeepOut {
        KeepOut { min, max, outline: None }
    }

    /// Returns the disc with this centre and radius \[m\].
    pub fn disc(centre: Vec2, radius_m: f32) -> KeepOut {
        KeepOut::rounded(vec![centre], radius_m)
    }

    /// Returns the convex polygon with these corners \[m\], counter-clockwise; there are at least three.
    pub fn polygon(corners: Vec<Vec2>) -> KeepOut {
        KeepOut::rounded(corners, 0.0)
    }

    fn rounded(corners: Vec<Vec2>, radius_m: f32) -> KeepOut {
        let min = corners.iter().skip(1).fold(corners[0], |min, corner| min.inf(corner)).add_scalar(-radius_m);
        let max = corners.iter().skip(1).fold(corners[0], |max, corner| max.sup(corner)).add_scalar(radius_m);
        KeepOut { min, max, outline: Some(Arc::new(Outline { corners, radius_m })) }
    }

    /// Returns the block, moved by an offset \[m\].
    pub fn moved(&self, by: Vec2) -> KeepOut {
        let outline = self.outline.as_ref().map(|outline| {
            let corners = outline.corners.iter().map(|corner| corner + by).collect();
            Arc::new(Outline { corners, radius_m: outline.radius_m })
        });
        KeepOut { min: self.min + by, max: self.max + by, outline }
    }

    /// Returns the ground that the block covers while it is moved straight by an offset \[m\].
    pub fn swept(&self, by: Vec2) -> KeepOut {
        let corners = self.corners().chain(self.corners().map(|corner| corner + by)).collect();
        KeepOut::rounded(hull(corners), self.radius_m())
    }

    /// Returns whether the block is a rectangle along the axes.
    pub fn is_rect(&self) -> bool {
        self.outline.is_none()
    }

    /// Returns the shape of the block.
    pub fn solid(&self) -> Solid {
        match self.outline.as_deref() {
            None => Solid::Rect([self.min.x, self.min.y, self.max.x, self.max.y]),
            Some(Outline { corners, radius_m }) if corners.len() == 1 => {
                Solid::Disc { disc: [corners[0].x, corners[0].y, *radius_m] }
            }
            Some(outline) => Solid::Polygon { polygon: outline.corners.iter().map(Planar::to_array).collect() },
        }
    }

    /// Returns the radius by which the corners are rounded \[m\]; zero for a rectangle and a polygon.
    pub fn radius_m(&self) -> f32 {
        self.outline.as_ref().map_or(0.0, |outline| outline.radius_m)
    }

    /// Returns the corners of the block \[m\], world frame, counter-clockwise; the centre of a disc.
    pub fn corners(&self) -> impl Iterator<Item = Vec2> + Clone + '_ {
        let count = self.outline.as_ref().map_or(4, |outline| outline.corners.len());
        (0..count).map(|at| self.corner(at))
    }

    fn corner(&self, at: usize) -> Vec2 {
        match (self.outline.as_deref(), at) {
            (Some(outline), _) => outline.corners[at],
            (None, 0) => self.min,
            (None, 1) => Vec2::new(self.max.x, self.min.y),
            (None, 2) => self.max,
            (None, _) => Vec2::new(self.min.x, self.max.y),
        }
    }

    /// Returns the distance from `point` \[m\], world frame, to the block \[m\]; zero inside the block.
    pub fn distance(&self, point: Vec2) -> f32 {
        (point - self.nearest(point)).norm()
    }

    /// Returns the point of the block that is nearest to `point`, both \[m\] in the world frame; `point` itself if it
    /// is inside.
    #[inline]
    pub fn nearest(&self, point: Vec2) -> Vec2 {
        match &self.outline {
            None => point.sup(&self.min).inf(&self.max),
            Some(outline) => outline.nearest(point),
        }
    }

    /// Returns true if the straight line from `from` to `to` \[m\] intersects the block enlarged by `margin_m` \[m\]. A
    /// rectangle is enlarged on each side, and other blocks by all points that near; with a margin below zero, the
    /// sides are moved inwards.
    pub(crate) fn blocks(&self, from: Vec2, to: Vec2, margin_m: f32) -> bool {
        let in_bounds = meets_box([self.min, self.max], from, to, margin_m);
        in_bounds && self.outline.as_ref().is_none_or(|outline| outline.blocks(from, to, margin_m))
    }

    /// Returns whether the line may intersect the block enlarged by `margin_m` \[m\], by the block's bounds alone: if
    /// not, `blocks` is false with every margin up to that.
    pub(crate) fn may_block(&self, from: Vec2, to: Vec2, margin_m: f32) -> bool {
        meets_box([self.min, self.max], from, to, margin_m)
    }

    /// Returns the places \[m\] at which the shortest paths turn that keep `margin_m` \[m\] from the block.
    pub(crate) fn turns(&self, margin_m: f32) -> Vec<Vec2> {
        match &self.outline {
            None => {
                let [low, high] = [self.min.add_scalar(-margin_m), self.max.add_scalar(margin_m)];
                vec![low, Vec2::new(high.x, low.y), high, Vec2::new(low.x, high.y)]
            }
            Some(outline) => outline.turns(margin_m),
        }
    }

    /// Returns whether a place is nearer to the block than paths that keep `margin_m` \[m\] from it.
    pub(crate) fn is_within(&self, place: Vec2, margin_m: f32) -> bool {
        let apart = place - self.nearest(place);
        // A rectangle is enlarged along both axes.
        if self.is_rect() { apart.abs().max() < margin_m } else { apart.norm() < margin_m }
    }

    /// Returns the distance \[m\] between two blocks; zero if they overlap.
    pub fn apart_m(&self, other: &KeepOut) -> f32 {
        if self.is_rect() && other.is_rect() {
            return (self.min - other.max).sup(&(other.min - self.max)).sup(&Vec2::zeros()).norm();
        }
        let (one, another) = self.nearest_pair(other);
        (another - one).norm()
    }

    /// Returns a pair of nearest points of two blocks \[m\]; twice the same point if they overlap. Of parallel sides
    /// these are the middles of where they are opposite each other.
    pub fn nearest_pair(&self, other: &KeepOut) -> (Vec2, Vec2) {
        let crossing = other.sides().find(|[from, to]| self.blocks(*from, *to, 0.0));
        if let Some([from, to]) = crossing {
            let point = self.nearest((from + to) / 2.0);
            return (point, point);
        }
        let mine = self.corners().map(|corner| self.toward(corner, other.nearest(corner)));
        let theirs = other.corners().map(|corner| {
            let (one, another) = other.toward(corner, self.nearest(corner));
            (another, one)
        });
        let pairs: Vec<(Vec2, Vec2)> = mine.chain(theirs).collect();
        let length_m = |pair: &(Vec2, Vec2)| (pair.1 - pair.0).norm();
        let least_m = pairs.iter().map(length_m).fold(f32::INFINITY, f32::min);
        let mut nearest = pairs.into_iter().filter(|pair| length_m(pair) <= least_m + SAME_M);
        let first = nearest.next().expect("a block has a corner");
        let (sum, count) = nearest.fold((first, 1.0), |((a, b), count), (c, d)| ((a + c, b + d), count + 1.0));
        (sum.0 / count, sum.1 / count)
    }

    /// Returns the point of a rounded corner of this block that is nearest to `point`, and `point`.
    fn toward(&self, corner: Vec2, point: Vec2) -> (Vec2, Vec2) {
        let way = point - corner;
        let reach_m = self.radius_m().min(way.norm());
        (corner + way.try_normalize(0.0).unwrap_or_else(Vec2::zeros) * reach_m, point)
    }

    /// Returns the sides of the block's polygon, each by its ends \[m\]; for a disc, its centre twice.
    pub fn sides(&self) -> impl Iterator<Item = [Vec2; 2]> + '_ {
        self.corners().zip(self.corners().cycle().skip(1)).map(|(from, to)| [from, to])
    }
}

/// Returns whether the straight line from `from` to `to` intersects the box between the corners `low` and `high`,
/// enlarged by `margin_m` on each side; all \[m\].
fn meets_box([low, high]: [Vec2; 2], from: Vec2, to: Vec2, margin_m: f32) -> bool {
    // Slab method: the part of the line that is inside the enlarged box along both axes.
    let (mut enter, mut leave) = (0.0f32, 1.0f32);
    for axis in 0..2 {
        let [min, max, from, to] = [low, high, from, to].map(|point| point.to_array()[axis]);
        let (low, high) = (min - margin_m, max + margin_m);
        let (at, step) = (from, to - from);
        if step.abs() < 1e-9 {
            if at <= low || at >= high {
                return false;
            }
        } else {
            let (a, b) = ((low - at) / step, (high - at) / step);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
    }
    enter < leave
}

impl Outline {
    fn sides(&self) -> impl Iterator<Item = [Vec2; 2]> + '_ {
        let next = self.corners.iter().cycle().skip(1);
        self.corners.iter().zip(next).map(|(from, to)| [*from, *to])
    }

    /// Returns whether a point is within the polygon, without its rounded rim.
    fn has(&self, point: Vec2) -> bool {
        self.corners.len() > 2 && self.sides().all(|[from, to]| (to - from).perp(&(point - from)) >= 0.0)
    }

    fn nearest(&self, point: Vec2) -> Vec2 {
        if self.has(point) {
            return point;
        }
        let nearest = self.sides().map(|[from, to]| nearest_on(from, to, point));
        let distance = |place: &Vec2| (point - place).norm_squared();
        let nearest = nearest.min_by(|a, b| distance(a).total_cmp(&distance(b))).expect("it has a corner");
        let distance_m = (point - nearest).norm();
        if distance_m <= self.radius_m { point } else { nearest + (point - nearest) * (self.radius_m / distance_m) }
    }

    fn blocks(&self, from: Vec2, to: Vec2, margin_m: f32) -> bool {
        let reach_m = self.radius_m + margin_m;
        if self.corners.len() > 2 && reach_m <= 0.0 {
            return self.meets_inner(from, to, reach_m);
        }
        let near = |[one, other]: [Vec2; 2]| distance_of_lines([one, other], [from, to]) < reach_m;
        self.has(from) || self.sides().any(near)
    }

    /// Returns whether a straight line intersects the polygon whose sides are moved outwards by `margin_m` \[m\], which
    /// is at most zero (Cyrus and Beck, 1978).
    fn meets_inner(&self, from: Vec2, to: Vec2, margin_m: f32) -> bool {
        let (mut enter, mut leave) = (0.0f32, 1.0f32);
        for [one, other] in self.sides() {
            let Some(along) = (other - one).try_normalize(0.0) else { continue };
            let outside = |point: Vec2| -along.perp(&(point - one)) - margin_m;
            let (at, end) = (outside(from), outside(to));
            if at >= 0.0 && end >= 0.0 {
                return false;
            }
            let share = at / (at - end);
            if at > 0.0 {
                enter = enter.max(share);
            } else if end > 0.0 {
                leave = leave.min(share);
            }
        }
        enter < leave
    }

    fn turns(&self, margin_m: f32) -> Vec<Vec2> {
        let count = self.corners.len();
        let reach_m = self.radius_m + margin_m;
        let outward = |[from, to]: [Vec2; 2]| libm::atan2f(from.x - to.x, to.y - from.y);
        let mut turns = Vec::new();
        for (at, corner) in self.corners.iter().enumerate() {
            // Around a disc paths may turn by a whole turn, around another corner from one side's normal to the next.
            let (first, whole) = match count {
                1 => (0.0, 2.0 * PI),
                _ => {
                    let before = outward([self.corners[(at + count - 1) % count], *corner]);
                    let after = outward([*corner, self.corners[(at + 1) % count]]);
                    (before, (after - before).rem_euclid(2.0 * PI))
                }
            };
            let places = (whole / TURN_RAD).ceil().max(1.0);
            let step = whole / places;
            for place in 0..places as u32 {
                let (sin, cos) = libm::sincosf(first + step * (place as f32 + 0.5));
                turns.push(corner + Vec2::new(cos, sin) * (reach_m / libm::cosf(step / 2.0)));
            }
        }
        turns
    }
}

/// Returns the corners of the smallest convex polygon that has all `points`, counter-clockwise (Andrew, 1979).
fn hull(mut points: Vec<Vec2>) -> Vec<Vec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let half = |points: &mut dyn Iterator<Item = Vec2>| {
        let mut rim: Vec<Vec2> = Vec::new();
        for point in points {
            while let [.., before, last] = rim[..]
                && (last - before).perp(&(point - last)) <= 0.0
            {
                rim.pop();
            }
            rim.push(point);
        }
        rim.pop();
        rim
    };
    [half(&mut points.iter().copied()), half(&mut points.iter().rev().copied())].concat()
}

/// Returns the point of the straight line between two points that is nearest to `point`.
fn nearest_on(from: Vec2, to: Vec2, point: Vec2) -> Vec2 {
    let way = to - from;
    let share = (point - from).dot(&way) / way.norm_squared().max(f32::MIN_POSITIVE);
    from + way * share.clamp(0.0, 1.0)
}

/// Returns the distance between two straight lines, each given by its ends \[m\].
fn distance_of_lines(one: [Vec2; 2], other: [Vec2; 2]) -> f32 {
    let sides =
        |[from, to]: [Vec2; 2], [a, b]: [Vec2; 2]| (to - from).perp(&(a - from)) * (to - from).perp(&(b - from));
    if sides(one, other) < 0.0 && sides(other, one) < 0.0 {
        return 0.0;
    }
    let to = |[from, to]: [Vec2; 2], point: Vec2| (nearest_on(from, to, point) - point).norm();
    let ends = [to(one, other[0]), to(one, other[1]), to(other, one[0]), to(other, one[1])];
    ends.into_iter().fold(f32::INFINITY, f32::min)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn square() -> KeepOut {
        KeepOut::polygon([[0.5, -0.15], [2.0, -0.15], [2.0, 0.15], [0.5, 0.15]].map(Vec2::from).to_vec())
    }

    #[test]
    fn a_block_intersects_the_lines_that_come_within_the_margin() {
        let rect = KeepOut::rect(Vec2::new(0.5, -0.15), Vec2::new(2.0, 0.15));
        for block in [rect, square()] {
            let line = |x: f32, margin_m: f32| block.blocks(Vec2::new(x, -1.0), Vec2::new(x, 1.0), margin_m);
            assert!(line(1.0, 0.0) && !line(0.0, 0.25) && line(0.3, 0.25));
            assert!(!block.blocks(Vec2::new(1.0, -1.0), Vec2::new(-1.0, -1.0), 0.25));
            assert!((block.distance(Vec2::new(0.2, 0.55)) - 0.5).abs() < 1e-6);
            assert!(!block.blocks(Vec2::new(0.5, -1.0), Vec2::new(0.5, 1.0), -1e-3), "along its side");
            assert!(block.blocks(Vec2::new(0.6, 0.0), Vec2::new(0.6, 1.0), -1e-3), "from inside");
        }
    }

    #[test]
    fn shapes_are_written_as_in_a_task_file() {
        let json = |block: KeepOut| serde_json::to_string(&block.solid()).expect("a shape is JSON");
        assert_eq!(json(KeepOut::rect(Vec2::zeros(), Vec2::new(1.0, 2.0))), "[0.0,0.0,1.0,2.0]");
        assert_eq!(json(KeepOut::disc(Vec2::new(1.0, 2.0), 0.5)), "{\"disc\":[1.0,2.0,0.5]}");
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        let text = json(KeepOut::polygon(corners.map(Vec2::from).to_vec()));
        assert_eq!(text, "{\"polygon\":[[0.0,0.0],[1.0,0.0],[0.0,1.0]]}");
        assert_eq!(
            serde_json::from_str::<Solid>(&text).expect("it is one"),
            Solid::Polygon { polygon: corners.into() }
        );
    }

    /// A disc, a triangle, a square that is turned, or a rectangle, by the number `kind`.
    fn block(kind: u8, at: Vec2, size: f32, angle: f32) -> KeepOut {
        let corner = |turn: f32| {
            let (sin, cos) = (angle + turn).sin_cos();
            at + Vec2::new(cos, sin) * size
        };
        match kind {
            0 => KeepOut::disc(at, size),
            1 => KeepOut::polygon([0.0, 1.3, 3.9].map(corner).to_vec()),
            2 => KeepOut::polygon([0.0, 0.5 * PI, PI, 1.5 * PI].map(corner).to_vec()),
            _ => KeepOut::rect(at.add_scalar(-size), at.add_scalar(size)),
        }
    }

    proptest! {
        #[test]
        fn nearest_points_lines_and_turns_agree_with_what_small_steps_find(
            kind in 0..4u8, size in 0.05..1.5f32, angle in 0.0..6.2f32, margin_m in 0.0..0.6f32,
            ends in prop::array::uniform2((-3.0..3.0f32, -3.0..3.0f32)),
        ) {
            let block = block(kind, Vec2::new(0.2, -0.3), size, angle);
            let [from, to] = ends.map(|(x, y)| Vec2::new(x, y));
            let line = || (0..=2000).map(|at| from + (to - from) * (at as f32 / 2000.0));
            let near_m = line().map(|point| block.distance(point)).fold(f32::INFINITY, f32::min);
            if kind == 3 {
                let corners = line().any(|point| block.is_within(point, margin_m - 3e-3));
                prop_assert!(!corners || block.blocks(from, to, margin_m));
            } else {
                prop_assert!(near_m > margin_m - 1e-3 || block.blocks(from, to, margin_m));
            }
            prop_assert!(near_m < margin_m + 3e-3 || kind == 3 || !block.blocks(from, to, margin_m));
            let nearest = block.nearest(from);
            prop_assert!(block.distance(nearest) < 1e-4);
            prop_assert!(block.min.x - 1e-4 <= nearest.x && nearest.y <= block.max.y + 1e-4);
            // From each turn to the next, a path is free.
            let turns = block.turns(margin_m + 2e-3);
            for (at, turn) in turns.iter().enumerate() {
                prop_assert!(!block.blocks(*turn, turns[(at + 1) % turns.len()], margin_m), "{turns:?}");
            }
        }

        #[test]
        fn two_blocks_are_as_far_apart_as_their_nearest_points(
            kinds in prop::array::uniform2(0..4u8), size in 0.05..1.0f32, angle in 0.0..6.2f32,
            at in (-2.5..2.5f32, -2.5..2.5f32),
        ) {
            let one = block(kinds[0], Vec2::zeros(), 0.5, 0.4);
            let other = block(kinds[1], Vec2::new(at.0, at.1), size, angle);
            let (a, b) = one.nearest_pair(&other);
            let apart_m = one.apart_m(&other);
            prop_assert!(((a - b).norm() - apart_m).abs() < 1e-4);
            if apart_m > 0.0 {
                prop_assert!(one.distance(a) < 1e-3 && other.distance(b) < 1e-3);
                // No point of a grid on the other block is nearer.
                for step in 0..400 {
                    let share = Vec2::new((step % 20) as f32, (step / 20) as f32) / 19.0;
                    let point = other.nearest(other.min + (other.max - other.min).component_mul(&share));
                    prop_assert!(one.distance(point) > apart_m - 1e-3);
                }
            }
        }
    }
}
