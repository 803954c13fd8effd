//! Training by rewards and by an expert at once: what the expert does is learnt, on any number of threads and after a
//! resumption with equal weights, and an expert without weight changes nothing.

use murmurate::registry::Registry;
use murmurate_train::config::{Config, Imitated};
use murmurate_train::trainer::{Plan, Trainer};

use crate::training::train;

/// Small training of three robots that share out goals, with `claim` as their expert.
fn plan(weight: Option<[f32; 2]>) -> Plan {
    let mut config = Config::preset("robust").expect("it is a preset");
    (config.ppo.environments, config.ppo.decisions, config.ppo.minibatch) = (40, 8, 64);
    (config.policy.encoder, config.policy.message, config.policy.update) = (vec![32, 16], vec![32, 16], vec![32]);
    config.policy.observation = serde_json::from_str(
        r#"["velocity", {"name": "near-goals", "shape": [3, 2], "unit": "m", "frame": "policy"}]"#,
    )
    .expect("they are entries");
    (config.robots, config.episode_s, config.ppo.kl_stop) = (Some(3), 10.0, f32::INFINITY);
    for stage in &mut config.curriculum {
        stage.groups = vec![vec![3]];
    }
    config.expert = weight.map(|weight| Imitated { policy: "claim".to_owned(), weight, until: 1.0 });
    let task = Some(include_str!("../../examples/tasks/unlabelled.toml").to_owned());
    Plan { scenario: "unlabelled.toml".to_owned(), task, preset: "robust".to_owned(), config, seed: 2 }
}

fn trainer(plan: Plan) -> Trainer {
    Trainer::new(plan, &Registry::builtin()).expect("it is sound")
}

#[test]
fn trainings_with_an_expert_repeat_on_any_number_of_threads_and_resume_bit_for_bit() {
    let begin = || trainer(plan(Some([2.0, 0.0])));
    let (checkpoint, file) = train(begin(), 0..4, 3, 1);
    assert!(file == train(begin(), 0..4, 3, 2).1, "two threads");
    let resumed = Trainer::resume(&checkpoint, &Registry::builtin()).expect("it was just written");
    assert!(train(resumed, 3..4, 4, 2).1 == file, "resumed");
    assert!(train(trainer(plan(None)), 0..4, 3, 1).1 != file, "the expert matters");
}

#[test]
fn what_the_expert_does_is_learnt() {
    let left = |weight: f32| {
        let mut trainer = trainer(plan(Some([weight; 2])));
        let disagreements = (0..40).map(|_| trainer.iterate(0.1, 2).expect("it stays finite").disagreement);
        disagreements.last().flatten().expect("it has an expert")
    };
    let [taught, hardly] = [left(8.0), left(1e-6)];
    assert!(taught < 0.8 * hardly, "{taught} m2/s2 are left, and {hardly} where the expert has no weight to speak of");
}

#[test]
fn an_expert_without_weight_changes_nothing() {
    let weights = |weight| {
        let mut trainer = trainer(plan(weight));
        let metrics = trainer.iterate(0.0, 2).expect("it stays finite");
        assert!(metrics.disagreement.is_none());
        trainer.parameters().to_vec()
    };
    assert_eq!(weights(Some([0.0, 0.0])), weights(None));
}

#[test]
fn experts_that_cannot_be_asked_are_refused_by_field() {
    let refused = |policy: &str| {
        let mut plan = plan(Some([1.0, 0.0]));
        plan.config.expert.as_mut().expect("it has one").policy = policy.to_owned();
        Trainer::new(plan, &Registry::builtin()).expect_err("it is refused").to_string()
    };
    for policy in ["nothing", "flock-local"] {
        let why = refused(policy);
        assert!(why.starts_with(&format!("expert.policy: '{policy}': ")), "{why}");
    }
    let wrong = |expert: &str| {
        let text = format!("{}\n[expert]\n{expert}", murmurate_train::config::PRESETS[1].1);
        Config::from_toml(&text).expect_err("it is wrong").to_string()
    };
    assert!(wrong("policy = 'claim'\nweight = [-1.0, 0.0]\nuntil = 0.5").contains("expert.weight"));
    assert!(wrong("policy = 'claim'\nweight = [1.0, 0.0]\nuntil = 0.0").contains("expert.until"));
}
