//! Quantity that the action of a policy of several hops is: a velocity or an acceleration.

use serde::{Deserialize, Serialize};

/// Quantity that a policy's action is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Action {
    /// The robot's velocity \[m/s\].
    #[default]
    Velocity,
    /// The robot's acceleration \[m/s²\]: the velocity is the measured one plus the acceleration, limited to 1 m/s²
    /// along each axis, times the period.
    Acceleration,
}

impl Action {
    /// Returns whether the action is a velocity.
    pub(crate) fn is_velocity(&self) -> bool {
        *self == Action::Velocity
    }
}
