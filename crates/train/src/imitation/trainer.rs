//! The loop of a training by imitation: iterations of rollouts and of gradient steps, from random weights to a policy
//! file. The state can be saved as bytes, and resumed with identical results.

use std::sync::Arc;

use rand::seq::SliceRandom;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use super::config::Config;
use super::episode::{self, Driver, Messages, Setting, Taught, TaughtEpisode};
use super::learn::{Lesson, Shard};
pub use super::setup::SetupError;
use super::setup::channels;
use super::units::Units;
use crate::adam::Adam;
use crate::channels::Channels;
use crate::checkpoint::vector_instructions;
use crate::experts::Expert;
use crate::learner::{Initial, Learner, SHARDS};
use crate::network::{Network, Shape};
use crate::parallel::in_parallel;
use crate::policy;
use crate::trainer::Diverged;
use murmurate::config::kinds::FileKind;
use murmurate::observation::PolicyFrame;
use murmurate::policy::file::AnyManifest;
use murmurate::policy::hops::entry;
use murmurate::policy::hops::manifest::Manifest;
use murmurate::policy::manifest::Training;
use murmurate::random::{Seed, Stream};
use murmurate::registry::Registry;
use murmurate::scenario::judge::{Judgement, Verdict};
use murmurate::scenario::{Scenario, Settings};
use murmurate_report::outcomes::CostOutcomes;
use murmurate_report::statistics::mean_95;

/// Version of the checkpoint format.
const FORMAT: u32 = 1;
/// Seed of the layouts of an evaluation.
const EVALUATION_SEED: u64 = 0x9a11_e7a1;

/// Parameters of a training that stay fixed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the scenario.
    pub scenario: String,
    /// Name of the preset from which the configuration was made.
    pub preset: String,
    /// Configuration of the training.
    pub config: Config,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Metrics of one iteration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Metrics {
    /// Number of iterations so far.
    pub iteration: u64,
    /// Number of decisions so far: one per team and step.
    pub decisions: u64,
    /// Mean squared difference of an action's component from the expert's, in the units of the network.
    pub loss: f32,
    /// Mean cost of the episodes that the policy drove; NaN if the expert drove all.
    pub cost: f64,
    /// Share of these episodes with a collision.
    pub collided: f64,
    /// Mean norm of the gradient before clipping.
    pub gradient: f32,
    /// Learning rate.
    pub learning_rate: f32,
}

/// Costs of a policy under one set of conditions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Name of who drove and under which conditions: `expert`, `lockstep` or `late`.
    pub conditions: &'static str,
    /// Mean cost of the episodes.
    pub cost_mean: f64,
    /// Its 95 % interval by Student's t distribution.
    pub cost_ci95: [f64; 2],
    /// Share of the episodes with a collision.
    pub collided: f64,
}

/// State of a training between two iterations.
#[derive(Debug)]
pub struct Trainer {
    plan: Plan,
    scenario: Arc<dyn Scenario>,
    expert: Expert,
    channels: Option<Channels>,
    units: Units,
    manifest: Manifest,
    learner: Learner,
    iteration: u64,
    decisions: u64,
}

#[derive(Serialize, Deserialize)]
struct State {
    format: u32,
    vector: String,
    plan: Plan,
    parameters: Vec<f32>,
    adam: Adam,
    iteration: u64,
    decisions: u64,
}

impl Trainer {
    /// Starts a training with random weights. The number of robots is resolved in the plan's configuration.
    ///
    /// # Errors
    /// If the scenario or the expert cannot be made, or training by imitation does not support the scenario.
    pub fn new(mut plan: Plan, registry: &Registry) -> Result<Trainer, SetupError> {
        let Config { robots, scale, hull_m, .. } = plan.config;
        let settings = Settings { robots, gap_m: None, scale, hull_m };
        let scenario = registry.scenario(&plan.scenario, &settings)?;
        plan.config.robots = Some(scenario.robots());
        let unsupported = |why: &'static str| SetupError::Unsupported { scenario: plan.scenario.clone(), why };
        if scenario.cost().is_none() {
            return Err(unsupported("its robots have goals; training by imitation is for scenarios with a cost"));
        }
        if scenario.tasks(0, 0).iter().any(|task| scenario.frame(task) != PolicyFrame::World) {
            return Err(unsupported("its policy frame is not the world frame"));
        }
        let name = plan.config.expert.clone();
        let wrong = |why: String| SetupError::Expert { name: name.clone(), why };
        let expert = Expert::new(registry, &name, &scenario).map_err(wrong)?;
        let manifest = plan.config.manifest(&plan.scenario);
        let shape = Shape::of_manifest(&AnyManifest::Format2(manifest.clone()));
        let shape = shape.expect("a checked configuration has a supported network");
        let of_policy =
            channels(&entry::requests(&manifest.observation), &scenario).map_err(SetupError::Observation)?;
        let units = Units::new(&manifest, &plan.config.imitation);
        let mut stream = Seed::of_run(plan.seed).stream("train/imitation/initial");
        let learner = Learner::new(Network::new(shape), Initial::Uniform, &mut stream);
        let (iteration, decisions) = (0, 0);
        Ok(Trainer { plan, scenario, expert, channels: of_policy, units, manifest, learner, iteration, decisions })
    }

    fn stream(&self, name: &str) -> Stream {
        Seed::of_run(self.plan.seed).stream(&format!("train/imitation/{name}"))
    }

    fn setting(&self) -> Setting<'_> {
        let Trainer { scenario, expert, units, manifest, learner, .. } = self;
        let Learner { network, parameters, .. } = learner;
        Setting {
            scenario: &**scenario,
            expert,
            channels: self.channels.as_ref(),
            units,
            repeat: self.plan.config.imitation.repeat,
            manifest,
            network,
            parameters,
        }
    }

    /// Performs one iteration. `progress` is the completed fraction of the training, 0 to 1, on which learning rate and
    /// the expert's share depend.
    ///
    /// # Errors
    /// If a value is NaN or infinite. The training cannot continue then.
    pub fn iterate(&mut self, progress: f64, threads: usize) -> Result<Metrics, Diverged> {
        let progress = progress.clamp(0.0, 1.0) as f32;
        let (episodes, drivers) = self.rollouts(progress, threads);
        let settings = self.plan.config.imitation.clone();
        let [from, to] = settings.learning_rate;
        let learning_rate = from * libm::powf(to / from, progress);
        let mut lessons: Vec<Lesson> = Vec::new();
        for (episode, recorded) in episodes.iter().enumerate() {
            lessons.extend((0..recorded.steps()).step_by(settings.window).map(|begin| Lesson { episode, begin }));
        }
        lessons.shuffle(&mut self.stream(&format!("order/{}", self.iteration)));
        let mut shards: Vec<Shard> = Vec::new();
        shards.resize_with(SHARDS, Shard::default);
        let (mut loss, mut gradient, mut batches) = (0.0, 0.0, 0.0);
        for batch in lessons.chunks(settings.batch) {
            let start = |at: usize| batch.len() * at / SHARDS;
            in_parallel(threads, shards.iter_mut().enumerate(), |(at, shard)| {
                shard.learn(&self.setting(), &settings, &episodes, &batch[start(at)..start(at + 1)]);
            });
            let learnt: usize = shards.iter().map(|shard| shard.learnt).sum();
            let components = (2 * learnt).max(1) as f32;
            loss += shards.iter().map(|shard| shard.loss).sum::<f32>() / components;
            let gradients = shards.iter_mut().map(|shard| &mut shard.gradient);
            gradient +=
                self.learner.step(gradients, components, settings.max_gradient, learning_rate).ok_or(Diverged {
                    iteration: self.iteration + 1,
                    decisions: self.decisions,
                    what: "the gradient",
                    learning_rate,
                })?;
            batches += 1.0;
        }
        self.iteration += 1;
        self.decisions += episodes.iter().map(|episode| episode.steps() as u64).sum::<u64>();
        let own = || episodes.iter().zip(&drivers).filter(|(_, driver)| **driver == Driver::Policy);
        let count = own().count() as f64;
        let collided = own().filter(|(episode, _)| episode.finding.verdict == Verdict::RobotCollision).count();
        Ok(Metrics {
            iteration: self.iteration,
            decisions: self.decisions,
            loss: loss / batches,
            cost: own().filter_map(|(episode, _)| episode.finding.cost).sum::<f64>() / count,
            collided: collided as f64 / count,
            gradient: gradient / batches,
            learning_rate,
        })
    }

    /// Runs the episodes of an iteration; returns them with who drove each.
    fn rollouts(&self, progress: f32, threads: usize) -> (Vec<TaughtEpisode>, Vec<Driver>) {
        let (settings, conditions) = (&self.plan.config.imitation, &self.plan.config.conditions);
        let left = (1.0 - progress / settings.expert_until.max(1e-6)).max(0.0);
        let expert_share = settings.expert_share * left;
        let mut recorded: Vec<Option<(TaughtEpisode, Driver)>> = vec![None; settings.episodes];
        in_parallel(threads, recorded.iter_mut().enumerate(), |(index, recorded)| {
            let mut stream = self.stream(&format!("rollout/{}/{index}", self.iteration));
            let layout = (stream.next_u64(), 0);
            let [low, high] = conditions.loss;
            let loss = low + (high - low) * stream.random_range(0.0..1.0);
            let together = stream.random_range(0.0..1.0) < conditions.lockstep;
            let messages = if together { Messages::Lockstep } else { Messages::Late(loss) };
            let drives = stream.random_range(0.0..1.0) < expert_share;
            let driver = if drives { Driver::Expert } else { Driver::Policy };
            let episode = episode::run(self.setting(), layout, (driver, messages), Taught::Yes, &mut stream);
            *recorded = Some((episode, driver));
        });
        recorded.into_iter().flatten().unzip()
    }

    /// Evaluates the policy on `episodes` layouts from a seed of their own, in lock step and with late messages of
    /// which the mean of the configured loss gets lost, and the expert on the same layouts.
    pub fn evaluate(&self, episodes: u32, threads: usize) -> Vec<Score> {
        let [low, high] = self.plan.config.conditions.loss;
        let late = Messages::Late((low + high) / 2.0);
        let all = [
            ("expert", Driver::Expert, Messages::Lockstep),
            ("lockstep", Driver::Policy, Messages::Lockstep),
            ("late", Driver::Policy, late),
        ];
        all.into_iter()
            .map(|(conditions, driver, messages)| {
                let mut found: Vec<Option<Judgement>> = vec![None; episodes as usize];
                in_parallel(threads, found.iter_mut().enumerate(), |(index, found)| {
                    let mut stream = Seed::of_run(EVALUATION_SEED).stream(&format!("train/imitation/evaluate/{index}"));
                    let taught = if driver == Driver::Expert { Taught::Yes } else { Taught::No };
                    let layout = (EVALUATION_SEED, index as u32);
                    let episode = episode::run(self.setting(), layout, (driver, messages), taught, &mut stream);
                    *found = Some(episode.finding);
                });
                let findings = || found.iter().flatten();
                let costs: Vec<f64> = findings().filter_map(|finding| finding.cost).collect();
                let collided = findings().filter(|finding| finding.verdict == Verdict::RobotCollision).count();
                let (cost_mean, cost_ci95) = mean_95(&costs).unwrap_or((f64::NAN, [f64::NAN; 2]));
                Score { conditions, cost_mean, cost_ci95, collided: collided as f64 / f64::from(episodes.max(1)) }
            })
            .collect()
    }

    /// Parameters of the training, fixed at its start.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The scenario of the team.
    pub fn scenario(&self) -> &dyn Scenario {
        &*self.scenario
    }

    /// Number of decisions so far.
    pub fn decisions(&self) -> u64 {
        self.decisions
    }

    /// Number of iterations so far.
    pub fn iterations(&self) -> u64 {
        self.iteration
    }

    /// Returns the bytes of a policy file with the current weights.
    pub fn policy_file(&self) -> Vec<u8> {
        let training = Training {
            program: format!("murmurate {}", env!("CARGO_PKG_VERSION")),
            preset: self.plan.preset.clone(),
            seed: self.plan.seed,
            decisions: self.decisions,
            env_steps: self.decisions,
            configuration: serde_json::to_value(&self.plan.config).expect("a configuration is JSON"),
        };
        let manifest = AnyManifest::Format2(self.manifest.clone());
        let network = &self.learner.network;
        let tensors = self.units.in_metres(network.shape(), network.tensors(&self.learner.parameters));
        policy::file(manifest, training, tensors)
    }

    /// Returns the complete state as bytes, from which [`Trainer::resume`] continues with identical results.
    pub fn checkpoint(&self) -> Vec<u8> {
        let state = State {
            format: FORMAT,
            vector: vector_instructions(),
            plan: self.plan.clone(),
            parameters: self.learner.parameters.clone(),
            adam: self.learner.adam.clone(),
            iteration: self.iteration,
            decisions: self.decisions,
        };
        rmp_serde::to_vec_named(&state).expect("a state is plain data")
    }

    /// Restores a trainer from a checkpoint. The registry must have the checkpoint's scenario and expert.
    ///
    /// # Errors
    /// If the bytes are not a checkpoint of this version, or are of a processor with other vector instructions.
    pub fn resume(bytes: &[u8], registry: &Registry) -> Result<Trainer, SetupError> {
        if let Some(other) = FileKind::no_checkpoint(bytes) {
            return Err(SetupError::Foreign(other));
        }
        let state: State = rmp_serde::from_slice(bytes).map_err(|error| SetupError::Format(error.to_string()))?;
        let ours = vector_instructions();
        if state.vector != ours {
            return Err(SetupError::Processor { theirs: state.vector, ours });
        }
        if state.format != FORMAT {
            return Err(SetupError::Format(format!("its format is {}; this program reads {FORMAT}", state.format)));
        }
        state.plan.config.check().map_err(|error| SetupError::Format(error.to_string()))?;
        // Before anything is made of the configuration, which could ask for any amount of memory.
        let manifest = state.plan.config.manifest(&state.plan.scenario);
        let shape = Shape::of_manifest(&AnyManifest::Format2(manifest));
        let length = Network::new(shape.map_err(SetupError::Format)?).parameters();
        if state.parameters.len() != length || !state.adam.fits(length) {
            return Err(SetupError::Format("its weights do not match its configuration".to_owned()));
        }
        let mut trainer = Trainer::new(state.plan, registry)?;
        (trainer.learner.parameters, trainer.learner.adam) = (state.parameters, state.adam);
        (trainer.iteration, trainer.decisions) = (state.iteration, state.decisions);
        Ok(trainer)
    }
}

/// Returns the costs of a score as text, such as `0.0123 (95 %: 0.0120 to 0.0126)`.
impl std::fmt::Display for Score {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Score { cost_mean, cost_ci95, .. } = *self;
        let cost = CostOutcomes { completed: 0, cost_mean, cost_ci95, cost_median: cost_mean };
        write!(f, "{}", cost.in_words())
    }
}
