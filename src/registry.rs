//! Registry of named parts, such as scenarios and policies. The command line, team files, trials and trainings look up
//! names in the registry that the caller passes in. So a program that adds its own scenario, plant or policy has all
//! commands of this crate's program.
//!
//! ```
//! use murmurate::policy::{self, Model};
//! use murmurate::registry::Registry;
//!
//! let still = policy::Entry { name: "scripted", about: "another name of orca", build: |_| Ok(Model::Orca) };
//! let registry = Registry::builtin().with_policy(still);
//! assert!(registry.policy("scripted").is_some() && registry.policy("orca").is_some());
//! ```

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::chassis::Chassis;
use crate::config::ConfigError;
use crate::drivers;
use crate::edge::Settings;
use crate::estimation;
use crate::localization::{self, plausibility};
use crate::messages::ids::RobotId;
use crate::net::transport;
use crate::observers;
use crate::policy::{self, shipped};
use crate::scenario::{self, Scenario, ScenarioError, TaskFile, task_file};
use crate::senses;
use crate::world;

/// Registry of the named parts that a run can use: scenarios, plants, policies, drivers, sources of
/// readings, kinds of senses, estimators, transports and observers.
#[derive(Clone, Debug)]
pub struct Registry {
    scenarios: Vec<scenario::Entry>,
    plants: Vec<world::Entry>,
    policies: Vec<policy::Entry>,
    drivers: Vec<drivers::Entry>,
    sources: Vec<localization::Entry>,
    senses: Vec<senses::Entry>,
    estimators: Vec<estimation::Entry>,
    transports: Vec<transport::Entry>,
    observers: Vec<observers::Entry>,
    /// Function that reads task files; `None` in a library, which reads no files.
    reads_tasks: Option<ReadText>,
    /// Task files whose content is known, by their names.
    tasks: BTreeMap<String, TaskFile>,
    /// Whether a part was added to those of the program.
    extended: bool,
}

/// Function that returns the text of a file, given its path. An error describes the fault and names the file.
pub type ReadText = fn(&str) -> Result<String, String>;

/// Error for a name that is not in the registry. Its text lists the names in the registry.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no {kind} '{name}'; there are: {known}")]
pub struct Unknown {
    /// Kind of the missing part, such as `plant` or `driver`.
    pub kind: &'static str,
    /// The name that is not in the registry.
    pub name: String,
    /// The names of this kind in the registry, separated by commas.
    pub known: String,
}

/// Entry of a registry for one kind of part.
trait Entry {
    /// Name of the kind of part, in the singular.
    const KIND: &'static str;
    fn name(&self) -> &'static str;
}

macro_rules! entries {
    ($($entry:ty, $kind:literal;)*) => {
        $(impl Entry for $entry {
            const KIND: &'static str = $kind;
            fn name(&self) -> &'static str {
                self.name
            }
        })*
    };
}

entries! {
    scenario::Entry, "scenario";
    world::Entry, "plant";
    policy::Entry, "policy";
    drivers::Entry, "driver";
    localization::Entry, "source";
    senses::Entry, "kind of sense";
    estimation::Entry, "estimator";
    transport::Entry, "transport";
    observers::Entry, "observer";
}

fn find<'a, E: Entry>(entries: &'a [E], name: &str) -> Result<&'a E, Unknown> {
    entries.iter().find(|entry| entry.name() == name).ok_or_else(|| Unknown {
        kind: E::KIND,
        name: name.to_owned(),
        known: entries.iter().map(E::name).collect::<Vec<_>>().join(", "),
    })
}

impl Registry {
    /// The registry of all parts that this crate contains.
    pub fn builtin() -> Registry {
        Registry {
            scenarios: scenario::REGISTRY.to_vec(),
            plants: world::REGISTRY.to_vec(),
            policies: policy::REGISTRY.to_vec(),
            drivers: drivers::REGISTRY.to_vec(),
            sources: localization::REGISTRY.to_vec(),
            senses: senses::REGISTRY.to_vec(),
            estimators: estimation::REGISTRY.to_vec(),
            transports: transport::REGISTRY.to_vec(),
            observers: Vec::new(),
            reads_tasks: None,
            tasks: BTreeMap::new(),
            extended: false,
        }
    }

    /// Adds an entry to one of the lists.
    ///
    /// # Panics
    /// If the name of the entry is already in the registry.
    fn add<E: Entry>(&mut self, list: impl Fn(&mut Registry) -> &mut Vec<E>, entry: E) {
        self.extended = true;
        let entries = list(self);
        assert!(entries.iter().all(|other| other.name() != entry.name()), "a second {} '{}'", E::KIND, entry.name());
        entries.push(entry);
    }

    /// Adds a scenario (a task for a team) and returns the registry.
    ///
    /// # Panics
    /// If the registry already has a scenario of that name.
    pub fn with_scenario(mut self, entry: scenario::Entry) -> Registry {
        self.add(|all| &mut all.scenarios, entry);
        self
    }

    /// Adds a plant (a simulator of robots) and returns the registry.
    ///
    /// # Panics
    /// If the registry already has a plant of that name.
    pub fn with_plant(mut self, entry: world::Entry) -> Registry {
        self.add(|all| &mut all.plants, entry);
        self
    }

    /// Adds a policy and returns the registry.
    ///
    /// # Panics
    /// If the registry already has a policy of that name.
    pub fn with_policy(mut self, entry: policy::Entry) -> Registry {
        self.add(|all| &mut all.policies, entry);
        self
    }

    /// Adds a driver of real robots and returns the registry.
    ///
    /// # Panics
    /// If the registry already has a driver of that name.
    pub fn with_driver(mut self, entry: drivers::Entry) -> Registry {
        self.add(|all| &mut all.drivers, entry);
        self
    }

    /// Adds a source of readings, which localizes real robots, and returns the registry.
    ///
    /// # Panics
    /// If the registry already has a source of that name.
    pub fn with_source(mut self, entry: localization::Entry) -> Registry {
        self.add(|all| &mut all.sources, entry);
        self
    }

    /// Adds a kind of sense, by which robots perceive their surroundings, and returns the registry.
    ///
    /// # Panics
    /// If the registry already has a kind of sense of that name.
    pub fn with_sense(mut self, entry: senses::Entry) -> Registry {
        self.add(|all| &mut all.senses, entry);
        self
    }

    /// Adds an estimator, which filters readings into a robot's state, and returns the registry.
    ///
    /// # Panics
    /// If the registry already has an estimator of that name.
    pub fn with_estimator(mut self, entry: estimation::Entry) -> Registry {
        self.add(|all| &mut all.estimators, entry);
        self
    }

    /// Adds a transport, which carries the datagrams of a link, and returns the registry.
    ///
    /// # Panics
    /// If the registry already has a transport of that name. Also if a settings field of the transport has a reserved
    /// name, or the name of another transport's field of another type.
    pub fn with_transport(mut self, entry: transport::Entry) -> Registry {
        for field in entry.fields {
            let others = || self.transports.iter().flat_map(|other| other.fields);
            let own = !transport::RESERVED.contains(&field.name);
            let agrees = others().filter(|other| other.name == field.name).all(|other| other.agrees(field));
            assert!(own && agrees, "the field '{}' of '{}' is another's", field.name, entry.name);
        }
        self.add(|all| &mut all.transports, entry);
        self
    }

    /// Adds an observer, which passes messages of the team on to other programs, and returns the registry.
    ///
    /// # Panics
    /// If the registry already has an observer of that name.
    pub fn with_observer(mut self, entry: observers::Entry) -> Registry {
        self.add(|all| &mut all.observers, entry);
        self
    }

    /// Sets the function that reads task files, and returns the registry. A name of a scenario that ends with `.toml`
    /// is the path of such a file.
    pub fn reading_tasks(mut self, read: ReadText) -> Registry {
        self.reads_tasks = Some(read);
        self
    }

    /// Returns the registry with a task file under the name `name`, such as its path. So scenarios of that name that
    /// are made later are of this content, whatever happens to the file in the meantime.
    pub fn with_task(mut self, name: &str, file: TaskFile) -> Registry {
        self.tasks.insert(name.to_owned(), file);
        self
    }

    /// Returns the registry with the text of a task file, of which a record or a checkpoint has a copy, under the name
    /// `name`, unless it has one of that text, which may have a behaviour besides. An error names the wrong field.
    pub fn with_task_text(self, name: &str, text: &str) -> Result<Registry, ScenarioError> {
        if self.tasks.get(name).is_some_and(|file| file.text() == text) {
            return Ok(self);
        }
        let wrong = |error: ConfigError| ScenarioError::Unread { file: name.to_owned(), why: error.to_string() };
        Ok(self.with_task(name, TaskFile::read(text).map_err(wrong)?))
    }

    /// Returns the registry as that of a program: parts that are added later are extensions of it
    /// ([`Registry::is_extended`]).
    pub fn of_program(mut self) -> Registry {
        self.extended = false;
        self
    }

    /// All transports in the registry, which carry the datagrams of links.
    pub fn transports(&self) -> &[transport::Entry] {
        &self.transports
    }

    /// Returns the transport called `name`, which carries the datagrams of a link. An error lists the names of all
    /// transports.
    pub fn transport(&self, name: &str) -> Result<&transport::Entry, Unknown> {
        find(&self.transports, name)
    }

    /// All estimators in the registry, which filter readings into a robot's state.
    pub fn estimators(&self) -> &[estimation::Entry] {
        &self.estimators
    }

    /// All drivers of real robots in the registry.
    pub fn drivers(&self) -> &[drivers::Entry] {
        &self.drivers
    }

    /// All sources in the registry, which deliver readings of the poses of real robots.
    pub fn sources(&self) -> &[localization::Entry] {
        &self.sources
    }

    /// All kinds of senses in the registry, by which robots perceive their surroundings.
    pub fn senses(&self) -> &[senses::Entry] {
        &self.senses
    }

    /// All scenarios (tasks for a team) in the registry.
    pub fn scenarios(&self) -> &[scenario::Entry] {
        &self.scenarios
    }

    /// All plants (simulators of robots) in the registry.
    pub fn plants(&self) -> &[world::Entry] {
        &self.plants
    }

    /// All policies in the registry.
    pub fn policies(&self) -> &[policy::Entry] {
        &self.policies
    }

    /// Returns the task file with the path `path`. An error says that it cannot be read, or names the wrong field.
    pub fn task_file(&self, path: &str) -> Result<TaskFile, ScenarioError> {
        if let Some(known) = self.tasks.get(path) {
            return Ok(known.clone());
        }
        let wrong = |why: String| ScenarioError::Unread { file: path.to_owned(), why };
        let read = self.reads_tasks.ok_or_else(|| wrong("this program reads no files".to_owned()))?;
        let text = read(path).map_err(ScenarioError::Unreadable)?;
        let file = TaskFile::read(&text).map_err(|error| wrong(error.to_string()))?;
        if self.scenarios.iter().any(|entry| entry.name == file.name()) {
            return Err(wrong(format!("name: '{}' is a scenario of this program", file.name())));
        }
        self.check_senses(&file).map_err(|error| wrong(error.to_string()))?;
        Ok(file)
    }

    /// Checks that the registry has the kinds of a task file's senses, with their settings. An error names the field.
    pub fn check_senses(&self, file: &TaskFile) -> Result<(), ConfigError> {
        file.senses().iter().try_for_each(|(name, settings)| {
            let made = self.sense(name, &senses::Settings::of_task(settings.clone()), RobotId(0));
            made.map(drop).map_err(|error| error.within("senses"))
        })
    }

    /// Makes the scenario (task of a team) called `name`, for the team size and other values in `settings`. A name that
    /// ends with `.toml` is the path of a task file. An error says that the name is unknown or that the settings do not
    /// fit.
    pub fn scenario(&self, name: &str, settings: &scenario::Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
        if task_file::is_task_file(name) || self.tasks.contains_key(name) {
            return self.task_file(name)?.scenario(settings);
        }
        let scenario = scenario::build_of(&self.scenarios, name, settings)?;
        assert_eq!(scenario.name(), name, "a scenario goes by the name that it has in its registry");
        Ok(scenario)
    }

    /// Returns the plant (simulator of robots) called `name`. An error lists the names of all plants.
    pub fn plant(&self, name: &str) -> Result<&world::Entry, Unknown> {
        find(&self.plants, name).map_err(|mut unknown| {
            if name == "rigid" {
                unknown.known += ", and 'rigid' where the program is built with the feature 'rigid'";
            }
            unknown
        })
    }

    /// Returns the estimator called `name`, which filters readings into a robot's state. An error lists the names of
    /// all estimators.
    pub fn estimator(&self, name: &str) -> Result<&estimation::Entry, Unknown> {
        find(&self.estimators, name)
    }

    /// Makes the driver of one real robot from its `settings` in a deployment. An error names the wrong field from
    /// `driver` on, such as `driver.name`.
    pub fn driver(&self, settings: &Settings, robot: RobotId) -> Result<drivers::Parts, ConfigError> {
        let entry =
            find(&self.drivers, &settings.name).map_err(|e| ConfigError::field("driver.name", e.to_string()))?;
        let settings = settings.for_robot(robot).map_err(|error| error.within("driver"))?;
        (entry.make)(&settings, robot).map_err(|error| error.within("driver"))
    }

    /// Makes the parts of a source of readings, such as a tracker: its state machine, and the worker that will
    /// communicate with the device. No device is opened yet. `settings` are those of the source in a deployment;
    /// `robots` are the real robots that the source localizes. An error names the wrong field from `source` on, such as
    /// `source.address`.
    pub fn source(&self, settings: &Settings, robots: &[RobotId]) -> Result<localization::Parts, ConfigError> {
        let entry =
            find(&self.sources, &settings.name).map_err(|e| ConfigError::field("source.name", e.to_string()))?;
        let limits = |robot: &RobotId| plausibility::limits(settings, *robot, (&Chassis::default(), None)).map(drop);
        let parts = robots
            .iter()
            .try_for_each(limits)
            .and_then(|()| localization::fusion::make(&plausibility::without(settings), robots, entry.make));
        parts.map_err(|error| error.within("source"))
    }

    /// Makes the parts of the sense called `name` of one robot, from its `settings` in a deployment. No worker is
    /// started. An error names the wrong field from the sense's name on, such as `lidar.rays`.
    pub fn sense(&self, name: &str, settings: &senses::Settings, robot: RobotId) -> Result<senses::Parts, ConfigError> {
        let wrong = |field: &str, why: String| ConfigError::field(format!("{name}.{field}"), why);
        let entry = find(&self.senses, &settings.kind).map_err(|e| wrong("kind", e.to_string()))?;
        let own = settings.named(name).for_robot(robot).map_err(|error| error.within(name))?;
        let parts = (entry.make)(&own, robot)?;
        match parts.layout.unfit() {
            None => Ok(parts),
            Some(why) => Err(ConfigError::field(name, why)),
        }
    }

    /// Makes the observer of a team of these `robots` from its `settings` in a deployment. An error names the wrong
    /// field from `observe` on, such as `observe.name`.
    pub fn observer(&self, settings: &Settings, robots: &[RobotId]) -> Result<observers::Parts, ConfigError> {
        let entry =
            find(&self.observers, &settings.name).map_err(|e| ConfigError::field("observe.name", e.to_string()))?;
        (entry.make)(settings, robots).map_err(|error| error.within("observe"))
    }

    /// Returns the policy called `name`; `None` if the registry has no policy of that name.
    pub fn policy(&self, name: &str) -> Option<&policy::Entry> {
        find(&self.policies, name).ok()
    }

    /// Returns the name of the policy that a scenario uses if the user gives none: the better one of the shipped
    /// trained policy, if there is one for the scenario, and the scripted one.
    pub fn default_policy(&self, scenario: &dyn Scenario) -> &'static str {
        let shipped = shipped::is_best_for(scenario.name()) && self.policy(policy::SHIPPED).is_some();
        if shipped { policy::SHIPPED } else { policy::scripted(scenario) }
    }

    /// Whether the registry has a part beyond those of the program, such as a user's own scenario.
    pub fn is_extended(&self) -> bool {
        self.extended
    }
}
