//! The command `murmurate train` in scenarios without goals: training by imitation (`murmurate_train::imitation`).

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result};
use plotters::prelude::*;
use serde::{Deserialize, Serialize};

use super::budget::{Budget, Clock, Timed};
use super::curve::{SIZE, chart, smooth};
use super::folder::Folder;
use super::{Args, SAVE_EVERY, bar, finish, plan, resumes};
use murmurate::config::shown::counted;
use murmurate::config::{regular, unquoted};
use murmurate::registry::Registry;
use murmurate::scenario::Settings;
use murmurate_robot::output::{self, print, read_text, talk};
use murmurate_robot::{BadInput, Ended, bad};
use murmurate_train::imitation::config::{Config, PRESET};
use murmurate_train::imitation::trainer::{Metrics, Plan, Score, Trainer};

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

/// Result of a training, as it is printed.
#[derive(Serialize)]
struct Report<'a> {
    policy: String,
    scenario: &'a str,
    preset: &'a str,
    seed: u64,
    decisions: u64,
    iterations: u64,
    wall_s: f64,
    unit: &'a str,
    /// Costs at the end of the training; null after an interruption.
    evaluation: Option<Vec<Score>>,
    interrupted: bool,
}

/// Returns whether the flags ask for training by imitation: by the preset, by the configuration file, or, if they name
/// neither, because the scenario has no goals.
pub fn is_meant(args: &Args, registry: &Registry) -> Result<bool> {
    if let Some(path) = &args.config {
        return Ok(Config::is_in(&read_text(path, "training configuration")?));
    }
    if let Some(preset) = &args.preset {
        return Ok(preset == PRESET);
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
        None => (Config { robots: args.robots, ..Config::preset() }, PRESET),
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
    let head = format!("# Training of '{name}', from preset '{PRESET}'. Fields: docs/training.md.");
    print(format!("{head} Use: murmurate train {name} --config FILE.toml\n{text}").trim_end())?;
    Ok(Ended::Done)
}

/// Runs `train` in a scenario without goals.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    if args.print_config {
        return print_config(args, registry);
    }
    let (budget, began) = (Budget::of(args)?, Instant::now());
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = args.threads.map_or(cores, usize::from);
    let out = args.out.as_deref().expect("the parser requires it unless the configuration is printed");
    let mut folder = Folder::open(out, args.resume.is_some())?;
    let resumes = resumes(args, &folder);
    let (mut trainer, mut rows) = match resumes {
        true => {
            let trainer = resume(args, &folder, registry)?;
            let rows = rows_of(&folder.curve_text(trainer.iterations())?, trainer.iterations())?;
            (trainer, rows)
        }
        false => (begin(args, registry)?, Vec::new()),
    };
    if !resumes {
        folder.write_config(&trainer.plan().config)?;
        save(&mut folder, &trainer, &rows)?;
    }
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;
    tracing::info!("training by imitation; Ctrl-C saves everything");
    let spent_s = rows.last().map_or(0.0, |row: &Row| row.elapsed_s);
    let elapsed_s = || spent_s + began.elapsed().as_secs_f64();
    let mut clock = Clock::new(budget);
    if clock.counts_minutes() {
        // The only evaluation comes at the end: a part of one says how long that will take.
        let part = Instant::now();
        trainer.evaluate(EPISODES / EVALUATION_PART, threads);
        clock.took(Timed::Evaluation, f64::from(EVALUATION_PART) * part.elapsed().as_secs_f64());
    }
    let bar = bar(args.quiet);
    let (mut saved, mut interrupted) = (Instant::now(), false);
    loop {
        let progress = clock.progress(elapsed_s(), trainer.decisions());
        interrupted |= stop.load(Ordering::Relaxed);
        if progress >= 1.0 || interrupted {
            break;
        }
        let metrics = match clock.time(Timed::Iteration, || trainer.iterate(progress, threads)) {
            Ok(metrics) => metrics,
            Err(diverged) => {
                bar.abandon();
                return Err(anyhow::anyhow!("{diverged}; {}", folder.last_saved()));
            }
        };
        rows.push(row(elapsed_s(), progress, &metrics));
        let Metrics { decisions, loss, cost, .. } = metrics;
        let summary = format!("{decisions} decisions, loss {loss:.4}, cost {cost:.4}");
        bar.set_position((progress * 1000.0) as u64);
        bar.set_message(summary.clone());
        if saved.elapsed() >= SAVE_EVERY {
            saved = Instant::now();
            clock.time(Timed::Save, || save(&mut folder, &trainer, &rows))?;
            if bar.is_hidden() && !args.quiet {
                talk(&format!("{:3.0} %  {summary}", 100.0 * progress));
            }
        }
    }
    save(&mut folder, &trainer, &rows)?;
    let evaluation = (!interrupted).then(|| trainer.evaluate(EPISODES, threads));
    bar.finish_and_clear();
    let report = report(&folder, &trainer, (elapsed_s(), evaluation, interrupted));
    finish(args, &report, table, interrupted)
}

fn row(elapsed_s: f64, progress: f64, metrics: &Metrics) -> Row {
    let Metrics { iteration, decisions, loss, cost, collided, gradient, learning_rate } = *metrics;
    Row { elapsed_s, progress, iteration, decisions, loss, cost, collided, gradient, learning_rate }
}

/// Parses a learning curve, and keeps the rows up to the iteration `iterations`.
fn rows_of(text: &str, iterations: u64) -> Result<Vec<Row>> {
    let rows: Result<Vec<Row>, csv::Error> = csv::Reader::from_reader(text.as_bytes()).deserialize().collect();
    let rows = rows.map_err(|e| BadInput(format!("cannot read the curve: {e}")))?;
    Ok(rows.into_iter().filter(|row| row.iteration <= iterations).collect())
}

fn save(folder: &mut Folder, trainer: &Trainer, rows: &[Row]) -> Result<()> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    rows.iter().try_for_each(|row| csv.serialize(row)).context("a row is CSV")?;
    let csv = String::from_utf8(csv.into_inner().context("a curve is CSV")?).context("CSV is text")?;
    let svg = plot(&trainer.plan().scenario, trainer.scenario().cost().map_or("", |cost| cost.unit), rows)?;
    folder.save_files(trainer.iterations(), (trainer.policy_file(), csv, svg, trainer.checkpoint()))
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
        draw(&upper, &title, "squared error of the acceleration", line(|row| f64::from(row.loss)))?;
        draw(&lower, "", &format!("cost of the policy's episodes [{unit}]"), line(|row| row.cost))?;
        area.present()?;
    }
    Ok(svg)
}

/// Returns the result of the training.
fn report<'a>(
    folder: &Folder,
    trainer: &'a Trainer,
    (wall_s, evaluation, interrupted): (f64, Option<Vec<Score>>, bool),
) -> Report<'a> {
    let plan = trainer.plan();
    Report {
        policy: folder.policy().display().to_string(),
        scenario: &plan.scenario,
        preset: &plan.preset,
        seed: plan.seed,
        decisions: trainer.decisions(),
        iterations: trainer.iterations(),
        wall_s,
        unit: trainer.scenario().cost().map_or("", |cost| cost.unit),
        evaluation,
        interrupted,
    }
}

fn table(report: &Report) -> String {
    let Report { decisions, wall_s, preset, scenario, seed, unit, .. } = report;
    let mut lines =
        vec![format!("{} in {wall_s:.0} s; {preset} for '{scenario}', seed {seed}", counted(decisions, "decision"))];
    for score in report.evaluation.iter().flatten() {
        let (conditions, collided) = (score.conditions, 100.0 * score.collided);
        lines.push(format!(
            "{conditions:<10} cost [{unit}] {score}  collisions in {collided:.0} %  ({EPISODES} layouts)"
        ));
    }
    lines.push(format!("policy {}", report.policy));
    lines.join("\n")
}
