//! Conditions of a simulation as a file: the world, and the links between robots. `study twin` writes what it has
//! fitted in this form; `sim`, `study` and `train` read it.

use serde::{Deserialize, Serialize};

use super::{Deployment, Impair, ImpairError};
use crate::config::{self, ConfigError};
use crate::world::Physics;

/// Conditions; a field that is `None` leaves what the command has.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Plant of the simulated robots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plant: Option<String>,
    /// Time constant of the drivetrains \[s\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lag_s: Option<f32>,
    /// Standard deviation of wheel slip, as a share of the commanded speed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slip: Option<f32>,
    /// Correlation time of wheel slip \[s\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slip_s: Option<f32>,
    /// Delay of messages between robots \[s\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_s: Option<f64>,
    /// Probability that a robot loses a message of another one, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub loss: Option<f64>,
}

impl Conditions {
    /// Reads conditions from TOML and checks their ranges; an error names the line or the field. The registry checks
    /// the plant's name.
    pub fn from_toml(text: &str) -> Result<Conditions, ConfigError> {
        let conditions: Conditions = config::from_toml(text)?;
        let fields = [
            ("lag_s", conditions.lag_s.map(f64::from), 10.0),
            ("slip", conditions.slip.map(f64::from), 1.0),
            ("slip_s", conditions.slip_s.map(f64::from), 60.0),
            ("delay_s", conditions.delay_s, 60.0),
            ("loss", conditions.loss, 1.0),
        ];
        for (field, value, most) in fields {
            if let Some(value) = value.filter(|value| !(0.0..=most).contains(value)) {
                return Err(ConfigError::field(field, format!("{value} is not 0 to {most}")));
            }
        }
        Ok(conditions)
    }

    /// Writes the conditions as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("conditions are TOML")
    }

    /// Returns physics with these conditions in place of their own; a lag \[s\] that a flag gives counts before theirs.
    pub fn physics(&self, physics: Physics, lag_s: Option<f32>) -> Physics {
        Physics {
            lag_s: lag_s.or(self.lag_s).unwrap_or(physics.lag_s),
            slip: self.slip.unwrap_or(physics.slip),
            slip_s: self.slip_s.unwrap_or(physics.slip_s),
            ..physics
        }
    }

    /// Whether they say something of the links.
    pub fn impair(&self) -> bool {
        self.delay_s.is_some() || self.loss.is_some()
    }

    /// Returns a deployment whose messages between robots have this delay and loss.
    pub fn links(&self, deployment: Deployment) -> Result<Deployment, ImpairError> {
        deployment.impaired(self.delay_s, self.loss, Impair::Latent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_survive_toml_and_wrong_ones_are_refused_by_field() {
        let conditions = Conditions { lag_s: Some(0.5), loss: Some(0.16), ..Conditions::default() };
        assert_eq!(Conditions::from_toml(&conditions.to_toml()), Ok(conditions));
        for (text, word) in [("loss = 2.0", "loss"), ("lag_s = -1.0", "lag_s"), ("lag = 1.0", "lag")] {
            assert!(Conditions::from_toml(text).unwrap_err().to_string().contains(word));
        }
    }
}
