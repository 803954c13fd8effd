//! Axes and signs between a team and a Crazyflie. All that turns a velocity or an angle of one into one of the other is
//! here.
//!
//! The team's frame is right-handed with z up, and angles are counter-clockwise from the x axis \[rad\]. So is that of
//! the firmware's estimator, in degrees. Yaw rates of setpoints are so since protocol version 9, and were clockwise
//! before.

use murmurate::messages::geometry::{Planar, Vec2, wrapped};
use serde::Deserialize;

use crate::packet::{Packet, port};
use crate::requests::floats;

/// First protocol version whose setpoints have yaw rates counter-clockwise.
const COUNTER_CLOCKWISE: u8 = 9;
/// Vertical speed for each metre from the height, where the host holds it \[1/s\], and the largest one \[m/s\].
const CLIMB_PER_S: f32 = 1.5;
const CLIMB_MOST_M_S: f32 = 0.3;

/// Kind of setpoint by which velocities are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Setpoint {
    /// Velocity along the robot's own axes, yaw rate and height, which the firmware holds.
    #[default]
    Hover,
    /// Velocity in the world frame, and yaw rate; the height is held by the driver, through its estimate.
    VelocityWorld,
}

/// Motion of a robot in the air, in the team's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Velocity in the world frame \[m/s\].
    pub velocity: Vec2,
    /// Yaw rate, counter-clockwise \[rad/s\].
    pub yaw_rate: f32,
    /// Height above the ground at which the robot is to be \[m\].
    pub height_m: f32,
}

impl Setpoint {
    /// Returns the packet that makes a robot move so, of which its own estimate says the heading \[rad\] and the height
    /// \[m\]. The firmware turns velocities by its own heading, so that one counts here, too.
    pub fn packet(self, protocol: u8, motion: &Motion, (heading, height_m): (f32, f32)) -> Packet {
        let current = protocol >= COUNTER_CLOCKWISE;
        let yaw_rate = motion.yaw_rate.to_degrees() * if current { 1.0 } else { -1.0 };
        let [x, y] = motion.velocity.to_array();
        let (kind, numbers) = match self {
            Setpoint::Hover => {
                let (sin, cos) = libm::sincos(f64::from(heading));
                let (sin, cos) = (sin as f32, cos as f32);
                let (ahead, left) = (cos * x + sin * y, cos * y - sin * x);
                (if current { 10 } else { 5 }, [ahead, left, yaw_rate, motion.height_m])
            }
            Setpoint::VelocityWorld => {
                let climb = (CLIMB_PER_S * (motion.height_m - height_m)).clamp(-CLIMB_MOST_M_S, CLIMB_MOST_M_S);
                (if current { 8 } else { 1 }, [x, y, climb, yaw_rate])
            }
        };
        Packet::new(port::SETPOINT, 0, [&[kind][..], &floats(&numbers)].concat())
    }
}

/// Returns a heading of the team's frame \[rad\] from the yaw of the firmware's estimator \[degrees\].
pub fn heading_of(yaw_deg: f32) -> f32 {
    wrapped(f64::from(yaw_deg).to_radians()) as f32
}

/// Returns the attitude (x, y, z, w) of a level robot with a heading \[rad\].
pub fn level(heading: f32) -> [f32; 4] {
    let (sin, cos) = libm::sincos(f64::from(heading) / 2.0);
    [0.0, 0.0, sin as f32, cos as f32]
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{FRAC_PI_2, PI};

    use super::*;

    fn numbers(setpoint: Setpoint, protocol: u8, motion: &Motion, at: (f32, f32)) -> (u8, [f32; 4]) {
        let data = setpoint.packet(protocol, motion, at).data;
        let number = |k: usize| f32::from_le_bytes(data[1 + 4 * k..5 + 4 * k].try_into().expect("four bytes"));
        (data[0], std::array::from_fn(number))
    }

    #[test]
    fn a_velocity_of_the_world_is_turned_into_the_robots_axes() {
        let motion = Motion { velocity: Vec2::new(0.4, 0.0), yaw_rate: 0.0, height_m: 0.5 };
        // The robot looks along: x, y, -x, -y. The velocity along x is then: ahead, right, back, left.
        for (heading, [ahead, left]) in
            [(0.0, [0.4, 0.0]), (FRAC_PI_2, [0.0, -0.4]), (PI, [-0.4, 0.0]), (-FRAC_PI_2, [0.0, 0.4])]
        {
            let (kind, sent) = numbers(Setpoint::Hover, 12, &motion, (heading, 0.5));
            assert!(kind == 10 && (sent[0] - ahead).abs() < 1e-6 && (sent[1] - left).abs() < 1e-6, "{sent:?}");
            assert_eq!(sent[2..], [0.0, 0.5]);
            let world = numbers(Setpoint::VelocityWorld, 12, &motion, (heading, 0.5));
            assert_eq!(world, (8, [0.4, 0.0, 0.0, 0.0]), "whatever its heading");
        }
    }

    #[test]
    fn yaw_rates_are_in_degrees_with_the_sign_of_the_protocol_version() {
        let motion = Motion { velocity: Vec2::zeros(), yaw_rate: PI, height_m: 0.5 };
        for (protocol, sign, kinds) in [(12, 1.0, [10, 8]), (9, 1.0, [10, 8]), (8, -1.0, [5, 1])] {
            let hover = numbers(Setpoint::Hover, protocol, &motion, (1.0, 0.5));
            let world = numbers(Setpoint::VelocityWorld, protocol, &motion, (1.0, 0.5));
            assert_eq!([hover.0, world.0], kinds);
            assert!((hover.1[2] - sign * 180.0).abs() < 1e-3 && (world.1[3] - sign * 180.0).abs() < 1e-3);
        }
    }

    #[test]
    fn the_height_is_held_from_both_sides_and_slowly() {
        let motion = Motion { velocity: Vec2::zeros(), yaw_rate: 0.0, height_m: 1.0 };
        let climb = |height_m| numbers(Setpoint::VelocityWorld, 12, &motion, (0.0, height_m)).1[2];
        assert_eq!((climb(0.0), climb(2.0), climb(1.0)), (CLIMB_MOST_M_S, -CLIMB_MOST_M_S, 0.0));
        assert!(climb(0.9) > 0.0 && climb(1.1) < 0.0);
    }

    #[test]
    fn angles_of_the_firmware_are_wrapped_and_a_level_attitude_has_the_heading() {
        assert!((heading_of(90.0) - FRAC_PI_2).abs() < 1e-6 && (heading_of(270.0) + FRAC_PI_2).abs() < 1e-6);
        let [x, y, z, w] = level(FRAC_PI_2);
        assert_eq!([x, y], [0.0, 0.0]);
        assert!((z - w).abs() < 1e-6 && z > 0.7);
    }
}
