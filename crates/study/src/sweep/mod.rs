//! Sweeps: the same trials over the values of one or two axes, such as the size of the team and the radio.
//!
//! Every point of a sweep is a simulation of its own, with its own team, task and policy. Layouts and all other
//! randomness are drawn from one seed, so points differ in nothing but what their axes say.

pub mod pages;
pub mod results;
pub mod table;

use murmurate::results::episode::Episode;
use murmurate::results::listening::Listening;
use murmurate::results::totals::Steps;
use murmurate::trial::Trial;
use serde::{Deserialize, Serialize};

use super::differing;
use super::origin::{self, Origin};
use super::record::are_possible;

/// Name of the study, in its files.
pub const NAME: &str = "sweep";

/// Quantity that a sweep varies, with its values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Name of the quantity: a flag of `sim` without `--`, or a field in the file of a flag, such as `radio.retries`.
    pub name: String,
    /// Values of the quantity, as they are given.
    pub values: Vec<String>,
}

/// One point of a sweep: a value on each axis, and the trial there.
#[derive(Clone)]
pub struct Point {
    /// Value on each axis, in the order of the axes.
    pub at: Vec<String>,
    /// First trial of the point; the others are repeats of it.
    pub trial: Trial,
    /// Name of the policy in reports.
    pub policy: String,
    /// Conditions that determine the results: flags with their values, and digests of the files that they name.
    pub conditions: Vec<String>,
}

/// Sweep: its axes and points, and what makes them its own.
#[derive(Clone)]
pub struct Sweep {
    /// One or two axes.
    pub axes: Vec<Axis>,
    /// Points for all combinations of values, ordered by the value on the last axis and then by that on the first.
    pub points: Vec<Point>,
    /// Number of trials at each point: the same layouts with other random numbers.
    pub repeats: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Flags that all points share, as text.
    pub setting: String,
    /// Command that reproduces this sweep.
    pub command: String,
    /// Digest of the program's sources: programs with equal digests compute the same numbers.
    pub build: String,
}

/// Indices that identify one trial of a sweep: its point, and its repeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Job {
    /// Index of the trial's point in the sweep.
    pub point: usize,
    /// Index of the trial's repeat, from 0.
    pub repeat: u32,
}

/// Identity of a sweep: everything that determines its results, and the command that started it. Stored results are
/// reused only if all fields but the command are the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Identity {
    /// Name of the study, [`NAME`].
    pub study: String,
    /// Version of the program.
    pub version: String,
    /// Digest of the program's sources.
    pub build: String,
    /// Axes of the sweep.
    pub axes: Vec<Axis>,
    /// Flags that all points share, as text.
    pub setting: String,
    /// Digest of the conditions of all points, files included.
    pub conditions: String,
    /// Number of trials at each point.
    pub repeats: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Command that reproduces this sweep.
    pub command: String,
}

/// Names of the fields of [`Identity`] that its `difference` compares, the most informative first. The command is
/// not compared.
const FIELDS: [&str; 8] = ["study", "axes", "setting", "seed", "repeats", "conditions", "version", "build"];

impl Identity {
    /// Returns the first field in which two identities differ, except the command: its name, its value in `self` and
    /// its value in `other`, both as JSON cut to 60 characters; `None` if there is none.
    pub fn difference(&self, other: &Identity) -> Option<(String, String, String)> {
        differing(&FIELDS, self, other)
    }
}

impl Sweep {
    /// Returns all trials of the sweep by their indices, ordered by point and then by repeat.
    pub fn jobs(&self) -> Vec<Job> {
        let of = |point| (0..self.repeats).map(move |repeat| Job { point, repeat });
        (0..self.points.len()).flat_map(of).collect()
    }

    /// Builds one trial of the sweep, ready to run.
    pub fn trial(&self, job: Job) -> Trial {
        // Delivery is counted at all receivers, as on real links.
        let (repeat, steps) = (job.repeat, Steps::Followed);
        Trial { repeat, steps, everywhere: true, ..self.points[job.point].trial.clone() }
    }

    /// Returns the number of episodes of all trials.
    pub fn episodes(&self) -> u64 {
        self.points.iter().map(|point| u64::from(point.trial.layouts.len()) * u64::from(self.repeats)).sum()
    }

    /// Returns the identity of the sweep, by which stored results are recognised as its own.
    pub fn identity(&self) -> Identity {
        let all: Vec<&[String]> = self.points.iter().map(|point| &*point.conditions).collect();
        Identity {
            study: NAME.to_owned(),
            version: origin::VERSION.to_owned(),
            build: self.build.clone(),
            axes: self.axes.clone(),
            setting: self.setting.clone(),
            conditions: Origin::here(&self.build, NAME, self.seed, "", &all).conditions,
            repeats: self.repeats,
            seed: self.seed,
            command: self.command.clone(),
        }
    }

    /// Returns the origin of the record of one trial. It does not depend on the sweep's other points, nor on the number
    /// of repeats.
    pub fn origin(&self, job: Job) -> Origin {
        let point = &self.points[job.point];
        Origin::here(&self.build, NAME, self.seed, &point.policy, &point.conditions)
    }
}

/// Record of one trial of a sweep: results of its episodes, and of the messages in them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointRecord {
    /// Origin of the record: study, version, build, seed, policy and conditions that it was computed for.
    pub origin: Origin,
    /// Value on each axis.
    pub at: Vec<String>,
    /// Index of the trial's repeat, from 0.
    pub repeat: u32,
    /// Results of the trial's episodes.
    pub episodes: Vec<Episode>,
    /// Delivery and age of messages between robots.
    pub listening: Listening,
}

impl PointRecord {
    /// Returns the record of the finished trial `job`, from the results of its episodes and messages.
    pub fn of(sweep: &Sweep, job: Job, episodes: Vec<Episode>, listening: Listening) -> PointRecord {
        let at = sweep.points[job.point].at.clone();
        PointRecord { origin: sweep.origin(job), at, repeat: job.repeat, episodes, listening }
    }

    /// Returns whether this is the complete record of the trial `job`, with numbers that a trial can have.
    pub fn belongs_to(&self, sweep: &Sweep, job: Job) -> bool {
        let point = &sweep.points[job.point];
        are_possible(&self.episodes, self.repeat, &self.listening)
            && self.origin == sweep.origin(job)
            && (&self.at, self.repeat) == (&point.at, job.repeat)
            && self.episodes.len() == point.trial.layouts.len() as usize
    }
}
