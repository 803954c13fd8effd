//! Benchmarks of one policy step of one robot, and of one tick of its guard, with four neighbours.
//!
//! `cargo bench --bench policy`. The allocation columns must read zero.

use divan::{AllocProfiler, Bencher};
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::local::{Action, OtherRobot, Progress};
use murmurate::messages::wire::{Phase, Round};
use murmurate::observation::Observation;
use murmurate::policy::gnn::Gnn;
use murmurate::policy::mlp::Instructions;
use murmurate::policy::{self, Draw, Model, Neighbour, Policy};
use murmurate::random::Seed;
use murmurate::safety::filter::Settings;
use murmurate::safety::guard::Guard;
use murmurate::safety::{Clamp, Safety};
use murmurate::scenario::{self};
use murmurate::time::{Span, Time};

#[global_allocator]
static ALLOCATIONS: AllocProfiler = AllocProfiler::system();

fn main() {
    divan::main();
}

/// Encode and act, with four neighbours.
fn step(bencher: Bencher, model: Model, instructions: Instructions) {
    let Model::Gnn(network, _) = model else { unreachable!("an untrained model is a network") };
    let mut gnn = Gnn::new(network, Draw::Sample, RobotId(0)).with_instructions(instructions);
    let observation = Observation::new(Motion::at_rest(Vec2::new(0.3, -1.5)), Vec2::new(-0.2, 1.5));
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

/// A tick of a guard with everything on: in the gap of the passage, with four neighbours so near that all of them and
/// both walls limit the velocity.
#[divan::bench(sample_size = 1000)]
fn guard_tick(bencher: Bencher) {
    let passage = scenario::build("passage", &scenario::Settings::default()).expect("the default is sound");
    let mut guard = Guard::new(Settings {
        safety: Safety::deployed(),
        half_extent: passage.arena().half_extent,
        walls: passage.arena().keep_outs.as_slice().into(),
        movers: passage.arena().movers.as_slice().into(),
        limit_m_s: 1.5,
        clamp: Clamp::Deployed,
        period: Span::from_millis(50),
    });
    guard.server_heard(Time::ZERO);
    guard.own_state(Time::ZERO);
    let at = [Vec2::new(0.45, -0.55), Vec2::new(-0.45, -0.55), Vec2::new(0.2, 0.55), Vec2::new(-0.2, 0.55)];
    let other = |(k, position): (u16, Vec2)| OtherRobot {
        robot: RobotId(k),
        motion: Motion { position, velocity: Vec2::new(0.1, 0.2) },
        age: Span::from_millis(20),
    };
    let action = Action {
        robot: RobotId(0),
        round: Round::default(),
        phase: Phase::Running,
        due: Time::ZERO,
        velocity: Some(Vec2::new(0.6, 1.2)),
        estimate: Motion { position: Vec2::new(0.0, -0.3), velocity: Vec2::new(0.1, 0.5) },
        others: (1..5).zip(at).map(other).collect(),
        progress: Progress::Underway,
    };
    bencher.bench_local(|| guard.decide(Time::ZERO, divan::black_box(&action)));
}
