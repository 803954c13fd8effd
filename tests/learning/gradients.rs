//! Every derivative of the trainer against central differences in f64: networks of one hop in both architectures, of
//! several hops through time and with memory, and the losses of policy and critic; through late messages, robots
//! without neighbours, and every layer.

use murmurate::policy::manifest::Architecture;
use murmurate::random::{Seed, Stream};
use murmurate_train::batch::Batch;
use murmurate_train::graphs::{Graphs, Window};
use murmurate_train::loss::{self, Sample, Terms};
use murmurate_train::network::layer::Activation;
use murmurate_train::network::shape::{Aggregation, HopShape, MessagePart, UpdatePart, Widths};
use murmurate_train::network::{Shape, TeamNetwork, TeamSpace};
use rand::RngExt;

fn fill(floats: &mut [f32], stream: &mut Stream) {
    floats.iter_mut().for_each(|float| *float = stream.random_range(-1.0..1.0));
}

/// Returns three graphs of three robots: with late sources, with a robot 1 without neighbours, and without any edge.
fn single_graphs(network: &TeamNetwork, stream: &mut Stream) -> Batch<f64> {
    let mut graphs = Graphs::new(3, network.inputs(), network.edge_inputs());
    let heard: [&[(usize, u16)]; 3] =
        [&[(0, 1), (0, 3), (1, 0), (1, 2), (2, 4), (2, 3)], &[(0, 1), (0, 2), (2, 3)], &[]];
    for (extra, edges) in [2, 1, 0].into_iter().zip(heard) {
        // Robot 1 is of the second role, if there is one, and so is every other late source.
        for source in 0..3 + extra {
            let role = (source % 3) % network.networks().len();
            fill(graphs.source(role as u8).1, stream);
        }
        for &(receiver, sender) in edges {
            fill(graphs.edge(receiver, sender), stream);
        }
        graphs.end();
    }
    let mut batch = Batch::default();
    batch.gather((0..3).map(|graph| graphs.window(graph, 1)));
    assert_eq!((batch.outputs, batch.nodes), (9, 9));
    batch
}

/// Returns windows of two rows of three robots, with messages of several ages, some from before the windows. In one row
/// an episode begins within the window.
fn windows(network: &TeamNetwork, stream: &mut Stream) -> Batch<f64> {
    let (widths, memory) = (network.hop_inputs(), network.has_memory());
    let width: usize = widths.iter().sum();
    let mut graphs = Graphs::new(3, network.inputs(), network.edge_inputs()).recurrent(2, widths, memory, 3);
    let mut past = vec![0.0; graphs.last_latents().len()];
    fill(&mut past, stream);
    assert!(graphs.restore_latents(past));
    let heard: [&[(usize, u16, u8)]; 3] =
        [&[(0, 1, 0), (0, 2, 1), (1, 0, 3), (1, 2, 0), (2, 1, 2)], &[(0, 1, 1), (2, 0, 2), (2, 1, 0)], &[(1, 2, 1)]];
    for (graph, edges) in heard.iter().cycle().take(12).enumerate() {
        for _ in 0..3 {
            fill(graphs.source(0).1, stream);
            graphs.begins(graph == 6);
        }
        for &(receiver, sender, age) in *edges {
            fill(graphs.edge_of_age(receiver, sender, age), stream);
        }
        graphs.end();
        let mut latents = vec![0.0; 3 * width];
        fill(&mut latents, stream);
        graphs.store_latents(3, |_| &latents);
    }
    let all = [
        Window { graphs: &graphs, first: 0, steps: 6, lookback: 2, every: 2 },
        Window { graphs: &graphs, first: 3, steps: 3, lookback: 1, every: 1 },
        Window { graphs: &graphs, first: 7, steps: 1, lookback: 0, every: 4 },
    ];
    let mut batch = Batch::default();
    batch.gather(all.iter().copied());
    assert_eq!((batch.outputs, batch.nodes), (15, 30));
    assert!(batch.recorded[0].len() >= 3 * network.hop_inputs()[0], "some messages are from before the windows");
    batch
}

fn one_hop_shapes() -> Vec<Shape> {
    let shape = |architecture, message: &[usize], update: &[usize], edge| {
        Shape::one_hop(architecture, [vec![4, 7, 5], message.to_vec(), update.to_vec()], edge)
    };
    vec![
        shape(Architecture::Published, &[5, 8, 6, 7], &[7, 9, 4], 0),
        shape(Architecture::Published, &[5, 8, 7], &[7, 4], 0),
        shape(Architecture::Full, &[13, 8, 6, 7], &[12, 9, 6, 4], 3),
        shape(Architecture::Full, &[10, 8, 9, 6, 7], &[12, 9, 4], 0),
    ]
}

/// Returns a shape with all these hops, each from its message inputs and update inputs to an output of 4 floats.
fn hops_shape(hops: &[(&[MessagePart], &[UpdatePart])], memory: Option<usize>) -> Shape {
    let mut shape = Shape {
        encoder: Widths { last: Activation::Tanh, ..Widths::rectified(vec![4, 6, 5]) },
        memory,
        hops: Vec::new(),
        decoder: Some(Widths::rectified(vec![4, 4])),
        edge: 3,
    };
    for (index, (message_inputs, update_inputs)) in hops.iter().enumerate() {
        let input = shape.hop_input(index);
        let message: usize = message_inputs.iter().map(|part| if *part == MessagePart::Edge { 3 } else { input }).sum();
        let update: usize = update_inputs.iter().map(|part| if *part == UpdatePart::Own { input } else { 5 }).sum();
        shape.hops.push(HopShape {
            message: Widths::rectified(vec![message, 7, 6, 5]),
            message_inputs: message_inputs.to_vec(),
            aggregation: if index % 2 == 0 { Aggregation::Mean } else { Aggregation::Sum },
            self_loop: false,
            update: Widths::rectified(vec![update, 6, 4]),
            update_inputs: update_inputs.to_vec(),
        });
    }
    shape
}

fn recurrent_shapes() -> Vec<Shape> {
    use MessagePart::{Difference, Edge, Own, Sender};
    let (full, messages) = (&[UpdatePart::Own, UpdatePart::Messages][..], &[UpdatePart::Messages][..]);
    let edges = (&[Edge][..], messages);
    let all = (&[Own, Sender, Edge][..], full);
    let other = (&[Edge, Sender][..], &[UpdatePart::Messages, UpdatePart::Own][..]);
    let mut shapes = vec![
        hops_shape(&[all], None),
        hops_shape(&[edges, other, all], None),
        hops_shape(&[all, other, all, other], None),
        hops_shape(&[all], Some(6)),
        hops_shape(&[other, (&[Own, Edge][..], full), all], Some(5)),
    ];
    // Every kind of activation, of message network and of message to itself.
    for (index, form) in [(&[Difference, Edge][..], messages), all, (&[Sender][..], full)].into_iter().enumerate() {
        let mut shape = hops_shape(&[form, form], (index == 0).then_some(3));
        for hop in &mut shape.hops {
            hop.self_loop = true;
            hop.message.last = [Activation::Relu, Activation::Tanh, Activation::Linear][index];
            (hop.message.between, hop.update.last) = (Activation::Tanh, Activation::Relu);
            hop.message.widths.drain(1..3 - index);
        }
        shapes.push(shape);
    }
    shapes
}

/// Returns the sum of both losses over all robots, and its derivatives by the outputs.
fn lost(outputs: &[f64], samples: &[Sample<f64>]) -> (f64, Vec<f64>) {
    let terms = Terms { clip: 0.2, entropy: 0.03, log_std_max: 0.4, overshoot: 0.7, limit_m_s: 0.2, imitation: 0.4 };
    let (mut sum, mut d_outputs) = (0.0, Vec::new());
    for (outputs, sample) in outputs.chunks_exact(4).zip(samples) {
        let found = loss::policy(outputs, sample, &terms);
        let (value, d_value) = loss::value(outputs[0], 0.3);
        sum += found.loss + value;
        let mut d = found.d_outputs;
        d[0] += d_value;
        d_outputs.extend(d);
    }
    (sum, d_outputs)
}

/// Compares every derivative of a network over a batch with central differences.
fn compare(name: &str, network: &TeamNetwork, batch: &Batch<f64>, stream: &mut Stream) {
    let mut parameters: Vec<f64> = (0..network.parameters()).map(|_| stream.random_range(-0.6..0.6)).collect();
    // Positive biases keep most units active: an inactive one has no gradient.
    for (role, of_role) in network.networks().iter().enumerate() {
        let parameters = &mut parameters[network.place(role)];
        for layer in of_role.layers().concat() {
            parameters[layer.bias()..layer.end()].iter_mut().for_each(|bias| *bias = bias.abs());
        }
    }
    let sample = |stream: &mut Stream| Sample {
        action: [stream.random_range(-1.0..1.0), stream.random_range(-1.0..1.0)],
        taught: Some([stream.random_range(-1.0..1.0), stream.random_range(-1.0..1.0)]),
        log_density: stream.random_range(-2.5..-1.5),
        advantage: stream.random_range(-1.0..1.0),
    };
    let samples: Vec<Sample<f64>> = (0..batch.outputs).map(|_| sample(stream)).collect();
    let mut space = TeamSpace::default();
    network.forward(&parameters, batch, &mut space);
    assert_eq!(space.outputs().len(), 4 * batch.outputs, "{name}");
    let (_, d_outputs) = lost(space.outputs(), &samples);
    let mut gradient = vec![0.0; parameters.len()];
    network.backward(&parameters, batch, &d_outputs, &mut space, &mut gradient);
    let alive = gradient.iter().filter(|g| g.abs() > 1e-9).count();
    assert!(alive * 3 > gradient.len(), "{name}: {alive} of {} parameters matter", gradient.len());

    let mut other = TeamSpace::default();
    let mut worst: f64 = 0.0;
    for at in 0..parameters.len() {
        let (kept, by) = (parameters[at], 1e-6);
        let mut at_offset = |offset: f64| {
            parameters[at] = kept + offset;
            network.forward(&parameters, batch, &mut other);
            lost(other.outputs(), &samples).0
        };
        let difference = (at_offset(by) - at_offset(-by)) / (2.0 * by);
        parameters[at] = kept;
        let error = (difference - gradient[at]).abs() / (1.0 + difference.abs());
        worst = worst.max(error);
        assert!(error < 1e-6, "{name}, parameter {at}: {} by hand, {difference} by difference", gradient[at]);
    }
    println!("{name}: {} parameters, worst relative error {worst:.1e}", parameters.len());
}

#[test]
fn every_derivative_of_networks_over_single_graphs_matches_central_differences() {
    for (index, shape) in one_hop_shapes().into_iter().chain(recurrent_shapes().into_iter().take(1)).enumerate() {
        let mut stream = Seed::of_run(3).stream(&format!("gradients/{index}"));
        let network = TeamNetwork::new(vec![shape]);
        let batch = single_graphs(&network, &mut stream);
        compare(&format!("shape {index}"), &network, &batch, &mut stream);
    }
}

/// Returns the shapes of three roles that hear each other, with observations, layers and activations of their own.
fn shapes_of_roles() -> Vec<Shape> {
    let full = |encoder: &[usize], message: &[usize], update: &[usize]| {
        Shape::one_hop(Architecture::Full, [encoder.to_vec(), message.to_vec(), update.to_vec()], 3)
    };
    let mut with_decoder = full(&[6, 5], &[13, 9, 7], &[12, 6, 5]);
    with_decoder.decoder = Some(Widths::rectified(vec![5, 4]));
    with_decoder.encoder.last = Activation::Tanh;
    vec![full(&[4, 7, 5], &[13, 8, 6, 7], &[12, 9, 6, 4]), full(&[2, 5], &[13, 6, 7], &[12, 4]), with_decoder]
}

#[test]
fn every_derivative_of_networks_of_roles_matches_central_differences() {
    for roles in [2, 3] {
        let mut stream = Seed::of_run(3).stream(&format!("gradients/roles/{roles}"));
        let network = TeamNetwork::new(shapes_of_roles()[..roles].to_vec());
        let batch = single_graphs(&network, &mut stream);
        compare(&format!("{roles} roles"), &network, &batch, &mut stream);
    }
}

#[test]
fn the_loss_of_one_role_reaches_the_encoder_of_the_role_that_it_hears() {
    let mut stream = Seed::of_run(3).stream("gradients/across");
    let network = TeamNetwork::new(shapes_of_roles()[..2].to_vec());
    let mut graphs = Graphs::new(2, network.inputs(), network.edge_inputs());
    (0..2).for_each(|role| fill(graphs.source(role).1, &mut stream));
    fill(graphs.edge(0, 1), &mut stream);
    graphs.end();
    let mut batch = Batch::default();
    batch.gather([graphs.window(0, 1)].into_iter());
    let parameters: Vec<f64> = (0..network.parameters()).map(|_| stream.random_range(0.0..0.6)).collect();
    let mut space = TeamSpace::default();
    network.forward(&parameters, &batch, &mut space);
    let mut gradient = vec![0.0; parameters.len()];
    // A loss of the robot of the first role alone.
    let d_outputs = [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0];
    network.backward(&parameters, &batch, &d_outputs, &mut space, &mut gradient);
    let heard = &gradient[network.place(1)];
    let encoder = network.networks()[1].layers()[0].last().map(|layer| layer.end()).expect("it has layers");
    assert!(heard[..encoder].iter().any(|derivative| derivative.abs() > 1e-9), "what it says is learnt");
    assert!(heard[encoder..].iter().all(|derivative| *derivative == 0.0), "what it does is not");
}

#[test]
fn every_derivative_of_networks_through_time_matches_central_differences() {
    for (index, shape) in one_hop_shapes().into_iter().chain(recurrent_shapes()).enumerate() {
        let mut stream = Seed::of_run(3).stream(&format!("gradients/time/{index}"));
        let network = TeamNetwork::new(vec![shape]);
        let batch = windows(&network, &mut stream);
        compare(&format!("shape {index} through time"), &network, &batch, &mut stream);
    }
}

#[test]
fn the_policy_loss_is_flat_where_it_is_clipped_and_where_the_deviation_is_capped() {
    let terms = Terms { clip: 0.2, entropy: 0.0, log_std_max: -1.0, overshoot: 0.0, limit_m_s: 1.0, imitation: 0.0 };
    // Much more likely than before, with a positive advantage: clipped.
    let far = Sample { action: [0.0, 0.0], taught: None, log_density: -5.0f64, advantage: 1.0 };
    assert_eq!(loss::policy(&[0.0, 0.0, -2.0, -2.0], &far, &terms).d_outputs, [0.0; 4]);
    // With a negative advantage: not clipped.
    let bad = Sample { advantage: -1.0, ..far };
    assert!(loss::policy(&[0.1, 0.0, -2.0, -2.0], &bad, &terms).d_outputs[0] != 0.0);
    let capped = loss::policy(&[0.1, 0.2, 0.0, 0.0], &Sample { log_density: -0.5, ..bad }, &terms);
    assert_eq!(capped.d_outputs[2..], [0.0; 2], "above its cap a deviation has no say");
}

#[test]
fn a_mean_beyond_the_limit_costs_the_square_of_what_is_beyond() {
    // The advantage is zero, so nothing else has a derivative by the means.
    let sample = Sample { action: [0.0, 0.0], taught: None, log_density: -2.0f64, advantage: 0.0 };
    let found = |overshoot, mean: [f64; 2]| {
        let terms = Terms { clip: 0.2, entropy: 0.0, log_std_max: 0.0, overshoot, limit_m_s: 1.0, imitation: 0.0 };
        loss::policy(&[mean[0], mean[1], -1.0, -1.0], &sample, &terms)
    };
    let beyond = found(2.0, [1.5, -3.0]);
    assert_eq!((beyond.loss, [beyond.d_outputs[0], beyond.d_outputs[1]]), (2.0 * (0.25 + 4.0), [2.0, -8.0]));
    let within = found(2.0, [1.0, -0.9]);
    assert_eq!((within.loss, within.d_outputs), (0.0, [0.0; 4]));
    assert_eq!(found(0.0, [1.5, -3.0]).loss, 0.0, "it has no price unless the configuration says so");
}

#[test]
fn a_mean_other_than_what_was_taught_costs_the_square_of_the_difference() {
    let terms = Terms { clip: 0.2, entropy: 0.0, log_std_max: 0.0, overshoot: 0.0, limit_m_s: 1.0, imitation: 0.5 };
    let found = |taught: Option<[f64; 2]>| {
        let sample = Sample { action: [0.0, 0.0], taught, log_density: -2.0f64, advantage: 0.0 };
        loss::policy(&[0.5, -0.25, -1.0, -1.0], &sample, &terms)
    };
    let disagreement = found(Some([-0.5, 0.25]));
    assert_eq!(
        (disagreement.disagreement, disagreement.loss, disagreement.d_outputs),
        (1.25, 0.625, [1.0, -0.5, 0.0, 0.0])
    );
    assert_eq!((found(None).loss, found(None).disagreement), (0.0, 0.0), "without an expert nothing was taught");
}
