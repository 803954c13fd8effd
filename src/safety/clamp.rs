//! Limit on a policy's velocity before a robot is commanded to drive at it.
//!
//! Both the Controller, the actor that guards a robot's motors, and the trainer apply the limit.

use crate::messages::geometry::Vec2;

/// Limit on a policy's output velocity before a robot is commanded to drive at it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Clamp {
    /// Limits the speed along each axis only, as in training, where the simulated world itself limits acceleration.
    #[default]
    Training,
    /// Limits the speed along each axis and the difference from the measured velocity (0.25 m/s along each axis). The
    /// real robots of the paper had this limit, and no other limit of acceleration.
    Deployed,
}

/// Gain of the published robots' limit along each axis \[1/s\]. The change of velocity times this gain is an
/// acceleration, which is limited and divided by the gain again. So a command is within 0.25 m/s of the measured
/// velocity.
const DEPLOYED_GAIN_PER_S: f32 = 4.0;
/// Acceleration along each axis to which the published robots' limit ([`Clamp::Deployed`]) restricts commands
/// \[m/s^2\].
const DEPLOYED_ACCELERATION_M_S2: f32 = 1.0;

impl Clamp {
    /// Returns the largest difference \[m/s\] of a command from the measured velocity along each axis; infinite if it
    /// is not limited.
    pub fn step_m_s(self) -> f32 {
        match self {
            Clamp::Training => f32::INFINITY,
            Clamp::Deployed => DEPLOYED_ACCELERATION_M_S2 / DEPLOYED_GAIN_PER_S,
        }
    }

    /// Returns the velocity to command \[m/s\]. `wanted` is the policy's output \[m/s\] and `measured` the robot's
    /// measured velocity \[m/s\], in the same frame. `limit_m_s` is the largest speed along each axis \[m/s\].
    #[inline]
    pub fn limit(self, wanted: Vec2, measured: Vec2, limit_m_s: f32) -> Vec2 {
        let within = |velocity: Vec2| velocity.map(|axis| axis.clamp(-limit_m_s, limit_m_s));
        match self {
            Clamp::Training => within(wanted),
            Clamp::Deployed => {
                let max = DEPLOYED_ACCELERATION_M_S2;
                let change = ((within(wanted) - measured) * DEPLOYED_GAIN_PER_S).map(|axis| axis.clamp(-max, max));
                // Limited again, because the measured velocity may have any value.
                within(measured + change / DEPLOYED_GAIN_PER_S)
            }
        }
    }
}
