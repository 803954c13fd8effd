//! Lengths of the shortest paths of one robot around the blocks of an arena, for the reward of training.
//!
//! Shortest paths turn at corners of blocks. The distances between all corners are computed once, so a length needs the
//! corners that are seen from both of its ends. Robots are taken as half as large as they are: their centres then never
//! come nearer to a block than paths do, and lengths have no jumps. Gaps that a robot cannot pass are closed.

use super::doors::fillings;
use crate::messages::geometry::Vec2;
use crate::scenario::{Arena, KeepOut};

/// Distance that paths keep from blocks, in radii of the robots.
const MARGIN: f32 = 0.5;
/// Distance \[m\] of a corner from its block beyond the margin: what rounding needs.
const BESIDE_M: f32 = 1e-3;

/// Corners of an arena at which paths turn, and the lengths of the shortest paths between them.
#[derive(Debug)]
pub struct Ways {
    blocks: Vec<KeepOut>,
    margin_m: f32,
    corners: Vec<Vec2>,
    /// Length of the shortest path \[m\] from each corner to each, row after row; infinite where there is none.
    lengths_m: Vec<f32>,
    /// Length \[m\] that is added to the straight line where there is no path.
    nowhere_m: f32,
}

impl Ways {
    /// Returns the ways of `arena`.
    pub fn new(arena: &Arena) -> Ways {
        let blocks = [&arena.keep_outs[..], &fillings(arena)].concat();
        let margin_m = MARGIN * arena.robot_radius_m;
        let nowhere_m = 4.0 * (arena.half_extent.x + arena.half_extent.y);
        let mut ways = Ways { blocks, margin_m, corners: Vec::new(), lengths_m: Vec::new(), nowhere_m };
        let corners = ways.blocks.iter().flat_map(|block| block.turns(margin_m + BESIDE_M));
        let is_free = |corner: &Vec2| {
            let on_ground = corner.x.abs() <= arena.half_extent.x && corner.y.abs() <= arena.half_extent.y;
            on_ground && !ways.blocks.iter().any(|block| block.is_within(*corner, margin_m))
        };
        let corners: Vec<Vec2> = corners.filter(is_free).collect();
        ways.corners = corners;
        ways.measure();
        ways
    }

    /// Computes the lengths between all corners (Floyd and Warshall).
    fn measure(&mut self) {
        let n = self.corners.len();
        let straight = |a: usize, b: usize| {
            let (from, to) = (self.corners[a], self.corners[b]);
            if self.sees(from, to) { (to - from).norm() } else { f32::INFINITY }
        };
        let mut lengths_m: Vec<f32> = (0..n * n).map(|at| straight(at / n, at % n)).collect();
        for by in 0..n {
            for from in 0..n {
                let first = lengths_m[from * n + by];
                for to in 0..n {
                    let whole = first + lengths_m[by * n + to];
                    if whole < lengths_m[from * n + to] {
                        lengths_m[from * n + to] = whole;
                    }
                }
            }
        }
        self.lengths_m = lengths_m;
    }

    /// Returns the length \[m\] of the shortest path from `from` to `to` \[m\], world frame; if there is none, a length
    /// that is longer than every path.
    #[inline]
    pub fn length_m(&self, from: Vec2, to: Vec2) -> f32 {
        let straight_m = (to - from).norm();
        if self.sees(from, to) { straight_m } else { self.around_m(from, to) }
    }

    /// Returns the length \[m\] of the shortest path by way of a corner, or longer than every path.
    fn around_m(&self, from: Vec2, to: Vec2) -> f32 {
        let seen = self.corners.iter().enumerate().filter(|(_, corner)| self.sees(**corner, to));
        let last: Vec<(usize, f32)> = seen.map(|(at, corner)| (at, (to - corner).norm())).collect();
        let n = self.corners.len();
        let mut shortest_m = f32::INFINITY;
        for (first, corner) in self.corners.iter().enumerate() {
            let row = &self.lengths_m[first * n..][..n];
            let rest_m = last.iter().map(|(at, last_m)| row[*at] + last_m).fold(f32::INFINITY, f32::min);
            let whole_m = (corner - from).norm() + rest_m;
            if whole_m < shortest_m && self.sees(from, *corner) {
                shortest_m = whole_m;
            }
        }
        if shortest_m.is_finite() { shortest_m } else { (to - from).norm() + self.nowhere_m }
    }

    /// Returns whether the straight line between two points is free. An end that is nearer to a block than paths are
    /// can leave it.
    fn sees(&self, from: Vec2, to: Vec2) -> bool {
        self.blocks.iter().filter(|block| block.may_block(from, to, self.margin_m)).all(|block| {
            let margin_m = self.margin_m.min(block.distance(from).min(block.distance(to)) - BESIDE_M);
            !block.blocks(from, to, margin_m)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Settings, build};

    #[test]
    fn lengths_lead_through_the_door_without_jumps_and_end_at_zero() {
        let passage = build("passage", &Settings::default()).expect("it is there");
        let ways = Ways::new(passage.arena());
        let goal = Vec2::new(1.2, -1.7);
        let path = [Vec2::new(1.5, 1.7), Vec2::new(0.3, 0.45), Vec2::new(0.3, -0.45), goal];
        let mut last = ways.length_m(path[0], goal);
        let straight = (goal - path[0]).norm();
        assert!(last > straight + 0.05 && last < straight + 1.5, "{last} m");
        for leg in path.windows(2) {
            let steps = ((leg[1] - leg[0]).norm() / 0.05).ceil();
            for step in 1..=steps as usize {
                let left = ways.length_m(leg[0] + (leg[1] - leg[0]) * (step as f32 / steps), goal);
                assert!(left < last + 1e-3 && last - left < 0.06, "{last} m, then {left} m");
                last = left;
            }
        }
        assert!(last < 1e-6);
    }

    #[test]
    fn every_length_is_at_least_a_straight_line_and_a_closed_room_is_far() {
        let wall = KeepOut::rect(Vec2::new(-2.0, -0.1), Vec2::new(2.0, 0.1));
        let closed = Arena::new(Vec2::repeat(2.0), vec![wall], 0.25);
        let (from, to) = (Vec2::new(0.0, -1.0), Vec2::new(0.0, 1.0));
        assert!(Ways::new(&closed).length_m(from, to) > 10.0);
        let open = Arena { keep_outs: Vec::new(), ..closed };
        assert_eq!(Ways::new(&open).length_m(from, to), 2.0);
    }
}
