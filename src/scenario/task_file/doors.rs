//! Doors of an arena: the gaps between blocks, and between a block and the rim of the ground, that one robot at a time
//! can pass.

use crate::messages::geometry::Vec2;
use crate::scenario::arena::{Arena, KeepOut, Portal};

/// Widest gap in which two robots cannot pass each other, in radii of the robots. Four are two robots side by side.
const NARROW: f32 = 4.5;
/// Distances of a mouth from the end of its gap that are tried, in radii of the robots. The first is that of the
/// scenario `passage`.
const MOUTHS: [f32; 4] = [2.0, 1.75, 1.5, 1.25];
/// Length \[m\] below which two coordinates are one.
const SAME_M: f32 = 1e-3;

/// Gap between two blocks that lie opposite each other.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Gap {
    /// Ground between the blocks \[m\].
    between: KeepOut,
    /// Axis along which the gap is passed: 0 for x, 1 for y.
    along: usize,
}

/// Returns the bottlenecks of `arena`, whose own are not considered. Each is passed straight, and its mouths are free.
pub fn portals(arena: &Arena) -> Vec<Portal> {
    let narrow = NARROW * arena.robot_radius_m;
    let gaps = gaps(arena).into_iter().filter(|gap| gap.width() > 2.0 * arena.robot_radius_m && gap.width() <= narrow);
    gaps.filter_map(|gap| portal(arena, &gap)).collect()
}

/// Returns blocks that fill the gaps of `arena` which are too narrow for its robots.
pub fn fillings(arena: &Arena) -> Vec<KeepOut> {
    let gaps = gaps(arena).into_iter().filter(|gap| gap.width() <= 2.0 * arena.robot_radius_m);
    gaps.map(|gap| gap.between).collect()
}

/// Returns the bottleneck of a gap; `None` if no robot has room at one of its ends.
fn portal(arena: &Arena, gap: &Gap) -> Option<Portal> {
    let (low, high) = gap.ends();
    let along = unit(gap.along);
    let mouth = |end: Vec2, outward: Vec2| {
        let places = MOUTHS.map(|radii| end + outward * (radii * arena.robot_radius_m));
        let is_free = |place: &Vec2| {
            arena.admits(*place) && !arena.keep_outs.iter().any(|block| block.blocks(end, *place, arena.robot_radius_m))
        };
        places.into_iter().find(is_free)
    };
    Some(Portal { near: mouth(low, -along)?, far: mouth(high, along)? })
}

/// Returns all gaps between blocks, and between blocks and the rim, that nothing else lies in. Gaps one behind the
/// other between the same lines are one.
fn gaps(arena: &Arena) -> Vec<Gap> {
    let blocks = &arena.keep_outs;
    let rims = rims(arena);
    let all: Vec<&KeepOut> = blocks.iter().chain(&rims).collect();
    let mut found: Vec<Gap> = Vec::new();
    for (at, a) in blocks.iter().enumerate() {
        for b in &all[at + 1..] {
            let gap = [0, 1].into_iter().find_map(|along| between(a, b, along));
            let overlaps = |gap: &Gap| blocks.iter().any(|block| overlap(block, &gap.between));
            found.extend(gap.filter(|gap| !overlaps(gap)));
        }
    }
    let mut joined: Vec<Gap> = Vec::new();
    for gap in found {
        match joined.iter_mut().find(|other| other.continues(&gap)) {
            Some(other) => {
                let KeepOut { min, max } = &mut other.between;
                (*min, *max) = (min.inf(&gap.between.min), max.sup(&gap.between.max));
            }
            None => joined.push(gap),
        }
    }
    joined
}

/// Returns blocks beyond the rim of the ground, so that a robot which touches one has its centre on the rim.
fn rims(arena: &Arena) -> [KeepOut; 4] {
    let inner = arena.half_extent.add_scalar(arena.robot_radius_m);
    let outer = inner * 2.0;
    let block = |min: [f32; 2], max: [f32; 2]| KeepOut { min: min.into(), max: max.into() };
    [
        block([-outer.x, -outer.y], [-inner.x, outer.y]),
        block([inner.x, -outer.y], [outer.x, outer.y]),
        block([-outer.x, -outer.y], [outer.x, -inner.y]),
        block([-outer.x, inner.y], [outer.x, outer.y]),
    ]
}

/// Returns the gap between two blocks that is passed along the axis `along`; `None` if they are not opposite each
/// other across it, or touch.
fn between(a: &KeepOut, b: &KeepOut, along: usize) -> Option<Gap> {
    let across = 1 - along;
    let (first, second) = if a.min[across] <= b.min[across] { (a, b) } else { (b, a) };
    let (from, to) = (first.max[across], second.min[across]);
    let (low, high) = (a.min[along].max(b.min[along]), a.max[along].min(b.max[along]));
    if to - from < SAME_M || high - low < SAME_M {
        return None;
    }
    let (mut min, mut max) = (Vec2::zeros(), Vec2::zeros());
    (min[across], max[across], min[along], max[along]) = (from, to, low, high);
    Some(Gap { between: KeepOut { min, max }, along })
}

/// Returns whether two blocks have ground in common, beyond their rims.
fn overlap(a: &KeepOut, b: &KeepOut) -> bool {
    let size = a.max.inf(&b.max) - a.min.sup(&b.min);
    size.min() > SAME_M
}

fn unit(axis: usize) -> Vec2 {
    if axis == 0 { Vec2::x() } else { Vec2::y() }
}

impl Gap {
    fn width(&self) -> f32 {
        (self.between.max - self.between.min)[1 - self.along]
    }

    /// Returns the middles of both ends \[m\], the one with the lower coordinate first.
    fn ends(&self) -> (Vec2, Vec2) {
        let KeepOut { min, max } = self.between;
        let middle = (min + max) / 2.0;
        let (mut low, mut high) = (middle, middle);
        (low[self.along], high[self.along]) = (min[self.along], max[self.along]);
        (low, high)
    }

    /// Returns whether another gap between the same lines begins where this one ends, or the other way round.
    fn continues(&self, other: &Gap) -> bool {
        let (a, b, across) = (&self.between, &other.between, 1 - self.along);
        let is_same = |a: f32, b: f32| (a - b).abs() < SAME_M;
        let apart_m = (a.min[self.along] - b.max[self.along]).max(b.min[self.along] - a.max[self.along]);
        self.along == other.along
            && is_same(a.min[across], b.min[across])
            && is_same(a.max[across], b.max[across])
            && apart_m < SAME_M
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Settings, build};

    fn arena(half: f32, blocks: &[[f32; 4]]) -> Arena {
        let block = |&[x, y, far_x, far_y]: &[f32; 4]| KeepOut { min: Vec2::new(x, y), max: Vec2::new(far_x, far_y) };
        let keep_outs = blocks.iter().map(block).collect();
        Arena { half_extent: Vec2::repeat(half), keep_outs, portals: Vec::new(), robot_radius_m: 0.25 }
    }

    #[test]
    fn the_door_of_the_passage_is_the_one_that_its_author_wrote() {
        for gap_m in [None, Some(0.6), Some(1.1)] {
            let passage = build("passage", &Settings { gap_m, ..Settings::default() }).expect("it is there");
            let found = portals(passage.arena());
            let [Portal { near, far }] = found[..] else { panic!("{found:?}") };
            let written = passage.arena().portals[0];
            assert!((near - written.near).norm() < 1e-6 && (far - written.far).norm() < 1e-6, "{found:?}");
        }
        let wide = build("passage", &Settings { gap_m: Some(1.5), ..Settings::default() }).expect("it is there");
        assert_eq!(portals(wide.arena()), []);
    }

    #[test]
    fn gaps_at_the_rim_in_two_layers_and_too_narrow_ones_are_told_apart() {
        // A wall in two layers with a door at its right end, and one with a slit.
        let arena =
            arena(2.0, &[[-2.0, -0.2, 1.2, 0.0], [-2.0, 0.0, 1.2, 0.2], [-2.0, 1.5, 0.0, 2.0], [0.3, 1.5, 2.0, 2.0]]);
        let found = portals(&arena);
        let [Portal { near, far }] = found[..] else { panic!("{found:?}") };
        assert!((near - Vec2::new(1.725, -0.7)).norm() < 1e-5 && (far - Vec2::new(1.725, 0.7)).norm() < 1e-5);
        assert!(fillings(&arena).contains(&KeepOut { min: Vec2::new(0.0, 1.5), max: Vec2::new(0.3, 2.0) }));
    }
}
