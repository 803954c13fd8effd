//! A policy of several hops that is trained: forward and backward passes over graphs of robots at successive steps.
//!
//! It is the part of policy format 2 whose derivatives are written here: hops with a message network and an update
//! network, sums and means, and the activations relu and tanh. [`TrainableHops::new`] refuses the rest by name. The
//! test `tests/learning/imitation.rs` compares the derivatives with central differences.

use super::graph::Graph;
use super::perceptron::{self, Perceptron};
use crate::matrix::Real;
use crate::network::{add, resize};
use murmurate::policy::hops::action::Action;
use murmurate::policy::hops::file::Tensors;
use murmurate::policy::hops::manifest::{Aggregation, Distribution, Input, Manifest};
use murmurate::policy::mlp::Instructions;

/// One hop: its networks, and what their inputs are.
#[derive(Clone, Debug)]
struct Hop {
    /// Width of the hop's input.
    input: usize,
    message: Perceptron,
    message_inputs: Vec<Input>,
    aggregation: Aggregation,
    update: Perceptron,
    update_inputs: Vec<Input>,
}

/// Architecture of a policy of several hops; its parameters are a slice of numbers.
#[derive(Clone, Debug)]
pub struct TrainableHops {
    encoder: Perceptron,
    hops: Vec<Hop>,
    decoder: Perceptron,
    /// Width of the features of an edge.
    edge: usize,
    parameters: usize,
}

/// Buffers of one hop.
#[derive(Debug, Default)]
struct HopSpace<T> {
    /// Inputs of the message network, one row for each edge.
    rows: Vec<T>,
    message: perceptron::Space<T>,
    /// Aggregated messages, one row for each node.
    aggregate: Vec<T>,
    /// Inputs of the update network, one row for each node.
    update_rows: Vec<T>,
    update: perceptron::Space<T>,
}

/// Buffers of a network for the passes over one graph.
#[derive(Debug, Default)]
pub struct Space<T> {
    encoder: perceptron::Space<T>,
    hops: Vec<HopSpace<T>>,
    decoder: perceptron::Space<T>,
    d_hidden: Vec<T>,
    d_input: Vec<T>,
    d_messages: Vec<T>,
}

impl<T> Space<T> {
    /// Returns the decoder's outputs of the last forward pass, one row for each node.
    pub fn outputs(&self) -> &[T] {
        self.decoder.outputs()
    }
}

/// Returns the input of a hop from the buffers of what comes before it.
fn input_of<'a, T>(encoder: &'a perceptron::Space<T>, before: &'a [HopSpace<T>]) -> &'a [T] {
    before.last().map_or_else(|| encoder.outputs(), |hop| hop.update.outputs())
}

impl TrainableHops {
    /// Makes the network of a checked manifest. An error names the field that training does not support.
    pub fn new(manifest: &Manifest) -> Result<TrainableHops, String> {
        if manifest.distribution != Distribution::DiagonalNormal {
            return Err("distribution: training by imitation supports 'diagonal-normal' only".to_owned());
        }
        if manifest.action != Action::Acceleration {
            return Err("action: training by imitation supports 'acceleration' only".to_owned());
        }
        let (mut at, edge) = (0, manifest.edge_floats());
        let within = |field: &str, why: String| format!("{field}.{why}");
        let encoder = Perceptron::new(&manifest.encoder, &mut at).map_err(|why| within("encoder", why))?;
        let (mut hops, mut input) = (Vec::new(), encoder.outputs());
        for (index, form) in manifest.hops.iter().enumerate() {
            let field = format!("hops.{index}");
            let lacks = |name: &str| format!("{field}.{name}: training by imitation needs it");
            if !matches!(form.aggregation, Aggregation::Sum | Aggregation::Mean) {
                return Err(format!("{field}.aggregation: training by imitation supports 'sum' and 'mean'"));
            }
            if form.self_loop.is_some() {
                return Err(format!("{field}.self_loop: training by imitation does not support it; leave it out"));
            }
            let message = form.message.as_ref().ok_or_else(|| lacks("message"))?;
            let update = form.update.as_ref().ok_or_else(|| lacks("update"))?;
            let hop = Hop {
                input,
                message: Perceptron::new(message, &mut at).map_err(|why| within(&format!("{field}.message"), why))?,
                message_inputs: message.inputs.clone(),
                aggregation: form.aggregation,
                update: Perceptron::new(update, &mut at).map_err(|why| within(&format!("{field}.update"), why))?,
                update_inputs: update.inputs.clone(),
            };
            input = hop.update.outputs();
            hops.push(hop);
        }
        let decoder = Perceptron::new(&manifest.decoder, &mut at).map_err(|why| within("decoder", why))?;
        Ok(TrainableHops { encoder, hops, decoder, edge, parameters: at })
    }

    /// Returns the number of weights and biases.
    pub fn parameters(&self) -> usize {
        self.parameters
    }

    /// Returns the number of hops.
    pub fn hops(&self) -> usize {
        self.hops.len()
    }

    /// Returns the width of the observation.
    pub fn inputs(&self) -> usize {
        self.encoder.inputs()
    }

    /// Returns the width of an edge's features.
    pub fn edge(&self) -> usize {
        self.edge
    }

    /// Returns the width of the decoder's output.
    pub fn outputs(&self) -> usize {
        self.decoder.outputs()
    }

    fn perceptrons(&self) -> impl Iterator<Item = &Perceptron> {
        let hops = self.hops.iter().flat_map(|hop| [&hop.message, &hop.update]);
        [&self.encoder].into_iter().chain(hops).chain([&self.decoder])
    }

    /// Returns for each layer the number of its inputs, and the places of its parameters: the begin of its weights, the
    /// begin of its biases and their end.
    pub fn layers(&self) -> Vec<[usize; 4]> {
        self.perceptrons().flat_map(Perceptron::places).collect()
    }

    /// Returns the parameters as the tensors of a policy file.
    pub fn tensors(&self, parameters: &[f32]) -> Tensors {
        let layer = |[_, at, bias, end]: [usize; 4]| (parameters[at..bias].to_vec(), parameters[bias..end].to_vec());
        self.perceptrons().map(|perceptron| perceptron.places().map(layer).collect()).collect()
    }

    /// Computes the outputs of all nodes of a graph, which are in `space` then.
    pub fn forward<T: Real>(&self, p: &[T], graph: &Graph<T>, space: &mut Space<T>) {
        Instructions::Detected.run(
            #[inline(always)]
            || self.forward_here(p, graph, space),
        );
    }

    #[inline(always)]
    fn forward_here<T: Real>(&self, p: &[T], graph: &Graph<T>, space: &mut Space<T>) {
        let nodes = graph.nodes();
        self.encoder.forward(p, &graph.observations, nodes, &mut space.encoder);
        space.hops.resize_with(self.hops.len(), HopSpace::default);
        for (index, hop) in self.hops.iter().enumerate() {
            let (before, rest) = space.hops.split_at_mut(index);
            let input = input_of(&space.encoder, before);
            hop.forward(p, input, |sender| &input[sender * hop.input..][..hop.input], graph, &mut rest[0]);
        }
        self.decoder.forward(p, input_of(&space.encoder, &space.hops), nodes, &mut space.decoder);
    }

    /// Computes the inputs of the first hop from the observations of some robots, one row for each.
    pub fn encode<'a>(&self, p: &[f32], observations: &[f32], space: &'a mut Space<f32>) -> &'a [f32] {
        let rows = observations.len() / self.inputs();
        self.encoder.forward(p, observations, rows, &mut space.encoder);
        space.hops.resize_with(self.hops.len(), HopSpace::default);
        space.encoder.outputs()
    }

    /// Computes the output of one hop for all nodes of a graph, whose own inputs of the hop are `input`. The input of
    /// each sender is `sent(sender)`, which need not be a node of the graph.
    pub fn hop<'a, 'b>(
        &self,
        index: usize,
        p: &[f32],
        input: &[f32],
        sent: impl Fn(usize) -> &'b [f32],
        graph: &Graph<f32>,
        space: &'a mut Space<f32>,
    ) -> &'a [f32] {
        self.hops[index].forward(p, input, sent, graph, &mut space.hops[index]);
        space.hops[index].update.outputs()
    }

    /// Computes the decoder's outputs from the outputs of the last hop, one row for each robot.
    pub fn decode<'a>(&self, p: &[f32], hidden: &[f32], space: &'a mut Space<f32>) -> &'a [f32] {
        self.decoder.forward(p, hidden, hidden.len() / self.decoder.inputs(), &mut space.decoder);
        space.decoder.outputs()
    }

    /// Adds the gradient of the parameters to `g`, for the derivatives `d_outputs` by the outputs of the last forward
    /// pass over the same graph.
    pub fn backward<T: Real>(&self, p: &[T], graph: &Graph<T>, d_outputs: &[T], space: &mut Space<T>, g: &mut [T]) {
        Instructions::Detected.run(
            #[inline(always)]
            || self.backward_here(p, graph, d_outputs, space, g),
        );
    }

    #[inline(always)]
    fn backward_here<T: Real>(&self, p: &[T], graph: &Graph<T>, d_outputs: &[T], space: &mut Space<T>, g: &mut [T]) {
        let nodes = graph.nodes();
        let Space { encoder, hops, decoder, d_hidden, d_input, d_messages } = space;
        let d = self.decoder.backward(p, input_of(encoder, hops), nodes, d_outputs, decoder, g);
        d_hidden.clear();
        d_hidden.extend_from_slice(d);
        for (index, hop) in self.hops.iter().enumerate().rev() {
            hop.backward(p, graph, &mut hops[index], (&mut *d_hidden, &mut *d_input, &mut *d_messages), g);
            std::mem::swap(d_hidden, d_input);
        }
        self.encoder.backward(p, &graph.observations, nodes, d_hidden, encoder, g);
    }
}

impl Hop {
    /// Width of a part of the input of the message or the update network, whose edges have `edge` features.
    fn width(&self, part: Input, edge: usize) -> usize {
        match part {
            Input::Own | Input::Sender => self.input,
            Input::Edge => edge,
            Input::Messages => self.message.outputs(),
        }
    }

    #[inline(always)]
    fn forward<'b, T: Real>(
        &self,
        p: &[T],
        input: &[T],
        sent: impl Fn(usize) -> &'b [T],
        graph: &Graph<T>,
        space: &mut HopSpace<T>,
    ) {
        let (nodes, edges) = (graph.nodes(), graph.sender.len());
        let edge = graph.edges.len() / edges.max(1);
        let own = |node: usize| &input[node * self.input..][..self.input];
        space.rows.clear();
        for node in 0..nodes {
            for at in graph.edges_of(node) {
                for part in &self.message_inputs {
                    space.rows.extend_from_slice(match part {
                        Input::Own | Input::Messages => own(node),
                        Input::Sender => sent(graph.sender[at] as usize),
                        Input::Edge => &graph.edges[at * edge..][..edge],
                    });
                }
            }
        }
        self.message.forward(p, &space.rows, edges, &mut space.message);
        let width = self.message.outputs();
        resize(&mut space.aggregate, nodes * width);
        space.aggregate.fill(T::zero());
        space.update_rows.clear();
        for node in 0..nodes {
            let sum = &mut space.aggregate[node * width..][..width];
            let range = graph.edges_of(node);
            for term in space.message.outputs()[range.start * width..range.end * width].chunks_exact(width) {
                add(sum, term);
            }
            let share = self.share::<T>(range.len());
            sum.iter_mut().for_each(|sum| *sum = *sum * share);
            for part in &self.update_inputs {
                space.update_rows.extend_from_slice(if *part == Input::Own { own(node) } else { sum });
            }
        }
        self.update.forward(p, &space.update_rows, nodes, &mut space.update);
    }

    /// Returns the factor of each of `messages` messages in the aggregation.
    fn share<T: Real>(&self, messages: usize) -> T {
        match self.aggregation {
            Aggregation::Mean => T::one() / T::of(messages.max(1) as f32),
            _ => T::one(),
        }
    }

    /// Computes the derivatives by the hop's inputs into the second of the buffers, from those by its outputs in the
    /// first. The third is scratch.
    #[inline(always)]
    fn backward<T: Real>(
        &self,
        p: &[T],
        graph: &Graph<T>,
        space: &mut HopSpace<T>,
        (d_hidden, d_input, d_messages): (&mut Vec<T>, &mut Vec<T>, &mut Vec<T>),
        g: &mut [T],
    ) {
        let (nodes, edges) = (graph.nodes(), graph.sender.len());
        let (width, edge) = (self.message.outputs(), graph.edges.len() / edges.max(1));
        resize(d_input, nodes * self.input);
        d_input.fill(T::zero());
        resize(d_messages, edges * width);
        let HopSpace { rows, message, update_rows, update, .. } = space;
        let d = self.update.backward(p, update_rows, nodes, d_hidden, update, g);
        for (node, row) in d.chunks_exact(self.update.inputs()).enumerate() {
            let mut at = 0;
            for part in &self.update_inputs {
                let d = &row[at..at + self.width(*part, edge)];
                at += d.len();
                if *part == Input::Own {
                    add(&mut d_input[node * self.input..][..self.input], d);
                    continue;
                }
                let range = graph.edges_of(node);
                let share = self.share::<T>(range.len());
                for to in d_messages[range.start * width..range.end * width].chunks_exact_mut(width) {
                    to.iter_mut().zip(d).for_each(|(to, d)| *to = *d * share);
                }
            }
        }
        if !self.update_inputs.contains(&Input::Messages) {
            d_messages.fill(T::zero());
        }
        let d = self.message.backward(p, rows, edges, d_messages, message, g);
        for node in 0..nodes {
            for edge_at in graph.edges_of(node) {
                let row = &d[edge_at * self.message.inputs()..][..self.message.inputs()];
                let mut at = 0;
                for part in &self.message_inputs {
                    let d = &row[at..at + self.width(*part, edge)];
                    at += d.len();
                    let to = match part {
                        Input::Edge => continue,
                        Input::Sender => graph.sender[edge_at] as usize,
                        Input::Own | Input::Messages => node,
                    };
                    add(&mut d_input[to * self.input..][..self.input], d);
                }
            }
        }
    }
}
