//! Network of a policy, which all robots of a team share: its graphs, the meaning of their inputs and outputs, and what
//! an action stands for.

use std::ops::Range;
use std::sync::Arc;

use murmurate::messages::geometry::Vec2;
use murmurate::observation::Observation;
use murmurate::policy::{Draw, Interface};
use murmurate::random::{self, Stream};

use crate::contract::{Contract, Distribution, Id, Kind};
use crate::engine::{self, Engine};
use crate::parts::{GraphFile, Parts, Refused};
use crate::structure::Role;

/// Beginning of the name of the engine of a policy in Python.
pub const PYTHON: &str = "Python";

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
    /// Place of the robot in its team, in so many floats.
    Id(usize),
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
    /// Name and version of what computes it, and the kind of processor.
    pub(crate) engine: String,
    /// Number of robots of the largest team that its graphs tell apart; `None` without a bound.
    pub(crate) most_robots: Option<usize>,
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
        let mut of_robots = Vec::new();
        for GraphFile { role, structure, bytes } in files {
            structure.check(&contract, role)?;
            let id_floats = structure.id_floats(&contract)?;
            of_robots.extend(id_floats);
            missing.retain(|name| structure.inputs.iter().all(|port| port.name != **name));
            let inputs: Vec<String> = structure.inputs.iter().map(|port| port.name.clone()).collect();
            let expected = structure.expected_outputs(&contract, role);
            let names: Vec<String> = expected.iter().map(|(name, _)| (*name).to_owned()).collect();
            let engine = engine::load(bytes, &inputs, &names)
                .map_err(|why| Refused::Disagree(format!("its {}: {why}", role.field())))?;
            let inputs = inputs.into_iter().map(|name| (name.clone(), source(&contract, &name, id_floats))).collect();
            let outputs = expected.into_iter().map(|(name, floats)| (name, output(name), floats)).collect();
            graphs.push(Graph { role, engine, inputs, outputs });
        }
        if let Some(name) = missing.first() {
            let why = format!("its contract has an observation '{name}', and no graph has an input of that name");
            return Err(Refused::Disagree(why));
        }
        if contract.robots.is_some() && of_robots.is_empty() {
            let why = "its contract has a table [robots], and no graph has an input 'id'";
            return Err(Refused::Disagree(why.to_owned()));
        }
        let (interface, engine) = (contract.interface(), engine::about());
        let most_robots = most_robots(&contract, of_robots.into_iter().min());
        Ok(Network { contract, graphs, interface, digest, engine, most_robots })
    }

    /// Makes the network of a policy whose steps `engine` computes, such as one in Python: for each role of `roles` it
    /// gets the inputs and outputs, in the order of its arrays. These are all that the contract knows. `digest` is that
    /// of contract and program, and `name` that of the engine in records.
    pub fn of_engine(
        (contract, digest, name): (Contract, String, String),
        roles: &[Role],
        mut engine: impl FnMut(Role, &[Port], &[Port]) -> Arc<dyn Engine>,
    ) -> Network {
        let id_floats = contract.robots.and_then(|robots| robots.floats());
        let graphs = roles.iter().map(|&role| {
            let (inputs, outputs) = ports(&contract, role);
            let engine = engine(role, &inputs, &outputs);
            let inputs =
                inputs.into_iter().map(|port| (port.name.clone(), source(&contract, &port.name, id_floats))).collect();
            let outputs = outputs.iter().map(|port| {
                let what = output(&port.name);
                let name = match what {
                    Output::Action => "action",
                    Output::Message => "message",
                    Output::State => "state_next",
                };
                (name, what, port.axes.iter().product())
            });
            Graph { role, engine, inputs, outputs: outputs.collect() }
        });
        let graphs = graphs.collect();
        let interface = contract.interface();
        let most_robots = most_robots(&contract, id_floats);
        Network { contract, graphs, interface, digest, engine: name, most_robots }
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

/// Input or output of a call of an engine.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Port {
    /// Name of the input or output.
    pub name: String,
    /// Whether the axis of robots is followed by one of places for neighbours.
    pub of_neighbours: bool,
    /// Sizes along the other axes.
    pub axes: Vec<usize>,
}

/// Returns all inputs and outputs that a call of this role has by the contract.
pub fn ports(contract: &Contract, role: Role) -> (Vec<Port>, Vec<Port>) {
    let port = |name: &str, of_neighbours: bool, axes: &[usize]| Port {
        name: name.to_owned(),
        of_neighbours,
        axes: axes.to_vec(),
    };
    let (message, edge, state) = (contract.message.floats, contract.edge_floats(), contract.state_floats());
    let mut inputs: Vec<Port> =
        contract.requests().iter().map(|request| port(&request.input, false, &request.shape)).collect();
    let mut outputs = Vec::new();
    let id = contract.robots.and_then(|robots| robots.floats());
    inputs.extend(id.map(|floats| port("id", false, &[floats])));
    if role != Role::Encode {
        inputs.extend((message > 0).then(|| port("messages", true, &[message])));
        inputs.extend((edge > 0).then(|| port("edges", true, &[edge])));
        inputs.push(port("heard", true, &[]));
        inputs.extend((message > 0).then(|| port("own_message", false, &[message])));
    }
    if matches!(role, Role::Step | Role::Act) {
        outputs.push(port("action", false, &[contract.action_floats()]));
    }
    if role != Role::Act {
        outputs.extend((message > 0).then(|| port("message", false, &[message])));
    }
    inputs.extend((state > 0).then(|| port("state", false, &[state])));
    outputs.extend((state > 0).then(|| port("state_next", false, &[state])));
    (inputs, outputs)
}

/// Returns the number of robots of the largest team that a policy tells apart, whose input `id` has `id_floats` floats.
fn most_robots(contract: &Contract, id_floats: Option<usize>) -> Option<usize> {
    contract.robots.and_then(|robots| if robots.id == Id::OneHot { id_floats } else { robots.most })
}

/// Returns the meaning of the input called `name`; `id` has `id_floats` floats. The structure was checked, so every
/// name is known.
fn source(contract: &Contract, name: &str, id_floats: Option<usize>) -> Source {
    match name {
        "messages" => Source::Messages,
        "edges" => Source::Edges,
        "heard" => Source::Heard,
        "own_message" => Source::OwnMessage,
        "state" => Source::State,
        "id" => Source::Id(id_floats.expect("the structure was checked against the contract")),
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
            return self.velocity(own, own.out_of_frame(said.frame, Vec2::from(said.choices[largest])));
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
            _ => {
                let clamped = drawn.map(|axis| axis.clamp(-limit, limit));
                let turned = own.out_of_frame(said.frame, clamped);
                self.velocity(own, turned)
            }
        }
    }

    /// Returns the velocity \[m/s\] that an action `turned` into the policy frame stands for: itself, or what the robot
    /// has after a period if it is an acceleration.
    fn velocity(&self, own: &Observation, turned: Vec2) -> Vec2 {
        match self.contract.action.accelerates() {
            true => own.motion.velocity + turned * self.interface.period.as_secs() as f32,
            false => turned,
        }
    }
}
