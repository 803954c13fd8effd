//! Batches of recorded graphs as input of a network.
//!
//! A batch of windows of successive graphs is one graph whose edges lead back in time: a node is a robot at a step. So
//! a network over it computes for each node what a robot computed, whatever the ages of its messages.

use super::graphs::{Graphs, Window};
use super::matrix::Real;

/// Order in which the memories of nodes are computed, step by step.
#[derive(Clone, Debug, Default)]
pub struct Scan<T> {
    /// Nodes in the order of their steps in their windows.
    pub order: Vec<u32>,
    /// Index of the first node of each step in `order`, and last the number of nodes.
    pub start: Vec<u32>,
    /// For each node, that of the same robot one step before; from the number of nodes on, rows of `state`.
    pub before: Vec<u32>,
    /// States before the first steps, \[rows, floats\]. The first row is zero: the state at the start of an episode.
    pub state: Vec<T>,
}

/// Batch of graphs as input of a network: the observations (sources) from which messages are made, and the messages
/// (edges) that robots use.
#[derive(Clone, Debug, Default)]
pub struct Batch<T> {
    /// Number of nodes with outputs; they come first.
    pub outputs: usize,
    /// Number of nodes: robots in all graphs.
    pub nodes: usize,
    /// Observations of all sources, \[sources, inputs\], row-major. Those of the nodes come first.
    pub x: Vec<T>,
    /// Role of the robot that has made each observation.
    pub role: Vec<u8>,
    /// Index of each node's first edge in `sender`, and last the number of edges: one entry more than `nodes`.
    pub first: Vec<u32>,
    /// Source of each edge: a row of `x`, or from the number of sources on a row of `recorded`.
    pub sender: Vec<u32>,
    /// Edge features, \[edges, edge inputs\], row-major.
    pub e: Vec<T>,
    /// Recorded inputs of each hop, of messages that were sent before the batch's windows, \[rows, floats\]. They are
    /// constants.
    pub recorded: Vec<Vec<T>>,
    /// Order in which memories are computed; empty without memory.
    pub scan: Scan<T>,
    /// First node of each step of each window.
    node_of: Vec<u32>,
    /// Row of `recorded` for each message that was sent before a window, by window, steps before it and robot.
    late: Vec<u32>,
}

/// Number of steps before a window from which its messages may be.
const LATEST: usize = 256;

/// Numbers of a batch that grow as it is gathered.
struct Position {
    /// Next node.
    node: usize,
    /// Next source that is not the observation of a node.
    extra: usize,
}

impl<T: Real> Batch<T> {
    /// Returns the number of observations from which messages are made; `inputs` is the number of floats in one.
    pub fn sources(&self, inputs: usize) -> usize {
        self.x.len() / inputs
    }

    /// Replaces the content of the batch by the graphs of these windows. Rows of nodes are in the order of the windows,
    /// then of their steps, then of the robots; those with outputs come before the others.
    pub fn gather<'a>(&mut self, windows: impl Iterator<Item = Window<'a>> + Clone) {
        self.x.clear();
        self.role.clear();
        self.first.clear();
        self.sender.clear();
        self.e.clear();
        self.node_of.clear();
        self.late.clear();
        self.recorded.iter_mut().for_each(Vec::clear);
        self.nodes = 0;
        self.node_of.resize(windows.clone().map(|window| window.steps).sum(), 0);
        for outputs in [true, false] {
            let mut at = 0;
            for window in windows.clone() {
                for step in (0..window.steps).filter(|step| window.has_outputs(*step) == outputs) {
                    let graphs = window.graphs;
                    let first = graphs.source_start[window.graph(step)] as usize;
                    let own = first * graphs.inputs..(first + graphs.robots) * graphs.inputs;
                    self.x.extend(graphs.observations[own].iter().map(|&float| T::of(float)));
                    self.role.extend_from_slice(&graphs.roles[first..first + graphs.robots]);
                    self.node_of[at + step] = self.nodes as u32;
                    self.nodes += graphs.robots;
                }
                at += window.steps;
            }
            if outputs {
                self.outputs = self.nodes;
            }
        }
        self.first.push(0);
        let mut position = Position { node: 0, extra: self.nodes };
        for outputs in [true, false] {
            let mut at = 0;
            for (index, window) in windows.clone().enumerate() {
                for step in (0..window.steps).filter(|step| window.has_outputs(*step) == outputs) {
                    self.gather_edges((index, &window), (at, step), &mut position);
                }
                at += window.steps;
            }
        }
        self.gather_scan(windows);
    }

    /// Adds the edges of one graph: that of the step `step` of a window, whose first entry in `node_of` is `at`.
    fn gather_edges(&mut self, (index, window): (usize, &Window), (at, step): (usize, usize), next: &mut Position) {
        let (graphs, graph, robots) = (window.graphs, window.graph(step), window.graphs.robots);
        let edges = Graphs::span(&graphs.edge_start, graph);
        let features = edges.start * graphs.edge_inputs..edges.end * graphs.edge_inputs;
        self.e.extend(graphs.edges[features].iter().map(|&float| T::of(float)));
        let mut edge = edges.start;
        for robot in 0..robots {
            while edge < edges.end && usize::from(graphs.receivers[edge]) == robot {
                let sender = usize::from(graphs.senders[edge]);
                let row = match &graphs.latents {
                    None if sender < robots => next.node + sender,
                    None => next.extra + sender - robots,
                    Some(latents) => match step.checked_sub(latents.ages[edge].into()) {
                        Some(sent) => self.node_of[at + sent] as usize + sender,
                        None => self.recorded_row((index, window), usize::from(latents.ages[edge]) - step, sender),
                    },
                };
                self.sender.push(row as u32);
                edge += 1;
            }
            self.first.push(self.sender.len() as u32);
        }
        assert_eq!(edge, edges.end, "edges are in the order of receivers");
        next.node += robots;
        if graphs.latents.is_none() {
            let sources = Graphs::span(&graphs.source_start, graph);
            self.role.extend_from_slice(&graphs.roles[sources.start + robots..sources.end]);
            let late = (sources.start + robots) * graphs.inputs..sources.end * graphs.inputs;
            next.extra += late.len() / graphs.inputs;
            self.x.extend(graphs.observations[late].iter().map(|&float| T::of(float)));
        }
    }

    /// Returns the row, among those of nodes and recorded inputs, of the message that a robot sent `before` steps
    /// before the first of a window.
    fn recorded_row(&mut self, (index, window): (usize, &Window), before: usize, robot: usize) -> usize {
        let graphs = window.graphs;
        let latents = graphs.latents.as_ref().expect("only recurrent networks have late messages of their own");
        let at = (index * LATEST + before) * graphs.robots + robot;
        if self.late.len() <= at {
            self.late.resize(at + 1, u32::MAX);
        }
        if self.late[at] == u32::MAX {
            self.recorded.resize_with(latents.widths.len(), Vec::new);
            self.late[at] = (self.recorded[0].len() / latents.widths[0]) as u32;
            let mut rest = latents.of(graphs.robots, window.first, before, robot);
            for (recorded, width) in self.recorded.iter_mut().zip(&latents.widths) {
                let (input, after) = rest.split_at(*width);
                recorded.extend(input.iter().map(|&float| T::of(float)));
                rest = after;
            }
        }
        self.nodes + self.late[at] as usize
    }

    /// Makes the order in which the memories of the nodes are computed.
    fn gather_scan<'a>(&mut self, windows: impl Iterator<Item = Window<'a>> + Clone) {
        let Scan { order, start, before, state } = &mut self.scan;
        order.clear();
        start.clear();
        state.clear();
        let memory = |window: &Window| window.graphs.latents.as_ref().is_some_and(|latents| latents.memory);
        if !windows.clone().any(|window| memory(&window)) {
            return;
        }
        before.clear();
        before.resize(self.nodes, 0);
        start.push(0);
        let steps = windows.clone().map(|window| window.steps).max().unwrap_or(0);
        for step in 0..steps {
            let mut at = 0;
            for window in windows.clone() {
                let graphs = window.graphs;
                let latents = graphs.latents.as_ref().expect("all graphs of a batch are of one network");
                let floats = latents.widths[0];
                if state.is_empty() {
                    state.resize(floats, T::zero());
                }
                for robot in (0..graphs.robots).filter(|_| step < window.steps) {
                    let node = self.node_of[at + step] as usize + robot;
                    order.push(node as u32);
                    before[node] = if latents.begins[window.graph(step) * graphs.robots + robot] {
                        self.nodes as u32
                    } else if step > 0 {
                        self.node_of[at + step - 1] + robot as u32
                    } else {
                        let row = state.len() / floats;
                        let last = &latents.of(graphs.robots, window.first, 1, robot)[..floats];
                        state.extend(last.iter().map(|&float| T::of(float)));
                        (self.nodes + row) as u32
                    };
                }
                at += window.steps;
            }
            start.push(order.len() as u32);
        }
    }
}
