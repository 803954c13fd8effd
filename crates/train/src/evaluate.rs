//! Evaluation of a policy in the trainer's environments: many episodes at once, judged by the same rules as `sim`.

use std::sync::Arc;

use serde::Serialize;

use super::conditions::EpisodeConditions;
use super::config::Conditions;
use super::parallel::in_parallel;
use super::rollout::{CHUNK, Chunk, RolloutSettings};
use super::trainer::Trainer;
use murmurate::policy::Draw;
use murmurate::random::Seed;
use murmurate::scenario::Scenario;
use murmurate::scenario::judge::{JudgedRobot, Judgement, Verdict};
use murmurate::time::Span;
use murmurate::world::kinematic::PERIOD;
use murmurate_report::statistics::quantile;

/// Seed of the layouts of a quick evaluation.
const QUICK_SEED: u64 = 0x9a11_e7a1;

/// Parameters of an evaluation of a policy in the trainer's environments.
#[derive(Debug)]
pub struct Evaluation<'a> {
    /// Settings of the rollout, in which an action must be held for one step (`repeat` 1).
    pub settings: &'a RolloutSettings<'a>,
    /// Weights and biases of the policy's network, or of those of all roles, as one vector.
    pub parameters: &'a [f32],
    /// Scenario whose layouts (starts and goals) are run.
    pub scenario: &'a Arc<dyn Scenario>,
    /// Seed of the layouts and of all other random numbers.
    pub seed: u64,
    /// Number of layouts (starts and goals), each run for one episode.
    pub episodes: u32,
    /// Method of drawing an action from the policy's distribution.
    pub draw: Draw,
}

impl Evaluation<'_> {
    /// Runs one episode of every layout, on up to `threads` threads. Returns the findings in the order of the layouts.
    /// `conditions` returns the conditions of the episode with the given index.
    pub fn run(&self, conditions: impl Fn(u32) -> EpisodeConditions + Sync, threads: usize) -> Vec<Judgement> {
        let firsts: Vec<u32> = (0..self.episodes).step_by(CHUNK).collect();
        let mut findings: Vec<Vec<Judgement>> = firsts.iter().map(|_| Vec::new()).collect();
        in_parallel(threads, firsts.iter().zip(&mut findings), |(&first, findings)| {
            *findings = self.chunk(first..self.episodes.min(first + CHUNK as u32), &conditions);
        });
        findings.concat()
    }

    fn chunk(&self, episodes: std::ops::Range<u32>, conditions: impl Fn(u32) -> EpisodeConditions) -> Vec<Judgement> {
        let (settings, robots) = (self.settings, self.scenario.robots());
        let mut stream = Seed::of_run(self.seed).stream(&format!("train/evaluate/{}", episodes.start));
        let rows = episodes.len();
        let scenarios = std::slice::from_ref(self.scenario);
        let perceptions = settings.config.perceptions(scenarios).expect("a training whose scenario has them");
        let mut chunk = Chunk::new(rows, &[vec![robots]], (scenarios, perceptions), settings);
        let mut judges = Vec::new();
        for (team, episode) in episodes.enumerate() {
            chunk.environments.place(team, (self.seed, episode), conditions(episode), &mut stream);
            judges.push(chunk.environments.judge(team));
        }
        let mut findings: Vec<Option<Judgement>> = vec![None; rows];
        let mut after = Span::ZERO;
        while findings.iter().any(Option::is_none) {
            chunk.decide_unrecorded(settings, self.parameters, self.draw, &mut stream);
            after = after + PERIOD;
            for team in 0..rows {
                if findings[team].is_some() {
                    continue;
                }
                chunk.step(settings, team, &mut stream);
                let environments = &chunk.environments;
                let state = |robot: usize| JudgedRobot {
                    position: environments.position[robot],
                    point: environments.point(robot).position,
                    velocity: environments.velocity[robot],
                    contacts: environments.contacts[robot],
                };
                let states: Vec<JudgedRobot> = environments.teams[team].range().map(state).collect();
                findings[team] = judges[team].update(after, &states);
            }
        }
        findings.into_iter().flatten().collect()
    }
}

/// Result of an evaluation under one set of conditions with one method of drawing actions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Name of the conditions. `perfect`: all robots act at the same time, without delay or loss of messages;
    /// `disturbed`: drawn as in training, but never with simultaneous actions on perfect messages.
    pub conditions: &'static str,
    /// Method of drawing actions: `mean` or `sample`.
    pub action: &'static str,
    /// Share of the layouts in which the episode succeeded, 0 to 1.
    pub success: f64,
    /// Median makespan of the successful episodes \[s\]; `None` if there are none.
    pub makespan_s: Option<f64>,
}

impl Score {
    /// Returns the score of `findings`, one per episode. `conditions` is the name of the conditions of these episodes,
    /// and `draw` their method of drawing actions.
    pub fn of(conditions: &'static str, draw: Draw, findings: &[Judgement]) -> Score {
        let successes = findings.iter().filter(|finding| finding.verdict == Verdict::Success);
        let makespans: Vec<f64> = successes.map(|finding| finding.after.as_secs()).collect();
        let action = if draw == Draw::Mean { "mean" } else { "sample" };
        let success = makespans.len() as f64 / findings.len().max(1) as f64;
        Score { conditions, action, success, makespan_s: quantile(&makespans, 0.5) }
    }
}

/// Results of a quick evaluation. Those with the draw method of the policy's manifest come first.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Scores(pub Vec<Score>);

impl Scores {
    /// Returns the score under the conditions with the name `conditions`, with the draw method of the policy's
    /// manifest; `None` if there is no such score.
    pub fn with_default_draw(&self, conditions: &str) -> Option<&Score> {
        self.0.iter().find(|score| score.conditions == conditions)
    }
}

/// Evaluates a training's current policy on `episodes` layouts of a fixed seed, independent of the layouts of the
/// training: with both methods of drawing actions, and in those conditions that the training has.
pub fn quick_evaluation(trainer: &Trainer, episodes: u32, threads: usize) -> Scores {
    let own = trainer.settings().config.policy.draw;
    let other = if own == Draw::Mean { Draw::Sample } else { Draw::Mean };
    evaluation(trainer, &[own, other], episodes, threads)
}

/// Evaluates a training's current policy as `quick_evaluation` does, but with the draw method of its manifest alone.
pub fn glance(trainer: &Trainer, episodes: u32, threads: usize) -> Scores {
    evaluation(trainer, &[trainer.settings().config.policy.draw], episodes, threads)
}

fn evaluation(trainer: &Trainer, draws: &[Draw], episodes: u32, threads: usize) -> Scores {
    let settings = trainer.settings();
    let (settings, config) = (without_repeat(&settings), settings.config);
    let robots = trainer.scenario().robots();
    let seed = Seed::of_run(QUICK_SEED);
    let disturbed = |episode: u32| {
        let conditions = Conditions { clean: 0.0, ..config.conditions.clone() };
        EpisodeConditions::draw(&conditions, robots, &mut seed.stream(&format!("train/disturbed/{episode}")))
    };
    let mut scores = Vec::new();
    for &draw in draws {
        let (parameters, scenario) = (trainer.parameters(), trainer.scenario());
        let evaluation = Evaluation { settings: &settings, parameters, scenario, seed: QUICK_SEED, episodes, draw };
        if config.conditions.clean > 0.0 {
            scores.push(Score::of("perfect", draw, &evaluation.run(|_| EpisodeConditions::perfect(robots), threads)));
        }
        if config.conditions.clean < 1.0 || config.conditions.deployed > 0.0 {
            scores.push(Score::of("disturbed", draw, &evaluation.run(disturbed, threads)));
        }
    }
    Scores(scores)
}

/// Returns the settings for an evaluation: an action is held for one step.
fn without_repeat<'a>(settings: &RolloutSettings<'a>) -> RolloutSettings<'a> {
    let RolloutSettings { config, actor, critic, reward, log_std_max, .. } = *settings;
    RolloutSettings { config, actor, critic, reward, repeat: 1, log_std_max, expert: None }
}
