//! The network of a policy or a critic: encoder, memory, hops and decoder, with one forward and one backward pass over
//! batches of graphs. `docs/training.md` has the equations.

mod hop;
mod hop_back;
pub mod layer;
mod manifest;
mod memory;
pub mod shape;
mod team;

use super::batch::Batch;
use super::matrix::Real;
use hop::{Edges, Hop, HopSpace};
use layer::{Back, Layer, Perceptron};
use memory::{Memory, MemorySpace};
use murmurate::policy::mlp::Instructions;
pub use shape::Shape;
pub use team::{TeamNetwork, TeamSpace};

/// Shape of a network, with the place of each layer in its parameters. The parameters are one flat vector, which the
/// caller passes to each function.
#[derive(Clone, Debug)]
pub struct Network {
    shape: Shape,
    encoder: Perceptron,
    memory: Option<Memory>,
    hops: Vec<Hop>,
    decoder: Option<Perceptron>,
    parameters: usize,
}

/// Buffers for the activations of a network and the derivatives of a loss on one batch; all matrices are row-major.
#[derive(Debug, Default)]
pub struct Space<T> {
    /// Outputs of each layer of the encoder, \[sources, outputs\].
    encoder: Vec<Vec<T>>,
    memory: MemorySpace<T>,
    hops: Vec<HopSpace<T>>,
    /// Outputs of each layer of the decoder, \[rows, outputs\]; empty without one.
    decoder: Vec<Vec<T>>,
    /// Derivatives with respect to the outputs of the current layer in the backward pass, and a buffer for the next.
    back: Back<T>,
    d_input: Vec<T>,
}

impl<T> Space<T> {
    /// Returns the network's outputs of the last forward pass, \[nodes with outputs, outputs\], row-major.
    pub fn outputs(&self) -> &[T] {
        let hop = || self.hops.last().and_then(|hop| hop.update.last());
        self.decoder.last().or_else(hop).map_or(&[], |outputs| outputs)
    }

    /// Returns the inputs of the hop with the index `hop` of the last forward pass, those of the nodes first.
    pub fn hop_inputs(&self, hop: usize) -> &[T] {
        input_of(&self.encoder, &self.memory, &self.hops[..hop])
    }
}

/// Returns the input of a hop from the buffers of what comes before it.
fn input_of<'a, T>(encoder: &'a [Vec<T>], memory: &'a MemorySpace<T>, before: &'a [HopSpace<T>]) -> &'a [T] {
    match before.last() {
        Some(hop) => hop.update.last().map_or(&[], |outputs| outputs),
        None if memory.after.is_empty() => encoder.last().map_or(&[], |outputs| outputs),
        None => &memory.after,
    }
}

impl Network {
    /// Makes a network of the shape `shape`, and gives each layer its place in the parameter vector.
    ///
    /// # Panics
    /// If the widths of the shape's parts do not fit each other; those of a checked configuration do.
    pub fn new(shape: Shape) -> Network {
        shape.check().unwrap_or_else(|why| panic!("the parts of a network fit each other: {why}"));
        let mut at = 0;
        let activations = |widths: &shape::Widths| (widths.between, widths.last);
        let encoder = Perceptron::placed(&shape.encoder.widths, activations(&shape.encoder), &mut at);
        let memory = shape.memory.map(|floats| Memory::placed(encoder.outputs(), floats, &mut at));
        let hops = shape.hops.iter().enumerate();
        let hops = hops.map(|(index, hop)| Hop::placed(hop, shape.hop_input(index), shape.edge, &mut at)).collect();
        let decoder = shape.decoder.as_ref();
        let decoder = decoder.map(|widths| Perceptron::placed(&widths.widths, activations(widths), &mut at));
        Network { encoder, memory, hops, decoder, parameters: at, shape }
    }

    /// Returns the number of weights and biases of the network.
    pub fn parameters(&self) -> usize {
        self.parameters
    }

    /// Returns the number of floats in an observation, the input of the encoder.
    pub fn inputs(&self) -> usize {
        self.encoder.inputs()
    }

    /// Returns the number of outputs of the network for each robot.
    pub fn outputs(&self) -> usize {
        self.shape.decoder.as_ref().map_or(self.shape.hop_input(self.hops.len()), shape::Widths::outputs)
    }

    /// Returns the shape of the network.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Returns the number of floats of each hop's input.
    pub fn hop_inputs(&self) -> Vec<usize> {
        self.hops.iter().map(|hop| hop.input).collect()
    }

    /// Whether what the network computes for a robot in one step depends on what robots computed in earlier ones, as
    /// with memory or with messages that were made from messages.
    pub fn is_recurrent(&self) -> bool {
        self.memory.is_some() || self.hops.len() > 1
    }

    /// Returns the layers of each part of the network in the order of its parameters: encoder, memory, message and
    /// update network of each hop, and decoder. The memory has two, of its input and of its state.
    pub fn layers(&self) -> Vec<Vec<Layer>> {
        let mut parts = vec![self.encoder.layers.clone()];
        parts.extend(self.memory.iter().map(|memory| vec![memory.input, memory.state]));
        parts.extend(self.hops.iter().flat_map(|hop| [hop.message.layers.clone(), hop.update.layers.clone()]));
        parts.extend(self.decoder.iter().map(|decoder| decoder.layers.clone()));
        parts
    }

    /// Returns the weights and biases of each layer of each part in `parameters`, as policy files store them.
    pub fn tensors(&self, parameters: &[f32]) -> Vec<Vec<(Vec<f32>, Vec<f32>)>> {
        let tensor = |layer: Layer| {
            (parameters[layer.at..layer.bias()].to_vec(), parameters[layer.bias()..layer.end()].to_vec())
        };
        self.layers().into_iter().map(|layers| layers.into_iter().map(tensor).collect()).collect()
    }

    /// Returns the edges that the hop with the index `hop` uses. Only nodes with outputs need the last hop.
    fn edges<'a, T>(&self, hop: usize, batch: &'a Batch<T>) -> Edges<'a, T> {
        let nodes = if hop + 1 == self.hops.len() { batch.outputs } else { batch.nodes };
        Edges { nodes, first: &batch.first, sender: &batch.sender, features: &batch.e }
    }

    /// Computes all activations and outputs of the network for `batch`, with the weights and biases `parameters`, and
    /// stores them in `space`.
    pub fn forward<T: Real>(&self, parameters: &[T], batch: &Batch<T>, space: &mut Space<T>) {
        Instructions::Detected.run(
            #[inline(always)]
            || self.forward_here(parameters, batch, space),
        );
    }

    #[inline(always)]
    fn forward_here<T: Real>(&self, p: &[T], batch: &Batch<T>, space: &mut Space<T>) {
        let Space { encoder, memory, hops, decoder, .. } = space;
        self.encoder.forward(p, &batch.x, batch.sources(self.inputs()), encoder);
        match &self.memory {
            Some(cell) => cell.forward(p, &encoder[encoder.len() - 1], &batch.scan, memory),
            None => memory.after.clear(),
        }
        hops.resize_with(self.hops.len(), HopSpace::default);
        for (index, hop) in self.hops.iter().enumerate() {
            let (before, rest) = hops.split_at_mut(index);
            if let Some(recorded) = batch.recorded.get(index) {
                let input = match before.last_mut() {
                    Some(before) => before.update.last_mut(),
                    None if self.memory.is_some() => Some(&mut memory.after),
                    None => encoder.last_mut(),
                };
                input.expect("a part has a layer").extend_from_slice(recorded);
            }
            hop.forward(p, input_of(encoder, memory, before), self.edges(index, batch), &mut rest[0]);
        }
        match &self.decoder {
            Some(last) => last.forward(p, input_of(encoder, memory, hops), batch.outputs, decoder),
            None => decoder.clear(),
        }
    }

    /// Adds the gradient of a loss with respect to the parameters to `gradient`. `space` must hold the forward pass of
    /// the same batch. `d_outputs` are the derivatives of the loss with respect to the network's outputs, \[nodes with
    /// outputs, outputs\], row-major.
    pub fn backward<T: Real>(
        &self,
        parameters: &[T],
        batch: &Batch<T>,
        d_outputs: &[T],
        space: &mut Space<T>,
        gradient: &mut [T],
    ) {
        Instructions::Detected.run(
            #[inline(always)]
            || self.backward_here(parameters, batch, d_outputs, space, gradient),
        );
    }

    #[inline(always)]
    fn backward_here<T: Real>(&self, p: &[T], batch: &Batch<T>, d_outputs: &[T], space: &mut Space<T>, g: &mut [T]) {
        let Space { encoder, memory, hops, decoder, back, d_input } = space;
        back[0].clear();
        back[0].extend_from_slice(d_outputs);
        if let Some(last) = &self.decoder {
            last.backward(p, input_of(encoder, memory, hops), batch.outputs, decoder, back, g);
            let [d, spare] = back;
            last.layers[0].input_derivatives(p, d, batch.outputs, spare);
            back.swap(0, 1);
        }
        for (index, hop) in self.hops.iter().enumerate().rev() {
            let (before, rest) = hops.split_at_mut(index);
            let input = input_of(encoder, memory, before);
            hop.backward(p, input, self.edges(index, batch), &mut rest[0], back, d_input, g);
            // What was recorded is constant.
            let recorded = batch.recorded.get(index).map_or(0, Vec::len);
            back[0].clear();
            back[0].extend_from_slice(&d_input[..d_input.len() - recorded]);
        }
        if let Some(cell) = &self.memory {
            cell.backward(p, &encoder[encoder.len() - 1], &batch.scan, memory, back, g);
        }
        // What was recorded of a hop without memory follows the encoder's outputs.
        self.encoder.backward(p, &batch.x, batch.sources(self.inputs()), encoder, back, g);
    }
}
