//! Training by imitation: rollouts that compute what the policy file computes, the same weights on any number of
//! threads, exact resumption, and a policy that learns.

use std::sync::Arc;

use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::scenario::judge::Verdict;
use murmurate::trial::Trial;
use murmurate_train::imitation::config::Config;
use murmurate_train::imitation::trainer::{Plan, Trainer};

/// Returns the plan of a small training of velocities, from a map of each robot, by an expert that knows more.
fn coverage() -> Plan {
    let mut config = Config::preset("coverage").expect("it is a preset");
    (config.robots, config.policy.hops, config.imitation.episodes) = (Some(3), 2, 2);
    config.policy.observation =
        serde_json::from_str(r#"["position", {"name": "coarse-map", "shape": [3, 6, 6], "unit": "1"}]"#)
            .expect("they are entries");
    (config.policy.encoder, config.policy.message, config.policy.update) = (vec![16, 12], vec![12], vec![12]);
    (config.policy.radius_m, config.policy.limit_m_s) = (1.0, 0.15);
    (config.imitation.length_m, config.imitation.speed_m_s) = (1.0, 0.15);
    Plan { scenario: "coverage-table".to_owned(), preset: "small".to_owned(), config, seed: 5 }
}

fn tasks() -> Registry {
    murmurate_tasks::add(Registry::builtin())
}

/// Returns the plan of a small training.
fn plan(hops: usize, seed: u64) -> Plan {
    let mut config = Config::preset("imitation").expect("it is a preset");
    (config.robots, config.policy.hops, config.imitation.episodes) = (Some(20), hops, 3);
    (config.policy.message, config.policy.update) = (vec![16], vec![16, 8]);
    Plan { scenario: "flocking".to_owned(), preset: "small".to_owned(), config, seed }
}

fn trainer(hops: usize, seed: u64) -> Trainer {
    Trainer::new(plan(hops, seed), &Registry::builtin()).expect("it is sound")
}

/// Runs iterations; returns the checkpoint after the first, and the policy file after the last.
fn train(mut trainer: Trainer, iterations: std::ops::Range<u32>, threads: usize) -> (Vec<u8>, Vec<u8>) {
    let mut checkpoint = Vec::new();
    for iteration in iterations {
        trainer.iterate(f64::from(iteration) / 3.0, threads).expect("it stays finite");
        if iteration == 0 {
            checkpoint = trainer.checkpoint();
        }
    }
    (checkpoint, trainer.policy_file())
}

#[test]
fn the_same_seed_gives_the_same_weights_on_any_number_of_threads_and_after_a_resumption() {
    let (checkpoint, file) = train(trainer(2, 3), 0..3, 1);
    assert!(file == train(trainer(2, 3), 0..3, 3).1, "three threads");
    let resumed = Trainer::resume(&checkpoint, &Registry::builtin()).expect("it was just written");
    assert_eq!(resumed.iterations(), 1);
    assert!(file == train(resumed, 1..3, 2).1, "resumed");
    assert!(file != train(trainer(2, 4), 0..3, 1).1, "another seed");
    assert!(Trainer::resume(&checkpoint[1..], &Registry::builtin()).is_err());
}

#[test]
fn velocities_and_channels_are_learnt_with_equal_weights_on_any_number_of_threads_and_after_a_resumption() {
    let begin = || Trainer::new(coverage(), &tasks()).expect("it is sound");
    let (checkpoint, file) = train(begin(), 0..3, 1);
    assert!(file == train(begin(), 0..3, 3).1, "three threads");
    let resumed = Trainer::resume(&checkpoint, &tasks()).expect("it was just written");
    assert!(file == train(resumed, 1..3, 2).1, "resumed");
}

#[test]
fn the_file_of_a_training_of_velocities_covers_as_the_trainers_rollouts_do() {
    let mut plan = coverage();
    // A decision in each step, as in a run.
    (plan.config.imitation.repeat, plan.config.imitation.episodes) = (1, 1);
    let mut trainer = Trainer::new(plan, &tasks()).expect("it is sound");
    for iteration in 0..3 {
        trainer.iterate(f64::from(iteration) / 3.0, 2).expect("it stays finite");
    }
    let [_, lockstep, _] = &trainer.evaluate(3, 2)[..] else { panic!("three scores") };
    let model = Model::from_file(&trainer.policy_file(), "coverage-table").expect("it is sound");
    let trial = Trial::from_registry(&tasks(), "sim", "coverage-table", Some(3)).expect("a preset").model(model);
    let report = trial.seed(0x9a11_e7a1).episodes(3).run();
    let mean = report.episodes.iter().filter_map(|episode| episode.cost).sum::<f64>() / 3.0;
    let difference = (mean - lockstep.cost_mean).abs() / mean;
    assert!(difference < 1e-3, "{mean} in a run, {} in the trainer", lockstep.cost_mean);
}

#[test]
fn what_the_scenario_or_a_training_by_imitation_has_not_is_refused_by_field() {
    let refused = |observation: &str| {
        let mut plan = coverage();
        plan.config.policy.observation = serde_json::from_str(observation).expect("they are entries");
        Trainer::new(plan, &tasks()).expect_err("it is refused").to_string()
    };
    let missing = refused(r#"[{"name": "lidar", "shape": [3], "unit": "m"}]"#);
    assert!(missing.starts_with("policy.observation: ") && missing.contains("no channel 'lidar'"), "{missing}");
    let other = refused(r#"[{"name": "coarse-map", "shape": [3, 8, 8], "unit": "1"}]"#);
    assert!(other.starts_with("policy.observation: ") && other.contains("[3, 6, 6]"), "{other}");
    let unknown = refused(r#"[{"name": "heading", "shape": [1], "unit": "rad", "frame": "world"}]"#);
    assert!(unknown.starts_with("policy.observation: ") && unknown.contains("no value"), "{unknown}");
    let mut elsewhere = Plan { scenario: "flocking".to_owned(), ..coverage() };
    elsewhere.config.robots = None;
    let elsewhere = Trainer::new(elsewhere, &tasks()).expect_err("it is refused").to_string();
    assert!(elsewhere.starts_with("expert: 'coverage-clairvoyant'"), "{elsewhere}");
}

#[test]
fn the_file_of_a_training_drives_a_team_as_the_trainers_rollouts_do() {
    let trainer = train_for(2, 4);
    let [_, lockstep, late] = &trainer.evaluate(4, 2)[..] else { panic!("three scores") };
    assert!(lockstep.cost_mean.is_finite() && late.cost_mean.is_finite());
    let model = Model::from_file(&trainer.policy_file(), "flocking").expect("it is sound");
    assert_eq!((model.name(), model.largest_team()), ("gnn-hops", Some(20)));
    // The layouts of the trainer's own evaluation.
    let report =
        Trial::of_team("sim", "flocking", 20).expect("a preset").model(model).seed(0x9a11_e7a1).episodes(4).run();
    let costs: Vec<f64> = report.episodes.iter().filter_map(|episode| episode.cost).collect();
    let mean = costs.iter().sum::<f64>() / 4.0;
    assert_eq!(costs.len(), 4);
    let difference = (mean - lockstep.cost_mean).abs() / mean;
    assert!(difference < 0.02, "{mean} in a run, {} in the trainer", lockstep.cost_mean);
}

fn train_for(hops: usize, iterations: u32) -> Trainer {
    let mut trainer = trainer(hops, 1);
    for iteration in 0..iterations {
        trainer.iterate(f64::from(iteration) / f64::from(iterations), 2).expect("it stays finite");
    }
    trainer
}

#[test]
fn a_short_training_flocks_far_better_than_robots_that_keep_their_velocities() {
    let trainer = train_for(1, 12);
    let scores = trainer.evaluate(8, 2);
    let (expert, policy) = (scores[0].cost_mean, scores[1].cost_mean);
    assert!(policy < 0.15, "the variance at the start is 0.32; the policy keeps {policy}, the expert {expert}");
    assert!(expert < policy);
}

#[test]
fn scenarios_with_goals_and_unknown_experts_are_refused_by_name() {
    let refused = |plan: Plan| Trainer::new(plan, &Registry::builtin()).expect_err("it is refused").to_string();
    let why = refused(Plan { scenario: "swap".to_owned(), ..plan(1, 0) });
    assert!(why.contains("'swap'") && why.contains("goals"), "{why}");
    let mut unknown = plan(1, 0);
    unknown.config.expert = "nobody".to_owned();
    assert!(refused(unknown).contains("expert: 'nobody'"));
}

#[test]
fn a_robot_that_sees_everyone_flocks_better_than_one_that_hears_its_neighbours() {
    let registry = Registry::builtin();
    let trial = Trial::of_team("sim", "flocking", 30).expect("a preset").seed(4).episodes(4);
    let cost = |name: &str| {
        let entry = registry.policy(name).expect("it is built in");
        let model = (entry.build)(&*trial.scenario).expect("it is for flocking");
        let report = trial.clone().model(model).run();
        assert!(report.episodes.iter().all(|episode| episode.verdict != Verdict::Timeout));
        report.episodes.iter().filter_map(|episode| episode.cost).sum::<f64>() / 4.0
    };
    let (global, local) = (cost("flock-global"), cost("flock-local"));
    assert!(global < local && local < 0.1, "{global} {local}");
    let swap = Arc::clone(&Trial::preset("sim", "swap").expect("a preset").scenario);
    let refused = (registry.policy("flock-global").expect("it is built in").build)(&*swap);
    assert!(refused.expect_err("swap has goals").to_string().contains("have goals"));
}
