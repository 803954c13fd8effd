//! Trainer: iterations of rollout and update, from random weights to a policy file. The caller passes in the progress
//! and gets metrics. The trainer's state can be saved as bytes and resumed with identical results.

use std::collections::BTreeSet;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::config::Config;
pub use super::errors::{Diverged, SetupError};
use super::experts::Expert;
use super::learner::{Initial, Learner};
use super::network::{Network, TeamNetwork};
use super::parallel::in_parallel;
use super::policy;
use super::record::EpisodeTotals;
use super::reward::has_reward;
use super::roles::message_name;
use super::rollout::{CHUNK, Chunk, RolloutSettings};
use super::settings::WeightedExperts;
use super::update::{Outcome, Workspace, update};
use murmurate::policy::file::AnyManifest;
use murmurate::policy::manifest::Training;
use murmurate::random::Seed;
use murmurate::registry::Registry;
use murmurate::scenario::Scenario;

/// Factor on the learning rate after an update that stopped early.
const RATE_DECREASE: f32 = 0.9;
/// Factor on the learning rate after an update whose KL divergence stayed below half of the limit.
const RATE_INCREASE: f32 = 1.05;

/// Metrics of one iteration of a training, a rollout and an update.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Metrics {
    /// Number of iterations (a rollout and an update) so far.
    pub iteration: u64,
    /// Number of decisions so far: one per environment and step of the policy.
    pub decisions: u64,
    /// Number of steps of 50 ms of all environments so far.
    pub env_steps: u64,
    /// Index of the curriculum's stage in the iteration, from zero.
    pub stage: usize,
    /// Mean return of a robot in the episodes that ended in the iteration; NaN if none ended in it.
    pub earned: f32,
    /// Fraction of the episodes that ended in the iteration in which all robots arrived and none had a contact that
    /// makes an episode fail; NaN if none ended.
    pub success: f32,
    /// Fraction of the episodes that ended in the iteration in which all robots arrived; NaN if none ended.
    pub arrived: f32,
    /// Mean duration of the episodes that ended in the iteration \[s\]; NaN if none ended.
    pub length_s: f32,
    /// Number of epochs in the update; fractional if the update stopped within an epoch.
    pub epochs: f32,
    /// KL divergence of the policy after the update from the policy before, the mean over the last epoch.
    pub divergence: f32,
    /// Mean entropy of the policy's action distribution in the update.
    pub entropy: f32,
    /// Mean loss of the critic in the update.
    pub value_loss: f32,
    /// Mean norm of the policy's gradient in the update, before clipping.
    pub gradient: f32,
    /// Learning rate of the update.
    pub learning_rate: f32,
    /// Mean squared difference of the policy's mean velocities from those of its expert in the update \[m²/s²\]; `None`
    /// without one.
    pub disagreement: Option<f32>,
}

/// Parameters of a training, which do not change from its start to its end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the scenario, or path of its task file.
    pub scenario: String,
    /// Text of the task file; `None` for a scenario that is not from a file. The training sets it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task: Option<String>,
    /// Name of the preset from which the configuration was made.
    pub preset: String,
    /// Configuration of the training.
    pub config: Config,
    /// Seed of all random numbers of the training.
    pub seed: u64,
}

/// Training of a policy and its critic, with its complete state between two iterations.
#[derive(Debug)]
pub struct Trainer {
    /// Parameters of the training, fixed at its start.
    pub(super) plan: Plan,
    registry: Registry,
    scenario: Arc<dyn Scenario>,
    /// Network of the policy, or of the policies of all roles, with its parameters and its optimiser's state.
    pub(super) actor: Learner<TeamNetwork>,
    /// Network of the critic, with its parameters and its optimiser's state.
    pub(super) critic: Learner,
    /// Environments of the current stage, in groups that one thread steps together.
    pub(super) chunks: Vec<Chunk>,
    /// Index of the curriculum's current stage, from zero.
    pub(super) stage: usize,
    /// Number of iterations so far.
    pub(super) iteration: u64,
    /// Number of decisions so far: one per environment and step of the policy.
    pub(super) decisions: u64,
    /// Number of simulated steps of 50 ms so far, summed over all environments.
    pub(super) env_steps: u64,
    /// Completed fraction of the training, 0 to 1, that was passed to the last iteration.
    pub(super) progress: f64,
    /// Factor on the scheduled learning rate, adapted to the KL divergence of updates; at most 1.
    pub(super) rate_factor: f32,
    /// Policy that is imitated, for each team size, indexed by it; empty without one.
    experts: Vec<Option<Expert>>,
    workspace: Workspace,
}

impl Trainer {
    /// Starts a training with random weights.
    ///
    /// # Errors
    /// If the registry does not have the scenario, the scenario has no reward of its own although the configuration
    /// weights it, or a stage of the curriculum cannot be set up.
    pub fn new(mut plan: Plan, registry: &Registry) -> Result<Trainer, SetupError> {
        let (registry, scenario) = plan.scenario(registry)?;
        let weight = plan.config.reward.scenario;
        if weight > 0.0 && !has_reward(&*scenario) {
            return Err(SetupError::NoReward { scenario: plan.scenario, weight });
        }
        if weight == 0.0 && scenario.cost().is_some() {
            return Err(SetupError::NoGoals { scenario: plan.scenario });
        }
        let seed = Seed::of_run(plan.seed);
        let (actor, critic) = (TeamNetwork::new(plan.config.actors()), Network::new(plan.config.critic()));
        let log_std = plan.config.ppo.log_std;
        let initial = |name: &str| seed.child(name).stream("train/initial");
        let names: Vec<String> = plan.config.roles.keys().map(|role| format!("actor/{role}")).collect();
        let of_role = |role: usize| initial(names.get(role).map_or("actor", String::as_str));
        let mut trainer = Trainer {
            actor: Learner::of_team(actor, Initial::Normal(&[0.0, 0.0, log_std, log_std]), of_role),
            critic: Learner::new(critic, Initial::Normal(&[0.0]), &mut initial("critic")),
            plan,
            registry,
            scenario,
            chunks: Vec::new(),
            stage: 0,
            iteration: 0,
            decisions: 0,
            env_steps: 0,
            progress: 0.0,
            rate_factor: 1.0,
            experts: Vec::new(),
            workspace: Workspace::default(),
        };
        // Sets up every stage now, so that an error of a late stage does not appear after hours of training.
        for stage in (0..trainer.plan.config.curriculum.len()).rev() {
            trainer.enter_stage(stage)?;
        }
        trainer.start_chunks();
        Ok(trainer)
    }

    /// Enters a stage of the curriculum, with environments whose episodes are not started and the experts of their
    /// teams. Fails if the team sizes of the stage (`groups`) do not add up to the scenario's team, or if the scenario
    /// refuses one of them.
    pub(super) fn enter_stage(&mut self, stage: usize) -> Result<(), SetupError> {
        self.stage = stage;
        let stage = &self.plan.config.curriculum[stage];
        let (found, robots) = (stage.groups[0].iter().sum(), self.scenario.robots());
        if found != robots {
            return Err(SetupError::Groups { found, robots });
        }
        let sizes: BTreeSet<usize> = stage.groups.concat().into_iter().collect();
        let settings = |robots| self.plan.config.settings(Some(robots), stage.gap_m);
        let build = |robots| self.registry.scenario(&self.plan.scenario, &settings(robots));
        let scenarios = sizes.into_iter().map(build).collect::<Result<Vec<_>, _>>()?;
        let experts = self.make_experts(&scenarios)?;
        let rows = self.plan.config.ppo.environments;
        let (settings, perceptions) = (self.settings(), self.plan.config.perceptions(&scenarios)?);
        let chunk = |first: usize| {
            Chunk::new(CHUNK.min(rows - first), &stage.groups, (&scenarios, perceptions.clone()), &settings)
        };
        let chunks = (0..rows).step_by(CHUNK).map(chunk).collect();
        (self.chunks, self.experts) = (chunks, experts);
        Ok(())
    }

    /// Makes the expert for each of these scenarios, which have teams of different sizes, indexed by the size; none if
    /// the configuration has none.
    fn make_experts(&self, scenarios: &[Arc<dyn Scenario>]) -> Result<Vec<Option<Expert>>, SetupError> {
        let Some(expert) = &self.plan.config.expert else { return Ok(Vec::new()) };
        let wrong = |why: String| SetupError::Expert { name: expert.policy.clone(), why };
        let mut experts: Vec<Option<Expert>> = Vec::new();
        for scenario in scenarios {
            experts.resize_with(experts.len().max(scenario.robots() + 1), || None);
            experts[scenario.robots()] = Some(Expert::new(&self.registry, &expert.policy, scenario).map_err(wrong)?);
        }
        Ok(experts)
    }

    fn start_chunks(&mut self) {
        let (mut chunks, settings) = (std::mem::take(&mut self.chunks), self.settings());
        for (index, chunk) in chunks.iter_mut().enumerate() {
            chunk.start(&settings, &mut self.stream(&format!("start/{}/{index}", self.stage)));
        }
        self.chunks = chunks;
    }

    fn stream(&self, name: &str) -> murmurate::random::Stream {
        Seed::of_run(self.plan.seed).stream(&format!("train/{name}"))
    }

    /// Returns the settings of a rollout at the current stage and progress.
    pub fn settings(&self) -> RolloutSettings<'_> {
        let config = &self.plan.config;
        RolloutSettings {
            config,
            actor: &self.actor.network,
            critic: &self.critic.network,
            reward: config.reward.with_penalties(config.curriculum[self.stage].penalties),
            repeat: config.curriculum[self.stage].repeat,
            log_std_max: interpolate(config.ppo.log_std_max, self.progress),
            expert: self.weighted_experts(),
        }
    }

    /// Returns the experts with their weight at the current progress; `None` without one, or once it has no weight.
    fn weighted_experts(&self) -> Option<WeightedExperts<'_>> {
        let weight = self.plan.config.expert.as_ref()?.weight(self.progress);
        (weight > 0.0).then_some(WeightedExperts { experts: &self.experts, weight })
    }

    /// Performs one iteration, a rollout and an update, on up to `threads` threads. `progress` is the completed
    /// fraction of the training, 0 to 1, on which stage, learning rate and limits depend.
    ///
    /// # Errors
    /// If a value is NaN or infinite. The training cannot continue then.
    pub fn iterate(&mut self, progress: f64, threads: usize) -> Result<Metrics, Diverged> {
        self.progress = progress.clamp(0.0, 1.0);
        let stage = self.plan.config.stage(self.progress);
        if stage != self.stage {
            self.enter_stage(stage).expect("every stage was made once at the start");
            self.start_chunks();
        }
        let mut chunks = std::mem::take(&mut self.chunks);
        let settings = self.settings();
        let decisions = settings.config.ppo.decisions;
        in_parallel(threads, chunks.iter_mut().enumerate(), |(index, chunk)| {
            let mut stream = self.stream(&format!("collect/{}/{index}", self.iteration));
            chunk.collect(&settings, &self.actor.parameters, &self.critic.parameters, decisions, &mut stream);
        });
        let new_decisions = (decisions * settings.config.ppo.environments) as u64;
        let env_steps = new_decisions * u64::from(settings.repeat);

        let ppo = &settings.config.ppo;
        let [from, to] = ppo.learning_rate;
        let scheduled = from * libm::powf(to / from, self.progress as f32);
        let learning_rate = (self.rate_factor * scheduled).max(to);
        let entropy = interpolate(ppo.entropy, self.progress);
        let mut stream = self.stream(&format!("update/{}", self.iteration));
        let records: Vec<_> = chunks.iter().map(|chunk| &chunk.record).collect();
        let (mut actor, mut critic) = (self.actor.clone(), self.critic.clone());
        let mut workspace = std::mem::take(&mut self.workspace);
        let outcome = update(
            &self.settings(),
            &records,
            &mut actor,
            &mut critic,
            (learning_rate, entropy),
            threads,
            &mut workspace,
            &mut stream,
        );
        self.workspace = workspace;
        let mut ended = EpisodeTotals::default();
        records.iter().for_each(|record| ended.add(&record.ended));
        self.chunks = chunks;
        let outcome = outcome.map_err(|error| Diverged {
            iteration: self.iteration + 1,
            decisions: self.decisions,
            what: error.what,
            learning_rate,
        })?;
        (self.actor, self.critic) = (actor, critic);
        // An update that stops early leaves decisions unused; with a lower learning rate, the next one uses more of
        // them.
        let (epochs, kl_stop) = (self.plan.config.ppo.epochs as f32, self.plan.config.ppo.kl_stop);
        if outcome.epochs < 0.99 * epochs {
            self.rate_factor *= RATE_DECREASE;
        } else if outcome.divergence < 0.5 * kl_stop {
            self.rate_factor = (self.rate_factor * RATE_INCREASE).min(1.0);
        }
        self.rate_factor = self.rate_factor.max(to / scheduled);
        self.iteration += 1;
        self.decisions += new_decisions;
        self.env_steps += env_steps;
        Ok(self.metrics(&ended, &outcome, learning_rate))
    }

    fn metrics(&self, ended: &EpisodeTotals, outcome: &Outcome, learning_rate: f32) -> Metrics {
        let mean = |sum: f32| sum / ended.episodes as f32;
        Metrics {
            iteration: self.iteration,
            decisions: self.decisions,
            env_steps: self.env_steps,
            stage: self.stage,
            earned: mean(ended.returns),
            success: mean(ended.clean as f32),
            arrived: mean(ended.arrived as f32),
            length_s: mean(ended.length_s),
            epochs: outcome.epochs,
            divergence: outcome.divergence,
            entropy: outcome.entropy,
            value_loss: outcome.value_loss,
            gradient: outcome.gradient,
            learning_rate,
            disagreement: outcome.disagreement,
        }
    }

    /// Returns the parameters of the training, fixed at its start.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Returns the scenario of the training, with the team of the configured size.
    pub fn scenario(&self) -> &Arc<dyn Scenario> {
        &self.scenario
    }

    /// Whether the scenario's own reward is a term of the training's reward.
    pub fn uses_scenario_reward(&self) -> bool {
        self.plan.config.reward.scenario > 0.0
    }

    /// Returns the weights and biases of the policy's network as one vector.
    pub fn parameters(&self) -> &[f32] {
        &self.actor.parameters
    }

    /// Returns the number of decisions so far: one per environment and step of the policy.
    pub fn decisions(&self) -> u64 {
        self.decisions
    }

    /// Returns the number of iterations (a rollout and an update) so far.
    pub fn iterations(&self) -> u64 {
        self.iteration
    }

    /// Returns the completed fraction of the training, 0 to 1, that was passed to the last iteration.
    pub fn progress(&self) -> f64 {
        self.progress
    }

    /// Returns the bytes of the policy file of each role with the current weights, in the order of the roles; of one
    /// file without roles. Files of roles that were trained together, with these weights, have one name of messages.
    pub fn policy_files(&self) -> Vec<Vec<u8>> {
        let config = &self.plan.config;
        let training = Training {
            program: format!("murmurate {}", env!("CARGO_PKG_VERSION")),
            preset: self.plan.preset.clone(),
            seed: self.plan.seed,
            decisions: self.decisions,
            env_steps: self.env_steps,
            configuration: serde_json::to_value(config).expect("a configuration is JSON"),
        };
        let manifests = config.manifests(self.scenario.name(), self.settings().log_std_max).into_iter();
        let tensors = self.actor.network.tensors(&self.actor.parameters);
        let message = (!config.roles.is_empty()).then(|| message_name(&self.actor.parameters));
        let file = |(manifest, tensors): (AnyManifest, _)| {
            policy::file(manifest.with_message_name(message.clone()), training.clone(), tensors)
        };
        manifests.zip(tensors).map(file).collect()
    }
}

fn interpolate([from, to]: [f32; 2], progress: f64) -> f32 {
    from + (to - from) * progress as f32
}
