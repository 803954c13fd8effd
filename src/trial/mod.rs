//! Trial: all settings of one run of a deployment, from its first episode to its last. `simulate` runs it in one
//! process under virtual time, and `live` runs one host of it in real time.
//!
//! ```
//! use murmurate::policy::Model;
//! use murmurate::trial::Trial;
//!
//! let trial = Trial::preset("offboard", "passage")?.model(Model::shipped("passage")?);
//! let report = trial.episodes(4).seed(7).run();
//! assert_eq!(report.successes(), 4);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Equal trials give equal reports, bit for bit. Faults come from a [`FaultPlan`]; `examples/faults.rs` is an example
//! to copy. Trials are independent of each other: run them on as many threads as there are cores.

mod budget;
mod error;
mod obstacles;
mod senses;

use std::sync::Arc;

use crate::config::ConfigError;
use crate::deploy::Deployment;
use crate::deploy::team::{SimulationSettings, Team};
use crate::estimation;
use crate::faults::FaultPlan;
use crate::hearing::CommRange;
use crate::hearing::Handling;
use crate::messages::ids::RobotId;
use crate::messages::wire::{Marks, Stop};
use crate::observation::{Bound, ChannelError, Dynamics};
use crate::policy::{self, Model, Models};
use crate::random::Seed;
use crate::registry::Registry;
use crate::results::totals::Steps;
use crate::safety::{Clamp, Safety, Switch};
use crate::scenario::layout::Layouts;
use crate::scenario::{Arena, Scenario, Settings, TaskFile};
use crate::time::{Span, Time};
use crate::world::{self, Physics, Placement, kinematic};

pub use budget::Budget;
pub use error::TrialError;

/// Rough duration of an episode with its reset \[s\], for planning faults.
const EPISODE_S: f64 = 10.0;

/// Shortest possible duration of an episode with its reset.
const LEAST_EPISODE: Span = Span::from_millis(1000);

/// Trial: all settings of a run, from which its actors are made and connected.
#[derive(Clone)]
pub struct Trial {
    /// Hosts with the actors that they run, and the links between hosts.
    pub deployment: Deployment,
    /// Registry in which the deployment's plant is looked up.
    pub registry: Registry,
    /// Task of the team, such as driving through a passage.
    pub scenario: Arc<dyn Scenario>,
    /// Properties of the simulated robots, such as their largest acceleration and their sensor.
    pub physics: Physics,
    /// Policies that drive the robots during an episode: one for all, or one for each role.
    pub models: Models,
    /// Starts and goals of the robots in each episode; their number is the number of episodes.
    pub layouts: Layouts,
    /// Seed of the run. The layouts (starts and goals) of the episodes are drawn from it alone.
    pub seed: u64,
    /// Index of this repeat of the run. All randomness but the layouts of episodes is drawn from `seed` and `repeat`.
    pub repeat: u32,
    /// Range within which robots receive neighbours' messages; `None` for the range that the policy states.
    pub range: Option<CommRange>,
    /// How long a robot uses a neighbour's message: for the policy's whole hold time, or for one control step.
    pub handling: Handling,
    /// Time that a step of the policies takes under virtual time, from the percepts to the action; zero by default. In
    /// real time it takes what it takes.
    pub step_takes: Span,
    /// Estimator that filters readings into a robot's state.
    pub estimator: estimation::Entry,
    /// Known delay from a measurement to the arrival of its reading, for which the estimator can compensate; `None` for
    /// the latency of the simulated sensor.
    pub sensor_delay: Option<Span>,
    /// Limit on the policy's velocities: that of training, where the simulator limits acceleration, or that of the
    /// paper's robots. The method `clamp` sets it together with the matching `physics`.
    pub clamp: Clamp,
    /// Conditions in which robots are stopped or slowed, whatever the policy's output.
    pub safety: Safety,
    /// Emergency stops and re-arms during the trial, each with the time at which its sender, a host of the deployment,
    /// sends it.
    pub stops: Vec<(Time, Stop)>,
    /// Faults to inject during the trial, such as crashes of actors or failures of links.
    pub faults: FaultPlan,
    /// Time at which the trial ends, even during an episode; `None` to end with the last episode.
    pub until: Option<Time>,
    /// Whether emulated links carry latents to all hosts, also to those that are too far away to use them, so that
    /// counts of what arrives are those of real links. False by default: results and traces are the same.
    pub everywhere: bool,
    /// Whether the report contains the robots' true states after each step of the simulator, and the messages in use.
    pub steps: Steps,
}

/// Returns the properties of a plant's robots. `Trial::check` refuses a plant that is not in the registry.
fn physics(registry: &Registry, plant: &str, scenario: &dyn Scenario) -> Physics {
    let entry = registry.plant(plant);
    entry.map_or(Physics::published as fn(&Arena) -> Physics, |entry| entry.physics)(scenario.arena())
}

impl Trial {
    /// Makes a trial of one episode with the scripted policy, the scenario's default team size and seed 0. `mode` names
    /// a preset deployment, such as `offboard`; `scenario` names a task of this crate. An error says which name is
    /// unknown.
    pub fn preset(mode: &str, scenario: &str) -> Result<Trial, TrialError> {
        Trial::of_team(mode, scenario, None)
    }

    /// Makes a trial of one episode for a team of `robots`, with the scripted policy and seed 0. `mode` names a preset
    /// deployment, `scenario` a task of this crate. `None` as the size takes the scenario's default. An error names
    /// what is unknown, or says that the size does not fit.
    pub fn of_team(mode: &str, scenario: &str, robots: impl Into<Option<usize>>) -> Result<Trial, TrialError> {
        Trial::from_registry(&Registry::builtin(), mode, scenario, robots)
    }

    /// Makes a trial of one episode, with scenario and plant looked up in `registry`. `mode` names a preset
    /// deployment; `robots` is the team size, or `None` for the scenario's default. The policy is the scripted one, the
    /// seed 0. An error names what is unknown, or says that the size does not fit.
    pub fn from_registry(
        registry: &Registry,
        mode: &str,
        scenario: &str,
        robots: impl Into<Option<usize>>,
    ) -> Result<Trial, TrialError> {
        let scenario = registry.scenario(scenario, &Settings { robots: robots.into(), ..Settings::default() })?;
        let deployment = Deployment::preset(mode, scenario.robots());
        let deployment = deployment.ok_or_else(|| TrialError::Mode { name: mode.to_owned() })?;
        let scripted = registry.policy(policy::scripted(&*scenario)).map(|entry| (entry.build)(&*scenario));
        let model = scripted.and_then(Result::ok).unwrap_or(Model::Orca);
        Ok(Trial::with_registry(registry, deployment, scenario, model))
    }

    /// Makes a trial of one episode with seed 0, with a plant of this crate. The deployment must have
    /// passed `Deployment::check` and be made for the scenario's team size; another size panics.
    pub fn new(deployment: Deployment, scenario: Arc<dyn Scenario>, model: Model) -> Trial {
        Trial::with_registry(&Registry::builtin(), deployment, scenario, model)
    }

    /// Makes a trial of one episode with seed 0, with the plant looked up in `registry`. The deployment
    /// must have passed `Deployment::check` and be made for the scenario's team size; another size panics. Senses of
    /// the scenario's task file are added to those of the deployment.
    pub fn with_registry(
        registry: &Registry,
        deployment: Deployment,
        scenario: Arc<dyn Scenario>,
        model: impl Into<Models>,
    ) -> Trial {
        assert_eq!(deployment.robots, scenario.robots(), "a deployment is made for the scenario's team");
        Trial {
            layouts: Layouts::of_scenario(&*scenario, 0, 1),
            physics: physics(registry, &deployment.plant, &*scenario),
            registry: registry.clone(),
            deployment: deployment.for_task(scenario.task_file()),
            scenario,
            models: model.into(),
            seed: 0,
            repeat: 0,
            range: None,
            handling: Handling::Hold,
            step_takes: Span::ZERO,
            estimator: estimation::REGISTRY[0],
            sensor_delay: None,
            clamp: Clamp::Training,
            safety: Safety::emulated(),
            stops: Vec::new(),
            faults: FaultPlan::default(),
            until: None,
            everywhere: false,
            steps: Steps::Discarded,
        }
    }

    /// Makes the trial of a team file, with the policies `models`. Each host of the team makes the same trial and runs
    /// its own part of it. An error names the wrong field.
    pub fn of_host(registry: &Registry, team: &Team, models: impl Into<Models>) -> Result<Trial, TrialError> {
        let scenario = team.make_scenario(registry)?;
        let layouts = Layouts::of_scenario(&*scenario, team.seed, team.episodes);
        let trial = Trial::with_registry(registry, team.deployment.clone(), scenario, models);
        let SimulationSettings { physics, clamp, handling } = team.simulated;
        let (estimator, sensor_delay) = (team.estimator, team.sensor_delay);
        let (seed, safety) = (team.seed, team.safety);
        let trial = Trial { physics, handling, estimator, sensor_delay, seed, safety, layouts, ..trial }.clamp(clamp);
        trial.check()?;
        Ok(trial)
    }

    /// Sets the plant by name, with its default properties of robots. `check` refuses an unknown name.
    pub fn plant(mut self, name: &str) -> Trial {
        (self.physics, self.deployment.plant) = (physics(&self.registry, name, &*self.scenario), name.to_owned());
        let clamp = self.clamp;
        self.clamp(clamp)
    }

    /// Sets the policy that drives all robots during an episode.
    pub fn model(self, model: Model) -> Trial {
        self.models(model)
    }

    /// Sets the policies that drive the robots during an episode.
    pub fn models(mut self, models: impl Into<Models>) -> Trial {
        self.models = models.into();
        self
    }

    /// Sets the number of episodes, and draws their starts and goals anew as the scenario defines them.
    pub fn episodes(mut self, episodes: u32) -> Trial {
        self.layouts = Layouts::of_scenario(&*self.scenario, self.seed, episodes);
        self
    }

    /// Sets the seed of the run, and draws the episodes' starts and goals from it as the scenario defines them.
    pub fn seed(mut self, seed: u64) -> Trial {
        self.seed = seed;
        let episodes = self.layouts.len();
        self.episodes(episodes)
    }

    /// Sets the limit on the policy's velocities, and the largest acceleration of the simulated robots with it. With
    /// `Clamp::Training` the simulator limits acceleration, as in training; with `Clamp::Deployed` only the robots'
    /// Controllers do, as on the paper's robots.
    pub fn clamp(mut self, clamp: Clamp) -> Trial {
        self.clamp = clamp;
        self.physics.acceleration_m_s2 = match clamp {
            Clamp::Training => kinematic::MAX_ACCELERATION_M_S2,
            Clamp::Deployed => f32::INFINITY,
        };
        self
    }

    /// Sets the stops and limits of the robots' motion, adapted to hull, lag and acceleration of the simulated robots.
    pub fn safety(mut self, safety: Safety) -> Trial {
        self.safety = self.physics.fit(safety.of_hull(self.scenario.arena().hull_m()));
        self
    }

    /// Sets the faults that are injected during the trial.
    pub fn faults(mut self, faults: FaultPlan) -> Trial {
        self.faults = faults;
        self
    }

    /// Draws faults from `seed` and injects them in about the first half of the trial. The second half shows how the
    /// team recovers.
    pub fn random_faults(self, seed: u64) -> Trial {
        let half = Span::from_secs(EPISODE_S / 2.0 * f64::from(self.layouts.len()));
        let plan = FaultPlan::random(seed, &self.deployment.targets(), half);
        self.faults(plan)
    }

    /// Sets the duration of the trial, with enough episodes to fill it. The report's totals are those of this time.
    pub fn lasting(mut self, lasts: Span) -> Trial {
        let episodes = 1 + lasts.as_nanos() / LEAST_EPISODE.as_nanos();
        // Events at the last instant are included.
        self.until = Some(Time::ZERO + lasts + Span::from_nanos(1));
        self.episodes(u32::try_from(episodes).expect("a trial takes less than a century"))
    }

    /// Sets that the report contains the robots' true states after each step of the simulator.
    pub fn keeping_steps(mut self) -> Trial {
        self.steps = Steps::Reported;
        self
    }

    /// Checks the deployment and the safety limits, and that stops and faults fit the hosts, links and episodes. An
    /// error names the wrong field.
    pub fn check(&self) -> Result<(), ConfigError> {
        let deployment = Deployment { placement: self.placement(), ..self.deployment.clone() };
        deployment.check()?;
        let plant = self.registry.plant(&deployment.plant);
        let plant = plant.map_err(|error| ConfigError::field("plant", error.to_string()))?;
        deployment.check_drives(plant)?;
        self.check_obstacles(plant)?;
        self.safety.check()?;
        self.check_senses()?;
        RobotId::team(self.deployment.robots).try_for_each(|robot| self.check_policy(robot))?;
        budget::check(&self.deployment, &self.models)?;
        self.check_handling()?;
        if let Some((_, stop)) = self.stops.iter().find(|(_, stop)| usize::from(stop.by.0) >= deployment.hosts.len()) {
            let reason = format!("there is no host {}; there are {}, from 0", stop.by.0, deployment.hosts.len());
            return Err(ConfigError::field("stops", reason));
        }
        self.faults.check(&deployment.targets())?;
        self.faults.check_episodes(self.layouts.len())
    }

    /// Checks that a robot has the drive and the channels that its policy needs. An error names the field.
    fn check_policy(&self, robot: RobotId) -> Result<(), ConfigError> {
        let field = self.policy_field(robot);
        if self.models.of(robot).turns() && self.deployment.chassis(robot).point_ahead_m == 0.0 {
            let why = format!("it commands a yaw rate, and {robot} has a holonomic drive: it needs 'differential'");
            return Err(ConfigError::field(field, why));
        }
        let robots = self.deployment.robots;
        if let Some(most) = self.models.of(robot).most_robots().filter(|most| robots > *most) {
            let why = format!("its input 'id' tells {most} robots apart, and the team has {robots}");
            return Err(ConfigError::field(field, why));
        }
        self.channels(robot).map(drop).map_err(|error| ConfigError::field(field, error.to_string()))
    }

    /// Checks that no message is dropped in a tick in which the policy has no step. An error names the field.
    fn check_handling(&self) -> Result<(), ConfigError> {
        let unequal = |robots: &Vec<u16>| {
            let robots: Vec<RobotId> = robots.iter().copied().map(RobotId).collect();
            robots.iter().any(|robot| self.models.every(*robot, self.models.tick(&robots)) > 1)
        };
        match self.deployment.hosts.iter().find(|host| host.agents.iter().any(unequal)) {
            Some(host) if self.handling == Handling::AsPublished => {
                let why = format!(
                    "'as-published' is for robots that step at the same rate, and an agent of host '{}' has several; \
                     take 'hold'",
                    host.name
                );
                Err(ConfigError::field("handling", why))
            }
            _ => Ok(()),
        }
    }

    /// Returns the name of the field that states the policy of a robot.
    fn policy_field(&self, robot: RobotId) -> String {
        match self.deployment.role_of(robot).filter(|(_, role)| role.policy.is_some()) {
            Some((name, _)) => format!("roles.{name}.policy"),
            None => "policy".to_owned(),
        }
    }

    /// Returns whether robots are placed at their starts before an episode, or drive there. Robots are placed if the
    /// starts are not the goals of the episode before. So are all robots in a scenario without goals, with the
    /// velocities that they start with, if all are simulated. Real robots drive to their starts and begin at rest.
    pub(crate) fn placement(&self) -> Placement {
        let place = match self.scenario.cost() {
            Some(_) => self.deployment.check_simulated().is_ok(),
            None => !self.layouts.chained(),
        };
        if place { Placement::Exact } else { self.deployment.placement }
    }

    /// Returns the range within which a robot uses the messages of others: the trial's own, or that of the robot's
    /// role, or that of its policy.
    pub fn comm_range(&self, robot: RobotId) -> CommRange {
        self.range.unwrap_or(CommRange::fixed(self.deployment.radius_m(robot, &self.models)))
    }

    /// Returns the marks of policy and task file, by which hosts with unequal ones are noticed.
    pub(crate) fn marks(&self) -> Marks {
        Marks { policy: self.models.mark(), task: self.scenario.task_file().map_or(0, TaskFile::mark) }
    }

    /// Returns the largest mean of the ranges within which robots use each other's messages \[m\].
    pub fn farthest_m(&self) -> f32 {
        let ranges = RobotId::team(self.deployment.robots).map(|robot| self.comm_range(robot).mean_m);
        ranges.fold(0.0, f32::max)
    }

    /// Returns the channels of the observation that the policy of a robot takes, joined with those of the scenario and
    /// the robot's senses. An error names a channel that the robot has not, or has otherwise.
    pub fn channels(&self, robot: RobotId) -> Result<Bound, ChannelError> {
        let mut channels = self.scenario.channels();
        channels.extend(self.sense_channels(robot));
        Bound::new(self.models.of(robot).requests(), &channels)
    }

    /// Returns what the policy's messages need of the links on which they travel in parts; nothing if they fit into a
    /// datagram.
    pub fn budgets(&self) -> Vec<Budget> {
        budget::of(&self.deployment, &self.models)
    }

    /// Returns the delay from a measurement to the arrival of its reading, for which the estimator can compensate.
    pub(crate) fn reading_delay(&self) -> Span {
        self.sensor_delay.unwrap_or(self.physics.sensor.latency)
    }

    /// Returns the seed from which all random streams of this repeat are derived, but the layouts of the episodes.
    pub(crate) fn streams(&self) -> Seed {
        Seed::of_repeat(self.seed, self.repeat)
    }

    /// Returns the registry entry of the plant.
    ///
    /// # Panics
    /// If the registry has no such plant; the method `check` refuses such a trial.
    pub(crate) fn plant_entry(&self) -> world::Entry {
        *self.registry.plant(&self.deployment.plant).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Returns how a robot follows the velocities that its policy commands. The lag of a simulated robot is that of its
    /// plant, and that of a real one is in `safety`.
    pub(crate) fn dynamics(&self, robot: RobotId) -> Dynamics {
        let real = self.deployment.hosts.iter().any(|host| host.actuates.contains(&robot.0));
        let lag_s = if real { self.safety.lag_s } else { self.physics.lag_s };
        let point_ahead_m = self.deployment.chassis(robot).point_ahead_m;
        Dynamics { filtered: self.safety.distance == Switch::On, lag_s, point_ahead_m }
    }
}
