//! Results of a sweep, aggregated from the records of its trials: one row per point.

use std::collections::BTreeMap;

use murmurate::results::episode::Episode;
use murmurate::results::listening::Listening;
use murmurate_report::outcomes::Outcomes;
use serde::Serialize;

use super::{Job, PointRecord, Sweep};
use crate::results::Delivery;

/// Results of one point of a sweep, as `--json` prints them. Later versions may add fields and remove none.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Value on each axis, by the axis' name: a number where the value is one, otherwise text.
    pub at: BTreeMap<String, serde_json::Value>,
    /// Name of the policy.
    pub policy: String,
    /// Number of robots.
    pub robots: usize,
    /// Success, makespan and failures over all episodes.
    #[serde(flatten)]
    pub outcomes: Outcomes,
    /// Delivery and age of messages between robots.
    #[serde(flatten)]
    pub delivery: Delivery,
}

/// Results of a sweep, one row for each of its points in their order; `None` for a point without a finished trial.
#[derive(Clone, Debug)]
pub struct Results(pub Vec<Option<Row>>);

impl Results {
    /// Aggregates the records of a sweep's trials.
    ///
    /// # Panics
    /// If `records` are not in the order of their trials, which determines the order of float sums.
    pub fn of(sweep: &Sweep, records: &[(Job, PointRecord)]) -> Results {
        assert!(records.is_sorted_by_key(|(job, _)| *job), "records must be in the order of trials");
        let row = |point: usize| {
            let records = records.iter().filter(|(job, _)| job.point == point).map(|(_, record)| record);
            let records: Vec<&PointRecord> = records.collect();
            (!records.is_empty()).then(|| Row::of(sweep, point, &records))
        };
        Results((0..sweep.points.len()).map(row).collect())
    }

    /// Returns the rows of the points that have one.
    pub fn rows(&self) -> impl Iterator<Item = &Row> {
        self.0.iter().flatten()
    }
}

impl Row {
    fn of(sweep: &Sweep, point: usize, records: &[&PointRecord]) -> Row {
        let episodes: Vec<Episode> = records.iter().flat_map(|record| &record.episodes).copied().collect();
        let mut listening = Listening::default();
        records.iter().for_each(|record| listening.merge(&record.listening));
        let point = &sweep.points[point];
        let value = |text: &String| {
            text.parse::<f64>().ok().filter(|number| number.is_finite()).map_or_else(|| text.clone().into(), Into::into)
        };
        Row {
            at: sweep.axes.iter().zip(&point.at).map(|(axis, text)| (axis.name.clone(), value(text))).collect(),
            policy: point.policy.clone(),
            robots: point.trial.deployment.robots,
            outcomes: Outcomes::of(&episodes),
            delivery: Delivery::of(&listening),
        }
    }
}
