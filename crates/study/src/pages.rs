//! Report of a study that compares policies in columns of conditions: figures and HTML page.

use super::columns::{BASELINE, Column};
use super::conditions::Deployed;
use super::handling::PRESETS;
use super::results::{Cell, Results};
use super::{Study, published, table};
use murmurate::config::shown::counted;
use murmurate_report::figures::page::{self, Part};
use murmurate_report::figures::{
    DelayColumn, Figure, FigureError, Group, Line, Makespans, Panel, Point, Positions, Share,
};

/// Returns all figures of a study: first those of all policies, then those of each policy.
pub fn figures(study: &Study, results: &Results) -> Result<Vec<Figure>, FigureError> {
    if study.scenario.cost().is_some() {
        return Ok(vec![costs(study, results)?]);
    }
    let mut all = vec![overview(study, results)?];
    if study.name != "modes" {
        return Ok(all);
    }
    for (at, tested) in study.policies.iter().enumerate() {
        let cells = results.of_policy(study, at);
        let number = at + 1;
        all.push(makespans(number, &tested.name(), &cells)?);
        all.push(positions(study, number, &tested.name(), &cells)?);
        all.push(separation(study, number, &tested.name(), &cells)?);
        if cells.iter().any(|cell| cell.listening.due > 0) {
            all.push(delays(number, &tested.name(), &cells)?);
        }
    }
    Ok(all)
}

/// Draws the cost in each column, one line per policy, in a scenario without goals.
fn costs(study: &Study, results: &Results) -> Result<Figure, FigureError> {
    let cells = by_column(study, results);
    let point = |cell: &Cell| {
        let cost = cell.row.outcomes.cost.as_ref()?;
        // In thousandths, as the axis has one decimal.
        Some(Point { value: 1e3 * cost.cost_mean, within: cost.cost_ci95.map(|end| 1e3 * end) })
    };
    let line = |policy: usize| Line {
        name: study.policies[policy].name(),
        points: cells.iter().map(|column| column[policy].and_then(point)).collect(),
    };
    let unit = study.scenario.cost().map_or("", |cost| cost.unit);
    let (y, lines) = (format!("cost [0.001 {unit}]"), (0..study.policies.len()).map(line).collect());
    let panel = Panel { title: "mean cost of an episode".to_owned(), y, ends: None, lines };
    let places: Vec<String> = study.columns.iter().map(|column| column.name.clone()).collect();
    let title = "Cost by column";
    let caption =
        "Marks: the mean cost over all layouts and repeats; bars: its 95 % interval by Student's t.".to_owned();
    let (name, svg) =
        (format!("cost-{}", study.name), murmurate_report::figures::sweep(title, "column", &places, &[panel])?);
    Ok(Figure { name, title: "Cost".to_owned(), caption, svg })
}

fn overview(study: &Study, results: &Results) -> Result<Figure, FigureError> {
    let svg = match study.name {
        "delay" => delay_sweep(study, results)?,
        "range" => range_sweep(study, results)?,
        _ => modes(study, results)?,
    };
    let caption = match study.name {
        "delay" | "range" => {
            "Each point: all episodes of a column, with the 95 % Wilson interval of the success rate, or \
             with the quartiles of the makespans of its successes."
        }
        _ => "Marks: the share of successes over all layouts and repeats; bars: its 95 % Wilson interval.",
    };
    let name = format!("success-{}", study.name);
    Ok(Figure { name, title: "Success".to_owned(), caption: caption.to_owned(), svg })
}

fn names(study: &Study) -> Vec<String> {
    study.policies.iter().map(super::PolicyUnderTest::name).collect()
}

/// Returns, for each column of the study, the results of each policy; `None` where there is none.
fn by_column<'a>(study: &Study, results: &'a Results) -> Vec<Vec<Option<&'a Cell>>> {
    let of = |column: &str, policy: usize| {
        let tested = &study.policies[policy];
        let is = |cell: &&Cell| {
            let row = &cell.row;
            row.name == column && row.policy == tested.policy && row.handling == tested.handling.name
        };
        results.cells.iter().find(is)
    };
    let policies = |column: &str| (0..study.policies.len()).map(|policy| of(column, policy)).collect();
    study.columns.iter().map(|column| policies(&column.name)).collect()
}

fn modes(study: &Study, results: &Results) -> Result<String, FigureError> {
    let share = |cell: &Cell| Share { rate: cell.row.outcomes.success_rate, ci95: cell.row.outcomes.success_ci95 };
    let compared = study.policies.iter().any(|tested| published::ran(study, tested));
    let groups = by_column(study, results).into_iter().zip(&study.columns).map(|(cells, column)| Group {
        name: column.name.clone(),
        shares: cells.into_iter().map(|cell| cell.map(share)).collect(),
        paper: published::of(&column.name).success.filter(|_| compared),
    });
    murmurate_report::figures::success("Success by mode", &names(study), &groups.collect::<Vec<_>>())
}

fn success_of(cell: &Cell) -> Point {
    Point {
        value: 100.0 * cell.row.outcomes.success_rate,
        within: cell.row.outcomes.success_ci95.map(|end| 100.0 * end),
    }
}

fn makespan_of(cell: &Cell) -> Option<Point> {
    Some(Point { value: cell.row.outcomes.makespan_median_s?, within: cell.row.outcomes.makespan_quartiles_s? })
}

/// Draws the success rate against the delay of messages: one panel per policy, one line per loss probability.
fn delay_sweep(study: &Study, results: &Results) -> Result<String, FigureError> {
    let mut delays: Vec<f64> = Vec::new();
    let mut losses: Vec<f64> = Vec::new();
    for (delay_s, loss) in study.columns.iter().filter_map(Column::impairment) {
        let delay = 1000.0 * delay_s;
        if !delays.contains(&delay) {
            delays.push(delay);
        }
        if !losses.contains(&loss) {
            losses.push(loss);
        }
    }
    let panels = study.policies.iter().enumerate().map(|(at, tested)| {
        let cells = results.of_policy(study, at);
        let point = |loss: f64, delay: f64| {
            let found = cells.iter().find(|cell| (cell.row.loss, cell.row.delay_ms) == (Some(loss), Some(delay)));
            found.map(|cell| success_of(cell))
        };
        let line = |&loss: &f64| Line {
            name: format!("{:.0} % of messages lost", 100.0 * loss),
            points: delays.iter().map(|&delay| point(loss, delay)).collect(),
        };
        let lines = losses.iter().map(line).collect();
        Panel { title: tested.name(), y: "success [%]".to_owned(), ends: Some((0.0, 100.0)), lines }
    });
    let places: Vec<String> = delays.iter().map(|delay| format!("{delay:.0}")).collect();
    let title = "Success over delay and loss of messages between robots";
    murmurate_report::figures::sweep(title, "delay [ms]", &places, &panels.collect::<Vec<_>>())
}

/// Draws success and makespan against the communication range, one line per policy.
fn range_sweep(study: &Study, results: &Results) -> Result<String, FigureError> {
    let cells = by_column(study, results);
    let line = |point: &dyn Fn(&Cell) -> Option<Point>, policy: usize| Line {
        name: study.policies[policy].name(),
        points: cells.iter().map(|column| column[policy].and_then(point)).collect(),
    };
    let panel = |title: &str, y: &str, ends, point: &dyn Fn(&Cell) -> Option<Point>| Panel {
        title: title.to_owned(),
        y: y.to_owned(),
        ends,
        lines: (0..study.policies.len()).map(|policy| line(point, policy)).collect(),
    };
    let panels = [
        panel("success", "success [%]", Some((0.0, 100.0)), &|cell| Some(success_of(cell))),
        panel("makespan, median and quartiles", "makespan [s]", None, &makespan_of),
    ];
    let place = |column: &super::columns::Column| column.name.trim_end_matches('m').replace("everyone", "all");
    let places: Vec<String> = study.columns.iter().map(place).collect();
    let title = "Success and makespan over the communication radius";
    murmurate_report::figures::sweep(title, "communication radius [m]", &places, &panels)
}

fn makespans(number: usize, name: &str, cells: &[&Cell]) -> Result<Figure, FigureError> {
    let row = |cell: &&Cell| Makespans {
        name: cell.row.name.clone(),
        values_s: cell.makespans_s.clone(),
        episodes: cell.row.outcomes.episodes,
    };
    let rows: Vec<Makespans> = cells.iter().map(row).collect();
    Ok(Figure {
        name: format!("makespan-{number}"),
        title: format!("Makespan densities: {name}"),
        caption: "Makespans of the successes, smoothed with a Gaussian kernel; the area under a curve is the share \
                  of successes. Dashed in a row's colour: its median; dashed in black: the median of 'sim'."
            .to_owned(),
        svg: murmurate_report::figures::makespans(&format!("Makespan: {name}"), &rows, BASELINE)?,
    })
}

fn positions(study: &Study, number: usize, name: &str, cells: &[&Cell]) -> Result<Figure, FigureError> {
    let column = |cell: &&'_ Cell| (cell.row.name.clone(), cell.traces.position.clone());
    let columns: Vec<(String, murmurate_report::grid::Grid)> = cells.iter().map(column).collect();
    let columns: Vec<Positions> = columns.iter().map(|(name, grid)| Positions { name, grid }).collect();
    Ok(Figure {
        name: format!("position-{number}"),
        title: format!("Position density: {name}"),
        caption: "Where the robots' centres were while episodes ran, from the instruction to run to its end: the \
                  share of their time for each square metre, all columns on one scale, which is linear in its square \
                  root. Grey: the wall; between its parts, the passage."
            .to_owned(),
        svg: murmurate_report::figures::positions(&format!("Position: {name}"), &columns, study.scenario.arena())?,
    })
}

fn separation(study: &Study, number: usize, name: &str, cells: &[&Cell]) -> Result<Figure, FigureError> {
    let columns: Vec<_> = cells.iter().map(|cell| (cell.row.name.as_str(), &cell.traces.separation)).collect();
    let limit_m = study.scenario.rules().separation_m;
    Ok(Figure {
        name: format!("separation-{number}"),
        title: format!("d_min against d_origin: {name}"),
        caption: "For each robot and World step of running episodes: d_min, the distance between its centre and the \
                  nearest other robot's, against d_origin, its own distance from the origin, which is the middle of \
                  the passage. Bins of 0.1 m with at least 40 counts; distances of 2 m and more count as 2 m. \
                  Dashed: two robots nearer than this have collided."
            .to_owned(),
        svg: murmurate_report::figures::separation(
            &format!("Distance to the nearest robot: {name}"),
            &columns,
            limit_m,
        )?,
    })
}

fn delays(number: usize, name: &str, cells: &[&Cell]) -> Result<Figure, FigureError> {
    let columns: Vec<DelayColumn> =
        cells.iter().map(|cell| DelayColumn { name: &cell.row.name, listening: &cell.listening }).collect();
    Ok(Figure {
        name: format!("delay-{number}"),
        title: format!("Delays of messages: {name}"),
        caption: "Messages between robots while episodes ran. Left: from publication to arrival at each other host, \
                  as a share of all expected deliveries, so that a curve ends at the share delivered. Right: from \
                  publication to each control step that had the message, within range and not yet dropped. Dashed: \
                  20 and 50 ms. Columns in which no message crosses a link (sim, centralized) have no curve."
            .to_owned(),
        svg: murmurate_report::figures::delays(&format!("Delays of messages: {name}"), &columns)?,
    })
}

/// Returns the report page of a study as HTML, with its figures and tables.
pub fn page(study: &Study, results: &Results, figures: &[Figure]) -> String {
    let mut parts = vec![Part::Text(format!(
        "{}; {}, each run {}; seed {}.",
        study.scenario_text(),
        counted(study.layouts.len(), "layout"),
        counted(study.repeats, "time"),
        study.seed
    ))];
    for (at, tested) in study.policies.iter().enumerate() {
        let (heads, rows) = table::of_policy(study, results, at);
        parts.push(Part::Heading(format!("Policy {}, handling {}", tested.policy, tested.handling.name)));
        parts.push(Part::Table(heads, rows));
        let drop = Results::largest_drop_points(&results.of_policy(study, at));
        if let (Some(drop), true) = (drop, published::ran(study, tested)) {
            let most = published::LARGEST_DROP_POINTS;
            let text = format!("Success falls by up to {drop:.1} points against sim; in the paper by up to {most}.");
            parts.push(Part::Text(text));
        }
    }
    let costs = "Mean and median cost of the episodes, with the 95 % interval of the mean by Student's t; completed: \
                 episodes without a collision that lasted their time. 'within 50 ms': messages between robots that \
                 arrived within 50 ms, of all expected deliveries.";
    let successes = "Success with its 95 % Wilson interval; median makespan of the successes with its quartiles; \
                     'paper', where there is such a column: Table I of Blumenkamp et al., ICRA 2022, on real robots, \
                     which ran the task passage with five robots and the policy 'published' or its like. Failures by \
                     what came first: robot collisions (nearer to each other than the rules allow), wall collisions, \
                     timeouts, aborted and unseen episodes. 'within 50 ms': messages between robots that arrived \
                     within 50 ms, of all expected deliveries.";
    let legend = if study.scenario.cost().is_some() { costs } else { successes };
    parts.push(Part::Text(legend.to_owned()));
    parts.push(Part::Heading("Figures".to_owned()));
    parts.extend(figures.iter().map(Part::Figure));
    parts.push(Part::Heading("What was run".to_owned()));
    parts.push(Part::Verbatim(study.command.clone()));
    parts.push(Part::Terms(configuration(study)));
    page::page(&format!("murmurate study {}", study.name), &parts)
}

fn configuration(study: &Study) -> Vec<(String, String)> {
    let identity = study.identity();
    let Deployed { plant, radio, fitted, body } = &identity.conditions;
    let fitted = fitted.as_ref();
    let radio = if let Some(given) = fitted.filter(|given| given.impair()) {
        let (delay_ms, loss) = (1e3 * given.delay_s.unwrap_or(0.0), 1e2 * given.loss.unwrap_or(0.0));
        format!("messages between robots delayed by {delay_ms:.1} ms and lost by {loss:.1} % (--conditions)")
    } else if study.columns.iter().all(|column| column.impairment().is_some()) {
        "links with the delay and loss of the column".to_owned()
    } else {
        format!("radio '{radio}' (docs/radio.md)")
    };
    let lag = fitted.and_then(|given| given.lag_s).map_or(String::new(), |lag_s| format!(" with a lag of {lag_s} s"));
    let mut terms = vec![
        ("program".to_owned(), format!("murmurate {}", identity.version)),
        ("scenario".to_owned(), identity.scenario),
        ("layouts, with a digest".to_owned(), identity.layouts),
        ("policies, with digests of their files".to_owned(), identity.policies.join("; ")),
        ("column sim".to_owned(), "the training world: lock step, exact placement, perfect messages".to_owned()),
        (
            "all other columns".to_owned(),
            format!("world '{plant}'{lag} (docs/world.md), motion capture, unattended resets; {radio}"),
        ),
    ];
    if !body.is_empty() {
        let fields = serde_json::to_string(body).expect("settings are plain data");
        let fields = fields.trim_matches(['{', '}']).replace('"', "").replace(':', " = ").replace(',', ", ");
        terms.push(("chassis of all robots, in every column".to_owned(), fields));
    }
    let used = PRESETS.iter().filter(|preset| study.policies.iter().any(|tested| tested.handling == *preset));
    terms.extend(used.map(|preset| (format!("handling '{}'", preset.name), preset.about.to_owned())));
    terms
}
