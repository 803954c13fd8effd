//! The limit on a policy's velocity before it is commanded, used by the Controller and by the trainer.

use crate::messages::geometry::Vec2;

/// The limit applied to a policy's velocity before it is commanded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Clamp {
    /// Limits the speed only, as in training, where the world limits acceleration.
    #[default]
    Training,
    /// Limits the speed and the difference from the measured velocity, as on the published robots, which have no other
    /// limit of acceleration.
    Deployed,
}

/// Gain of the published robots' limit along each axis \[1/s\]. The change of velocity times this gain is an
/// acceleration, which is limited and divided by the gain again. So a command is within 0.25 m/s of the measured
/// velocity.
const DEPLOYED_GAIN_PER_S: f32 = 4.0;
/// Acceleration limit of the same \[m/s^2\].
const DEPLOYED_ACCELERATION_M_S2: f32 = 1.0;

impl Clamp {
    /// Returns the velocity to command \[m/s\] for a policy's output `wanted` \[m/s\], a measured velocity `measured`
    /// \[m/s\] and a speed limit `limit_m_s` along each axis.
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
