//! Benchmark of one policy step of one robot with four neighbours.
//!
//! `cargo bench --bench policy`. The allocation columns must read zero.

use divan::{AllocProfiler, Bencher};
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::policy::gnn::Gnn;
use murmurate::policy::mlp::Instructions;
use murmurate::policy::{self, Draw, Model, Neighbour, Policy};
use murmurate::random::Seed;
use murmurate::scenario::Observation;
use murmurate::time::Span;

#[global_allocator]
static ALLOCATIONS: AllocProfiler = AllocProfiler::system();

fn main() {
    divan::main();
}

/// Encode and act, with four neighbours.
fn step(bencher: Bencher, model: Model, instructions: Instructions) {
    let Model::Gnn(network, _) = model else { unreachable!("an untrained model is a network") };
    let mut gnn = Gnn::with_instructions(network, Draw::Sample, instructions);
    let observation = Observation { motion: Motion::at_rest(Vec2::new(0.3, -1.5)), goal: Vec2::new(-0.2, 1.5) };
    let mut features = vec![0.0; gnn.interface().features];
    let heard: Vec<Vec<f32>> =
        (0..4).map(|k| (0..features.len()).map(|i| ((i * 7 + k) as f32).sin()).collect()).collect();
    let neighbours: Vec<Neighbour> =
        heard.iter().map(|features| Neighbour { motion: observation.motion, features, age: Span::ZERO }).collect();
    let mut stream = Seed::of_run(1).stream("bench");
    bencher.bench_local(|| {
        gnn.encode(divan::black_box(&observation), &mut features);
        gnn.act(divan::black_box(&observation), &features, divan::black_box(&neighbours), &mut stream)
    });
}

#[divan::bench(sample_size = 1000)]
fn baseline_instructions(bencher: Bencher) {
    step(bencher, policy::untrained(1), Instructions::Baseline);
}

#[divan::bench(sample_size = 1000)]
fn detected_instructions(bencher: Bencher) {
    step(bencher, policy::untrained(1), Instructions::Detected);
}

#[divan::bench(sample_size = 1000)]
fn full_baseline_instructions(bencher: Bencher) {
    step(bencher, policy::untrained_full(1), Instructions::Baseline);
}

#[divan::bench(sample_size = 1000)]
fn full_detected_instructions(bencher: Bencher) {
    step(bencher, policy::untrained_full(1), Instructions::Detected);
}
