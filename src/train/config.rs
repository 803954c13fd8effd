//! Configuration of a training: one TOML file, with two presets. The same configuration, seed and number of steps give
//! the same weights.

use serde::{Deserialize, Serialize};

use super::network::Shape;
use crate::chassis::{self, Chassis};
use crate::config::{self, ConfigError};
use crate::policy::Draw;
use crate::policy::manifest::{Activation, Aggregation, Architecture, EdgeField, Field, Manifest};

/// Presets: name and text of each, from a committed file.
pub const PRESETS: &[(&str, &str)] = &[
    ("published", include_str!("../../policies/published.toml")),
    ("robust", include_str!("../../policies/robust.toml")),
];

/// Bounds of a uniform distribution, \[low, high\].
pub type Range = [f32; 2];

/// Configuration of a training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Size of the team; the scenario's default if left out.
    #[serde(default)]
    pub robots: Option<usize>,
    /// Longest duration of an episode \[s\]. The episode is then truncated: the value of its last state is estimated.
    pub episode_s: f32,
    /// Chassis of the robots; holonomic without limits if left out.
    #[serde(default, skip_serializing_if = "chassis::Settings::is_empty")]
    pub body: chassis::Settings,
    /// The policy's network and interface.
    pub policy: Policy,
    /// Widths of the critic's network; `None` for those of the policy's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub critic: Option<Critic>,
    /// Parameters of proximal policy optimisation.
    pub ppo: Ppo,
    /// Weights of the reward's terms.
    pub reward: Reward,
    /// Distribution of the episodes' conditions.
    pub conditions: Conditions,
    /// Stages of the training.
    pub curriculum: Vec<Stage>,
}

/// The policy's network, and the parameters for its manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Policy {
    /// Layout of the message passing.
    pub architecture: Architecture,
    /// Entries of the observation.
    pub observation: Vec<Field>,
    /// Features of an edge.
    #[serde(default)]
    pub edge: Vec<EdgeField>,
    /// Widths of the encoder's layers; the last one is that of the broadcast latent.
    pub encoder: Vec<usize>,
    /// Widths of the message network's layers.
    pub message: Vec<usize>,
    /// Widths of the update network's layers but the last.
    pub update: Vec<usize>,
    /// Communication radius \[m\].
    pub radius_m: f32,
    /// Largest velocity along each axis \[m/s\].
    pub limit_m_s: f32,
    /// Age up to which a message is used when the policy runs \[s\].
    pub hold_s: f64,
    /// Method of drawing actions when the policy runs.
    pub draw: Draw,
}

/// Widths of the critic's network, which estimates values. It is not used after the training and observes the whole
/// team, so it may be smaller than the policy's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Critic {
    /// Widths of the encoder's layers.
    pub encoder: Vec<usize>,
    /// Widths of the message network's layers; with two layers, no matrix product is computed per edge.
    pub message: Vec<usize>,
    /// Widths of the update network's layers but the last.
    pub update: Vec<usize>,
}

/// Parameters of proximal policy optimisation (Schulman et al., arXiv 1707.06347) with generalised advantage estimation
/// (arXiv 1506.02438).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ppo {
    /// Number of parallel environments, each with a row of robots.
    pub environments: usize,
    /// Number of decisions of each environment in a rollout.
    pub decisions: usize,
    /// Number of decisions in a minibatch.
    pub minibatch: usize,
    /// Largest number of epochs of an update.
    pub epochs: usize,
    /// KL divergence from the old policy at which an update stops early; may be infinite.
    pub kl_stop: f32,
    /// Clipping range of the probability ratio around 1.
    pub clip: f32,
    /// Discount factor for a step of 50 ms.
    pub gamma: f32,
    /// Decay factor lambda of generalised advantage estimation.
    pub lambda: f32,
    /// Learning rate at the beginning and at the end, interpolated geometrically.
    pub learning_rate: [f32; 2],
    /// Largest norm of a gradient; longer ones are scaled down to it.
    pub gradient_clip: f32,
    /// Weight of the entropy at the beginning and at the end, interpolated linearly.
    pub entropy: [f32; 2],
    /// Initial log standard deviation of actions.
    pub log_std: f32,
    /// Upper limit of the log standard deviation at the beginning and at the end, interpolated linearly.
    pub log_std_max: [f32; 2],
}

/// Weights of the terms of a robot's reward in a step; each may be zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reward {
    /// Factor on the sum of all terms.
    pub scale: f32,
    /// Weight of the scenario's own reward; 0 if the scenario has none.
    pub scenario: f32,
    /// Reward per metre by which the remaining path becomes shorter \[1/m\].
    pub progress: f32,
    /// Reward for the arrival, once.
    pub arrival: f32,
    /// Penalty per second before the arrival \[1/s\].
    pub time: f32,
    /// Penalty for each step with a wall contact.
    pub wall: f32,
    /// Penalty for each step with a robot contact.
    pub robot: f32,
    /// Penalty per second for another robot at distance zero \[1/s\]; decreases linearly to zero at `proximity_m`.
    pub proximity: f32,
    /// Distance between robots' centres from which the penalty is zero \[m\].
    pub proximity_m: f32,
    /// Penalty per second for a wall at distance zero \[1/s\]; decreases linearly to zero at `wall_proximity_m`.
    pub wall_proximity: f32,
    /// Distance of a robot's centre from a wall from which the penalty is zero \[m\].
    pub wall_proximity_m: f32,
    /// Weight of the team's mean reward in a robot's reward, 0 to 1.
    pub shared: f32,
}

/// Distribution of the episodes' conditions; a value is drawn from every range for each episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Probability of lock step with perfect messages.
    pub clean: f32,
    /// Probability of deployed physics: a lag, and contacts that fail the episode but do not block a move. The other
    /// episodes have the training environment's physics.
    pub deployed: f32,
    /// Distance between a robot's centre and a wall below which the robot touches the wall \[m\], with deployed
    /// physics.
    pub wall_radius_m: f32,
    /// Drivetrain lag \[s\], with deployed physics.
    pub lag_s: Range,
    /// Delay of messages \[s\].
    pub delay_s: Range,
    /// Loss probability of messages.
    pub loss: Range,
    /// Largest relative deviation of the delay and loss between two robots from those of the episode, 0 to 1.
    pub edge_spread: f32,
    /// Age up to which a message is used \[s\].
    pub hold_s: Range,
    /// Standard deviation of the communication radius \[m\].
    pub range_std_m: Range,
    /// Standard deviation of a measured position \[m\].
    pub position_noise_m: Range,
    /// Standard deviation of a measured velocity \[m/s\].
    pub velocity_noise_m_s: Range,
    /// Probability that an episode has unlimited communication range.
    #[serde(default)]
    pub everyone: f32,
    /// Probability, with deployed physics, that the world limits acceleration instead of the controller.
    #[serde(default)]
    pub wheels: f32,
}

/// A stage of the curriculum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Progress of the training at which the stage ends; 1 for the last stage.
    pub until: f64,
    /// Sizes of the teams into which an environment's robots are split; environments take the entries in turn.
    pub groups: Vec<Vec<usize>>,
    /// Number of world steps for which an action is held.
    pub repeat: u32,
    /// Width of the bottleneck \[m\]; the scenario's default if left out.
    #[serde(default)]
    pub gap_m: Option<f32>,
    /// Factor on the penalties for contacts and proximity. With large penalties, an untrained policy learns to stand
    /// still.
    pub penalties: f32,
}

impl Reward {
    /// Returns the weights with all penalties for contacts and proximity multiplied by `factor`.
    pub fn with_penalties(self, factor: f32) -> Reward {
        Reward {
            wall: factor * self.wall,
            robot: factor * self.robot,
            proximity: factor * self.proximity,
            wall_proximity: factor * self.wall_proximity,
            ..self
        }
    }
}

impl Config {
    /// Returns the preset of this name; `None` if there is none.
    pub fn preset(name: &str) -> Option<Config> {
        let (_, text) = PRESETS.iter().find(|(preset, _)| *preset == name)?;
        Some(Config::from_toml(text).expect("the committed presets are valid; a test reads them all"))
    }

    /// Parses and checks a configuration in TOML; an error names the line or the field.
    pub fn from_toml(text: &str) -> Result<Config, ConfigError> {
        let config: Config = config::from_toml(text)?;
        config.check()?;
        Ok(config)
    }

    /// Index of the stage at this progress of the training, 0 to 1.
    pub fn stage(&self, progress: f64) -> usize {
        let last = self.curriculum.len() - 1;
        self.curriculum.iter().position(|stage| progress < stage.until).unwrap_or(last)
    }

    /// Returns the manifest of a trained policy, without the training's data and without the hash.
    pub fn manifest(&self, scenario: &str) -> Manifest {
        let policy = &self.policy;
        let shape = self.actor();
        Manifest {
            scenario: scenario.to_owned(),
            architecture: policy.architecture,
            observation: policy.observation.clone(),
            edge: policy.edge.clone(),
            activation: Some(Activation::Relu),
            aggregation: Some(Aggregation::Sum),
            encoder: shape.encoder,
            message: shape.message,
            update: shape.update,
            draw: policy.draw,
            radius_m: policy.radius_m,
            limit_m_s: policy.limit_m_s,
            hold_s: policy.hold_s,
            log_std_max: Some(self.ppo.log_std_max[1]),
            ..Manifest::published()
        }
    }

    /// Chassis of the robots of a checked configuration.
    pub fn chassis(&self) -> Chassis {
        self.body.chassis().expect("a checked configuration has a sound chassis")
    }

    /// Shape of the policy's network.
    pub fn actor(&self) -> Shape {
        let policy = &self.policy;
        let edge = policy.edge.iter().map(|field| field.floats()).sum();
        let widths = [&policy.encoder, &policy.message, &policy.update];
        shape(policy.architecture, 2 * policy.observation.len(), edge, widths, 4)
    }

    /// Shape of the critic's network, which observes all robots of its team and privileged information about each.
    pub fn critic(&self) -> Shape {
        let policy = &self.policy;
        let widths = match &self.critic {
            Some(critic) => [&critic.encoder, &critic.message, &critic.update],
            None => [&policy.encoder, &policy.message, &policy.update],
        };
        let inputs = 2 * policy.observation.len() + super::observe::PRIVILEGED;
        shape(Architecture::Full, inputs, 2, widths, 1)
    }
}

/// The shape of a network from the widths of its hidden layers: encoder, message and update network.
fn shape(
    architecture: Architecture,
    inputs: usize,
    edge: usize,
    [encoder, message, update]: [&Vec<usize>; 3],
    outputs: usize,
) -> Shape {
    let widths = |input: usize, rest: &[usize]| [&[input], rest].concat();
    let last = |widths: &[usize]| widths.last().copied().unwrap_or(0);
    let (hidden, messages) = (last(encoder), last(message));
    let (message_inputs, update_inputs) = match architecture {
        Architecture::Published => (hidden, messages),
        Architecture::Full => (2 * hidden + edge, hidden + messages),
    };
    let update = [&widths(update_inputs, update)[..], &[outputs]].concat();
    Shape { architecture, encoder: widths(inputs, encoder), message: widths(message_inputs, message), update, edge }
}
