//! Training of policies with several hops and with memory by their rewards: windows of decisions are computed as they
//! were made, files of trainings drive teams as the trainer does, and trainings repeat and resume bit for bit.

use murmurate::policy::Model;
use murmurate::policy::hops::manifest::{Aggregation, Cell, Memory};
use murmurate::random::Seed;
use murmurate::registry::Registry;
use murmurate::scenario::{self, Settings};
use murmurate::trial::Trial;
use murmurate_train::batch::Batch;
use murmurate_train::conditions::EpisodeConditions;
use murmurate_train::config::Config;
use murmurate_train::evaluate::Evaluation;
use murmurate_train::learner::{self, Initial};
use murmurate_train::loss::{self, Sample, Terms};
use murmurate_train::network::{Network, TeamNetwork, TeamSpace};
use murmurate_train::rollout::{Chunk, RolloutSettings};
use murmurate_train::trainer::Trainer;

use crate::training::{plan, train};

/// Returns small configurations with delay and loss: of three hops, of one hop with memory, and of two with memory.
fn configurations() -> [(&'static str, Config); 3] {
    let with = |hops: usize, memory: Option<usize>| {
        let mut config = Config::preset("robust").expect("it is a preset");
        (config.ppo.environments, config.ppo.decisions, config.ppo.minibatch) = (40, 6, 64);
        (config.ppo.window, config.ppo.lookback) = (Some(4), Some(1));
        (config.policy.encoder, config.policy.message, config.policy.update) = (vec![8, 8], vec![8, 8], vec![8]);
        config.policy.hops = hops;
        config.policy.memory = memory.map(|floats| Memory { cell: Cell::Gru, floats, after_gap_s: 0.5 });
        config
    };
    let mean = |mut config: Config| {
        config.policy.aggregation = Aggregation::Mean;
        config
    };
    [("three hops", with(3, None)), ("memory", with(1, Some(6))), ("two hops with memory", mean(with(2, Some(6))))]
}

fn trainer(config: &Config, seed: u64) -> Trainer {
    Trainer::new(plan(config.clone(), seed), &Registry::builtin()).expect("it is sound")
}

#[test]
fn windows_of_decisions_are_computed_as_the_decisions_were_made() {
    let passage = scenario::build("passage", &Settings::default()).expect("the default is sound");
    for (name, mut config) in configurations() {
        // Short episodes, so that several begin and end within the record.
        config.episode_s = 1.3;
        let (actor, critic) = (TeamNetwork::new(config.actors()), Network::new(config.critic()));
        let mut stream = Seed::of_run(3).stream("windows");
        let mut parameters =
            learner::parameters(&actor.networks()[0], Initial::Normal(&[0.0, 0.0, -0.5, -0.5]), &mut stream);
        // Larger weights of the output layer, before its four biases, so that what is heard matters.
        parameters.iter_mut().rev().skip(4).take(32).for_each(|weight| *weight *= 30.0);
        let of_critic = learner::parameters(&critic, Initial::Normal(&[0.0]), &mut stream);
        let settings = RolloutSettings {
            config: &config,
            actor: &actor,
            critic: &critic,
            reward: config.reward,
            repeat: 3,
            log_std_max: -0.3,
            expert: None,
        };
        let scenarios = std::slice::from_ref(&passage);
        let mut chunk = Chunk::new(
            3,
            &[vec![5]],
            (scenarios, config.perceptions(scenarios).expect("it takes fields alone")),
            &settings,
        );
        chunk.start(&settings, &mut stream);
        let terms =
            Terms { clip: 0.2, entropy: 0.0, log_std_max: -0.3, overshoot: 0.0, limit_m_s: 1.0, imitation: 0.0 };
        for _ in 0..3 {
            chunk.collect(&settings, &parameters, &of_critic, 11, &mut stream);
            let record = &chunk.record;
            for extent in [(1, 0), (4, 0), (4, 2), (11, 0)] {
                let (mut batch, mut space) = (Batch::default(), TeamSpace::default());
                let windows = 0..record.windows(extent.0);
                batch.gather(windows.clone().map(|window| record.window(window, extent)));
                actor.forward(&parameters, &batch, &mut space);
                let samples = windows.flat_map(|window| record.decisions_of(window, extent.0));
                let samples = samples.flat_map(|decision| decision * 5..(decision + 1) * 5);
                let mut count = 0;
                for (outputs, at) in space.outputs().chunks_exact(4).zip(samples) {
                    let (action, log_density) = (record.action[at], record.log_density[at]);
                    let sample = Sample { action, taught: None, log_density, advantage: 0.0 };
                    let divergence = loss::policy(outputs, &sample, &terms).divergence;
                    assert!(divergence.abs() < 1e-4, "{name}, {extent:?}, sample {at}: {divergence}");
                    count += 1;
                }
                assert_eq!(count, record.action.len(), "{name}: every decision is in one window");
            }
        }
        assert!(chunk.record.ended.episodes > 0, "{name}: episodes end within the record");
    }
}

#[test]
fn trainings_repeat_on_any_number_of_threads_and_resume_bit_for_bit() {
    for (name, config) in configurations() {
        let (checkpoint, file) = train(trainer(&config, 5), 0..8, 3, 1);
        assert!(file == train(trainer(&config, 5), 0..8, 3, 2).1, "{name}: two threads");
        let resumed = Trainer::resume(&checkpoint, &Registry::builtin()).expect("it was just written");
        assert!(resumed.checkpoint() == checkpoint, "{name}: nothing is lost on the way");
        assert!(train(resumed, 3..8, 8, 2).1 == file, "{name}: resumed");
        let mut begun = trainer(&config, 6);
        begun.initialize_from(&checkpoint).expect("it has the same networks");
        let other = Config::preset("published").expect("it is a preset");
        assert!(trainer(&other, 6).initialize_from(&checkpoint).is_err(), "{name}: another network");
    }
}

#[test]
fn the_file_of_a_training_drives_a_team_as_the_trainer_does() {
    let passage = scenario::build("passage", &Settings::of(2)).expect("two robots are supported");
    for (name, mut config) in configurations() {
        config.ppo.learning_rate = [3e-3, 3e-3];
        for stage in &mut config.curriculum {
            stage.groups = vec![vec![2]];
        }
        config.robots = Some(2);
        let mut trainer = trainer(&config, 7);
        for _ in 0..40 {
            trainer.iterate(0.0, 2).expect("it stays finite");
        }
        let settings = trainer.settings();
        let settings = RolloutSettings { repeat: 1, ..settings };
        let (episodes, seed) = (24, 21);
        let evaluation = Evaluation {
            settings: &settings,
            parameters: trainer.parameters(),
            scenario: &passage,
            seed,
            episodes,
            draw: config.policy.draw,
        };
        let ours = evaluation.run(|_| EpisodeConditions::perfect(2), 2);
        let model = Model::from_file(&trainer.policy_files()[0], "passage").expect("it is sound");
        let report =
            Trial::of_team("sim", "passage", 2).expect("a preset").model(model).seed(seed).episodes(episodes).run();
        let alike = ours.iter().zip(&report.episodes).filter(|(ours, theirs)| {
            ours.verdict == theirs.verdict && (ours.min_separation_m - theirs.min_separation_m).abs() < 0.02
        });
        let (alike, moved) = (alike.count(), ours.iter().filter(|finding| finding.min_separation_m < 0.9).count());
        println!("{name}: {alike} of {episodes} alike, {moved} moved");
        assert!(alike * 10 >= episodes as usize * 8, "{name}: {alike} of {episodes} are the same\n{ours:?}");
    }
}
