//! The way through an arena: which point to steer for next, and who goes first through a bottleneck. Pure
//! geometry, used by the scripted policy.

use crate::messages::geometry::Vec2;
use crate::scenario::{Arena, Portal};

/// Extra room between a robot's hull and a block on a planned way \[m\].
const MARGIN_M: f32 = 0.03;

/// Where to steer for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leg {
    /// Straight to the destination.
    Direct,
    /// Through a bottleneck.
    Through(Crossing),
}

/// A way through a bottleneck, from one mouth to the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// The mouth on this side \[m\].
    pub entry: Vec2,
    /// The mouth on the other side \[m\].
    pub exit: Vec2,
}

impl Crossing {
    /// The point to steer for from `at` \[m\]: the exit once nothing stands before it, else the entry.
    pub fn aim(&self, arena: &Arena, at: Vec2) -> Vec2 {
        if is_free(arena, at, self.exit) { self.exit } else { self.entry }
    }

    /// How far it is to the middle of the bottleneck \[m\]; negative behind it.
    pub fn ahead(&self, arena: &Arena, at: Vec2) -> f32 {
        let half = (self.exit - self.entry).norm() / 2.0;
        let along = (self.exit - self.entry) / (2.0 * half);
        if is_free(arena, at, self.exit) {
            (self.exit - at).dot(&along) - half
        } else {
            (self.entry - at).norm() + half
        }
    }
}

/// Whether the straight way between two points is free for a robot.
pub fn is_free(arena: &Arena, from: Vec2, to: Vec2) -> bool {
    // A robot that is nearer to a block than the margin must still be able to leave it.
    let margin = |block_distance: f32| (arena.robot_radius_m + MARGIN_M).min(block_distance - 1e-3);
    arena.keep_outs.iter().all(|block| !block.blocks(from, to, margin(block.distance(from).min(block.distance(to)))))
}

/// The next leg of the way from `from` to `to` \[m\].
pub fn leg(arena: &Arena, from: Vec2, to: Vec2) -> Leg {
    if is_free(arena, from, to) {
        return Leg::Direct;
    }
    let length = |crossing: &Crossing| (crossing.entry - from).norm() + (to - crossing.exit).norm();
    let crossings = arena.portals.iter().map(|&Portal { near, far }| {
        let (a, b) = (Crossing { entry: near, exit: far }, Crossing { entry: far, exit: near });
        if length(&a) <= length(&b) { a } else { b }
    });
    match crossings.min_by(|a, b| length(a).total_cmp(&length(b))) {
        Some(crossing) => Leg::Through(crossing),
        None => Leg::Direct,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Settings, build};

    #[test]
    fn the_way_to_the_other_side_leads_through_the_gap() {
        let passage = build("passage", &Settings { robots: None }).unwrap();
        let arena = passage.arena();
        let (from, to) = (Vec2::new(1.5, -1.5), Vec2::new(1.0, 1.5));
        let Leg::Through(crossing) = leg(arena, from, to) else { panic!("a wall stands between") };
        assert!(crossing.entry.y < 0.0 && crossing.exit.y > 0.0);
        assert_eq!(crossing.aim(arena, from), crossing.entry);
        assert_eq!(crossing.aim(arena, Vec2::new(0.0, -0.5)), crossing.exit);
        assert!(crossing.ahead(arena, from) > crossing.ahead(arena, Vec2::new(0.0, -0.5)));
        assert_eq!(leg(arena, from, Vec2::new(-1.5, -1.5)), Leg::Direct);
    }
}
