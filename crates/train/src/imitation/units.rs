//! Units of a network while it learns by imitation: lengths and speeds of the scenario become numbers of about one, in
//! which a step of the optimiser is the same for all weights. Weights of policy files are for metres and seconds.

use super::config::Imitation;
use crate::network::Shape;
use crate::network::shape::MessagePart;
use murmurate::observation::Unit;
use murmurate::policy::hops::entry::Entry;
use murmurate::policy::hops::file::Tensors;
use murmurate::policy::hops::manifest::{EdgeFeature, Manifest};
use murmurate::policy::manifest::Field;

/// Factors between metres and seconds and what the network takes and gives.
#[derive(Clone, Debug, PartialEq)]
pub struct Units {
    /// Factor of each input of the encoder.
    pub observation: Vec<f32>,
    /// Factor of each edge feature.
    pub edge: Vec<f32>,
    /// Velocity \[m/s\] or acceleration \[m/s²\] that is 1 in the outputs.
    pub action: f32,
}

impl Units {
    /// Returns the units of a policy with this manifest.
    pub fn new(manifest: &Manifest, imitation: &Imitation) -> Units {
        let (of_length, of_speed) = (1.0 / imitation.length_m, 1.0 / imitation.speed_m_s);
        let of_field = |field: Field| match field {
            Field::GoalMinusPosition | Field::Position | Field::PositionPlusVelocity => of_length,
            Field::Velocity => of_speed,
            Field::FilterAndLag => 1.0,
        };
        let of_entry = |entry: &Entry| match entry {
            Entry::Field(field) => of_field(*field),
            Entry::Channel(channel) => match channel.observed.unit {
                Unit::Metre => of_length,
                Unit::MetrePerSecond | Unit::MetrePerSecondSquared => of_speed,
                Unit::Radian | Unit::RadianPerSecond | Unit::Second | Unit::One => 1.0,
            },
        };
        let of_edge = |feature: &EdgeFeature| match feature {
            EdgeFeature::Age => 1.0,
            EdgeFeature::RelativePosition | EdgeFeature::Distance => of_length,
            EdgeFeature::RelativeVelocity => of_speed,
        };
        let repeat = |factor: f32, floats: usize| std::iter::repeat_n(factor, floats);
        Units {
            observation: manifest.observation.iter().flat_map(|one| repeat(of_entry(one), one.floats())).collect(),
            edge: manifest.edge.iter().flat_map(|feature| repeat(of_edge(feature), feature.floats())).collect(),
            action: imitation.speed_m_s,
        }
    }

    /// Returns the weights of the network for metres and seconds. `tensors` are those of its parts, as
    /// `Network::tensors` returns them.
    pub fn in_metres(&self, shape: &Shape, mut tensors: Tensors) -> Tensors {
        let columns = |weights: &mut [f32], inputs: usize, first: usize, factors: &[f32]| {
            for row in weights.chunks_exact_mut(inputs) {
                row[first..].iter_mut().zip(factors).for_each(|(weight, factor)| *weight *= factor);
            }
        };
        columns(&mut tensors[0][0].0, shape.encoder.widths[0], 0, &self.observation);
        let first_hop = 1 + usize::from(shape.memory.is_some());
        for (index, hop) in shape.hops.iter().enumerate() {
            let before = hop.message_inputs.iter().take_while(|part| **part != MessagePart::Edge);
            let before = before.count() * shape.hop_input(index);
            columns(&mut tensors[first_hop + 2 * index][0].0, hop.message.widths[0], before, &self.edge);
        }
        let (weights, biases) = tensors.last_mut().and_then(|decoder| decoder.last_mut()).expect("it has a decoder");
        // The first two outputs are the means; the others are parameters of deviations, which are not learnt.
        let inputs = weights.len() / biases.len();
        weights[..2 * inputs].iter_mut().chain(&mut biases[..2]).for_each(|weight| *weight *= self.action);
        tensors
    }
}

/// Multiplies values by their factors.
pub fn scale(values: &mut [f32], factors: &[f32]) {
    values.iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
}
