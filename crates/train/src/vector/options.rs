//! Settings of a vectorised environment, and the values that they may have.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::buffers::Lengths;
use crate::config::{Conditions, Reward};
use crate::message_buffer::HISTORY_STEPS;
use crate::reward::has_reward;
use murmurate::chassis::{self, Chassis};
use murmurate::config::{ConfigError, in_range};
use murmurate::policy::manifest::Field;
use murmurate::scenario::Scenario;
use murmurate::senses::{self, Scanner};
use murmurate::world::kinematic::PERIOD;

/// Treatment of an environment whose episode has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Autoreset {
    /// The next episode starts in the same step in which one ends.
    SameStep,
    /// No episode starts until the caller resets the environment.
    Disabled,
}

/// Content of the messages that the robots of a vectorised environment receive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Content {
    /// Robots receive no messages.
    Nothing,
    /// The observation that the sender had when it sent, from which a training computes the sender's latent itself.
    Observations,
    /// This number of floats, which the sender's policy has put out with its action.
    Actions(usize),
}

/// Settings of a vectorised environment.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scenario of every environment, with the number of robots R of a team.
    pub scenario: Arc<dyn Scenario>,
    /// Width of the bottleneck with which the scenario was made \[m\]; `None` for its own.
    pub gap_m: Option<f32>,
    /// Scale with which the scenario was made; `None` for its own.
    pub scale: Option<f32>,
    /// Radius of a robot's hull with which the scenario was made \[m\]; `None` for that of the paper's robots.
    pub hull_m: Option<f32>,
    /// Number of environments N, each with one team.
    pub environments: usize,
    /// Number of threads that step the environments; the data do not depend on it.
    pub threads: usize,
    /// Distributions from which each episode's conditions are drawn.
    pub conditions: Conditions,
    /// Weights of the terms of a robot's reward.
    pub reward: Reward,
    /// Settings of the chassis (kind of drive and limits) of all robots.
    pub body: chassis::Settings,
    /// Entries of a robot's observation, two floats each, in the order in which they are written.
    pub observation: Vec<Field>,
    /// Largest distance between two robots that receive each other's messages \[m\].
    pub radius_m: f32,
    /// Largest commanded velocity along each axis \[m/s\].
    pub limit_m_s: f32,
    /// Longest duration of an episode \[s\]; an episode that reaches it is truncated.
    pub episode_s: f32,
    /// Number of steps of 50 ms for which an action is held; their rewards are added.
    pub repeat: u32,
    /// Age, counted from its arrival, up to which a deployed robot uses a message \[s\], for policies that are written
    /// to a file. Episodes draw theirs from `conditions`.
    pub hold_s: f64,
    /// Content of the messages that robots receive.
    pub content: Content,
    /// Treatment of an environment whose episode has ended.
    pub autoreset: Autoreset,
    /// Lidar of each robot; `None` for robots without one.
    pub lidar: Option<Lidar>,
    /// Seed from which the random streams of all environments are made.
    pub seed: u64,
}

/// Lidar of each robot of a vectorised environment, which scans after each step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lidar {
    /// Name of the sense, by which a policy takes it.
    pub name: String,
    /// Settings of the sense; its kind is `lidar`.
    pub settings: senses::Settings,
}

impl Lidar {
    /// Makes the scanner of a robot. The error names the wrong setting, by the argument of the Python package.
    pub fn scanner(&self) -> Result<Scanner, ConfigError> {
        Scanner::of(&self.name, &self.settings).map_err(|error| error.within("senses"))
    }
}

/// Largest number of environments: indices of robots and of their messages stay far below 2^32.
const ENVIRONMENTS: usize = 1 << 20;

impl Options {
    /// Checks the settings. The error names the wrong one, as the Python package does.
    ///
    /// # Errors
    /// If a value is not within its bounds, or the robots of the scenario have no goals and the configuration has no
    /// reward for them.
    pub fn check(&self) -> Result<(), ConfigError> {
        in_range("num_envs", self.environments, (1, ENVIRONMENTS))?;
        in_range("threads", self.threads, (1, 1024))?;
        in_range("repeat", self.repeat, (1, 100))?;
        in_range("episode_s", self.episode_s, (0.05, 3600.0))?;
        in_range("radius_m", self.radius_m, (1e-3, 1e6))?;
        in_range("limit_m_s", self.limit_m_s, (1e-3, 1e3))?;
        in_range("hold_s", self.hold_s, (1e-3, 60.0))?;
        in_range("observation_fields", self.observation.len(), (1, 16))?;
        if let Content::Actions(floats) = self.content {
            in_range("message_size", floats, (1, 1024))?;
        }
        self.body.chassis().map_err(|error| error.within("body"))?;
        self.reward.check()?;
        self.conditions.check()?;
        self.lidar.as_ref().map(Lidar::scanner).transpose()?;
        let (name, weight) = (self.scenario.name(), self.reward.scenario);
        if weight > 0.0 && !has_reward(&*self.scenario) {
            let why =
                format!("reward.scenario is {weight}, but the scenario '{name}' has no reward of its own; set it to 0");
            return Err(ConfigError::field("config", why));
        }
        if weight == 0.0 && self.scenario.cost().is_some() {
            let why =
                format!("reward.scenario is 0, but robots of '{name}' have no goals to be rewarded for; raise it");
            return Err(ConfigError::field("config", why));
        }
        Ok(())
    }

    /// Returns the chassis of the robots.
    ///
    /// # Panics
    /// If the settings `body` are wrong, which `check` excludes.
    pub fn chassis(&self) -> Chassis {
        self.body.chassis().expect("checked settings have a sound chassis")
    }

    /// Returns the numbers of robots and floats that give the lengths of one environment's part of each buffer.
    pub fn lengths(&self) -> Lengths {
        let observation = 2 * self.observation.len();
        let message = match self.content {
            Content::Nothing => 0,
            Content::Observations => observation,
            Content::Actions(floats) => floats,
        };
        let rays = self.lidar.as_ref().map_or(0, |lidar| lidar.scanner().map_or(0, |scanner| scanner.rays()));
        Lengths { robots: self.scenario.robots(), observation, message, rays }
    }

    /// Returns the number of floats that an environment keeps of what its policies have put out for messages.
    pub(super) fn outputs(&self) -> usize {
        match self.content {
            Content::Actions(floats) => HISTORY_STEPS * self.scenario.robots() * floats,
            Content::Nothing | Content::Observations => 0,
        }
    }

    /// Returns the largest number of decisions in an episode, each held for `repeat` steps.
    pub fn decisions(&self) -> u32 {
        let over = |step: &u32| *step as f32 * PERIOD.as_secs() as f32 >= self.episode_s;
        let steps = (1..).find(over).expect("an episode has an end");
        steps.div_ceil(self.repeat)
    }
}
