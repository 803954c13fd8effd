//! Observations with channels and senses in training environments: they are what a robot perceives there, messages have
//! those of their time, and a saved state continues to the bit.

use std::collections::BTreeMap;
use std::sync::Arc;

use murmurate::chassis::{Chassis, DriveKind, Settings as Body};
use murmurate::deploy::senses_of;
use murmurate::messages::geometry::Vec2;
use murmurate::policy::Model;
use murmurate::policy::hops::entry::{self, Entry};
use murmurate::random::{RngExt, Seed, Stream};
use murmurate::registry::Registry;
use murmurate::scenario::judge::Verdict;
use murmurate::scenario::{self, Scenario, Settings};
use murmurate::senses::{self, Scanner};
use murmurate::trial::Trial;
use murmurate_train::channels::Channels;
use murmurate_train::config::{Conditions, Config};
use murmurate_train::environments::Environments;
use murmurate_train::message_buffer::HISTORY_STEPS;
use murmurate_train::trainer::{Plan, Trainer};

const ROBOTS: usize = 3;
const RAYS: usize = 12;
/// Entries: fields, a channel of the scenario, a heading, and a lidar.
const ENTRIES: &str = r#"["velocity", {"name": "gap", "shape": [2, 2], "unit": "m", "frame": "policy"},
    {"name": "turned", "source": "heading", "shape": [1], "unit": "rad", "frame": "world"},
    {"name": "eyes", "shape": [12], "unit": "m", "frame": "body", "stale_after_s": 0.1}]"#;

fn lidar(noise_m: f32) -> BTreeMap<String, senses::Settings> {
    let table = format!("rays = {RAYS}\nrange_m = 1.5\nnoise_m = {noise_m}").parse().expect("it is TOML");
    [("eyes".to_owned(), senses::Settings { kind: "lidar".to_owned(), table })].into()
}

fn passage() -> Arc<dyn Scenario> {
    scenario::build("passage", &Settings::of(ROBOTS)).expect("it is there")
}

fn entries() -> Vec<Entry> {
    serde_json::from_str(ENTRIES).expect("they are entries")
}

/// Environments of teams on wheels whose robots send at times of their own.
fn environments(noise_m: f32, stream: &mut Stream) -> Environments {
    let scenarios = [passage()];
    let channels = Channels::new(&entries(), &lidar(noise_m), &scenarios).expect("the scenario has them");
    let body = Body { drive: Some(DriveKind::Differential), point_ahead_m: Some(0.1), ..Body::default() };
    let chassis: Chassis = body.chassis().expect("it is sound");
    let environments = Environments::new(2, &[vec![ROBOTS]], &scenarios).equipped(&chassis);
    let mut environments = environments.observing(&entries(), channels);
    let conditions = Conditions { clean: 0.0, ..Config::preset("robust").expect("it is there").conditions };
    (0..2).for_each(|team| environments.start(team, &conditions, stream));
    environments
}

fn step(environments: &mut Environments, stream: &mut Stream) {
    let actions: Vec<Vec2> =
        (0..2 * ROBOTS).map(|_| Vec2::new(stream.random_range(-0.5..0.5), stream.random_range(-0.5..0.5))).collect();
    let reward = Config::preset("robust").expect("it is there").reward;
    (0..2).for_each(|team| environments.step(team, &actions, &reward, 0.9, stream));
}

fn observed(environments: &Environments, team: usize, at: (u32, usize)) -> Vec<f32> {
    let mut to = vec![0.0; entry::floats(&entries())];
    environments.observation(team, &environments.teams[team].messages, at, &mut to);
    to
}

/// Returns what the robot's lidar sees without noise.
fn scanned(environments: &Environments, (team, robot): (usize, usize)) -> Vec<f32> {
    let (name, settings) = lidar(0.0).pop_first().expect("there is one");
    let mut scanner = Scanner::of(&name, &settings).expect("it is sound");
    let (range, heading) = (environments.teams[team].range(), environments.heading(robot));
    let others = range.filter(|other| *other != robot).map(|other| environments.position[other]);
    let mut values = vec![0.0; RAYS];
    let pose = (environments.position[robot], heading, heading);
    scanner.scan(environments.arena(team), pose, others, &mut values);
    values.iter_mut().for_each(|value| *value = value.min(1.5));
    values
}

#[test]
fn robots_observe_what_is_about_them_and_messages_have_the_observations_of_their_time() {
    let mut stream = Seed::of_run(4).stream("sensing");
    let mut environments = environments(0.0, &mut stream);
    let (mut past, mut near) = (Vec::new(), 0);
    for now in 0..40u32 {
        let all: Vec<Vec<f32>> =
            (0..2 * ROBOTS).map(|at| observed(&environments, at / ROBOTS, (now, at % ROBOTS))).collect();
        for (at, found) in all.iter().enumerate() {
            let (team, robot) = (at / ROBOTS, at);
            let scan = scanned(&environments, (team, robot));
            assert_eq!(found[7..], scan, "robot {robot}, step {now}");
            near += scan.iter().filter(|distance| **distance < 1.5).count();
            assert!((found[6] - environments.heading(robot)).sin().abs() < 1e-5);
            let (estimate, task) = (environments.estimate(team, robot), environments.tasks[robot]);
            let seen = environments.scenario(team).frame(&task).turn_motion(&estimate);
            assert_eq!(Vec2::new(found[0], found[1]), seen.velocity);
            // The middle of the gap is the middle of the ground.
            let gap = (Vec2::new(found[2], found[3]) + Vec2::new(found[4], found[5])) / 2.0;
            assert!((gap + seen.position).norm() < 1e-5, "{found:?}");
        }
        past.push(all);
        for then in (now + 1).saturating_sub(HISTORY_STEPS as u32)..=now {
            for (at, expected) in past[then as usize].iter().enumerate() {
                assert_eq!(observed(&environments, at / ROBOTS, (then, at % ROBOTS)), *expected);
            }
        }
        step(&mut environments, &mut stream);
    }
    assert!(near > 200, "{near}");
}

#[test]
fn the_critic_sees_without_noise_and_a_saved_state_continues_to_the_bit() {
    let mut stream = Seed::of_run(5).stream("sensing");
    let mut first = environments(0.05, &mut stream);
    (0..10).for_each(|_| step(&mut first, &mut stream));
    let mut truth = vec![0.0; entry::floats(&entries())];
    first.true_observation(1, ROBOTS + 1, &mut truth);
    assert_eq!(truth[7..], scanned(&first, (1, ROBOTS + 1)));
    assert_ne!(truth[7..], observed(&first, 1, (10, 1))[7..], "the policy's scan has noise");
    let mut other = environments(0.05, &mut Seed::of_run(9).stream("another"));
    assert!(other.restore(first.snapshot()));
    let mut again = stream.clone();
    for now in 10..30 {
        for at in 0..2 * ROBOTS {
            let at = (at / ROBOTS, (now, at % ROBOTS));
            assert_eq!(observed(&first, at.0, at.1), observed(&other, at.0, at.1));
        }
        step(&mut first, &mut stream);
        step(&mut other, &mut again);
    }
    let scenarios = [passage()];
    let plain = Environments::new(2, &[vec![ROBOTS]], &scenarios);
    assert!(!plain.fits(&first.snapshot()), "its observations are not stored");
}

#[test]
fn a_channel_that_the_scenario_or_the_robots_lack_is_refused_by_its_name() {
    let refused = |text: &str, senses: &BTreeMap<String, senses::Settings>| {
        let entries: Vec<Entry> = serde_json::from_str(text).expect("they are entries");
        Channels::new(&entries, senses, &[passage()]).expect_err("it is not there").to_string()
    };
    let none = BTreeMap::new();
    let unknown = refused(ENTRIES, &none);
    assert!(unknown.contains("observation 'eyes': there is no channel 'eyes' here"), "{unknown}");
    let shape = r#"[{"name": "gap", "shape": [4], "unit": "m", "frame": "policy"}]"#;
    assert!(refused(shape, &none).contains("the channel 'gap' is [2, 2]"));
    let mut slow = lidar(0.0);
    slow.get_mut("eyes").expect("it is there").table.insert("rate_hz".to_owned(), 10.0.into());
    assert!(refused(ENTRIES, &slow).contains("senses.eyes.rate_hz"));
    let fields: Vec<Entry> = serde_json::from_str(r#"["velocity"]"#).expect("they are entries");
    assert!(Channels::new(&fields, &none, &[passage()]).expect("nothing is wrong").is_none());
}

#[test]
fn a_policy_is_trained_with_a_lidar_and_drives_a_team_that_has_one() {
    let mut config = Config::preset("robust").expect("it is there");
    (config.ppo.environments, config.ppo.decisions, config.ppo.minibatch) = (40, 6, 64);
    (config.policy.encoder, config.policy.message, config.policy.update) = (vec![8, 8], vec![12, 12, 12], vec![12]);
    (config.policy.observation, config.senses) = (entries(), lidar(0.02));
    let text = toml::to_string(&config).expect("a configuration is TOML");
    assert_eq!(Config::from_toml(&text).expect("it is sound"), config, "it is written and read again");
    let plan = Plan { scenario: "passage".to_owned(), preset: "small".to_owned(), config, seed: 3, task: None };
    let begin = || Trainer::new(plan.clone(), &Registry::builtin()).expect("it is sound");
    let iterate = |trainer: &mut Trainer, iterations: std::ops::Range<u32>, threads: usize| {
        for iteration in iterations {
            trainer.iterate(f64::from(iteration) / 8.0, threads).expect("it stays finite");
        }
    };
    let mut once = begin();
    iterate(&mut once, 0..3, 2);
    let mut resumed = Trainer::resume(&once.checkpoint(), &Registry::builtin()).expect("it was just written");
    iterate(&mut resumed, 3..8, 1);
    iterate(&mut once, 3..8, 2);
    assert!(once.policy_files() == resumed.policy_files(), "the same weights on any number of threads, and resumed");
    let model = Model::from_file(&once.policy_files()[0], "passage").expect("it is sound");
    assert_eq!((model.name(), model.requests().len()), ("gnn-hops", 3));
    let trial = |senses: &str| {
        let mut trial = Trial::preset("offboard", "passage").expect("it is a mode").model(model.clone()).episodes(2);
        if !senses.is_empty() {
            trial.deployment = trial.deployment.with_senses(senses_of(senses).expect("they are senses"));
        }
        trial
    };
    let with = trial("[senses.eyes]\nkind = \"lidar\"\nrays = 12\nrange_m = 1.5\n");
    assert_eq!(with.check(), Ok(()));
    let report = with.run();
    assert!(report.episodes.iter().all(|episode| episode.verdict != Verdict::Aborted));
    assert!(trial("").check().is_err_and(|why| why.to_string().contains("'eyes'")));
    let mut blind = plan.clone();
    blind.config.senses.clear();
    let refused = Trainer::new(blind, &Registry::builtin()).expect_err("there is no lidar").to_string();
    assert!(refused.contains("policy.observation") && refused.contains("'eyes'"), "{refused}");
}

#[test]
fn a_training_takes_the_senses_of_its_task_file_that_its_policy_names() {
    let mut config = Config::preset("robust").expect("it is there");
    (config.ppo.environments, config.ppo.decisions, config.ppo.minibatch) = (40, 4, 64);
    (config.policy.encoder, config.policy.message, config.policy.update) = (vec![8, 8], vec![12, 12, 12], vec![12]);
    config.policy.observation = serde_json::from_str(
        r#"["goal-minus-position", "velocity",
            {"name": "eyes", "shape": [24], "unit": "m", "frame": "policy", "stale_after_s": 0.12}]"#,
    )
    .expect("they are entries");
    config.robots = Some(5);
    let task = include_str!("../../examples/tasks/navigation.toml");
    let begin = |text: &str, config: &Config| {
        let registry = Registry::builtin().with_task_text("field.toml", text).expect("it is sound");
        let config = config.clone();
        let plan = Plan { scenario: "field.toml".to_owned(), preset: "small".to_owned(), config, seed: 3, task: None };
        Trainer::new(plan, &registry)
    };
    let mut trainer = begin(task, &config).expect("it is sound");
    assert_eq!(trainer.plan().config.senses["eyes"].table["range_m"].as_float(), Some(2.0));
    trainer.iterate(0.0, 2).expect("it stays finite");
    let written = &trainer.plan().config;
    let mut said = begin(&task.replace("range_m = 2.0", "range_m = 1.0"), written).expect("it is sound");
    assert_eq!(said.plan().config.senses, written.senses, "the configuration has the last word");
    said.iterate(0.0, 2).expect("it stays finite");
    assert!(said.policy_files() == trainer.policy_files(), "the lidar alone differs between the two files");
    // A sense that the policy does not take may be of any kind.
    let camera = "\n[senses.camera]\nkind = \"relative\"\nmost = 3\nrange_m = 1.0\n";
    begin(&format!("{task}{camera}"), &config).expect("it is sound");
    let late = begin(&task.replace("rays = 24", "rays = 24\nrate_hz = 5.0"), &config).expect_err("it has a rate");
    assert!(late.to_string().contains("senses.eyes.rate_hz"), "{late}");
}
