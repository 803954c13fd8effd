//! Axes: conversion between the team's frame, with its z axis up, and an autopilot's axes north, east and down. No
//! other file turns or flips an axis.

use std::f64::consts::FRAC_PI_2;

use murmurate::messages::geometry::{rotated, wrapped};

/// Vector of an autopilot in its axes north and east: a velocity \[m/s\] or a place from its origin \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NorthEast {
    /// Component along north, or along the autopilot's own x axis where it has no compass.
    pub north: f64,
    /// Component along east, or along the autopilot's own y axis, to the right of its x axis seen from above.
    pub east: f64,
}

/// Direction of an autopilot's axes in the team's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Axes {
    /// Direction of east in the team's frame \[rad\], counter-clockwise from the team's x axis.
    pub yaw_rad: f64,
}

impl Axes {
    /// Converts a vector of the team's frame to north and east.
    pub fn to_autopilot(self, x: f64, y: f64) -> NorthEast {
        let (east, north) = rotated(-self.yaw_rad, x, y);
        NorthEast { north, east }
    }

    /// Converts a vector of north and east to the team's axes x and y, without the place of any origin.
    pub fn to_team(self, vector: NorthEast) -> [f64; 2] {
        let (x, y) = rotated(self.yaw_rad, vector.east, vector.north);
        [x, y]
    }

    /// Converts an autopilot's heading \[rad\], clockwise from north, to one of the team's frame \[rad\], which is
    /// counter-clockwise from its x axis. The result is from -pi to pi.
    pub fn heading(self, clockwise_rad: f64) -> f64 {
        wrapped(FRAC_PI_2 - clockwise_rad + self.yaw_rad)
    }
}

/// Converts a rate of turn \[rad/s\] between counter-clockwise, as in the team's frame, and clockwise, as around the
/// axis down. It is its own inverse.
pub fn turned_over(rate_rad_s: f64) -> f64 {
    // Plus zero, since minus zero is odd to read.
    -rate_rad_s + 0.0
}

/// Converts a height or a speed upwards to one downwards, or back. It is its own inverse.
pub fn flipped(up: f64) -> f64 {
    -up + 0.0
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    fn near(one: f64, other: f64) -> bool {
        (one - other).abs() < 1e-12
    }

    #[test]
    fn without_a_turn_x_is_east_and_y_is_north() {
        let axes = Axes::default();
        assert_eq!(axes.to_autopilot(1.0, 2.0), NorthEast { north: 2.0, east: 1.0 });
        assert_eq!(axes.to_team(NorthEast { north: 2.0, east: 1.0 }), [1.0, 2.0]);
        for (clockwise, heading) in [(0.0, FRAC_PI_2), (FRAC_PI_2, 0.0), (PI, -FRAC_PI_2), (-FRAC_PI_2, PI)] {
            let found = axes.heading(clockwise);
            assert!(near(found.cos(), heading.cos()) && near(found.sin(), heading.sin()), "{clockwise}: {found}");
        }
    }

    #[test]
    fn a_team_whose_x_axis_is_north_has_east_to_the_right() {
        let axes = Axes { yaw_rad: -FRAC_PI_2 };
        let NorthEast { north, east } = axes.to_autopilot(1.0, 0.0);
        assert!(near(north, 1.0) && near(east, 0.0), "ahead is north: {north} {east}");
        let NorthEast { north, east } = axes.to_autopilot(0.0, 1.0);
        assert!(near(north, 0.0) && near(east, -1.0), "left is west: {north} {east}");
        assert!(near(axes.heading(0.0), 0.0), "a robot that looks north looks along x");
    }

    #[test]
    fn there_and_back_is_the_same_at_every_turn() {
        for k in 0..64 {
            let axes = Axes { yaw_rad: f64::from(k) * 0.1 };
            let [x, y] = axes.to_team(axes.to_autopilot(0.3, -1.7));
            assert!(near(x, 0.3) && near(y, -1.7), "{k}: {x} {y}");
            // The heading of a robot that moves ahead is the direction of its velocity, in both frames.
            let NorthEast { north, east } = axes.to_autopilot(libm::cos(0.4), libm::sin(0.4));
            assert!(near(axes.heading(libm::atan2(east, north)), 0.4), "{k}");
        }
        assert_eq!((turned_over(0.5), flipped(2.0)), (-0.5, -2.0));
        assert!(turned_over(0.0).is_sign_positive() && flipped(0.0).is_sign_positive());
    }
}
