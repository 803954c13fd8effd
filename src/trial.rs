//! Trial: one deployment in one process under virtual time, from its first episode to its last.
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

mod error;

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;

use crate::actors::recorder::Steps;
use crate::actors::state_server;
use crate::config::ConfigError;
use crate::deploy::Deployment;
use crate::deploy::team::{SimulationSettings, Team};
use crate::estimation;
use crate::faults::FaultPlan;
use crate::graph::process::{Graph, ProcessEvent};
use crate::graph::{self, Plan};
use crate::hearing::CommRange;
use crate::hearing::Handling;
use crate::messages::ids::HostId;
use crate::messages::wire::Stop;
use crate::policy::{self, Model};
use crate::random::Seed;
use crate::registry::Registry;
use crate::report::episode::Episode;
pub use crate::report::trial::TrialReport;
use crate::runtime::drive::{End, run_virtual};
use crate::safety::Safety;
use crate::scenario::judge::Verdict;
use crate::scenario::layout::Layouts;
use crate::scenario::{Arena, Scenario, Settings};
use crate::time::{Span, Time};
use crate::world::{Clamp, Physics, Placement, kinematic};

pub use error::TrialError;

/// Rough duration of an episode with its reset \[s\], for planning faults.
const EPISODE_S: f64 = 10.0;

/// Shortest possible duration of an episode with its reset.
const LEAST_EPISODE: Span = Span::from_millis(1000);

/// All inputs of a trial, a series of simulated episodes in one process under virtual time.
#[derive(Clone)]
pub struct Trial {
    /// Hosts with the actors that they run, and the links between hosts.
    pub deployment: Deployment,
    /// Registry in which the deployment's plant (simulator) is looked up.
    pub registry: Registry,
    /// Task of the team, such as driving through a passage.
    pub scenario: Arc<dyn Scenario>,
    /// Properties of the simulated robots, such as their largest acceleration and their sensor.
    pub physics: Physics,
    /// Policy that drives the robots during an episode.
    pub model: Model,
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
    /// Whether the report contains the robots' true states after each step of the simulator, and the messages in use.
    pub steps: Steps,
}

/// Decision of a caller, after each event of a trial, whether the trial continues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Proceed {
    /// The trial continues with the next event.
    Continue,
    /// The trial continues. The time until its next event is not counted in its time limit, because a person has paused
    /// the team.
    Hold,
    /// The trial stops; the report holds the results up to that time.
    Stop,
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

    /// Makes a trial of one episode, with scenario and plant (simulator) looked up in `registry`. `mode` names a preset
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

    /// Makes a trial of one episode with seed 0, with a plant (simulator) of this crate. The deployment must have
    /// passed `Deployment::check` and be made for the scenario's team size; another size panics.
    pub fn new(deployment: Deployment, scenario: Arc<dyn Scenario>, model: Model) -> Trial {
        Trial::with_registry(&Registry::builtin(), deployment, scenario, model)
    }

    /// Makes a trial of one episode with seed 0, with the plant (simulator) looked up in `registry`. The deployment
    /// must have passed `Deployment::check` and be made for the scenario's team size; another size panics.
    pub fn with_registry(
        registry: &Registry,
        deployment: Deployment,
        scenario: Arc<dyn Scenario>,
        model: Model,
    ) -> Trial {
        assert_eq!(deployment.robots, scenario.robots(), "a deployment is made for the scenario's team");
        Trial {
            layouts: Layouts::of_scenario(&*scenario, 0, 1),
            physics: physics(registry, &deployment.plant, &*scenario),
            registry: registry.clone(),
            deployment,
            scenario,
            model,
            seed: 0,
            repeat: 0,
            range: None,
            handling: Handling::Hold,
            estimator: estimation::REGISTRY[0],
            sensor_delay: None,
            clamp: Clamp::Training,
            safety: Safety::emulated(),
            stops: Vec::new(),
            faults: FaultPlan::default(),
            until: None,
            steps: Steps::Discarded,
        }
    }

    /// Makes the trial of a team file, with the policy `model`. Each host of the team makes the same trial and runs its
    /// own part of it. An error names the wrong field.
    pub fn of_host(registry: &Registry, team: &Team, model: Model) -> Result<Trial, TrialError> {
        let scenario = registry.scenario(&team.scenario, &team.deployment.settings())?;
        let layouts = Layouts::of_scenario(&*scenario, team.seed, team.episodes);
        let trial = Trial::with_registry(registry, team.deployment.clone(), scenario, model);
        let SimulationSettings { physics, clamp, handling } = team.simulated;
        let (estimator, sensor_delay) = (team.estimator, team.sensor_delay);
        let (seed, safety) = (team.seed, team.safety);
        let trial = Trial { physics, handling, estimator, sensor_delay, seed, safety, layouts, ..trial }.clamp(clamp);
        trial.check()?;
        Ok(trial)
    }

    /// Sets the plant (simulator) by name, with its default properties of robots. `check` refuses an unknown name.
    pub fn plant(mut self, name: &str) -> Trial {
        (self.physics, self.deployment.plant) = (physics(&self.registry, name, &*self.scenario), name.to_owned());
        let clamp = self.clamp;
        self.clamp(clamp)
    }

    /// Sets the policy that drives the robots during an episode.
    pub fn model(mut self, model: Model) -> Trial {
        self.model = model;
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
        self.safety = safety.of_hull(self.scenario.arena().hull_m()).simulated(&self.physics);
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

    /// Runs the trial to its end on the calling thread and returns the report.
    pub fn run(&self) -> TrialReport {
        self.run_while(|_| Proceed::Continue)
    }

    /// Runs the trial on the calling thread until its end, or until `proceed` returns [`Proceed::Stop`]. The function
    /// `proceed` is called after each event of the simulation with the results of the episodes so far.
    pub fn run_while(&self, mut proceed: impl FnMut(&[Episode]) -> Proceed) -> TrialReport {
        self.run_observed(|_, _, _| {}, |_, _, episodes| proceed(episodes))
    }

    /// Runs the trial on the calling thread until its end, or until `proceed` returns [`Proceed::Stop`], and reports
    /// what happens in it. The function `report` is called with each event, its time, and the host where it happened.
    /// `proceed` is called after the events of each instant, with the actors, the time, and the results so far.
    pub fn run_observed(
        &self,
        report: impl Fn(Time, HostId, ProcessEvent) + 'static,
        mut proceed: impl FnMut(&Graph, Time, &[Episode]) -> Proceed,
    ) -> TrialReport {
        let plan = self.plan();
        let shared = Rc::new(RefCell::new(TrialReport::default()));
        let sink = {
            let shared = Rc::clone(&shared);
            move |output| shared.borrow_mut().note(output)
        };
        let (mut deadline, mut held_since) = (self.deadline(), None);
        let (graph, end) = run_virtual(
            |clock| {
                let time = clock.clone();
                graph::wire(
                    clock,
                    plan,
                    Rc::new(move |host, event: ProcessEvent| report(time.now(), host, event)),
                    sink,
                )
            },
            |graph, now| {
                let mut report = shared.borrow_mut();
                report.simulated = now.since(Time::ZERO);
                let closed = self.until.is_some_and(|until| now >= until);
                if let Some(since) = held_since.take() {
                    deadline += now.since(since);
                }
                let proceed = proceed(graph, now, &report.episodes);
                held_since = (proceed == Proceed::Hold).then_some(now);
                report.finished || closed || now >= deadline || proceed == Proceed::Stop
            },
        );
        assert_eq!(end, End::Done, "a team with heartbeats never falls idle");
        let mut report = shared.borrow().clone();
        (report.refused, report.lost) = graph.undelivered();
        if !report.finished && Time::ZERO + report.simulated >= deadline {
            self.give_up(&mut report);
        }
        report
    }

    /// Returns the time at which a trial is given up, whatever has crashed: every episode may take the longest times
    /// that the state server allows.
    fn deadline(&self) -> Time {
        let each = state_server::MUSTER_LIMIT * 2 + state_server::RESET_LIMIT + self.scenario.rules().limit;
        Time::ZERO + (each + state_server::GRACE) * (u64::from(self.layouts.len()) + 1)
    }

    /// Adds an aborted result for every episode without a result.
    fn give_up(&self, report: &mut TrialReport) {
        let open = u32::try_from(report.episodes.len()).expect("episodes were counted in u32");
        report.episodes.extend((open..self.layouts.len()).map(|episode| Episode {
            repeat: self.repeat,
            episode,
            verdict: Verdict::Aborted,
            makespan_s: None,
            reset_s: 0.0,
            min_separation_m: f32::INFINITY,
            judged: self.deployment.judged(),
            cost: None,
            reason: None,
        }));
        report.finished = true;
    }

    /// Checks the deployment and the safety limits, and that stops and faults fit the hosts, links and episodes. An
    /// error names the wrong field.
    pub fn check(&self) -> Result<(), ConfigError> {
        let deployment = self.placed();
        deployment.check()?;
        let plant = self.registry.plant(&deployment.plant);
        deployment.check_drives(plant.map_err(|error| ConfigError::field("plant", error.to_string()))?)?;
        self.safety.check()?;
        if let Some((_, stop)) = self.stops.iter().find(|(_, stop)| usize::from(stop.by.0) >= deployment.hosts.len()) {
            let reason = format!("there is no host {}; there are {}, from 0", stop.by.0, deployment.hosts.len());
            return Err(ConfigError::field("stops", reason));
        }
        self.faults.check(&deployment.targets())?;
        self.faults.check_episodes(self.layouts.len())
    }

    /// Returns the deployment as used by the trial. Robots are placed at their starts if these are not the goals of the
    /// episode before. So are all robots in a scenario without goals, with the velocities that they start with, if all
    /// are simulated. Real robots drive to their starts and begin at rest.
    fn placed(&self) -> Deployment {
        let mut deployment = self.deployment.clone();
        let place = match self.scenario.cost() {
            Some(_) => deployment.check_simulated().is_ok(),
            None => !self.layouts.chained(),
        };
        if place {
            deployment.placement = Placement::Exact;
        }
        deployment
    }

    /// Makes the settings from which the actors of this trial are made and connected.
    ///
    /// # Panics
    /// If the deployment's plant (simulator) is not in the registry; the method `check` refuses such a trial.
    pub fn plan(&self) -> Plan {
        let deployment = self.placed();
        let interface = self.model.interface();
        Plan {
            deployment,
            scenario: Arc::clone(&self.scenario),
            plant: *self.registry.plant(&self.deployment.plant).unwrap_or_else(|error| panic!("{error}")),
            physics: self.physics,
            run: self.model.clone(),
            reset: Model::Orca,
            range: self.range.unwrap_or(CommRange::fixed(interface.radius_m)),
            hold: interface.hold,
            handling: self.handling,
            estimator: self.estimator,
            sensor_delay: self.sensor_delay.unwrap_or(self.physics.sensor.latency),
            clamp: self.clamp,
            safety: self.safety,
            stops: self.stops.clone(),
            layouts: self.layouts.clone(),
            repeat: self.repeat,
            seed: Seed::of_repeat(self.seed, self.repeat),
            faults: self.faults.clone(),
            until: self.until,
            steps: self.steps,
        }
    }
}
