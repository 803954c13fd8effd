//! Record of one trial of a study: results of its episodes, and histograms over its steps.

use serde::{Deserialize, Serialize};

use super::origin::Origin;
use super::{Job, Study};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::wire::Phase;
use murmurate::report::TrialReport;
use murmurate::results::episode::Episode;
use murmurate::results::listening::Listening;
use murmurate::results::totals::Step;
use murmurate::scenario::Arena;
use murmurate_report::grid::{Axis, Grid};

/// Bin width of the position histogram \[m\]. Bins are wider if an axis would have more than its largest number of
/// bins.
const CELL_M: f32 = 0.1;
const MOST_BINS: usize = 80;
/// Largest distance between robots in the histogram \[m\]; larger ones count as this one.
const FAR_M: f32 = 2.0;

/// Longest makespan and reset of an episode \[s\]: far beyond every time limit.
const LONGEST_S: f64 = 1e5;
/// Largest cost of an episode, in the unit of the scenario's cost.
const MOST_COST: f64 = 1e9;
/// Largest count of a histogram's bin: that of a million steps of ten thousand robots. Sums over all bins and records
/// stay below the largest integer.
const MOST_COUNT: u64 = 10_000_000_000;

/// Record of one trial of a study: results of its episodes and histograms of its steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrialRecord {
    /// Origin of the record: study, version, build, seed, policy and conditions that it was computed for.
    pub origin: Origin,
    /// Name of the trial's column.
    pub column: String,
    /// Name of the trial's policy.
    pub policy: String,
    /// Name of the handling of the policy: use of messages, choice of actions, limit of commands, safety filter.
    pub handling: String,
    /// Index of the trial's repeat, from 0.
    pub repeat: u32,
    /// Results of the trial's episodes.
    pub episodes: Vec<Episode>,
    /// Delivery and age of messages between robots.
    pub listening: Listening,
    /// Histograms of the robots' positions.
    pub traces: Traces,
}

/// Histograms of the robots' positions in running episodes, with one count per robot and step of the World (the
/// simulation of the bodies).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Traces {
    /// Histogram of the robots' positions x and y \[m\], world frame.
    pub position: Grid,
    /// Histogram of the distance of a robot from the origin (d_origin) and to the nearest other robot (d_min) \[m\].
    pub separation: Grid,
}

impl Traces {
    /// Returns empty histograms for robots on the ground of this arena.
    pub fn new(arena: &Arena) -> Traces {
        let half = arena.half_extent;
        let axis = |half: f32| Axis::new(-half, half, CELL_M, MOST_BINS);
        Traces {
            position: Grid::new(axis(half.x), axis(half.y)),
            separation: Grid::new(Axis::new(0.0, half.norm(), CELL_M, MOST_BINS), Axis::new(0.0, FAR_M, 0.02, 200)),
        }
    }

    fn add_step(&mut self, step: &Step) {
        if step.phase != Phase::Running {
            return;
        }
        let positions: Vec<Vec2> = step.samples.iter().map(|sample| sample.motion.position).collect();
        for (at, position) in positions.iter().enumerate() {
            self.position.add(position.x, position.y);
            let others = positions.iter().enumerate().filter(|(other, _)| *other != at);
            let nearest = others.map(|(_, other)| (*other - *position).norm()).fold(f32::INFINITY, f32::min);
            if nearest.is_finite() {
                self.separation.add(position.norm(), nearest);
            }
        }
    }

    /// Adds the counts of another record's histograms.
    pub fn merge(&mut self, other: &Traces) {
        self.position.merge(&other.position);
        self.separation.merge(&other.separation);
    }
}

/// Returns whether results can be those of the trial with the index `repeat`: a file may be damaged, and sums over
/// records must not overflow.
pub(crate) fn are_possible(episodes: &[Episode], repeat: u32, listening: &Listening) -> bool {
    let seconds = |value: f64| (0.0..=LONGEST_S).contains(&value);
    let episode = |(at, episode): (usize, &Episode)| {
        let Episode { makespan_s, reset_s, min_separation_m, cost, .. } = *episode;
        (episode.repeat, episode.episode as usize) == (repeat, at)
            && makespan_s.is_none_or(seconds)
            && seconds(reset_s)
            && min_separation_m >= 0.0
            && cost.is_none_or(|cost| cost.abs() <= MOST_COST)
    };
    episodes.iter().enumerate().all(episode) && listening.most() <= MOST_COUNT
}

impl TrialRecord {
    /// Returns the record of the finished trial `job` of a study. `report` has its results and steps.
    pub fn of(study: &Study, job: Job, report: &TrialReport) -> TrialRecord {
        let mut traces = Traces::new(study.scenario.arena());
        report.steps.iter().for_each(|step| traces.add_step(step));
        let tested = &study.policies[job.policy];
        TrialRecord {
            origin: study.origin(job),
            column: study.columns[job.column].name.clone(),
            policy: tested.policy.clone(),
            handling: tested.handling.name.to_owned(),
            repeat: job.repeat,
            episodes: report.episodes.clone(),
            listening: report.totals.listening,
            traces,
        }
    }

    /// Returns whether the numbers of the record can be those of a trial: a file may be damaged, and sums over records
    /// must not overflow.
    fn is_possible(&self) -> bool {
        let counts = [self.traces.position.most(), self.traces.separation.most()];
        are_possible(&self.episodes, self.repeat, &self.listening)
            && counts.into_iter().all(|count| count <= MOST_COUNT)
    }

    /// Returns whether this is the complete record of the trial `job` of the study, with numbers that a trial can have.
    pub fn belongs_to(&self, study: &Study, job: Job) -> bool {
        let tested = &study.policies[job.policy];
        let traces = Traces::new(study.scenario.arena());
        self.is_possible()
            && self.origin == study.origin(job)
            && self.column == study.columns[job.column].name
            && self.policy == tested.policy
            && self.handling == tested.handling.name
            && self.repeat == job.repeat
            && self.episodes.len() == study.layouts.len() as usize
            && (self.traces.position.x, self.traces.position.y) == (traces.position.x, traces.position.y)
            && (self.traces.separation.x, self.traces.separation.y) == (traces.separation.x, traces.separation.y)
    }
}
