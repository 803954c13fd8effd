//! Every derivative of the trainer against central differences in f64: both architectures, the losses of policy and
//! critic, through late sources, robots without neighbours, and every layer.

use murmurate::policy::manifest::Architecture;
use murmurate::random::{Seed, Stream};
use murmurate_train::batch::{Batch, Graphs};
use murmurate_train::loss::{self, Sample, Terms};
use murmurate_train::network::{Shape, Space, TrainableGnn};
use rand::RngExt;

/// Returns graphs of three robots: with late sources, with a robot 1 without neighbours, and without any edge.
fn graphs(inputs: usize, edge: usize, stream: &mut Stream) -> Graphs {
    let mut graphs = Graphs::new(3, inputs, edge);
    let heard: [&[(usize, u16)]; 3] =
        [&[(0, 1), (0, 3), (1, 0), (1, 2), (2, 4), (2, 3)], &[(0, 1), (0, 2), (2, 3)], &[]];
    for (extra, edges) in [2, 1, 0].into_iter().zip(heard) {
        for _ in 0..3 + extra {
            graphs.source().1.iter_mut().for_each(|float| *float = stream.random_range(-1.0..1.0));
        }
        for &(receiver, sender) in edges {
            graphs.edge(receiver, sender).iter_mut().for_each(|float| *float = stream.random_range(-1.0..1.0));
        }
        graphs.end();
    }
    graphs
}

fn shapes() -> Vec<Shape> {
    let shape = |architecture, message: &[usize], update: &[usize], edge| Shape {
        architecture,
        encoder: vec![4, 7, 5],
        message: message.to_vec(),
        update: update.to_vec(),
        edge,
    };
    vec![
        shape(Architecture::Published, &[5, 8, 6, 7], &[7, 9, 4], 0),
        shape(Architecture::Published, &[5, 8, 7], &[7, 4], 0),
        shape(Architecture::Full, &[13, 8, 6, 7], &[12, 9, 6, 4], 3),
        shape(Architecture::Full, &[10, 8, 9, 6, 7], &[12, 9, 4], 0),
    ]
}

/// Returns the sum of both losses over all robots, and its derivatives by the outputs.
fn lost(outputs: &[f64], samples: &[Sample<f64>]) -> (f64, Vec<f64>) {
    let terms = Terms { clip: 0.2, entropy: 0.03, log_std_max: 0.4, overshoot: 0.7, limit_m_s: 0.2 };
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

#[test]
fn every_derivative_matches_central_differences() {
    for (index, shape) in shapes().into_iter().enumerate() {
        let mut stream = Seed::of_run(3).stream(&format!("gradients/{index}"));
        let network = TrainableGnn::new(shape);
        let graphs = graphs(network.inputs(), network.shape().edge, &mut stream);
        let mut batch = Batch::default();
        batch.gather((0..3).map(|graph| (&graphs, graph)));
        let mut parameters: Vec<f64> = (0..network.parameters()).map(|_| stream.random_range(-0.6..0.6)).collect();
        // Positive biases keep most units active: an inactive one has no gradient.
        for (_, _, bias, end) in network.layers().concat() {
            parameters[bias..end].iter_mut().for_each(|bias| *bias = bias.abs());
        }
        let samples: Vec<Sample<f64>> = (0..9)
            .map(|_| Sample {
                action: [stream.random_range(-1.0..1.0), stream.random_range(-1.0..1.0)],
                log_density: stream.random_range(-2.5..-1.5),
                advantage: stream.random_range(-1.0..1.0),
            })
            .collect();
        let mut space = Space::default();
        network.forward(&parameters, &batch, &mut space);
        let (_, d_outputs) = lost(space.outputs(), &samples);
        let mut gradient = vec![0.0; parameters.len()];
        network.backward(&parameters, &batch, &d_outputs, &mut space, &mut gradient);
        let alive = gradient.iter().filter(|g| g.abs() > 1e-9).count();
        assert!(alive * 3 > gradient.len(), "{alive} of {} parameters matter", gradient.len());

        let mut other = Space::default();
        let mut worst: f64 = 0.0;
        for at in 0..parameters.len() {
            let (kept, by) = (parameters[at], 1e-6);
            let mut at_offset = |offset: f64| {
                parameters[at] = kept + offset;
                network.forward(&parameters, &batch, &mut other);
                lost(other.outputs(), &samples).0
            };
            let difference = (at_offset(by) - at_offset(-by)) / (2.0 * by);
            parameters[at] = kept;
            let error = (difference - gradient[at]).abs() / (1.0 + difference.abs());
            worst = worst.max(error);
            assert!(
                error < 1e-6,
                "shape {index}, parameter {at}: {} by hand, {difference} by difference",
                gradient[at]
            );
        }
        println!("shape {index}: {} parameters, worst relative error {worst:.1e}", parameters.len());
    }
}

#[test]
fn the_policy_loss_is_flat_where_it_is_clipped_and_where_the_deviation_is_capped() {
    let terms = Terms { clip: 0.2, entropy: 0.0, log_std_max: -1.0, overshoot: 0.0, limit_m_s: 1.0 };
    // Much more likely than before, with a positive advantage: clipped.
    let far = Sample { action: [0.0, 0.0], log_density: -5.0f64, advantage: 1.0 };
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
    let sample = Sample { action: [0.0, 0.0], log_density: -2.0f64, advantage: 0.0 };
    let found = |overshoot, mean: [f64; 2]| {
        let terms = Terms { clip: 0.2, entropy: 0.0, log_std_max: 0.0, overshoot, limit_m_s: 1.0 };
        loss::policy(&[mean[0], mean[1], -1.0, -1.0], &sample, &terms)
    };
    let beyond = found(2.0, [1.5, -3.0]);
    assert_eq!((beyond.loss, [beyond.d_outputs[0], beyond.d_outputs[1]]), (2.0 * (0.25 + 4.0), [2.0, -8.0]));
    let within = found(2.0, [1.0, -0.9]);
    assert_eq!((within.loss, within.d_outputs), (0.0, [0.0; 4]));
    assert_eq!(found(0.0, [1.5, -3.0]).loss, 0.0, "it has no price unless the configuration says so");
}
