//! Report of the benchmark: two figures for each task, and its HTML page.

use murmurate::config::shown::counted;
use murmurate_report::figures::page::{self, Part};
use murmurate_report::figures::{Figure, FigureError, Line, Panel, Point};

use super::matrix::{Cell, KINDS};
use super::results::{Results, Row};
use super::{Bench, table};

/// Returns the label of a cell in a figure: of channels with a number of robots that number and the rate.
fn label(cell: &Cell) -> String {
    cell.channel.name.trim_start_matches("wifi-").to_owned()
}

/// Returns a panel with a line for each policy over the cells `cells`.
fn panel(
    (bench, results, cells): (&Bench, &Results, &[usize]),
    (title, y, ends): (&str, &str, Option<(f64, f64)>),
    point: impl Fn(&Row) -> Option<Point>,
) -> Panel {
    let there = |entrant: &str, cell: usize| {
        let mut rows = bench.entries.iter().zip(&results.rows);
        let (_, row) = rows.find(|(entry, _)| entry.cell == cell && entry.entrant == entrant)?;
        row.as_ref()
    };
    let line = |entrant: &String| Line {
        name: entrant.clone(),
        points: cells.iter().map(|cell| there(entrant, *cell).and_then(&point)).collect(),
    };
    Panel::new(title, y, ends, bench.entrants.iter().map(line).collect())
}

/// Draws the figures of a task: one of channels with the task's own number of robots, one of those with another.
fn of_task(bench: &Bench, results: &Results, task: &str) -> Result<Vec<Figure>, FigureError> {
    let mut figures = Vec::new();
    let of = |own: bool| -> Vec<usize> {
        let cells = bench.cells.iter().enumerate().filter(|(_, cell)| cell.task.name == task);
        let is = |cell: &Cell| match cell.channel.robots {
            Some(_) => !own,
            None => own && cell.robots == cell.task.robots,
        };
        cells.filter(|(_, cell)| is(cell)).map(|(at, _)| at).collect()
    };
    let unit = bench.entries.iter().find(|entry| bench.cell(entry).task.name == task);
    let unit = unit.and_then(|entry| entry.trial.scenario.cost()).map_or("s", |cost| cost.unit);
    // Axes have one decimal at most.
    let (factor, thousandths) = if unit == "m2/s2" { (1e3, "0.001 ") } else { (1.0, "") };
    for (own, name, x) in [(true, "channels", "channel"), (false, "wifi", "robots-messages/s of each")] {
        let cells = of(own);
        if cells.is_empty() {
            continue;
        }
        let done = |row: &Row| {
            let ends = murmurate_report::statistics::wilson_95(
                (row.done * row.outcomes.episodes as f64).round() as usize,
                row.outcomes.episodes,
            );
            Some(Point { value: 100.0 * row.done, within: ends.map(|end| 100.0 * end) })
        };
        let score = |row: &Row| Some(Point::exactly(factor * row.score?));
        let panels = [
            panel((bench, results, &cells), ("episodes without a failure", "share [%]", Some((0.0, 100.0))), done),
            panel(
                (bench, results, &cells),
                ("mean score, less is better", &format!("score [{thousandths}{unit}]"), None),
                score,
            ),
        ];
        let places: Vec<String> = cells.iter().map(|cell| label(&bench.cells[*cell])).collect();
        let title = format!("{task}: {}", if own { "channels" } else { "Wi-Fi by robots and messages" });
        figures.push(Figure {
            name: format!("{task}-{name}"),
            title: title.clone(),
            caption: "Share with its 95 % interval (Wilson). The score is the mean makespan, with the time limit for \
                      failures, or the mean cost; whether two scores differ is in the table of comparisons."
                .to_owned(),
            svg: murmurate_report::figures::sweep(&title, x, &places, &panels)?,
        });
    }
    Ok(figures)
}

/// Draws the figures of the report, two for each task at the most.
pub fn figures(bench: &Bench, results: &Results) -> Result<Vec<Figure>, FigureError> {
    let mut all = Vec::new();
    for task in table::tasks(bench) {
        all.extend(of_task(bench, results, task)?);
    }
    Ok(all)
}

/// Returns the report page as HTML, with its figures and tables.
pub fn page(bench: &Bench, results: &Results, figures: &[Figure]) -> String {
    let identity = bench.identity();
    let tables: Vec<_> =
        table::tasks(bench).into_iter().map(|task| (task, table::of_task(bench, results, task))).collect();
    let mut parts = vec![
        Part::Text(format!("{}; {}.", counted(bench.cells.len(), "cell"), table::verdicts(results))),
        Part::Text(table::LEGEND.to_owned()),
    ];
    for (task, (heads, rows)) in &tables {
        parts.push(Part::Heading((*task).to_owned()));
        parts.push(Part::Table(heads.iter().map(String::as_str).collect(), rows.clone()));
        let own = figures.iter().filter(|figure| figure.name.starts_with(&format!("{task}-")));
        parts.extend(own.map(Part::Figure));
    }
    parts.push(Part::Heading("Channels".to_owned()));
    let mut channels: Vec<_> = bench.cells.iter().map(|cell| cell.channel).collect();
    channels.sort_by_key(|channel| channel.name);
    channels.dedup_by_key(|channel| channel.name);
    parts.push(Part::Terms(
        channels.iter().map(|channel| (channel.name.to_owned(), channel.about.to_owned())).collect(),
    ));
    let (heads, rows) = table::empty(bench);
    parts.extend([Part::Heading("Empty places".to_owned()), Part::Table(heads, rows)]);
    let (heads, rows) = table::comparisons(results);
    parts.extend([Part::Heading("Comparisons".to_owned()), Part::Table(heads, rows)]);
    parts.extend([
        Part::Heading("What was run".to_owned()),
        Part::Verbatim(bench.command.clone()),
        Part::Terms(vec![
            ("program".to_owned(), format!("murmurate {}, build {}", identity.version, identity.build)),
            ("digest of the conditions".to_owned(), identity.conditions),
            ("kinds of policies".to_owned(), KINDS.join(", ")),
        ]),
    ]);
    page::page("murmurate study commbench", &parts)
}
