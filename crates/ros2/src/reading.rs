//! Conversion of poses and velocities from ROS messages to readings. Does no I/O.

use murmurate::messages::geometry::{Deviation, Pose, Twist, Vec2, rotated, wrapped};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;
use serde::Deserialize;

use super::packet::PoseSample;

/// Convention for the axes of a robot's frame, as used by the sender of ROS messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axes {
    /// x forward, y left, yaw counter-clockwise (REP-103).
    #[default]
    Rep103,
    /// x forward, y right, yaw clockwise, as on a RoboMaster behind a CAN bridge.
    Ned,
}

impl Axes {
    /// Returns the factor (1 or -1) that converts y components and yaw angles in these axes to those of REP-103.
    pub fn sign(self) -> f64 {
        match self {
            Axes::Rep103 => 1.0,
            Axes::Ned => -1.0,
        }
    }
}

/// Velocity of a robot in the frame in which its pose is given, with the axes of REP-103.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity {
    /// Velocity along the x axis of the pose's frame \[m/s\].
    pub x: f64,
    /// Velocity along the y axis of the pose's frame \[m/s\].
    pub y: f64,
    /// Yaw rate \[rad/s\], counter-clockwise; `None` if not measured.
    pub yaw_rate: Option<f64>,
}

/// Converts a received pose and velocity from the sender's `axes` to those of REP-103: x forward, y left, yaw
/// counter-clockwise.
pub fn in_rep103(axes: Axes, mut pose: PoseSample) -> PoseSample {
    let sign = axes.sign();
    pose.y *= sign;
    pose.yaw = pose.yaw.map(|yaw| sign * yaw);
    if let Some(twist) = &mut pose.twist {
        twist.y *= sign;
        twist.yaw_rate *= sign;
    }
    pose
}

/// Rotates the velocity of a received message from the robot's frame into the frame of its pose. Returns `None` if the
/// message has no velocity or no yaw.
pub fn velocity(pose: &PoseSample) -> Option<Velocity> {
    let twist = pose.twist?;
    let (x, y) = rotated(pose.yaw?, twist.x, twist.y);
    Some(Velocity { x, y, yaw_rate: Some(twist.yaw_rate) })
}

/// Makes a reading of `robot` from a pose and a velocity in the same frame. `stamp_ns` is the time of measurement
/// \[ns\] on the sender's clock. Returns `None` if a number is too large for a reading.
pub fn reading(robot: RobotId, stamp_ns: u64, pose: &PoseSample, velocity: Velocity) -> Option<Reading> {
    let twist = pose.twist.unwrap_or_default();
    let single = |value: Option<f64>| value.map(|value| value as f32);
    let reading = Reading {
        robot,
        stamp_ns,
        pose: Pose {
            position: Vec2::new(pose.x as f32, pose.y as f32),
            heading: pose.yaw.map(|yaw| wrapped(yaw) as f32),
        },
        twist: Twist { velocity: Vec2::new(velocity.x as f32, velocity.y as f32), yaw_rate: single(velocity.yaw_rate) },
        deviation: Deviation {
            position_m: single(pose.position_m),
            heading_rad: single(pose.heading_rad),
            velocity_m_s: single(twist.velocity_m_s),
            yaw_rate_rad_s: single(twist.yaw_rate_rad_s),
        },
    };
    reading.unfit().is_none().then_some(reading)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::TwistSample;

    #[test]
    fn a_robot_that_points_north_and_goes_ahead_goes_north() {
        let twist = Some(TwistSample { x: 0.5, y: 0.1, yaw_rate: 0.2, ..TwistSample::default() });
        let north = PoseSample { yaw: Some(std::f64::consts::FRAC_PI_2), twist, ..PoseSample::default() };
        let v = velocity(&north).unwrap();
        assert!((v.x + 0.1).abs() < 1e-12 && (v.y - 0.5).abs() < 1e-12, "{v:?}");
        assert_eq!(velocity(&PoseSample { yaw: None, ..north }), None);
        // The same robot in other axes: clockwise by a quarter turn is south, and right is the other side.
        let south = velocity(&in_rep103(Axes::Ned, north)).unwrap();
        assert!((south.x + 0.1).abs() < 1e-12 && (south.y + 0.5).abs() < 1e-12, "{south:?}");
        assert_eq!(south.yaw_rate, Some(-0.2));
    }

    #[test]
    fn numbers_that_no_reading_holds_are_refused() {
        let far = PoseSample { x: 1e9, ..PoseSample::default() };
        assert_eq!(reading(RobotId(1), 1, &far, Velocity::default()), None);
        let turned = PoseSample { yaw: Some(7.0), ..PoseSample::default() };
        let heading = reading(RobotId(1), 1, &turned, Velocity::default()).unwrap().pose.heading.unwrap();
        assert!((heading - 0.716_814_7).abs() < 1e-6, "{heading}");
    }
}
