//! Results table of a study: one row per column and policy, with the paper's results.

use std::fmt::Write as _;

use super::results::{Results, Row};
use super::{Study, published};
use murmurate::config::shown::{self, counted};

/// Heads of the columns of a study's results table.
const HEADS: [&str; 9] =
    ["column", "success", "95 %", "paper", "makespan", "quartiles", "paper", "failures", "within 50 ms"];

/// Heads of the columns of a results table in a scenario without goals.
const COST_HEADS: [&str; 7] = ["column", "cost", "95 %", "median", "completed", "failures", "within 50 ms"];

/// Returns the cells of a row of the results table in a scenario without goals, as text.
fn cost_cells(row: &Row) -> [String; 7] {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let dash = || "-".to_owned();
    let cost = row.outcomes.cost.as_ref();
    [
        row.name.clone(),
        cost.map_or_else(dash, |cost| format!("{:.4}", cost.cost_mean)),
        cost.map_or_else(dash, |cost| format!("{:.4} to {:.4}", cost.cost_ci95[0], cost.cost_ci95[1])),
        cost.map_or_else(dash, |cost| format!("{:.4}", cost.cost_median)),
        format!("{} of {}", cost.map_or(0, |cost| cost.completed), row.outcomes.episodes),
        row.outcomes.failures(),
        row.delivered.zip(row.within_50ms).map_or_else(dash, |(delivered, within)| percent(delivered * within)),
    ]
}

/// Returns the cells of a row of the results table, as text.
fn cells(row: &Row) -> [String; 9] {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    [
        row.name.clone(),
        percent(row.outcomes.success_rate),
        format!("{:.1} to {:.1}", 100.0 * row.outcomes.success_ci95[0], 100.0 * row.outcomes.success_ci95[1]),
        or_dash(row.paper_success_rate.map(percent)),
        or_dash(row.outcomes.makespan_median_s.map(|median| format!("{median:.2} s"))),
        or_dash(row.outcomes.makespan_quartiles_s.map(|[first, third]| format!("{first:.2} to {third:.2}"))),
        or_dash(row.paper_makespan_median_s.map(|median| format!("{median:.1} s"))),
        row.outcomes.failures(),
        or_dash(row.delivered.zip(row.within_50ms).map(|(delivered, within)| percent(delivered * within))),
    ]
}

/// Indices of the table's columns with the paper's results.
const PAPER: [usize; 2] = [3, 6];
/// Heads of the table's columns with text instead of numbers.
const WORDS: [&str; 2] = ["column", "failures"];

/// Returns column heads and rows of the results table of the study's policy with the index `policy`. It has the paper's
/// results beside them only for what the paper ran.
pub fn of_policy(study: &Study, results: &Results, policy: usize) -> (Vec<&'static str>, Vec<Vec<String>>) {
    if study.scenario.cost().is_some() {
        let rows = results.of_policy(study, policy).into_iter().map(|cell| cost_cells(&cell.row).to_vec());
        return (COST_HEADS.to_vec(), rows.collect());
    }
    let compared = published::ran(study, &study.policies[policy]);
    let shown = |at: &usize| compared || !PAPER.contains(at);
    let heads = (0..HEADS.len()).filter(shown).map(|at| HEADS[at]).collect();
    let row = |row: &Row| {
        let all = cells(row);
        (0..all.len()).filter(shown).map(|at| all[at].clone()).collect()
    };
    (heads, results.of_policy(study, policy).into_iter().map(|cell| row(&cell.row)).collect())
}

/// Formats the results tables of all policies of a study for the terminal.
pub fn text(study: &Study, results: &Results) -> String {
    let mut text = format!(
        "study {}: {}, {} x {}, seed {}\n",
        study.name,
        study.scenario_text(),
        counted(study.layouts.len(), "layout"),
        counted(study.repeats, "repeat"),
        study.seed
    );
    for (at, tested) in study.policies.iter().enumerate() {
        let (heads, rows) = of_policy(study, results, at);
        let _ = writeln!(text, "\npolicy {}, handling {}", shown::value(&tested.policy), tested.handling.name);
        let heads: Vec<String> = heads.into_iter().map(str::to_owned).collect();
        let widths: Vec<usize> = (0..heads.len())
            .map(|column| [&heads].into_iter().chain(&rows).map(|row| row[column].chars().count()).max().unwrap_or(0))
            .collect();
        for row in [&heads].into_iter().chain(&rows) {
            let mut line = String::from(" ");
            for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
                // Text is aligned left, numbers are aligned right.
                let left = WORDS.contains(&heads[column].as_str());
                let _ = if left { write!(line, " {cell:<width$} ") } else { write!(line, " {cell:>width$} ") };
            }
            let _ = writeln!(text, "{}", line.trim_end());
        }
        let cells = results.of_policy(study, at);
        if study.scenario.cost().is_some() {
            continue;
        }
        if let (Some(drop), true) = (Results::largest_drop_points(&cells), published::ran(study, tested)) {
            let most = published::LARGEST_DROP_POINTS;
            let _ =
                writeln!(text, "  success falls by up to {drop:.1} points against sim; in the paper by up to {most}");
        }
    }
    text.trim_end().to_owned()
}
