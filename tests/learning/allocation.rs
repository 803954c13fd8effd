//! A policy step allocates no memory once it has had its largest number of neighbours.

use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::policy::{self, Model, Neighbour};
use murmurate::random::Seed;
use murmurate::scenario::{self, Observation, Settings};
use murmurate::time::Span;

#[test]
fn a_step_of_a_network_allocates_nothing() {
    let passage = scenario::build("passage", &Settings::default()).expect("the default is sound");
    let hops = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/conv_three_hops.safetensors"));
    let hops = Model::from_file(&hops.expect("it is part of the tests"), "passage").expect("it is sound");
    for model in [policy::untrained(1), policy::untrained_full(1), hops] {
        let mut policy = model.instance(passage.arena());
        let observation = Observation::new(Motion::at_rest(Vec2::new(0.3, -1.5)), Vec2::new(-0.2, 1.5));
        let mut features = vec![0.0; policy.interface().features];
        let heard = vec![vec![0.5; features.len()]; 4];
        let neighbour = |features| Neighbour { motion: observation.motion, features, age: Span::ZERO };
        let neighbours: Vec<Neighbour> = heard.iter().map(|features| neighbour(features)).collect();
        let mut stream = Seed::of_run(1).stream("draw");
        let mut step = |count: usize| {
            policy.encode(&observation, &mut features);
            for hop in 1..policy.hops() {
                policy.relay(hop, &observation, &mut features, &neighbours[..count]);
            }
            std::hint::black_box(policy.act(&observation, &features, &neighbours[..count], &mut stream));
        };
        step(4);
        let counted = allocation_counter::measure(|| (0..100).for_each(|k| step(k % 5)));
        assert_eq!(counted.count_total, 0, "{}: {counted:?}", model.name());
    }
    // Checks that the counter works.
    assert_eq!(allocation_counter::measure(|| drop(std::hint::black_box(vec![0u8; 64]))).count_total, 1);
}
