//! Policy of one robot from graphs: makes the inputs of each call, checks them and the outputs, and keeps the state.
//!
//! A call with a value that is not finite is never made, since engines turn such values into ordinary ones. A step that
//! fails counts as none: the robot stands, and its state and its message stay those of the step before.

use std::ops::Range;
use std::sync::Arc;

use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::wire::MAX_FEATURE;
use murmurate::observation::Observation;
use murmurate::policy::{Draw, Interface, Model, Neighbour, Origin, Policy};
use murmurate::random::{self, Stream};
use murmurate::time::Span;

use crate::contract::{Contract, Distribution, Kind, Pad};
use crate::engine::{self, Array, Engine};
use crate::features;
use crate::parts::{Parts, Refused};
use crate::structure::{Role, Structure};

/// What an input of a graph is.
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

/// What an output of a graph is.
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
    interface: Interface,
    digest: String,
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
        for (role, bytes) in files {
            let structure = Structure::read(&bytes)?;
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

    /// Returns a policy of one robot at its start.
    pub fn robot(self: &Arc<Network>, draw: Draw) -> impl Policy + use<> {
        Robot::new(Arc::clone(self), draw)
    }

    /// Returns the model of a team whose robots all have this policy. Actions of a distribution are its mean, unless
    /// the user asks for samples.
    pub fn model(self: Arc<Network>) -> Model {
        let origin = Origin {
            digest: self.digest.clone(),
            requests: self.contract.requests(),
            turns: self.contract.action.kind == Kind::Twist,
        };
        let draw = (self.contract.action.distribution != Distribution::None).then_some(Draw::Mean);
        let interface = self.interface;
        let instance = move |_: &_, draw| Box::new(Robot::new(Arc::clone(&self), draw)) as Box<dyn Policy>;
        Model::of_file(("onnx", interface), origin, draw, instance).expect("a contract checks its interface")
    }
}

/// Returns what the input called `name` is. The structure was checked, so every name is known.
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

/// Returns what the output called `name` is.
fn output(name: &str) -> Output {
    match name {
        "action" => Output::Action,
        "message" => Output::Message,
        _ => Output::State,
    }
}

/// Policy of one robot.
struct Robot {
    network: Arc<Network>,
    draw: Draw,
    /// Message of the last step that succeeded; zeros at the start.
    message: Vec<f32>,
    /// State after the last step that succeeded; zeros at the start.
    state: Vec<f32>,
    /// State after `encode` of the present step.
    encoded: Vec<f32>,
    /// Inputs of the graphs, kept for the next call.
    arrays: Vec<Vec<Array>>,
    /// Indices of the neighbours in the call.
    chosen: Vec<usize>,
    /// Whether the log has said why a step has failed, since the last one that succeeded.
    reported: bool,
}

impl Robot {
    fn new(network: Arc<Network>, draw: Draw) -> Robot {
        let empty = || Array { shape: Vec::new(), values: Vec::new() };
        let arrays = network.graphs.iter().map(|graph| graph.inputs.iter().map(|_| empty()).collect()).collect();
        let (message, state) = (network.contract.message.floats, network.contract.state_floats());
        Robot {
            network,
            draw,
            message: vec![0.0; message],
            state: vec![0.0; state],
            encoded: vec![0.0; state],
            arrays,
            chosen: Vec::new(),
            reported: false,
        }
    }

    /// Chooses the neighbours of a call: the nearest ones, in the order of the robots' ids.
    fn choose(&mut self, own: &Motion, neighbours: &[Neighbour]) {
        let most = self.network.contract.max_neighbours;
        self.chosen.clear();
        self.chosen.extend(0..neighbours.len());
        if neighbours.len() > most {
            let distance = |at: &usize| (neighbours[*at].motion.position - own.position).norm_squared();
            self.chosen.sort_by(|one, other| distance(one).total_cmp(&distance(other)).then(one.cmp(other)));
            self.chosen.truncate(most);
            self.chosen.sort_unstable();
        }
    }

    /// Runs the graph number `at`, and returns its outputs. `message` is the robot's own message as an input.
    fn call(
        &mut self,
        at: usize,
        own: &Observation,
        message: &[f32],
        neighbours: &[Neighbour],
    ) -> Result<Vec<Array>, String> {
        let Network { contract, graphs, .. } = &*self.network;
        let graph = &graphs[at];
        let state = if graph.role == Role::Act { &self.encoded } else { &self.state };
        let heard = self.chosen.len();
        let places = if contract.pad == Pad::Max { contract.max_neighbours } else { heard.max(1) };
        for ((name, source), array) in graph.inputs.iter().zip(&mut self.arrays[at]) {
            let Array { shape, values } = array;
            shape.clear();
            values.clear();
            match source {
                Source::Observation(range, axes) => {
                    shape.push(1);
                    shape.extend_from_slice(axes);
                    values.extend_from_slice(&own.values[range.clone()]);
                }
                Source::Messages => {
                    let floats = contract.message.floats;
                    shape.extend([1, places, floats]);
                    self.chosen.iter().for_each(|&at| values.extend_from_slice(neighbours[at].features));
                    values.resize(places * floats, 0.0);
                }
                Source::Edges => {
                    let floats = contract.edge_floats();
                    shape.extend([1, places, floats]);
                    values.resize(places * floats, 0.0);
                    let edges = contract.edges.as_ref().expect("a graph with edges has them in its contract");
                    for (&at, edge) in self.chosen.iter().zip(values.chunks_exact_mut(floats)) {
                        features::write(edges, own, &neighbours[at], edge);
                    }
                }
                Source::Heard => {
                    shape.extend([1, places]);
                    values.resize(heard, 1.0);
                    values.resize(places, 0.0);
                }
                Source::OwnMessage => {
                    shape.extend([1, message.len()]);
                    values.extend_from_slice(message);
                }
                Source::State => {
                    shape.extend([1, state.len()]);
                    values.extend_from_slice(state);
                }
            }
            if !values.iter().all(|value| value.is_finite()) {
                return Err(format!("its input '{name}' is not known or not finite"));
            }
        }
        let outputs = graph.engine.run(&self.arrays[at])?;
        for ((name, _, floats), array) in graph.outputs.iter().zip(&outputs) {
            if array.shape != [1, *floats] {
                return Err(format!("its output '{name}' has the shape {:?}, not [1, {floats}]", array.shape));
            }
            if !array.values.iter().all(|value| value.abs() <= MAX_FEATURE) {
                return Err(format!("its output '{name}' is not finite, or above {MAX_FEATURE:e}"));
            }
        }
        Ok(outputs)
    }

    /// Returns the output of the graph number `at` that is `what`; `None` if it has none.
    fn pick<'a>(&self, at: usize, outputs: &'a [Array], what: Output) -> Option<&'a [f32]> {
        let index = self.network.graphs[at].outputs.iter().position(|(_, output, _)| *output == what)?;
        Some(&outputs[index].values)
    }

    /// Says once in the log that a step has failed, and why.
    fn failed(&mut self, why: &str) {
        if !self.reported {
            let policy = &self.network.contract.name;
            tracing::error!(policy, why, "a step of the policy failed; its robot stands until one succeeds");
            self.reported = true;
        }
    }

    fn encoded_message(&mut self, own: &Observation) -> Result<Vec<f32>, String> {
        let outputs = self.call(0, own, &[], &[])?;
        let message = self.pick(0, &outputs, Output::Message).expect("a graph 'encode' has a message").to_vec();
        self.encoded.clear();
        match self.pick(0, &outputs, Output::State) {
            Some(state) => self.encoded.extend_from_slice(state),
            None => self.encoded.extend_from_slice(&self.state),
        }
        Ok(message)
    }

    fn velocity(
        &mut self,
        own: &Observation,
        message: &[f32],
        neighbours: &[Neighbour],
        stream: &mut Stream,
    ) -> Result<Vec2, String> {
        self.choose(&own.motion, neighbours);
        let at = self.network.graphs.len() - 1;
        let outputs = self.call(at, own, message, neighbours)?;
        let action = self.pick(at, &outputs, Output::Action).expect("the last graph has an action");
        let velocity = self.network.commanded(own, action, self.draw, stream);
        if !(velocity.x.is_finite() && velocity.y.is_finite()) {
            return Err("its action needs the heading of the robot, which is not known".to_owned());
        }
        if let Some(message) = self.pick(at, &outputs, Output::Message) {
            self.message.copy_from_slice(message);
        }
        if let Some(state) = self.pick(at, &outputs, Output::State) {
            self.state.copy_from_slice(state);
        }
        self.reported = false;
        Ok(velocity)
    }
}

impl Network {
    /// Returns the velocity \[m/s\] in the policy frame that an output `action` stands for.
    fn commanded(&self, own: &Observation, action: &[f32], draw: Draw, stream: &mut Stream) -> Vec2 {
        let said = &self.contract.action;
        if said.kind == Kind::Choice {
            let largest =
                action.iter().enumerate().fold(0, |best, (at, value)| if *value > action[best] { at } else { best });
            return features::out_of_frame(own, said.frame, Vec2::from(said.choices[largest]));
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
        let limit = said.limit.expect("a contract has a limit for all but choices");
        match said.kind {
            Kind::Twist => {
                let (speed, yaw_rate) = (drawn.x.clamp(-limit, limit), drawn.y);
                let ahead = Vec2::new(speed, yaw_rate * own.dynamics.point_ahead_m);
                features::out_of_frame(own, said.frame, ahead)
            }
            kind => {
                let clamped = drawn.map(|axis| axis.clamp(-limit, limit));
                let turned = features::out_of_frame(own, said.frame, clamped);
                match kind {
                    Kind::Acceleration => own.motion.velocity + turned * self.interface.period.as_secs() as f32,
                    _ => turned,
                }
            }
        }
    }
}

impl Policy for Robot {
    fn interface(&self) -> Interface {
        self.network.interface
    }

    fn reset(&mut self) {
        [&mut self.message, &mut self.state, &mut self.encoded].into_iter().for_each(|floats| floats.fill(0.0));
    }

    fn forgets_after(&self) -> Option<Span> {
        self.network.contract.state.map(|state| Span::from_secs(state.after_gap_s))
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        if self.network.graphs[0].role == Role::Step {
            features.copy_from_slice(&self.message);
            return;
        }
        match self.encoded_message(own) {
            Ok(message) => features.copy_from_slice(&message),
            Err(why) => {
                self.failed(&why);
                // Neither is sent, and the robot stands.
                features.fill(f32::NAN);
            }
        }
    }

    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2 {
        match self.velocity(own, features, neighbours, stream) {
            Ok(velocity) => velocity,
            Err(why) => {
                self.failed(&why);
                Vec2::repeat(f32::NAN)
            }
        }
    }

    fn broadcast(&self) -> Option<&[f32]> {
        (self.network.graphs[0].role == Role::Step).then_some(&self.message)
    }
}
