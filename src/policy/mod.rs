//! Policies: a robot's broadcast to its neighbours, and its velocity as a function of their broadcasts.
//!
//! A policy is one file and one line in `REGISTRY`; in another crate, one line where its `Registry` is made. It works
//! in the policy frame only. Nothing in this folder knows that there is a network, an actor or a clock.

pub mod gnn;
pub mod manifest;
pub mod mlp;
mod model;
pub mod orca;
pub mod probe;
pub mod route;
pub mod safetensors;
pub mod shipped;
pub mod weights;

pub use model::{Model, ModelError};

use std::sync::Arc;

use crate::messages::geometry::{Motion, Vec2};
use rand::RngExt;

use self::manifest::Manifest;
use crate::random::{Seed, Stream};
use crate::scenario::{Observation, Scenario};
use crate::time::Span;

/// A neighbour's last message, as input to a policy, in the policy frame.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour<'a> {
    /// The neighbour's estimate of its own motion when it sent the message.
    pub motion: Motion,
    /// The features that it broadcast.
    pub features: &'a [f32],
    /// Time since the message arrived.
    pub age: Span,
}

/// Parameters of a policy that the rest of the system depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interface {
    /// Number of floats that a robot broadcasts.
    pub features: usize,
    /// Communication radius \[m\].
    pub radius_m: f32,
    /// Time between two actions of a robot.
    pub period: Span,
    /// Largest wanted speed along each axis \[m/s\].
    pub limit_m_s: f32,
    /// Age up to which a neighbour's message is used.
    pub hold: Span,
}

/// One robot's instance of a message-passing policy. It may keep scratch space, but no state between steps.
pub trait Policy {
    /// Parameters that the rest of the system depends on.
    fn interface(&self) -> Interface;

    /// Writes the features that the robot broadcasts; `features` has the length that the interface gives.
    fn encode(&mut self, own: &Observation, features: &mut [f32]);

    /// Returns the wanted velocity \[m/s\], policy frame. `features` are those just encoded. Neighbours are in the
    /// order of their ids, with features of the length that the interface gives.
    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2;
}

/// Method by which actions are drawn from a policy's distribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Draw {
    /// The mean of the distribution.
    Mean,
    /// A random sample.
    Sample,
}

/// A registry entry of a policy.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name on the command line and in team files.
    pub name: &'static str,
    /// One line for the help.
    pub about: &'static str,
    /// Makes the policy for a scenario.
    pub build: fn(&dyn Scenario) -> Result<Model, ModelError>,
}

/// Name of the default policy of a scenario that has a trained one.
pub const SHIPPED: &str = "shipped";
/// Name of scripted navigation, which works in every scenario.
pub const SCRIPTED: &str = "orca";

/// The policies of this crate that have a name; others are loaded from files.
pub const REGISTRY: &[Entry] = &[
    Entry {
        name: SHIPPED,
        about: "trained for the scenario, for delay, loss and lag",
        build: |scenario| Model::shipped(scenario.name()),
    },
    Entry {
        name: "published",
        about: "trained for the scenario, for the paper's own conditions",
        build: |scenario| Model::published(scenario.name()),
    },
    Entry { name: SCRIPTED, about: "scripted navigation by message passing", build: |_| Ok(Model::Orca) },
];

/// A network of the published architecture with random weights (uniform, scaled by the width of the input), the same
/// for the same seed. For tests and benchmarks.
pub fn untrained(seed: u64) -> Model {
    random_model(&Manifest::published(), seed)
}

/// A network with random weights of the architecture of the paper's equation (1) in full. For tests and benchmarks.
pub fn untrained_full(seed: u64) -> Model {
    random_model(&Manifest::full(), seed)
}

fn random_model(manifest: &Manifest, seed: u64) -> Model {
    let bytes = weights::write(manifest, &random_tensors(manifest, seed));
    let file = weights::read(&bytes).expect("a file that was just written can be read");
    Model::Gnn(Arc::new(gnn::Network::new(file)), Draw::Sample)
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
