//! Configuration of a training by imitation, read from one TOML file or from the preset. The same configuration, seed
//! and number of decisions give the same weights.

use serde::{Deserialize, Serialize};

use crate::network::Shape;
pub use crate::policy::Policy;
use murmurate::config::{self, ConfigError, in_range};
use murmurate::policy::file::AnyManifest;
use murmurate::policy::hops::action::Action;
use murmurate::policy::hops::manifest::Manifest;

/// Name of the preset that is the default in a scenario without goals which has none of its own.
pub const PRESET: &str = "imitation";
/// Presets, each with its name and TOML text. One that has the name of a scenario is the default in it.
pub const PRESETS: [(&str, &str); 2] = [
    (PRESET, include_str!("../../policies/flocking.toml")),
    ("coverage", include_str!("../../policies/coverage.toml")),
];

/// Configuration of a training by imitation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Number of robots in the team; the scenario's default if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robots: Option<usize>,
    /// Factor on the lengths of the scenario, but for the robots; 1 if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f32>,
    /// Radius of the robots' hull \[m\]; that of the paper's robots, 0.16 m, if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hull_m: Option<f32>,
    /// Name of the policy whose actions are learnt, in the registry.
    pub expert: String,
    /// Network and limits of the policy.
    pub policy: Policy,
    /// Parameters of the optimisation and of the rollouts.
    pub imitation: Imitation,
    /// Distributions from which each episode's conditions are drawn.
    pub conditions: Conditions,
}

/// Parameters of the optimisation and of the rollouts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Imitation {
    /// Quantity that is learnt: the acceleration, which is the default, or the velocity.
    #[serde(default = "acceleration", skip_serializing_if = "is_acceleration")]
    pub action: Action,
    /// Number of steps of 50 ms for which a decision is held; 1 if left out. A message of the decision before counts as
    /// one step old, as in a run, where every step is a decision.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub repeat: usize,
    /// Length that is 1 in the inputs of the network while it learns \[m\]; 1 m if left out. The weights of the policy
    /// file are for metres.
    #[serde(default = "unit", skip_serializing_if = "is_unit")]
    pub length_m: f32,
    /// Speed that is 1 in inputs and outputs of the network while it learns \[m/s\]; 1 m/s if left out. The weights of
    /// the policy file are for metres per second.
    #[serde(default = "unit", skip_serializing_if = "is_unit")]
    pub speed_m_s: f32,
    /// Number of episodes in an iteration.
    pub episodes: usize,
    /// Share of the episodes that the expert drives at the start of the training, 0 to 1; it falls linearly to zero.
    pub expert_share: f32,
    /// Progress of the training at which the expert drives no more, 0 to 1.
    pub expert_until: f32,
    /// Number of successive steps of a team that are learnt together.
    pub window: usize,
    /// Number of steps before these from which messages still count.
    pub lookback: usize,
    /// Number of windows in a minibatch.
    pub batch: usize,
    /// Learning rate at the start and at the end; it falls exponentially.
    pub learning_rate: [f32; 2],
    /// Largest norm of a gradient.
    pub max_gradient: f32,
}

/// Distributions from which the conditions of an episode are drawn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Share of the episodes in which robots step together and exchange all hops within a step, without loss. In the
    /// others every message is a step older or more.
    pub lockstep: f32,
    /// Least and largest probability that a receiver loses a message, in episodes without lock step.
    pub loss: [f32; 2],
}

fn acceleration() -> Action {
    Action::Acceleration
}

fn one() -> usize {
    1
}

fn unit() -> f32 {
    1.0
}

fn is_acceleration(action: &Action) -> bool {
    *action == Action::Acceleration
}

fn is_one(repeat: &usize) -> bool {
    *repeat == 1
}

fn is_unit(of_network: &f32) -> bool {
    of_network.to_bits() == 1.0_f32.to_bits()
}

impl Config {
    /// Returns the preset of this name, one of [`PRESETS`]; `None` if there is none.
    pub fn preset(name: &str) -> Option<Config> {
        let (_, text) = PRESETS.iter().find(|(other, _)| *other == name)?;
        Some(Config::from_toml(text).expect("a committed preset is valid; a test reads each"))
    }

    /// Returns the name of the default preset in the scenario named `scenario`.
    pub fn preset_of(scenario: &str) -> &'static str {
        PRESETS.iter().map(|(name, _)| *name).find(|name| *name == scenario).unwrap_or(PRESET)
    }

    /// Returns whether a text is such a configuration, and not one of reinforcement learning: it has a table
    /// `imitation`.
    pub fn is_in(text: &str) -> bool {
        text.parse::<toml::Table>().is_ok_and(|table| table.contains_key("imitation"))
    }

    /// Parses and checks a configuration in TOML. An error names the line or the field.
    pub fn from_toml(text: &str) -> Result<Config, ConfigError> {
        let config: Config = config::from_toml(text)?;
        config.check()?;
        Ok(config)
    }

    /// Converts a TOML table to a configuration, and checks it. An error names the field.
    pub fn from_table(table: &toml::Table) -> Result<Config, ConfigError> {
        let config: Config = config::from_table(table)?;
        config.check()?;
        Ok(config)
    }

    /// Checks all fields; the error names the field.
    pub fn check(&self) -> Result<(), ConfigError> {
        let Imitation { episodes, expert_share, expert_until, window, lookback, batch, learning_rate, .. } =
            &self.imitation;
        let Imitation { repeat, length_m, speed_m_s, max_gradient, .. } = &self.imitation;
        let counts =
            [("repeat", repeat, 200), ("episodes", episodes, 1024), ("window", window, 1024), ("batch", batch, 4096)];
        for (field, value, most) in counts {
            in_range(&format!("imitation.{field}"), *value as f64, (1.0, f64::from(most)))?;
        }
        in_range("imitation.lookback", *lookback as f64, (0.0, 64.0))?;
        in_range("imitation.expert_share", f64::from(*expert_share), (0.0, 1.0))?;
        in_range("imitation.expert_until", f64::from(*expert_until), (0.0, 1.0))?;
        in_range("imitation.length_m", f64::from(*length_m), (1e-3, 1e6))?;
        in_range("imitation.speed_m_s", f64::from(*speed_m_s), (1e-3, 1e3))?;
        for rate in learning_rate {
            in_range("imitation.learning_rate", f64::from(*rate), (1e-8, 1.0))?;
        }
        in_range("imitation.max_gradient", f64::from(*max_gradient), (1e-6, 1e6))?;
        in_range("conditions.lockstep", f64::from(self.conditions.lockstep), (0.0, 1.0))?;
        let [low, high] = self.conditions.loss;
        in_range("conditions.loss", f64::from(low), (0.0, f64::from(high)))?;
        in_range("conditions.loss", f64::from(high), (0.0, 0.95))?;
        in_range("policy.rate_hz", self.policy.rate_hz, (20.0, 20.0))?;
        // Without a width there is no network to check below.
        in_range("policy.hops", self.policy.hops as f64, (1.0, 8.0))?;
        for (field, widths) in [("message", &self.policy.message), ("update", &self.policy.update)] {
            in_range(&format!("policy.{field}"), widths.len() as f64, (1.0, 8.0))?;
        }
        let wrong = |text: String| match text.split_once(": ") {
            Some((field, reason)) => ConfigError::field(format!("policy.{field}"), reason.to_owned()),
            None => ConfigError::field("policy", text),
        };
        let manifest = self.policy.manifest("any", self.imitation.action, None).map_err(wrong)?;
        if let AnyManifest::Format1(_) = manifest {
            let why = "one hop with sums, relu and a velocity is of format 1, which imitation does not write: \
                       take more hops, the mean, or an edge with a distance";
            return Err(ConfigError::field("policy.hops", why));
        }
        Shape::of_manifest(&manifest).map(|_| ()).map_err(wrong)
    }

    /// Returns the manifest of the policy for a scenario.
    ///
    /// # Panics
    /// If the policy cannot have its fields together, which `check` excludes.
    pub fn manifest(&self, scenario: &str) -> Manifest {
        match self.policy.manifest(scenario, self.imitation.action, None) {
            Ok(AnyManifest::Format2(manifest)) => manifest,
            other => panic!("a checked policy is of format 2: {other:?}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::policy::hops::manifest::Aggregation;
    use murmurate::policy::hops::perceptron::Activation;

    #[test]
    fn wrong_fields_and_networks_that_training_does_not_support_are_named() {
        let refused = |change: fn(&mut Config)| {
            let mut config = Config::preset(PRESET).expect("it is a preset");
            change(&mut config);
            config.check().expect_err("it is wrong").to_string()
        };
        for (change, named) in [
            ((|config| config.imitation.window = 0) as fn(&mut Config), "imitation.window"),
            (|config| config.imitation.repeat = 201, "imitation.repeat"),
            (|config| config.imitation.length_m = 0.0, "imitation.length_m"),
            (|config| config.imitation.speed_m_s = f32::NAN, "imitation.speed_m_s"),
            (|config| config.conditions.loss = [0.5, 0.2], "conditions.loss"),
            (|config| config.policy.hops = 0, "policy.hops"),
            (|config| config.policy.update.clear(), "policy.update"),
            (|config| config.policy.aggregation = Aggregation::Max, "policy.hops.0.aggregation"),
            (|config| config.policy.activation = Activation::Elu, "policy.hops.0.message.output_activation"),
        ] {
            let why = refused(change);
            assert!(why.contains(named), "{named}: {why}");
        }
    }
}
