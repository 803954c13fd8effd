//! The arena of a scenario: ground, solid blocks (walls) and the bottlenecks between them. All points of an arena are
//! in the same frame, usually the world frame.

use crate::messages::geometry::{Planar, Vec2};

/// Radius of a robot's hull, as a share of the radius that is kept free about its centre.
const HULL_PER_ROOM: f32 = 0.64;

/// Solid, axis-aligned rectangular block in an arena, such as a part of a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeepOut {
    /// Corner with the smallest x and y \[m\], world frame.
    pub min: Vec2,
    /// Corner with the largest x and y \[m\], world frame.
    pub max: Vec2,
}

/// Bottleneck between blocks that one robot at a time can pass, along the straight line between its two ends (mouths).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Portal {
    /// Mouth (end) of the bottleneck on one side \[m\], world frame.
    pub(crate) near: Vec2,
    /// Mouth (end) of the bottleneck on the other side \[m\], world frame.
    pub(crate) far: Vec2,
}

/// Ground on which a team moves, with its solid blocks and bottlenecks. The origin is the middle of the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct Arena {
    /// Half the size of the ground along x and y \[m\]: largest distance of a robot's centre from the origin along each
    /// axis.
    pub half_extent: Vec2,
    /// Solid blocks, which robots must not touch; empty for open ground.
    pub keep_outs: Vec<KeepOut>,
    /// Bottlenecks between the blocks, through which scripted navigation plans its paths; empty if there are none.
    pub portals: Vec<Portal>,
    /// Radius that is kept free about each robot's centre \[m\], as in the paper authors' published environment: more
    /// than that of its hull (`Arena::hull_m`).
    pub robot_radius_m: f32,
}

impl KeepOut {
    /// Returns smallest x and y, then largest x and y of the block \[m\], world frame.
    pub fn corners(&self) -> [f32; 4] {
        [self.min.x, self.min.y, self.max.x, self.max.y]
    }

    /// Returns the distance from `point` \[m\], world frame, to the block \[m\]; zero inside the block.
    pub(crate) fn distance(&self, point: Vec2) -> f32 {
        (point - self.nearest(point)).norm()
    }

    /// Returns the point of the block that is nearest to `point`, both \[m\] in the world frame; `point` itself if it
    /// is inside.
    pub fn nearest(&self, point: Vec2) -> Vec2 {
        point.sup(&self.min).inf(&self.max)
    }

    /// Returns true if the straight line from `from` to `to` \[m\] intersects the block enlarged by `margin_m` \[m\] on
    /// each side.
    pub(crate) fn blocks(&self, from: Vec2, to: Vec2, margin_m: f32) -> bool {
        // Slab method: the part of the line that is inside the enlarged block along both axes.
        let (mut enter, mut leave) = (0.0f32, 1.0f32);
        for axis in 0..2 {
            let [min, max, from, to] = [self.min, self.max, from, to].map(|point| point.to_array()[axis]);
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
}

impl Arena {
    /// Returns the distance from `point` \[m\] to the nearest block \[m\]; infinite if the arena has no blocks.
    pub fn clearance(&self, point: Vec2) -> f32 {
        self.keep_outs.iter().map(|block| block.distance(point)).fold(f32::INFINITY, f32::min)
    }

    /// Returns the radius of each robot's hull \[m\]: as the paper's robots have 0.16 m in an environment whose robots
    /// have 0.25 m.
    pub fn hull_m(&self) -> f32 {
        self.robot_radius_m * HULL_PER_ROOM
    }

    /// Returns a copy of the arena in which the robots' radius is larger by `ahead_m` \[m\]. It is for planning the
    /// path of a point that lies `ahead_m` ahead of a robot's centre: the robot's hull is within the larger radius
    /// about that point.
    pub(crate) fn about_point(&self, ahead_m: f32) -> Arena {
        Arena { robot_radius_m: self.robot_radius_m + ahead_m, ..self.clone() }
    }

    /// Returns true if a robot's centre may be at `point` \[m\], world frame: on the ground and touching no block.
    pub(crate) fn admits(&self, point: Vec2) -> bool {
        point.x.abs() <= self.half_extent.x
            && point.y.abs() <= self.half_extent.y
            && self.clearance(point) > self.robot_radius_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hull_of_the_published_robots_is_that_of_the_paper() {
        let arena = Arena { half_extent: Vec2::zeros(), keep_outs: vec![], portals: vec![], robot_radius_m: 0.25 };
        assert_eq!(arena.hull_m(), crate::scenario::size::HULL_M);
    }

    #[test]
    fn a_block_intersects_the_lines_that_come_within_the_margin() {
        let block = KeepOut { min: Vec2::new(0.5, -0.15), max: Vec2::new(2.0, 0.15) };
        assert!(block.blocks(Vec2::new(1.0, -1.0), Vec2::new(1.0, 1.0), 0.0));
        assert!(!block.blocks(Vec2::new(0.0, -1.0), Vec2::new(0.0, 1.0), 0.25));
        assert!(block.blocks(Vec2::new(0.3, -1.0), Vec2::new(0.3, 1.0), 0.25));
        assert!(!block.blocks(Vec2::new(1.0, -1.0), Vec2::new(-1.0, -1.0), 0.25));
        assert!((block.distance(Vec2::new(0.2, 0.55)) - 0.5).abs() < 1e-6);
    }
}
