//! The registry: what there is by name, as a value. The command line, team files, trials and trainings look names up
//! in the one that they are handed, so a program with a scenario, a plant or a policy of its own has everything that
//! this crate's program has.
//!
//! ```
//! use murmurate::policy::{self, Model};
//! use murmurate::registry::Registry;
//!
//! let still = policy::Entry { name: "scripted", about: "another name of orca", build: |_| Ok(Model::Orca) };
//! let registry = Registry::builtin().with_policy(still);
//! assert!(registry.policy("scripted").is_some() && registry.policy("orca").is_some());
//! ```

use std::sync::Arc;

use crate::drivers;
use crate::estimation;
use crate::localization;
use crate::policy;
use crate::scenario::{self, Scenario, ScenarioError, Settings};
use crate::world;

/// What there is by name: scenarios, plants, policies, drivers, sources and estimators.
#[derive(Clone, Debug)]
pub struct Registry {
    scenarios: Vec<scenario::Entry>,
    plants: Vec<world::Entry>,
    policies: Vec<policy::Entry>,
    drivers: Vec<drivers::Entry>,
    sources: Vec<localization::Entry>,
    estimators: Vec<estimation::Entry>,
}

/// There is no plant of that name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no plant '{name}'; there are: {known}")]
pub struct UnknownPlant {
    /// What was asked for.
    pub name: String,
    /// What there is.
    pub known: String,
}

impl Registry {
    /// What this crate has.
    pub fn builtin() -> Registry {
        Registry {
            scenarios: scenario::REGISTRY.to_vec(),
            plants: world::REGISTRY.to_vec(),
            policies: policy::REGISTRY.to_vec(),
            drivers: drivers::REGISTRY.to_vec(),
            sources: localization::REGISTRY.to_vec(),
            estimators: estimation::REGISTRY.to_vec(),
        }
    }

    /// With a scenario more.
    ///
    /// # Panics
    /// If there is one of its name.
    pub fn with_scenario(mut self, entry: scenario::Entry) -> Registry {
        assert!(self.scenarios.iter().all(|other| other.name != entry.name), "a second scenario '{}'", entry.name);
        self.scenarios.push(entry);
        self
    }

    /// With a plant more.
    ///
    /// # Panics
    /// If there is one of its name.
    pub fn with_plant(mut self, entry: world::Entry) -> Registry {
        assert!(self.plants.iter().all(|other| other.name != entry.name), "a second plant '{}'", entry.name);
        self.plants.push(entry);
        self
    }

    /// With a policy more.
    ///
    /// # Panics
    /// If there is one of its name.
    pub fn with_policy(mut self, entry: policy::Entry) -> Registry {
        assert!(self.policies.iter().all(|other| other.name != entry.name), "a second policy '{}'", entry.name);
        self.policies.push(entry);
        self
    }

    /// With a driver more.
    ///
    /// # Panics
    /// If there is one of its name.
    pub fn with_driver(mut self, entry: drivers::Entry) -> Registry {
        assert!(self.drivers.iter().all(|other| other.name != entry.name), "a second driver '{}'", entry.name);
        self.drivers.push(entry);
        self
    }

    /// With a source of readings more.
    ///
    /// # Panics
    /// If there is one of its name.
    pub fn with_source(mut self, entry: localization::Entry) -> Registry {
        assert!(self.sources.iter().all(|other| other.name != entry.name), "a second source '{}'", entry.name);
        self.sources.push(entry);
        self
    }

    /// With an estimator more.
    ///
    /// # Panics
    /// If there is one of its name.
    pub fn with_estimator(mut self, entry: estimation::Entry) -> Registry {
        assert!(self.estimators.iter().all(|other| other.name != entry.name), "a second estimator '{}'", entry.name);
        self.estimators.push(entry);
        self
    }

    /// All estimators.
    pub fn estimators(&self) -> &[estimation::Entry] {
        &self.estimators
    }

    /// All drivers of robots that are not simulated.
    pub fn drivers(&self) -> &[drivers::Entry] {
        &self.drivers
    }

    /// All sources of readings of robots that are not simulated.
    pub fn sources(&self) -> &[localization::Entry] {
        &self.sources
    }

    /// All scenarios.
    pub fn scenarios(&self) -> &[scenario::Entry] {
        &self.scenarios
    }

    /// All plants.
    pub fn plants(&self) -> &[world::Entry] {
        &self.plants
    }

    /// All policies that have a name.
    pub fn policies(&self) -> &[policy::Entry] {
        &self.policies
    }

    /// Makes the scenario of that name.
    pub fn scenario(&self, name: &str, settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
        let scenario = scenario::build_of(&self.scenarios, name, settings)?;
        assert_eq!(scenario.name(), name, "a scenario goes by the name that it has in its registry");
        Ok(scenario)
    }

    /// The plant of that name.
    pub fn plant(&self, name: &str) -> Result<&world::Entry, UnknownPlant> {
        let names = || self.plants.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", ");
        let known = || match name {
            "rigid" => format!("{}, and 'rigid' where the program is built with the feature 'rigid'", names()),
            _ => names(),
        };
        let unknown = || UnknownPlant { name: name.to_owned(), known: known() };
        self.plants.iter().find(|entry| entry.name == name).ok_or_else(unknown)
    }

    /// The policy of that name; whatever has none here is a file.
    pub fn policy(&self, name: &str) -> Option<&policy::Entry> {
        self.policies.iter().find(|entry| entry.name == name)
    }

    /// The name of the policy that drives a scenario unless someone says otherwise.
    pub fn usual_policy(&self, scenario: &dyn Scenario) -> &'static str {
        let shipped = self.policy(policy::SHIPPED).is_some_and(|entry| (entry.build)(scenario).is_ok());
        if shipped { policy::SHIPPED } else { policy::SCRIPTED }
    }

    /// Whether there is something that this crate does not have.
    pub fn is_extended(&self) -> bool {
        let builtin = Registry::builtin();
        let count = |all: &Registry| {
            all.scenarios.len()
                + all.plants.len()
                + all.policies.len()
                + all.drivers.len()
                + all.sources.len()
                + all.estimators.len()
        };
        count(self) != count(&builtin)
    }
}
