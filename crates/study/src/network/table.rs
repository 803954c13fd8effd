//! Tables of a network study, for the terminal and for the page of the report.

use std::fmt::Write as _;

use super::case::Sweep;
use super::growth::Growth;
use super::outcome::Row;
use super::scale;
use murmurate::config::shown::counted;

/// Quantity that a table of a network study shows: its name, and the function that returns its value in a row.
type Shown = (&'static str, fn(&Row) -> Option<f64>);

/// Quantities that the tables of a network study show, one table each: name with unit, and the function that returns
/// the value from a row of results.
pub const SHOWN: [Shown; 5] = [
    ("within 20 ms [%]", |row| Some(100.0 * row.within_20ms)),
    ("delivered [%]", |row| Some(100.0 * row.delivered)),
    ("median delay [ms]", |row| row.p50_ms),
    ("airtime [%]", |row| row.airtime.map(|share| 100.0 * share)),
    ("age at control steps, median [ms]", |row| row.age_p50_ms),
];

/// Returns the heads of a table's columns: `messages/s` for the first, and the message rates of the study for the
/// others.
pub fn heads(sweep: &Sweep) -> Vec<String> {
    ["messages/s".to_owned()].into_iter().chain(sweep.rates.iter().map(f64::to_string)).collect()
}

/// Returns the lines of the table of one quantity: one line per combination of parameters, one column per message rate.
/// A cell without a result is `-`.
pub fn lines(sweep: &Sweep, rows: &[Row], (_, value): Shown) -> Vec<Vec<String>> {
    let mut names: Vec<String> = Vec::new();
    for row in rows {
        let name = row.combination();
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let line = |name: String| {
        let cell = |rate: &f64| {
            let row = rows.iter().find(|row| row.rate == *rate && row.combination() == name);
            row.and_then(value).map_or("-".to_owned(), |value| format!("{value:.1}"))
        };
        let cells: Vec<String> = sweep.rates.iter().map(cell).collect();
        [name].into_iter().chain(cells).collect()
    };
    names.into_iter().map(line).collect()
}

/// Formats heads and lines as aligned text. The first column is aligned left, the others right.
fn aligned(heads: &[String], lines: &[Vec<String>]) -> String {
    let width =
        |at: usize| lines.iter().map(|line| &line[at]).chain([&heads[at]]).map(|cell| cell.chars().count()).max();
    let widths: Vec<usize> = (0..heads.len()).map(|at| width(at).unwrap_or(0)).collect();
    let mut text = String::new();
    for line in [heads].into_iter().chain(lines.iter().map(Vec::as_slice)) {
        let mut row = String::new();
        for (at, (cell, width)) in line.iter().zip(&widths).enumerate() {
            let _ = if at == 0 { write!(row, " {cell:<width$}") } else { write!(row, "  {cell:>width$}") };
        }
        text += row.trim_end();
        text.push('\n');
    }
    text
}

/// Formats the tables for the terminal: shares of deliveries within 20 ms and in all, and the cost per robot of growing
/// teams.
pub fn text(sweep: &Sweep, rows: &[Row], grown: &[Growth]) -> String {
    let mut text = format!(
        "study network: {}, messages of {}, {} s a case, RTPS history {}, seed {}\n",
        counted(sweep.stations, "station"),
        counted(sweep.bytes, "byte"),
        sweep.seconds,
        sweep.history,
        sweep.seed
    );
    for shown in &SHOWN[..2] {
        let lines = lines(sweep, rows, *shown);
        let _ = write!(text, "\n{}, of all expected deliveries\n{}", shown.0, aligned(&heads(sweep), &lines));
    }
    if !grown.is_empty() {
        let (heads, lines) = scale::of_costs(grown);
        let heads: Vec<String> = heads.into_iter().map(str::to_owned).collect();
        let _ = write!(text, "\ncost per robot\n{}", aligned(&heads, &lines));
    }
    text.trim_end().to_owned()
}
