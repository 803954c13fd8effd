//! Update of a hop of format 1, with the layers before and after the sum folded into one.
//!
//! In format 1 the last message layer is linear and the messages are summed, so that layer is applied once, after the
//! sum. The first update layer is linear up to its activation, so both are one layer. This changes the last digits of
//! the results, so the format of the file fixes it: a hop of format 2 is computed as its file says.

use super::perceptron::{Activation, Buffers, Perceptron};
use crate::policy::mlp::{Layer, Relu};

/// Update of a hop whose messages are summed, from the sum of what comes before the last message layer.
#[derive(Debug)]
pub(crate) struct Folded {
    /// Term of the robot itself in the sum; empty if it is not one of its own neighbours.
    own_term: Vec<f32>,
    /// The last message layer and the first update layer folded into one, without the robot's own part.
    aggregate: Layer,
    /// Contribution of each term of the sum to the output of `aggregate`: the bias of the last message layer.
    term_bias: Vec<f32>,
    /// Part of the first update layer that takes the robot's own input; `None` if it takes none.
    own: Option<Layer>,
    /// All update layers but the first; `None` if that is the last one, too.
    rest: Option<Perceptron>,
}

/// Buffers of a folded update.
#[derive(Debug, Default)]
pub(crate) struct Space {
    aggregate: Vec<f32>,
    own: Vec<f32>,
}

impl Folded {
    /// Folds the last of the layers of a message network, `last`, with an update network of the layers `update`. The
    /// first `own` inputs of these are the robot's own. `own_term` is the term of the robot itself in the sum.
    ///
    /// # Panics
    /// If the layers do not fit each other.
    pub fn new(own_term: Vec<f32>, last: &Layer, update: &[Layer], own: usize) -> Folded {
        let (first, rest) = update.split_first().expect("a perceptron has a layer");
        let (own, first) = match own {
            0 => (None, first.clone()),
            _ => {
                let (own, first) = first.split(own);
                (Some(own), first)
            }
        };
        let (aggregate, term_bias) = first.fold_after(last);
        let rest = (!rest.is_empty()).then(|| Perceptron::new(rest.to_vec(), Activation::Relu, Activation::Linear));
        Folded { own_term, aggregate, term_bias, own, rest }
    }

    /// Returns the number of outputs.
    pub fn outputs(&self) -> usize {
        self.rest.as_ref().map_or(self.aggregate.outputs(), Perceptron::outputs)
    }

    /// Makes the buffers have the lengths that `apply` needs.
    pub fn reserve(&self, space: &mut Space, buffers: &mut Buffers) {
        space.aggregate.resize(self.aggregate.outputs(), 0.0);
        space.own.resize(self.aggregate.outputs(), 0.0);
        self.rest.iter().for_each(|rest| buffers.reserve(rest, 1));
    }

    /// Writes the sum before any message into `sum`: the robot's own term, or zero.
    #[inline(always)]
    pub fn begin(&self, sum: &mut [f32]) {
        match &self.own_term[..] {
            [] => sum.fill(0.0),
            term => sum.copy_from_slice(term),
        }
    }

    /// Computes the output of the hop for a robot with the input `own` from the `sum` of `count` messages.
    #[inline(always)]
    pub fn apply(
        &self,
        (own, sum, count): (&[f32], &[f32], usize),
        space: &mut Space,
        out: &mut [f32],
        buffers: &mut Buffers,
    ) {
        let Space { aggregate, own: of_own } = space;
        self.aggregate.apply(1, sum, aggregate, Relu::None);
        if let Some(layer) = &self.own {
            layer.apply(1, own, of_own, Relu::None);
            aggregate.iter_mut().zip(of_own).for_each(|(sum, own)| *sum += *own);
        }
        let terms = (count + usize::from(!self.own_term.is_empty())) as f32;
        aggregate.iter_mut().zip(&self.term_bias).for_each(|(sum, bias)| *sum += terms * bias);
        match &self.rest {
            None => out.copy_from_slice(aggregate),
            Some(rest) => {
                aggregate.iter_mut().for_each(|sum| *sum = sum.max(0.0));
                rest.apply(1, aggregate, out, buffers);
            }
        }
    }
}
