//! Configuration of a training, read from one TOML file or from a preset. The same configuration, seed and number of
//! decisions give the same weights.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::network::Shape;
use super::observe::PRIVILEGED;
pub use super::policy::Policy;
pub use super::roles::{Role, Roles};
pub use super::weights::Reward;
use murmurate::chassis::{self, Chassis};
use murmurate::config::{self, ConfigError};
use murmurate::policy::file::AnyManifest;
use murmurate::policy::hops::action::Action;
use murmurate::policy::hops::entry;
use murmurate::policy::manifest::Architecture;
use murmurate::scenario::{Settings, TaskFile};
use murmurate::senses;

/// Name and TOML text of each preset, a predefined configuration of a training.
pub const PRESETS: &[(&str, &str)] = &[
    ("published", include_str!("../policies/published.toml")),
    ("robust", include_str!("../policies/robust.toml")),
    ("any-size", include_str!("../policies/any-size.toml")),
];

/// Bounds of a uniform distribution: \[low, high\].
pub type Range = [f32; 2];

/// Configuration of a training: team, networks, algorithm, reward, conditions and curriculum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Number of robots in the team; the scenario's default if left out.
    #[serde(default)]
    pub robots: Option<usize>,
    /// Factor on the lengths of the scenario, but for the robots; 1 if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f32>,
    /// Radius of the robots' hull \[m\]; that of the paper's robots, 0.16 m, if left out. Distances of contact and
    /// nearness of this configuration are those of that hull, and grow or shrink with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hull_m: Option<f32>,
    /// Longest duration of an episode \[s\]. An episode that reaches it is truncated: the critic estimates the value of
    /// its last state.
    pub episode_s: f32,
    /// Chassis of the robots; holonomic without limits on speed and acceleration if left out.
    #[serde(default, skip_serializing_if = "chassis::Settings::is_empty")]
    pub body: chassis::Settings,
    /// Senses of each robot, by the names by which the policy's observation takes them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub senses: BTreeMap<String, senses::Settings>,
    /// Network, observation and limits of the policy.
    pub policy: Policy,
    /// Roles, each with the robots that have it and what their policy has in place of `policy`; none if left out.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub roles: Roles,
    /// Layer widths of the critic's network; the policy's widths if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub critic: Option<Critic>,
    /// Parameters of proximal policy optimisation, the learning algorithm.
    pub ppo: Ppo,
    /// Policy that is imitated besides; none if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expert: Option<Imitated>,
    /// Weights of the terms of a robot's reward.
    pub reward: Reward,
    /// Distributions from which each episode's conditions are drawn.
    pub conditions: Conditions,
    /// Stages of the curriculum, in the order of the training.
    pub curriculum: Vec<CurriculumStage>,
}

/// Layer widths of the critic's network, which estimates values during the training only. It observes the whole team,
/// so it may be smaller than the policy's network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Critic {
    /// Widths of the layers of the critic's encoder.
    pub encoder: Vec<usize>,
    /// Widths of the layers of the critic's message network. With two layers, no matrix product is computed per edge.
    pub message: Vec<usize>,
    /// Widths of the layers of the critic's update network, without the output layer.
    pub update: Vec<usize>,
}

/// Parameters of proximal policy optimisation (Schulman et al., arXiv 1707.06347) with generalised advantage estimation
/// (arXiv 1506.02438).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ppo {
    /// Number of environments that run in parallel. The robots of an environment are those of one configured team.
    pub environments: usize,
    /// Number of decisions of each environment in a rollout.
    pub decisions: usize,
    /// Number of decisions from which one step of the optimiser is computed.
    pub minibatch: usize,
    /// Number of successive decisions of an environment that are learnt together, for a policy with memory or several
    /// hops; 8 if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub window: Option<usize>,
    /// Number of decisions before a window from which memory and messages are computed anew; 1 if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lookback: Option<usize>,
    /// Largest number of passes over a rollout in one update.
    pub epochs: usize,
    /// KL divergence from the policy before the update at which the update stops early; may be infinite.
    pub kl_stop: f32,
    /// Half width of the interval around 1 to which the probability ratio is clipped.
    pub clip: f32,
    /// Discount factor for a step of 50 ms.
    pub gamma: f32,
    /// Decay factor lambda of generalised advantage estimation, 0 to 1.
    pub lambda: f32,
    /// Learning rate at the beginning and at the end of the training, interpolated geometrically.
    pub learning_rate: [f32; 2],
    /// Largest norm of a gradient; a longer gradient is scaled down to it.
    pub gradient_clip: f32,
    /// Weight of the entropy at the beginning and at the end of the training, interpolated linearly.
    pub entropy: [f32; 2],
    /// Initial log standard deviation of actions, with the standard deviation in m/s.
    pub log_std: f32,
    /// Upper limit of the log standard deviation at the beginning and at the end of the training, interpolated
    /// linearly.
    pub log_std_max: [f32; 2],
    /// Weight in the policy's loss of the squares of the parts of its means beyond `policy.limit_m_s` \[s²/m²\].
    /// It keeps the means within the limit, where different actions lead to different speeds.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub overshoot: f32,
}

/// Policy that says in each state what it would do, and the weight of what the trained policy does otherwise. So a
/// training that rewards alone would begin too slowly learns first what the expert can, and then what it cannot
/// (Schmitt et al., "Kickstarting deep reinforcement learning", arXiv 1803.03835, with a scripted expert).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Imitated {
    /// Name of the expert in the registry, such as `claim`.
    pub policy: String,
    /// Weight in the policy's loss of the squared difference of its mean velocity from the expert's \[s²/m²\], at the
    /// beginning and at `until`; linear in between, and constant after it. Without weight the expert is not asked.
    pub weight: [f32; 2],
    /// Progress of the training at which the weight has its second value, above 0 and at most 1.
    pub until: f64,
}

impl Imitated {
    /// Returns the weight at the completed fraction `progress` of the training, 0 to 1.
    pub fn weight(&self, progress: f64) -> f32 {
        let [from, to] = self.weight;
        from + (to - from) * (progress / self.until).min(1.0) as f32
    }
}

fn is_zero(weight: &f32) -> bool {
    *weight == 0.0
}

/// Distributions of the episodes' conditions. For each episode, a value is drawn from every range.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Probability that all robots of an episode act at the same time, with messages that have neither delay nor loss.
    pub clean: f32,
    /// Probability that an episode has deployed physics: the drivetrain lags, and a contact makes the episode fail but
    /// does not block the move. All other episodes have the physics of the paper's environment.
    pub deployed: f32,
    /// Distance between a robot's centre and a wall below which the robot touches the wall \[m\], in deployed physics.
    pub wall_radius_m: f32,
    /// Time constant of the drivetrain lag \[s\], in deployed physics.
    pub lag_s: Range,
    /// Mean delay of an episode's messages \[s\].
    pub delay_s: Range,
    /// Mean loss probability of an episode's messages.
    pub loss: Range,
    /// Largest relative deviation of the delay and loss between two robots from the episode's means, 0 to 1.
    pub edge_spread: f32,
    /// Age up to which a robot uses a message \[s\], counted from its arrival.
    pub hold_s: Range,
    /// Standard deviation of the communication range \[m\], which is drawn anew for each message.
    pub range_std_m: Range,
    /// Standard deviation of the noise on each axis of a measured position \[m\].
    pub position_noise_m: Range,
    /// Standard deviation of the noise on each axis of a measured velocity \[m/s\].
    pub velocity_noise_m_s: Range,
    /// Probability that an episode's communication range is unlimited.
    #[serde(default)]
    pub everyone: f32,
    /// Probability, in deployed physics, that the simulated wheels limit acceleration instead of the robot's
    /// controller.
    #[serde(default)]
    pub wheels: f32,
    /// Probability, in deployed physics, that the safety filter of real robots limits the policy's velocities.
    #[serde(default)]
    pub filtered: f32,
    /// Probability of the safety filter in all other episodes, those with the physics of the paper's environment.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub filtered_published: f32,
    /// Size of the smallest team all of whose episodes have deployed physics and the safety filter, such as of teams
    /// that would always collide without it; none if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filtered_from: Option<usize>,
    /// Range of `wall_radius_m` \[m\] in deployed physics with the safety filter, whose minimum distances grow with it;
    /// `wall_radius_m` itself if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filtered_wall_radius_m: Option<Range>,
}

/// One stage of the curriculum: settings that hold for a part of the training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CurriculumStage {
    /// Progress of the training at which the stage ends, 0 to 1; 1 for the last stage.
    pub until: f64,
    /// Ways to split an environment's robots into teams, each a list of team sizes. Environments take the entries in
    /// turn.
    pub groups: Vec<Vec<usize>>,
    /// Number of simulated steps of 50 ms for which an action is held.
    pub repeat: u32,
    /// Width of the scenario's bottleneck \[m\]; the scenario's default if left out.
    #[serde(default)]
    pub gap_m: Option<f32>,
    /// Factor on the penalties for contacts and proximity. Large penalties in the first stage make an untrained policy
    /// learn to stand still.
    pub penalties: f32,
}

impl Config {
    /// Returns the predefined configuration named `name`; `None` if there is none of this name.
    pub fn preset(name: &str) -> Option<Config> {
        let (_, text) = PRESETS.iter().find(|(preset, _)| *preset == name)?;
        Some(Config::from_toml(text).expect("the committed presets are valid; a test reads them all"))
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

    /// Returns the settings of the scenario for a team of `robots` robots, with a bottleneck of the width `gap_m`
    /// \[m\]; `None` for the scenario's default.
    pub fn settings(&self, robots: Option<usize>, gap_m: Option<f32>) -> Settings {
        Settings { robots, gap_m, scale: self.scale, hull_m: self.hull_m }
    }

    /// Returns the index of the curriculum's stage at the completed fraction `progress` of the training, 0 to 1.
    pub fn stage(&self, progress: f64) -> usize {
        let last = self.curriculum.len() - 1;
        self.curriculum.iter().position(|stage| progress < stage.until).unwrap_or(last)
    }

    /// Returns the manifests of the policies trained with this configuration for the scenario named `scenario`, in the
    /// order of the roles, without the data of the training and the hash of the weights. `log_std_max` is the upper
    /// limit of the log standard deviations.
    ///
    /// # Panics
    /// If a policy cannot have its fields together, which `check` excludes.
    pub fn manifests(&self, scenario: &str, log_std_max: f32) -> Vec<AnyManifest> {
        let manifest = |(_, policy): (&str, Policy)| {
            let manifest = policy.manifest(scenario, Action::Velocity, Some(log_std_max));
            manifest.unwrap_or_else(|why| panic!("a checked configuration has a policy: {why}"))
        };
        self.policies().into_iter().map(manifest).collect()
    }

    /// Returns the chassis (kind of drive and limits) of the robots.
    ///
    /// # Panics
    /// If the settings `body` are wrong, which `check` excludes.
    pub fn chassis(&self) -> Chassis {
        self.body.chassis().expect("a checked configuration has a sound chassis")
    }

    /// Returns the configuration with those senses of a task file, if there is one, that an observation takes by
    /// their names. Under a name that the configuration has, it keeps its own.
    pub fn for_task(mut self, file: Option<&TaskFile>) -> Config {
        let observed = self.observed();
        let taken = entry::requests(&observed);
        let of_file = file.into_iter().flat_map(TaskFile::senses);
        for (name, settings) in of_file.filter(|(name, _)| taken.iter().any(|request| request.channel == **name)) {
            self.senses.entry(name.clone()).or_insert_with(|| senses::Settings::of_task(settings.clone()));
        }
        self
    }

    /// Returns the shapes of the policies' networks, in the order of the roles; of one network without roles.
    ///
    /// # Panics
    /// If a width is wrong, which `check` excludes.
    pub fn actors(&self) -> Vec<Shape> {
        let manifests = self.manifests("any", self.ppo.log_std_max[1]);
        let shapes = manifests.iter().map(Shape::of_manifest);
        shapes.map(|shape| shape.unwrap_or_else(|why| panic!("a checked configuration has a network: {why}"))).collect()
    }

    /// Returns the shape of the critic's network, which observes all robots of a team and privileged information about
    /// each, and the roles of the robots, if they have some: one hop in the architecture `full`.
    pub fn critic(&self) -> Shape {
        let policy = &self.policy;
        let [encoder, message, update] = match &self.critic {
            Some(critic) => [&critic.encoder, &critic.message, &critic.update],
            None => [&policy.encoder, &policy.message, &policy.update],
        };
        let last = |widths: &[usize]| widths.last().copied().unwrap_or(0);
        let (inputs, hidden) = (entry::floats(&self.observed()) + PRIVILEGED + self.roles.len(), last(encoder));
        let message_widths = [&[2 * hidden + CRITIC_EDGE], &message[..]].concat();
        let update_widths = [&[hidden + last(message)], &update[..], &[1]].concat();
        let encoder_widths = [&[inputs], &encoder[..]].concat();
        Shape::one_hop(Architecture::Full, [encoder_widths, message_widths, update_widths], CRITIC_EDGE)
    }
}

/// Number of edge features of the critic: a relative position.
const CRITIC_EDGE: usize = 2;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn penalties_have_their_factor_in_filtered_episodes_alone() {
        let reward = Reward { filtered: 0.5, ..Config::preset("robust").expect("it is a preset").reward };
        assert_eq!(reward.in_episode(false), reward);
        let filtered = reward.in_episode(true);
        assert_eq!((filtered.robot, filtered.wall), (reward.robot / 2.0, reward.wall / 2.0));
        assert_eq!((filtered.proximity, filtered.time), (reward.proximity / 2.0, reward.time));
    }
}
