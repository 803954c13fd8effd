//! A trial: one deployment in one process under virtual time, from its first episode to its last.
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
//! Same trial, same report, bit for bit. Faults come from a [`FaultPlan`]; `examples/faults.rs` is an example to
//! copy. Trials are independent of each other: run them on as many threads as there are cores.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;

use crate::actors::recorder::Steps;
use crate::actors::state_server;
use crate::config::ConfigError;
use crate::deploy::Deployment;
use crate::deploy::team::{Simulated, Team};
use crate::estimation;
use crate::faults::FaultPlan;
use crate::graph::{self, Plan};
use crate::hearing::CommRange;
use crate::hearing::Handling;
use crate::messages::wire::Stop;
use crate::policy::Model;
use crate::random::Seed;
use crate::registry::Registry;
use crate::report::episode::Episode;
pub use crate::report::trial::TrialReport;
use crate::runtime::drive::{End, run_virtual};
use crate::safety::Safety;
use crate::scenario::judge::Verdict;
use crate::scenario::layout::Layouts;
use crate::scenario::{Arena, Scenario, ScenarioError, Settings};
use crate::time::{Span, Time};
use crate::world::{Clamp, Physics, Placement, kinematic};

/// About how long an episode with its reset takes \[s\].
const EPISODE_S: f64 = 10.0;

/// No episode with its reset is over sooner.
const LEAST_EPISODE: Span = Span::from_millis(1000);

/// Everything that a trial depends on.
#[derive(Clone)]
pub struct Trial {
    /// Which host runs what.
    pub deployment: Deployment,
    /// What the deployment's plant is looked up in.
    pub registry: Registry,
    /// What the team is to do.
    pub scenario: Arc<dyn Scenario>,
    /// What simulated robots are like.
    pub physics: Physics,
    /// What drives it.
    pub model: Model,
    /// The episodes.
    pub layouts: Layouts,
    /// The seed of the run: layouts are drawn from it.
    pub seed: u64,
    /// Which repeat of the run this is: all other randomness is drawn from seed and repeat.
    pub repeat: u32,
    /// Who is near enough to be heard; `None` for the policy's own radius.
    pub range: Option<CommRange>,
    /// What becomes of neighbours' messages once a robot's agent has seen them.
    pub handling: Handling,
    /// How a robot's readings become an estimate.
    pub estimator: estimation::Entry,
    /// How Controllers limit what the policy wants; `Trial::clamp` sets it together with the physics it goes with.
    pub clamp: Clamp,
    /// When robots are stopped or slowed, whatever the policy wants.
    pub safety: Safety,
    /// The emergency stops and re-arms of the trial, and when a host of the deployment says them.
    pub stops: Vec<(Time, Stop)>,
    /// What goes wrong.
    pub faults: FaultPlan,
    /// When it ends, in the midst of an episode or not; `None` for after the last one.
    pub until: Option<Time>,
    /// Whether the report keeps every step.
    pub steps: Steps,
}

/// Why a trial cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// The scenario cannot be made.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The deployment cannot be used.
    #[error(transparent)]
    Deployment(#[from] ConfigError),
    /// No preset has that name.
    #[error("there is no mode '{name}'; there are: {}", crate::deploy::MODES.join(", "))]
    Mode {
        /// What was asked for.
        name: String,
    },
}

/// Whether a trial is to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Proceed {
    /// To the next event.
    On,
    /// No further: the report holds what there is.
    Stop,
}

/// What the robots of a plant are like; a plant that there is not is refused by `Trial::check`.
fn physics(registry: &Registry, plant: &str, scenario: &dyn Scenario) -> Physics {
    let entry = registry.plant(plant);
    entry.map_or(Physics::published as fn(&Arena) -> Physics, |entry| entry.physics)(scenario.arena())
}

impl Trial {
    /// A trial of one episode in a preset mode, with the scripted policy, the scenario's own team and seed 0.
    pub fn preset(mode: &str, scenario: &str) -> Result<Trial, TrialError> {
        Trial::of_team(mode, scenario, None)
    }

    /// The same for a team of this size.
    pub fn of_team(mode: &str, scenario: &str, robots: impl Into<Option<usize>>) -> Result<Trial, TrialError> {
        Trial::among(&Registry::builtin(), mode, scenario, robots)
    }

    /// The same with scenarios and plants from a registry.
    pub fn among(
        registry: &Registry,
        mode: &str,
        scenario: &str,
        robots: impl Into<Option<usize>>,
    ) -> Result<Trial, TrialError> {
        let scenario = registry.scenario(scenario, &Settings { robots: robots.into(), gap_m: None })?;
        let deployment = Deployment::preset(mode, scenario.robots());
        let deployment = deployment.ok_or_else(|| TrialError::Mode { name: mode.to_owned() })?;
        Ok(Trial::with_registry(registry, deployment, scenario, Model::Orca))
    }

    /// A trial of one episode with seed 0, in a checked deployment of the scenario's team, in a plant of this crate.
    pub fn new(deployment: Deployment, scenario: Arc<dyn Scenario>, model: Model) -> Trial {
        Trial::with_registry(&Registry::builtin(), deployment, scenario, model)
    }

    /// The same in a plant from a registry.
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
            clamp: Clamp::Training,
            safety: Safety::emulated(),
            stops: Vec::new(),
            faults: FaultPlan::default(),
            until: None,
            steps: Steps::Discarded,
        }
    }

    /// The run that a team is to make as its team file says, of which each host does its part.
    pub fn of_host(registry: &Registry, team: &Team, model: Model) -> Result<Trial, TrialError> {
        let scenario = registry.scenario(&team.scenario, &Settings::of(team.deployment.robots))?;
        let layouts = Layouts::of_scenario(&*scenario, team.seed, team.episodes);
        let trial = Trial::with_registry(registry, team.deployment.clone(), scenario, model);
        let Simulated { physics, clamp, handling } = team.simulated;
        let estimator = team.estimator;
        let (seed, safety) = (team.seed, team.safety);
        let trial = Trial { physics, handling, estimator, seed, safety, layouts, ..trial }.clamp(clamp);
        trial.check()?;
        Ok(trial)
    }

    /// In this plant, whose robots are as they are unless someone says otherwise.
    pub fn plant(mut self, name: &str) -> Trial {
        (self.physics, self.deployment.plant) = (physics(&self.registry, name, &*self.scenario), name.to_owned());
        let clamp = self.clamp;
        self.clamp(clamp)
    }

    /// Driven by this.
    pub fn model(mut self, model: Model) -> Trial {
        self.model = model;
        self
    }

    /// With so many of the scenario's own episodes.
    pub fn episodes(mut self, episodes: u32) -> Trial {
        self.layouts = Layouts::of_scenario(&*self.scenario, self.seed, episodes);
        self
    }

    /// With this seed, and with the scenario's own layouts for it.
    pub fn seed(mut self, seed: u64) -> Trial {
        self.seed = seed;
        let episodes = self.layouts.len();
        self.episodes(episodes)
    }

    /// With what limits acceleration: in training the world does, on the published robots only their Controllers.
    pub fn clamp(mut self, clamp: Clamp) -> Trial {
        self.clamp = clamp;
        self.physics.acceleration_m_s2 = match clamp {
            Clamp::Training => kinematic::MAX_ACCELERATION_M_S2,
            Clamp::Deployed => f32::INFINITY,
        };
        self
    }

    /// With these faults.
    pub fn faults(mut self, faults: FaultPlan) -> Trial {
        self.faults = faults;
        self
    }

    /// With faults drawn from a seed, over about the first half of the trial: the rest shows how it recovers.
    pub fn random_faults(self, seed: u64) -> Trial {
        let half = Span::from_secs(EPISODE_S / 2.0 * f64::from(self.layouts.len()));
        let plan = FaultPlan::random(seed, &self.deployment.targets(), half);
        self.faults(plan)
    }

    /// For so long and no longer, and with as many episodes as that may take: what is said and carried in this time is
    /// in the report's totals, and `Cost::of` gives it per robot and second.
    pub fn lasting(mut self, lasts: Span) -> Trial {
        let episodes = 1 + lasts.as_nanos() / LEAST_EPISODE.as_nanos();
        // What happens at the last instant is part of it.
        self.until = Some(Time::ZERO + lasts + Span::from_nanos(1));
        self.episodes(u32::try_from(episodes).expect("a trial takes less than a century"))
    }

    /// With every step kept in the report.
    pub fn keeping_steps(mut self) -> Trial {
        self.steps = Steps::Reported;
        self
    }

    /// Runs the trial to its end on this thread.
    pub fn run(&self) -> TrialReport {
        self.run_while(|_| Proceed::On)
    }

    /// Runs the trial on this thread until its end, or until `proceed`, which is asked at every event and
    /// shown the episodes so far, says stop.
    pub fn run_while(&self, mut proceed: impl FnMut(&[Episode]) -> Proceed) -> TrialReport {
        let plan = self.plan();
        let said = Rc::new(RefCell::new(TrialReport::default()));
        let sink = {
            let said = Rc::clone(&said);
            move |told| said.borrow_mut().note(told)
        };
        let deadline = self.deadline();
        let (graph, end) = run_virtual(
            |clock| graph::wire(clock, plan, sink),
            |_, now| {
                let mut report = said.borrow_mut();
                report.simulated = now.since(Time::ZERO);
                let closed = self.until.is_some_and(|until| now >= until);
                report.finished || closed || now >= deadline || proceed(&report.episodes) == Proceed::Stop
            },
        );
        assert_eq!(end, End::Done, "a team that beats never falls idle");
        let mut report = said.borrow().clone();
        (report.refused, report.lost) = graph.undelivered();
        if !report.finished && Time::ZERO + report.simulated >= deadline {
            self.give_up(&mut report);
        }
        report
    }

    /// When a trial is given up, whatever has died: every episode may take as long as the state server lets it.
    fn deadline(&self) -> Time {
        let each = state_server::MUSTER_LIMIT * 2 + state_server::RESET_LIMIT + self.scenario.rules().limit;
        Time::ZERO + (each + state_server::GRACE) * (u64::from(self.layouts.len()) + 1)
    }

    /// Every episode that has no result was aborted.
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
        }));
        report.finished = true;
    }

    /// Checks the deployment as the trial will use it, and that the faults are of this team and its links.
    pub fn check(&self) -> Result<(), ConfigError> {
        let deployment = self.placed();
        deployment.check()?;
        let plant = self.registry.plant(&deployment.plant);
        plant.map_err(|error| ConfigError::field("plant", error.to_string()))?;
        self.safety.check()?;
        if let Some((_, stop)) = self.stops.iter().find(|(_, stop)| usize::from(stop.by.0) >= deployment.hosts.len()) {
            let reason = format!("there is no host {}; there are {}, from 0", stop.by.0, deployment.hosts.len());
            return Err(ConfigError::field("stops", reason));
        }
        self.faults.check(&deployment.targets())?;
        self.faults.check_episodes(self.layouts.len())
    }

    /// The deployment as the trial uses it: layouts that do not chain leave nothing to drive to.
    fn placed(&self) -> Deployment {
        let mut deployment = self.deployment.clone();
        if !self.layouts.chained() {
            deployment.placement = Placement::Exact;
        }
        deployment
    }

    /// What its graph is made of.
    ///
    /// # Panics
    /// If there is no plant of the deployment's name, which `check` says.
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
