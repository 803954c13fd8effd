//! Points, velocities and types made of them. SI units; x and y right-handed (REP-103).

use std::fmt;

/// A point \[m\] or a velocity \[m/s\] in the plane: the vector of nalgebra, with its operators and methods.
pub type Vec2 = nalgebra::Vector2<f32>;

/// What vectors of the plane have here beyond the methods of nalgebra.
pub trait Planar {
    /// Returns the components as the array `[x, y]`.
    fn to_array(&self) -> [f32; 2];

    /// Returns the vector with the same direction and a Euclidean length of at most `most`, in the unit of the vector.
    /// The limit holds for the exact length, since what is rounded is rounded toward zero (`cap_magnitude` of nalgebra
    /// may exceed it by a rounding).
    fn capped(&self, most: f32) -> Vec2;

    /// Returns a view that writes the vector in one line, as `[x, y]`; both components are formatted by the options of
    /// the format string. (nalgebra itself draws a box over several lines.)
    fn shown(&self) -> Shown;
}

impl Planar for Vec2 {
    #[inline(always)]
    fn to_array(&self) -> [f32; 2] {
        [self.x, self.y]
    }

    fn capped(&self, most: f32) -> Vec2 {
        if !exceeds(self, most) {
            return *self;
        }
        let length = self.norm();
        let mut capped = if length > most { self * (most / length) } else { *self };
        while exceeds(&capped, most) {
            capped = capped.map(toward_zero);
        }
        capped
    }

    fn shown(&self) -> Shown {
        Shown(self.to_array())
    }
}

/// Returns whether the exact length of `vector` is above `most`; false if it is not a number.
fn exceeds(vector: &Vec2, most: f32) -> bool {
    let [x, y, most] = [vector.x, vector.y, most].map(f64::from);
    // Products of two f32 are exact in f64. Beyond its relative error of 1e-16 nothing is lost in the sum.
    x * x + y * y > most * most
}

/// View of a vector that is written as `[x, y]`.
#[derive(Clone, Copy, Debug)]
pub struct Shown([f32; 2]);

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Shown([x, y]) = self;
        f.write_str("[")?;
        x.fmt(f)?;
        f.write_str(", ")?;
        y.fmt(f)?;
        f.write_str("]")
    }
}

/// Position \[m\] and velocity \[m/s\] of a robot, in the world frame unless a field of this type says otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Motion {
    /// Position \[m\] of the robot's centre or, in readings for policies, of its commanded point.
    pub position: Vec2,
    /// Velocity \[m/s\] of the point that `position` gives.
    pub velocity: Vec2,
}

/// Position and heading of a robot in the world frame (REP-103).
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Pose {
    /// Position \[m\], world frame, of the robot's centre or, in readings for policies, of its commanded point.
    pub position: Vec2,
    /// Heading \[rad\], counter-clockwise from the x axis, from -pi to pi; `None` if no heading was measured.
    pub heading: Option<f32>,
}

/// Linear velocity and yaw rate of a robot in the world frame.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Twist {
    /// Velocity \[m/s\], world frame, of the robot's centre or, in readings for policies, of its commanded point.
    pub velocity: Vec2,
    /// Yaw rate \[rad/s\], counter-clockwise; `None` if no yaw rate was measured.
    pub yaw_rate: Option<f32>,
}

/// Standard deviations of a measured pose and velocity. A field is `None` where the sensor states no accuracy.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Deviation {
    /// Standard deviation of the position along each axis \[m\]; `None` if unknown.
    pub position_m: Option<f32>,
    /// Standard deviation of the heading \[rad\]; `None` if unknown.
    pub heading_rad: Option<f32>,
    /// Standard deviation of the velocity along each axis \[m/s\]; `None` if unknown.
    pub velocity_m_s: Option<f32>,
    /// Standard deviation of the yaw rate \[rad/s\]; `None` if unknown.
    pub yaw_rate_rad_s: Option<f32>,
}

/// Start and goal of one robot in an episode (one attempt at the team's task), in the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Task {
    /// Position from which the robot begins the episode \[m\], world frame.
    pub start: Vec2,
    /// Position that the robot has to reach \[m\], world frame.
    pub goal: Vec2,
}

impl Task {
    /// Returns the direction from the start to the goal \[rad\], counter-clockwise from the x axis.
    pub fn heading(&self) -> f32 {
        let way = self.goal - self.start;
        libm::atan2f(way.y, way.x)
    }
}

impl Motion {
    /// Returns the motion of a robot that stands still at `position` \[m\], world frame.
    pub fn at_rest(position: Vec2) -> Motion {
        Motion { position, velocity: Vec2::zeros() }
    }

    /// Whether all components of position and velocity are finite and at most `MAX_SIZE` (1e5) in absolute value.
    pub fn is_sound(&self) -> bool {
        is_sound(self.position) && is_sound(self.velocity)
    }
}

impl Pose {
    /// Whether the coordinates are finite and at most `MAX_SIZE` (1e5) in absolute value, and the heading, if known, at
    /// most `MAX_HEADING` (pi).
    pub fn is_sound(&self) -> bool {
        is_sound(self.position) && self.heading.is_none_or(|heading| heading.abs() <= MAX_HEADING)
    }

    /// Converts a velocity \[m/s\] from the world frame into the frame of a robot with this pose, in which x points
    /// ahead and y to the left. Returns `None` if the heading is unknown.
    pub(crate) fn in_body_frame(&self, velocity: Vec2) -> Option<Vec2> {
        let (sin, cos) = libm::sincosf(self.heading?);
        Some(Vec2::new(cos * velocity.x + sin * velocity.y, cos * velocity.y - sin * velocity.x))
    }
}

impl Twist {
    /// Whether the velocity's components and the yaw rate, if known, are finite and at most `MAX_SIZE` (1e5) in
    /// absolute value.
    pub fn is_sound(&self) -> bool {
        is_sound(self.velocity) && self.yaw_rate.is_none_or(|rate| rate.abs() <= MAX_SIZE)
    }
}

impl Deviation {
    /// Whether every known standard deviation is finite, not negative and at most `MAX_SIZE` (1e5).
    pub fn is_sound(&self) -> bool {
        let all = [self.position_m, self.heading_rad, self.velocity_m_s, self.yaw_rate_rad_s];
        all.into_iter().flatten().all(|deviation| (0.0..=MAX_SIZE).contains(&deviation))
    }
}

/// Largest absolute heading \[rad\] that a valid pose has: pi as an f32, which is slightly more than pi.
pub const MAX_HEADING: f32 = std::f32::consts::PI;
/// Largest absolute value of a coordinate \[m\], velocity component \[m/s\] or yaw rate \[rad/s\] in a valid message.
/// Computations in f32 stay finite up to this bound.
pub const MAX_SIZE: f32 = 1e5;

/// Rotates the vector (`x`, `y`) counter-clockwise by `angle` \[rad\], in double precision. Returns the rotated x and
/// y.
pub fn rotated(angle: f64, x: f64, y: f64) -> (f64, f64) {
    let (sin, cos) = libm::sincos(angle);
    (cos * x - sin * y, sin * x + cos * y)
}

/// Reduces an angle \[rad\] by whole turns to the range from -pi to pi. Rounded to f32, the result is at most
/// `MAX_HEADING` (pi as an f32) in absolute value.
pub fn wrapped(angle: f64) -> f64 {
    libm::remainder(angle, std::f64::consts::TAU)
}

/// Smallest and largest length of a quaternion that is taken for a rotation. Senders that round to f32 are within 1e-6
/// of one, and some normalise seldom; a quaternion whose fields were confused is mostly further off.
pub(crate) const QUATERNION_LENGTH: [f64; 2] = [0.9, 1.1];

/// Reason why four numbers are no rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoRotation {
    /// All four are zero, as in a message whose orientation nobody has set.
    Zero,
    /// Their length as a quaternion is not within 0.9 to 1.1, or not finite.
    Length,
}

/// Returns the unit quaternion in the direction of `quaternion`, whose length has to be within 0.9 to 1.1.
pub fn unit_quaternion(quaternion: [f64; 4]) -> Result<[f64; 4], NoRotation> {
    if quaternion == [0.0; 4] {
        return Err(NoRotation::Zero);
    }
    let length = quaternion.iter().map(|number| number * number).sum::<f64>().sqrt();
    let [least, most] = QUATERNION_LENGTH;
    if (least..=most).contains(&length) {
        Ok(quaternion.map(|number| number / length))
    } else {
        Err(NoRotation::Length)
    }
}

/// Whether both components of a vector are finite and at most `MAX_SIZE` (1e5) in absolute value.
pub fn is_sound(v: Vec2) -> bool {
    v.x.abs() <= MAX_SIZE && v.y.abs() <= MAX_SIZE
}

/// Whether both components of a vector are finite: neither infinite nor NaN.
pub fn is_finite(v: Vec2) -> bool {
    v.x.is_finite() && v.y.is_finite()
}

/// Returns the next f32 toward zero; zero, infinity and NaN stay as they are.
pub fn toward_zero(value: f32) -> f32 {
    if !value.is_finite() || value == 0.0 {
        value
    } else if value > 0.0 {
        value.next_down()
    } else {
        value.next_up()
    }
}

/// Returns the largest f32 that is not above the decimal number that `limit` was written as, such as 0.7999999 for 0.8,
/// whose nearest f32 is larger. A limit that a user writes then holds for whoever reads numbers as decimals or f64.
pub fn limit_below(limit: f32) -> f32 {
    let decimal = limit.to_string().parse::<f64>().unwrap_or(f64::INFINITY);
    if f64::from(limit) > decimal { toward_zero(limit) } else { limit }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;
    use std::f64::consts::{PI, TAU};

    use super::*;

    #[test]
    fn a_capped_vector_is_never_longer_than_the_limit_and_keeps_its_direction() {
        use rand::RngExt;
        let mut stream = crate::random::Seed::of_run(1).stream("cap");
        for _ in 0..100_000 {
            let mut axis = || stream.random_range(-3.0..3.0f32);
            let (vector, most) = (Vec2::new(axis(), axis()), axis().abs());
            let capped = vector.capped(most);
            let exact = |v: Vec2| libm::hypot(f64::from(v.x), f64::from(v.y));
            assert!(exact(capped) <= f64::from(most), "{vector:?} to {most}: {capped:?}");
            assert!(
                exact(capped) >= f64::from(most) * (1.0 - 1e-6) || capped == vector,
                "{vector:?} to {most}: {capped:?}"
            );
            assert!((capped.x * vector.y - capped.y * vector.x).abs() < 1e-5, "{vector:?} to {most}: {capped:?}");
        }
        let far = Vec2::new(f32::INFINITY, 1.0).capped(1.0);
        assert!(far.x.is_nan() && Vec2::new(f32::NAN, 1.0).capped(1.0).x.is_nan());
        assert_eq!(Vec2::new(3.0, -4.0).capped(5.0), Vec2::new(3.0, -4.0));
        assert_eq!(Vec2::new(1e30, 1e30).capped(f32::INFINITY), Vec2::new(1e30, 1e30));
    }

    #[test]
    fn a_limit_is_not_above_the_decimal_that_was_written() {
        for k in 1..2000 {
            let decimal = f64::from(k) / 1000.0;
            let limit = limit_below(decimal as f32);
            assert!(f64::from(limit) <= decimal && f64::from(limit) > decimal * (1.0 - 2e-7), "{decimal}: {limit}");
        }
        assert_eq!([0.5, 0.25, 1.5, f32::INFINITY].map(limit_below), [0.5, 0.25, 1.5, f32::INFINITY]);
    }

    #[test]
    fn a_robot_that_points_north_goes_north_by_going_ahead() {
        let north = Pose { position: Vec2::zeros(), heading: Some(FRAC_PI_2) };
        let ahead = north.in_body_frame(Vec2::new(0.0, 1.0)).unwrap();
        assert!((ahead - Vec2::new(1.0, 0.0)).norm() < 1e-6, "{ahead:?}");
        let left = north.in_body_frame(Vec2::new(-2.0, 0.0)).unwrap();
        assert!((left - Vec2::new(0.0, 2.0)).norm() < 1e-6, "{left:?}");
        assert_eq!(Pose { heading: None, ..north }.in_body_frame(Vec2::zeros()), None);
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
    fn a_quaternion_is_made_one_of_unit_length_if_it_is_nearly_one() {
        for length in [0.901, 0.99, 1.0, 1.099] {
            let unit = unit_quaternion([0.0, 0.6 * length, 0.0, 0.8 * length]).unwrap();
            assert!((unit[1] - 0.6).abs() < 1e-12 && (unit[3] - 0.8).abs() < 1e-12, "{unit:?}");
        }
        assert_eq!(unit_quaternion([0.0; 4]), Err(NoRotation::Zero));
        for wrong in [[0.0, 0.0, 0.0, 0.89], [0.0, 0.0, 0.0, 1.11], [0.0, 0.0, 0.5, 0.5], [f64::NAN; 4], [1e300; 4]] {
            assert_eq!(unit_quaternion(wrong), Err(NoRotation::Length), "{wrong:?}");
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
