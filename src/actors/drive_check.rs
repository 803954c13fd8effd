//! Check of a short test drive of one robot: its measured displacement compared with the commanded one.

use crate::messages::geometry::{Planar, Vec2, wrapped};
use crate::messages::ids::RobotId;
use crate::safety::guard::SafetyCounts;

/// Commanded length of a test drive \[m\]: several times the noise of a tracker, and safe on a table.
pub(crate) const DISTANCE_M: f32 = 0.1;
/// Largest variation of a robot's measured position at rest \[m\] with which it is still driven. With more noise, a
/// drive of 10 cm cannot be judged.
pub(crate) const NOISE_M: f32 = 0.05;
/// Largest deviation of a test drive's measured direction from the commanded one that counts as correct \[rad\].
/// Mistakes in the axes give at least 45 degrees; the margin is for noise.
const DIRECTION_RAD: f32 = 30.0 * std::f32::consts::PI / 180.0;
/// Largest deviation of a test drive's measured distance that counts as correct, as a share of the commanded distance.
const SHARE: f32 = 0.5;
/// Smallest displacement that counts as motion \[m\]: three standard deviations of RTK GNSS (1 cm).
const MOVED_M: f32 = 0.03;
/// Smallest displacement that counts as motion, in multiples of the robot's largest displacement at rest.
const MOVED_NOISES: f32 = 1.2;

/// Result of the short test drive of one robot: whether it moved as commanded, or why not.
#[derive(Clone, Debug, PartialEq)]
pub enum DriveCheck {
    /// The robot moved correctly: measured distance \[m\], and deviation from the commanded direction \[rad\], positive
    /// to the left.
    Right(f32, f32),
    /// No reading of the robot has arrived, or none recently.
    Unseen,
    /// The robot's driver reports that it cannot follow commands, with the reason if it gave one.
    Unfit(Option<String>),
    /// The measured position of the robot at rest varies by this distance \[m\], which is too much to judge its motion.
    Noisy(f32),
    /// Every direction leads too close to a wall, the edge of the ground or another robot.
    NoRoom,
    /// The robot did not move. The list has the other robots that moved meanwhile; an empty list also means that the
    /// robot's guard did not stop it.
    Still(Vec<RobotId>),
    /// The robot moved, and so did the other robots in the list.
    Together(Vec<RobotId>),
    /// The robot moved in a wrong direction: the mistake in the axes that fits best, and the deviation from the
    /// commanded direction \[rad\], positive to the left.
    Astray(Axes, f32),
    /// The robot moved in the right direction, but by the distance given here \[m\] instead of `DISTANCE_M` (0.1 m).
    Distance(f32),
    /// The robot's guard stopped or slowed it, so that it did not drive the distance. The text lists the reasons.
    Held(String),
}

/// Mistake in the axes of a robot or of the source of its readings: a rotation or reflection of vectors in the plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axes {
    /// The axes have no mistake.
    Right,
    /// The sign of the x component of vectors is wrong.
    MirroredX,
    /// The sign of the y component of vectors is wrong.
    MirroredY,
    /// Both components of vectors have the wrong sign, which is a rotation by half a turn.
    Reversed,
    /// The x and y components of vectors are swapped.
    Swapped,
    /// Vectors are rotated by a quarter turn to the left.
    Left,
    /// Vectors are rotated by a quarter turn to the right.
    RightTurn,
    /// The x and y components of vectors are swapped, and both signs are wrong.
    SwappedReversed,
}

impl Axes {
    /// All eight values of [`Axes`], with no mistake first.
    pub(crate) const ALL: [Axes; 8] = [
        Axes::Right,
        Axes::MirroredX,
        Axes::MirroredY,
        Axes::Reversed,
        Axes::Swapped,
        Axes::Left,
        Axes::RightTurn,
        Axes::SwappedReversed,
    ];

    /// Returns the displacement that is measured for the commanded displacement if axes have this mistake.
    pub(crate) fn apply(self, commanded: Vec2) -> Vec2 {
        let [x, y] = commanded.to_array();
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

    /// Returns the mistake that turns `wanted` closest to the direction of `measured`.
    fn of(wanted: Vec2, measured: Vec2) -> Axes {
        let near = |axes: &Axes| axes.apply(wanted).dot(&measured);
        Axes::ALL.into_iter().max_by(|one, other| near(one).total_cmp(&near(other))).expect("there are eight")
    }
}

/// Whether the measured displacement `way` \[m\] exceeds what noise can explain, so that the robot has moved.
/// `noise_m` is the robot's largest measured displacement at rest \[m\].
pub(crate) fn has_moved(way: Vec2, noise_m: f32) -> bool {
    way.norm() > MOVED_M.max(MOVED_NOISES * noise_m)
}

/// Judges the test drive of a robot that was commanded to drive 0.1 m in the direction of the vector `along`, whose
/// length does not matter. `way` is the robot's measured displacement \[m\], `None` if it has not moved (see
/// [`has_moved`]); both are in the world frame. `others` are the other robots that moved during the drive, and `counts`
/// says how often the guard stopped or slowed the driven robot.
pub(crate) fn judge(along: Vec2, way: Option<Vec2>, others: Vec<RobotId>, counts: &SafetyCounts) -> DriveCheck {
    let held: Vec<&str> = counts.reasons().map(|(_, reason)| reason).collect();
    // The guard is the cause if it held the robot.
    let or_held = |verdict| if held.is_empty() { verdict } else { DriveCheck::Held(held.join(", ")) };
    let Some(way) = way else {
        return if others.is_empty() { or_held(DriveCheck::Still(others)) } else { DriveCheck::Still(others) };
    };
    if !others.is_empty() {
        return DriveCheck::Together(others);
    }
    let off = wrapped(f64::from(libm::atan2f(way.y, way.x) - libm::atan2f(along.y, along.x))) as f32;
    let distance = way.norm();
    if off.abs() > DIRECTION_RAD {
        DriveCheck::Astray(Axes::of(along, way), off)
    } else if (distance - DISTANCE_M).abs() > SHARE * DISTANCE_M {
        or_held(DriveCheck::Distance(distance))
    } else {
        DriveCheck::Right(distance, off)
    }
}
