//! Robots at successive steps as one graph, through which a policy of several hops is differentiated.
//!
//! A node is a robot at a step. An edge leads to it from the neighbour at the step at which the neighbour sent its
//! newest message: the same step if robots exchange all hops within a step, an earlier one if messages take a step or
//! more. So a network over this graph computes for each node what a robot computes, whatever the ages of its messages.

/// Graph of robots at successive steps, and the inputs of a policy in it.
#[derive(Clone, Debug, Default)]
pub struct Graph<T> {
    /// Observations, one row for each node.
    pub observations: Vec<T>,
    /// Index of each node's first edge, and last the number of edges.
    pub first: Vec<u32>,
    /// Sending node of each edge, grouped by the receiving nodes in their order.
    pub sender: Vec<u32>,
    /// Edge features, one row for each edge.
    pub edges: Vec<T>,
}

impl<T> Graph<T> {
    /// Removes all nodes and edges.
    pub fn clear(&mut self) {
        self.observations.clear();
        self.first.clear();
        self.first.push(0);
        self.sender.clear();
        self.edges.clear();
    }

    /// Ends the edges of a node. Its observation and its edges have been appended.
    pub fn end_node(&mut self) {
        self.first.push(u32::try_from(self.sender.len()).expect("a batch has far fewer edges"));
    }

    /// Returns the number of nodes.
    pub fn nodes(&self) -> usize {
        self.first.len() - 1
    }

    /// Returns the edges of a node.
    pub fn edges_of(&self, node: usize) -> std::ops::Range<usize> {
        self.first[node] as usize..self.first[node + 1] as usize
    }
}
