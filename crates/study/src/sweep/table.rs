//! Results table of a sweep: one row per point.

use murmurate::config::shown::counted;

use super::Sweep;
use super::results::Results;
use crate::table::{COST_HEADS, HEADS, cells, cost_cells, laid_out};

/// Returns whether the sweep's episodes have costs in place of success. Where a scenario of a point has goals, success
/// is shown.
pub(super) fn has_costs(sweep: &Sweep) -> bool {
    sweep.points.iter().all(|point| point.trial.scenario.cost().is_some())
}

/// Returns column heads and rows of the results table of a sweep.
pub fn rows<'a>(sweep: &'a Sweep, results: &Results) -> (Vec<&'a str>, Vec<Vec<String>>) {
    let axes = sweep.axes.iter().map(|axis| axis.name.as_str());
    let heads = if has_costs(sweep) { COST_HEADS } else { HEADS };
    let there = sweep.points.iter().zip(&results.0).filter_map(|(point, row)| Some((point, row.as_ref()?)));
    let row = |(point, row): (&super::Point, &super::results::Row)| {
        let outcomes = if has_costs(sweep) { cost_cells } else { cells }(&row.outcomes, &row.delivery);
        point.at.iter().cloned().chain(outcomes).collect()
    };
    (axes.chain(heads).collect(), there.map(row).collect())
}

/// Returns what was run, in one line.
pub(super) fn about(sweep: &Sweep) -> String {
    let setting = if sweep.setting.is_empty() { "defaults of sim" } else { &sweep.setting };
    let episodes = sweep.points.first().map_or(0, |point| point.trial.layouts.len());
    let (points, repeats) = (counted(sweep.points.len(), "point"), counted(sweep.repeats, "repeat"));
    format!("{setting}; {points}, {repeats} of {}, seed {}", counted(episodes, "episode"), sweep.seed)
}

/// Formats the results table of a sweep for the terminal.
pub fn text(sweep: &Sweep, results: &Results) -> String {
    let (heads, rows) = rows(sweep, results);
    let words: Vec<&str> = sweep.axes.iter().map(|axis| axis.name.as_str()).chain(["failures"]).collect();
    format!("study sweep: {}\n\n{}", about(sweep), laid_out(&heads, &rows, &words)).trim_end().to_owned()
}
