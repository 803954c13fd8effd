//! Recorded graphs of robots and their messages, and windows of successive ones.
//!
//! A graph is one step of one row, the robots of one environment. Its nodes are the robots; an edge is a message that a
//! robot uses. A network over single graphs takes each message from the observation from which it was made. A network
//! that is recurrent, with memory or several hops, takes it from the sender's node at the step of sending.

use std::ops::Range;

/// Recorded sequence of graphs. A graph has the observations and the used messages of one step of one row (the robots
/// of one environment): its nodes are robots, its sources observations, and its edges messages.
#[derive(Clone, Debug, Default)]
pub struct Graphs {
    /// Number of robots (nodes) in each graph.
    pub robots: usize,
    /// Number of floats in the observation of one source.
    pub inputs: usize,
    /// Number of floats in the features of one edge (message).
    pub edge_inputs: usize,
    /// Index of each graph's first source in `observations`, and last the number of sources.
    pub(super) source_start: Vec<u32>,
    /// Index of each graph's first edge in `senders`, and last the number of edges.
    pub(super) edge_start: Vec<u32>,
    pub(super) observations: Vec<f32>,
    /// Role of the robot of each source.
    pub(super) roles: Vec<u8>,
    /// Receiving robot of each edge, numbered within the graph; in ascending order.
    pub(super) receivers: Vec<u16>,
    /// Source of each edge, numbered within the graph.
    pub(super) senders: Vec<u16>,
    pub(super) edges: Vec<f32>,
    /// Latents of earlier steps, for a recurrent network; `None` for graphs that stand for themselves.
    pub(super) latents: Option<Latents>,
}

/// Latents that robots had in successive steps: for each the inputs of all hops, which its messages hold. The first
/// input is the robot's memory, if it has one.
#[derive(Clone, Debug, Default)]
pub(super) struct Latents {
    /// Number of rows: the next graph of a row comes after those of all rows.
    pub(super) rows: usize,
    /// Number of floats of each hop's input.
    pub(super) widths: Vec<usize>,
    /// Whether the first hop's input is a memory.
    pub(super) memory: bool,
    /// Number of graphs before the first whose latents are kept.
    past: usize,
    /// Latents by graph, those before the first included, then by robot.
    floats: Vec<f32>,
    /// Whether the robot's episode began with the graph, by graph and robot.
    pub(super) begins: Vec<bool>,
    /// Age of each edge's message \[steps\].
    pub(super) ages: Vec<u8>,
}

impl Latents {
    fn width(&self) -> usize {
        self.widths.iter().sum()
    }

    /// Returns the latents that a robot had `steps` steps before a graph.
    pub(super) fn of(&self, robots: usize, graph: usize, steps: usize, robot: usize) -> &[f32] {
        let at = (self.past + graph - steps * self.rows) * robots + robot;
        &self.floats[at * self.width()..][..self.width()]
    }
}

impl Graphs {
    /// Returns an empty sequence for graphs of `robots` robots, with observations of `inputs` floats and edges of
    /// `edge_inputs` floats. Each graph stands for itself.
    pub fn new(robots: usize, inputs: usize, edge_inputs: usize) -> Graphs {
        Graphs { robots, inputs, edge_inputs, source_start: vec![0], edge_start: vec![0], ..Graphs::default() }
    }

    /// Returns the sequence for a recurrent network whose hops have inputs of these widths, the first of which is a
    /// `memory` or not. Steps of `rows` rows follow each other, and what robots had in the last `past` steps is kept.
    pub fn recurrent(self, rows: usize, widths: Vec<usize>, memory: bool, past: usize) -> Graphs {
        let mut latents = Latents { rows, widths, memory, past: past * rows, ..Latents::default() };
        latents.floats = vec![0.0; latents.past * self.robots * latents.width()];
        Graphs { latents: Some(latents), ..self }
    }

    /// Returns the number of complete graphs.
    pub fn len(&self) -> usize {
        self.source_start.len() - 1
    }

    /// Whether there is no complete graph.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Removes all graphs, but for the last latents, and keeps the allocated memory.
    pub fn clear(&mut self) {
        self.source_start.truncate(1);
        self.edge_start.truncate(1);
        self.observations.clear();
        self.roles.clear();
        self.receivers.clear();
        self.senders.clear();
        self.edges.clear();
        let kept = self.last_latents().len();
        if let Some(latents) = &mut self.latents {
            latents.floats.drain(..latents.floats.len() - kept);
            latents.begins.clear();
            latents.ages.clear();
        }
    }

    /// Returns the latents that are kept for the graphs that come next; empty for graphs that stand for themselves.
    pub fn last_latents(&self) -> &[f32] {
        let kept = |latents: &Latents| latents.past * self.robots * latents.width();
        self.latents.as_ref().map_or(&[], |latents| &latents.floats[latents.floats.len() - kept(latents)..])
    }

    /// Replaces the latents that are kept. Returns `false` and changes nothing if they have another length.
    pub fn restore_latents(&mut self, kept: Vec<f32>) -> bool {
        let fits = kept.len() == self.last_latents().len() && kept.iter().all(|float| float.is_finite());
        if let Some(latents) = self.latents.as_mut().filter(|_| fits) {
            latents.floats = kept;
        }
        fits
    }

    /// Appends all graphs of the sequence `other`, of graphs that stand for themselves.
    pub fn append(&mut self, other: &Graphs) {
        let (sources, edges) = (self.source_start[self.len()], self.edge_start[self.len()]);
        self.source_start.extend(other.source_start[1..].iter().map(|start| sources + start));
        self.edge_start.extend(other.edge_start[1..].iter().map(|start| edges + start));
        self.observations.extend_from_slice(&other.observations);
        self.roles.extend_from_slice(&other.roles);
        self.receivers.extend_from_slice(&other.receivers);
        self.senders.extend_from_slice(&other.senders);
        self.edges.extend_from_slice(&other.edges);
    }

    /// Adds a source, an observation from which a message is made, to the unfinished graph; `role` is the index of the
    /// role of the robot that observed. Returns the source's number within the graph, and its observation, zero until
    /// the caller writes it. The robots' own come first.
    pub fn source(&mut self, role: u8) -> (u16, &mut [f32]) {
        let at = self.observations.len();
        self.roles.push(role);
        let first = self.source_start[self.source_start.len() - 1] as usize;
        let index = u16::try_from(at / self.inputs - first).expect("a graph has few sources");
        self.observations.resize(at + self.inputs, 0.0);
        (index, &mut self.observations[at..])
    }

    /// Adds an edge to the unfinished graph: the robot with index `receiver` uses the message made from the source with
    /// number `sender`. Returns the edge's features, zero until the caller writes them.
    pub fn edge(&mut self, receiver: usize, sender: u16) -> &mut [f32] {
        self.receivers.push(u16::try_from(receiver).expect("a graph has few robots"));
        self.senders.push(sender);
        let at = self.edges.len();
        self.edges.resize(at + self.edge_inputs, 0.0);
        &mut self.edges[at..]
    }

    /// Adds an edge to the unfinished graph of a recurrent network: the robot with index `receiver` uses the message
    /// that the robot `sender` sent `age` steps before. Returns the edge's features as `edge` does.
    pub fn edge_of_age(&mut self, receiver: usize, sender: u16, age: u8) -> &mut [f32] {
        self.latents.as_mut().expect("the graphs are those of a recurrent network").ages.push(age);
        self.edge(receiver, sender)
    }

    /// Completes the unfinished graph.
    ///
    /// # Panics
    /// If the graph has fewer sources than robots.
    pub fn end(&mut self) {
        let count = |len: usize| u32::try_from(len).expect("a rollout is far below 2^32 edges");
        self.source_start.push(count(self.observations.len() / self.inputs));
        self.edge_start.push(count(self.senders.len()));
        let graph = self.len() - 1;
        let own = self.source_start[graph + 1] - self.source_start[graph];
        assert!(own as usize >= self.robots, "every robot has its own observation");
    }

    /// Says of the next robot of the unfinished graph of a recurrent network whether its episode begins with it.
    pub fn begins(&mut self, begins: bool) {
        self.latents.as_mut().expect("the graphs are those of a recurrent network").begins.push(begins);
    }

    /// Stores the latents of the next robots: `inputs` returns the inputs of a hop, one row for each robot.
    pub fn store_latents<'a>(&mut self, robots: usize, inputs: impl Fn(usize) -> &'a [f32]) {
        let latents = self.latents.as_mut().expect("the graphs are those of a recurrent network");
        for robot in 0..robots {
            for (hop, width) in latents.widths.iter().enumerate() {
                latents.floats.extend_from_slice(&inputs(hop)[robot * width..][..*width]);
            }
        }
    }

    /// Returns the successive graphs of one row that begin with the graph `first`, all with outputs.
    pub fn window(&self, first: usize, steps: usize) -> Window<'_> {
        Window { graphs: self, first, steps, lookback: 0, every: 1 }
    }

    /// Returns the entries of a graph, by the lists of first entries.
    pub(super) fn span(starts: &[u32], graph: usize) -> Range<usize> {
        starts[graph] as usize..starts[graph + 1] as usize
    }
}

/// Successive graphs of one row.
#[derive(Clone, Copy, Debug)]
pub struct Window<'a> {
    /// Sequence of graphs.
    pub graphs: &'a Graphs,
    /// Index of the first graph.
    pub first: usize,
    /// Number of graphs.
    pub steps: usize,
    /// Number of graphs at the beginning without outputs.
    pub lookback: usize,
    /// Distance \[steps\] between graphs with outputs after these; the first of them has outputs.
    pub every: usize,
}

impl Window<'_> {
    /// Returns whether a step of the window has outputs.
    pub(super) fn has_outputs(&self, step: usize) -> bool {
        step >= self.lookback && (step - self.lookback).is_multiple_of(self.every)
    }

    /// Returns the index of the graph of a step of the window.
    pub(super) fn graph(&self, step: usize) -> usize {
        self.first + step * self.graphs.latents.as_ref().map_or(1, |latents| latents.rows)
    }
}
