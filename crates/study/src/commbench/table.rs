//! Tables of the benchmark: for each task a row for each channel, with the policies side by side.

use std::fmt::Write as _;

use murmurate::config::shown::counted;

use super::matrix::{Cell, REFERENCE};
use super::results::{Comparison, Results, Row};
use super::verdict::{LEVEL, Measure, Verdict};
use super::{Bench, Entry};
use crate::table::laid_out;

/// Returns the entries of the cell with index `cell` that are finished, with their rows.
fn of_cell<'a>(bench: &'a Bench, results: &'a Results, cell: usize) -> Vec<(&'a Entry, &'a Row)> {
    let rows = bench.entries.iter().zip(&results.rows).filter(|(entry, _)| entry.cell == cell);
    rows.filter_map(|(entry, row)| Some((entry, row.as_ref()?))).collect()
}

/// Returns a score as text, such as `6.50 s`, or as many digits of a cost as tell two of them apart.
fn score(row: &Row) -> String {
    let Some(score) = row.score else { return "-".to_owned() };
    match row.unit {
        "s" => format!("{score:.2} s"),
        _ if score >= 100.0 => format!("{score:.0}"),
        _ => format!("{score:.5}"),
    }
}

/// Returns the result of an entry in a table: share of episodes that did not fail, score, and for both the verdict
/// against the channel [`REFERENCE`].
fn shown(bench: &Bench, results: &Results, (entry, row): (&Entry, &Row)) -> String {
    let sign = |measure| {
        results
            .comparison(bench, entry, REFERENCE, measure)
            .map_or(" ", |comparison| comparison.difference.verdict.sign())
    };
    format!("{:.1} %{} {}{}", 100.0 * row.done, sign(Measure::Done), score(row), sign(Measure::Score))
}

/// Returns the names of the entries of a cell than which no other one is better, by share of successes and then by
/// score: several if they are ties.
fn best(bench: &Bench, results: &Results, there: &[(&Entry, &Row)]) -> Vec<String> {
    let better = |one: &Entry, other: &Entry| {
        let verdict = |measure| {
            let of = |a: &Entry, b: &Entry| results.comparison(bench, a, &b.entrant, measure);
            match (of(one, other), of(other, one)) {
                (Some(found), _) => found.difference.verdict,
                (_, Some(found)) => match found.difference.verdict {
                    Verdict::Better => Verdict::Worse,
                    Verdict::Worse => Verdict::Better,
                    Verdict::Tie => Verdict::Tie,
                },
                _ => Verdict::Tie,
            }
        };
        match verdict(Measure::Done) {
            Verdict::Tie => verdict(Measure::Score) == Verdict::Better,
            done => done == Verdict::Better,
        }
    };
    let beaten = |entry: &Entry| there.iter().any(|(other, _)| better(other, entry));
    there.iter().filter(|(entry, _)| !beaten(entry)).map(|(entry, _)| entry.entrant.clone()).collect()
}

/// Returns heads and rows of the table of a task.
pub fn of_task(bench: &Bench, results: &Results, task: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let cells = bench.cells.iter().enumerate().filter(|(_, cell)| cell.task.name == task);
    let heads = ["channel", "robots"].map(str::to_owned).into_iter().chain(bench.entrants.iter().cloned());
    let heads = heads.chain(["best".to_owned(), "within 50 ms".to_owned()]).collect();
    let row = |(at, cell): (usize, &Cell)| {
        let there = of_cell(bench, results, at);
        let of = |entrant: &String| there.iter().find(|(entry, _)| entry.entrant == *entrant);
        let result = |entrant| of(entrant).map_or("-".to_owned(), |found| shown(bench, results, *found));
        let on_time = there.first().and_then(|(_, row)| row.delivery.on_time());
        [cell.channel.name.to_owned(), cell.robots.to_string()]
            .into_iter()
            .chain(bench.entrants.iter().map(result))
            .chain([best(bench, results, &there).join(", ")])
            .chain([on_time.map_or("-".to_owned(), |share| format!("{:.1} %", 100.0 * share))])
            .collect()
    };
    (heads, cells.map(row).collect())
}

/// Returns heads and rows of the table of all comparisons.
pub fn comparisons(results: &Results) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let row = |found: &Comparison| {
        let difference = &found.difference;
        let number = |value: f64| match found.measure {
            Measure::Done => format!("{:+.1} points", 100.0 * value),
            Measure::Score => format!("{value:+.4}"),
        };
        vec![
            found.task.clone(),
            found.channel.clone(),
            found.robots.to_string(),
            found.entrant.clone(),
            found.against.clone(),
            serde_json::to_value(found.measure).map_or(String::new(), |name| name.as_str().unwrap_or("").to_owned()),
            number(difference.difference),
            difference.interval.map(number).join(" to "),
            difference.verdict.sign().to_owned(),
        ]
    };
    let heads = ["task", "channel", "robots", "policy", "against", "measure", "difference", "99.9 %", "verdict"];
    (heads.to_vec(), results.comparisons.iter().map(row).collect())
}

/// Returns heads and rows of the table of empty places.
pub fn empty(bench: &Bench) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let all = |name: &Option<String>| name.clone().unwrap_or_else(|| "all".to_owned());
    let row = |empty: &super::matrix::Empty| {
        vec![empty.task.clone(), all(&empty.channel), all(&empty.policy), empty.why.clone()]
    };
    (vec!["task", "channel", "policy", "why"], bench.empty.iter().map(row).collect())
}

/// Returns the names of the tasks in the order of the tables.
pub fn tasks(bench: &Bench) -> Vec<&'static str> {
    let mut names: Vec<&str> = bench.cells.iter().map(|cell| cell.task.name).collect();
    names.dedup();
    names
}

/// Returns the number of verdicts in words.
pub fn verdicts(results: &Results) -> String {
    let [better, worse] = [Verdict::Better, Verdict::Worse].map(|verdict| results.count(verdict));
    format!(
        "{}: {} differ ({better} better, {worse} worse), {} tie; a difference counts if its {:.1} % interval \
         excludes zero",
        counted(results.comparisons.len(), "comparison"),
        better + worse,
        results.count(Verdict::Tie),
        100.0 * LEVEL
    )
}

/// Legend of a table of results.
pub const LEGEND: &str = "Share of episodes that did not fail, and mean score: makespan with the task's time limit for \
failures [s], or the task's cost; less is better. Behind each the verdict against the same policy on 'perfect' with as \
many robots: + better, - worse, = tie. 'best': no other policy of the row is better, first by that share and then by \
the score.";

/// Formats the tables of a benchmark for the terminal.
pub fn text(bench: &Bench, results: &Results) -> String {
    let mut text = format!("study commbench: {}, seed {}\n", counted(bench.cells.len(), "cell"), bench.seed);
    for task in tasks(bench) {
        let (heads, rows) = of_task(bench, results, task);
        let episodes = bench.entries.iter().find(|entry| bench.cell(entry).task.name == task);
        let episodes = episodes.map_or(0, |entry| entry.episodes);
        let unit = bench
            .entries
            .iter()
            .zip(&results.rows)
            .find_map(|(entry, row)| (bench.cell(entry).task.name == task).then_some(row.as_ref()?.unit));
        let unit = unit.unwrap_or("s");
        let _ = writeln!(text, "\n{task}, {} a cell, score [{unit}]", counted(episodes, "episode"));
        let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
        text += &laid_out(&heads, &rows, &["channel", "best"]);
    }
    let _ = write!(text, "\n{LEGEND}\n{}", verdicts(results));
    text
}
