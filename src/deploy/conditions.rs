//! Conditions of a simulation as a TOML file: properties of the simulated robots, size of their task, and delay and
//! loss of messages between them. `study twin` writes the values that it has fitted in this form; `sim`, `study` and
//! `train` read it.

use serde::{Deserialize, Serialize};

use super::{Deployment, Impair, ImpairError};
use crate::config::{self, ConfigError};
use crate::scenario::Settings;
use crate::world::Physics;

/// Conditions of a simulation: plant, properties of the robots' motion, and delay and loss of messages. A field that is
/// `None` leaves the setting of the command unchanged.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Name of the plant that moves the simulated robots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plant: Option<String>,
    /// Time constant of the first-order lag from commanded to true velocity of the robots \[s\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lag_s: Option<f32>,
    /// Standard deviation of wheel slip, as a share of the commanded speed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slip: Option<f32>,
    /// Correlation time of wheel slip \[s\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slip_s: Option<f32>,
    /// Radius of the robots' hull \[m\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hull_m: Option<f32>,
    /// Factor on the lengths of the task, but for the robots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f32>,
    /// Delay of messages between robots \[s\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_s: Option<f64>,
    /// Probability that a robot loses a message of another one, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub loss: Option<f64>,
}

impl Conditions {
    /// Reads conditions from TOML and checks the ranges of the numbers; an error names the line or the field. The
    /// plant's name is not checked.
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

    /// Returns the properties `physics` of simulated robots with the lag and wheel slip that these conditions set. A
    /// `lag_s` \[s\], from a command line flag, takes precedence over that of the conditions.
    pub fn physics(&self, physics: Physics, lag_s: Option<f32>) -> Physics {
        Physics {
            lag_s: lag_s.or(self.lag_s).unwrap_or(physics.lag_s),
            slip: self.slip.unwrap_or(physics.slip),
            slip_s: self.slip_s.unwrap_or(physics.slip_s),
            ..physics
        }
    }

    /// Returns `settings` of a scenario with the scale and hull of these conditions, where they are not set.
    pub fn under(&self, settings: Settings) -> Settings {
        Settings { scale: settings.scale.or(self.scale), hull_m: settings.hull_m.or(self.hull_m), ..settings }
    }

    /// Whether the conditions set a delay or a loss of messages.
    pub fn impair(&self) -> bool {
        self.delay_s.is_some() || self.loss.is_some()
    }

    /// Returns `deployment` with the delay and loss of these conditions on messages between robots (latents). Fails if
    /// no latent crosses a link, or if a value is out of range.
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
