//! Points, velocities and what is made of them. SI units; x and y right-handed (REP-103).

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

    /// Both coordinates.
    #[inline(always)]
    pub const fn to_array(self) -> [f32; 2] {
        [self.x, self.y]
    }

    /// What a function makes of each coordinate.
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

    /// The direction, of length 1; of a zero vector not numbers.
    #[inline(always)]
    pub fn normalize(&self) -> Vec2 {
        *self / self.norm()
    }

    /// The direction, unless the length is `least` or below.
    #[inline(always)]
    pub fn try_normalize(&self, least: f32) -> Option<Vec2> {
        let norm = self.norm();
        if norm <= least { None } else { Some(*self / norm) }
    }

    /// The distance of each coordinate from zero.
    #[inline(always)]
    pub fn abs(&self) -> Vec2 {
        Vec2::new(self.x.abs(), self.y.abs())
    }

    /// The larger coordinate.
    #[inline(always)]
    pub fn max(&self) -> f32 {
        self.x.max(self.y)
    }

    /// The same number added to both coordinates.
    #[inline(always)]
    pub fn add_scalar(&self, both: f32) -> Vec2 {
        *self + Vec2::repeat(both)
    }
}

/// `[x, y]`, at the precision that is asked for.
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

/// Where a robot is and how it moves, in the world frame.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Motion {
    /// Position of the centre \[m\].
    pub position: Vec2,
    /// Velocity of the centre \[m/s\].
    pub velocity: Vec2,
}

/// Where one robot starts an episode and where it is to go, in the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Task {
    /// Start \[m\].
    pub start: Vec2,
    /// Goal \[m\].
    pub goal: Vec2,
}

impl Motion {
    /// At rest at `position`.
    pub fn at_rest(position: Vec2) -> Motion {
        Motion { position, velocity: Vec2::zeros() }
    }

    /// Whether all four numbers are finite and of a size that a robot's can be.
    pub fn is_sound(&self) -> bool {
        is_sound(self.position) && is_sound(self.velocity)
    }
}

/// The largest coordinate \[m\] and velocity \[m/s\] that is taken for one: arithmetic in f32 stays finite with it.
pub const MAX_SIZE: f32 = 1e5;

/// Whether both coordinates are finite and at most `MAX_SIZE`.
pub fn is_sound(v: Vec2) -> bool {
    v.x.abs() <= MAX_SIZE && v.y.abs() <= MAX_SIZE
}

/// Whether both coordinates are finite.
pub fn is_finite(v: Vec2) -> bool {
    v.x.is_finite() && v.y.is_finite()
}
