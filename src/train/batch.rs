//! Many observation graphs in a row, as a network takes them: who observed what, and who heard whom.
//!
//! A graph is one decision of one team. Its first sources are the robots' own observations, in the order of the
//! robots; further ones are observations of an earlier moment that someone still acts on.

use std::ops::Range;

use super::matrix::Real;

/// Graphs as they are recorded, one after the other.
#[derive(Clone, Debug, Default)]
pub struct Graphs {
    /// Robots of a graph.
    pub robots: usize,
    /// Floats of an observation.
    pub inputs: usize,
    /// Floats of an edge.
    pub edge_inputs: usize,
    /// Where each graph's sources begin; one entry more than graphs.
    source_start: Vec<u32>,
    /// Where each graph's edges begin; one entry more than graphs.
    edge_start: Vec<u32>,
    observations: Vec<f32>,
    /// By edge: who hears, counted within the graph; never falling.
    receivers: Vec<u16>,
    /// By edge: which source is heard, counted within the graph.
    senders: Vec<u16>,
    edges: Vec<f32>,
}

impl Graphs {
    /// No graphs yet.
    pub fn new(robots: usize, inputs: usize, edge_inputs: usize) -> Graphs {
        Graphs { robots, inputs, edge_inputs, source_start: vec![0], edge_start: vec![0], ..Graphs::default() }
    }

    /// How many graphs are complete.
    pub fn len(&self) -> usize {
        self.source_start.len() - 1
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Forgets all graphs and keeps their room.
    pub fn clear(&mut self) {
        self.source_start.truncate(1);
        self.edge_start.truncate(1);
        self.observations.clear();
        self.receivers.clear();
        self.senders.clear();
        self.edges.clear();
    }

    /// Adds all graphs of another record.
    pub fn append(&mut self, other: &Graphs) {
        let (sources, edges) = (self.source_start[self.len()], self.edge_start[self.len()]);
        self.source_start.extend(other.source_start[1..].iter().map(|start| sources + start));
        self.edge_start.extend(other.edge_start[1..].iter().map(|start| edges + start));
        self.observations.extend_from_slice(&other.observations);
        self.receivers.extend_from_slice(&other.receivers);
        self.senders.extend_from_slice(&other.senders);
        self.edges.extend_from_slice(&other.edges);
    }

    /// Adds a source to the graph that is being made, to be written; its number within the graph.
    pub fn source(&mut self) -> (u16, &mut [f32]) {
        let at = self.observations.len();
        let first = self.source_start[self.source_start.len() - 1] as usize;
        let index = u16::try_from(at / self.inputs - first).expect("a graph has few sources");
        self.observations.resize(at + self.inputs, 0.0);
        (index, &mut self.observations[at..])
    }

    /// Adds an edge to the graph that is being made; its features are to be written.
    pub fn edge(&mut self, receiver: usize, sender: u16) -> &mut [f32] {
        self.receivers.push(u16::try_from(receiver).expect("a graph has few robots"));
        self.senders.push(sender);
        let at = self.edges.len();
        self.edges.resize(at + self.edge_inputs, 0.0);
        &mut self.edges[at..]
    }

    /// Ends the graph that is being made.
    pub fn end(&mut self) {
        let count = |len: usize| u32::try_from(len).expect("a rollout is far below 2^32 edges");
        self.source_start.push(count(self.observations.len() / self.inputs));
        self.edge_start.push(count(self.senders.len()));
        let graph = self.len() - 1;
        let own = self.source_start[graph + 1] - self.source_start[graph];
        assert!(own as usize >= self.robots, "every robot has its own observation");
    }
}

/// Some graphs side by side, ready for a network.
#[derive(Clone, Debug, Default)]
pub struct Batch<T> {
    /// How many robots, of all graphs.
    pub nodes: usize,
    /// Observations, \[sources, inputs\]: the robots' own first.
    pub x: Vec<T>,
    /// Where each robot's edges begin; one entry more than nodes.
    pub first: Vec<u32>,
    /// By edge: which source is heard.
    pub sender: Vec<u32>,
    /// Edge features, \[edges, edge inputs\].
    pub e: Vec<T>,
}

impl<T: Real> Batch<T> {
    /// How many sources there are.
    pub fn sources(&self, inputs: usize) -> usize {
        self.x.len() / inputs
    }

    /// Replaces the batch by these graphs, given by their record and their number in it.
    pub fn gather<'a>(&mut self, which: impl Iterator<Item = (&'a Graphs, usize)> + Clone) {
        self.x.clear();
        self.first.clear();
        self.sender.clear();
        self.e.clear();
        self.nodes = 0;
        let span = |starts: &[u32], graph: usize| starts[graph] as usize..starts[graph + 1] as usize;
        let floats = |range: Range<usize>, each: usize| range.start * each..range.end * each;
        let numbers = |floats: &'a [f32]| floats.iter().map(|&float| T::of(float));
        for (graphs, graph) in which.clone() {
            let sources = span(&graphs.source_start, graph);
            let own = sources.start..sources.start + graphs.robots;
            self.x.extend(numbers(&graphs.observations[floats(own, graphs.inputs)]));
            self.nodes += graphs.robots;
        }
        let (mut node, mut extra) = (0, self.nodes);
        self.first.push(0);
        for (graphs, graph) in which {
            let robots = graphs.robots;
            let sources = span(&graphs.source_start, graph);
            let late = sources.start + robots..sources.end;
            let edges = span(&graphs.edge_start, graph);
            self.e.extend(numbers(&graphs.edges[floats(edges.clone(), graphs.edge_inputs)]));
            let mut edge = edges.start;
            for robot in 0..robots {
                while edge < edges.end && usize::from(graphs.receivers[edge]) == robot {
                    let sender = usize::from(graphs.senders[edge]);
                    let at = if sender < robots { node + sender } else { extra + sender - robots };
                    self.sender.push(at as u32);
                    edge += 1;
                }
                self.first.push(self.sender.len() as u32);
            }
            assert_eq!(edge, edges.end, "edges come in the order of who hears");
            node += robots;
            extra += late.len();
            self.x.extend(numbers(&graphs.observations[floats(late, graphs.inputs)]));
        }
    }
}
