//! Benchmark of training: rollout, environments of other trainings, forward pass, update and whole iterations.
//!
//! `cargo bench --bench train`. In the first three groups an item is a step of an environment of five robots. In the
//! last two, which use two threads, it is a decision: one policy evaluation for one environment.

use divan::Bencher;
use divan::counter::ItemsCount;
use murmurate::messages::geometry::Vec2;
use murmurate::policy::hops::entry::Entry;
use murmurate::policy::manifest::Architecture;
use murmurate::random::Seed;
use murmurate::registry::Registry;
use murmurate::scenario::{self, Settings};
use murmurate::senses::Settings as SenseSettings;
use murmurate_train::batch::Batch;
use murmurate_train::conditions::EpisodeConditions;
use murmurate_train::config::{Conditions, Config, CurriculumStage, Reward};
use murmurate_train::environments::Environments;
use murmurate_train::graphs::Graphs;
use murmurate_train::learner::{self, Initial};
use murmurate_train::network::{Network, Space};
use murmurate_train::rollout::CHUNK;
use murmurate_train::trainer::{Plan, Trainer};
use murmurate_train::vector::{Autoreset, Buffers, Content, Lengths, Lidar, Options, VectorEnvironment};
use rand::RngExt;

fn main() {
    divan::main();
}

fn preset(name: &str) -> Config {
    Config::preset(name).expect("it is a preset")
}

/// Dynamics and reward only: 1024 environments of five robots, one thread, commands that keep them moving.
#[divan::bench(args = ["scenario's reward", "published", "robust"], sample_count = 40)]
fn rollout(bencher: Bencher, reward: &str) {
    const ENVIRONMENTS: usize = 1024;
    let passage = scenario::build("passage", &Settings::default()).expect("the default passes its check");
    let mut config = preset(if reward == "robust" { "robust" } else { "published" });
    if reward == "scenario's reward" {
        let none = config.reward.with_penalties(0.0);
        config.reward = Reward { scenario: 1.0, progress: 0.0, shared: 0.0, ..none };
    }
    // As in the trainer: the environments of each chunk are stepped independently, with actions held for four steps.
    let mut stream = Seed::of_run(1).stream("bench");
    let mut chunks: Vec<Environments> = (0..ENVIRONMENTS / CHUNK)
        .map(|chunk| {
            let mut environments = Environments::new(CHUNK, &[vec![5]], std::slice::from_ref(&passage));
            for team in 0..CHUNK {
                environments.place(
                    team,
                    ((chunk * CHUNK + team) as u64, 0),
                    EpisodeConditions::perfect(5),
                    &mut stream,
                );
            }
            environments
        })
        .collect();
    let mut actions: Vec<Vec2> = chunks[0].position.iter().map(|at| Vec2::new(-at.x, 1.0)).collect();
    let mut steps = 0u32;
    bencher.counter(ItemsCount::new(ENVIRONMENTS * 20)).bench_local(|| {
        steps += 20;
        if steps.is_multiple_of(100) {
            actions.iter_mut().for_each(|action| *action = -*action);
        }
        for environments in &mut chunks {
            for _decision in 0..5 {
                for team in 0..CHUNK {
                    (0..4).for_each(|_| environments.step(team, &actions, &config.reward, 1.5, &mut stream));
                }
            }
        }
    });
    assert!(chunks.iter().all(|environments| environments.teams[0].step >= 20), "every team has moved on");
}

/// Vectorised environment with messages, as Python sees it: 1024 environments of five robots, one thread and random
/// actions; perfect or late messages, or no messages, without a lidar and with one of 32 rays.
#[divan::bench(args = ["perfect", "late", "silent", "lidar"], sample_count = 20)]
fn vectorised(bencher: Bencher, conditions: &str) {
    const ENVIRONMENTS: usize = 1024;
    const STEPS: usize = 20;
    let config = preset("robust");
    let alone = ["silent", "lidar"].contains(&conditions);
    let lidar = || Lidar {
        name: "lidar".to_owned(),
        settings: SenseSettings {
            kind: "lidar".to_owned(),
            table: "rays = 32\nrange_m = 2.0".parse().expect("it is TOML"),
        },
    };
    let late = if conditions == "late" { 1.0 } else { 0.0 };
    let mut environments = VectorEnvironment::new(Options {
        scenario: scenario::build("passage", &Settings::default()).expect("the default passes its check"),
        gap_m: None,
        scale: None,
        hull_m: None,
        repeat: 1,
        hold_s: config.policy.hold_s,
        environments: ENVIRONMENTS,
        threads: 1,
        conditions: Conditions { clean: 1.0 - late, deployed: late, everyone: 0.0, ..config.conditions.clone() },
        reward: config.reward,
        body: config.body.clone(),
        observation: config.policy.observation.iter().filter_map(Entry::field).collect(),
        radius_m: config.policy.radius_m,
        limit_m_s: config.policy.limit_m_s,
        episode_s: config.episode_s,
        content: if alone { Content::Nothing } else { Content::Observations },
        autoreset: Autoreset::SameStep,
        lidar: (conditions == "lidar").then(lidar),
        seed: 1,
    });
    let Lengths { robots, observation, message, rays } = environments.lengths();
    let (rows, edges) = (ENVIRONMENTS * robots, if alone { 0 } else { ENVIRONMENTS * robots * robots });
    let floats = |number: usize| vec![0.0f32; number];
    let (mut seen, mut last, mut reward) = (floats(rows * observation), floats(rows * observation), floats(rows));
    let (mut age_s, mut said) = (floats(edges), floats(edges * message));
    let (mut scan, mut last_scan) = (floats(rows * rays), floats(rows * rays));
    let flags = |number: usize| vec![false; number];
    let (mut terminated, mut truncated) = (flags(ENVIRONMENTS), flags(ENVIRONMENTS));
    let (mut arrived, mut heard) = (flags(rows), flags(edges));
    let mut stream = Seed::of_run(1).stream("bench");
    let actions: Vec<f32> = (0..2 * rows).map(|_| stream.random_range(-1.0..1.0)).collect();
    bencher.counter(ItemsCount::new(ENVIRONMENTS * STEPS)).bench_local(|| {
        for _ in 0..STEPS {
            let buffers = Buffers {
                observation: &mut seen,
                last_observation: &mut last,
                reward: &mut reward,
                terminated: &mut terminated,
                truncated: &mut truncated,
                arrived: &mut arrived,
                heard: &mut heard,
                age_s: &mut age_s,
                message: &mut said,
                scan: &mut scan,
                last_scan: &mut last_scan,
            };
            environments.step(&actions, &[], buffers);
        }
    });
    assert!(alone || heard.iter().any(|heard| *heard), "messages arrive");
    assert!(rays == 0 || scan.iter().any(|distance| *distance < 2.0), "something is seen");
}

/// Forward pass for 4096 environments of five robots in range of each other, one thread, in both architectures.
#[divan::bench(args = ["full", "published"], sample_count = 20)]
fn forward(bencher: Bencher, architecture: &str) {
    const ENVIRONMENTS: usize = 4096;
    let mut config = preset("published");
    if architecture == "published" {
        (config.policy.architecture, config.policy.edge) = (Some(Architecture::Published), Vec::new());
    }
    let network = Network::new(config.actors().remove(0));
    let mut stream = Seed::of_run(1).stream("bench");
    let parameters = learner::parameters(&network, Initial::Normal(&[0.0; 4]), &mut stream);
    let mut graphs = Graphs::new(5, network.inputs(), network.shape().edge);
    for _ in 0..ENVIRONMENTS {
        for _ in 0..5 {
            graphs.source(0).1.iter_mut().for_each(|float| *float = stream.random_range(-2.0..2.0));
        }
        for receiver in 0..5 {
            for sender in (0..5).filter(|&sender| sender != receiver) {
                let edge = graphs.edge(receiver, sender as u16);
                edge.iter_mut().for_each(|float| *float = stream.random_range(-1.0..1.0));
            }
        }
        graphs.end();
    }
    let (mut batch, mut space) = (Batch::default(), Space::default());
    bencher.counter(ItemsCount::new(ENVIRONMENTS)).bench_local(|| {
        for first in (0..ENVIRONMENTS).step_by(CHUNK) {
            batch.gather((first..first + CHUNK).map(|graph| graphs.window(graph, 1)));
            network.forward(&parameters, &batch, &mut space);
            divan::black_box(space.outputs());
        }
    });
}

/// Returns a trainer for five robots with `epochs` epochs and no early stop.
fn trainer(name: &str, epochs: usize) -> Trainer {
    let mut config = preset(name);
    config.curriculum =
        vec![CurriculumStage { until: 1.0, groups: vec![vec![5]], repeat: 4, gap_m: None, penalties: 1.0 }];
    (config.ppo.epochs, config.ppo.kl_stop) = (epochs, f32::INFINITY);
    let plan = Plan { scenario: "passage".to_owned(), preset: name.to_owned(), config, seed: 1, task: None };
    Trainer::new(plan, &Registry::builtin()).expect("the preset passes its check")
}

/// Whole iterations: rollout, and `epochs` passes over policy and critic. The difference between the two arguments is
/// the time of one pass.
#[divan::bench(args = [("published", 2), ("published", 3), ("robust", 2), ("robust", 3)], sample_count = 8)]
fn iteration(bencher: Bencher, (name, epochs): (&str, usize)) {
    let mut trainer = trainer(name, epochs);
    let ppo = &trainer.plan().config.ppo;
    let decisions = ppo.environments * ppo.decisions;
    bencher.counter(ItemsCount::new(decisions)).bench_local(|| {
        let point = trainer.iterate(0.0, 2).expect("it stays finite");
        assert!((point.epochs - epochs as f32).abs() < 1e-3, "{} epochs", point.epochs);
    });
}
