//! Results of a study, aggregated from the records of its trials: one row per column and policy.

use serde::Serialize;

use super::columns::{BASELINE, Range};
use super::record::{Record, Traces};
use super::{Job, Study, published};
use crate::report::episode::Episode;
use crate::report::listening::Listening;
use crate::report::outcomes::Outcomes;
use crate::time::Span;

/// Results of one column and policy, as `--json` prints them. Fields are only ever added.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the column.
    pub name: String,
    /// Name of the policy.
    pub policy: String,
    /// Name of the handling.
    pub handling: String,
    /// Success, makespan and failures over all its episodes.
    #[serde(flatten)]
    pub outcomes: Outcomes,
    /// Success rate that the paper reports for the column, if known.
    pub paper_success_rate: Option<f64>,
    /// Median makespan that the paper reports for the column, if known \[s\].
    pub paper_makespan_median_s: Option<f64>,
    /// Fixed delay of messages between robots \[ms\]; null with the shared radio.
    pub delay_ms: Option<f64>,
    /// Loss probability of messages between robots; null with the shared radio.
    pub loss: Option<f64>,
    /// Communication range \[m\]; null if it is the policy's own, or unlimited.
    pub range_m: Option<f32>,
    /// Share of messages between robots that arrived; null where none crosses a link.
    pub delivered: Option<f64>,
    /// Share of arrivals within 20 ms of publication.
    pub within_20ms: Option<f64>,
    /// Share of arrivals within 50 ms of publication.
    pub within_50ms: Option<f64>,
    /// Mean number of neighbours with a usable message at a control step.
    pub neighbours: Option<f64>,
    /// Median age of neighbours' messages at control steps, since publication \[ms\], from the histogram; null where
    /// none crosses a link.
    pub age_p50_ms: Option<f64>,
}

/// Results of one column and policy, with the data for its figures.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Row of the table.
    pub row: Row,
    /// Makespans of the successful episodes \[s\], by repeat and episode.
    pub makespans_s: Vec<f64>,
    /// Delivery and age of messages between robots.
    pub listening: Listening,
    /// Histograms of the robots' positions.
    pub traces: Traces,
}

/// Results of a study.
#[derive(Clone, Debug)]
pub struct Results {
    /// Results by column and then by policy. A pair without any result yet is left out.
    pub cells: Vec<Cell>,
}

impl Results {
    /// Aggregates the records of trials.
    ///
    /// # Panics
    /// Unless `records` are in the order of their trials, which fixes the order of float sums.
    pub fn of(study: &Study, records: &[(Job, Record)]) -> Results {
        assert!(records.is_sorted_by_key(|(job, _)| *job), "records must be in the order of trials");
        let pairs = (0..study.columns.len()).flat_map(|column| (0..study.policies.len()).map(move |e| (column, e)));
        let cell = |(column, policy): (usize, usize)| {
            let of = |job: &Job| (job.column, job.policy) == (column, policy);
            let records: Vec<&Record> = records.iter().filter(|(job, _)| of(job)).map(|(_, record)| record).collect();
            (!records.is_empty()).then(|| Cell::of(study, (column, policy), &records))
        };
        Results { cells: pairs.filter_map(cell).collect() }
    }

    /// Returns the cells of one policy, by column.
    pub fn of_policy<'a>(&'a self, study: &'a Study, policy: usize) -> Vec<&'a Cell> {
        let tested = &study.policies[policy];
        let is = |row: &Row| row.policy == tested.policy && row.handling == tested.handling.name;
        self.cells.iter().filter(|cell| is(&cell.row)).collect()
    }

    /// Returns the rows.
    pub fn rows(&self) -> impl Iterator<Item = &Row> {
        self.cells.iter().map(|cell| &cell.row)
    }

    /// Returns the largest drop of success against the baseline, over the columns of a policy \[percentage points\];
    /// `None` if the baseline has no result.
    pub fn largest_drop_points(cells: &[&Cell]) -> Option<f64> {
        let baseline = cells.iter().find(|cell| cell.row.name == BASELINE)?.row.outcomes.success_rate;
        cells.iter().map(|cell| 100.0 * (baseline - cell.row.outcomes.success_rate)).reduce(f64::max)
    }
}

impl Cell {
    fn of(study: &Study, (column, policy): (usize, usize), records: &[&Record]) -> Cell {
        let episodes: Vec<Episode> = records.iter().flat_map(|record| &record.episodes).copied().collect();
        let mut listening = Listening::default();
        let mut traces = Traces::new(study.scenario.arena());
        for record in records {
            listening.merge(&record.listening);
            traces.merge(&record.traces);
        }
        let (column, tested) = (&study.columns[column], &study.policies[policy]);
        let paper = published::of(&column.name);
        let within = |ms| listening.delay.share_within(Span::from_millis(ms));
        let row = Row {
            name: column.name.clone(),
            policy: tested.policy.clone(),
            handling: tested.handling.name.to_owned(),
            outcomes: Outcomes::of(&episodes),
            paper_success_rate: paper.success,
            paper_makespan_median_s: paper.makespan_s,
            delay_ms: column.impairment().map(|(delay_s, _)| 1000.0 * delay_s),
            loss: column.impairment().map(|(_, loss)| loss),
            range_m: match column.range {
                Range::Within { mean_m, .. } => Some(mean_m),
                Range::Own | Range::Everyone => None,
            },
            delivered: listening.delivered(),
            within_20ms: within(20),
            within_50ms: within(50),
            neighbours: listening.neighbours(),
            age_p50_ms: listening.age.quantile_s(0.5).map(|age_s| 1000.0 * age_s),
        };
        let makespans_s = episodes.iter().filter_map(|episode| episode.makespan_s).collect();
        Cell { row, makespans_s, listening, traces }
    }
}
