//! The command `murmurate study sweep`: simulations over the values of one or two flags or fields of files, with a
//! figure. The sweep itself is in the library of studies.

mod axis;
mod files;
pub(super) mod given;
pub(super) mod place;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result};
use indicatif::ProgressBar;
use murmurate::config::shown::counted;
use murmurate::registry::Registry;
use murmurate::trial::Trial;
use murmurate_study::sweep::results::{Results, Row};
use murmurate_study::sweep::{Job, NAME, Point, PointRecord, Sweep, table};
use serde::Serialize;

use super::flags::build;
use super::folder::Folder;
use super::part;
use super::run::{CommandLine, Run};
use super::shard::Shard;
use crate::progress::watched;
use crate::sim::EPISODES;
use crate::sim::trial::{self, Defined};
use axis::GivenAxis;
use given::Given;
use murmurate_robot::output::{print, talk};
use murmurate_robot::{BadInput, Ended, bad, own_name};

/// Flags of `murmurate study sweep`.
#[derive(clap::Args)]
pub struct Args {
    /// Axis of the sweep, once or twice: a flag of 'sim' that is below, without '--', with its values
    /// (robots=6,8,10), or a field in the file of a flag (radio.retries=0,3,7; files: conditions, deployment, faults,
    /// radio, roles, scenario, senses). The first one is the figure's axis, the second one makes its lines
    #[arg(long = "axis", value_name = "NAME=VALUE,...", required = true)]
    axes: Vec<GivenAxis>,
    /// Flags of `sim` that all points share.
    #[command(flatten)]
    given: Given,
    /// Runs the K-th of N parts of the trials, each part on a machine of its own, into the folder of --out. The same
    /// command without this flag then writes the report (docs/study.md)
    #[arg(long, value_name = "K/N", requires = "out")]
    shard: Option<Shard>,
    /// Flags that all studies share.
    #[command(flatten)]
    run: Run,
}

/// Output of a sweep with `--json`.
#[derive(Serialize)]
struct Report<'a> {
    study: &'static str,
    setting: &'a str,
    rows: Vec<&'a Row>,
    wall_s: f64,
    seed: u64,
    /// Number of finished trials, and number of all trials.
    trials: [usize; 2],
    interrupted: bool,
}

/// Runs `study sweep`: runs the trials of all points, prints the table and writes the report.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let sweep = args.sweep(registry)?;
    let folder = args.run.out.as_deref().map(|path| files::open(path, &sweep)).transpose()?;
    let stop = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&stop);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;

    let began = Instant::now();
    let records = args.run_all(&sweep, folder.as_ref(), &stop)?;
    let (all, done) = (sweep.jobs(), records.len());
    if let (Some(shard), Some(folder)) = (args.shard, &folder) {
        let finished: BTreeSet<Job> = records.iter().map(|(job, _)| *job).collect();
        return part::is_done((NAME, shard), &all, &finished, (folder, &args.run));
    }
    let (trials, interrupted) = ([done, all.len()], done < all.len());
    let results = Results::of(&sweep, &records);
    if let (Some(folder), false) = (&folder, interrupted) {
        files::write_report(folder, &sweep, &results, &records)?;
    }
    let wall_s = began.elapsed().as_secs_f64();
    print(&if args.run.json {
        let (setting, rows) = (&*sweep.setting, results.rows().collect());
        let report = Report { study: NAME, setting, rows, wall_s, seed: sweep.seed, trials, interrupted };
        serde_json::to_string(&report).context("a report is JSON")?
    } else {
        format!("{}\n\n{done} of {}; {wall_s:.1} s", table::text(&sweep, &results), counted(all.len(), "trial"))
    })?;
    args.run.print_location(folder.as_ref(), "trials", done, all.len());
    Ok(if interrupted { Ended::Interrupted } else { Ended::Done })
}

/// Returns the values of the first two points that are one simulation; `None` if all differ.
fn equal(points: &[Point]) -> Option<[String; 2]> {
    let mut seen = BTreeMap::new();
    points.iter().find_map(|point| {
        let Trial { deployment, physics, scenario, clamp, safety, handling, .. } = &point.trial;
        let Trial { step_takes, estimator, range, faults, models, .. } = &point.trial;
        let task = (scenario.name(), scenario.task_file().map(|file| file.digest()), deployment.to_toml());
        let rest = (physics, clamp, safety, handling, step_takes, range, estimator.name, models.mark());
        let key = format!("{task:?} {rest:?} {faults:?} {:?}", point.policy);
        let other = seen.insert(key, point.at.join(", "))?;
        Some([other, point.at.join(", ")])
    })
}

impl Args {
    /// Returns the sweep as the flags define it. An error names the axis and its value, or the flag.
    fn sweep(&self, registry: &Registry) -> Result<Sweep> {
        if self.axes.len() > 2 {
            return bad(format!("--axis: {} of them; a sweep has one or two", self.axes.len()));
        }
        if let [first, second] = &self.axes[..]
            && first.place == second.place
        {
            return bad(format!("--axis: {} is given twice", first.axis.name));
        }
        if let Some(twice) = self.axes.iter().find(|axis| self.given.has(&axis.axis.name)) {
            let name = &twice.axis.name;
            return bad(format!("--axis {name}: --{name} is given, too; leave one of the two out"));
        }
        let mut points = Vec::new();
        let mut warned = BTreeSet::new();
        let seconds = self.axes.get(1).map_or(vec![None], |axis| axis.axis.values.iter().map(Some).collect());
        for second in seconds {
            for first in &self.axes[0].axis.values {
                let at: Vec<&str> = [Some(first), second].into_iter().flatten().map(String::as_str).collect();
                let (point, warnings) = self.point(&at, registry)?;
                points.push(point);
                for warning in warnings {
                    if !self.run.quiet && warned.insert(warning.clone()) {
                        talk(&format!("warning: {warning}"));
                    }
                }
            }
        }
        let costs = points.iter().filter(|point| point.trial.scenario.cost().is_some()).count();
        if costs > 0 && costs < points.len() {
            return bad("--axis: some points have goals and others a cost, which cannot be compared".to_owned());
        }
        if let (Some([one, other]), false) = (equal(&points), self.run.quiet) {
            talk(&format!("warning: the points '{one}' and '{other}' are one simulation: an axis has no effect there"));
        }
        let repeats = self.given.at(&[])?.repeats();
        let setting: Vec<String> = self.given.words().map(|(flag, value)| format!("--{flag} {value}")).collect();
        Ok(Sweep {
            axes: self.axes.iter().map(|axis| axis.axis.clone()).collect(),
            points,
            repeats,
            seed: self.run.seed,
            setting: setting.join(" "),
            command: self.command(),
            build: build(registry)?,
        })
    }

    /// Returns the point with these values on the axes, and warnings about its policy.
    fn point(&self, at: &[&str], registry: &Registry) -> Result<(Point, Vec<String>)> {
        let values = self.axes.iter().map(|axis| axis.place.clone()).zip(at.iter().copied()).collect::<Vec<_>>();
        let place = || self.axes.iter().zip(at).map(|(axis, value)| format!("{}={value}", axis.axis.name));
        let wrong = |error: anyhow::Error| {
            let at = place().collect::<Vec<_>>().join(", ");
            // Only what the user can mend gets the name of the point.
            match error.downcast::<BadInput>() {
                Ok(BadInput(why)) => BadInput(format!("--axis {at}: {why}")).into(),
                Err(error) => error,
            }
        };
        let setup = self.given.at(&values).map_err(wrong)?;
        let policy = match &setup.policy[..] {
            [] => None,
            [policy] => Some(&**policy),
            _ => return bad("--policy: name one policy, or make it an axis (--axis policy=A,B)".to_owned()),
        };
        let episodes = setup.episodes(EPISODES);
        let defined =
            trial::of_flags(&setup, (self.run.seed, episodes), policy, (registry, &|_| None)).map_err(wrong)?;
        let Defined { trial, policy, warnings } = defined;
        let mut conditions: Vec<String> = self.given.words().map(|(flag, value)| format!("--{flag}={value}")).collect();
        conditions.extend(place());
        let of_roles = trial.deployment.roles.values().filter_map(|role| role.policy.clone());
        let files: Vec<PathBuf> = setup.files().into_iter().chain(of_roles).collect();
        conditions.extend(files.iter().filter_map(|path| given::digest(path)));
        conditions.push(format!("{episodes} episodes"));
        let at = at.iter().map(|value| (*value).to_owned()).collect();
        Ok((Point { at, trial, policy, conditions }, warnings))
    }

    /// Returns the command line that reproduces the sweep, without flags that do not affect the results.
    fn command(&self) -> String {
        let mut command = CommandLine(format!("{} study sweep", own_name()));
        for axis in &self.axes {
            command.add("axis", Some(format!("{}={}", axis.axis.name, axis.axis.values.join(","))));
        }
        self.given.words().for_each(|(flag, value)| command.add(flag, Some(value)));
        command.add("seed", Some(self.run.seed.to_string()));
        command.0
    }

    /// Returns the results of all trials of the sweep, in order: reads those of finished trials from the folder, and
    /// runs the others. After Ctrl-C, or with `--shard`, some are missing.
    fn run_all(&self, sweep: &Sweep, folder: Option<&Folder>, stop: &AtomicBool) -> Result<Vec<(Job, PointRecord)>> {
        let all = sweep.jobs();
        let found: Vec<Option<PointRecord>> =
            all.iter().map(|job| folder.and_then(|folder| files::read(folder, sweep, *job))).collect();
        let episodes = |job: Job| u64::from(sweep.points[job.point].trial.layouts.len());
        let work = |job: Job, bar: &ProgressBar| -> Result<Option<PointRecord>> {
            let report = sweep.trial(job).run_while(watched(bar, stop));
            if !report.finished {
                return Ok(None);
            }
            let record = PointRecord::of(sweep, job, report.episodes, report.totals.listening);
            folder.map_or(Ok(()), |folder| files::write(folder, job, &record))?;
            tracing::info!("kept repeat {} of point {}", job.repeat, record.at.join(", "));
            Ok(Some(record))
        };
        part::finish((all, found), (&self.run, self.shard), ("trial", episodes), stop, work)
    }
}
