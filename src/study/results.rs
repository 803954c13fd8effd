//! What came of a study: one row a column and entrant, from the records of its trials.

use serde::Serialize;

use super::columns::{BASELINE, Range};
use super::record::{Record, Traces};
use super::{Job, Study, published};
use crate::report::episode::Episode;
use crate::report::listening::Listening;
use crate::report::outcomes::Outcomes;
use crate::time::Span;

/// Shares and times of one column and entrant, as `--json` prints them. Fields are only ever added.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The column.
    pub name: String,
    /// The policy.
    pub policy: String,
    /// Its handling.
    pub handling: String,
    /// What came of its episodes.
    #[serde(flatten)]
    pub outcomes: Outcomes,
    /// The share that the paper reports for the column, where it is known.
    pub paper_success_rate: Option<f64>,
    /// The median makespan that the paper reports for the column, where it is known \[s\].
    pub paper_makespan_median_s: Option<f64>,
    /// What messages between robots suffered in place of the shared radio: delay \[ms\]; null where the radio is.
    pub delay_ms: Option<f64>,
    /// And the share lost.
    pub loss: Option<f64>,
    /// The radius within which robots hear each other \[m\]; null for the policy's own, or none.
    pub range_m: Option<f32>,
    /// The share of messages between robots that arrived; null where none crosses a link.
    pub delivered: Option<f64>,
    /// The share of arrivals within 20 ms of publication.
    pub within_20ms: Option<f64>,
    /// The share of arrivals within 50 ms.
    pub within_50ms: Option<f64>,
    /// How many neighbours a control step had a message of, on average.
    pub neighbours: Option<f64>,
    /// Median age of those messages, from publication \[ms\], by the bins of the histogram.
    pub age_p50_ms: Option<f64>,
}

/// One column and entrant, with what its figures are drawn from.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Shares and times.
    pub row: Row,
    /// Makespans of the successes \[s\], by repeat and episode.
    pub makespans_s: Vec<f64>,
    /// What robots heard.
    pub listening: Listening,
    /// Where they were.
    pub traces: Traces,
}

/// A whole study's results.
#[derive(Clone, Debug)]
pub struct Results {
    /// By column and then by entrant, without those that have no result yet.
    pub cells: Vec<Cell>,
}

impl Results {
    /// Puts together the records, each with its trial, in the order of their trials.
    pub fn of(study: &Study, records: &[(Job, Record)]) -> Results {
        assert!(records.is_sorted_by_key(|(job, _)| *job), "sums run in the order of trials");
        let pairs = (0..study.columns.len()).flat_map(|column| (0..study.entrants.len()).map(move |e| (column, e)));
        let cell = |(column, entrant): (usize, usize)| {
            let of = |job: &Job| (job.column, job.entrant) == (column, entrant);
            let records: Vec<&Record> = records.iter().filter(|(job, _)| of(job)).map(|(_, record)| record).collect();
            (!records.is_empty()).then(|| Cell::of(study, (column, entrant), &records))
        };
        Results { cells: pairs.filter_map(cell).collect() }
    }

    /// The cells of one entrant, by column.
    pub fn of_entrant<'a>(&'a self, study: &'a Study, entrant: usize) -> Vec<&'a Cell> {
        let entrant = &study.entrants[entrant];
        let is = |row: &Row| row.policy == entrant.policy && row.handling == entrant.handling.name;
        self.cells.iter().filter(|cell| is(&cell.row)).collect()
    }

    /// The rows.
    pub fn rows(&self) -> impl Iterator<Item = &Row> {
        self.cells.iter().map(|cell| &cell.row)
    }

    /// The largest fall of success against the baseline, over the columns of an entrant \[percentage points\].
    pub fn largest_drop_points(cells: &[&Cell]) -> Option<f64> {
        let baseline = cells.iter().find(|cell| cell.row.name == BASELINE)?.row.outcomes.success_rate;
        cells.iter().map(|cell| 100.0 * (baseline - cell.row.outcomes.success_rate)).reduce(f64::max)
    }
}

impl Cell {
    fn of(study: &Study, (column, entrant): (usize, usize), records: &[&Record]) -> Cell {
        let episodes: Vec<Episode> = records.iter().flat_map(|record| &record.episodes).copied().collect();
        let mut listening = Listening::default();
        let mut traces = Traces::new(study.scenario.arena());
        for record in records {
            listening.merge(&record.listening);
            traces.merge(&record.traces);
        }
        let (column, entrant) = (&study.columns[column], &study.entrants[entrant]);
        let paper = published::of(&column.name);
        let within = |ms| listening.delay.share_within(Span::from_millis(ms));
        let row = Row {
            name: column.name.clone(),
            policy: entrant.policy.clone(),
            handling: entrant.handling.name.to_owned(),
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
