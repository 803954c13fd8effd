//! Doors of an arena: the gaps between blocks, and between a block and the rim of the ground, that one robot at a time
//! can pass.

use crate::messages::geometry::Vec2;
use crate::scenario::{Arena, KeepOut, Portal};

/// Widest gap in which two robots cannot pass each other, in radii of the robots. Four are two robots side by side.
const NARROW: f32 = 4.5;
/// Distances of a mouth from the end of its gap that are tried, in radii of the robots. The first is that of the
/// scenario `passage`.
const MOUTHS: [f32; 4] = [2.0, 1.75, 1.5, 1.25];
/// Length \[m\] below which two coordinates are one.
const SAME_M: f32 = 1e-3;
/// Step of the search for the end of a gap, and the room by which it is wider there, in radii of the robots.
const DEPTH: f32 = 0.1;
/// Largest number of such steps.
const MOST_STEPS: u32 = 200;

/// Gap between two blocks that lie opposite each other.
#[derive(Clone, Debug, PartialEq)]
struct Gap {
    /// Ground between the blocks \[m\].
    between: KeepOut,
    /// Axis along which the gap is passed: 0 for x, 1 for y.
    along: usize,
}

/// Returns the bottlenecks of `arena`, whose own are not considered. Each is passed straight, and its mouths are free.
pub fn portals(arena: &Arena) -> Vec<Portal> {
    let is_narrow = |width_m: f32| width_m > 2.0 * arena.robot_radius_m && width_m <= NARROW * arena.robot_radius_m;
    let straight = gaps(arena).into_iter().filter(|gap| is_narrow(gap.width())).filter_map(|gap| {
        let (low, high) = gap.ends();
        portal(arena, [low, high], unit(gap.along))
    });
    let askew = askew(arena, is_narrow).into_iter().filter_map(|(middle, along)| {
        let ends = [-along, along].map(|outward| middle + outward * depth_m(arena, middle, outward));
        portal(arena, ends, along)
    });
    straight.chain(askew).collect()
}

/// Returns the gaps, as wide as `is_narrow` says, between two blocks of which one is no rectangle along the axes: the
/// middle of each, and the direction in which it is passed. They are where the blocks are nearest to each other, and
/// nothing else is as near to the middle.
fn askew(arena: &Arena, is_narrow: impl Fn(f32) -> bool) -> Vec<(Vec2, Vec2)> {
    let blocks = &arena.keep_outs;
    let rims = rims(arena);
    let all: Vec<&KeepOut> = blocks.iter().chain(&rims).collect();
    let mut found: Vec<(Vec2, Vec2)> = Vec::new();
    for (at, a) in blocks.iter().enumerate() {
        for b in all[at + 1..].iter().filter(|b| !(a.is_rect() && b.is_rect())) {
            let (one, other) = a.nearest_pair(b);
            let (way, middle) = (other - one, (one + other) / 2.0);
            let half_m = way.norm() / 2.0;
            let is_free = all.iter().all(|block| block.distance(middle) > half_m - SAME_M);
            let is_new = found.iter().all(|(before, _)| (before - middle).norm() > arena.robot_radius_m);
            if is_narrow(2.0 * half_m) && is_free && is_new {
                found.push((middle, Vec2::new(-way.y, way.x) / (2.0 * half_m)));
            }
        }
    }
    found
}

/// Returns how far a gap reaches from its middle in a direction \[m\], until there is more room than in the middle.
fn depth_m(arena: &Arena, middle: Vec2, outward: Vec2) -> f32 {
    let radius_m = arena.robot_radius_m;
    let room_m = |depth_m: f32| arena.clearance(middle + outward * depth_m);
    let steps = (0..MOST_STEPS).map(|step| step as f32 * DEPTH * radius_m);
    let wide_m = room_m(0.0) + DEPTH * radius_m;
    steps.into_iter().find(|depth_m| room_m(*depth_m) > wide_m).unwrap_or(0.0)
}

/// Returns blocks that fill the gaps of `arena` which are too narrow for its robots, between rectangles along the axes.
pub fn fillings(arena: &Arena) -> Vec<KeepOut> {
    let gaps = gaps(arena).into_iter().filter(|gap| gap.width() <= 2.0 * arena.robot_radius_m);
    gaps.map(|gap| gap.between).collect()
}

/// Returns the bottleneck of a gap between two `ends`, the second one in the direction `along`; `None` if no robot has
/// room beyond one of them.
fn portal(arena: &Arena, [low, high]: [Vec2; 2], along: Vec2) -> Option<Portal> {
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
    for (at, a) in blocks.iter().enumerate().filter(|(_, a)| a.is_rect()) {
        for b in all[at + 1..].iter().filter(|b| b.is_rect()) {
            let gap = [0, 1].into_iter().find_map(|along| between(a, b, along));
            let overlaps = |gap: &Gap| blocks.iter().any(|block| overlap(block, &gap.between));
            found.extend(gap.filter(|gap| !overlaps(gap)));
        }
    }
    let mut joined: Vec<Gap> = Vec::new();
    for gap in found {
        match joined.iter_mut().find(|other| other.continues(&gap)) {
            Some(other) => {
                let (a, b) = (&other.between, &gap.between);
                other.between = KeepOut::rect(a.min.inf(&b.min), a.max.sup(&b.max));
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
    let block = |min: [f32; 2], max: [f32; 2]| KeepOut::rect(min.into(), max.into());
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
    Some(Gap { between: KeepOut::rect(min, max), along })
}

/// Returns whether the bounds of two blocks have ground in common, beyond their rims.
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
        let KeepOut { min, max, .. } = self.between;
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
        let block = |&[x, y, far_x, far_y]: &[f32; 4]| KeepOut::rect(Vec2::new(x, y), Vec2::new(far_x, far_y));
        Arena::new(Vec2::repeat(half), blocks.iter().map(block).collect(), 0.25)
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
    fn doors_between_discs_and_askew_walls_are_found() {
        let disc = |x: f32, y: f32| KeepOut::disc(Vec2::new(x, y), 0.5);
        let of = |keep_outs| Arena::new(Vec2::repeat(4.0), keep_outs, 0.25);
        let found = portals(&of(vec![disc(-0.9, 0.0), disc(0.9, 0.0)]));
        let [Portal { near, far }] = found[..] else { panic!("{found:?}") };
        assert!(near.x.abs() < 1e-4 && far.x.abs() < 1e-4 && near.y * far.y < 0.0, "{found:?}");
        assert!((0.5..1.0).contains(&far.y.abs()), "{found:?}");
        assert_eq!(portals(&of(vec![disc(-1.2, 0.0), disc(1.2, 0.0)])), [], "two robots pass there");
        assert_eq!(portals(&of(vec![disc(-0.7, 0.0), disc(0.7, 0.0)])), [], "none passes there");
        // A wall along the diagonal, with a gap of 0.8 m in its middle.
        let wall = |from: f32, to: f32| {
            let along = |at: f32| Vec2::repeat(at / 2.0f32.sqrt());
            let beside = Vec2::new(0.1, -0.1);
            KeepOut::polygon(vec![along(from) + beside, along(to) + beside, along(to) - beside, along(from) - beside])
        };
        let found = portals(&of(vec![wall(-4.0, -0.4), wall(0.4, 4.0)]));
        let [Portal { near, far }] = found[..] else { panic!("{found:?}") };
        assert!((near + far).norm() < 0.05 && (near.x + near.y).abs() < 0.05, "{found:?}");
        assert!((0.4..0.9).contains(&near.norm()), "{found:?}");
    }

    #[test]
    fn gaps_at_the_rim_in_two_layers_and_too_narrow_ones_are_told_apart() {
        // A wall in two layers with a door at its right end, and one with a slit.
        let arena =
            arena(2.0, &[[-2.0, -0.2, 1.2, 0.0], [-2.0, 0.0, 1.2, 0.2], [-2.0, 1.5, 0.0, 2.0], [0.3, 1.5, 2.0, 2.0]]);
        let found = portals(&arena);
        let [Portal { near, far }] = found[..] else { panic!("{found:?}") };
        assert!((near - Vec2::new(1.725, -0.7)).norm() < 1e-5 && (far - Vec2::new(1.725, 0.7)).norm() < 1e-5);
        assert!(fillings(&arena).contains(&KeepOut::rect(Vec2::new(0.0, 1.5), Vec2::new(0.3, 2.0))));
    }
}
