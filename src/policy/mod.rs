//! Policies: functions that compute a robot's broadcast to its neighbours, and its velocity from their broadcasts.
//!
//! A new policy is one file here, and one entry in `REGISTRY`. A policy of another crate is one entry in the `Registry`
//! that the crate makes. A policy works in the policy frame only: the world frame, or the world frame turned by half a
//! turn. The code of this folder uses no network, actor or clock.

mod claim;
pub mod failures;
pub mod file;
pub mod flock;
pub mod gnn;
pub mod hops;
pub mod manifest;
pub mod mlp;
mod model;
mod models;
pub mod orca;
pub mod probe;
pub mod roadmap;
pub mod route;
mod safetensors;
pub mod shipped;
pub mod weights;

pub use model::{Model, ModelError, Origin};
pub use models::{Models, Unequal};

use std::sync::Arc;

use crate::messages::geometry::{Motion, Vec2};
use rand::RngExt;

use self::manifest::Manifest;
use crate::messages::wire::Form;
use crate::observation::Observation;
use crate::random::{Seed, Stream};
use crate::scenario::{Arena, Scenario};
use crate::time::Span;

/// Last message of a neighbour, as input to a robot's policy. A neighbour is another robot within communication range.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour<'a> {
    /// The neighbour's estimate of its own position \[m\] and velocity \[m/s\] when it sent the message, in the policy
    /// frame of the receiving robot.
    pub motion: Motion,
    /// Latent that the neighbour broadcast: what its `Policy::encode` wrote and, with several hops, `Policy::relay`.
    pub features: &'a [f32],
    /// Time since the message arrived at the receiving robot.
    pub age: Span,
}

/// Parameters of a policy that the rest of the system needs to run it: message size, radius, period, speed limit and
/// hold time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interface {
    /// Number of 32-bit floats in the message that a robot broadcasts at each step.
    pub features: usize,
    /// Default communication radius \[m\]: a robot uses messages only of neighbours within this distance, unless the
    /// trial sets another range.
    pub radius_m: f32,
    /// Time between two steps of the policy on one robot, each of which gives one action.
    pub period: Span,
    /// Largest speed along each axis \[m/s\] that is commanded for the policy; larger outputs are clamped.
    pub limit_m_s: f32,
    /// Hold time: age up to which a neighbour's newest message is used.
    pub hold: Span,
}

/// One robot's instance of a message-passing policy. At each step, `encode` makes the robot's broadcast, then `act`
/// computes its velocity.
///
/// # Order of calls
/// A new instance is at its start: it remembers nothing. `reset` puts it back there. The robot's Agent calls it when an
/// episode begins (an emergency stop ends the episode, so the next one begins anew), and after a gap longer than
/// `Policy::forgets_after`. An Agent or a process that is started again, on this host or another, has a new instance.
/// In each step of a running episode follow one call of `encode`, calls of `relay` for the hops 1 to `hops() - 1`, and
/// one call of `act`. A step in which the robot's own state is too old does not take place. A robot whose broadcast is
/// invalid, or whose `encode` has failed, skips `act`; one that broadcasts nothing skips `relay`.
pub trait Policy {
    /// Returns the parameters that the rest of the system needs to run the policy, such as message size and period.
    fn interface(&self) -> Interface;

    /// Returns the number of hops: how many times the robots exchange messages for one action. The default is 1, for a
    /// policy whose action depends on the observations of the robot and of its direct neighbours only.
    fn hops(&self) -> usize {
        1
    }

    /// Puts the policy back to its start, so that it remembers nothing of the steps before. `seed` is for random
    /// numbers that the policy draws itself until the next call: it follows from the seed of the run, the robot, and
    /// the number of calls since its Agent was started. The default does nothing, for a policy whose instance keeps no
    /// state from one step to the next.
    fn reset(&mut self, _seed: u64) {}

    /// Takes back the last step, whose action came too late and was not used: the state is that before the step. Called
    /// at most once after each step. The default does nothing, for a policy without state.
    fn undo(&mut self) {}

    /// Returns the longest time between two steps after which the policy still goes on from its state; after a longer
    /// gap it is reset. `None`, the default, is no bound, for a policy without state. It is the same for all steps.
    fn forgets_after(&self) -> Option<Span> {
        None
    }

    /// Returns what the policy remembers for its next step, for records; `None`, the default, for one without state, or
    /// whose state is not known.
    fn memory(&self) -> Option<&[f32]> {
        None
    }

    /// Returns the form in which the robot's broadcast travels: the encoding to which it is rounded, and what holds of
    /// parts of it that get lost. The default is that of broadcasts of at most 256 floats.
    fn form(&self) -> Form {
        Form::default()
    }

    /// Takes the arena of the episode that begins, in the policy frame, where it is another one than that for which the
    /// policy was made: the robots' radius is the same. The default does nothing, for policies that know no arena.
    fn enter(&mut self, _arena: &Arena) {}

    /// Returns whether the steps of several robots of an Agent are computed together. Then each robot is told by
    /// `prepare_encode` and `prepare_act` what the next `encode` and `act` of a running episode get, before the first
    /// of them is called. The default is no.
    fn is_joint(&self) -> bool {
        false
    }

    /// Takes what the next `encode` gets. The default does nothing.
    fn prepare_encode(&mut self, _own: &Observation) {}

    /// Takes what the next `act` gets. The default does nothing.
    fn prepare_act(&mut self, _own: &Observation, _features: &[f32], _neighbours: &[Neighbour]) {}

    /// Writes the robot's broadcast for this step into `features`, which has the length `Interface::features`. `own` is
    /// the robot's own state and goal, in the policy frame.
    fn encode(&mut self, own: &Observation, features: &mut [f32]);

    /// Computes the part of the robot's broadcast that its neighbours need for the hop `hop`, from the neighbours'
    /// broadcasts for the hop before, and writes it into `features`. Only policies of two or more hops implement this.
    /// It is called after `encode`, once for each hop from 1 to `hops() - 1` in this order; `encode` serves hop 0.
    ///
    /// `features` already holds what `encode` and the calls for lower hops wrote. Each of `neighbours` has the features
    /// that it broadcast for lower hops: in this step if the robots step together, otherwise in its newest message.
    fn relay(&mut self, _hop: usize, _own: &Observation, _features: &mut [f32], _neighbours: &[Neighbour]) {}

    /// Returns the robot's wanted velocity \[m/s\], policy frame. One that is not finite ends the episode for the whole
    /// team; a step that has failed is told by `broadcast`. `own` is the robot's own state and goal, and `features` are
    /// those that `encode` and `relay` have just written for the same step.
    ///
    /// `neighbours` has the last message of each neighbour in range, in the order of robot ids; it may be empty.
    /// `stream` is the source of random numbers for a policy that samples its actions.
    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2;

    /// Returns the robot's broadcast in the present step; the Agent asks after `encode` and after `act`. The default is
    /// [`Broadcast::Encoded`], for a policy whose steps do not fail and which broadcasts before it acts.
    fn broadcast(&self) -> Broadcast<'_> {
        Broadcast::Encoded
    }
}

/// Broadcast of a robot in one step of its policy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Broadcast<'a> {
    /// Floats that `Policy::encode` and `Policy::relay` have written.
    Encoded,
    /// Floats that `Policy::act` has computed together with its action, for other hosts. Robots of the same Agent get
    /// them in the next step, when `encode` has written them: as late as robots of other Agents do.
    Computed(&'a [f32]),
    /// None, as in the first step of a policy that computes its broadcast together with its action.
    Nothing,
    /// None, because the step has failed. It counts as none: the robot stands, and the state is that before the step.
    Failed,
}

/// Method of drawing an action from the probability distribution that a trained policy's network outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Draw {
    /// The action is the mean of the distribution.
    Mean,
    /// The action is a random sample of the distribution.
    Sample,
}

/// Registry entry of a policy: its name and its constructor.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name by which a user selects the policy, on the command line (`--policy`) and in team files.
    pub name: &'static str,
    /// Description of the policy in one line, for the program's help text.
    pub about: &'static str,
    /// Constructor of the policy for a scenario (a task for a robot team). An error says that the policy does not exist
    /// for the scenario or refuses it.
    pub build: fn(&dyn Scenario) -> Result<Model, ModelError>,
}

/// Name of the trained policy that is built into the program; it is the default in a scenario for which one was
/// trained.
pub(crate) const SHIPPED: &str = "shipped";
/// Name of scripted navigation by optimal reciprocal collision avoidance (ORCA), a policy without training that works
/// in every scenario with goals.
pub(crate) const SCRIPTED: &str = "orca";

/// The policies of this crate that a user selects by name; all other policies are loaded from files.
pub const REGISTRY: &[Entry] = &[
    Entry {
        name: SHIPPED,
        about: "trained for the scenario, for delay, loss, lag, teams of many sizes and the safety filter",
        build: |scenario| Model::shipped(scenario.name()),
    },
    Entry {
        name: "robust",
        about: "trained for the scenario, for delay, loss and lag, in teams of up to five ('shipped' before)",
        build: |scenario| Model::built_in("robust", scenario.name()),
    },
    Entry {
        name: "published",
        about: "trained for the scenario, for the paper's own conditions",
        build: |scenario| Model::built_in("published", scenario.name()),
    },
    Entry {
        name: "any-size",
        about: "a former name of 'shipped'",
        build: |scenario| Model::built_in("any-size", scenario.name()),
    },
    Entry { name: SCRIPTED, about: "scripted navigation by message passing", build: orca },
    Entry {
        name: claim::NAME,
        about: "scripted navigation to goals that robots claim by messages (for unlabelled goals)",
        build: claim::model,
    },
    Entry {
        name: flock::GLOBAL,
        about: "scripted flocking; each robot knows all others (for scenarios without goals)",
        build: |scenario| flock::model(scenario, flock::Sight::All),
    },
    Entry {
        name: flock::LOCAL,
        about: "scripted flocking; each robot knows its neighbours within 2 m (for scenarios without goals)",
        build: |scenario| flock::model(scenario, flock::Sight::Near),
    },
];

/// Makes scripted navigation; an error says that the scenario has no goals.
fn orca(scenario: &dyn Scenario) -> Result<Model, ModelError> {
    match scenario.cost() {
        None => Ok(Model::Orca),
        Some(_) => {
            let name = scenario.name();
            Err(ModelError::Refused(format!(
                "the scenario '{name}' has no goals to navigate to; use '{}'",
                flock::LOCAL
            )))
        }
    }
}

/// Returns the name of the scripted policy of this crate that works in `scenario` with what a robot hears.
pub fn scripted(scenario: &dyn Scenario) -> &'static str {
    match scenario.cost() {
        Some(_) => flock::LOCAL,
        None if scenario.goals().are_unlabelled() => claim::NAME,
        None => SCRIPTED,
    }
}

/// Returns a network with random weights, for tests and benchmarks, of the architecture published with the paper arXiv
/// 2111.01777. The weights are uniform and scaled by the width of each layer's input; the same `seed` gives the same
/// weights.
pub fn untrained(seed: u64) -> Model {
    random_model(&Manifest::published(), seed)
}

/// Returns a network with random weights, for tests and benchmarks. It has the full architecture of equation (1) in the
/// paper, with edge features. The same `seed` gives the same weights.
pub fn untrained_full(seed: u64) -> Model {
    random_model(&Manifest::full(), seed)
}

fn random_model(manifest: &Manifest, seed: u64) -> Model {
    let bytes = weights::write(manifest, &random_tensors(manifest, seed));
    let file = file::read(&bytes).expect("a file that was just written can be read");
    Model::Gnn(Arc::new(gnn::GnnWeights::new(file)), Draw::Sample)
}

fn random_tensors(manifest: &Manifest, seed: u64) -> weights::Tensors {
    let mut stream = Seed::of_run(seed).stream("policy/untrained");
    [&manifest.encoder, &manifest.message, &manifest.update].map(|widths| {
        let pairs = widths.windows(2).map(|pair| {
            let bound = 1.0 / (pair[0] as f32).sqrt();
            let mut floats =
                |count: usize| (0..count).map(|_| stream.random_range(-bound..bound)).collect::<Vec<f32>>();
            (floats(pair[0] * pair[1]), floats(pair[1]))
        });
        pairs.collect()
    })
}
