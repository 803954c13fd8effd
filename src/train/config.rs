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

    /// Checks every number; the error names the field.
    pub fn check(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, reason: String| Err(ConfigError::field(field, reason));
        let within = |field: &str, value: f32, low: f32, high: f32| {
            if (low..=high).contains(&value) {
                Ok(())
            } else {
                Err(ConfigError::field(field, format!("{value} is not {low} to {high}")))
            }
        };
        let (ppo, conditions, reward) = (&self.ppo, &self.conditions, &self.reward);
        within("episode_s", self.episode_s, 0.1, 3600.0)?;
        let counts = [
            ("ppo.environments", ppo.environments, 1 << 20),
            ("ppo.decisions", ppo.decisions, 1 << 16),
            ("ppo.minibatch", ppo.minibatch, 1 << 24),
            ("ppo.epochs", ppo.epochs, 100),
        ];
        for (field, value, most) in counts {
            if value == 0 || value > most {
                return wrong(field, format!("{value} is not 1 to {most}"));
            }
        }
        if ppo.environments.saturating_mul(ppo.decisions) > 1 << 22 {
            return wrong("ppo.decisions", format!("{} x {} decisions are too many", ppo.environments, ppo.decisions));
        }
        if ppo.kl_stop.is_nan() || ppo.kl_stop <= 0.0 {
            return wrong("ppo.kl_stop", format!("{} is not above 0", ppo.kl_stop));
        }
        within("ppo.clip", ppo.clip, 1e-3, 1.0)?;
        within("ppo.gamma", ppo.gamma, 0.0, 1.0)?;
        within("ppo.lambda", ppo.lambda, 0.0, 1.0)?;
        within("ppo.gradient_clip", ppo.gradient_clip, 1e-6, 1e6)?;
        within("ppo.log_std", ppo.log_std, -10.0, 2.0)?;
        for at in [0, 1] {
            within("ppo.learning_rate", ppo.learning_rate[at], 1e-9, 1.0)?;
            within("ppo.entropy", ppo.entropy[at], 0.0, 1.0)?;
            within("ppo.log_std_max", ppo.log_std_max[at], -10.0, 2.0)?;
        }
        let weights = [
            ("reward.scale", reward.scale),
            ("reward.scenario", reward.scenario),
            ("reward.progress", reward.progress),
            ("reward.arrival", reward.arrival),
            ("reward.time", reward.time),
            ("reward.wall", reward.wall),
            ("reward.robot", reward.robot),
            ("reward.proximity", reward.proximity),
            ("reward.wall_proximity", reward.wall_proximity),
        ];
        for (field, value) in weights {
            within(field, value, 0.0, 1e4)?;
        }
        within("reward.proximity_m", reward.proximity_m, 1e-3, 100.0)?;
        within("reward.wall_proximity_m", reward.wall_proximity_m, 1e-3, 100.0)?;
        within("reward.shared", reward.shared, 0.0, 1.0)?;
        within("conditions.clean", conditions.clean, 0.0, 1.0)?;
        within("conditions.deployed", conditions.deployed, 0.0, 1.0)?;
        within("conditions.wall_radius_m", conditions.wall_radius_m, 1e-3, 10.0)?;
        within("conditions.edge_spread", conditions.edge_spread, 0.0, 1.0)?;
        within("conditions.everyone", conditions.everyone, 0.0, 1.0)?;
        within("conditions.wheels", conditions.wheels, 0.0, 1.0)?;
        let ranges = [
            ("conditions.lag_s", conditions.lag_s, 10.0),
            ("conditions.delay_s", conditions.delay_s, 0.5),
            ("conditions.loss", conditions.loss, 1.0),
            ("conditions.hold_s", conditions.hold_s, 0.5),
            ("conditions.range_std_m", conditions.range_std_m, 100.0),
            ("conditions.position_noise_m", conditions.position_noise_m, 10.0),
            ("conditions.velocity_noise_m_s", conditions.velocity_noise_m_s, 10.0),
        ];
        for (field, [low, high], most) in ranges {
            within(field, low, 0.0, most)?;
            within(field, high, low, most)?;
        }
        self.check_curriculum()?;
        if self.policy.message.len() < 2 {
            return wrong("policy.message", "a message network that is trained has two layers or more".to_owned());
        }
        if self.policy.encoder.is_empty() {
            return wrong("policy.encoder", "an encoder has a layer".to_owned());
        }
        if let Some(Critic { encoder, message, update }) = &self.critic {
            let fields = [("encoder", encoder, 1), ("message", message, 2), ("update", update, 0)];
            for (field, widths, least) in fields {
                if widths.len() < least || widths.iter().any(|width| !(1..=4096).contains(width)) {
                    return wrong(
                        &format!("critic.{field}"),
                        format!("{widths:?} is not {least} or more layers of 1 to 4096"),
                    );
                }
            }
        }
        self.manifest("any").check().map_err(|text| match text.split_once(": ") {
            Some((field, reason)) => ConfigError::field(format!("policy.{field}"), reason.to_owned()),
            None => ConfigError::field("policy", text),
        })
    }

    fn check_curriculum(&self) -> Result<(), ConfigError> {
        let wrong = |at: usize, field: &str, reason: String| {
            Err(ConfigError::field(format!("curriculum[{at}].{field}"), reason))
        };
        if self.curriculum.is_empty() {
            return Err(ConfigError::field("curriculum", "a training has a stage".to_owned()));
        }
        let mut begins = 0.0;
        for (at, stage) in self.curriculum.iter().enumerate() {
            if stage.until.is_nan() || stage.until <= begins || stage.until > 1.0 {
                return wrong(at, "until", format!("{} is not above {begins} and up to 1", stage.until));
            }
            begins = stage.until;
            let robots = |groups: &Vec<usize>| groups.iter().sum::<usize>();
            let team = stage.groups.first().map_or(0, robots);
            if team == 0 || stage.groups.iter().any(|groups| robots(groups) != team || groups.contains(&0)) {
                return wrong(at, "groups", format!("{:?} do not each make up the same team", stage.groups));
            }
            if !(0.0..=100.0).contains(&stage.penalties) {
                return wrong(at, "penalties", format!("{} is not 0 to 100", stage.penalties));
            }
            if !(1..=20).contains(&stage.repeat) {
                return wrong(at, "repeat", format!("{} is not 1 to 20", stage.repeat));
            }
        }
        if begins < 1.0 {
            return wrong(self.curriculum.len() - 1, "until", format!("the last stage ends at 1, not at {begins}"));
        }
        Ok(())
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
