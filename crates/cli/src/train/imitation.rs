//! The command `murmurate train` in scenarios without goals: training by imitation (`murmurate_train::imitation`).

use std::time::Instant;

use anyhow::{Context, Result};
use plotters::prelude::*;
use serde::{Deserialize, Serialize};

use super::budget::Budget;
use super::curve::{SIZE, chart, smooth};
use super::folder::{Folder, POLICY};
use super::training::{self, Training};
use super::{Args, Report, finish, plan};
use murmurate::config::{regular, unquoted};
use murmurate::registry::Registry;
use murmurate::scenario::Settings;
use murmurate_robot::output::{self, print, read_text};
use murmurate_robot::{BadInput, Ended, bad};
use murmurate_train::imitation::config::{Config, PRESETS};
use murmurate_train::imitation::trainer::{Metrics, Plan, Score, Trainer};
use murmurate_train::trainer::Diverged;

/// Number of layouts of the evaluation at the end.
const EPISODES: u32 = 64;
/// Share of these layouts, one in so many, by which a training of minutes finds out how long that evaluation takes.
const EVALUATION_PART: u32 = 8;

/// Row of the learning curve: metrics of one iteration.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Row {
    elapsed_s: f64,
    progress: f64,
    iteration: u64,
    decisions: u64,
    loss: f32,
    cost: f64,
    collided: f64,
    gradient: f32,
    learning_rate: f32,
}

/// Returns whether the flags ask for training by imitation: by the preset, by the configuration file, or, if they name
/// neither, because the scenario has no goals.
pub fn is_meant(args: &Args, registry: &Registry) -> Result<bool> {
    if let Some(path) = &args.config {
        return Ok(Config::is_in(&read_text(path, "training configuration")?));
    }
    if let Some(preset) = &args.preset {
        return Ok(PRESETS.iter().any(|(name, _)| name == preset));
    }
    let settings = args.size.over(Settings { robots: args.robots, ..Settings::default() });
    let scenario = registry.scenario(&args.scenario, &settings);
    Ok(scenario.is_ok_and(|scenario| scenario.cost().is_some()))
}

/// Returns the plan that the flags define.
fn plan_of(args: &Args) -> Result<Plan> {
    let unused = [
        ("--radio", args.radio.is_some()),
        ("--conditions", args.conditions.is_some()),
        ("--from", args.from.is_some()),
        ("--drive and its flags", !args.drive.is_empty()),
    ];
    if let Some((flag, _)) = unused.iter().find(|(_, given)| *given) {
        return bad(format!("{flag}: training by imitation does not have it; leave it out"));
    }
    let (config, preset) = match &args.config {
        Some(path) => {
            let config = Config::from_toml(&read_text(path, "training configuration")?);
            let wrong = |e| BadInput(format!("the training configuration '{}': {e}", path.display()));
            (config.map_err(wrong)?, "a configuration of the user's")
        }
        None => {
            let name = args.preset.as_deref().unwrap_or_else(|| Config::preset_of(&args.scenario));
            let preset = Config::preset(name).expect("the parser accepts presets only");
            (Config { robots: args.robots, ..preset }, name)
        }
    };
    let (scale, hull_m) = (args.size.scale.or(config.scale), args.size.hull_m.or(config.hull_m));
    let config = Config { scale, hull_m, ..config };
    let config = plan::with_fields(config, &args.set, Config::from_table)?;
    let (scenario, preset) = (args.scenario.clone(), preset.to_owned());
    Ok(Plan { scenario, preset, config, seed: args.seed.unwrap_or(0) })
}

/// Creates the trainer of a new training; an error names the flag or the file.
fn begin(args: &Args, registry: &Registry) -> Result<Trainer> {
    Ok(Trainer::new(plan_of(args)?, registry).map_err(|error| match &args.config {
        Some(path) => BadInput(format!("the training configuration '{}': {error}", path.display())),
        None => BadInput(error.to_string()),
    })?)
}

/// Loads the trainer of an earlier training; an error says in what it differs from the flags.
fn resume(args: &Args, folder: &Folder, registry: &Registry) -> Result<Trainer> {
    let wrong = |why: String| BadInput(format!("cannot resume '{}': {why}", folder.checkpoint().display()));
    let bytes = regular::read(&folder.checkpoint(), output::MAX_CHECKPOINT)
        .map_err(|e| wrong(format!("{e}; leave out --resume to start a training")))?;
    let trainer = Trainer::resume(&bytes, registry).map_err(|e| wrong(unquoted(&e.to_string())))?;
    let theirs = trainer.plan();
    let sized = args.size.given().next().is_some();
    let names_fields = args.config.is_some() || args.robots.is_some() || sized || !args.set.is_empty();
    let mut ours = plan_of(args)?;
    ours.config.robots = ours.config.robots.or(theirs.config.robots);
    let differs = theirs.scenario != ours.scenario
        || args.seed.is_some_and(|seed| seed != theirs.seed)
        || (names_fields && theirs.config != ours.config);
    if differs {
        let why = "it is of another training: scenario, seed or configuration differ; see config.toml beside it";
        return Err(wrong(why.to_owned()).into());
    }
    Ok(trainer)
}

/// Prints the configuration that the flags give, as a file to begin with.
fn print_config(args: &Args, registry: &Registry) -> Result<Ended> {
    let plan = begin(args, registry)?.plan().clone();
    let text = toml::to_string(&plan.config).context("a configuration is TOML")?;
    let name = &args.scenario;
    let head = format!("# Training of '{name}', from preset '{}'. Fields: docs/training.md.", plan.preset);
    print(format!("{head} Use: murmurate train {name} --config FILE.toml\n{text}").trim_end())?;
    Ok(Ended::Done)
}

/// Training with its curve.
struct ByImitation {
    trainer: Trainer,
    rows: Vec<Row>,
    /// Results of the evaluation at the end.
    evaluation: Option<Vec<Score>>,
}

impl Training for ByImitation {
    type Metrics = Metrics;

    fn origin(&self) -> (&str, &str, u64) {
        let plan = self.trainer.plan();
        (&plan.scenario, &plan.preset, plan.seed)
    }

    fn iterations(&self) -> u64 {
        self.trainer.iterations()
    }

    fn decisions(&self) -> u64 {
        self.trainer.decisions()
    }

    fn elapsed_s(&self) -> f64 {
        self.rows.last().map_or(0.0, |row| row.elapsed_s)
    }

    fn iterate(&mut self, progress: f64, threads: usize) -> Result<Metrics, Diverged> {
        self.trainer.iterate(progress, threads)
    }

    fn note(&mut self, elapsed_s: f64, progress: f64, metrics: &Metrics) {
        self.rows.push(row(elapsed_s, progress, metrics));
    }

    // Each iteration has the cost of its own episodes.
    fn glance(&mut self, _: usize) {}

    fn rehearse(&self, threads: usize) -> u32 {
        self.trainer.evaluate(EPISODES / EVALUATION_PART, threads);
        EVALUATION_PART
    }

    fn evaluate(&mut self, threads: usize) {
        self.evaluation = Some(self.trainer.evaluate(EPISODES, threads));
    }

    fn summary(&self) -> String {
        let Some(Row { decisions, loss, cost, .. }) = self.rows.last() else { return String::new() };
        format!("{decisions} decisions, loss {loss:.4}, cost {cost:.4}")
    }

    fn save(&self, folder: &mut Folder) -> Result<()> {
        let ByImitation { trainer, rows, .. } = self;
        let mut csv = csv::Writer::from_writer(Vec::new());
        rows.iter().try_for_each(|row| csv.serialize(row)).context("a row is CSV")?;
        let csv = String::from_utf8(csv.into_inner().context("a curve is CSV")?).context("CSV is text")?;
        let svg = plot(&trainer.plan().scenario, trainer.scenario().cost().map_or("", |cost| cost.unit), rows)?;
        let policies = vec![(POLICY.to_owned(), trainer.policy_file())];
        folder.save(trainer.iterations(), (policies, csv, svg), &trainer.checkpoint())
    }
}

/// Runs `train` in a scenario without goals.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    if args.print_config {
        return print_config(args, registry);
    }
    let (budget, began) = (Budget::of(args)?, Instant::now());
    let (mut folder, resumes) = super::open_folder(args)?;
    let mut training = if resumes {
        let trainer = resume(args, &folder, registry)?;
        let rows = folder.curve(trainer.iterations(), rows_of)?;
        ByImitation { trainer, rows, evaluation: None }
    } else {
        let training = ByImitation { trainer: begin(args, registry)?, rows: Vec::new(), evaluation: None };
        folder.write_config(&training.trainer.plan().config)?;
        training.save(&mut folder)?;
        training
    };
    let end = training::run(&mut training, &mut folder, (budget, began), args)?;
    let unit = training.trainer.scenario().cost().map(|cost| cost.unit);
    let report = Report { unit, ..Report::of(&training, (&folder, end), training.evaluation.as_deref()) };
    finish(args, &report, table)
}

fn row(elapsed_s: f64, progress: f64, metrics: &Metrics) -> Row {
    let Metrics { iteration, decisions, loss, cost, collided, gradient, learning_rate } = *metrics;
    Row { elapsed_s, progress, iteration, decisions, loss, cost, collided, gradient, learning_rate }
}

/// Parses a learning curve, and keeps the rows up to the iteration `iterations`.
fn rows_of(text: &str, iterations: u64) -> Result<Vec<Row>, csv::Error> {
    let rows: Result<Vec<Row>, csv::Error> = csv::Reader::from_reader(text.as_bytes()).deserialize().collect();
    Ok(rows?.into_iter().filter(|row| row.iteration <= iterations).collect())
}

/// Plots loss and cost over the decisions; returns the SVG.
fn plot(scenario: &str, unit: &str, rows: &[Row]) -> Result<String> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let (upper, lower) = area.split_vertically(SIZE.1 / 2);
        let last = rows.last().map_or(1.0, |row| row.decisions as f64 / 1e6).max(1e-6);
        let line = |pick: fn(&Row) -> f64| -> Vec<(f64, f64)> {
            let point = |row: &Row| Some((row.decisions as f64 / 1e6, Some(pick(row)).filter(|y| y.is_finite())?));
            smooth(&rows.iter().filter_map(point).collect::<Vec<_>>())
        };
        let draw = |area, title: &str, y: &str, points: Vec<(f64, f64)>| {
            let high = points.iter().map(|point| point.1).fold(1e-3, f64::max);
            chart(area, title, (last, 0.0..1.05 * high), y, (&[("in training", points)], &[]))
        };
        let title = format!("Training '{scenario}' by imitation");
        draw(&upper, &title, "squared error of the action", line(|row| f64::from(row.loss)))?;
        draw(&lower, "", &format!("cost of the policy's episodes [{unit}]"), line(|row| row.cost))?;
        area.present()?;
    }
    Ok(svg)
}

fn table(report: &Report<[Score]>) -> String {
    let unit = report.unit.unwrap_or_default();
    let line = |score: &Score| {
        let (conditions, collided) = (score.conditions, 100.0 * score.collided);
        format!("{conditions:<10} cost [{unit}] {score}  collisions in {collided:.0} %  ({EPISODES} layouts)")
    };
    report.text(report.evaluation.into_iter().flatten().map(line), None)
}
