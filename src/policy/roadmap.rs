//! Paths of one robot through any arena of blocks and bottlenecks, for scripted navigation. Other robots are not
//! considered.
//!
//! The shortest path between two points turns at corners of blocks alone, at the distance that a robot keeps from
//! them. So the places of a roadmap are those corners, connected where the straight line between them is free (a
//! visibility graph). A bottleneck is passed straight, by its two mouths, and not along its corners.

use pathfinding::prelude::dijkstra;

use super::route::{is_free, margin_m};
use crate::messages::geometry::Vec2;
use crate::scenario::{Arena, KeepOut, Portal};

/// Distance \[m\] of a place from the block that it is at, beyond the clearance that paths keep: what rounding needs.
const BESIDE_M: f32 = 1e-3;

/// Places of an arena at which paths turn, and the free straight lines between them.
#[derive(Debug)]
pub struct Roadmap {
    arena: Arena,
    places: Vec<Place>,
    /// Indices of the places to which a free straight line leads from each.
    ways: Vec<Vec<usize>>,
}

/// Place at which a path may turn.
#[derive(Clone, Copy, Debug)]
struct Place {
    at: Vec2,
    /// Bottleneck of which this is a mouth; `None` at the corner of a block.
    mouth_of: Option<usize>,
}

impl Roadmap {
    /// Returns the roadmap of `arena`, in its frame and for its robots.
    pub fn new(arena: &Arena) -> Roadmap {
        let mouths = arena
            .portals
            .iter()
            .enumerate()
            .flat_map(|(index, &Portal { near, far })| [near, far].map(|at| Place { at, mouth_of: Some(index) }));
        let corners = arena.keep_outs.iter().flat_map(|block| turns(arena, block));
        let places: Vec<Place> = mouths.chain(corners.map(|at| Place { at, mouth_of: None })).collect();
        let mut map = Roadmap { arena: arena.clone(), ways: Vec::new(), places };
        let all = 0..map.places.len();
        map.ways = all.clone().map(|from| all.clone().filter(|to| map.leads(from, *to)).collect()).collect();
        map
    }

    /// Returns the points to pass on the shortest path of a robot from `from` to `to`, which is the last of them, all
    /// \[m\] in the frame of the arena; `None` if there is no path. It keeps the robots' radius and a margin clear of
    /// blocks, except where `from` or `to` itself is nearer.
    pub fn path(&self, from: Vec2, to: Vec2) -> Option<Vec<Vec2>> {
        if is_free(&self.arena, from, to) {
            return Some(vec![to]);
        }
        let [start, goal] = [self.places.len(), self.places.len() + 1];
        let at = |index: usize| self.places.get(index).map_or(if index == start { from } else { to }, |place| place.at);
        let successors = |&here: &usize| {
            let all = 0..self.places.len();
            let next: Vec<usize> = match here {
                here if here == start => all.filter(|place| self.is_reached(from, *place)).collect(),
                here if here == goal => Vec::new(),
                place => {
                    let free = is_free(&self.arena, at(place), to) || self.leaves(to, at(place));
                    let arrives = self.is_beside(place, to) && free;
                    self.ways[place].iter().copied().chain(arrives.then_some(goal)).collect()
                }
            };
            next.into_iter().map(move |next| (next, micrometres(at(here), at(next))))
        };
        let (path, _) = dijkstra(&start, successors, |place| *place == goal)?;
        Some(path.into_iter().skip(1).map(at).collect())
    }

    /// Returns whether a robot at `from` \[m\] can drive straight to the place with the index `place`: on a free line
    /// or, where the robot is nearer to a block than paths are, on one that leaves the block.
    fn is_reached(&self, from: Vec2, place: usize) -> bool {
        let Place { at, .. } = self.places[place];
        is_free(&self.arena, from, at) || self.is_beside(place, from) && self.leaves(from, at)
    }

    /// Returns whether the straight line from `from` to `to` \[m\] touches no block and comes no nearer to one than its
    /// nearer end. From inside a block, where noise may put a robot, it can leave.
    fn leaves(&self, from: Vec2, to: Vec2) -> bool {
        let outside = self.arena.keep_outs.iter().filter(|block| block.distance(from) > 0.0);
        outside.into_iter().all(|block| {
            let ends = block.distance(from).min(block.distance(to));
            let passes = block.corners().map(|corner| distance(from, to, corner) - block.radius_m());
            !block.blocks(from, to, 0.0) && passes.fold(ends, f32::min) >= margin_m(&self.arena).min(ends - BESIDE_M)
        })
    }

    /// Returns whether a path may lead straight from one place to another, both given by their indices.
    fn leads(&self, from: usize, to: usize) -> bool {
        let [a, b] = [self.places[from], self.places[to]];
        let through = a.mouth_of.is_some() && a.mouth_of == b.mouth_of;
        let beside = self.is_beside(from, b.at) && self.is_beside(to, a.at);
        from != to && (through || beside) && is_free(&self.arena, a.at, b.at)
    }

    /// Returns whether `point` \[m\] lies on the same side of the bottleneck as the mouth with the index `place`, since
    /// the bottleneck is passed from mouth to mouth; true for all other places.
    fn is_beside(&self, place: usize, point: Vec2) -> bool {
        let Place { at, mouth_of } = self.places[place];
        mouth_of.is_none_or(|portal| {
            let Portal { near, far } = self.arena.portals[portal];
            let middle = (near + far) / 2.0;
            (point - middle).dot(&(at - middle)) >= 0.0
        })
    }
}

/// Returns the points \[m\] at which paths turn around `block`, at the clearance that paths keep. Those at which no
/// robot can be and those within a bottleneck are left out.
fn turns<'a>(arena: &'a Arena, block: &'a KeepOut) -> impl Iterator<Item = Vec2> + 'a {
    block.turns(margin_m(arena) + BESIDE_M).into_iter().filter(move |corner| {
        let within = |portal: &Portal| {
            let along = portal.far - portal.near;
            let share = (corner - portal.near).dot(&along) / along.norm_squared();
            let middle = portal.near + along * share;
            (0.0..=1.0).contains(&share)
                && (corner - middle).norm() < block.distance(middle)
                && is_free(arena, *corner, middle)
        };
        arena.admits(*corner) && !arena.portals.iter().any(within)
    })
}

/// Returns the distance \[m\] of `point` from the straight line between `from` and `to` \[m\].
fn distance(from: Vec2, to: Vec2, point: Vec2) -> f32 {
    let along = to - from;
    let share = ((point - from).dot(&along) / along.norm_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
    (from + along * share - point).norm()
}

/// Returns the length of a straight line \[µm\]; a path with fewer points is preferred to another of the same length.
fn micrometres(from: Vec2, to: Vec2) -> u64 {
    (f64::from((to - from).norm()) * 1e6) as u64 + 1
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::messages::geometry::Motion;
    use crate::observation::Observation;
    use crate::policy::Policy;
    use crate::policy::orca::Orca;
    use crate::random::Seed;
    use crate::scenario::{Settings, build};
    use crate::world::{Physics, kinematic};

    fn arena(half: f32, blocks: &[[f32; 4]]) -> Arena {
        let block = |&[x, y, far_x, far_y]: &[f32; 4]| KeepOut::rect(Vec2::new(x, y), Vec2::new(far_x, far_y));
        Arena::new(Vec2::repeat(half), blocks.iter().map(block).collect(), 0.25)
    }

    fn two_walls() -> Arena {
        arena(4.0, &[[-4.0, -1.2, 2.0, -1.0], [-2.0, 1.0, 4.0, 1.2]])
    }

    fn pocket() -> Arena {
        arena(4.0, &[[-1.5, 1.0, 1.5, 1.3], [-1.5, -2.0, -1.2, 1.0], [1.2, -2.0, 1.5, 1.0]])
    }

    fn maze() -> Arena {
        let walls = [[-3.0, -4.0, -2.8, 2.5], [-1.0, -2.5, -0.8, 4.0], [1.0, -4.0, 1.2, 2.5], [2.8, -2.5, 3.0, 4.0]];
        arena(4.0, &[walls.as_slice(), &[[-1.0, -2.5, 0.0, -2.3], [2.2, 0.0, 2.8, 0.2]]].concat())
    }

    /// Smallest distance \[m\] from a block along a path.
    fn nearest(arena: &Arena, from: Vec2, path: &[Vec2]) -> f32 {
        let points = [from].into_iter().chain(path.iter().copied());
        let lines = points.zip(path).flat_map(|(a, b)| (0..=200).map(move |at| a + (b - a) * (at as f32 / 200.0)));
        lines.map(|point| arena.clearance(point)).fold(f32::INFINITY, f32::min)
    }

    #[test]
    fn a_bottleneck_is_passed_by_its_mouths() {
        let passage = build("passage", &Settings::default()).unwrap();
        let map = Roadmap::new(passage.arena());
        let Portal { near, far } = map.arena.portals[0];
        assert_eq!(map.places.len(), 2, "not along the ends of its walls");
        let (from, to) = (Vec2::new(1.5, -1.5), Vec2::new(1.0, 1.5));
        assert_eq!(map.path(from, to), Some(vec![near, far, to]));
        assert_eq!(map.path(to, from), Some(vec![far, near, from]));
        assert_eq!(map.path(near, to), Some(vec![far, to]));
        assert_eq!(map.path(from, Vec2::new(-1.5, -1.5)), Some(vec![Vec2::new(-1.5, -1.5)]));
    }

    /// The path through one bottleneck: by the mouths, in the direction that is shorter, and straight to the second as
    /// soon as the line to it is free.
    fn through(arena: &Arena, from: Vec2, to: Vec2) -> Vec<Vec2> {
        let Portal { near, far } = arena.portals[0];
        let length = |[entry, exit]: [Vec2; 2]| (entry - from).norm() + (to - exit).norm();
        let [entry, exit] = if length([near, far]) <= length([far, near]) { [near, far] } else { [far, near] };
        match (is_free(arena, from, to), is_free(arena, from, exit)) {
            (true, _) => vec![to],
            (_, true) => vec![exit, to],
            _ => vec![entry, exit, to],
        }
    }

    #[test]
    fn there_is_a_path_from_wherever_a_robot_can_be_at_a_bottleneck() {
        use rand::RngExt;
        let passage = build("passage", &Settings::default()).unwrap();
        let mut stream = Seed::of_run(5).stream("ends");
        for ahead_m in [0.0, 0.05, 0.1] {
            let arena = passage.arena().about_point(ahead_m);
            let map = Roadmap::new(&arena);
            assert_eq!(map.places.len(), 2);
            for _ in 0..20_000 {
                // A robot's point, or its goal, is at times nearer to the wall than the larger radius.
                let mut end = |wide: f32| loop {
                    let at = Vec2::new(stream.random_range(-wide..wide), stream.random_range(-wide..wide));
                    if passage.arena().admits(at) {
                        return at;
                    }
                };
                let (from, to) = (end(0.8), end(2.0));
                let path = map.path(from, to).unwrap_or_else(|| panic!("none from {from:?} to {to:?} at {ahead_m}"));
                // One whose goal is on its side of the wall stays there.
                let expected = if from.y * to.y < 0.0 { through(&arena, from, to) } else { path.clone() };
                assert_eq!(path, expected, "from {from:?} to {to:?} at {ahead_m}");
                let stays = from.y * to.y <= 0.0 || path.iter().all(|point| point.y * to.y > 0.0);
                assert!(stays, "from {from:?} to {to:?} at {ahead_m}: {path:?}");
            }
        }
    }

    #[test]
    fn two_walls_a_pocket_and_a_maze_are_driven_through_without_a_touch() {
        let ways = [
            ("two walls", two_walls(), Vec2::new(-3.0, -3.0), Vec2::new(3.0, 3.0), 3),
            ("a pocket", pocket(), Vec2::new(0.0, 0.3), Vec2::new(0.0, 3.0), 2),
            ("a maze", maze(), Vec2::new(-3.5, -3.5), Vec2::new(3.5, -3.0), 6),
        ];
        for (name, arena, from, to, turns) in ways {
            let path = Roadmap::new(&arena).path(from, to).unwrap_or_else(|| panic!("{name}: no path"));
            assert!(path.len() > turns && nearest(&arena, from, &path) > arena.robot_radius_m, "{name}: {path:?}");
            let mut plant = kinematic::build(&arena, &Physics::published(&arena), &[from], Seed::of_run(0));
            let (mut orca, mut stream) = (Orca::new(&arena), Seed::of_run(1).stream("none"));
            let arrived = (0..1200).any(|_| {
                let state = plant.states()[0];
                assert!(!state.contacts.wall, "{name}: at {:?}", state.motion.position);
                let own = Observation::new(state.motion, to);
                let mut features = [0.0; 3];
                orca.encode(&own, &mut features);
                plant.drive(0, orca.act(&own, &features, &[], &mut stream));
                plant.advance();
                (state.motion.position - to).norm() < 0.05
            });
            assert!(arrived, "{name}: it stands at {:?}", plant.states()[0].motion.position);
        }
    }

    #[test]
    fn where_no_path_leads_a_robot_stands_and_out_of_a_block_it_leaves() {
        let closed = arena(4.0, &[[-4.0, -0.1, 4.0, 0.1]]);
        let (from, to) = (Vec2::new(0.0, -2.0), Vec2::new(0.0, 2.0));
        assert_eq!(Roadmap::new(&closed).path(from, to), None);
        let command = Orca::new(&closed).act(
            &Observation::new(Motion::at_rest(from), to),
            &[0.25, 0.0, 0.0],
            &[],
            &mut Seed::of_run(1).stream("none"),
        );
        assert_eq!(command, Vec2::zeros());
        assert!(Roadmap::new(&two_walls()).path(Vec2::new(0.0, -1.1), to).is_some(), "noise puts it into a wall");
    }

    /// Whether `to` is reached from `from` by steps of 0.1 m between points that are clearly farther from every block
    /// than paths need.
    fn is_connected(arena: &Arena, from: Vec2, to: Vec2) -> bool {
        let apart = |block: &KeepOut, at: Vec2| (at - block.nearest(at)).abs().max();
        let open = |at: Vec2| arena.keep_outs.iter().all(|block| apart(block, at) > margin_m(arena) + 0.11);
        let cell = |at: Vec2| [(at.x * 10.0).round() as i32, (at.y * 10.0).round() as i32];
        let point = |[x, y]: [i32; 2]| Vec2::new(x as f32, y as f32) / 10.0;
        let (mut seen, mut open_cells) = (std::collections::BTreeSet::new(), vec![cell(from)]);
        while let Some(here @ [x, y]) = open_cells.pop() {
            let on_ground = point(here).abs().max() < arena.half_extent.x - 0.1;
            if on_ground && open(point(here)) && seen.insert(here) {
                open_cells.extend([[x + 1, y], [x - 1, y], [x, y + 1], [x, y - 1]]);
            }
        }
        seen.contains(&cell(from)) && seen.contains(&cell(to))
    }

    proptest! {
        #[test]
        fn every_path_is_clear_of_walls_and_is_found_where_there_is_one(
            blocks in prop::collection::vec(
                (-4.0..4.0f32, -4.0..4.0f32, 0.05..4.0f32, 0.05..1.0f32, any::<bool>()),
                0..8,
            ),
            ends in prop::array::uniform2((-3.7..3.7f32, -3.7..3.7f32)),
        ) {
            let block = |&(x, y, long, wide, upright): &(f32, f32, f32, f32, bool)| match upright {
                true => [x, y, x + wide, y + long],
                false => [x, y, x + long, y + wide],
            };
            let arena = arena(4.0, &blocks.iter().map(block).collect::<Vec<_>>());
            let [from, to] = ends.map(|(x, y)| Vec2::new(x, y));
            prop_assume!(arena.admits(from) && arena.admits(to));
            match Roadmap::new(&arena).path(from, to) {
                Some(path) => {
                    prop_assert_eq!(path.last(), Some(&to));
                    let room_m = nearest(&arena, from, &path);
                    prop_assert!(room_m > arena.robot_radius_m - 2e-3 && room_m > arena.hull_m(), "{room_m}: {path:?}");
                    prop_assert!(path.iter().all(|point| point.abs().max() <= 4.0), "{path:?}");
                }
                None => prop_assert!(!is_connected(&arena, from, to), "no path from {from:?} to {to:?}"),
            }
        }
    }
}
