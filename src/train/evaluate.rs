//! The trainer's own quick evaluation: episodes judged as `sim` judges them, many at once.

use std::sync::Arc;

use serde::Serialize;

use super::conditions::Episode;
use super::config::Conditions;
use super::parallel::in_parallel;
use super::rollout::{CHUNK, Chunk, Rules};
use super::trainer::Trainer;
use crate::policy::Draw;
use crate::random::Seed;
use crate::report::statistics::quantile;
use crate::scenario::Scenario;
use crate::scenario::judge::{Finding, Judge, JudgedRobot, Verdict};
use crate::time::Span;
use crate::world::kinematic::PERIOD;

/// The seed of the layouts of a quick evaluation.
const QUICK: u64 = 0x9a11_e7a1;

/// What is to be evaluated.
#[derive(Debug)]
pub struct Examination<'a> {
    /// As in training; actions are held for one step.
    pub rules: &'a Rules<'a>,
    /// Of the policy.
    pub parameters: &'a [f32],
    /// The task.
    pub scenario: &'a Arc<dyn Scenario>,
    /// The seed of the layouts, and of everything else that is drawn.
    pub seed: u64,
    /// Layouts 0 to this.
    pub episodes: u32,
    /// How actions are drawn.
    pub draw: Draw,
}

impl Examination<'_> {
    /// Drives every layout once; `conditions` says what an episode is like, from its number.
    pub fn run(&self, conditions: impl Fn(u32) -> Episode + Sync, threads: usize) -> Vec<Finding> {
        let firsts: Vec<u32> = (0..self.episodes).step_by(CHUNK).collect();
        let mut findings: Vec<Vec<Finding>> = firsts.iter().map(|_| Vec::new()).collect();
        in_parallel(threads, firsts.iter().zip(&mut findings), |(&first, findings)| {
            *findings = self.chunk(first..self.episodes.min(first + CHUNK as u32), &conditions);
        });
        findings.concat()
    }

    fn chunk(&self, episodes: std::ops::Range<u32>, conditions: impl Fn(u32) -> Episode) -> Vec<Finding> {
        let (rules, robots) = (self.rules, self.scenario.robots());
        let mut stream = Seed::of_run(self.seed).stream(&format!("train/evaluate/{}", episodes.start));
        let rows = episodes.len();
        let mut chunk = Chunk::new(rows, &[vec![robots]], std::slice::from_ref(self.scenario), rules);
        let mut judges = Vec::new();
        for (team, episode) in episodes.enumerate() {
            chunk.crowd.place(team, (self.seed, episode), conditions(episode), &mut stream);
            let goals = chunk.crowd.tasks[chunk.crowd.teams[team].range()].iter().map(|task| task.goal);
            judges.push(Judge::new(self.scenario.rules(), goals.collect()));
        }
        let mut findings: Vec<Option<Finding>> = vec![None; rows];
        let mut after = Span::ZERO;
        while findings.iter().any(Option::is_none) {
            chunk.decide_alone(rules, self.parameters, self.draw, &mut stream);
            after = after + PERIOD;
            for team in 0..rows {
                if findings[team].is_some() {
                    continue;
                }
                chunk.step(rules, team, &mut stream);
                let range = chunk.crowd.teams[team].range();
                let seen: Vec<JudgedRobot> = range
                    .map(|robot| JudgedRobot {
                        position: chunk.crowd.position[robot],
                        contacts: chunk.crowd.contacts[robot],
                    })
                    .collect();
                findings[team] = judges[team].update(after, &seen);
            }
        }
        findings.into_iter().flatten().collect()
    }
}

/// How a policy did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// `perfect`: lock step and perfect messages; `disturbed`: conditions drawn as in training.
    pub conditions: &'static str,
    /// `mean` or `sample`.
    pub action: &'static str,
    /// Share of layouts that succeeded.
    pub success: f64,
    /// Median makespan of these \[s\].
    pub makespan_s: Option<f64>,
}

impl Score {
    /// Of these findings.
    pub fn of(conditions: &'static str, draw: Draw, findings: &[Finding]) -> Score {
        let successes = findings.iter().filter(|finding| finding.verdict == Verdict::Success);
        let makespans: Vec<f64> = successes.map(|finding| finding.after.as_secs()).collect();
        let action = if draw == Draw::Mean { "mean" } else { "sample" };
        let success = makespans.len() as f64 / findings.len().max(1) as f64;
        Score { conditions, action, success, makespan_s: quantile(&makespans, 0.5) }
    }
}

/// What a quick evaluation found; actions drawn as the policy's file says come first.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Scores(pub Vec<Score>);

impl Scores {
    /// Under these conditions, with actions drawn as the policy's file says.
    pub fn of_running(&self, conditions: &str) -> Option<&Score> {
        self.0.iter().find(|score| score.conditions == conditions)
    }
}

/// Evaluates a training's policy as it is now, on layouts that it is never trained on but by chance.
pub fn quick(trainer: &Trainer, episodes: u32, threads: usize) -> Scores {
    let rules = trainer.rules();
    let (rules, config) = (running(&rules), rules.config);
    let robots = trainer.scenario().robots();
    let seed = Seed::of_run(QUICK);
    let disturbed = |episode: u32| {
        let conditions = Conditions { clean: 0.0, ..config.conditions.clone() };
        Episode::draw(&conditions, robots, &mut seed.stream(&format!("train/disturbed/{episode}")))
    };
    let other = if config.policy.draw == Draw::Mean { Draw::Sample } else { Draw::Mean };
    let mut scores = Vec::new();
    for draw in [config.policy.draw, other] {
        let (parameters, scenario) = (trainer.parameters(), trainer.scenario());
        let examination = Examination { rules: &rules, parameters, scenario, seed: QUICK, episodes, draw };
        scores.push(Score::of("perfect", draw, &examination.run(|_| Episode::perfect(robots), threads)));
        if config.conditions.clean < 1.0 || config.conditions.deployed > 0.0 {
            scores.push(Score::of("disturbed", draw, &examination.run(disturbed, threads)));
        }
    }
    Scores(scores)
}

/// The rules of running a policy, as opposed to training it: an action is held for one step.
pub fn running<'a>(rules: &Rules<'a>) -> Rules<'a> {
    let Rules { config, actor, critic, reward, log_std_max, .. } = *rules;
    Rules { config, actor, critic, reward, repeat: 1, log_std_max }
}
