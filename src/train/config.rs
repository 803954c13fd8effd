//! What a training run is made of, as data: one TOML file, two presets. Every run of one configuration, seed and
//! number of steps gives the same weights.

use serde::{Deserialize, Serialize};

use super::network::Shape;
use crate::config::{self, ConfigError};
use crate::policy::Draw;
use crate::policy::manifest::{Architecture, EdgeField, Field, Manifest};

/// The presets by name, each a committed file.
pub const PRESETS: &[(&str, &str)] = &[
    ("published", include_str!("../../policies/published.toml")),
    ("robust", include_str!("../../policies/robust.toml")),
];

/// A closed range that something is drawn from, uniformly.
pub type Range = [f32; 2];

/// A training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Size of the team; the scenario's own if left out.
    #[serde(default)]
    pub robots: Option<usize>,
    /// How long an episode lasts at most \[s\]; its end is no failure, what comes after is estimated.
    pub episode_s: f32,
    /// The network.
    pub policy: Policy,
    /// The critic's network; the policy's widths if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub critic: Option<Critic>,
    /// Proximal policy optimisation.
    pub ppo: Ppo,
    /// What a robot earns.
    pub reward: Reward,
    /// What episodes are like.
    pub conditions: Conditions,
    /// What is trained when.
    pub curriculum: Vec<Stage>,
}

/// The network and what its file will say of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Policy {
    /// How the message passing is laid out.
    pub architecture: Architecture,
    /// The observation's entries.
    pub observation: Vec<Field>,
    /// The message's edge features.
    #[serde(default)]
    pub edge: Vec<EdgeField>,
    /// Widths of the encoder's layers, the last one the message's.
    pub encoder: Vec<usize>,
    /// Widths of the message network's layers.
    pub message: Vec<usize>,
    /// Widths of the update network's layers but the last.
    pub update: Vec<usize>,
    /// Communication radius \[m\].
    pub radius_m: f32,
    /// Largest velocity along each axis \[m/s\].
    pub limit_m_s: f32,
    /// How long a message is held when the policy runs \[s\].
    pub hold_s: f64,
    /// How actions are drawn when the policy runs.
    pub draw: Draw,
}

/// Widths of the network that estimates what is still to be earned. It is thrown away after the training and sees
/// the whole team anyway, so it may be the lighter one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Critic {
    /// Of the encoder's layers.
    pub encoder: Vec<usize>,
    /// Of the message network's layers; with two of them no product is left to do per edge.
    pub message: Vec<usize>,
    /// Of the update network's layers but the last.
    pub update: Vec<usize>,
}

/// Proximal policy optimisation (Schulman et al., arXiv 1707.06347) with generalised advantages (arXiv 1506.02438).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ppo {
    /// Teams side by side.
    pub environments: usize,
    /// Decisions of each before an update.
    pub decisions: usize,
    /// Decisions in a minibatch.
    pub minibatch: usize,
    /// Passes over the decisions, at most.
    pub epochs: usize,
    /// Divergence from the old policy at which an update ends early; infinite for never.
    pub kl_stop: f32,
    /// How far the probability of an action may move, as a ratio.
    pub clip: f32,
    /// Discount of a step of 50 ms.
    pub gamma: f32,
    /// Weight of later advantages.
    pub lambda: f32,
    /// Learning rate at the beginning and at the end; in between it falls geometrically.
    pub learning_rate: [f32; 2],
    /// Norm that a gradient is cut to.
    pub gradient_clip: f32,
    /// Weight of the entropy, at the beginning and at the end.
    pub entropy: [f32; 2],
    /// Log standard deviation of actions at the beginning.
    pub log_std: f32,
    /// Cap on it, at the beginning and at the end.
    pub log_std_max: [f32; 2],
}

/// What a robot earns in a step; weights may be zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reward {
    /// Factor over everything.
    pub scale: f32,
    /// The scenario's own reward.
    pub scenario: f32,
    /// For each metre of its way that it has put behind it.
    pub progress: f32,
    /// For arriving, once.
    pub arrival: f32,
    /// For each second before it has arrived, taken away.
    pub time: f32,
    /// For touching a wall, taken away in each step.
    pub wall: f32,
    /// For touching a robot, taken away in each step.
    pub robot: f32,
    /// For coming near to a robot: for each second at no distance, less in proportion farther off.
    pub proximity: f32,
    /// How near is near \[m\].
    pub proximity_m: f32,
    /// For coming near to a wall, likewise.
    pub wall_proximity: f32,
    /// How near is near \[m\].
    pub wall_proximity_m: f32,
    /// Share of its reward that a robot takes from the mean of its team, 0 to 1.
    pub shared: f32,
}

/// What episodes are like; every range is drawn from for each episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Share of episodes in lock step with perfect messages.
    pub clean: f32,
    /// Share of episodes with the physics below; the others have the training environment's.
    pub deployed: f32,
    /// How near to a wall is a contact in those \[m\].
    pub wall_radius_m: f32,
    /// Drivetrain lag in those \[s\].
    pub lag_s: Range,
    /// How long a message takes \[s\].
    pub delay_s: Range,
    /// Share of messages lost.
    pub loss: Range,
    /// How much delay and loss differ from one pair of robots to the next, 0 to 1.
    pub edge_spread: f32,
    /// How long a message is held \[s\].
    pub hold_s: Range,
    /// Standard deviation of the communication radius \[m\].
    pub range_std_m: Range,
    /// Standard deviation of a measured position \[m\].
    pub position_noise_m: Range,
    /// Standard deviation of a measured velocity \[m/s\].
    pub velocity_noise_m_s: Range,
    /// Share of all episodes in which everyone hears everyone, however far away.
    #[serde(default)]
    pub everyone: f32,
    /// Share of the deployed episodes in which the wheels limit acceleration, as in training, and no controller does.
    #[serde(default)]
    pub wheels: f32,
}

/// A stretch of training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// It ends at this share of the whole training; the last one's is 1.
    pub until: f64,
    /// How the robots of an environment are split into teams; environments take these in turn.
    pub groups: Vec<Vec<usize>>,
    /// World steps that an action is held.
    pub repeat: u32,
    /// Width of the bottleneck \[m\]; the scenario's own if left out.
    #[serde(default)]
    pub gap_m: Option<f32>,
    /// Factor over the penalties for touching and for coming near: small ones let beginners move at all.
    pub penalties: f32,
}

impl Reward {
    /// With all penalties for touching and for coming near multiplied.
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
    /// The configuration of that name.
    pub fn preset(name: &str) -> Option<Config> {
        let (_, text) = PRESETS.iter().find(|(preset, _)| *preset == name)?;
        Some(Config::from_toml(text).expect("the committed presets are sound; a test reads them all"))
    }

    /// Reads and checks a configuration.
    pub fn from_toml(text: &str) -> Result<Config, ConfigError> {
        let config: Config = config::from_toml(text)?;
        config.check()?;
        Ok(config)
    }

    /// The stage at this share of the whole training.
    pub fn stage(&self, progress: f64) -> usize {
        let last = self.curriculum.len() - 1;
        self.curriculum.iter().position(|stage| progress < stage.until).unwrap_or(last)
    }

    /// What the file of a trained policy will say, but for its training and its hash.
    pub fn manifest(&self, scenario: &str) -> Manifest {
        let policy = &self.policy;
        let shape = self.actor();
        Manifest {
            scenario: scenario.to_owned(),
            architecture: policy.architecture,
            observation: policy.observation.clone(),
            edge: policy.edge.clone(),
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

    /// The policy's network.
    pub fn actor(&self) -> Shape {
        let policy = &self.policy;
        let edge = policy.edge.iter().map(|field| field.floats()).sum();
        let widths = [&policy.encoder, &policy.message, &policy.update];
        shape(policy.architecture, 2 * policy.observation.len(), edge, widths, 4)
    }

    /// The network that estimates what is still to be earned: it sees all of its team, and more of each.
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

/// A network's widths from those of its hidden layers: encoder, message and update network.
fn shape(
    architecture: Architecture,
    inputs: usize,
    edge: usize,
    [encoder, message, update]: [&Vec<usize>; 3],
    outputs: usize,
) -> Shape {
    let widths = |input: usize, rest: &[usize]| [&[input], rest].concat();
    let last = |widths: &[usize]| widths.last().copied().unwrap_or(0);
    let (hidden, heard) = (last(encoder), last(message));
    let (gathered, updated) = match architecture {
        Architecture::Published => (hidden, heard),
        Architecture::Full => (2 * hidden + edge, hidden + heard),
    };
    let update = [&widths(updated, update)[..], &[outputs]].concat();
    Shape { architecture, encoder: widths(inputs, encoder), message: widths(gathered, message), update, edge }
}
