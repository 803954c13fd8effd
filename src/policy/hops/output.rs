//! Meaning of the four outputs of a policy's network: the parameters of the distribution of a velocity or an
//! acceleration.

use super::action::Action;
use super::manifest::{Deviation, Distribution, OUTPUTS};
use crate::messages::geometry::Vec2;
use crate::policy::Draw;
use crate::policy::flock::accelerated;
use crate::random::{self, Stream};
use crate::time::Span;

/// Meaning of the outputs of a policy's network, by which an action is made of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Meaning {
    /// Quantity that the action is.
    pub action: Action,
    /// Probability distribution of the action.
    pub distribution: Distribution,
    /// Meaning of the last two outputs.
    pub deviation: Deviation,
    /// Upper limit of the logarithm of the standard deviation; `None` for none.
    pub log_std_max: Option<f32>,
    /// Largest speed along each axis \[m/s\].
    pub limit_m_s: f32,
    /// Time between two steps.
    pub period: Span,
}

impl Meaning {
    /// Returns the velocity \[m/s\] that the `outputs` mean, drawn by the method `draw`, of a robot with the measured
    /// velocity `own` \[m/s\]; all in the policy frame.
    pub fn velocity(&self, outputs: &[f32; OUTPUTS], own: Vec2, draw: Draw, stream: &mut Stream) -> Vec2 {
        let normal = match draw {
            Draw::Mean => Vec2::new(outputs[0], outputs[1]),
            Draw::Sample => {
                let [x, y] = random::normals(stream);
                let drawn = |mean: f32, parameter: f32, unit: f64| mean + unit as f32 * self.deviation(parameter);
                Vec2::new(drawn(outputs[0], outputs[2], x), drawn(outputs[1], outputs[3], y))
            }
        };
        if self.action == Action::Acceleration {
            return accelerated(own, normal, self.period);
        }
        match self.distribution {
            Distribution::DiagonalNormal => normal,
            Distribution::TanhNormal => normal.map(|axis| self.limit_m_s * libm::tanhf(axis)),
        }
    }

    /// Returns the standard deviation for the network's output `parameter`.
    fn deviation(&self, parameter: f32) -> f32 {
        match self.deviation {
            Deviation::Log => libm::expf(self.log_std_max.map_or(parameter, |max| parameter.min(max))),
            Deviation::BiasedSoftplus => {
                /// Smallest standard deviation.
                const LEAST: f32 = 0.01;
                // softplus(shift) = 1 - LEAST, so that an output of zero gives a deviation of one.
                let shift = libm::logf(libm::expm1f(1.0 - LEAST));
                softplus(parameter + shift) + LEAST
            }
        }
    }
}

/// Returns ln(1 + exp(x)), without overflow.
fn softplus(x: f32) -> f32 {
    x.max(0.0) + libm::log1pf(libm::expf(-x.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Seed;

    fn meaning(distribution: Distribution, deviation: Deviation) -> Meaning {
        let (action, period) = (Action::Velocity, Span::from_millis(50));
        Meaning { action, distribution, deviation, log_std_max: None, limit_m_s: 1.5, period }
    }

    fn drawn(meaning: &Meaning, outputs: [f32; OUTPUTS], draw: Draw) -> Vec2 {
        meaning.velocity(&outputs, Vec2::new(0.5, 0.5), draw, &mut Seed::of_run(1).stream("draw"))
    }

    #[test]
    fn a_tanh_normal_is_the_limit_times_the_tangent_of_its_normal() {
        let raw = [0.5, -2.0, -0.3, 0.2];
        for draw in [Draw::Mean, Draw::Sample] {
            let normal = drawn(&meaning(Distribution::DiagonalNormal, Deviation::Log), raw, draw);
            let squashed = drawn(&meaning(Distribution::TanhNormal, Deviation::Log), raw, draw);
            assert_eq!(squashed, normal.map(|axis| 1.5 * libm::tanhf(axis)));
        }
        let mean = drawn(&meaning(Distribution::DiagonalNormal, Deviation::Log), raw, Draw::Mean);
        assert_eq!(mean, Vec2::new(0.5, -2.0));
    }

    #[test]
    fn an_acceleration_changes_the_measured_velocity_within_its_limit() {
        let velocities = meaning(Distribution::DiagonalNormal, Deviation::Log);
        let velocity =
            drawn(&Meaning { action: Action::Acceleration, ..velocities }, [0.4, -7.0, 0.0, 0.0], Draw::Mean);
        assert!((velocity - Vec2::new(0.52, 0.45)).norm() < 1e-6, "{velocity:?}");
    }

    #[test]
    fn deviations_are_exponentials_or_a_softplus_that_is_one_at_zero() {
        let deviation = |kind, x: f32| meaning(Distribution::TanhNormal, kind).deviation(x);
        assert!((deviation(Deviation::Log, 0.5) - 0.5f64.exp() as f32).abs() < 1e-6);
        assert!((deviation(Deviation::BiasedSoftplus, 0.0) - 1.0).abs() < 1e-6);
        // The formula of TorchRL, in 64 bits.
        let formula = |x: f64| (x + 0.99f64.exp_m1().ln()).exp().ln_1p() + 0.01;
        for x in [-3.0, 2.0, 50.0] {
            assert!((f64::from(deviation(Deviation::BiasedSoftplus, x as f32)) - formula(x)).abs() < 1e-4, "{x}");
        }
    }

    #[test]
    fn log_std_max_limits_the_log_standard_deviation_of_samples() {
        let action = |log_std_max: Option<f32>, log_std: f32| {
            let meaning = Meaning { log_std_max, ..meaning(Distribution::DiagonalNormal, Deviation::Log) };
            drawn(&meaning, [0.0, 0.0, log_std, log_std], Draw::Sample)
        };
        assert_ne!(action(Some(-1.0), 2.0), action(None, 2.0));
        assert_eq!(action(Some(-1.0), 2.0), action(None, -1.0));
        assert_eq!(action(Some(-1.0), -3.0), action(None, -3.0));
    }
}
