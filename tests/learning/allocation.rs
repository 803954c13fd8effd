//! A policy step allocates no memory once it has had its largest number of neighbours; vectorised environments take no
//! more than was reckoned.

use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::observation::Observation;
use murmurate::policy::hops::entry::Entry;
use murmurate::policy::{self, Model, Neighbour};
use murmurate::random::Seed;
use murmurate::scenario::{self, Settings};
use murmurate::senses;
use murmurate::time::Span;
use murmurate_train::config::Config;
use murmurate_train::vector::{Autoreset, Buffers, Content, Lidar, Options, VectorEnvironment};

#[test]
fn a_step_of_a_network_allocates_nothing() {
    let passage = scenario::build("passage", &Settings::default()).expect("the default is sound");
    let hops = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/conv_three_hops.safetensors"));
    let hops = Model::from_file(&hops.expect("it is part of the tests"), "passage").expect("it is sound");
    for model in [policy::untrained(1), policy::untrained_full(1), hops] {
        let mut policy = model.instance(passage.arena(), RobotId(0));
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

/// Buffers of environments.
struct Memory {
    floats: [Vec<f32>; 7],
    flags: [Vec<bool>; 4],
}

impl Memory {
    fn of(options: &Options) -> Memory {
        let (n, lengths) = (options.environments, options.lengths());
        let (rows, edges) = (n * lengths.robots, n * lengths.robots * lengths.robots);
        let (edges, scan) = (if lengths.message > 0 { edges } else { 0 }, rows * lengths.rays);
        let seen = rows * lengths.observation;
        let floats = [seen, seen, rows, edges, edges * lengths.message, scan, scan].map(|length| vec![0.0f32; length]);
        Memory { floats, flags: [n, n, rows, edges].map(|length| vec![false; length]) }
    }

    fn buffers(&mut self) -> Buffers<'_> {
        let [observation, last_observation, reward, age_s, message, scan, last_scan] = &mut self.floats;
        let [terminated, truncated, arrived, heard] = &mut self.flags;
        Buffers {
            observation,
            last_observation,
            reward,
            terminated,
            truncated,
            arrived,
            heard,
            age_s,
            message,
            scan,
            last_scan,
        }
    }
}

/// Makes environments and buffers of their sizes, and starts new episodes; the result is of no interest.
fn allocate(options: Options) {
    let mut memory = Memory::of(&options);
    let mut environments = VectorEnvironment::new(options);
    environments.reset(|_| true, memory.buffers());
    std::hint::black_box(environments);
}

/// Returns 320 environments of this scenario without messages.
fn environments(name: &str, robots: usize) -> Options {
    let config = Config::preset("robust").expect("it is a preset");
    Options {
        scenario: scenario::build(name, &Settings::of(robots)).expect("such teams are supported"),
        gap_m: None,
        scale: None,
        hull_m: None,
        environments: 320,
        threads: 1,
        conditions: config.conditions.clone(),
        reward: config.reward,
        body: config.body.clone(),
        observation: config.policy.observation.iter().filter_map(Entry::field).collect(),
        radius_m: config.policy.radius_m,
        limit_m_s: config.policy.limit_m_s,
        episode_s: config.episode_s,
        repeat: 1,
        hold_s: config.policy.hold_s,
        content: Content::Nothing,
        autoreset: Autoreset::SameStep,
        lidar: None,
        seed: 1,
    }
}

/// Returns a lidar of 64 rays with noise.
fn lidar() -> Option<Lidar> {
    let table = "rays = 64\nrange_m = 2.0\nnoise_m = 0.01\ndropouts = 0.1".parse().expect("it is TOML");
    Some(Lidar { name: "eyes".to_owned(), settings: senses::Settings { kind: "lidar".to_owned(), table } })
}

#[test]
fn a_step_with_a_lidar_allocates_no_more_than_one_without() {
    let counted = |lidar| {
        let options = Options { lidar, ..environments("passage", 5) };
        let (mut memory, actions) = (Memory::of(&options), vec![0.5; 320 * 5 * 2]);
        let mut environments = VectorEnvironment::new(options);
        environments.begin(memory.buffers());
        allocation_counter::measure(|| environments.step(&actions, &[], memory.buffers())).count_total
    };
    assert_eq!(counted(lidar()), counted(None));
}

#[test]
fn environments_take_less_memory_than_was_reckoned_and_not_much_less() {
    for (name, robots) in [("passage", 2), ("passage", 12), ("flocking", 40)] {
        let contents = [Content::Nothing, Content::Observations, Content::Actions(64)];
        for (content, lidar) in contents.map(|content| (content, None)).into_iter().chain([(Content::Nothing, lidar())])
        {
            let mut options = Options { content, lidar, ..environments(name, robots) };
            (options.conditions.clean, options.conditions.deployed, options.conditions.filtered) = (0.0, 1.0, 1.0);
            let reckoned = options.memory_bytes();
            let taken = allocation_counter::measure(|| allocate(options)).bytes_max;
            assert!(taken < reckoned, "{name} of {robots}, {content:?}: {taken} of {reckoned}");
            // The first megabyte is a margin for what does not grow with the environments.
            assert!(taken * 3 > reckoned - (1 << 20), "{name} of {robots}, {content:?}: {taken} of {reckoned}");
        }
    }
}
