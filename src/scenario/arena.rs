//! The arena of a scenario: ground, solid blocks (walls), the bottlenecks between them, and moving obstacles. All
//! points of an arena are in the same frame, usually the world frame.

use std::borrow::Cow;

use super::block::KeepOut;
use super::mover::Mover;
use crate::messages::geometry::Vec2;
use crate::time::Span;

/// Radius of a robot's hull, as a share of the radius that is kept free about its centre.
const HULL_PER_ROOM: f32 = 0.64;

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
    /// Moving obstacles, which are there while an episode runs; empty if there are none. All else of the arena stands.
    pub movers: Vec<Mover>,
    /// Radius that is kept free about each robot's centre \[m\], as in the paper authors' published environment: more
    /// than that of its hull (`Arena::hull_m`).
    pub robot_radius_m: f32,
}

impl Arena {
    /// Returns an arena with these blocks, and without bottlenecks and moving obstacles. The half extent and the radius
    /// that is kept free about each robot's centre are \[m\].
    pub fn new(half_extent: Vec2, keep_outs: Vec<KeepOut>, robot_radius_m: f32) -> Arena {
        Arena { half_extent, keep_outs, portals: Vec::new(), movers: Vec::new(), robot_radius_m }
    }

    /// Returns the arena at an instant, in which the moving obstacles stand among the blocks. `elapsed` is the time
    /// since the episode runs; while none runs, it is `None`, and there are no moving obstacles.
    #[inline]
    pub fn at(&self, elapsed: Option<Span>) -> Cow<'_, Arena> {
        if self.movers.is_empty() { Cow::Borrowed(self) } else { Cow::Owned(self.moved(elapsed)) }
    }

    fn moved(&self, elapsed: Option<Span>) -> Arena {
        let mut now = Arena { movers: Vec::new(), ..self.clone() };
        now.keep_outs.extend(elapsed.iter().flat_map(|elapsed| self.movers.iter().map(|mover| mover.block(*elapsed))));
        now
    }

    /// Returns the distance from `point` \[m\] to the nearest block \[m\]; infinite if the arena has no blocks.
    #[inline]
    pub fn clearance(&self, point: Vec2) -> f32 {
        let squares = self.keep_outs.iter().map(|block| (point - block.nearest(point)).norm_squared());
        // The square root keeps the order of lengths.
        squares.fold(f32::INFINITY, f32::min).sqrt()
    }

    /// Returns the radius of each robot's hull \[m\]: as the paper's robots have 0.16 m in an environment whose robots
    /// have 0.25 m.
    #[inline]
    pub fn hull_m(&self) -> f32 {
        self.robot_radius_m * HULL_PER_ROOM
    }

    /// Returns a copy of the arena in which the robots' radius is larger by `ahead_m` \[m\]. It is for planning the
    /// path of a point that lies `ahead_m` ahead of a robot's centre: the robot's hull is within the larger radius
    /// about that point.
    pub(crate) fn about_point(&self, ahead_m: f32) -> Arena {
        Arena { robot_radius_m: self.robot_radius_m + ahead_m, ..self.clone() }
    }

    /// Returns true if a robot may start at `point` \[m\], world frame, and stand there: on the ground, and touching no
    /// block and no way of a moving obstacle.
    pub(crate) fn has_room(&self, point: Vec2) -> bool {
        let mut ways = self.movers.iter().flat_map(Mover::ways);
        self.admits(point) && ways.all(|way| way.distance(point) > self.robot_radius_m)
    }

    /// Returns true if a robot's centre may be at `point` \[m\], world frame: on the ground and touching no block that
    /// stands.
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
        let arena = Arena::new(Vec2::zeros(), Vec::new(), 0.25);
        assert_eq!(arena.hull_m(), crate::scenario::size::HULL_M);
    }
}
