//! Networks of a team: one that all robots share, or one for each role, with messages and gradients between roles.
//!
//! Robots of all roles hear each other, so the encoders of all networks make latents of one width. A hop of one role
//! takes the latents of all senders, and its backward pass gives derivatives with respect to them back to the encoders
//! of the senders' roles.

use std::ops::Range;

use super::hop::{Edges, HopSpace};
use super::layer::{Back, add, resize};
use super::{Network, Shape, Space};
use crate::batch::Batch;
use crate::matrix::Real;
use murmurate::policy::hops::file::Tensors;
use murmurate::policy::mlp::Instructions;

/// Networks of a team, one for each role, or one for all robots. Their parameters are one flat vector, one network
/// after the other.
#[derive(Clone, Debug)]
pub struct TeamNetwork {
    of_roles: Vec<Network>,
}

/// Buffers for the activations of the networks of a team, and the derivatives of a loss, on one batch.
#[derive(Debug, Default)]
pub struct TeamSpace<T> {
    of_roles: Vec<RoleSpace<T>>,
    /// Latents of all sources, or the derivatives with respect to them, \[sources, floats\].
    latents: Vec<T>,
    /// Outputs of all nodes, \[nodes, outputs\]; empty with one network, whose space has them.
    outputs: Vec<T>,
    /// For each source, its row in the input of the hop of the present role; `u32::MAX` for none.
    places: Vec<u32>,
}

/// Part of a batch that concerns one role, with the buffers of the role's network.
#[derive(Debug, Default)]
struct RoleSpace<T> {
    network: Space<T>,
    /// Sources whose observations are of robots of the role, those that are nodes first.
    own: Vec<u32>,
    /// Number of nodes of the role.
    nodes: usize,
    /// Source of each row of the hop's input: the role's nodes, then all other senders that these hear.
    rows: Vec<u32>,
    /// Observations of the sources in `own`, \[sources, inputs\].
    x: Vec<T>,
    /// Edges to the role's nodes: the first edge of each, the row of each sender, and the features.
    first: Vec<u32>,
    sender: Vec<u32>,
    features: Vec<T>,
    /// Input of the hop, \[rows, floats\].
    input: Vec<T>,
    /// Derivatives of the loss with respect to the outputs of the role's nodes.
    d_outputs: Vec<T>,
}

impl<T> TeamSpace<T> {
    /// Returns the outputs of the last forward pass, \[nodes with outputs, outputs\], row-major.
    pub fn outputs(&self) -> &[T] {
        match &self.of_roles[..] {
            [one] => one.network.outputs(),
            _ => &self.outputs,
        }
    }

    /// Returns the inputs of the hop with the index `hop` of the last forward pass of the network that all robots
    /// share, those of the nodes first.
    pub fn hop_inputs(&self, hop: usize) -> &[T] {
        self.of_roles[0].network.hop_inputs(hop)
    }
}

impl From<Network> for TeamNetwork {
    fn from(network: Network) -> TeamNetwork {
        TeamNetwork { of_roles: vec![network] }
    }
}

impl TeamNetwork {
    /// Makes the networks of roles with these shapes, or the one that all robots share.
    ///
    /// # Panics
    /// If there is no shape, or a network of several ones has memory, several hops, or latents, edges or outputs of
    /// another width than the first. Those of a checked configuration have not.
    pub fn new(shapes: Vec<Shape>) -> TeamNetwork {
        let of_roles: Vec<Network> = shapes.into_iter().map(Network::new).collect();
        let (first, others) = of_roles.split_first().expect("a team has a network");
        let contract =
            |network: &Network| (network.hop_inputs(), network.shape.edge, network.outputs(), network.is_recurrent());
        assert!(others.is_empty() || !first.is_recurrent(), "networks of roles have one hop and no memory");
        assert!(others.iter().all(|other| contract(other) == contract(first)), "roles have one kind of message");
        TeamNetwork { of_roles }
    }

    /// Returns the networks, in the order of the roles.
    pub fn networks(&self) -> &[Network] {
        &self.of_roles
    }

    /// Returns the number of weights and biases of all networks.
    pub fn parameters(&self) -> usize {
        self.of_roles.iter().map(Network::parameters).sum()
    }

    /// Returns the place of the parameters of the role with the index `role` among those of all.
    pub fn place(&self, role: usize) -> Range<usize> {
        let first = self.of_roles[..role].iter().map(Network::parameters).sum();
        first..first + self.of_roles[role].parameters()
    }

    /// Returns the number of floats of the longest observation of a role. Shorter ones are its first floats.
    pub fn inputs(&self) -> usize {
        self.of_roles.iter().map(Network::inputs).max().expect("a team has a network")
    }

    /// Returns the number of edge features, which all networks take.
    pub fn edge_inputs(&self) -> usize {
        self.of_roles[0].shape.edge
    }

    /// Returns the number of floats of each hop's input.
    pub fn hop_inputs(&self) -> Vec<usize> {
        self.of_roles[0].hop_inputs()
    }

    /// Whether the network that all robots share has a memory.
    pub fn has_memory(&self) -> bool {
        self.of_roles[0].memory.is_some()
    }

    /// Whether what the network computes for a robot in one step depends on what robots computed in earlier ones.
    pub fn is_recurrent(&self) -> bool {
        self.of_roles[0].is_recurrent()
    }

    /// Returns the weights and biases of each layer of each part of each network in `parameters`, as policy files store
    /// them.
    pub fn tensors(&self, parameters: &[f32]) -> Vec<Tensors> {
        let networks = self.of_roles.iter().enumerate();
        networks.map(|(role, network)| network.tensors(&parameters[self.place(role)])).collect()
    }

    /// Computes all activations and outputs for `batch`, with the weights and biases `parameters`, and stores them in
    /// `space`.
    pub fn forward<T: Real>(&self, parameters: &[T], batch: &Batch<T>, space: &mut TeamSpace<T>) {
        space.of_roles.resize_with(self.of_roles.len(), RoleSpace::default);
        match &self.of_roles[..] {
            [network] => network.forward(parameters, batch, &mut space.of_roles[0].network),
            _ => Instructions::Detected.run(
                #[inline(always)]
                || self.forward_roles(parameters, batch, space),
            ),
        }
    }

    #[inline(always)]
    fn forward_roles<T: Real>(&self, p: &[T], batch: &Batch<T>, space: &mut TeamSpace<T>) {
        let (sources, outputs) = (batch.sources(self.inputs()), self.of_roles[0].outputs());
        let TeamSpace { of_roles, latents, outputs: joined, places } = space;
        let floats = self.of_roles[0].hops[0].input;
        resize(latents, sources * floats);
        for (role, (network, part)) in self.of_roles.iter().zip(&mut *of_roles).enumerate() {
            part.gather(batch, (role, network.inputs(), self.inputs()), places);
            network.encoder.forward(&p[self.place(role)], &part.x, part.own.len(), &mut part.network.encoder);
            let made = &part.network.encoder[network.encoder.layers.len() - 1];
            scatter(made, floats, &part.own, latents);
        }
        resize(joined, batch.outputs * outputs);
        for (role, (network, part)) in self.of_roles.iter().zip(of_roles).enumerate() {
            gather(latents, floats, &part.rows, &mut part.input);
            let p = &p[self.place(role)];
            part.network.hops.resize_with(1, HopSpace::default);
            let edges = Edges { nodes: part.nodes, first: &part.first, sender: &part.sender, features: &part.features };
            network.hops[0].forward(p, &part.input, edges, &mut part.network.hops[0]);
            let Space { hops, decoder, .. } = &mut part.network;
            if let (Some(last), Some(made)) = (&network.decoder, hops[0].update.last()) {
                last.forward(p, made, part.nodes, decoder);
            }
            scatter(part.network.outputs(), outputs, &part.own[..part.nodes], joined);
        }
    }

    /// Adds the gradient of a loss with respect to the parameters to `gradient`. `space` must hold the forward pass of
    /// the same batch. `d_outputs` are the derivatives of the loss with respect to the outputs, \[nodes with outputs,
    /// outputs\], row-major.
    pub fn backward<T: Real>(
        &self,
        parameters: &[T],
        batch: &Batch<T>,
        d_outputs: &[T],
        space: &mut TeamSpace<T>,
        gradient: &mut [T],
    ) {
        match &self.of_roles[..] {
            [network] => network.backward(parameters, batch, d_outputs, &mut space.of_roles[0].network, gradient),
            _ => Instructions::Detected.run(
                #[inline(always)]
                || self.backward_roles(parameters, d_outputs, space, gradient),
            ),
        }
    }

    #[inline(always)]
    fn backward_roles<T: Real>(&self, p: &[T], d_outputs: &[T], space: &mut TeamSpace<T>, gradient: &mut [T]) {
        let (floats, outputs) = (self.of_roles[0].hops[0].input, self.of_roles[0].outputs());
        let TeamSpace { of_roles, latents: d_latents, .. } = space;
        // The latents are not needed any more: the input of each hop has those that it takes.
        d_latents.fill(T::zero());
        for (role, (network, part)) in self.of_roles.iter().zip(&mut *of_roles).enumerate() {
            gather(d_outputs, outputs, &part.own[..part.nodes], &mut part.d_outputs);
            if part.nodes == 0 {
                continue;
            }
            let (p, g) = (&p[self.place(role)], &mut gradient[self.place(role)]);
            let edges = Edges { nodes: part.nodes, first: &part.first, sender: &part.sender, features: &part.features };
            let Space { hops, decoder, back, d_input, .. } = &mut part.network;
            std::mem::swap(&mut back[0], &mut part.d_outputs);
            if let (Some(last), Some(made)) = (&network.decoder, hops[0].update.last()) {
                last.backward(p, made, part.nodes, decoder, back, g);
                let [d, spare] = back;
                last.layers[0].input_derivatives(p, d, part.nodes, spare);
                back.swap(0, 1);
            }
            network.hops[0].backward(p, &part.input, edges, &mut hops[0], back, d_input, g);
            for (row, d) in part.rows.iter().zip(d_input.chunks_exact(floats)) {
                add(&mut d_latents[*row as usize * floats..][..floats], d);
            }
        }
        for (role, (network, part)) in self.of_roles.iter().zip(of_roles).enumerate() {
            let Space { encoder, back, .. } = &mut part.network;
            let back: &mut Back<T> = back;
            gather(d_latents, floats, &part.own, &mut back[0]);
            let g = &mut gradient[self.place(role)];
            network.encoder.backward(&p[self.place(role)], &part.x, part.own.len(), encoder, back, g);
        }
    }
}

impl<T: Real> RoleSpace<T> {
    /// Takes what concerns a role from a batch: its index, the number of floats of its observations, and that of the
    /// rows of the batch. `places` is a buffer.
    #[inline(always)]
    fn gather(&mut self, batch: &Batch<T>, (role, inputs, width): (usize, usize, usize), places: &mut Vec<u32>) {
        let RoleSpace { own, nodes, rows, x, first, sender, features, .. } = self;
        let of_role = batch.role.iter().enumerate().filter(|(_, of)| usize::from(**of) == role);
        own.clear();
        own.extend(of_role.map(|(source, _)| source as u32));
        *nodes = own.partition_point(|source| (*source as usize) < batch.outputs);
        x.clear();
        own.iter().for_each(|source| x.extend_from_slice(&batch.x[*source as usize * width..][..inputs]));
        rows.clear();
        rows.extend_from_slice(&own[..*nodes]);
        places.clear();
        places.resize(batch.role.len(), u32::MAX);
        rows.iter().zip(0..).for_each(|(source, row)| places[*source as usize] = row);
        first.clear();
        sender.clear();
        features.clear();
        first.push(0);
        let edge_inputs = batch.e.len() / batch.sender.len().max(1);
        for node in &own[..*nodes] {
            let edges = batch.first[*node as usize] as usize..batch.first[*node as usize + 1] as usize;
            features.extend_from_slice(&batch.e[edges.start * edge_inputs..edges.end * edge_inputs]);
            for source in &batch.sender[edges] {
                let place = &mut places[*source as usize];
                if *place == u32::MAX {
                    *place = rows.len() as u32;
                    rows.push(*source);
                }
                sender.push(*place);
            }
            first.push(sender.len() as u32);
        }
    }
}

/// Writes those of the rows of `from` that `rows` lists, of `width` floats each, to `to`.
#[inline(always)]
fn gather<T: Real>(from: &[T], width: usize, rows: &[u32], to: &mut Vec<T>) {
    to.clear();
    rows.iter().for_each(|row| to.extend_from_slice(&from[*row as usize * width..][..width]));
}

/// Writes the rows of `from`, of `width` floats each, to those of `to` that `rows` lists.
#[inline(always)]
fn scatter<T: Real>(from: &[T], width: usize, rows: &[u32], to: &mut [T]) {
    for (row, from) in rows.iter().zip(from.chunks_exact(width)) {
        to[*row as usize * width..][..width].copy_from_slice(from);
    }
}
