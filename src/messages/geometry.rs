//! Points, velocities and what is made of them. SI units; x and y right-handed (REP-103).

/// A point \[m\] or a velocity \[m/s\] in the plane.
pub type Vec2 = nalgebra::Vector2<f32>;

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
