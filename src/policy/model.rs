//! Models: policies from which every robot of a team gets its own, identical instance.

use std::fmt;
use std::sync::Arc;

use super::gnn::{Gnn, Network};
use super::manifest::Architecture;
use super::weights::{self, WeightsError};
use super::{Draw, Interface, Policy, orca, probe, shipped};
use crate::chassis::Chassis;
use crate::messages::wire::MAX_FEATURES;
use crate::scenario::Arena;
use crate::time::Span;

/// A policy from which instances for robots can be made.
#[derive(Clone, Debug)]
pub enum Model {
    /// Scripted collision-avoiding navigation.
    Orca,
    /// A trained network.
    Gnn(Arc<Network>, Draw),
    /// A policy that another crate implements in code.
    Custom(Custom),
}

/// A policy in code: its name, its interface, and the constructor of an instance.
#[derive(Clone)]
pub struct Custom {
    name: &'static str,
    interface: Interface,
    instance: Arc<Instance>,
}

/// Constructor of one robot's instance, for an arena in the policy frame.
type Instance = dyn Fn(&Arena) -> Box<dyn Policy> + Send + Sync;

impl fmt::Debug for Custom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Custom").field("name", &self.name).field("interface", &self.interface).finish_non_exhaustive()
    }
}

/// Error of a model that cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// No trained policy is shipped for the scenario.
    #[error("the scenario '{scenario}' has none; use 'orca'")]
    None {
        /// The scenario.
        scenario: String,
    },
    /// The file is not a policy file.
    #[error(transparent)]
    File(#[from] WeightsError),
    /// The policy is for another scenario.
    #[error("it is for the scenario '{theirs}', not '{ours}'")]
    Scenario {
        /// Scenario of the policy file.
        theirs: String,
        /// Scenario that it was to be used in.
        ours: String,
    },
    /// A policy in code refuses the scenario, with this reason.
    #[error("{0}")]
    Refused(String),
}

impl Model {
    /// The default trained policy that is built into the program for the scenario of this name.
    pub fn shipped(scenario: &str) -> Result<Model, ModelError> {
        Model::of_scenario(shipped::shipped(scenario), scenario)
    }

    /// The built-in policy for the scenario that was trained for the paper's conditions: lock step, perfect messages.
    pub fn published(scenario: &str) -> Result<Model, ModelError> {
        Model::of_scenario(shipped::published(scenario), scenario)
    }

    fn of_scenario(bytes: Option<&[u8]>, scenario: &str) -> Result<Model, ModelError> {
        let none = || ModelError::None { scenario: scenario.to_owned() };
        Model::from_file(bytes.ok_or_else(none)?, scenario)
    }

    /// Reads a policy file from `bytes` for the scenario of this name; actions are drawn as the file says.
    pub fn from_file(bytes: &[u8], scenario: &str) -> Result<Model, ModelError> {
        let file = weights::read(bytes)?;
        if file.manifest.scenario != scenario {
            return Err(ModelError::Scenario { theirs: file.manifest.scenario, ours: scenario.to_owned() });
        }
        let draw = file.manifest.draw;
        let (network, _) = probe::network(file)?;
        Ok(Model::Gnn(network, draw))
    }

    /// Makes a model of a policy in code. `instance` makes one robot's instance, for an arena in the policy frame.
    ///
    /// # Panics
    /// If no team could run the interface. The features must fit into a message, and the period must be 1 to 100 ms.
    /// The hold time must be at least the period, and radius and speed above zero.
    pub fn custom(
        name: &'static str,
        interface: Interface,
        instance: impl Fn(&Arena) -> Box<dyn Policy> + Send + Sync + 'static,
    ) -> Model {
        let Interface { features, radius_m, period, limit_m_s, hold } = interface;
        assert!(features <= MAX_FEATURES, "policy '{name}': a message carries {MAX_FEATURES} features");
        let period_is_valid = (Span::from_millis(1)..=Span::from_millis(100)).contains(&period);
        assert!(period_is_valid, "policy '{name}': its period is not 1 to 100 ms, so motor commands would expire");
        assert!(hold >= period, "policy '{name}': its hold time must be at least one period");
        assert!(radius_m > 0.0 && limit_m_s > 0.0, "policy '{name}': its radius and its speed must be above zero");
        Model::Custom(Custom { name, interface, instance: Arc::new(instance) })
    }

    /// Name of the model in reports.
    pub fn name(&self) -> &'static str {
        match self {
            Model::Orca => "orca",
            Model::Gnn(network, _) => match network.manifest().architecture {
                Architecture::Published => "gnn",
                Architecture::Full => "gnn-full",
            },
            Model::Custom(custom) => custom.name,
        }
    }

    /// Makes one robot's instance, for an arena in the policy frame.
    pub fn instance(&self, arena: &Arena) -> Box<dyn Policy> {
        match self {
            Model::Orca => Box::new(orca::Orca::new(arena)),
            Model::Gnn(network, draw) => Box::new(Gnn::new(Arc::clone(network), *draw)),
            Model::Custom(custom) => (custom.instance)(arena),
        }
    }

    /// Parameters of the policy that the rest of the system depends on.
    pub fn interface(&self) -> Interface {
        match self {
            Model::Orca => orca::INTERFACE,
            Model::Gnn(network, _) => network.interface(),
            Model::Custom(custom) => custom.interface,
        }
    }

    /// Returns the model with another method of drawing actions; `None` if it has no distribution to draw from.
    pub fn with_draw(self, draw: Draw) -> Option<Model> {
        match self {
            Model::Gnn(network, _) => Some(Model::Gnn(network, draw)),
            Model::Orca | Model::Custom(_) => None,
        }
    }

    /// Digest of the policy file; empty for a policy in code.
    pub fn digest(&self) -> &str {
        self.network().map_or("", Network::digest)
    }

    /// Assumptions made because the policy file has no manifest or an incomplete one, for a warning.
    pub fn assumed(&self) -> Option<&str> {
        self.network()?.assumed()
    }

    /// Size of the largest team in the policy's training; `None` if that is unknown.
    pub fn largest_team(&self) -> Option<usize> {
        self.network()?.manifest().training.as_ref()?.largest_team()
    }

    /// Chassis of the robots of its training; none where that is unknown.
    pub fn trained_chassis(&self) -> Option<Chassis> {
        self.network()?.manifest().training.as_ref()?.chassis()
    }

    fn network(&self) -> Option<&Network> {
        match self {
            Model::Gnn(network, _) => Some(network),
            Model::Orca | Model::Custom(_) => None,
        }
    }
}
