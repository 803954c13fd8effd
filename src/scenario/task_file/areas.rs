//! Areas of a task file: discs, rectangles and formations, in which places of robots are drawn.

use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};

use super::shapes::Shape;
use crate::messages::geometry::Vec2;
use crate::random::Stream;
use crate::scenario::size::APART;
use crate::scenario::{Arena, KeepOut, Portal};

/// Room \[m\] that a drawn place has from walls beyond the robots' radius, as in the scenario `passage`.
const ROOM_M: f32 = 0.05;
/// Radius of the robots for which that room was chosen \[m\]; smaller ones have less in proportion.
const CHOSEN_FOR_M: f32 = 0.25;
/// Number of times that the places of a team are drawn anew, and number of draws of each place, before they are those
/// of a lattice.
const TRIES: (usize, usize) = (16, 48);
/// Spacing of that lattice, in the least distance of two places.
const LATTICE: f32 = 1.05;
/// Largest number of points of a lattice along each axis.
const MOST_POINTS: f32 = 400.0;

/// Area in which places of robots are drawn \[m\], world frame.
#[derive(Clone, Debug)]
pub struct Area {
    /// Blocks whose points within `radius_m` are the area: the rectangle, the parts of the polygon, the centre of the
    /// disc, or the points of the formation.
    cores: Vec<KeepOut>,
    /// Radius of the disc \[m\]; zero for other areas.
    radius_m: f32,
    /// Whether the area is a formation, whose points are the places.
    is_formation: bool,
}

impl Area {
    /// Returns the area of a shape whose lengths are multiplied by `scale`.
    pub fn of(shape: &Shape, scale: f32) -> Area {
        let point = |[x, y]: [f32; 2]| KeepOut::rect(Vec2::new(x, y) * scale, Vec2::new(x, y) * scale);
        let (cores, radius_m, is_formation) = match shape {
            Shape::Rect(_) | Shape::Polygon(_) => (shape.blocks(scale), 0.0, false),
            Shape::Disc([x, y, radius_m]) => (vec![point([*x, *y])], radius_m * scale, false),
            Shape::Points(points) => (points.iter().copied().map(point).collect(), 0.0, true),
        };
        Area { cores, radius_m, is_formation }
    }

    /// Returns the least distance \[m\] between points of two areas; zero if they overlap.
    pub fn distance(&self, other: &Area) -> f32 {
        let pairs = self.cores.iter().flat_map(|a| other.cores.iter().map(move |b| a.apart_m(b)));
        (pairs.fold(f32::INFINITY, f32::min) - self.radius_m - other.radius_m).max(0.0)
    }

    /// Returns the points of a formation \[m\]; empty for other areas.
    pub fn points(&self) -> Vec<Vec2> {
        if self.is_formation { self.cores.iter().map(|core| core.min).collect() } else { Vec::new() }
    }

    /// Returns the number of robots for which the area certainly has room, at most `wanted`.
    pub fn room(&self, arena: &Arena, wanted: usize) -> usize {
        let places = if self.is_formation { self.points() } else { self.fullest(arena) };
        let mut apart: Vec<Vec2> = Vec::new();
        for place in places {
            if apart.len() < wanted && is_apart(place, &apart, arena) && admits(self.is_formation, arena, place) {
                apart.push(place);
            }
        }
        apart.len()
    }

    /// Draws `count` places \[m\] in the area. It must have room for them.
    pub fn draw(&self, arena: &Arena, count: usize, stream: &mut Stream) -> Vec<Vec2> {
        let mut places = if self.is_formation { self.points() } else { Vec::new() };
        if !self.is_formation {
            for _ in 0..TRIES.0 {
                if let Some(drawn) = self.try_draw(arena, count, stream) {
                    return drawn;
                }
            }
            places = self.fullest(arena);
        }
        places.shuffle(stream);
        places.truncate(count);
        places
    }

    /// Draws a place \[m\] in the area beside those that are `taken`; `None` if there is none.
    pub fn draw_beside(&self, arena: &Arena, taken: &[Vec2], stream: &mut Stream) -> Option<Vec2> {
        let mut places = if self.is_formation { self.points() } else { Vec::new() };
        if !self.is_formation {
            let drawn = (0..TRIES.1).find_map(|_| self.try_place(arena, taken, stream));
            if drawn.is_some() {
                return drawn;
            }
            places = self.fullest(arena);
        }
        places.retain(|place| admits(self.is_formation, arena, *place) && is_apart(*place, taken, arena));
        places.choose(stream).copied()
    }

    /// Draws a point in the bounds of the area; `None` if no robot has its place there beside those that are `taken`.
    fn try_place(&self, arena: &Arena, taken: &[Vec2], stream: &mut Stream) -> Option<Vec2> {
        let (low, high) = self.bounds();
        let place = Vec2::new(stream.random_range(low.x..=high.x), stream.random_range(low.y..=high.y));
        (self.has(place) && admits(false, arena, place) && is_apart(place, taken, arena)).then_some(place)
    }

    fn try_draw(&self, arena: &Arena, count: usize, stream: &mut Stream) -> Option<Vec<Vec2>> {
        let mut drawn: Vec<Vec2> = Vec::with_capacity(count);
        for _ in 0..count {
            let place = (0..TRIES.1).find_map(|_| self.try_place(arena, &drawn, stream));
            drawn.push(place?);
        }
        Some(drawn)
    }

    /// Returns the points of that lattice at which most robots have room: of those with a point in the middle of the
    /// area along an axis, or two beside it.
    fn fullest(&self, arena: &Arena) -> Vec<Vec2> {
        let all = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|fewer| self.lattice(arena, fewer.into()));
        // The first of equal ones.
        all.into_iter().rev().max_by_key(Vec::len).expect("there are four")
    }

    /// Returns the points of a lattice in the area at which robots have room, with `fewer` points along each axis than
    /// it has room for.
    fn lattice(&self, arena: &Arena, fewer: Vec2) -> Vec<Vec2> {
        let (low, high) = self.bounds();
        let size = high - low;
        let step_m = (LATTICE * least_m(arena)).max(size.max() / MOST_POINTS);
        let steps = (size.map(|side| (side / step_m).floor()) - fewer).sup(&Vec2::zeros());
        let from = low + (size - steps * step_m) / 2.0;
        let column = |x: usize| (0..=steps.y as usize).map(move |y| from + Vec2::new(x as f32, y as f32) * step_m);
        let points = (0..=steps.x as usize).flat_map(column);
        points.filter(|point| self.has(*point) && admits(false, arena, *point)).collect()
    }

    fn bounds(&self) -> (Vec2, Vec2) {
        let low = self.cores.iter().skip(1).fold(self.cores[0].min, |low, core| low.inf(&core.min));
        let high = self.cores.iter().skip(1).fold(self.cores[0].max, |high, core| high.sup(&core.max));
        (low.add_scalar(-self.radius_m), high.add_scalar(self.radius_m))
    }

    fn has(&self, point: Vec2) -> bool {
        self.cores.iter().any(|core| core.distance(point) <= self.radius_m)
    }
}

/// Returns the least distance of two places \[m\].
pub fn least_m(arena: &Arena) -> f32 {
    APART * 2.0 * arena.robot_radius_m
}

/// Returns whether a robot may have its place at a point \[m\]. A place that is drawn also has room to move, and is
/// out of the bottlenecks.
fn admits(is_given: bool, arena: &Arena, place: Vec2) -> bool {
    let radius_m = arena.robot_radius_m;
    let room_m = ROOM_M * (radius_m / CHOSEN_FOR_M).min(1.0);
    let is_out = |portal: &Portal| {
        let [min, max] = [portal.near.inf(&portal.far), portal.near.sup(&portal.far)];
        KeepOut::rect(min, max).distance(place) >= 2.0 * radius_m
    };
    arena.has_room(place)
        && (is_given || arena.clearance(place) >= radius_m + room_m && arena.portals.iter().all(is_out))
}

fn is_apart(place: Vec2, others: &[Vec2], arena: &Arena) -> bool {
    others.iter().all(|other| (other - place).norm() >= least_m(arena))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Seed;

    fn open(half: f32) -> Arena {
        Arena::new(Vec2::repeat(half), Vec::new(), 0.25)
    }

    #[test]
    fn places_are_in_their_area_and_apart_also_where_it_is_almost_full() {
        let arena = open(2.0);
        for shape in [Shape::Rect([-1.0, -1.0, 1.0, 0.0]), Shape::Disc([0.5, 0.5, 0.9])] {
            let area = Area::of(&shape, 1.0);
            let room = area.room(&arena, 100);
            assert!((3..20).contains(&room), "{room}");
            for seed in 0..50 {
                let places = area.draw(&arena, room, &mut Seed::of_run(seed).stream("places"));
                assert_eq!(places.len(), room);
                for (at, place) in places.iter().enumerate() {
                    assert!(area.has(*place) && is_apart(*place, &places[..at], &arena), "{place:?}");
                }
            }
        }
    }

    #[test]
    fn distances_of_areas_are_those_of_their_nearest_points() {
        let rect = Area::of(&Shape::Rect([-1.0, -1.0, 0.0, 1.0]), 1.0);
        let disc = Area::of(&Shape::Disc([2.0, 0.0, 0.5]), 1.0);
        let points = Area::of(&Shape::Points(vec![[0.0, 4.0], [9.0, 9.0]]), 1.0);
        assert_eq!((rect.distance(&disc), rect.distance(&points)), (1.5, 3.0));
        assert_eq!(disc.distance(&Area::of(&Shape::Disc([2.5, 0.0, 0.5]), 1.0)), 0.0);
    }
}
