//! Results of a study in columns, aggregated from the records of its trials: one row per column and policy.

use serde::Serialize;

use super::columns::{BASELINE, Range};
use super::record::{Traces, TrialRecord};
use super::{Job, Study, published};
use murmurate::results::episode::Episode;
use murmurate::results::listening::Listening;
use murmurate::time::Span;
use murmurate_report::outcomes::Outcomes;

/// Results of one policy in one column, as `--json` prints them. Later versions may add fields and remove none.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the column, which stands for one set of conditions.
    pub name: String,
    /// Name of the policy.
    pub policy: String,
    /// Name of the handling of the policy: use of messages, choice of actions, limit of commands, safety filter.
    pub handling: String,
    /// Success, makespan and failures over all episodes.
    #[serde(flatten)]
    pub outcomes: Outcomes,
    /// Success rate in the paper's Table I, 0 to 1; null for a column that is not in it,
    /// and beside what the paper did not run: another task, team, gap, drive or policy.
    pub paper_success_rate: Option<f64>,
    /// Median makespan in the paper's Table I \[s\]; null as above.
    pub paper_makespan_median_s: Option<f64>,
    /// Fixed delay of messages between robots \[ms\]; null if the column uses the radio.
    pub delay_ms: Option<f64>,
    /// Loss probability of messages between robots, 0 to 1; null if the column uses the radio.
    pub loss: Option<f64>,
    /// Mean communication range \[m\]; null if it is that of the policy, or unlimited.
    pub range_m: Option<f32>,
    /// Delivery and age of messages between robots.
    #[serde(flatten)]
    pub delivery: Delivery,
}

/// Delivery and age of messages between robots; all fields are null if no message crosses a link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Delivery {
    /// Share of messages between robots that arrived.
    pub delivered: Option<f64>,
    /// Share of the arrived messages with at most 20 ms from publication to arrival.
    pub within_20ms: Option<f64>,
    /// Share of the arrived messages with at most 50 ms from publication to arrival.
    pub within_50ms: Option<f64>,
    /// Mean number of neighbours whose messages a control step uses.
    pub neighbours: Option<f64>,
    /// Median age of neighbours' messages at control steps, since publication \[ms\].
    pub age_p50_ms: Option<f64>,
}

impl Delivery {
    /// Returns what the counts say of delivery and age.
    pub fn of(listening: &Listening) -> Delivery {
        let within = |ms| listening.delay.share_within(Span::from_millis(ms));
        Delivery {
            delivered: listening.delivered(),
            within_20ms: within(20),
            within_50ms: within(50),
            neighbours: listening.neighbours(),
            age_p50_ms: listening.age.quantile_s(0.5).map(|age_s| 1000.0 * age_s),
        }
    }

    /// Returns the share of all expected deliveries that arrived within 50 ms.
    pub fn on_time(&self) -> Option<f64> {
        Some(self.delivered? * self.within_50ms?)
    }
}

/// Results of one policy in one column, with the data of its figures.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Row of the results table: success, makespan, failures and messages.
    pub row: Row,
    /// Makespans of the successful episodes \[s\], ordered by repeat and episode.
    pub makespans_s: Vec<f64>,
    /// Delivery and age of messages between robots.
    pub listening: Listening,
    /// Histograms of the robots' positions.
    pub traces: Traces,
}

/// Results of a study: one entry for each column and policy.
#[derive(Clone, Debug)]
pub struct Results {
    /// Results of each policy in each column, ordered by column and then by policy. Pairs without a record are left
    /// out.
    pub cells: Vec<Cell>,
}

impl Results {
    /// Aggregates the records of a study's trials to results, one for each column and policy.
    ///
    /// # Panics
    /// If `records` are not in the order of their trials, which determines the order of float sums.
    pub fn of(study: &Study, records: &[(Job, TrialRecord)]) -> Results {
        assert!(records.is_sorted_by_key(|(job, _)| *job), "records must be in the order of trials");
        let pairs = (0..study.columns.len()).flat_map(|column| (0..study.policies.len()).map(move |e| (column, e)));
        let cell = |(column, policy): (usize, usize)| {
            let of = |job: &Job| (job.column, job.policy) == (column, policy);
            let records: Vec<&TrialRecord> =
                records.iter().filter(|(job, _)| of(job)).map(|(_, record)| record).collect();
            (!records.is_empty()).then(|| Cell::of(study, (column, policy), &records))
        };
        Results { cells: pairs.filter_map(cell).collect() }
    }

    /// Returns the results of the study's policy with the index `policy`, in the order of the columns.
    pub fn of_policy<'a>(&'a self, study: &'a Study, policy: usize) -> Vec<&'a Cell> {
        let tested = &study.policies[policy];
        let is = |row: &Row| row.policy == tested.policy && row.handling == tested.handling.name;
        self.cells.iter().filter(|cell| is(&cell.row)).collect()
    }

    /// Returns the rows of the results table, ordered by column and then by policy.
    pub fn rows(&self) -> impl Iterator<Item = &Row> {
        self.cells.iter().map(|cell| &cell.row)
    }

    /// Returns the largest drop of one policy's success rate from the column [`BASELINE`] (conditions of training) to
    /// any column \[percentage points\]; `None` without a result in [`BASELINE`]. `cells` are the results of that
    /// policy.
    pub fn largest_drop_points(cells: &[&Cell]) -> Option<f64> {
        let baseline = cells.iter().find(|cell| cell.row.name == BASELINE)?.row.outcomes.success_rate;
        cells.iter().map(|cell| 100.0 * (baseline - cell.row.outcomes.success_rate)).reduce(f64::max)
    }
}

impl Cell {
    fn of(study: &Study, (column, policy): (usize, usize), records: &[&TrialRecord]) -> Cell {
        let episodes: Vec<Episode> = records.iter().flat_map(|record| &record.episodes).copied().collect();
        let mut listening = Listening::default();
        let mut traces = Traces::new(study.scenario.arena());
        for record in records {
            listening.merge(&record.listening);
            traces.merge(&record.traces);
        }
        let (column, tested) = (&study.columns[column], &study.policies[policy]);
        let paper = published::ran(study, tested).then(|| published::of(&column.name));
        let row = Row {
            name: column.name.clone(),
            policy: tested.policy.clone(),
            handling: tested.handling.name.to_owned(),
            outcomes: Outcomes::of(&episodes),
            paper_success_rate: paper.and_then(|paper| paper.success),
            paper_makespan_median_s: paper.and_then(|paper| paper.makespan_s),
            delay_ms: column.impairment().map(|(delay_s, _)| 1000.0 * delay_s),
            loss: column.impairment().map(|(_, loss)| loss),
            range_m: match column.range {
                Range::Within { mean_m, .. } => Some(mean_m),
                Range::Own | Range::Everyone => None,
            },
            delivery: Delivery::of(&listening),
        };
        let makespans_s = episodes.iter().filter_map(|episode| episode.makespan_s).collect();
        Cell { row, makespans_s, listening, traces }
    }
}
