//! Verdicts on a robot that was driven a short way: where it went, against where it should have gone.

use crate::messages::geometry::{Vec2, wrapped};
use crate::messages::ids::RobotId;
use crate::safety::guard::SafetyCounts;

/// Distance that a robot is driven \[m\]: several times the noise of a tracker, and safe on a bench.
pub const DISTANCE_M: f32 = 0.1;
/// Largest distance between two positions of a robot that stands \[m\]: beyond it, 10 cm cannot be judged.
pub const NOISE_M: f32 = 0.05;
/// Largest difference of directions \[rad\]. Mistakes in the axes give 45 degrees or more; the rest is for noise.
const DIRECTION_RAD: f32 = 30.0 * std::f32::consts::PI / 180.0;
/// Largest difference of distances, as a share.
const SHARE: f32 = 0.5;
/// Least displacement that counts as motion \[m\]: three standard deviations of RTK, 1 cm.
const MOVED_M: f32 = 0.03;
/// The same as a share of the robot's noise.
const MOVED_NOISES: f32 = 1.2;

/// Result of one robot.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// It went where it should: distance \[m\], and angle to the left of the right direction \[rad\].
    Right(f32, f32),
    /// No reading of it has arrived, or none any more.
    Unseen,
    /// Its driver reports that it does not follow commands, with the reason.
    Unfit(Option<String>),
    /// Its position varies by so much while it stands \[m\]: its motion cannot be judged.
    Noisy(f32),
    /// There is no direction without a wall, the edge of the ground or another robot near it.
    NoRoom,
    /// It did not move, and these did.
    Still(Vec<RobotId>),
    /// It moved, and these did, too.
    Together(Vec<RobotId>),
    /// It went in the direction that this mistake in the axes gives; angle to the left of the right direction \[rad\].
    Astray(Axes, f32),
    /// It went so far instead of `DISTANCE_M` \[m\].
    Distance(f32),
    /// Its guard has stopped or slowed it, for these reasons.
    Held(String),
}

/// Mistake in the axes of a robot or of its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axes {
    /// None of the others.
    Right,
    /// The sign of x is wrong.
    MirroredX,
    /// The sign of y is wrong.
    MirroredY,
    /// Both signs are wrong: half a turn.
    Reversed,
    /// x and y are swapped.
    Swapped,
    /// A quarter turn to the left.
    Left,
    /// A quarter turn to the right.
    RightTurn,
    /// Swapped, and both signs are wrong.
    SwappedReversed,
}

impl Axes {
    /// All of them.
    pub const ALL: [Axes; 8] = [
        Axes::Right,
        Axes::MirroredX,
        Axes::MirroredY,
        Axes::Reversed,
        Axes::Swapped,
        Axes::Left,
        Axes::RightTurn,
        Axes::SwappedReversed,
    ];

    /// The vector that this mistake makes of a vector.
    pub fn apply(self, Vec2 { x, y }: Vec2) -> Vec2 {
        match self {
            Axes::Right => Vec2::new(x, y),
            Axes::MirroredX => Vec2::new(-x, y),
            Axes::MirroredY => Vec2::new(x, -y),
            Axes::Reversed => Vec2::new(-x, -y),
            Axes::Swapped => Vec2::new(y, x),
            Axes::Left => Vec2::new(-y, x),
            Axes::RightTurn => Vec2::new(y, -x),
            Axes::SwappedReversed => Vec2::new(-y, -x),
        }
    }

    /// The mistake whose direction is nearest to the measured one.
    fn of(wanted: Vec2, measured: Vec2) -> Axes {
        let near = |axes: &Axes| axes.apply(wanted).dot(&measured);
        Axes::ALL.into_iter().max_by(|one, other| near(one).total_cmp(&near(other))).expect("there are eight")
    }
}

/// Whether a robot with this noise \[m\] has moved.
pub fn has_moved(way: Vec2, noise_m: f32) -> bool {
    way.norm() > MOVED_M.max(MOVED_NOISES * noise_m)
}

/// Judges a robot that was commanded to drive 0.1 m in the direction `along`, of any length, world frame. `way` is the
/// robot's measured displacement \[m\], world frame; `None` if it has not moved (see [`has_moved`]). `others` are the
/// other robots that have moved meanwhile; `counts` says how often the robot's guard stopped or slowed it meanwhile.
pub fn judge(along: Vec2, way: Option<Vec2>, others: Vec<RobotId>, counts: &SafetyCounts) -> Verdict {
    let held: Vec<&str> = counts.reasons().map(|(_, reason)| reason).collect();
    // A robot that was held is not one that cannot move.
    let or_held = |verdict| if held.is_empty() { verdict } else { Verdict::Held(held.join(", ")) };
    let Some(way) = way else {
        return if others.is_empty() { or_held(Verdict::Still(others)) } else { Verdict::Still(others) };
    };
    if !others.is_empty() {
        return Verdict::Together(others);
    }
    let off = wrapped(f64::from(libm::atan2f(way.y, way.x) - libm::atan2f(along.y, along.x))) as f32;
    let distance = way.norm();
    if off.abs() > DIRECTION_RAD {
        Verdict::Astray(Axes::of(along, way), off)
    } else if (distance - DISTANCE_M).abs() > SHARE * DISTANCE_M {
        or_held(Verdict::Distance(distance))
    } else {
        Verdict::Right(distance, off)
    }
}
