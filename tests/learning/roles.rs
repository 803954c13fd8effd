//! Roles that are trained together: trainings repeat and resume bit for bit, their files drive a team as the trainer
//! does, go together and with no others, and configurations that cannot be trained are refused by the field.

use murmurate::policy::{Model, Models};
use murmurate::registry::Registry;
use murmurate::scenario::{Scenario, Settings, TaskFile};
use murmurate::trial::Trial;
use murmurate_train::conditions::EpisodeConditions;
use murmurate_train::config::{Config, Role};
use murmurate_train::evaluate::Evaluation;
use murmurate_train::rollout::RolloutSettings;
use murmurate_train::trainer::{Plan, SetupError, Trainer};
use std::sync::Arc;

use crate::training::train;

const TASK: &str = include_str!("../../examples/tasks/scouts.toml");

/// Returns a small training of the roles of `policies/scouts.toml` in two teams of two, with lost and late messages.
fn small() -> Config {
    let mut config = Config::from_toml(include_str!("../../policies/scouts.toml")).expect("it is sound");
    (config.ppo.environments, config.ppo.decisions, config.ppo.minibatch) = (40, 6, 64);
    (config.policy.encoder, config.policy.message, config.policy.update) = (vec![8, 8], vec![12, 12], vec![12]);
    config.robots = Some(4);
    config.curriculum.iter_mut().for_each(|stage| stage.groups = vec![vec![2, 2]]);
    let carrier = config.roles.get_mut("carrier").expect("it is there");
    (carrier.robots, carrier.update) = (vec![1, 3], Some(vec![10, 6]));
    config.roles.get_mut("scout").expect("it is there").robots = vec![0, 2];
    config
}

fn begin(config: &Config, seed: u64) -> Result<Trainer, SetupError> {
    let plan = Plan {
        scenario: "scouts.toml".to_owned(),
        preset: "small".to_owned(),
        config: config.clone(),
        seed,
        task: None,
    };
    Trainer::new(plan, &registry())
}

fn registry() -> Registry {
    Registry::builtin().with_task_text("scouts.toml", TASK).expect("it is sound")
}

fn trainer(seed: u64) -> Trainer {
    begin(&small(), seed).expect("it is sound")
}

fn scenario() -> Arc<dyn Scenario> {
    TaskFile::read(TASK).expect("it is sound").scenario(&Settings::of(4)).expect("it is sound")
}

/// Returns the models of a team whose robots have these files of scouts and carriers.
fn models(carrier: &[u8], scout: &[u8]) -> Result<Models, String> {
    let model = |file: &[u8]| Model::from_file(file, "scouts").expect("it is for the task");
    let roles = vec![("carrier".to_owned(), model(carrier)), ("scout".to_owned(), model(scout))];
    Models::of_roles(roles, vec![1, 0, 1, 0]).map_err(|unequal| unequal.to_string())
}

#[test]
fn trainings_of_roles_repeat_on_any_number_of_threads_and_resume_bit_for_bit() {
    let (checkpoint, files) = train(trainer(5), 0..8, 3, 1);
    assert!(files == train(trainer(5), 0..8, 3, 2).1, "two threads");
    let resumed = Trainer::resume(&checkpoint, &registry()).expect("it was just written");
    assert!(resumed.checkpoint() == checkpoint, "nothing is lost on the way");
    assert!(train(resumed, 3..8, 8, 2).1 == files, "resumed");
    trainer(6).initialize_from(&checkpoint).expect("it has the same networks");
    let mut other = small();
    other.roles.get_mut("carrier").expect("it is there").update = None;
    let mut other = begin(&other, 6).expect("it is sound");
    assert!(other.initialize_from(&checkpoint).is_err(), "a role has another network");
}

#[test]
fn files_of_one_training_go_together_and_with_those_of_no_other() {
    let (mut one, other) = (trainer(1), trainer(2));
    let before = one.policy_files();
    one.iterate(0.0, 2).expect("it stays finite");
    let [files, others] = [one.policy_files(), other.policy_files()];
    assert!(models(&files[0], &files[1]).is_ok());
    for (carrier, scout) in [(&files[0], &others[1]), (&files[0], &before[1])] {
        let why = models(carrier, scout).expect_err("they have not heard each other");
        assert!(why.contains("the name 'roles of one training, "), "{why}");
    }
    assert_ne!(files[0], before[0], "the carrier learns");
    assert_ne!(files[1], before[1], "the scout learns");
}

#[test]
fn files_of_roles_drive_a_team_as_the_trainer_does() {
    let mut config = small();
    config.ppo.learning_rate = [3e-3, 3e-3];
    let mut trainer = begin(&config, 7).expect("it is sound");
    for _ in 0..30 {
        trainer.iterate(1.0, 2).expect("it stays finite");
    }
    let settings = trainer.settings();
    let settings = RolloutSettings { repeat: 1, ..settings };
    let (seed, episodes, scenario) = (21, 12, scenario());
    let evaluation = Evaluation {
        settings: &settings,
        parameters: trainer.parameters(),
        scenario: &scenario,
        seed,
        episodes,
        draw: config.policy.draw,
    };
    let ours = evaluation.run(|_| EpisodeConditions::perfect(4), 2);
    let files = trainer.policy_files();
    let models = models(&files[0], &files[1]).expect("they were trained together");
    let deployment = murmurate::deploy::Deployment::preset("sim", 4).expect("it is a mode");
    let trial = Trial::with_registry(&registry(), deployment, scenario, models).seed(seed).episodes(episodes);
    let report = trial.run();
    let alike = ours.iter().zip(&report.episodes).filter(|(ours, theirs)| {
        ours.verdict == theirs.verdict && (ours.min_separation_m - theirs.min_separation_m).abs() < 0.02
    });
    let (alike, moved) = (alike.count(), ours.iter().filter(|finding| finding.min_separation_m < 0.5).count());
    println!("{alike} of {episodes} alike, {moved} moved");
    assert!(alike * 10 >= episodes as usize * 8, "{alike} of {episodes} are the same\n{ours:?}\n{:?}", report.episodes);
}

#[test]
fn roles_that_cannot_be_trained_together_are_refused_by_the_field() {
    fn of<'a>(config: &'a mut Config, role: &str) -> &'a mut Role {
        config.roles.get_mut(role).expect("it is there")
    }
    for (change, named) in [
        (
            (|config| of(config, "scout").robots = vec![0, 4]) as fn(&mut Config),
            "roles.scout.robots: there is no robot 4",
        ),
        (|config| of(config, "scout").robots = vec![0, 1], "roles.scout.robots: robot 1 has the role 'carrier'"),
        (|config| of(config, "scout").robots.clear(), "roles.scout.robots: no robot"),
        (|config| of(config, "scout").robots = vec![0], "roles: robot 2 has none"),
        (|config| of(config, "carrier").encoder = Some(vec![8, 16]), "roles.carrier.encoder: its last width is 16"),
        (|config| of(config, "carrier").update = Some(vec![0]), "roles.carrier.update"),
        (|config| of(config, "carrier").message = Some(vec![8]), "roles.carrier.message"),
        (|config| config.policy.hops = 2, "policy.hops"),
        (|config| of(config, "scout").update = Some(vec![0]), "roles.scout.update"),
        (|config| config.policy.update = vec![0], "policy.hops.0.update"),
        (
            |config| {
                let role = config.roles.remove("scout").expect("it is there");
                config.roles.insert("../scout".to_owned(), role);
            },
            "roles.../scout: a name is",
        ),
    ] {
        let mut config = small();
        change(&mut config);
        let why = config.check().expect_err("it is wrong").to_string();
        assert!(why.starts_with(named), "{named}: {why}");
    }
    let mut config = small();
    of(&mut config, "scout").observation =
        serde_json::from_str(r#"["velocity", {"name": "eyes", "shape": [4], "unit": "m", "frame": "policy"}]"#).ok();
    let why = begin(&config, 0).expect_err("there are no eyes").to_string();
    assert!(why.starts_with("roles.scout.observation: ") && why.contains("'eyes'"), "{why}");
}
