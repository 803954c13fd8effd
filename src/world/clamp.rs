//! How a wanted velocity is limited before it is commanded: by the Controller, and by the trainer.

use crate::messages::geometry::Vec2;

/// The limit between a policy and the wheels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Clamp {
    /// Its speed, as in training: what limits acceleration there is the world.
    #[default]
    Training,
    /// Its speed, and how far it is from the measured velocity, as on the published robots: nothing else limits
    /// their acceleration.
    Deployed,
}

/// How the published robots limit a change of velocity along each axis: the change times a gain \[1/s\] is an
/// acceleration \[m/s^2\], which is limited and divided by the gain again. So a command is within 0.25 m/s of the
/// measured velocity.
const DEPLOYED_GAIN_PER_S: f32 = 4.0;
const DEPLOYED_ACCELERATION_M_S2: f32 = 1.0;

impl Clamp {
    /// The velocity to command \[m/s\], of a robot that moves at `measured` \[m/s\], when the policy wants `wanted`
    /// \[m/s\] and no axis may be faster than `limit_m_s`.
    pub fn limit(self, wanted: Vec2, measured: Vec2, limit_m_s: f32) -> Vec2 {
        let within = |velocity: Vec2| velocity.map(|axis| axis.clamp(-limit_m_s, limit_m_s));
        match self {
            Clamp::Training => within(wanted),
            Clamp::Deployed => {
                let most = DEPLOYED_ACCELERATION_M_S2;
                let change = ((within(wanted) - measured) * DEPLOYED_GAIN_PER_S).map(|axis| axis.clamp(-most, most));
                // Once more, because a sensor may say anything.
                within(measured + change / DEPLOYED_GAIN_PER_S)
            }
        }
    }
}
