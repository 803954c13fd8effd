//! Sensor model of a robot's state: noise, rate and latency. A Body applies it to the samples of its World.

use crate::messages::geometry::{Deviation, Motion, Vec2};
use crate::random;
use crate::random::Stream;
use crate::time::Span;

/// Noise, rate and latency between a robot's true state and its measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Standard deviation of the position along each axis \[m\].
    pub position_m: f32,
    /// Standard deviation of the velocity along each axis \[m/s\].
    pub velocity_m_s: f32,
    /// Shortest time between two measurements; a World's own period, if that is longer.
    pub period: Span,
    /// Delay from the instant of a measurement to its output.
    pub latency: Span,
}

impl Sensor {
    /// No noise and no latency, at every step of the World.
    pub const EXACT: Sensor = Sensor { position_m: 0.0, velocity_m_s: 0.0, period: Span::ZERO, latency: Span::ZERO };

    /// A motion capture system such as the paper's (section V: OptiTrack).
    ///
    /// Position: the +-0.2 mm that OptiTrack states for its PrimeX cameras. Rate: 100 Hz, a usual setting. Velocity:
    /// the noise of a difference of positions three frames apart, sqrt(2) * 0.2 mm / 30 ms. Latency: 6 to 7 ms were
    /// measured to the end of such a chain (Qualisys at ETH Zurich, 200 Hz), and half a frame more at 100 Hz.
    pub const MOTION_CAPTURE: Sensor =
        Sensor { position_m: 2e-4, velocity_m_s: 0.01, period: Span::from_millis(10), latency: Span::from_millis(10) };

    /// A satellite receiver with real-time kinematic corrections (RTK, fixed solution).
    ///
    /// Position and velocity: 0.01 m + 1 ppm and 0.05 m/s are stated for u-blox ZED-F9P receivers; 2 cm with a moving
    /// antenna. Rate: 10 Hz. Latency: 100 ms through receiver, serial line and gpsd.
    pub const RTK: Sensor = Sensor {
        position_m: 0.02,
        velocity_m_s: 0.05,
        period: Span::from_millis(100),
        latency: Span::from_millis(100),
    };

    /// All sensors by name.
    pub const NAMED: [(&str, Sensor); 3] =
        [("exact", Sensor::EXACT), ("motion-capture", Sensor::MOTION_CAPTURE), ("rtk", Sensor::RTK)];

    /// Standard deviations of its measurements. Headings and yaw rates have no noise.
    pub fn deviation(&self) -> Deviation {
        Deviation {
            position_m: Some(self.position_m),
            heading_rad: Some(0.0),
            velocity_m_s: Some(self.velocity_m_s),
            yaw_rate_rad_s: Some(0.0),
        }
    }

    /// Returns a noisy measurement of this motion. A quantity without noise draws nothing from the stream.
    pub fn measure(&self, motion: &Motion, stream: &mut Stream) -> Motion {
        let mut noisy = |value: Vec2, deviation: f32| {
            if deviation > 0.0 { value + standard_normals(stream) * deviation } else { value }
        };
        Motion {
            position: noisy(motion.position, self.position_m),
            velocity: noisy(motion.velocity, self.velocity_m_s),
        }
    }
}

/// Two numbers of the standard normal distribution.
pub(super) fn standard_normals(stream: &mut Stream) -> Vec2 {
    let [x, y] = random::normals(stream);
    Vec2::new(x as f32, y as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Seed;

    #[test]
    fn measurements_scatter_about_the_true_state_and_an_exact_one_equals_it() {
        let mut stream = Seed::of_run(1).stream("sensor");
        let truth = Motion { position: Vec2::new(1.0, -2.0), velocity: Vec2::new(0.5, 0.25) };
        assert_eq!(Sensor::EXACT.measure(&truth, &mut stream), truth);
        let sensor = Sensor::MOTION_CAPTURE;
        let all: Vec<Motion> = (0..4000).map(|_| sensor.measure(&truth, &mut stream)).collect();
        let deviation = |off: &dyn Fn(&Motion) -> Vec2| {
            let (sum, squares) = all.iter().map(off).fold((Vec2::zeros(), Vec2::zeros()), |(sum, squares), off| {
                (sum + off, squares + off.component_mul(&off))
            });
            assert!(sum.abs().max() / 4000.0 < squares.max(), "no bias");
            (squares / 4000.0).map(f32::sqrt)
        };
        let position = deviation(&|seen| seen.position - truth.position);
        let velocity = deviation(&|seen| seen.velocity - truth.velocity);
        let near = |deviation: Vec2, wanted: f32| (deviation / wanted).add_scalar(-1.0).abs().max() < 0.05;
        assert!(near(position, sensor.position_m), "{position}");
        assert!(near(velocity, sensor.velocity_m_s), "{velocity}");
    }
}
