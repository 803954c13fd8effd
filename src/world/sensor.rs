//! Sensor model of a simulated robot's state: noise, rate and latency.
//!
//! The Body, the actor of a robot's motors and sensors, applies the model to the true states that its World sends.

use crate::messages::geometry::{Deviation, Motion, Vec2};
use crate::random;
use crate::random::Stream;
use crate::time::Span;

/// Noise, rate and latency of a sensor that measures the position and velocity of simulated robots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Standard deviation \[m\] of the Gaussian noise of a measured position, along each axis.
    pub position_m: f32,
    /// Standard deviation \[m/s\] of the Gaussian noise of a measured velocity, along each axis.
    pub velocity_m_s: f32,
    /// Shortest time between two measurements. If a step of the simulated world takes longer, the sensor measures once
    /// in each step.
    pub period: Span,
    /// Delay from the instant of a measurement until the reading is available.
    pub latency: Span,
}

impl Sensor {
    /// Ideal sensor without noise and latency, which measures at every step of the simulated world.
    pub const EXACT: Sensor = Sensor { position_m: 0.0, velocity_m_s: 0.0, period: Span::ZERO, latency: Span::ZERO };

    /// Motion capture system such as OptiTrack, which the paper used (section V), at 100 Hz.
    ///
    /// Position: OptiTrack states +-0.2 mm for its PrimeX cameras. Rate: 100 Hz is a usual setting. Velocity: the noise
    /// of a difference of positions three frames apart, sqrt(2) * 0.2 mm / 30 ms. Latency: 6 to 7 ms were measured to
    /// the end of such a chain (Qualisys at ETH Zurich, 200 Hz). At 100 Hz half a frame is added.
    pub const MOTION_CAPTURE: Sensor =
        Sensor { position_m: 2e-4, velocity_m_s: 0.01, period: Span::from_millis(10), latency: Span::from_millis(10) };

    /// Satellite receiver with real-time kinematic corrections (RTK, fixed solution), at 10 Hz.
    ///
    /// Position: 0.01 m + 1 ppm is stated for u-blox ZED-F9P receivers; with a moving antenna it is 2 cm. Velocity:
    /// 0.05 m/s is stated for the same receivers. Rate: 10 Hz. Latency: 100 ms through receiver, serial line and gpsd.
    pub const RTK: Sensor = Sensor {
        position_m: 0.02,
        velocity_m_s: 0.05,
        period: Span::from_millis(100),
        latency: Span::from_millis(100),
    };

    /// All predefined sensors, each with the name by which a user selects it (`--sensor`).
    pub const NAMED: [(&str, Sensor); 3] =
        [("exact", Sensor::EXACT), ("motion-capture", Sensor::MOTION_CAPTURE), ("rtk", Sensor::RTK)];

    /// Returns the standard deviations of this sensor's measurements, as a reading states them. Headings and yaw rates
    /// are measured without noise, so theirs are zero.
    pub fn deviation(&self) -> Deviation {
        Deviation {
            position_m: Some(self.position_m),
            heading_rad: Some(0.0),
            velocity_m_s: Some(self.velocity_m_s),
            yaw_rate_rad_s: Some(0.0),
        }
    }

    /// Returns a measurement of the true `motion` \[m, m/s\] with Gaussian noise drawn from `stream`. A quantity
    /// without noise is returned unchanged and draws no number from the stream.
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

/// Draws two independent numbers of the standard normal distribution.
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
        assert!(near(position, sensor.position_m), "{position:?}");
        assert!(near(velocity, sensor.velocity_m_s), "{velocity:?}");
    }
}
