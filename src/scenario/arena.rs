//! The arena of a scenario: ground, solid blocks and the bottlenecks between them, in the world frame.

use crate::messages::geometry::Vec2;

/// A solid, axis-aligned block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeepOut {
    /// Lower left corner \[m\].
    pub min: Vec2,
    /// Upper right corner \[m\].
    pub max: Vec2,
}

/// A bottleneck that one robot at a time can pass, along the straight line between its two ends (mouths).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Portal {
    /// One mouth \[m\].
    pub near: Vec2,
    /// The other mouth \[m\].
    pub far: Vec2,
}

/// The ground, with its blocks and bottlenecks.
#[derive(Clone, Debug, PartialEq)]
pub struct Arena {
    /// Half the size of the ground \[m\]: largest distance of a robot's centre from the origin along x and y.
    pub half_extent: Vec2,
    /// Blocks that robots must not touch.
    pub keep_outs: Vec<KeepOut>,
    /// Bottlenecks between the blocks.
    pub portals: Vec<Portal>,
    /// Radius of a robot \[m\].
    pub robot_radius_m: f32,
}

impl KeepOut {
    /// Distance from a point to the block \[m\], zero inside.
    pub fn distance(&self, point: Vec2) -> f32 {
        (point - self.nearest(point)).norm()
    }

    /// The point of the block nearest to `point` \[m\].
    pub fn nearest(&self, point: Vec2) -> Vec2 {
        point.sup(&self.min).inf(&self.max)
    }

    /// Whether the straight line between two points intersects the block enlarged by `margin_m` on each side.
    pub fn blocks(&self, from: Vec2, to: Vec2, margin_m: f32) -> bool {
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
    /// Distance from a point to the nearest block \[m\]; infinite if there is none.
    pub fn clearance(&self, point: Vec2) -> f32 {
        self.keep_outs.iter().map(|block| block.distance(point)).fold(f32::INFINITY, f32::min)
    }

    /// The same ground for a point that is this far from the centres of robots \[m\]: their radius about it is larger.
    pub fn about_point(&self, ahead_m: f32) -> Arena {
        Arena { robot_radius_m: self.robot_radius_m + ahead_m, ..self.clone() }
    }

    /// Whether a robot's centre may be at `point` \[m\]: on the ground and touching no block.
    pub fn admits(&self, point: Vec2) -> bool {
        point.x.abs() <= self.half_extent.x
            && point.y.abs() <= self.half_extent.y
            && self.clearance(point) > self.robot_radius_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
