//! Points, velocities and types made of them. SI units; x and y right-handed (REP-103).

use std::fmt;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// A point \[m\] or a velocity \[m/s\] in the plane.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Vec2 {
    /// Along the first axis.
    pub x: f32,
    /// Along the second.
    pub y: f32,
}

impl Vec2 {
    /// The vector with these coordinates.
    #[inline(always)]
    pub const fn new(x: f32, y: f32) -> Vec2 {
        Vec2 { x, y }
    }

    /// The origin, or standing still.
    #[inline(always)]
    pub const fn zeros() -> Vec2 {
        Vec2::new(0.0, 0.0)
    }

    /// The same number along both axes.
    #[inline(always)]
    pub const fn repeat(both: f32) -> Vec2 {
        Vec2::new(both, both)
    }

    /// The direction of the first axis.
    #[inline(always)]
    pub const fn x() -> Vec2 {
        Vec2::new(1.0, 0.0)
    }

    /// The direction of the second axis.
    #[inline(always)]
    pub const fn y() -> Vec2 {
        Vec2::new(0.0, 1.0)
    }

    /// Both coordinates as an array.
    #[inline(always)]
    pub const fn to_array(self) -> [f32; 2] {
        [self.x, self.y]
    }

    /// Applies a function to each coordinate.
    #[inline(always)]
    pub fn map(self, mut of: impl FnMut(f32) -> f32) -> Vec2 {
        Vec2::new(of(self.x), of(self.y))
    }

    /// The lesser of two coordinates, along each axis.
    #[inline(always)]
    pub fn inf(&self, other: &Vec2) -> Vec2 {
        Vec2::new(self.x.min(other.x), self.y.min(other.y))
    }

    /// The greater of two coordinates, along each axis.
    #[inline(always)]
    pub fn sup(&self, other: &Vec2) -> Vec2 {
        Vec2::new(self.x.max(other.x), self.y.max(other.y))
    }

    /// The product of two coordinates, along each axis.
    #[inline(always)]
    pub fn component_mul(&self, other: &Vec2) -> Vec2 {
        Vec2::new(self.x * other.x, self.y * other.y)
    }

    /// The scalar product.
    #[inline(always)]
    pub fn dot(&self, other: &Vec2) -> f32 {
        self.x * other.x + self.y * other.y
    }

    /// The square of the length.
    #[inline(always)]
    pub fn norm_squared(&self) -> f32 {
        self.dot(self)
    }

    /// The length.
    #[inline(always)]
    pub fn norm(&self) -> f32 {
        self.norm_squared().sqrt()
    }

    /// Returns the vector with its length limited to `most`.
    pub fn cap_magnitude(self, most: f32) -> Vec2 {
        let length = self.norm();
        if length > most { self * (most / length) } else { self }
    }

    /// Returns the unit vector of this direction; NaN for a zero vector.
    #[inline(always)]
    pub fn normalize(&self) -> Vec2 {
        *self / self.norm()
    }

    /// Returns the unit vector, unless the length is `least` or below.
    #[inline(always)]
    pub fn try_normalize(&self, least: f32) -> Option<Vec2> {
        let norm = self.norm();
        if norm <= least { None } else { Some(*self / norm) }
    }

    /// Absolute value of each coordinate.
    #[inline(always)]
    pub fn abs(&self) -> Vec2 {
        Vec2::new(self.x.abs(), self.y.abs())
    }

    /// The larger coordinate.
    #[inline(always)]
    pub fn max(&self) -> f32 {
        self.x.max(self.y)
    }

    /// Adds the same number to both coordinates.
    #[inline(always)]
    pub fn add_scalar(&self, both: f32) -> Vec2 {
        *self + Vec2::repeat(both)
    }
}

/// `[x, y]`, with the precision of the format string.
impl fmt::Display for Vec2 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("[")?;
        self.x.fmt(f)?;
        f.write_str(", ")?;
        self.y.fmt(f)?;
        f.write_str("]")
    }
}

impl From<[f32; 2]> for Vec2 {
    #[inline(always)]
    fn from([x, y]: [f32; 2]) -> Vec2 {
        Vec2::new(x, y)
    }
}

impl Add for Vec2 {
    type Output = Vec2;

    #[inline(always)]
    fn add(self, other: Vec2) -> Vec2 {
        Vec2::new(self.x + other.x, self.y + other.y)
    }
}

impl Sub for Vec2 {
    type Output = Vec2;

    #[inline(always)]
    fn sub(self, other: Vec2) -> Vec2 {
        Vec2::new(self.x - other.x, self.y - other.y)
    }
}

impl Sub<&Vec2> for Vec2 {
    type Output = Vec2;

    #[inline(always)]
    fn sub(self, other: &Vec2) -> Vec2 {
        self - *other
    }
}

impl Sub<Vec2> for &Vec2 {
    type Output = Vec2;

    #[inline(always)]
    fn sub(self, other: Vec2) -> Vec2 {
        *self - other
    }
}

impl Mul<f32> for Vec2 {
    type Output = Vec2;

    #[inline(always)]
    fn mul(self, factor: f32) -> Vec2 {
        Vec2::new(self.x * factor, self.y * factor)
    }
}

impl Div<f32> for Vec2 {
    type Output = Vec2;

    #[inline(always)]
    fn div(self, divisor: f32) -> Vec2 {
        Vec2::new(self.x / divisor, self.y / divisor)
    }
}

impl Neg for Vec2 {
    type Output = Vec2;

    #[inline(always)]
    fn neg(self) -> Vec2 {
        Vec2::new(-self.x, -self.y)
    }
}

impl AddAssign for Vec2 {
    #[inline(always)]
    fn add_assign(&mut self, other: Vec2) {
        *self = *self + other;
    }
}

impl SubAssign for Vec2 {
    #[inline(always)]
    fn sub_assign(&mut self, other: Vec2) {
        *self = *self - other;
    }
}

/// Position and velocity of a robot in the world frame.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Motion {
    /// Position of the centre \[m\].
    pub position: Vec2,
    /// Velocity of the centre \[m/s\].
    pub velocity: Vec2,
}

/// Position and heading of a robot in the world frame (REP-103).
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Pose {
    /// Position of the centre \[m\].
    pub position: Vec2,
    /// Heading \[rad\], counter-clockwise from the x axis, within -pi and pi; none if it is not measured.
    pub heading: Option<f32>,
}

/// Linear velocity and yaw rate of a robot in the world frame.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Twist {
    /// Velocity of the centre \[m/s\].
    pub velocity: Vec2,
    /// Yaw rate \[rad/s\], counter-clockwise; none if it is not measured.
    pub yaw_rate: Option<f32>,
}

/// Standard deviations of a measurement; none where unknown.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Deviation {
    /// Of the position along each axis \[m\].
    pub position_m: Option<f32>,
    /// Of the heading \[rad\].
    pub heading_rad: Option<f32>,
    /// Of the velocity along each axis \[m/s\].
    pub velocity_m_s: Option<f32>,
    /// Standard deviation of the yaw rate \[rad/s\]; `None` if unknown.
    pub yaw_rate_rad_s: Option<f32>,
}

/// Start and goal of one robot in an episode, in the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Task {
    /// Start \[m\].
    pub start: Vec2,
    /// Goal \[m\].
    pub goal: Vec2,
}

impl Task {
    /// Direction from the start to the goal \[rad\], counter-clockwise from the x axis.
    pub fn heading(&self) -> f32 {
        let way = self.goal - self.start;
        libm::atan2f(way.y, way.x)
    }
}

impl Motion {
    /// At rest at `position`.
    pub fn at_rest(position: Vec2) -> Motion {
        Motion { position, velocity: Vec2::zeros() }
    }

    /// Whether all four numbers are finite and of a plausible size.
    pub fn is_sound(&self) -> bool {
        is_sound(self.position) && is_sound(self.velocity)
    }
}

impl Pose {
    /// Whether the position is of a plausible size and the heading is within a turn.
    pub fn is_sound(&self) -> bool {
        is_sound(self.position) && self.heading.is_none_or(|heading| heading.abs() <= MAX_HEADING)
    }

    /// Converts a velocity \[m/s\] from the world frame into the frame of a robot with this pose: x ahead, y to the
    /// left. None if the heading is unknown.
    pub fn into_body(&self, velocity: Vec2) -> Option<Vec2> {
        let (sin, cos) = libm::sincosf(self.heading?);
        Some(Vec2::new(cos * velocity.x + sin * velocity.y, cos * velocity.y - sin * velocity.x))
    }
}

impl Twist {
    /// Whether all numbers are of a plausible size.
    pub fn is_sound(&self) -> bool {
        is_sound(self.velocity) && self.yaw_rate.is_none_or(|rate| rate.abs() <= MAX_SIZE)
    }
}

impl Deviation {
    /// Whether every known deviation is finite and not negative.
    pub fn is_sound(&self) -> bool {
        let all = [self.position_m, self.heading_rad, self.velocity_m_s, self.yaw_rate_rad_s];
        all.into_iter().flatten().all(|deviation| (0.0..=MAX_SIZE).contains(&deviation))
    }
}

/// Largest heading \[rad\]: pi as an f32, which is slightly more than pi.
pub const MAX_HEADING: f32 = std::f32::consts::PI;
/// Largest coordinate \[m\] and velocity \[m/s\] that is valid: arithmetic in f32 stays finite with it.
pub const MAX_SIZE: f32 = 1e5;

/// Rotates a vector by an angle \[rad\], counter-clockwise, in double precision.
pub fn rotated(angle: f64, x: f64, y: f64) -> (f64, f64) {
    let (sin, cos) = libm::sincos(angle);
    (cos * x - sin * y, sin * x + cos * y)
}

/// Returns the same angle \[rad\] within -pi and pi; also as a 32-bit float it is within `MAX_HEADING`.
pub fn wrapped(angle: f64) -> f64 {
    libm::remainder(angle, std::f64::consts::TAU)
}

/// Whether both coordinates are finite and at most `MAX_SIZE`.
pub fn is_sound(v: Vec2) -> bool {
    v.x.abs() <= MAX_SIZE && v.y.abs() <= MAX_SIZE
}

/// Whether both coordinates are finite.
pub fn is_finite(v: Vec2) -> bool {
    v.x.is_finite() && v.y.is_finite()
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;
    use std::f64::consts::{PI, TAU};

    use super::*;

    #[test]
    fn a_robot_that_points_north_goes_north_by_going_ahead() {
        let north = Pose { position: Vec2::zeros(), heading: Some(FRAC_PI_2) };
        let ahead = north.into_body(Vec2::new(0.0, 1.0)).unwrap();
        assert!((ahead - Vec2::new(1.0, 0.0)).norm() < 1e-6, "{ahead}");
        let left = north.into_body(Vec2::new(-2.0, 0.0)).unwrap();
        assert!((left - Vec2::new(0.0, 2.0)).norm() < 1e-6, "{left}");
        assert_eq!(Pose { heading: None, ..north }.into_body(Vec2::zeros()), None);
    }

    #[test]
    fn an_angle_is_wrapped_to_one_that_a_pose_may_have() {
        for (angle, same) in [(0.5, 0.5), (4.0, 4.0 - TAU), (-4.0, TAU - 4.0), (40.0, 40.0 - 6.0 * TAU)] {
            assert!((wrapped(angle) - same).abs() < 1e-9, "{angle}");
        }
        for turns in -5..5 {
            assert!((wrapped(PI + TAU * f64::from(turns)) as f32).abs() <= MAX_HEADING, "{turns}");
        }
    }

    #[test]
    fn what_is_unknown_is_sound_and_what_cannot_be_is_not() {
        let deviation = |position_m| Deviation { position_m, ..Deviation::default() };
        assert!(deviation(None).is_sound() && deviation(Some(0.5)).is_sound());
        assert!(!deviation(Some(-0.5)).is_sound() && !deviation(Some(f32::NAN)).is_sound());
        let pose = |heading| Pose { position: Vec2::zeros(), heading };
        assert!(pose(None).is_sound() && pose(Some(-std::f32::consts::PI)).is_sound());
        assert!(!pose(Some(7.0)).is_sound() && !pose(Some(f32::NAN)).is_sound());
    }
}
