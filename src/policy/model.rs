//! Models: policies of a team, from which each robot gets its own, identical instance.

use std::fmt;
use std::sync::Arc;

use super::gnn::{Gnn, GnnWeights};
use super::manifest::Training;
use super::weights::WeightsError;
use super::{Draw, Interface, Policy, SHIPPED, file, orca, probe, shipped};
use crate::chassis::Chassis;
use crate::messages::ids::RobotId;
use crate::messages::wire::{Form, MAX_FLOATS};
use crate::observation::Request;
use crate::scenario::Arena;
use crate::time::Span;

/// Policy of a team, from which each robot gets its own instance; all instances are identical.
#[derive(Clone, Debug)]
pub enum Model {
    /// Scripted navigation by optimal reciprocal collision avoidance (ORCA), without training.
    Orca,
    /// Trained graph neural network from a policy file of format 1 or 2, with the method by which actions are drawn
    /// from its output distribution.
    Gnn(Arc<GnnWeights>, Draw),
    /// Policy that another crate implements in code; see [`Model::custom`].
    Custom(Custom),
}

/// Policy that another crate implements in code or reads from a file: its name, its interface, what it takes and where
/// it comes from, and the constructor of one robot's instance. [`Model::custom`] and [`Model::of_file`] make it.
#[derive(Clone)]
pub struct Custom {
    name: &'static str,
    interface: Interface,
    origin: Origin,
    /// How actions are drawn from the policy's output distribution; `None` if it has none.
    draw: Option<Draw>,
    instance: Arc<Instance>,
}

/// Properties of a policy from its file, for a policy that another crate reads.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Origin {
    /// Digest of the policy's files (16 hexadecimal digits); empty without files.
    pub digest: String,
    /// Channels of the observation that the policy takes, in the order in which it gets their values.
    pub requests: Vec<Request>,
    /// Name and version of the engine that computes the policy, and the kind of processor, on which the last digits of
    /// its numbers depend; empty for what computes the same bits everywhere.
    pub engine: String,
    /// Whether the policy is computed on a thread of its own on real hosts, because a step may take long or never end.
    pub apart: bool,
    /// Form in which the policy's messages travel.
    pub form: Form,
    /// Name of what the policy's messages mean, by which policies that were made for each other understand each other;
    /// empty for a policy that understands no other one.
    pub message: String,
    /// Whether the policy commands a yaw rate, which only a robot with a differential drive follows.
    pub turns: bool,
    /// Number of robots of the largest team that the policy tells apart; `None` without such a bound.
    pub most_robots: Option<usize>,
}

/// Constructor of one robot's instance, for an arena in the policy frame. The last argument says how actions are drawn,
/// which only a policy with an output distribution reads.
type Instance = dyn Fn(&Arena, RobotId, Draw) -> Box<dyn Policy> + Send + Sync;

impl fmt::Debug for Custom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Custom").field("name", &self.name).field("interface", &self.interface).finish_non_exhaustive()
    }
}

impl Interface {
    /// Checks that a team can run a policy with this interface. The features have to fit into a message, and the period
    /// has to be 1 to 100 ms, so that motor commands do not expire between two steps. The hold time is at least one
    /// period, and radius and speed limit are above zero. An error says which is not so.
    pub fn check(&self) -> Result<(), String> {
        let Interface { features, radius_m, period, limit_m_s, hold } = *self;
        let periods = Span::from_millis(1)..=Span::from_millis(100);
        // A radius may have no bound.
        let above_zero = |value: f32| value > 0.0;
        let wrong = if features > MAX_FLOATS {
            format!("its message has {features} floats, and a message carries at most {MAX_FLOATS}")
        } else if !periods.contains(&period) {
            "its period is not 1 to 100 ms (10 to 1000 steps a second), so motor commands would expire".to_owned()
        } else if hold < period {
            "its hold time is less than one period".to_owned()
        } else if !(above_zero(radius_m) && above_zero(limit_m_s)) {
            "its radius and its speed limit are not above zero".to_owned()
        } else {
            return Ok(());
        };
        Err(wrong)
    }
}

/// Error of a policy that cannot be made for a scenario (a task for a robot team).
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// No trained policy is built into the program for the scenario.
    #[error("the scenario '{scenario}' has none; use 'orca'")]
    None {
        /// Name of the scenario for which a policy was requested.
        scenario: String,
    },
    /// The given bytes are not a valid policy file, or the network computes other numbers than those stored with it.
    #[error(transparent)]
    File(#[from] WeightsError),
    /// The policy file is for another scenario than the requested one.
    #[error("it is for the scenario '{theirs}', not '{ours}'")]
    Scenario {
        /// Name of the scenario for which the policy was trained, from its file.
        theirs: String,
        /// Name of the scenario in which the policy was to be used.
        ours: String,
    },
    /// A policy implemented in code refuses the scenario; the text is its reason.
    #[error("{0}")]
    Refused(String),
}

impl Model {
    /// Returns the default trained policy that is built into the program for the scenario named `scenario`. Without one
    /// the error is [`ModelError::None`].
    pub fn shipped(scenario: &str) -> Result<Model, ModelError> {
        Model::built_in(SHIPPED, scenario)
    }

    /// Returns the built-in trained policy named `name`, one of [`shipped::NAMES`], for the scenario named `scenario`.
    /// Without such a policy the error is [`ModelError::None`].
    pub fn built_in(name: &str, scenario: &str) -> Result<Model, ModelError> {
        let none = || ModelError::None { scenario: scenario.to_owned() };
        Model::from_file(shipped::built_in(name, scenario).ok_or_else(none)?, scenario)
    }

    /// Makes a model from the content `bytes` of a policy file, for the scenario named `scenario`. Actions are drawn as
    /// the file says. An error says that the file is invalid or for another scenario.
    pub fn from_file(bytes: &[u8], scenario: &str) -> Result<Model, ModelError> {
        let check = |theirs: &str| match theirs == scenario {
            true => Ok(()),
            false => Err(ModelError::Scenario { theirs: theirs.to_owned(), ours: scenario.to_owned() }),
        };
        let file = file::read(bytes)?;
        check(file.manifest.scenario())?;
        let draw = file.manifest.draw();
        let (network, _) = probe::network(file)?;
        Ok(Model::Gnn(network, draw))
    }

    /// Makes a model of a policy that is implemented in code. `name` is its name in reports, and `interface` gives its
    /// message size, radius, period, speed limit and hold time. `instance` makes one robot's instance for an arena in
    /// the policy frame.
    ///
    /// # Panics
    /// If no team could run the interface. The features must fit into a message, and the period must be 1 to 100 ms.
    /// The hold time must be at least the period, and radius and speed limit above zero.
    pub fn custom(
        name: &'static str,
        interface: Interface,
        instance: impl Fn(&Arena) -> Box<dyn Policy> + Send + Sync + 'static,
    ) -> Model {
        interface.check().unwrap_or_else(|reason| panic!("policy '{name}': {reason}"));
        let instance = move |arena: &Arena, _: RobotId, _: Draw| instance(arena);
        Model::Custom(Custom { name, interface, origin: Origin::default(), draw: None, instance: Arc::new(instance) })
    }

    /// Makes a model of a policy whose file another crate reads. `name` is the name of its kind in reports, `origin`
    /// what is known from the file, and `draw` how actions are drawn unless the user says otherwise; `None` if the
    /// policy has no output distribution. `instance` makes the instance of a robot for an arena in the policy frame.
    ///
    /// # Errors
    /// No team could run the interface; the text says why.
    pub fn of_file(
        (name, interface): (&'static str, Interface),
        origin: Origin,
        draw: Option<Draw>,
        instance: impl Fn(&Arena, RobotId, Draw) -> Box<dyn Policy> + Send + Sync + 'static,
    ) -> Result<Model, String> {
        interface.check()?;
        Ok(Model::Custom(Custom { name, interface, origin, draw, instance: Arc::new(instance) }))
    }

    /// Returns the model's name in reports, such as `orca`, `gnn` or the name of a custom policy.
    pub fn name(&self) -> &'static str {
        match self {
            Model::Orca => "orca",
            Model::Gnn(network, _) => network.manifest().kind(),
            Model::Custom(custom) => custom.name,
        }
    }

    /// Makes the policy instance of `robot`. `arena` has the ground, the walls and the robots' radius, in the policy
    /// frame.
    pub fn instance(&self, arena: &Arena, robot: RobotId) -> Box<dyn Policy> {
        match self {
            Model::Orca => Box::new(orca::Orca::new(arena)),
            Model::Gnn(network, draw) => Box::new(Gnn::new(Arc::clone(network), *draw, robot)),
            Model::Custom(custom) => (custom.instance)(arena, robot, custom.draw.unwrap_or(Draw::Mean)),
        }
    }

    /// Returns the parameters that the rest of the system needs to run the policy, such as message size and period.
    pub fn interface(&self) -> Interface {
        match self {
            Model::Orca => orca::INTERFACE,
            Model::Gnn(network, _) => network.interface(),
            Model::Custom(custom) => custom.interface,
        }
    }

    /// Returns the same model with `draw` as the method of drawing actions from the policy's output distribution.
    /// `None` means that the policy has no such distribution, because it is scripted or implemented in code.
    pub fn with_draw(self, draw: Draw) -> Option<Model> {
        match self {
            Model::Gnn(network, _) => Some(Model::Gnn(network, draw)),
            Model::Custom(custom) => custom.draw.map(|_| Model::Custom(Custom { draw: Some(draw), ..custom })),
            Model::Orca => None,
        }
    }

    /// Returns a digest of the policy file (16 hexadecimal digits); the text is empty if the policy has no file.
    pub fn digest(&self) -> &str {
        match self {
            Model::Gnn(network, _) => network.digest(),
            Model::Custom(custom) => &custom.origin.digest,
            Model::Orca => "",
        }
    }

    /// Returns a number by which robots of unequal policies are told apart: the beginning of the policy's digest, or of
    /// that of its name if it has no file. Never 0.
    pub fn mark(&self) -> u32 {
        let of_file = u32::from_str_radix(self.digest().get(..8).unwrap_or_default(), 16).ok();
        let of_name = || {
            let [a, b, c, d, ..] = *blake3::hash(self.name().as_bytes()).as_bytes();
            u32::from_be_bytes([a, b, c, d])
        };
        of_file.unwrap_or_else(of_name).max(1)
    }

    /// Returns the name and version of the engine that computes the policy, and the kind of processor; empty for a
    /// policy that computes the same bits on every machine.
    pub fn engine(&self) -> &str {
        match self {
            Model::Custom(custom) => &custom.origin.engine,
            Model::Orca | Model::Gnn(..) => "",
        }
    }

    /// Returns the same model, computed by its Agents themselves on real hosts, too: for a replay that asks another
    /// policy than the recorded one.
    pub fn computed_inline(self) -> Model {
        match self {
            Model::Custom(custom) => {
                Model::Custom(Custom { origin: Origin { apart: false, ..custom.origin }, ..custom })
            }
            other => other,
        }
    }

    /// Returns whether the policy is computed on a thread of its own on real hosts. Under virtual time no policy is.
    pub fn runs_apart(&self) -> bool {
        matches!(self, Model::Custom(custom) if custom.origin.apart)
    }

    /// Returns the form in which the policy's messages travel.
    pub fn form(&self) -> Form {
        match self {
            Model::Custom(custom) => custom.origin.form,
            Model::Orca | Model::Gnn(..) => Form::default(),
        }
    }

    /// Returns whether both are the same policy: of one file, or of one constructor.
    pub fn is_same_as(&self, other: &Model) -> bool {
        let of_file = !self.digest().is_empty() && self.digest() == other.digest() && self.name() == other.name();
        of_file
            || match (self, other) {
                (Model::Orca, Model::Orca) => true,
                (Model::Custom(one), Model::Custom(other)) => Arc::ptr_eq(&one.instance, &other.instance),
                _ => false,
            }
    }

    /// Returns the name of what the policy's messages mean; empty if no other policy understands them.
    pub fn message(&self) -> &str {
        match self {
            Model::Custom(custom) => &custom.origin.message,
            Model::Gnn(network, _) => network.manifest().message_name(),
            Model::Orca => "",
        }
    }

    /// Returns whether the policy commands a yaw rate, which only a robot with a differential drive follows.
    pub fn turns(&self) -> bool {
        matches!(self, Model::Custom(custom) if custom.origin.turns)
    }

    /// Returns the number of robots of the largest team that the policy tells apart; `None` without such a bound.
    pub fn most_robots(&self) -> Option<usize> {
        match self {
            Model::Custom(custom) => custom.origin.most_robots,
            Model::Orca | Model::Gnn(..) => None,
        }
    }

    /// Returns the channels of the observation that the policy takes by name, in the order in which it gets their
    /// values; empty for a policy that reads the fields of its observation.
    pub fn requests(&self) -> &[Request] {
        match self {
            Model::Custom(custom) => &custom.origin.requests,
            Model::Gnn(network, _) => network.requests(),
            Model::Orca => &[],
        }
    }

    /// Returns the assumptions made because the policy file has no manifest (its metadata) or an incomplete one, as
    /// text for a warning. `None` means that nothing was assumed, or that the policy has no file.
    pub fn assumed(&self) -> Option<&str> {
        match self {
            Model::Gnn(network, _) => network.assumed(),
            Model::Orca | Model::Custom(_) => None,
        }
    }

    /// Returns the number of robots in the largest team of the policy's training; `None` if that is unknown.
    pub fn largest_team(&self) -> Option<usize> {
        self.training()?.largest_team()
    }

    /// Returns the chassis (kind of drive and limits) of the robots in the policy's training; `None` if that is
    /// unknown.
    pub fn trained_chassis(&self) -> Option<Chassis> {
        self.training()?.chassis()
    }

    fn training(&self) -> Option<&Training> {
        match self {
            Model::Gnn(network, _) => network.manifest().training(),
            Model::Orca | Model::Custom(_) => None,
        }
    }
}
