//! Results table of a study: one row per column and policy, with the paper's results.

use std::fmt::Write as _;

use super::results::{Delivery, Results, Row};
use super::{Study, published};
use murmurate::config::shown::{self, counted};
use murmurate_report::outcomes::Outcomes;

/// Heads of the columns with outcomes in a results table.
pub(super) const HEADS: [&str; 6] = ["success", "95 %", "makespan", "quartiles", "failures", "within 50 ms"];

/// Heads of the columns with outcomes in a results table of a scenario without goals.
pub(super) const COST_HEADS: [&str; 6] = ["cost", "95 %", "median", "completed", "failures", "within 50 ms"];

/// Returns the share as text, in percent.
fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// Returns the cells of outcomes in a scenario without goals, as text; their heads are [`COST_HEADS`].
pub(super) fn cost_cells(outcomes: &Outcomes, delivery: &Delivery) -> [String; 6] {
    let dash = || "-".to_owned();
    let cost = outcomes.cost.as_ref();
    [
        cost.map_or_else(dash, |cost| format!("{:.4}", cost.cost_mean)),
        cost.map_or_else(dash, |cost| format!("{:.4} to {:.4}", cost.cost_ci95[0], cost.cost_ci95[1])),
        cost.map_or_else(dash, |cost| format!("{:.4}", cost.cost_median)),
        format!("{} of {}", cost.map_or(0, |cost| cost.completed), outcomes.episodes),
        outcomes.failures(),
        delivery.on_time().map_or_else(dash, percent),
    ]
}

/// Returns the cells of outcomes, as text; their heads are [`HEADS`].
pub(super) fn cells(outcomes: &Outcomes, delivery: &Delivery) -> [String; 6] {
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    [
        percent(outcomes.success_rate),
        format!("{:.1} to {:.1}", 100.0 * outcomes.success_ci95[0], 100.0 * outcomes.success_ci95[1]),
        or_dash(outcomes.makespan_median_s.map(|median| format!("{median:.2} s"))),
        or_dash(outcomes.makespan_quartiles_s.map(|[first, third]| format!("{first:.2} to {third:.2}"))),
        outcomes.failures(),
        or_dash(delivery.on_time().map(percent)),
    ]
}

/// Heads of the table's columns with text instead of numbers.
const WORDS: [&str; 2] = ["column", "failures"];

/// Returns column heads and rows of the results table of the study's policy with the index `policy`. It has the paper's
/// results beside them only for what the paper ran.
pub fn of_policy(study: &Study, results: &Results, policy: usize) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let rows = results.of_policy(study, policy).into_iter().map(|cell| &cell.row);
    if study.scenario.cost().is_some() {
        let row = |row: &Row| [row.name.clone()].into_iter().chain(cost_cells(&row.outcomes, &row.delivery)).collect();
        return ([&["column"][..], &COST_HEADS].concat(), rows.map(row).collect());
    }
    let mut heads = [&["column"][..], &HEADS].concat();
    let compared = published::ran(study, &study.policies[policy]);
    let row = |row: &Row| {
        let mut all = vec![row.name.clone()];
        all.extend(cells(&row.outcomes, &row.delivery));
        if compared {
            let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
            all.insert(PAPER[0], or_dash(row.paper_success_rate.map(percent)));
            all.insert(PAPER[1], or_dash(row.paper_makespan_median_s.map(|median| format!("{median:.1} s"))));
        }
        all
    };
    if compared {
        PAPER.into_iter().for_each(|at| heads.insert(at, "paper"));
    }
    (heads, rows.map(row).collect())
}

/// Places of the columns with the paper's results in a table.
const PAPER: [usize; 2] = [3, 6];

/// Lays out a table for the terminal: text is aligned left, numbers are aligned right. `words` are the heads of the
/// columns with text.
pub(super) fn laid_out(heads: &[&str], rows: &[Vec<String>], words: &[&str]) -> String {
    let heads: Vec<String> = heads.iter().map(|head| (*head).to_owned()).collect();
    let widths: Vec<usize> = (0..heads.len())
        .map(|column| [&heads].into_iter().chain(rows).map(|row| row[column].chars().count()).max().unwrap_or(0))
        .collect();
    let mut text = String::new();
    for row in [&heads].into_iter().chain(rows) {
        let mut line = String::from(" ");
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            let left = words.contains(&heads[column].as_str());
            let _ = if left { write!(line, " {cell:<width$} ") } else { write!(line, " {cell:>width$} ") };
        }
        let _ = writeln!(text, "{}", line.trim_end());
    }
    text
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
        text += &laid_out(&heads, &rows, &WORDS);
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
