//! The command `murmurate train` in scenarios with goals: training by rewards (`murmurate_train::trainer`).

use std::collections::BTreeMap;
use std::time::Instant;

use anyhow::{Context, Result};
use murmurate::deploy;
use murmurate::registry::Registry;
use murmurate_robot::Ended;
use murmurate_robot::output::{print, talk};
use murmurate_train::config::{Config, Role};
use murmurate_train::evaluate::{Score, Scores, glance, quick_evaluation};
use murmurate_train::expectation;
use murmurate_train::reward::has_reward;
use murmurate_train::trainer::{Diverged, Metrics, Trainer};

use super::budget::Budget;
use super::curve::{Curve, Row};
use super::folder::{Folder, POLICY, ROLES};
use super::training::{self, Training};
use super::{Args, Report, finish, plan};

/// Number of layouts of an evaluation during a training. A policy on its way lets most episodes run to their limit, so
/// each takes long.
const ON_THE_WAY: u32 = 32;
/// Number of layouts of the evaluation at the end.
const EPISODES: u32 = 128;
/// Share of these layouts, one in so many, by which a training of minutes finds out how long an evaluation takes.
const EVALUATION_PART: u32 = 16;

/// Training with its curve.
struct ByRewards {
    trainer: Trainer,
    curve: Curve,
    /// Results of the evaluation at the end.
    scores: Option<Scores>,
}

impl Training for ByRewards {
    type Metrics = Metrics;

    fn origin(&self) -> (&str, &str, u64) {
        let plan = self.trainer.plan();
        (self.trainer.scenario().name(), &plan.preset, plan.seed)
    }

    fn result(&self) -> &'static str {
        if self.trainer.plan().config.roles.is_empty() { POLICY } else { ROLES }
    }

    fn iterations(&self) -> u64 {
        self.trainer.iterations()
    }

    fn decisions(&self) -> u64 {
        self.trainer.decisions()
    }

    fn elapsed_s(&self) -> f64 {
        self.curve.elapsed_s()
    }

    fn iterate(&mut self, progress: f64, threads: usize) -> Result<Metrics, Diverged> {
        self.trainer.iterate(progress, threads)
    }

    fn note(&mut self, elapsed_s: f64, progress: f64, metrics: &Metrics) {
        self.curve.push(Row::new(elapsed_s, progress, metrics));
    }

    fn glance(&mut self, threads: usize) {
        self.curve.set_last_scores(&glance(&self.trainer, ON_THE_WAY, threads));
    }

    fn rehearse(&self, threads: usize) -> u32 {
        quick_evaluation(&self.trainer, EPISODES / EVALUATION_PART, threads);
        EVALUATION_PART
    }

    fn evaluate(&mut self, threads: usize) {
        let scores = quick_evaluation(&self.trainer, EPISODES, threads);
        self.curve.set_last_scores(&scores);
        self.scores = Some(scores);
    }

    fn summary(&self) -> String {
        self.curve.summary(self.trainer.decisions(), self.trainer.plan().config.curriculum.len())
    }

    fn save(&self, folder: &mut Folder) -> Result<()> {
        let (trainer, curve) = (&self.trainer, &self.curve);
        let files = (policies(trainer)?, curve.to_csv()?, curve.plot(trainer.scenario().name())?);
        folder.save(trainer.iterations(), files, &trainer.checkpoint())
    }
}

/// Returns the files of the policies with their names: one for all robots, or one for each role, and last the one that
/// says which robots have which role.
fn policies(trainer: &Trainer) -> Result<Vec<(String, Vec<u8>)>> {
    let roles = &trainer.plan().config.roles;
    let file = |role: &str| format!("{role}.safetensors");
    if roles.is_empty() {
        return Ok(trainer.policy_files().into_iter().map(|bytes| (POLICY.to_owned(), bytes)).collect());
    }
    let of_file = |(name, role): (&String, &Role)| {
        let role =
            deploy::Role { robots: role.robots.clone(), policy: Some(file(name).into()), ..deploy::Role::default() };
        (name.clone(), role)
    };
    let of_files: deploy::Roles = roles.iter().map(of_file).collect();
    let text = toml::to_string(&BTreeMap::from([("roles", of_files)])).context("roles are TOML")?;
    let names = roles.keys().map(|name| file(name));
    Ok(names.zip(trainer.policy_files()).chain([(ROLES.to_owned(), text.into_bytes())]).collect())
}

/// Runs `train` in a scenario with goals.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    if args.print_config {
        print(plan::config_text(args, registry)?.trim_end())?;
        return Ok(Ended::Done);
    }
    let (budget, began) = (Budget::of(args)?, Instant::now());
    let (mut folder, mut training) = begin(args, registry)?;
    if !args.quiet {
        announce(&training.trainer, budget);
    }
    let end = training::run(&mut training, &mut folder, (budget, began), args)?;
    finish(args, &Report::of(&training, (&folder, end), training.scores.as_ref()), table)
}

/// Opens the output folder, and returns it with the training in it, or with a new one, which is saved there.
fn begin(args: &Args, registry: &Registry) -> Result<(Folder, ByRewards)> {
    let (mut folder, resumes) = super::open_folder(args)?;
    if resumes {
        let trainer = plan::resume(args, &folder, registry)?;
        let curve = folder.curve(trainer.iterations(), Curve::from_csv)?;
        return Ok((folder, ByRewards { trainer, curve, scores: None }));
    }
    let training = ByRewards { trainer: plan::begin(args, registry)?, curve: Curve::default(), scores: None };
    folder.write_config(&training.trainer.plan().config)?;
    training.save(&mut folder)?;
    Ok((folder, training))
}

/// Says when the stages of the curriculum begin, and if the scenario has a reward of its own which the training does
/// not use.
fn announce(trainer: &Trainer, budget: Budget) {
    schedule(&trainer.plan().config, budget).iter().for_each(|stages| talk(stages));
    if !trainer.uses_scenario_reward() && has_reward(&**trainer.scenario()) {
        let name = &trainer.plan().scenario;
        talk(&format!("note: the reward of scenario '{name}' itself has weight 0 (reward.scenario) and is not used"));
    }
}

/// Returns a line about when the stages of the curriculum begin; `None` if there is only one.
fn schedule(config: &Config, budget: Budget) -> Option<String> {
    let (_, before) = config.curriculum.split_last()?;
    let begins = |share: f64| match budget {
        Budget::Minutes(minutes) => format!("{:.1} min", share * minutes),
        Budget::Decisions(decisions) => format!("{:.2} M decisions", share * decisions as f64 / 1e6),
    };
    let ends: Vec<String> = before.iter().map(|stage| begins(stage.until)).collect();
    let stages = config.curriculum.len();
    (!ends.is_empty())
        .then(|| format!("{stages} stages, the later ones from {} on; success drops as one begins", ends.join(", ")))
}

/// Returns a text on the success that trainings with this preset have reached after more decisions; `None` if none was
/// better than this one, or if nothing is known of the preset.
fn expectation(report: &Report<Scores>, decisions_per_s: f64) -> Option<String> {
    let measured = expectation::measured(report.preset)?;
    let success = report.evaluation?.with_default_draw("perfect")?.success;
    let better = measured.iter().find(|known| known.decisions > report.decisions && known.success > success)?;
    let known: Vec<String> = measured
        .iter()
        .map(|known| format!("{:.0} % after {:.1} M", 100.0 * known.success, known.decisions as f64 / 1e6))
        .collect();
    Some(format!(
        "{:.2} M decisions; on '{}' trainings with this preset reached {}; {:.1} M take about {:.0} minutes here",
        report.decisions as f64 / 1e6,
        expectation::SCENARIO,
        known.join(", "),
        better.decisions as f64 / 1e6,
        better.decisions as f64 / decisions_per_s / 60.0,
    ))
}

fn table(report: &Report<Scores>) -> String {
    let line = |score: &Score| {
        let makespan = score.makespan_s.map_or("-".to_owned(), |makespan| format!("{makespan:.2} s"));
        format!(
            "{:<10} {:<7} success {:5.1} %  median makespan {makespan}  ({EPISODES} layouts)",
            score.conditions,
            score.action,
            100.0 * score.success
        )
    };
    let hint = expectation(report, report.decisions as f64 / report.wall_s.max(1e-9));
    report.text(report.evaluation.iter().flat_map(|scores| &scores.0).map(line), hint)
}
