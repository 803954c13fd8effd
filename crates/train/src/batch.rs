//! Observation graphs of many decisions, and batches of them as input of a network.
//!
//! A graph is one decision of one row, the robots of one environment. Its nodes are the robots; an edge is a message
//! that a robot uses. A source is an observation from which a message is encoded. A graph's first sources are the
//! robots' current observations, in the order of the robots. Further ones are earlier observations whose messages are
//! still in use.

use std::ops::Range;

use super::matrix::Real;

/// Recorded sequence of graphs. A graph has the observations and the used messages of one decision of one row (the
/// robots of one environment): its nodes are robots, its sources observations, and its edges messages.
#[derive(Clone, Debug, Default)]
pub struct Graphs {
    /// Number of robots (nodes) in each graph.
    pub robots: usize,
    /// Number of floats in the observation of one source.
    pub inputs: usize,
    /// Number of floats in the features of one edge (message).
    pub edge_inputs: usize,
    /// Index of each graph's first source in `observations`, and last the number of sources.
    source_start: Vec<u32>,
    /// Index of each graph's first edge in `senders`, and last the number of edges.
    edge_start: Vec<u32>,
    observations: Vec<f32>,
    /// Receiving robot of each edge, numbered within the graph; in ascending order.
    receivers: Vec<u16>,
    /// Source of each edge, numbered within the graph.
    senders: Vec<u16>,
    edges: Vec<f32>,
}

impl Graphs {
    /// Returns an empty sequence for graphs of `robots` robots, with observations of `inputs` floats and edges of
    /// `edge_inputs` floats.
    pub fn new(robots: usize, inputs: usize, edge_inputs: usize) -> Graphs {
        Graphs { robots, inputs, edge_inputs, source_start: vec![0], edge_start: vec![0], ..Graphs::default() }
    }

    /// Returns the number of complete graphs.
    pub fn len(&self) -> usize {
        self.source_start.len() - 1
    }

    /// Whether there is no complete graph.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Removes all graphs and keeps the allocated memory.
    pub fn clear(&mut self) {
        self.source_start.truncate(1);
        self.edge_start.truncate(1);
        self.observations.clear();
        self.receivers.clear();
        self.senders.clear();
        self.edges.clear();
    }

    /// Appends all graphs of the sequence `other`.
    pub fn append(&mut self, other: &Graphs) {
        let (sources, edges) = (self.source_start[self.len()], self.edge_start[self.len()]);
        self.source_start.extend(other.source_start[1..].iter().map(|start| sources + start));
        self.edge_start.extend(other.edge_start[1..].iter().map(|start| edges + start));
        self.observations.extend_from_slice(&other.observations);
        self.receivers.extend_from_slice(&other.receivers);
        self.senders.extend_from_slice(&other.senders);
        self.edges.extend_from_slice(&other.edges);
    }

    /// Adds a source, an observation from which a message is made, to the unfinished graph. Returns the source's number
    /// within the graph, and its observation, zero until the caller writes it. The robots' own come first.
    pub fn source(&mut self) -> (u16, &mut [f32]) {
        let at = self.observations.len();
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
}

/// Batch of graphs as input of a network: the observations (sources) from which messages are made, and the messages
/// (edges) that robots use.
#[derive(Clone, Debug, Default)]
pub struct Batch<T> {
    /// Number of robots in the batch, summed over all graphs.
    pub nodes: usize,
    /// Observations of all sources, \[sources, inputs\], row-major. The robots' current observations come first.
    pub x: Vec<T>,
    /// Index of each robot's first edge in `sender`, and last the number of edges: one entry more than `nodes`.
    pub first: Vec<u32>,
    /// Row in `x` of each edge's source, the observation from which the message was made.
    pub sender: Vec<u32>,
    /// Edge features, \[edges, edge inputs\], row-major.
    pub e: Vec<T>,
}

impl<T: Real> Batch<T> {
    /// Returns the number of observations from which messages are made; `inputs` is the number of floats in one.
    pub fn sources(&self, inputs: usize) -> usize {
        self.x.len() / inputs
    }

    /// Replaces the content of the batch by the graphs `which`, each given by a sequence of graphs and an index in it.
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
            assert_eq!(edge, edges.end, "edges are in the order of receivers");
            node += robots;
            extra += late.len();
            self.x.extend(numbers(&graphs.observations[floats(late, graphs.inputs)]));
        }
    }
}
