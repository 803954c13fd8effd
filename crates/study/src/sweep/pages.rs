//! Report of a sweep: its figure and its HTML page.

use std::collections::BTreeSet;

use murmurate::config::shown::counted;
use murmurate_report::figures::page::{self, Part};
use murmurate_report::figures::{Figure, FigureError, Line, Panel, Point};

use super::results::{Results, Row};
use super::table::{self, has_costs};
use super::{Axis, Sweep};

/// Returns the names of the lines of the figure: the values on the second axis, or else the policy if it is one.
fn lines(sweep: &Sweep) -> Vec<String> {
    if let [_, Axis { name, values }] = &sweep.axes[..] {
        return values.iter().map(|value| format!("{name} {value}")).collect();
    }
    let policies: BTreeSet<&str> = sweep.points.iter().map(|point| point.policy.as_str()).collect();
    let one = policies.first().filter(|_| policies.len() == 1);
    vec![one.map_or("each point's own policy".to_owned(), |policy| (*policy).to_owned())]
}

/// Returns a panel with a line for each value on the second axis; `point` is what it shows of a row.
fn panel(
    sweep: &Sweep,
    results: &Results,
    (title, y, ends): (&str, &str, Option<(f64, f64)>),
    point: impl Fn(&Row) -> Option<Point>,
) -> Panel {
    let places = sweep.axes[0].values.len();
    let line = |(name, rows): (String, &[Option<Row>])| Line {
        name,
        points: rows.iter().map(|row| row.as_ref().and_then(&point)).collect(),
    };
    Panel::new(title, y, ends, lines(sweep).into_iter().zip(results.0.chunks(places)).map(line).collect())
}

/// Draws success and makespan, or the cost in a scenario without goals, against the first axis.
pub fn figure(sweep: &Sweep, results: &Results) -> Result<Figure, FigureError> {
    let x = sweep.axes[0].name.as_str();
    let over = sweep.axes.iter().map(|axis| axis.name.as_str()).collect::<Vec<_>>().join(" and ");
    let panels = if has_costs(sweep) {
        let cost = |row: &Row| {
            let cost = row.outcomes.cost.as_ref()?;
            // In thousandths, as the axis has one decimal.
            Some(Point { value: 1e3 * cost.cost_mean, within: cost.cost_ci95.map(|end| 1e3 * end) })
        };
        let unit = sweep.points[0].trial.scenario.cost().map_or("", |cost| cost.unit);
        vec![panel(sweep, results, ("mean cost of an episode", &format!("cost [0.001 {unit}]"), None), cost)]
    } else {
        let success = |row: &Row| {
            let within = row.outcomes.success_ci95.map(|end| 100.0 * end);
            Some(Point { value: 100.0 * row.outcomes.success_rate, within })
        };
        let makespan = |row: &Row| {
            Some(Point { value: row.outcomes.makespan_median_s?, within: row.outcomes.makespan_quartiles_s? })
        };
        vec![
            panel(sweep, results, ("success", "success [%]", Some((0.0, 100.0))), success),
            panel(sweep, results, ("makespan, median and quartiles", "makespan [s]", None), makespan),
        ]
    };
    let title = format!("{} over {over}", if has_costs(sweep) { "Cost" } else { "Success and makespan" });
    let caption = "Each point: all episodes of a point of the sweep, with the 95 % interval of its success (Wilson) or \
                   of its cost (Student's t), or with the quartiles of the makespans of its successes.";
    Ok(Figure {
        name: "sweep".to_owned(),
        title: title.clone(),
        caption: caption.to_owned(),
        svg: murmurate_report::figures::sweep(&title, x, &sweep.axes[0].values, &panels)?,
    })
}

/// Returns the report page of a sweep as HTML, with its figure and table.
pub fn page(sweep: &Sweep, results: &Results, figure: &Figure) -> String {
    let (heads, rows) = table::rows(sweep, results);
    let legend = "Success with its 95 % Wilson interval, or cost with its 95 % interval by Student's t; median \
                  makespan of the successes with its quartiles. 'within 50 ms': messages between robots that arrived \
                  within 50 ms, of all expected deliveries.";
    let identity = sweep.identity();
    let policies: BTreeSet<&str> = sweep.points.iter().map(|point| point.policy.as_str()).collect();
    let terms = vec![
        ("program".to_owned(), format!("murmurate {}, build {}", identity.version, identity.build)),
        ("digest of the conditions".to_owned(), identity.conditions),
        ("policies".to_owned(), policies.into_iter().collect::<Vec<_>>().join(", ")),
        ("episodes".to_owned(), counted(usize::try_from(sweep.episodes()).unwrap_or(usize::MAX), "episode")),
    ];
    let parts = [
        Part::Text(format!("{}.", table::about(sweep))),
        Part::Figure(figure),
        Part::Table(heads, rows),
        Part::Text(legend.to_owned()),
        Part::Heading("What was run".to_owned()),
        Part::Verbatim(sweep.command.clone()),
        Part::Terms(terms),
    ];
    page::page("murmurate study sweep", &parts)
}
