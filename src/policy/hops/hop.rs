//! One hop: the messages of a robot's neighbours, their aggregation, and the update of the robot's own part.

use super::attention;
use super::folded::{self, Folded};
use super::manifest::{self, Aggregation, EdgeFeature, Input, SelfLoop};
use super::perceptron::{Activation, Buffers, Perceptron};
use crate::messages::geometry::{Motion, Planar};
use crate::policy::Neighbour;
use crate::policy::manifest::{Architecture, EdgeField};
use crate::policy::mlp::{Layer, Relu};

/// Network of a hop, such as the message network, with the parts of its input.
#[derive(Debug)]
struct Part {
    /// Parts of the network's input, which lie one after the other, but for those that `own` takes.
    inputs: Vec<Input>,
    /// Part of the first layer that takes the robot's own input, which is the same for all neighbours; `None` if the
    /// perceptron takes all inputs itself.
    own: Option<Layer>,
    /// Layers of the network with their weights.
    perceptron: Perceptron,
}

impl Part {
    /// Makes a network that is computed for each neighbour. If its first input is the robot's own, of `own` floats,
    /// that part of the first layer is computed once for all of them. The sums of the others go on from it, so the bits
    /// are those of the whole layer.
    fn of_senders(inputs: &[Input], perceptron: Perceptron, own: usize) -> Part {
        let split = (inputs.first() == Some(&Input::Own)).then(|| perceptron.split(own)).flatten();
        match split {
            Some((own, perceptron)) => Part { inputs: inputs[1..].to_vec(), own: Some(own), perceptron },
            None => Part { inputs: inputs.to_vec(), own: None, perceptron },
        }
    }
}

/// Last part of a hop, which makes its output.
#[derive(Debug)]
enum Update {
    /// The output is the aggregated messages.
    Messages,
    /// Network of the robot's own input and the aggregated messages.
    Network(Part),
    /// Update of format 1.
    Folded(Folded),
}

/// One hop of a policy with the weights of its networks: computes the hop's output for a robot from the messages of its
/// neighbours.
#[derive(Debug)]
pub struct Hop {
    /// First float of the hop's input in a latent.
    begins: usize,
    /// Width of the hop's input.
    input: usize,
    /// Width of a message.
    messages: usize,
    edge: Vec<EdgeFeature>,
    aggregation: Aggregation,
    heads: usize,
    self_loop: Option<SelfLoop>,
    /// Whether the message network takes the difference of the sender's input from the robot's own in its place.
    relative: bool,
    message: Option<Part>,
    score: Option<Part>,
    query: Option<Perceptron>,
    key: Option<Part>,
    update: Update,
}

/// Buffers of one robot for one hop. They grow only in a step in which the robot has more neighbours than ever before.
#[derive(Debug, Default)]
pub(crate) struct Space {
    /// Edge features, one row for each sender; with a self-loop, the robot's own last.
    edges: Vec<f32>,
    work: Work,
    messages: Vec<f32>,
    keys: Vec<f32>,
    query: Vec<f32>,
    scores: Vec<f32>,
    sum: Vec<f32>,
    folded: folded::Space,
    /// Number of senders that the buffers have room for.
    capacity: usize,
}

/// Buffers for the network of a hop that is computed.
#[derive(Debug, Default)]
struct Work {
    /// Input of the network, one row for each sender.
    rows: Vec<f32>,
    /// Contribution of the robot's own input to the first layer.
    start: Vec<f32>,
    buffers: Buffers,
}

/// Senders of the messages of a hop: the neighbours and, with a self-loop, the robot itself as the last.
#[derive(Clone, Copy, Debug)]
struct Senders<'a> {
    /// Input of the hop of the robot itself.
    own: &'a [f32],
    /// Place of the hop's input in a latent.
    place: (usize, usize),
    neighbours: &'a [Neighbour<'a>],
    /// Edge features, `edge` floats for each sender.
    edges: &'a [f32],
    edge: usize,
    count: usize,
}

impl<'a> Senders<'a> {
    /// Returns the input of the hop of the sender with the index `at`.
    #[inline(always)]
    fn input(&self, at: usize) -> &'a [f32] {
        match self.neighbours.get(at) {
            Some(neighbour) => &neighbour.features[self.place.0..self.place.1],
            None => self.own,
        }
    }
}

impl Hop {
    /// Makes a hop with the networks and the aggregation that `form` states. Its input is `input` floats of a latent,
    /// from the index `begins`. `edge` are the policy's edge features, and `load` returns the weights of a network of
    /// the hop by the network's name.
    ///
    /// # Errors
    /// The error of `load`.
    pub(crate) fn new<E>(
        form: &manifest::Hop,
        (begins, input): (usize, usize),
        edge: &[EdgeFeature],
        mut load: impl FnMut(&str, &manifest::Layers) -> Result<Perceptron, E>,
    ) -> Result<Hop, E> {
        let mut part = |name: &str, layers: &Option<manifest::Layers>| {
            let part = |layers: &manifest::Layers| Ok(Part::of_senders(&layers.inputs, load(name, layers)?, input));
            layers.as_ref().map(part).transpose()
        };
        let (message, score, key) =
            (part("message", &form.message)?, part("score", &form.score)?, part("key", &form.key)?);
        let update = match &form.update {
            None => Update::Messages,
            Some(layers) => {
                Update::Network(Part { inputs: layers.inputs.clone(), own: None, perceptron: load("update", layers)? })
            }
        };
        Ok(Hop {
            begins,
            input,
            messages: form.message_width(input),
            edge: edge.to_vec(),
            aggregation: form.aggregation,
            heads: form.heads.unwrap_or(1),
            self_loop: form.self_loop,
            relative: false,
            message,
            score,
            query: form.query.as_ref().map(|layers| load("query", layers)).transpose()?,
            key,
            update,
        })
    }

    /// Makes the only hop of a policy of format 1, whose input is `input` floats, from the layers of its message and
    /// its update network and its edge features.
    ///
    /// # Panics
    /// If the layers do not fit each other.
    pub(crate) fn of_format_1(
        architecture: Architecture,
        input: usize,
        edge: &[EdgeField],
        [message, update]: [&[Layer]; 2],
    ) -> Hop {
        let (last, rest) = message.split_last().expect("a perceptron has a layer");
        let perceptron = match rest {
            [] => Perceptron::unchanged(last.inputs()),
            rest => Perceptron::new(rest.to_vec(), Activation::Relu, Activation::Relu),
        };
        let messages = perceptron.outputs();
        let (relative, inputs, own_term, own): (bool, &[Input], Vec<f32>, usize) = match architecture {
            Architecture::Published => (true, &[Input::Sender], of_zeros(&perceptron), 0),
            Architecture::Full => (false, &[Input::Own, Input::Sender, Input::Edge], Vec::new(), input),
        };
        Hop {
            begins: 0,
            input,
            messages,
            edge: edge.iter().copied().map(EdgeFeature::from).collect(),
            aggregation: Aggregation::Sum,
            heads: 1,
            self_loop: None,
            relative,
            message: Some(Part::of_senders(inputs, perceptron, input)),
            score: None,
            query: None,
            key: None,
            update: Update::Folded(Folded::new(own_term, last, update, own)),
        }
    }

    /// Returns the index of the first float of the hop's input in a latent.
    pub(crate) fn begins(&self) -> usize {
        self.begins
    }

    /// Returns the number of floats of the hop's input.
    pub(crate) fn inputs(&self) -> usize {
        self.input
    }

    /// Returns the number of floats of the hop's output.
    pub(crate) fn outputs(&self) -> usize {
        match &self.update {
            Update::Messages => self.messages,
            Update::Network(part) => part.perceptron.outputs(),
            Update::Folded(folded) => folded.outputs(),
        }
    }

    /// Enlarges the buffers `space` so that `apply` can be called with the given number of neighbours.
    pub(crate) fn reserve(&self, space: &mut Space, neighbours: usize) {
        let senders = neighbours + usize::from(self.self_loop.is_some());
        if space.capacity >= senders.max(1) {
            return;
        }
        // At least one row, which the networks of the robot itself need, too.
        space.capacity = senders.max(1);
        let rows = space.capacity;
        let parts = || [&self.message, &self.score, &self.key].into_iter().flatten();
        let edge: usize = self.edge.iter().map(|feature| feature.floats()).sum();
        space.edges.resize(rows * edge, 0.0);
        let widest = parts().map(|part| part.perceptron.inputs()).max().unwrap_or(0);
        space.work.rows.resize(rows * widest, 0.0);
        let start = parts().filter_map(|part| part.own.as_ref()).map(Layer::outputs).max();
        space.work.start.resize(start.unwrap_or(0), 0.0);
        space.messages.resize(rows * self.messages, 0.0);
        space.keys.resize(rows * self.key.as_ref().map_or(0, |key| key.perceptron.outputs()), 0.0);
        space.query.resize(self.query.as_ref().map_or(0, Perceptron::outputs), 0.0);
        space.scores.resize(rows * self.heads, 0.0);
        space.sum.resize(self.messages, 0.0);
        parts().for_each(|part| space.work.buffers.reserve(&part.perceptron, rows));
        self.query.iter().for_each(|query| space.work.buffers.reserve(query, 1));
        match &self.update {
            Update::Messages => {}
            Update::Network(part) => {
                space.work.buffers.reserve(&part.perceptron, 1);
                space.work.rows.resize(space.work.rows.len().max(part.perceptron.inputs()), 0.0);
            }
            Update::Folded(folded) => folded.reserve(&mut space.folded, &mut space.work.buffers),
        }
    }

    /// Computes the hop for a robot with the state `motion` in the policy frame. `latent` is the robot's own, which
    /// holds the hop's input, and `neighbours` are those in range, in the order of their ids. `out` receives the
    /// hop's output. `space` has room for as many neighbours, made by `reserve`.
    #[inline(always)]
    pub(crate) fn apply(
        &self,
        motion: &Motion,
        latent: &[f32],
        neighbours: &[Neighbour],
        space: &mut Space,
        out: &mut [f32],
    ) {
        let own = &latent[self.begins..][..self.input];
        let count = self.write_edges(motion, neighbours, space);
        let Space { edges, work, messages, keys, query, scores, sum, folded, .. } = space;
        let (place, edge) = ((self.begins, self.begins + self.input), edges.len() / space.capacity);
        let senders = Senders { own, place, neighbours, edges, edge, count };
        match &self.message {
            Some(part) => self.of_senders(part, senders, work, messages),
            None => {
                let rows = messages.chunks_exact_mut(self.input).take(count).enumerate();
                rows.for_each(|(at, row)| row.copy_from_slice(senders.input(at)));
            }
        }
        if let Some(part) = &self.score {
            self.of_senders(part, senders, work, scores);
        }
        if let Some(part) = &self.key {
            self.of_senders(part, senders, work, keys);
        }
        if let Some(perceptron) = &self.query {
            perceptron.apply(1, own, query, &mut work.buffers);
            attention::dot_products(count, self.heads, query, keys, scores);
        }
        match (self.aggregation, &self.update) {
            (_, Update::Folded(folded)) => {
                folded.begin(sum);
                attention::add(count, messages, sum);
            }
            (Aggregation::Sum | Aggregation::Mean | Aggregation::Max, _) => {
                attention::plain(self.aggregation, count, messages, sum);
            }
            (Aggregation::Softmax | Aggregation::DotProduct, _) => {
                attention::softmax(count, self.heads, scores);
                attention::weighted_sum(count, self.heads, scores, messages, sum);
            }
        }
        match &self.update {
            Update::Messages => out.copy_from_slice(sum),
            Update::Network(part) => {
                let row = &mut work.rows[..part.perceptron.inputs()];
                compose(&part.inputs, |input| if input == Input::Own { own } else { sum }, row);
                part.perceptron.apply(1, row, out, &mut work.buffers);
            }
            Update::Folded(update) => update.apply((own, sum, count), folded, out, &mut work.buffers),
        }
    }

    /// Computes the network `part` for each of the `senders`; `out` receives a row for each.
    #[inline(always)]
    fn of_senders(&self, part: &Part, senders: Senders, work: &mut Work, out: &mut [f32]) {
        let Work { rows, start, buffers } = work;
        let Senders { own, edges, edge, count, .. } = senders;
        for (at, row) in rows.chunks_exact_mut(part.perceptron.inputs()).take(count).enumerate() {
            let of = |input: Input| match input {
                Input::Own => own,
                Input::Sender => senders.input(at),
                Input::Edge => &edges[at * edge..][..edge],
                Input::Messages => &[],
            };
            compose(&part.inputs, of, row);
            if self.relative {
                row.iter_mut().zip(own).for_each(|(theirs, mine)| *theirs -= mine);
            }
        }
        let of_own: Option<&[f32]> = match &part.own {
            Some(layer) => {
                layer.apply(1, own, start, Relu::None);
                Some(start)
            }
            None => None,
        };
        part.perceptron.apply_from(of_own, count, rows, out, buffers);
    }

    /// Writes the features of the senders' edges into `space`, and returns the number of senders: the neighbours, and
    /// with a self-loop the robot itself as the last.
    #[inline(always)]
    fn write_edges(&self, motion: &Motion, neighbours: &[Neighbour], space: &mut Space) -> usize {
        let edge = space.edges.len() / space.capacity;
        let count = neighbours.len();
        if edge > 0 {
            for (row, neighbour) in space.edges.chunks_exact_mut(edge).zip(neighbours) {
                write_edge(&self.edge, motion, (&neighbour.motion, neighbour.age.as_secs() as f32), row);
            }
        }
        let Some(self_loop) = self.self_loop else { return count };
        if edge > 0 {
            let (edges, mine) = space.edges.split_at_mut(count * edge);
            match self_loop {
                SelfLoop::ZeroEdge => mine[..edge].fill(0.0),
                SelfLoop::MeanEdge => attention::plain(Aggregation::Mean, count, edges, &mut mine[..edge]),
            }
        }
        count + 1
    }
}

/// Returns the outputs of a perceptron for an input of zeros.
fn of_zeros(perceptron: &Perceptron) -> Vec<f32> {
    let (mut outputs, mut buffers) = (vec![0.0; perceptron.outputs()], Buffers::default());
    buffers.reserve(perceptron, 1);
    perceptron.apply(1, &vec![0.0; perceptron.inputs()], &mut outputs, &mut buffers);
    outputs
}

/// Writes the parts `inputs` one after the other into `row`; `of` returns the numbers of a part.
#[inline(always)]
fn compose<'a>(inputs: &[Input], of: impl Fn(Input) -> &'a [f32], row: &mut [f32]) {
    let mut rest = row;
    for input in inputs {
        let part = of(*input);
        let (to, after) = rest.split_at_mut(part.len());
        to.copy_from_slice(part);
        rest = after;
    }
}

/// Writes the features of the edge to a robot with the state `own` into `row`, from a neighbour that had the state
/// `sent` when it sent its message, which is `age_s` \[s\] old. Both states are in the policy frame.
#[inline(always)]
pub fn write_edge(edge: &[EdgeFeature], own: &Motion, (sent, age_s): (&Motion, f32), row: &mut [f32]) {
    let mut rest = row;
    let relative = sent.position - own.position;
    for feature in edge {
        let (to, after) = rest.split_at_mut(feature.floats());
        match feature {
            EdgeFeature::Age => to[0] = age_s,
            EdgeFeature::RelativePosition => to.copy_from_slice(&relative.to_array()),
            EdgeFeature::Distance => to[0] = relative.norm(),
            EdgeFeature::RelativeVelocity => {
                to.copy_from_slice(&(sent.velocity - own.velocity).to_array());
            }
        }
        rest = after;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Vec2;
    use crate::policy::hops::manifest::Layers;
    use crate::time::Span;

    fn layers(inputs: &[Input], widths: &[usize]) -> Option<Layers> {
        let (inputs, widths) = (inputs.to_vec(), widths.to_vec());
        Some(Layers { inputs, widths, activation: None, output_activation: Activation::Linear })
    }

    fn form(aggregation: Aggregation) -> manifest::Hop {
        let none = || None;
        manifest::Hop {
            message: none(),
            aggregation,
            heads: None,
            score: none(),
            query: none(),
            key: none(),
            self_loop: None,
            update: none(),
        }
    }

    /// Applies a hop with single layers of these weights, without biases, to a robot at (1, 0) whose input is 10.
    /// Neighbours with the inputs 3, 5, ... are 1 m apart from each other on the x axis, from (2, 0) on. The floats
    /// before the hop's own in each latent are of another hop.
    fn applied(form: &manifest::Hop, edge: &[EdgeFeature], weights: &[(&str, &[f32])], neighbours: usize) -> Vec<f32> {
        let load = |name: &str, layers: &Layers| {
            let weight = weights.iter().find(|(of, _)| *of == name).expect("the test has its weights").1;
            let layer = Layer::new(weight, &vec![0.0; layers.outputs()]);
            Ok::<_, ()>(Perceptron::new(vec![layer], Activation::Linear, layers.output_activation))
        };
        let hop = Hop::new(form, (1, 1), edge, load).expect("nothing fails");
        let latents: Vec<[f32; 3]> = (0..neighbours).map(|k| [99.0, 3.0 + 2.0 * k as f32, 77.0]).collect();
        let neighbour = |(k, features): (usize, &'_ [f32; 3])| Neighbour {
            motion: Motion { position: Vec2::new(2.0 + k as f32, 0.0), velocity: Vec2::new(0.0, 4.0) },
            features: &latents[k][..features.len()],
            age: Span::from_millis(500),
        };
        let neighbours: Vec<Neighbour> = latents.iter().enumerate().map(neighbour).collect();
        let own = Motion { position: Vec2::new(1.0, 0.0), velocity: Vec2::new(1.0, 1.0) };
        let (mut space, mut out) = (Space::default(), vec![f32::NAN; hop.outputs()]);
        hop.reserve(&mut space, neighbours.len());
        hop.apply(&own, &[88.0, 10.0, 66.0], &neighbours, &mut space, &mut out);
        out
    }

    #[test]
    fn without_networks_a_hop_aggregates_the_neighbours_inputs() {
        for (aggregation, expected) in [(Aggregation::Sum, 8.0), (Aggregation::Mean, 4.0), (Aggregation::Max, 5.0)] {
            assert_eq!(applied(&form(aggregation), &[], &[], 2), [expected]);
            assert_eq!(applied(&form(aggregation), &[], &[], 0), [0.0]);
        }
        let with_itself = manifest::Hop { self_loop: Some(SelfLoop::ZeroEdge), ..form(Aggregation::Mean) };
        assert_eq!(applied(&with_itself, &[], &[], 2), [6.0]);
        assert_eq!(applied(&with_itself, &[], &[], 0), [10.0]);
    }

    #[test]
    fn messages_and_updates_take_their_inputs_in_the_order_of_the_manifest() {
        let form = manifest::Hop {
            message: layers(&[Input::Edge, Input::Sender, Input::Own], &[8, 2]),
            update: layers(&[Input::Messages, Input::Own], &[3, 1]),
            ..form(Aggregation::Sum)
        };
        let edge =
            [EdgeFeature::Distance, EdgeFeature::Age, EdgeFeature::RelativeVelocity, EdgeFeature::RelativePosition];
        // The first message: distance 1, age 0.5, velocity (-1, 3), position (1, 0), sender 3, own 10.
        #[rustfmt::skip]
        let message = [
            1.0, 10.0, 100.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            0.0, 0.0, 0.0, 1.0, 10.0, 100.0, 1000.0, 10000.0,
        ];
        let of = |update: &[f32]| applied(&form, &edge, &[("message", &message), ("update", update)], 1)[0];
        assert_eq!(of(&[1.0, 0.0, 0.0]), 1.0 + 5.0 - 100.0);
        assert_eq!(of(&[0.0, 1.0, 0.0]), 3.0 + 10.0 + 3000.0 + 100_000.0);
        assert_eq!(of(&[0.0, 0.0, 1.0]), 10.0);
    }

    #[test]
    fn softmax_weighs_messages_by_the_scores_of_their_edges() {
        let form = manifest::Hop {
            score: layers(&[Input::Edge], &[1, 1]),
            self_loop: Some(SelfLoop::ZeroEdge),
            ..form(Aggregation::Softmax)
        };
        // The distances are 1 m, 2 m and, to itself, 0: weights 2, 4 and 1 of 7.
        let score = [2.0f32.ln()];
        let [found] = applied(&form, &[EdgeFeature::Distance], &[("score", &score)], 2)[..] else {
            panic!("one number")
        };
        assert!((found - (2.0 * 3.0 + 4.0 * 5.0 + 10.0) / 7.0).abs() < 1e-5, "{found}");
        let mean_edge = manifest::Hop { self_loop: Some(SelfLoop::MeanEdge), ..form };
        let [found] = applied(&mean_edge, &[EdgeFeature::Distance], &[("score", &score)], 2)[..] else { panic!("one") };
        let middle = 2.0f32.powi(3).sqrt();
        assert!((found - (2.0 * 3.0 + 4.0 * 5.0 + middle * 10.0) / (6.0 + middle)).abs() < 1e-5, "{found}");
        assert_eq!(applied(&mean_edge, &[EdgeFeature::Distance], &[("score", &score)], 0), [10.0]);
    }

    #[test]
    fn dot_products_of_query_and_keys_weigh_messages() {
        let form = manifest::Hop {
            query: layers(&[Input::Own], &[1, 1]),
            key: layers(&[Input::Sender], &[1, 1]),
            ..form(Aggregation::DotProduct)
        };
        // Query 10 x 0.1 = 1; keys 3 and 5 times ln(2) / 2, so the second weighs twice the first.
        let weights: [(&str, &[f32]); 2] = [("query", &[0.1]), ("key", &[2.0f32.ln() / 2.0])];
        let [found] = applied(&form, &[], &weights, 2)[..] else { panic!("one number") };
        assert!((found - 13.0 / 3.0).abs() < 1e-5, "{found}");
        assert_eq!(applied(&form, &[], &weights, 0), [0.0]);
    }
}
