//! A training, whatever its objective: iterations, evaluations and saves until its budget is used or Ctrl-C, with
//! progress.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use indicatif::{ProgressBar, ProgressStyle};
use murmurate_train::trainer::Diverged;

use super::Args;
use super::budget::{Budget, Clock, Timed};
use super::folder::{Folder, POLICY};
use murmurate_robot::output::talk;

/// Interval at which a training saves its files, and prints progress lines if there is no progress bar.
const SAVE_EVERY: Duration = Duration::from_secs(30);
/// Interval of evaluations during a training, as a share of the whole training.
const EVALUATE_EVERY: f64 = 0.05;

/// Training with its learning curve.
pub trait Training {
    /// Results of an iteration.
    type Metrics;

    /// Returns the name of the scenario, that of the preset, and the seed.
    fn origin(&self) -> (&str, &str, u64);

    /// Returns the name of the file from which the policy is run.
    fn result(&self) -> &'static str {
        POLICY
    }

    /// Returns the number of iterations so far.
    fn iterations(&self) -> u64;

    /// Returns the number of decisions so far.
    fn decisions(&self) -> u64;

    /// Returns the duration of the training up to the last row of the curve \[s\]; 0 without a row.
    fn elapsed_s(&self) -> f64;

    /// Performs one iteration at this share of the training. An error is a training that cannot go on.
    fn iterate(&mut self, progress: f64, threads: usize) -> Result<Self::Metrics, Diverged>;

    /// Adds an iteration to the curve. `elapsed_s` is the duration of the training so far \[s\].
    fn note(&mut self, elapsed_s: f64, progress: f64, metrics: &Self::Metrics);

    /// Evaluates the policy on its way, and adds that to the last row of the curve.
    fn glance(&mut self, threads: usize);

    /// Evaluates a part of what `evaluate` does, one in so many as it returns.
    fn rehearse(&self, threads: usize) -> u32;

    /// Evaluates the policy at the end.
    fn evaluate(&mut self, threads: usize);

    /// Returns the state of the training in one line.
    fn summary(&self) -> String;

    /// Saves all files.
    fn save(&self, folder: &mut Folder) -> Result<()>;
}

/// End of a training.
#[derive(Clone, Copy, Debug)]
pub struct End {
    /// Duration of the training, with those from which it was resumed \[s\].
    pub elapsed_s: f64,
    /// Whether Ctrl-C has ended it.
    pub interrupted: bool,
}

/// Runs a training that began at `began` until its budget is used or Ctrl-C, evaluates its policy unless it was
/// interrupted, and saves it.
///
/// # Errors
/// If the training cannot go on, or a file cannot be written; the error says what is saved.
pub fn run(
    training: &mut impl Training,
    folder: &mut Folder,
    (budget, began): (Budget, Instant),
    args: &Args,
) -> Result<End> {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = args.threads.map_or(cores, usize::from);
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;
    tracing::info!("training; Ctrl-C saves everything");
    let spent_s = training.elapsed_s();
    let elapsed_s = || spent_s + began.elapsed().as_secs_f64();
    let mut clock = Clock::new(budget);
    if clock.counts_minutes() {
        // A short training may have only the evaluation at its end: a part of one says how long that will take.
        let part = Instant::now();
        let parts = training.rehearse(threads);
        clock.took(Timed::Evaluation, f64::from(parts) * part.elapsed().as_secs_f64());
    }
    let bar = bar(args.quiet);
    let (mut saved, mut evaluated, mut interrupted) = (Instant::now(), None, false);
    loop {
        let progress = clock.progress(elapsed_s(), training.decisions());
        interrupted |= progress < 1.0 && stop.load(Ordering::Relaxed);
        if progress >= 1.0 || interrupted {
            break;
        }
        let metrics = clock.time(Timed::Iteration, || training.iterate(progress, threads));
        let metrics = metrics.map_err(|diverged| {
            bar.abandon();
            anyhow::anyhow!("{diverged}; {}", folder.last_saved())
        })?;
        training.note(elapsed_s(), progress, &metrics);
        let part = (progress / EVALUATE_EVERY) as u64;
        if *evaluated.get_or_insert(part) < part {
            evaluated = Some(part);
            clock.time(Timed::Glance, || training.glance(threads));
        }
        bar.set_position((progress * 1000.0) as u64);
        bar.set_message(training.summary());
        if saved.elapsed() >= SAVE_EVERY {
            saved = Instant::now();
            clock.time(Timed::Save, || training.save(folder))?;
            if bar.is_hidden() && !args.quiet {
                talk(&format!("{:3.0} %  {}", 100.0 * progress, training.summary()));
            }
        }
    }
    training.save(folder)?;
    if !interrupted {
        training.evaluate(threads);
        training.save(folder)?;
    }
    bar.finish_and_clear();
    Ok(End { elapsed_s: elapsed_s(), interrupted })
}

fn bar(quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    // If stderr is not a terminal, the bar draws nothing, and progress lines are printed.
    let bar = ProgressBar::new(1000);
    let template = "{bar:24} {percent:>3} %  {msg}, {eta} left";
    bar.set_style(ProgressStyle::with_template(template).expect("the template is valid"));
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}
