//! Models: policies of which every robot of a team has an instance, each the same.

use std::fmt;
use std::sync::Arc;

use super::gnn::{Gnn, Network};
use super::manifest::Architecture;
use super::weights::{self, WeightsError};
use super::{Draw, Interface, Policy, orca, shipped};
use crate::messages::wire::MAX_FEATURES;
use crate::scenario::Arena;
use crate::time::Span;

/// A policy that every robot of a team can have an instance of.
#[derive(Clone, Debug)]
pub enum Model {
    /// Scripted collision-avoiding navigation.
    Orca,
    /// A trained network.
    Gnn(Arc<Network>, Draw),
    /// One that the program was built with.
    Own(Own),
}

/// A policy in code: its name, what the rest has to know of it, and what makes an instance.
#[derive(Clone)]
pub struct Own {
    name: &'static str,
    interface: Interface,
    instance: Arc<Instance>,
}

/// What makes one robot's instance, for an arena in the policy frame.
type Instance = dyn Fn(&Arena) -> Box<dyn Policy> + Send + Sync;

impl fmt::Debug for Own {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Own").field("name", &self.name).field("interface", &self.interface).finish_non_exhaustive()
    }
}

/// Why there is no such model.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The scenario has no policy of its own.
    #[error("the scenario '{scenario}' has none; use 'orca'")]
    None {
        /// The scenario.
        scenario: String,
    },
    /// The file is no policy.
    #[error(transparent)]
    File(#[from] WeightsError),
    /// The policy is for something else.
    #[error("it is for the scenario '{theirs}', not '{ours}'")]
    Scenario {
        /// What it is for.
        theirs: String,
        /// What it was to do.
        ours: String,
    },
    /// What a policy in code has against it.
    #[error("{0}")]
    Refused(String),
}

impl Model {
    /// The policy that comes with the program for the scenario of this name.
    pub fn shipped(scenario: &str) -> Result<Model, ModelError> {
        Model::of_scenario(shipped::shipped(scenario), scenario)
    }

    /// The same, trained for the paper's own conditions: lock step, perfect messages.
    pub fn published(scenario: &str) -> Result<Model, ModelError> {
        Model::of_scenario(shipped::published(scenario), scenario)
    }

    fn of_scenario(bytes: Option<&[u8]>, scenario: &str) -> Result<Model, ModelError> {
        let none = || ModelError::None { scenario: scenario.to_owned() };
        Model::from_file(bytes.ok_or_else(none)?, scenario)
    }

    /// The policy in a file of these bytes, for the scenario of this name; it draws as the file says.
    pub fn from_file(bytes: &[u8], scenario: &str) -> Result<Model, ModelError> {
        let file = weights::read(bytes)?;
        if file.manifest.scenario != scenario {
            return Err(ModelError::Scenario { theirs: file.manifest.scenario, ours: scenario.to_owned() });
        }
        let draw = file.manifest.draw;
        Ok(Model::Gnn(Arc::new(Network::new(file)), draw))
    }

    /// A policy in code. `instance` makes one robot's, for an arena in the policy frame.
    ///
    /// # Panics
    /// If the interface is one that no team could run: more features than a message carries, a period that is not 1 to
    /// 100 ms, a message that is of no use for one step, or a radius or a speed that is not above zero.
    pub fn own(
        name: &'static str,
        interface: Interface,
        instance: impl Fn(&Arena) -> Box<dyn Policy> + Send + Sync + 'static,
    ) -> Model {
        let Interface { features, radius_m, period, limit_m_s, hold } = interface;
        assert!(features <= MAX_FEATURES, "policy '{name}': a message carries {MAX_FEATURES} features");
        let sound = (Span::from_millis(1)..=Span::from_millis(100)).contains(&period);
        assert!(sound, "policy '{name}': its period is not 1 to 100 ms, so motor commands would expire");
        assert!(hold >= period, "policy '{name}': a message is of use for one step at least");
        assert!(radius_m > 0.0 && limit_m_s > 0.0, "policy '{name}': its radius and its speed are above zero");
        Model::Own(Own { name, interface, instance: Arc::new(instance) })
    }

    /// Its name in reports.
    pub fn name(&self) -> &'static str {
        match self {
            Model::Orca => "orca",
            Model::Gnn(network, _) => match network.manifest().architecture {
                Architecture::Published => "gnn",
                Architecture::Full => "gnn-full",
            },
            Model::Own(own) => own.name,
        }
    }

    /// One robot's instance, for an arena in the policy frame.
    pub fn instance(&self, arena: &Arena) -> Box<dyn Policy> {
        match self {
            Model::Orca => Box::new(orca::Orca::new(arena)),
            Model::Gnn(network, draw) => Box::new(Gnn::new(Arc::clone(network), *draw)),
            Model::Own(own) => (own.instance)(arena),
        }
    }

    /// What the rest of the system has to know of it.
    pub fn interface(&self) -> Interface {
        match self {
            Model::Orca => orca::INTERFACE,
            Model::Gnn(network, _) => network.interface(),
            Model::Own(own) => own.interface,
        }
    }

    /// The same with actions drawn like this; `None` if it draws none.
    pub fn drawing(self, draw: Draw) -> Option<Model> {
        match self {
            Model::Gnn(network, _) => Some(Model::Gnn(network, draw)),
            Model::Orca | Model::Own(_) => None,
        }
    }

    /// A digest of its file; empty for a policy in code.
    pub fn digest(&self) -> &str {
        self.network().map_or("", Network::digest)
    }

    /// What its file does not say and was assumed, for a warning.
    pub fn assumed(&self) -> Option<&str> {
        self.network()?.assumed()
    }

    fn network(&self) -> Option<&Network> {
        match self {
            Model::Gnn(network, _) => Some(network),
            Model::Orca | Model::Own(_) => None,
        }
    }
}
