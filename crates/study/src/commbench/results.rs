//! Results of the benchmark: a row for each policy in each cell, and verdicts on pairs of them.

use murmurate::results::episode::Episode;
use murmurate::results::listening::Listening;
use murmurate_report::outcomes::Outcomes;
use serde::Serialize;

use super::matrix::REFERENCE;
use super::verdict::{Difference, Measure, Scored, Verdict};
use super::{Bench, Entry, Job, Record};
use crate::results::Delivery;

/// Results of one policy in one cell, as `--json` prints them. Later versions may add fields and remove none.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the task.
    pub task: String,
    /// Name of the channel.
    pub channel: String,
    /// Number of robots.
    pub robots: usize,
    /// Kind of policy, or the name of one that was entered.
    pub entrant: String,
    /// Policy as `sim --policy` takes it.
    pub policy: String,
    /// Flags of `sim` and fields of its files, with their values, that make the cell.
    pub settings: Vec<String>,
    /// Share of episodes that did not fail, 0 to 1.
    pub done: f64,
    /// Mean of the score: makespan \[s\] with the task's time limit for failures, or the cost; `None` without one.
    pub score: Option<f64>,
    /// Unit of the score.
    pub unit: &'static str,
    /// Success, makespan, failures and cost over all episodes.
    #[serde(flatten)]
    pub outcomes: Outcomes,
    /// Delivery and age of messages between robots.
    #[serde(flatten)]
    pub delivery: Delivery,
}

/// Result with which a policy's result is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Against {
    /// The same policy on the channel [`REFERENCE`], with as many robots.
    Reference,
    /// Another policy in the same cell.
    Policy,
}

/// Comparison of two results of the same episodes, as `--json` prints it.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// Name of the task.
    pub task: String,
    /// Name of the channel.
    pub channel: String,
    /// Number of robots.
    pub robots: usize,
    /// Kind or name of the policy.
    pub entrant: String,
    /// Kind of the result with which it is compared.
    pub of: Against,
    /// Name of the other policy or of the other channel.
    pub against: String,
    /// Measure that is compared.
    pub measure: Measure,
    /// The paired difference, its interval and the verdict.
    #[serde(flatten)]
    pub difference: Difference,
}

/// Results of a benchmark.
#[derive(Clone, Debug)]
pub struct Results {
    /// A row for each entry in their order; `None` for one that is not finished.
    pub rows: Vec<Option<Row>>,
    /// All comparisons of finished entries.
    pub comparisons: Vec<Comparison>,
}

impl Results {
    /// Aggregates the records of a benchmark's jobs.
    ///
    /// # Panics
    /// If `records` are not in the order of their jobs, which determines the order of float sums.
    pub fn of(bench: &Bench, records: &[(Job, Record)]) -> Results {
        assert!(records.is_sorted_by_key(|(job, _)| *job), "records must be in the order of jobs");
        let finished = |at: usize| {
            let parts: Vec<&Record> =
                records.iter().filter(|(job, _)| job.entry == at).map(|(_, record)| record).collect();
            let episodes: Vec<Episode> = parts.iter().flat_map(|record| &record.episodes).copied().collect();
            let mut listening = Listening::default();
            parts.iter().for_each(|record| listening.merge(&record.listening));
            (episodes.len() == bench.entries[at].episodes as usize).then_some((episodes, listening))
        };
        let all: Vec<_> = (0..bench.entries.len()).map(finished).collect();
        let limit_s = |entry: &Entry| {
            let scenario = &entry.trial.scenario;
            scenario.cost().is_none().then(|| scenario.rules().limit.as_secs())
        };
        let scored: Vec<Option<Vec<Scored>>> = bench
            .entries
            .iter()
            .zip(&all)
            .map(|(entry, found)| {
                let (episodes, _) = found.as_ref()?;
                Some(episodes.iter().map(|episode| Scored::of(episode, limit_s(entry))).collect())
            })
            .collect();
        let rows = bench.entries.iter().zip(&all).zip(&scored).map(|((entry, found), scored)| {
            let (episodes, listening) = found.as_ref()?;
            Some(row(bench, entry, (episodes, listening), scored.as_ref()?))
        });
        Results { rows: rows.collect(), comparisons: comparisons(bench, &scored) }
    }

    /// Returns the comparison of the entry's policy in its cell with the other entry or channel `against` by `measure`.
    pub fn comparison(&self, bench: &Bench, entry: &Entry, against: &str, measure: Measure) -> Option<&Comparison> {
        let cell = bench.cell(entry);
        self.comparisons.iter().find(|comparison| {
            (&*comparison.task, &*comparison.channel, comparison.robots)
                == (cell.task.name, cell.channel.name, cell.robots)
                && comparison.entrant == entry.entrant
                && comparison.against == against
                && comparison.measure == measure
        })
    }

    /// Returns the number of comparisons with this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.comparisons.iter().filter(|comparison| comparison.difference.verdict == verdict).count()
    }
}

fn row(bench: &Bench, entry: &Entry, (episodes, listening): (&[Episode], &Listening), scored: &[Scored]) -> Row {
    let cell = bench.cell(entry);
    let scores: Vec<f64> = scored.iter().filter_map(|scored| scored.score).collect();
    let mean = |values: &[f64]| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
    let done: Vec<f64> = scored.iter().map(|scored| scored.done).collect();
    Row {
        task: cell.task.name.to_owned(),
        channel: cell.channel.name.to_owned(),
        robots: cell.robots,
        entrant: entry.entrant.clone(),
        policy: entry.policy.clone(),
        settings: cell.settings().into_iter().map(|(name, value)| format!("{name}={value}")).collect(),
        done: mean(&done).unwrap_or(0.0),
        score: mean(&scores),
        unit: entry.trial.scenario.cost().map_or("s", |cost| cost.unit),
        outcomes: Outcomes::of(episodes),
        delivery: Delivery::of(listening),
    }
}

/// Compares every entry with the later entries of its cell, and with its policy on the channel [`REFERENCE`].
fn comparisons(bench: &Bench, scored: &[Option<Vec<Scored>>]) -> Vec<Comparison> {
    let mut all = Vec::new();
    for (at, entry) in bench.entries.iter().enumerate() {
        let cell = bench.cell(entry);
        for (other_at, other) in bench.entries.iter().enumerate() {
            let others = bench.cell(other);
            let same_team = (cell.task.name, cell.robots) == (others.task.name, others.robots);
            let is_reference = same_team
                && other.entrant == entry.entrant
                && others.channel.name == REFERENCE
                && cell.channel.name != REFERENCE;
            let is_rival = other.cell == entry.cell && other_at > at;
            let (of, against) = match (is_reference, is_rival) {
                (true, _) => (Against::Reference, REFERENCE),
                (_, true) => (Against::Policy, &*other.entrant),
                _ => continue,
            };
            let (Some(mine), Some(theirs)) = (&scored[at], &scored[other_at]) else { continue };
            for measure in [Measure::Done, Measure::Score] {
                let name = format!("{}/{}/{against}/{measure:?}", cell.words(), entry.entrant);
                let Some(difference) = Difference::of((mine, theirs), measure, (bench.seed, &name)) else { continue };
                all.push(Comparison {
                    task: cell.task.name.to_owned(),
                    channel: cell.channel.name.to_owned(),
                    robots: cell.robots,
                    entrant: entry.entrant.clone(),
                    of,
                    against: against.to_owned(),
                    measure,
                    difference,
                });
            }
        }
    }
    all
}
