//! A whole training: from random weights, iteration by iteration, to a policy file. It is handed its progress and
//! hands back what it found; its state goes to bytes and back, and goes on from there bit for bit.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::config::Config;
use super::network::Network;
use super::parallel::in_parallel;
use super::record::Ended;
use super::rollout::{CHUNK, Chunk, Rules};
use super::update::{Learner, Outcome, Room, initial, update};
use crate::policy::manifest::Training;
use crate::policy::weights;
use crate::random::Seed;
use crate::registry::Registry;
use crate::scenario::{Scenario, ScenarioError, Settings};

/// What an update that was cut short makes of the learning rate, and one that could have gone farther.
const SLOWER: f32 = 0.9;
const FASTER: f32 = 1.05;

/// What came of one iteration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Iterations so far.
    pub iteration: u64,
    /// Decisions so far: one for each environment and step of the policy.
    pub decisions: u64,
    /// Steps of 50 ms of all environments so far.
    pub env_steps: u64,
    /// Stage of the curriculum, counted from zero.
    pub stage: usize,
    /// What a robot earned in the episodes that ended, mean; NaN if none did.
    pub earned: f32,
    /// Share of them in which all arrived and touched nothing.
    pub success: f32,
    /// Share of them in which all arrived.
    pub arrived: f32,
    /// How long they lasted, mean \[s\].
    pub length_s: f32,
    /// Of the update.
    pub epochs: f32,
    /// Of the update.
    pub divergence: f32,
    /// Of the update.
    pub entropy: f32,
    /// Of the update.
    pub value_loss: f32,
    /// Of the update.
    pub gradient: f32,
    /// In the update.
    pub learning_rate: f32,
}

/// Why a training cannot go on.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "iteration {iteration} ({decisions} decisions): {what} came out as no number; the likely cause is a learning \
     rate ({learning_rate:e}) or a reward scale that is too high"
)]
pub struct Diverged {
    /// The iteration that failed.
    pub iteration: u64,
    /// Decisions before it.
    pub decisions: u64,
    /// Where it was seen first.
    pub what: &'static str,
    /// Of the failed update.
    pub learning_rate: f32,
}

/// Why a training cannot be set up or resumed.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// The scenario cannot be made.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The bytes are no checkpoint.
    #[error("not a whole checkpoint of this version of the program: {0}")]
    Format(String),
    /// The checkpoint is of another training.
    #[error("it is of another training: {what} is {theirs} there and {ours} here")]
    Other {
        /// What differs.
        what: &'static str,
        /// In the checkpoint.
        theirs: String,
        /// As asked for.
        ours: String,
    },
    /// A stage's teams do not make up the scenario's.
    #[error("curriculum: its groups make up teams of {found}; the scenario has {robots} robots")]
    Groups {
        /// Robots of the groups.
        found: usize,
        /// Robots of the scenario.
        robots: usize,
    },
}

/// What stays the same during a training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the scenario.
    pub scenario: String,
    /// Name of the preset that the configuration began as.
    pub preset: String,
    /// The configuration.
    pub config: Config,
    /// The root of all randomness.
    pub seed: u64,
}

/// A training.
#[derive(Debug)]
pub struct Trainer {
    pub(super) plan: Plan,
    registry: Registry,
    scenario: Arc<dyn Scenario>,
    pub(super) actor: Learner,
    pub(super) critic: Learner,
    pub(super) chunks: Vec<Chunk>,
    pub(super) stage: usize,
    pub(super) iteration: u64,
    pub(super) decisions: u64,
    pub(super) env_steps: u64,
    pub(super) progress: f64,
    /// Share of the scheduled learning rate that the divergence leaves.
    pub(super) pace: f32,
    room: Room,
}

impl Trainer {
    /// A training from its beginning, of a scenario that the registry has.
    pub fn new(plan: Plan, registry: &Registry) -> Result<Trainer, SetupError> {
        let settings = Settings { robots: plan.config.robots, gap_m: None };
        let scenario = registry.scenario(&plan.scenario, &settings)?;
        let seed = Seed::of_run(plan.seed);
        let (actor, critic) = (Network::new(plan.config.actor()), Network::new(plan.config.critic()));
        let log_std = plan.config.ppo.log_std;
        let learner = |network: Network, name: &str, bias: &[f32]| {
            let parameters = initial(&network, seed.child(name), bias);
            Learner { adam: Adam::new(parameters.len()), parameters, network }
        };
        let mut trainer = Trainer {
            actor: learner(actor, "actor", &[0.0, 0.0, log_std, log_std]),
            critic: learner(critic, "critic", &[0.0]),
            plan,
            registry: registry.clone(),
            scenario,
            chunks: Vec::new(),
            stage: 0,
            iteration: 0,
            decisions: 0,
            env_steps: 0,
            progress: 0.0,
            pace: 1.0,
            room: Room::default(),
        };
        // Every stage must be possible, before hours are spent on the first.
        for stage in (0..trainer.plan.config.curriculum.len()).rev() {
            trainer.stage = stage;
            trainer.chunks = trainer.make_chunks()?;
        }
        trainer.start_chunks();
        Ok(trainer)
    }

    pub(super) fn make_chunks(&self) -> Result<Vec<Chunk>, SetupError> {
        let stage = &self.plan.config.curriculum[self.stage];
        let (found, robots) = (stage.groups[0].iter().sum(), self.scenario.robots());
        if found != robots {
            return Err(SetupError::Groups { found, robots });
        }
        let mut sizes = stage.groups.concat();
        sizes.sort_unstable();
        sizes.dedup();
        let settings = |robots| Settings { robots: Some(robots), gap_m: stage.gap_m };
        let build = |robots| self.registry.scenario(&self.plan.scenario, &settings(robots));
        let scenarios = sizes.into_iter().map(build).collect::<Result<Vec<_>, _>>()?;
        let rows = self.plan.config.ppo.environments;
        let rules = self.rules();
        let chunk = |first: usize| Chunk::new(CHUNK.min(rows - first), &stage.groups, &scenarios, &rules);
        Ok((0..rows).step_by(CHUNK).map(chunk).collect())
    }

    fn start_chunks(&mut self) {
        let (mut chunks, rules) = (std::mem::take(&mut self.chunks), self.rules());
        for (index, chunk) in chunks.iter_mut().enumerate() {
            chunk.start(&rules, &mut self.stream(&format!("start/{}/{index}", self.stage)));
        }
        self.chunks = chunks;
    }

    fn stream(&self, name: &str) -> crate::random::Stream {
        Seed::of_run(self.plan.seed).stream(&format!("train/{name}"))
    }

    /// The rules of this moment.
    pub fn rules(&self) -> Rules<'_> {
        let config = &self.plan.config;
        Rules {
            config,
            actor: &self.actor.network,
            critic: &self.critic.network,
            reward: config.reward.with_penalties(config.curriculum[self.stage].penalties),
            repeat: config.curriculum[self.stage].repeat,
            log_std_max: between(config.ppo.log_std_max, self.progress),
        }
    }

    /// Collects decisions and learns from them. `progress` is the share of the whole training that has been done, 0
    /// to 1; schedules follow it.
    ///
    /// # Errors
    /// If anything came out as no number: the training is of no use from here on.
    pub fn iterate(&mut self, progress: f64, threads: usize) -> Result<Point, Diverged> {
        self.progress = progress.clamp(0.0, 1.0);
        let stage = self.plan.config.stage(self.progress);
        if stage != self.stage {
            self.stage = stage;
            self.chunks = self.make_chunks().expect("every stage was made once at the beginning");
            self.start_chunks();
        }
        let mut chunks = std::mem::take(&mut self.chunks);
        let rules = self.rules();
        let decisions = rules.config.ppo.decisions;
        in_parallel(threads, chunks.iter_mut().enumerate(), |(index, chunk)| {
            let mut stream = self.stream(&format!("collect/{}/{index}", self.iteration));
            chunk.collect(&rules, &self.actor.parameters, &self.critic.parameters, decisions, &mut stream);
        });
        let done = (decisions * rules.config.ppo.environments) as u64;
        let env_steps = done * u64::from(rules.repeat);

        let ppo = &rules.config.ppo;
        let [from, to] = ppo.learning_rate;
        let scheduled = from * libm::powf(to / from, self.progress as f32);
        let learning_rate = (self.pace * scheduled).max(to);
        let entropy = between(ppo.entropy, self.progress);
        let mut stream = self.stream(&format!("update/{}", self.iteration));
        let records: Vec<_> = chunks.iter().map(|chunk| &chunk.record).collect();
        let (mut actor, mut critic) = (self.actor.clone(), self.critic.clone());
        let mut room = std::mem::take(&mut self.room);
        let found = update(
            &self.rules(),
            &records,
            &mut actor,
            &mut critic,
            (learning_rate, entropy),
            threads,
            &mut room,
            &mut stream,
        );
        self.room = room;
        let mut ended = Ended::default();
        records.iter().for_each(|record| ended.add(&record.ended));
        self.chunks = chunks;
        let outcome = found.map_err(|found| Diverged {
            iteration: self.iteration + 1,
            decisions: self.decisions,
            what: found.what,
            learning_rate,
        })?;
        (self.actor, self.critic) = (actor, critic);
        // Updates that are cut short learn from few decisions: slower steps make more of them.
        let (epochs, kl_stop) = (self.plan.config.ppo.epochs as f32, self.plan.config.ppo.kl_stop);
        if outcome.epochs < 0.99 * epochs {
            self.pace *= SLOWER;
        } else if outcome.divergence < 0.5 * kl_stop {
            self.pace = (self.pace * FASTER).min(1.0);
        }
        self.pace = self.pace.max(to / scheduled);
        self.iteration += 1;
        self.decisions += done;
        self.env_steps += env_steps;
        Ok(self.point(&ended, &outcome, learning_rate))
    }

    fn point(&self, ended: &Ended, outcome: &Outcome, learning_rate: f32) -> Point {
        let mean = |sum: f32| sum / ended.episodes as f32;
        Point {
            iteration: self.iteration,
            decisions: self.decisions,
            env_steps: self.env_steps,
            stage: self.stage,
            earned: mean(ended.earned),
            success: mean(ended.clean as f32),
            arrived: mean(ended.arrived as f32),
            length_s: mean(ended.length_s),
            epochs: outcome.epochs,
            divergence: outcome.divergence,
            entropy: outcome.entropy,
            value_loss: outcome.value_loss,
            gradient: outcome.gradient,
            learning_rate,
        }
    }

    /// What stays the same.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The scenario of the whole team.
    pub fn scenario(&self) -> &Arc<dyn Scenario> {
        &self.scenario
    }

    /// The policy's parameters.
    pub fn parameters(&self) -> &[f32] {
        &self.actor.parameters
    }

    /// Decisions so far.
    pub fn decisions(&self) -> u64 {
        self.decisions
    }

    /// Iterations so far.
    pub fn iterations(&self) -> u64 {
        self.iteration
    }

    /// The progress that it was last handed.
    pub fn progress(&self) -> f64 {
        self.progress
    }

    /// The policy as it is now, as a file.
    pub fn policy_file(&self) -> Vec<u8> {
        let config = &self.plan.config;
        let mut manifest = config.manifest(&self.plan.scenario);
        manifest.log_std_max = Some(self.rules().log_std_max);
        manifest.training = Some(Training {
            program: format!("murmurate {}", env!("CARGO_PKG_VERSION")),
            preset: self.plan.preset.clone(),
            seed: self.plan.seed,
            decisions: self.decisions,
            env_steps: self.env_steps,
            configuration: serde_json::to_value(config).expect("a configuration is JSON"),
        });
        let parameters = &self.actor.parameters;
        let tensors = self.actor.network.layers().map(|layers| {
            let layer = |(_, weight, bias, end): (usize, usize, usize, usize)| {
                (parameters[weight..bias].to_vec(), parameters[bias..end].to_vec())
            };
            layers.into_iter().map(layer).collect::<Vec<_>>()
        });
        weights::write(&manifest, &tensors)
    }
}

fn between([from, to]: [f32; 2], progress: f64) -> f32 {
    from + (to - from) * progress as f32
}
