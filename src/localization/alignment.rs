//! Alignment of a source's frame of reference with the team's frame: yaw and origin, from the team file.

use crate::config::ConfigError;
use crate::messages::geometry::{MAX_SIZE, Vec2, rotated, wrapped};
use crate::messages::wire::Reading;

/// Largest rotation that a setting may have \[rad\]: a full turn, with room for rounding.
const YAW_MOST_RAD: f64 = 7.0;

/// Pose of the frame in which a source measures, in the team's frame. Both have their z axes up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Alignment {
    yaw_rad: f64,
    origin_m: [f64; 2],
}

impl Alignment {
    /// Makes the alignment of a frame that is rotated by `yaw_rad` \[rad\], counter-clockwise, and whose origin is at
    /// `origin_m` \[m\]. The error names the setting, `yaw_rad` or `origin_m`.
    pub fn new(yaw_rad: f64, origin_m: [f64; 2]) -> Result<Alignment, ConfigError> {
        let within = |name: &str, value: f64, most: f64, unit: &str| {
            let why = || format!("it is out of range; give -{most} to {most} {unit}");
            if value.abs() <= most { Ok(()) } else { Err(ConfigError::field(name, why())) }
        };
        within("yaw_rad", yaw_rad, YAW_MOST_RAD, "rad")?;
        origin_m.iter().try_for_each(|&m| within("origin_m", m, f64::from(MAX_SIZE), "m"))?;
        Ok(Alignment { yaw_rad, origin_m })
    }

    /// Makes the alignment of a frame that is rotated by `yaw_rad` \[rad\] and in which the point `from` \[m\] is the
    /// point `to` \[m\] of the team's frame. `None` if the frame's origin is out of range.
    pub(crate) fn between(from: [f64; 2], to: [f64; 2], yaw_rad: f64) -> Option<Alignment> {
        let (x, y) = rotated(yaw_rad, from[0], from[1]);
        Alignment::new(wrapped(yaw_rad), [to[0] - x, to[1] - y]).ok()
    }

    /// Converts a reading to the team's frame.
    pub(crate) fn reading(&self, measured: &Reading) -> Reading {
        let (position, velocity) = (measured.pose.position, measured.twist.velocity);
        let [x, y] = self.position(f64::from(position.x), f64::from(position.y));
        let (vx, vy) = self.turned(f64::from(velocity.x), f64::from(velocity.y));
        let mut reading = measured.clone();
        reading.pose.position = Vec2::new(x as f32, y as f32);
        reading.pose.heading = measured.pose.heading.map(|heading| self.heading(f64::from(heading)) as f32);
        reading.twist.velocity = Vec2::new(vx as f32, vy as f32);
        reading
    }

    /// Converts a position \[m\] to the team's frame.
    pub fn position(&self, x: f64, y: f64) -> [f64; 2] {
        let (x, y) = self.turned(x, y);
        [self.origin_m[0] + x, self.origin_m[1] + y]
    }

    /// Rotates a vector, such as a velocity, to the axes of the team's frame.
    pub(crate) fn turned(&self, x: f64, y: f64) -> (f64, f64) {
        rotated(self.yaw_rad, x, y)
    }

    /// Converts a heading \[rad\] to the team's frame. The result is from -pi to pi.
    pub fn heading(&self, heading: f64) -> f64 {
        wrapped(heading + self.yaw_rad)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;

    #[test]
    fn positions_are_moved_and_vectors_only_turned() {
        let frame = Alignment::new(FRAC_PI_2, [10.0, 20.0]).unwrap();
        let [x, y] = frame.position(1.0, 2.0);
        assert!((x - 8.0).abs() < 1e-12 && (y - 21.0).abs() < 1e-12, "{x} {y}");
        let (x, y) = frame.turned(0.5, 0.0);
        assert!(x.abs() < 1e-12 && (y - 0.5).abs() < 1e-12, "{x} {y}");
        assert!((frame.heading(3.0) - (3.0 + FRAC_PI_2 - 2.0 * PI)).abs() < 1e-12);
    }

    #[test]
    fn a_wrong_setting_is_named() {
        let error = |yaw, x, y| Alignment::new(yaw, [x, y]).unwrap_err().to_string();
        assert!(error(f64::NAN, 0.0, 0.0).starts_with("yaw_rad: "));
        assert!(error(90.0, 0.0, 0.0).starts_with("yaw_rad: "), "degrees");
        assert!(error(0.0, 0.0, f64::INFINITY).starts_with("origin_m: "));
        assert!(error(0.0, 2e5, 0.0).starts_with("origin_m: "));
    }
}
