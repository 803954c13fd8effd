//! What stays of one trial of a study: its episodes, and histograms in place of its steps.

use serde::{Deserialize, Serialize};

use super::origin::Origin;
use super::{Job, Study};
use crate::messages::geometry::Vec2;
use crate::messages::wire::Phase;
use crate::report::episode::Episode;
use crate::report::grid::{Axis, Grid};
use crate::report::listening::Listening;
use crate::report::trial::{Step, TrialReport};
use crate::scenario::Arena;

/// Bins of the position histogram are this wide \[m\], unless the arena is so large that there would be more than
/// `MOST_BINS` of them along an axis.
const CELL_M: f32 = 0.1;
const MOST_BINS: usize = 80;
/// Distances between robots above this count with it \[m\].
const FAR_M: f32 = 2.0;

/// What stays of a trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// Its origin.
    pub origin: Origin,
    /// The column.
    pub column: String,
    /// The policy.
    pub policy: String,
    /// Its handling.
    pub handling: String,
    /// The repeat.
    pub repeat: u32,
    /// What came of each episode.
    pub episodes: Vec<Episode>,
    /// What robots heard of each other.
    pub listening: Listening,
    /// Where robots were.
    pub traces: Traces,
}

/// Where robots were while episodes ran, one count a robot and World step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Traces {
    /// Over x and y \[m\].
    pub position: Grid,
    /// Over a robot's distance from the origin, d_origin, and its distance to the nearest other robot, d_min \[m\].
    pub separation: Grid,
}

impl Traces {
    /// Nothing yet, in an arena.
    pub fn new(arena: &Arena) -> Traces {
        let half = arena.half_extent;
        let axis = |half: f32| Axis::new(-half, half, CELL_M, MOST_BINS);
        Traces {
            position: Grid::new(axis(half.x), axis(half.y)),
            separation: Grid::new(Axis::new(0.0, half.norm(), CELL_M, MOST_BINS), Axis::new(0.0, FAR_M, 0.02, 200)),
        }
    }

    fn see(&mut self, step: &Step) {
        if step.phase != Phase::Running {
            return;
        }
        let places: Vec<Vec2> = step.samples.iter().map(|sample| sample.motion.position).collect();
        for (at, place) in places.iter().enumerate() {
            self.position.add(place.x, place.y);
            let others = places.iter().enumerate().filter(|(other, _)| *other != at);
            let nearest = others.map(|(_, other)| (*other - *place).norm()).fold(f32::INFINITY, f32::min);
            if nearest.is_finite() {
                self.separation.add(place.norm(), nearest);
            }
        }
    }

    /// Adds those of another trial.
    pub fn merge(&mut self, other: &Traces) {
        self.position.merge(&other.position);
        self.separation.merge(&other.separation);
    }
}

impl Record {
    /// What stays of a trial of a study.
    pub fn of(study: &Study, job: Job, report: &TrialReport) -> Record {
        let mut traces = Traces::new(study.scenario.arena());
        report.steps.iter().for_each(|step| traces.see(step));
        let entrant = &study.entrants[job.entrant];
        Record {
            origin: study.origin(job),
            column: study.columns[job.column].name.clone(),
            policy: entrant.policy.clone(),
            handling: entrant.handling.name.to_owned(),
            repeat: job.repeat,
            episodes: report.episodes.clone(),
            listening: report.totals.listening,
            traces,
        }
    }

    /// Whether it is of that trial of the study, and whole.
    pub fn is_of(&self, study: &Study, job: Job) -> bool {
        let entrant = &study.entrants[job.entrant];
        let traces = Traces::new(study.scenario.arena());
        self.origin == study.origin(job)
            && self.column == study.columns[job.column].name
            && self.policy == entrant.policy
            && self.handling == entrant.handling.name
            && self.repeat == job.repeat
            && self.episodes.len() == study.layouts.len() as usize
            && (self.traces.position.x, self.traces.position.y) == (traces.position.x, traces.position.y)
            && (self.traces.separation.x, self.traces.separation.y) == (traces.separation.x, traces.separation.y)
    }
}
