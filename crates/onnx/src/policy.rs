//! Policy of one robot from graphs: makes the inputs of each call, checks them and the outputs, and keeps the state.
//!
//! A call with a value that is not finite is never made, since engines turn such values into ordinary ones. A step that
//! fails counts as none: the robot stands, and its state and its message stay those of the step before.

use std::sync::Arc;

use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{Form, MAX_FEATURE};
use murmurate::observation::Observation;
use murmurate::policy::failures::Failures;
use murmurate::policy::{Broadcast, Draw, Interface, Model, Neighbour, Origin, Policy};
use murmurate::random::Stream;
use murmurate::time::Span;

use crate::contract::{Contract, Distribution, Kind, Pad};
use crate::engine::{Array, Engine};
use crate::features;
use crate::memory::Memory;
use crate::network::{Graph, Network, Output, Source};
use crate::structure::Role;

/// Policy of one robot.
pub(crate) struct Robot {
    network: Arc<Network>,
    /// Engine of each graph, as the thread of the robot uses it.
    engines: Vec<Arc<dyn Engine>>,
    robot: RobotId,
    draw: Draw,
    /// Memory after the last step that succeeded.
    memory: Memory,
    /// Memory before the last step, whether it succeeded or not.
    before: Memory,
    /// State after `encode` of the present step.
    encoded: Vec<f32>,
    /// Inputs of the graphs, kept for the next call.
    arrays: Vec<Vec<Array>>,
    /// Indices of the neighbours in the call.
    chosen: Vec<usize>,
    /// Progress of the present step.
    progress: Progress,
    failures: Failures,
}

/// Progress of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    Encoded,
    Acted,
    Failed,
}

impl Robot {
    /// Creates the policy of `robot` at its start.
    pub(crate) fn new(network: Arc<Network>, robot: RobotId, draw: Draw) -> Robot {
        let empty = || Array { shape: Vec::new(), values: Vec::new() };
        let arrays = network.graphs.iter().map(|graph| graph.inputs.iter().map(|_| empty()).collect()).collect();
        let (message, state) = (network.contract.message.floats, network.contract.state_floats());
        let own = |graph: &Graph| graph.engine.of_thread().unwrap_or_else(|| Arc::clone(&graph.engine));
        Robot {
            engines: network.graphs.iter().map(own).collect(),
            network,
            robot,
            draw,
            memory: Memory::new(message, state),
            before: Memory::new(message, state),
            encoded: vec![0.0; state],
            arrays,
            chosen: Vec::new(),
            progress: Progress::Encoded,
            failures: Failures::new(robot),
        }
    }

    /// Returns whether one graph computes a whole step, so that the message of a step is heard in the next one.
    fn is_one_graph(&self) -> bool {
        self.network.graphs[0].role == Role::Step
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

    /// Makes the inputs of the graph number `at`. `message` is the robot's own message as an input. Fails if one is not
    /// finite.
    fn fill(&mut self, at: usize, own: &Observation, message: &[f32], neighbours: &[Neighbour]) -> Result<(), String> {
        let Network { contract, graphs, .. } = &*self.network;
        let graph = &graphs[at];
        let state = if matches!(graph.role, Role::Relay | Role::Act) { &self.encoded } else { &self.memory.state };
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
                Source::OwnMessage | Source::State => {
                    let row = if *source == Source::State { state } else { message };
                    shape.extend([1, row.len()]);
                    values.extend_from_slice(row);
                }
                Source::Id(floats) => {
                    shape.extend([1, *floats]);
                    values.resize(*floats, 0.0);
                    let robots = contract.robots.as_ref().expect("a graph with an id has a table of robots");
                    robots.write(self.robot, values)?;
                }
            }
            if !values.iter().all(|value| value.is_finite()) {
                return Err(unknown(contract, name));
            }
        }
        Ok(())
    }

    /// Runs the graph number `at`, and returns its outputs. `message` is the robot's own message as an input.
    fn call(
        &mut self,
        at: usize,
        own: &Observation,
        message: &[f32],
        neighbours: &[Neighbour],
    ) -> Result<Vec<Array>, String> {
        let outputs = match self.engines[at].answer(self.robot) {
            Some(outputs) => outputs?,
            None => {
                self.fill(at, own, message, neighbours)?;
                self.engines[at].run(&self.arrays[at])?
            }
        };
        let graph = &self.network.graphs[at];
        for ((name, output, floats), array) in graph.outputs.iter().zip(&outputs) {
            if array.shape != [1, *floats] {
                return Err(format!("its output '{name}' has the shape {:?}, not [1, {floats}]", array.shape));
            }
            let most = if *output == Output::Message { MAX_FEATURE } else { f32::MAX };
            if !array.values.iter().all(|value| value.abs() <= most) {
                return Err(format!("its output '{name}' is not finite, or above {most:e}"));
            }
        }
        Ok(outputs)
    }

    /// Returns the output of the graph number `at` that is `what`; `None` if it has none.
    fn pick<'a>(&self, at: usize, outputs: &'a [Array], what: Output) -> Option<&'a [f32]> {
        let index = self.network.graphs[at].outputs.iter().position(|(_, output, _)| *output == what)?;
        Some(&outputs[index].values)
    }

    /// Notes that the step has failed; the log has the reason `why` once.
    fn fail(&mut self, why: &str) {
        // Robots of the same Agent would hear the message of an older step as if it were new.
        (self.progress, self.memory.is_new) = (Progress::Failed, false);
        self.failures.fail(&self.network.contract.name, why);
    }

    fn encoded_message(&mut self, own: &Observation) -> Result<Vec<f32>, String> {
        let outputs = self.call(0, own, &[], &[])?;
        let message = self.pick(0, &outputs, Output::Message).expect("a graph 'encode' has a message").to_vec();
        self.encoded.clear();
        match self.pick(0, &outputs, Output::State) {
            Some(state) => self.encoded.extend_from_slice(state),
            None => self.encoded.extend_from_slice(&self.memory.state),
        }
        Ok(message)
    }

    /// Computes the message for the hop `hop` from what the neighbours broadcast for the hop before.
    fn relayed(
        &mut self,
        hop: usize,
        own: &Observation,
        message: &[f32],
        neighbours: &[Neighbour],
    ) -> Result<Vec<f32>, String> {
        self.choose(&own.motion, neighbours);
        let outputs = self.call(hop, own, message, neighbours)?;
        Ok(self.pick(hop, &outputs, Output::Message).expect("a graph 'relay' has a message").to_vec())
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
            let why = "its action needs the heading of the robot, which is not known, or its deviation is too large";
            return Err(why.to_owned());
        }
        if let Some(message) = self.pick(at, &outputs, Output::Message) {
            self.memory.message.copy_from_slice(message);
            self.memory.is_new = true;
        }
        if let Some(state) = self.pick(at, &outputs, Output::State) {
            self.memory.state.copy_from_slice(state);
        }
        self.failures.succeed();
        Ok(velocity)
    }
}

/// Says why an input of a graph has a value that is not finite.
fn unknown(contract: &Contract, name: &str) -> String {
    let observed = contract.observation.get(name);
    match observed.and_then(|observed| observed.stale_after_s) {
        Some(limit_s) => format!(
            "its sense '{name}' has no values that are younger than stale_after_s = {limit_s}, or its heading is not \
             known"
        ),
        None => format!("its input '{name}' is not known or not finite"),
    }
}

impl Policy for Robot {
    fn interface(&self) -> Interface {
        self.network.interface
    }

    fn reset(&mut self, seed: u64) {
        self.memory = Memory::new(self.memory.message.len(), self.memory.state.len());
        self.before.copy(&self.memory);
        if let Some(engine) = self.engines.first() {
            engine.reset(self.robot, seed);
        }
    }

    fn undo(&mut self) {
        self.memory.copy(&self.before);
    }

    fn forgets_after(&self) -> Option<Span> {
        self.network.contract.state.map(|state| Span::from_secs(state.after_gap_s))
    }

    fn memory(&self) -> Option<&[f32]> {
        self.network.contract.state.map(|_| &*self.memory.state)
    }

    fn form(&self) -> Form {
        self.network.contract.message.form()
    }

    fn is_joint(&self) -> bool {
        self.engines[0].is_joint()
    }

    // Without a waiting call the step makes its inputs itself, and fails by the one that is not finite.
    fn prepare_encode(&mut self, own: &Observation) {
        if !self.is_one_graph() && self.fill(0, own, &[], &[]).is_ok() {
            self.engines[0].ask(self.robot, &self.arrays[0]);
        }
    }

    fn prepare_act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour]) {
        self.choose(&own.motion, neighbours);
        let at = self.engines.len() - 1;
        if self.fill(at, own, features, neighbours).is_ok() {
            self.engines[at].ask(self.robot, &self.arrays[at]);
        }
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        self.before.copy(&self.memory);
        self.progress = Progress::Encoded;
        if self.is_one_graph() {
            features.copy_from_slice(&self.memory.message);
            return;
        }
        match self.encoded_message(own) {
            Ok(message) => features.copy_from_slice(&message),
            Err(why) => self.fail(&why),
        }
    }

    fn hops(&self) -> usize {
        1 + self.network.contract.relay.len()
    }

    fn relay(&mut self, hop: usize, own: &Observation, features: &mut [f32], neighbours: &[Neighbour]) {
        if self.progress == Progress::Failed {
            return;
        }
        match self.relayed(hop, own, features, neighbours) {
            Ok(message) => features.copy_from_slice(&message),
            Err(why) => self.fail(&why),
        }
    }

    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2 {
        if self.progress == Progress::Failed {
            // A hop of the step has failed.
            return Vec2::zeros();
        }
        match self.velocity(own, features, neighbours, stream) {
            Ok(velocity) => {
                self.progress = Progress::Acted;
                velocity
            }
            Err(why) => {
                self.fail(&why);
                Vec2::zeros()
            }
        }
    }

    fn broadcast(&self) -> Broadcast<'_> {
        match self.progress {
            Progress::Failed => Broadcast::Failed,
            Progress::Acted if self.is_one_graph() => Broadcast::Computed(&self.memory.message),
            // Without a message its motion is all that its neighbours use.
            Progress::Encoded if self.is_one_graph() && !self.memory.is_new && !self.memory.message.is_empty() => {
                Broadcast::Nothing
            }
            Progress::Encoded | Progress::Acted => Broadcast::Encoded,
        }
    }
}

impl Network {
    /// Returns the policy of `robot` at its start.
    pub fn robot(self: &Arc<Network>, robot: RobotId, draw: Draw) -> impl Policy + use<> {
        Robot::new(Arc::clone(self), robot, draw)
    }

    /// Returns the model of a team whose robots all have this policy. Actions of a distribution are its mean, unless
    /// the user asks for samples.
    pub fn model(self: Arc<Network>) -> Model {
        let origin = Origin {
            digest: self.digest.clone(),
            requests: self.contract.requests(),
            engine: self.engine.clone(),
            apart: true,
            form: self.contract.message.form(),
            message: self.contract.message.name.clone().unwrap_or_default(),
            turns: self.contract.action.kind == Kind::Twist,
            most_robots: self.most_robots,
        };
        let draw = (self.contract.action.distribution != Distribution::None).then_some(Draw::Mean);
        let interface = self.interface;
        let instance =
            move |_: &_, robot, draw| Box::new(Robot::new(Arc::clone(&self), robot, draw)) as Box<dyn Policy>;
        Model::of_file(("onnx", interface), origin, draw, instance).expect("a contract checks its interface")
    }
}
