//! Simple polygons, and the convex parts of what is inside and outside of them.

use std::collections::BTreeMap;

use super::block::KeepOut;
use crate::messages::geometry::Vec2;

/// Length \[m\] below which two coordinates are one.
const SAME_M: f32 = 1e-5;

/// Simple polygon: its sides do not cross or touch each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Polygon {
    /// Corners \[m\], counter-clockwise.
    corners: Vec<Vec2>,
}

/// Side of a polygon, or of the frame about it, by which a part is bounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Bound {
    FrameLow,
    Side(usize),
    FrameHigh,
}

/// Part between two bounds: x on both of them, at the lowest and the highest y \[m\].
#[derive(Clone, Copy, Debug)]
struct Part {
    y: [f32; 2],
    left: [f32; 2],
    right: [f32; 2],
}

impl Polygon {
    /// Returns the polygon with these corners \[m\]. An error says why there is none.
    pub fn of(mut corners: Vec<Vec2>) -> Result<Polygon, &'static str> {
        let count = corners.len();
        if count < 3 {
            return Err("a polygon has three corners or more");
        }
        let next = |at: usize| (at + 1) % count;
        if (0..count).any(|at| (corners[next(at)] - corners[at]).norm() < SAME_M) {
            return Err("two corners in a row are one");
        }
        let twice_area: f32 = (0..count).map(|at| corners[at].perp(&corners[next(at)])).sum();
        if twice_area.abs() < SAME_M {
            return Err("it has no area");
        }
        let touches = |one: usize, other: usize| meet([one, other].map(|at| [corners[at], corners[next(at)]]));
        let apart = |one: usize, other: usize| other != next(one) && one != next(other);
        if (0..count).any(|one| (0..one).any(|other| apart(one, other) && touches(one, other))) {
            return Err("its sides cross or touch each other");
        }
        if twice_area < 0.0 {
            corners.reverse();
        }
        Ok(Polygon { corners })
    }

    /// Returns the polygon with all lengths multiplied by `scale`.
    pub fn scaled(&self, scale: f32) -> Polygon {
        Polygon { corners: self.corners.iter().map(|corner| corner * scale).collect() }
    }

    /// Returns half the size of the smallest box about the origin that has all corners \[m\].
    pub fn half_extent(&self) -> Vec2 {
        self.corners.iter().fold(Vec2::zeros(), |half, corner| half.sup(&corner.abs()))
    }

    fn is_convex(&self) -> bool {
        let count = self.corners.len();
        let corner = |at: usize| self.corners[at % count];
        (0..count).all(|at| (corner(at + 1) - corner(at)).perp(&(corner(at + 2) - corner(at + 1))) >= 0.0)
    }

    /// Returns convex blocks that fill the polygon: one, if it is convex.
    pub fn inside(&self) -> Vec<KeepOut> {
        if self.is_convex() {
            return vec![KeepOut::polygon(self.corners.clone())];
        }
        self.parts(None).iter().map(Part::block).collect()
    }

    /// Returns convex blocks that fill what is outside the polygon, to the box about the origin with half the size
    /// `half_extent` \[m\], in which the polygon is.
    pub fn outside(&self, half_extent: Vec2) -> Vec<KeepOut> {
        self.parts(Some(half_extent)).iter().map(Part::block).collect()
    }

    /// Returns the parts inside the polygon, or those outside it within a `frame`. All horizontal lines through corners
    /// divide the plane into strips, and the sides divide each strip. Parts one above the other between the same sides
    /// are one.
    fn parts(&self, frame: Option<Vec2>) -> Vec<Part> {
        let mut lines: Vec<f32> = self.corners.iter().map(|corner| corner.y).collect();
        lines.extend(frame.iter().flat_map(|half| [-half.y, half.y]));
        lines.sort_by(f32::total_cmp);
        lines.dedup_by(|one, other| (*one - *other).abs() < SAME_M);
        let mut done = Vec::new();
        let mut open: BTreeMap<[Bound; 2], Part> = BTreeMap::new();
        for strip in lines.windows(2) {
            let strip = [strip[0], strip[1]];
            let mut bounds = self.sides_in(strip);
            if let Some(half) = frame {
                bounds.insert(0, (Bound::FrameLow, [-half.x; 2]));
                bounds.push((Bound::FrameHigh, [half.x; 2]));
            }
            let mut here = BTreeMap::new();
            for pair in bounds.chunks_exact(2) {
                let [(left, left_x), (right, right_x)] = [pair[0], pair[1]];
                let mut part = Part { y: strip, left: left_x, right: right_x };
                if let Some(below) = open.remove(&[left, right]) {
                    part = Part {
                        y: [below.y[0], strip[1]],
                        left: [below.left[0], left_x[1]],
                        right: [below.right[0], right_x[1]],
                    };
                }
                here.insert([left, right], part);
            }
            done.extend(open.into_values());
            open = here;
        }
        done.extend(open.into_values());
        done.retain(|part| part.right.iter().zip(part.left).any(|(right, left)| right - left > SAME_M));
        done
    }

    /// Returns the sides that cross a strip between two horizontal lines, from left to right, with x on both lines.
    fn sides_in(&self, [low, high]: [f32; 2]) -> Vec<(Bound, [f32; 2])> {
        let count = self.corners.len();
        let mut found: Vec<(Bound, [f32; 2])> = Vec::new();
        for at in 0..count {
            let (one, other) = (self.corners[at], self.corners[(at + 1) % count]);
            let (below, above) = if one.y < other.y { (one, other) } else { (other, one) };
            if below.y > low + SAME_M || above.y < high - SAME_M || above.y - below.y < SAME_M {
                continue;
            }
            let x = |y: f32| below.x + (above.x - below.x) * ((y - below.y) / (above.y - below.y)).clamp(0.0, 1.0);
            found.push((Bound::Side(at), [x(low), x(high)]));
        }
        found.sort_by(|(_, one), (_, other)| (one[0] + one[1]).total_cmp(&(other[0] + other[1])));
        found
    }
}

impl Part {
    fn block(&self) -> KeepOut {
        let Part { y, left, right } = *self;
        if left[0] == left[1] && right[0] == right[1] {
            return KeepOut::rect(Vec2::new(left[0], y[0]), Vec2::new(right[0], y[1]));
        }
        let mut corners = vec![Vec2::new(left[0], y[0])];
        for (x, y) in [(right[0], y[0]), (right[1], y[1]), (left[1], y[1])] {
            let corner = Vec2::new(x, y);
            if corners.iter().all(|other: &Vec2| (other - corner).norm() > SAME_M) {
                corners.push(corner);
            }
        }
        KeepOut::polygon(corners)
    }
}

/// Returns whether two straight lines have a point in common, each given by its ends \[m\].
fn meet([one, other]: [[Vec2; 2]; 2]) -> bool {
    let sides =
        |[from, to]: [Vec2; 2], [a, b]: [Vec2; 2]| (to - from).perp(&(a - from)) * (to - from).perp(&(b - from));
    let overlap = |axis: usize| {
        let ends = [one, other].map(|line| line.map(|end| end[axis]));
        let [low, high] = [f32::min, f32::max].map(|of| ends.map(|[from, to]| of(from, to)));
        low[0].max(low[1]) <= high[0].min(high[1])
    };
    sides(one, other) <= 0.0 && sides(other, one) <= 0.0 && overlap(0) && overlap(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(corners: &[[f32; 2]]) -> Result<Polygon, &'static str> {
        Polygon::of(corners.iter().map(|corner| Vec2::from(*corner)).collect())
    }

    /// Whether a point is inside, by the number of sides to its left.
    fn has(polygon: &Polygon, point: Vec2) -> bool {
        let count = polygon.corners.len();
        let crossed = (0..count).filter(|&at| {
            let (a, b) = (polygon.corners[at], polygon.corners[(at + 1) % count]);
            (a.y > point.y) != (b.y > point.y) && point.x < (b.x - a.x) * (point.y - a.y) / (b.y - a.y) + a.x
        });
        crossed.count() % 2 == 1
    }

    #[test]
    fn inside_and_outside_are_filled_by_blocks_that_do_not_overlap() {
        let shapes: [&[[f32; 2]]; 4] = [
            &[[-1.0, -1.0], [2.0, -1.0], [2.0, 0.0], [0.0, 0.0], [0.0, 2.0], [-1.0, 2.0]],
            &[[-2.0, -1.5], [2.0, -1.0], [1.0, 1.7], [0.2, 0.1], [-1.5, 2.0]],
            &[[2.0, 0.0], [0.5, 0.5], [0.0, 2.0], [-0.5, 0.5], [-2.0, 0.0], [-0.5, -0.5], [0.0, -2.0], [0.5, -0.5]],
            &[[0.0, -2.0], [2.0, 0.3], [0.0, 2.0], [-2.0, 0.0]],
        ];
        for corners in shapes {
            let polygon = polygon(corners).expect("it is simple");
            let (inside, outside) = (polygon.inside(), polygon.outside(Vec2::repeat(2.5)));
            for step in 0..2500 {
                let point = Vec2::new((step % 50) as f32 * 0.099 - 2.43, (step / 50) as f32 * 0.099 - 2.43);
                let blocks = |blocks: &[KeepOut]| blocks.iter().filter(|block| block.distance(point) == 0.0).count();
                let near = inside.iter().chain(&outside).any(|block| {
                    let rim = |[from, to]: [Vec2; 2]| {
                        let share = ((point - from).dot(&(to - from)) / (to - from).norm_squared()).clamp(0.0, 1.0);
                        (from + (to - from) * share - point).norm() < 1e-3
                    };
                    block.sides().any(rim)
                });
                if !near {
                    let expected = if has(&polygon, point) { (1, 0) } else { (0, 1) };
                    assert_eq!((blocks(&inside), blocks(&outside)), expected, "{point:?} of {corners:?}");
                }
            }
        }
        let l_shape = polygon(shapes[0]).expect("it is simple");
        assert!(l_shape.inside().iter().all(KeepOut::is_rect) && l_shape.inside().len() == 2);
        assert_eq!(polygon(shapes[3]).expect("it is simple").inside().len(), 1);
    }

    #[test]
    fn what_is_no_simple_polygon_is_refused() {
        let refused = |corners: &[[f32; 2]]| polygon(corners).expect_err("it is none");
        assert!(refused(&[[0.0, 0.0], [1.0, 0.0]]).contains("three corners"));
        assert!(refused(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]).contains("no area"));
        assert!(refused(&[[0.0, 0.0], [3.0, 1.0], [3.0, 0.0], [0.0, 2.0]]).contains("cross"));
        assert!(refused(&[[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]]).contains("in a row"));
        let turned = polygon(&[[0.0, 1.0], [1.0, 0.0], [0.0, 0.0]]).expect("clockwise is one, too");
        assert_eq!(turned, polygon(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]).expect("it is simple"));
    }
}
