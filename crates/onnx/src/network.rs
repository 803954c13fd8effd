//! Network of a policy, which all robots of a team share: its graphs, the meaning of their inputs and outputs, and what
//! an action stands for.

use std::ops::Range;
use std::sync::Arc;

use murmurate::messages::geometry::Vec2;
use murmurate::observation::Observation;
use murmurate::policy::{Draw, Interface};
use murmurate::random::{self, Stream};

use crate::contract::{Contract, Distribution, Kind};
use crate::engine::{self, Engine};
use crate::parts::{GraphFile, Parts, Refused};
use crate::structure::Role;

/// Meaning of an input of a graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    /// Observation: its range within the values of all channels, and its shape.
    Observation(Range<usize>, Vec<usize>),
    /// Messages of the neighbours.
    Messages,
    /// Features of the edges to the neighbours.
    Edges,
    /// 1 for each place with a neighbour, 0 for an empty one.
    Heard,
    /// Message of the robot itself: that of this step after `encode`, and of the step before in a whole step.
    OwnMessage,
    /// State.
    State,
}

/// Meaning of an output of a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Output {
    /// Action.
    Action,
    /// Message for the neighbours.
    Message,
    /// State for the next step.
    State,
}

/// Graph that is ready to run, with the meaning of its inputs and outputs.
pub(crate) struct Graph {
    pub(crate) role: Role,
    pub(crate) engine: Arc<dyn Engine>,
    pub(crate) inputs: Vec<(String, Source)>,
    pub(crate) outputs: Vec<(&'static str, Output, usize)>,
}

/// Network of a policy, which all robots of a team share: its contract and its graphs.
pub struct Network {
    pub(crate) contract: Contract,
    pub(crate) graphs: Vec<Graph>,
    pub(crate) interface: Interface,
    pub(crate) digest: String,
}

impl std::fmt::Debug for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Network").field("contract", &self.contract).finish_non_exhaustive()
    }
}

impl Network {
    /// Loads the graphs of a policy into the engine of this program. Fails if contract and graphs do not agree, or if
    /// the engine cannot load a graph. [`crate::check::check`] then runs it on made-up inputs.
    pub fn load(parts: Parts) -> Result<Network, Refused> {
        let Parts { contract, graphs: files, digest } = parts;
        let mut graphs = Vec::new();
        let mut missing: Vec<&String> = contract.observation.keys().collect();
        for GraphFile { role, structure, bytes } in files {
            structure.check(&contract, role)?;
            missing.retain(|name| structure.inputs.iter().all(|port| port.name != **name));
            let inputs: Vec<String> = structure.inputs.iter().map(|port| port.name.clone()).collect();
            let expected = structure.expected_outputs(&contract, role);
            let names: Vec<String> = expected.iter().map(|(name, _)| (*name).to_owned()).collect();
            let engine = engine::load(bytes, &inputs, &names)
                .map_err(|why| Refused::Disagree(format!("its {}: {why}", role.field())))?;
            let inputs = inputs.into_iter().map(|name| (name.clone(), source(&contract, &name))).collect();
            let outputs = expected.into_iter().map(|(name, floats)| (name, output(name), floats)).collect();
            graphs.push(Graph { role, engine, inputs, outputs });
        }
        if let Some(name) = missing.first() {
            let why = format!("its contract has an observation '{name}', and no graph has an input of that name");
            return Err(Refused::Disagree(why));
        }
        let interface = contract.interface();
        Ok(Network { contract, graphs, interface, digest })
    }

    /// Returns the contract of the policy.
    pub fn contract(&self) -> &Contract {
        &self.contract
    }

    /// Returns the digest of contract and graphs: the first 64 bits of a BLAKE3 hash, as hexadecimal digits.
    pub fn digest(&self) -> &str {
        &self.digest
    }
}

/// Returns the meaning of the input called `name`. The structure was checked, so every name is known.
fn source(contract: &Contract, name: &str) -> Source {
    match name {
        "messages" => Source::Messages,
        "edges" => Source::Edges,
        "heard" => Source::Heard,
        "own_message" => Source::OwnMessage,
        "state" => Source::State,
        _ => {
            let mut begins = 0;
            for request in contract.requests() {
                let ends = begins + request.floats();
                if request.input == name {
                    return Source::Observation(begins..ends, request.shape);
                }
                begins = ends;
            }
            unreachable!("the structure of the graph was checked against the contract")
        }
    }
}

/// Returns the meaning of the output called `name`.
fn output(name: &str) -> Output {
    match name {
        "action" => Output::Action,
        "message" => Output::Message,
        _ => Output::State,
    }
}

impl Network {
    /// Returns the velocity \[m/s\] in the policy frame that an output `action` stands for.
    pub(crate) fn commanded(&self, own: &Observation, action: &[f32], draw: Draw, stream: &mut Stream) -> Vec2 {
        let said = &self.contract.action;
        if said.kind == Kind::Choice {
            let largest =
                action.iter().enumerate().fold(0, |best, (at, value)| if *value > action[best] { at } else { best });
            return own.out_of_frame(said.frame, Vec2::from(said.choices[largest]));
        }
        let mean = Vec2::new(action[0], action[1]);
        let drawn = match (said.distribution, draw) {
            (Distribution::DiagonalNormal, Draw::Sample) => {
                let [x, y] = random::normals(stream);
                let deviation = Vec2::new(libm::expf(action[2]), libm::expf(action[3]));
                mean + deviation.component_mul(&Vec2::new(x as f32, y as f32))
            }
            _ => mean,
        };
        if !(drawn.x.is_finite() && drawn.y.is_finite()) {
            // Clamped, it would be full speed.
            return Vec2::repeat(f32::NAN);
        }
        let limit = said.limit.expect("a contract has a limit for all but choices");
        match said.kind {
            Kind::Twist => {
                let (speed, yaw_rate) = (drawn.x.clamp(-limit, limit), drawn.y);
                let ahead = Vec2::new(speed, yaw_rate * own.dynamics.point_ahead_m);
                own.out_of_frame(said.frame, ahead)
            }
            kind => {
                let clamped = drawn.map(|axis| axis.clamp(-limit, limit));
                let turned = own.out_of_frame(said.frame, clamped);
                match kind {
                    Kind::Acceleration => own.motion.velocity + turned * self.interface.period.as_secs() as f32,
                    _ => turned,
                }
            }
        }
    }
}
