//! Policies: what a robot says to its neighbours, and how it moves on what it hears. A policy is one file
//! and one line in `REGISTRY`; in a crate of one's own, one line where its `Registry` is made.
//!
//! A policy sees the policy frame only. Nothing in this folder knows that there is a network, an actor or a
//! clock.

pub mod gnn;
pub mod manifest;
pub mod mlp;
mod model;
pub mod orca;
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

/// One neighbour as a policy sees it, in the policy frame.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour<'a> {
    /// The neighbour's own estimate when it spoke.
    pub motion: Motion,
    /// What it said.
    pub features: &'a [f32],
    /// How old that is.
    pub age: Span,
}

/// What the rest of the system has to know of a policy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interface {
    /// How many floats a robot broadcasts.
    pub features: usize,
    /// How far a robot hears \[m\].
    pub radius_m: f32,
    /// How often a robot acts.
    pub period: Span,
    /// Largest wanted speed along each axis \[m/s\].
    pub limit_m_s: f32,
    /// How long a neighbour's message is of use.
    pub hold: Span,
}

/// A message-passing policy: one robot's part of it. It may keep scratch space, but no memory of the past.
pub trait Policy {
    /// What the rest of the system has to know.
    fn interface(&self) -> Interface;

    /// Writes what the robot broadcasts; `features` is as long as the interface says.
    fn encode(&mut self, own: &Observation, features: &mut [f32]);

    /// The wanted velocity \[m/s\]. `features` are those just encoded; neighbours come in the order of their
    /// ids, and their features are as long as the interface says.
    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2;
}

/// How actions are drawn from a policy's distribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Draw {
    /// The mean.
    Mean,
    /// A sample.
    Sample,
}

/// A policy by name.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name on the command line and in team files.
    pub name: &'static str,
    /// One line for the help.
    pub about: &'static str,
    /// Makes it for a scenario.
    pub build: fn(&dyn Scenario) -> Result<Model, ModelError>,
}

/// The name of the policy that a scenario has unless someone says otherwise, where it has one.
pub const SHIPPED: &str = "shipped";
/// The name of scripted navigation, which every scenario has.
pub const SCRIPTED: &str = "orca";

/// All policies that have a name; trained ones are files beside.
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

/// A network of the published layout with random weights (uniform, scaled by the width of the input): as
/// good as noise, but the same for the same seed. For tests and benchmarks.
pub fn untrained(seed: u64) -> Model {
    noise(&Manifest::published(), seed)
}

/// The same for the paper's equation (1) in full.
pub fn untrained_full(seed: u64) -> Model {
    noise(&Manifest::full(), seed)
}

fn noise(manifest: &Manifest, seed: u64) -> Model {
    let bytes = weights::write(manifest, &random_tensors(manifest, seed));
    let file = weights::read(&bytes).expect("a file that was just written can be read");
    Model::Gnn(Arc::new(gnn::Network::new(file)), Draw::Sample)
}

fn random_tensors(manifest: &Manifest, seed: u64) -> weights::Tensors {
    let mut stream = Seed::of_run(seed).stream("policy/untrained");
    [&manifest.encoder, &manifest.message, &manifest.update].map(|widths| {
        let pairs = widths.windows(2).map(|pair| {
            let reach = 1.0 / (pair[0] as f32).sqrt();
            let mut floats =
                |count: usize| (0..count).map(|_| stream.random_range(-reach..reach)).collect::<Vec<f32>>();
            (floats(pair[0] * pair[1]), floats(pair[1]))
        });
        pairs.collect()
    })
}
