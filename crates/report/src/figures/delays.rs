//! Figure of message delays as cumulative shares: from publication to arrival, and from publication to the control
//! steps that used the message.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::{Area, Drawn, FigureError, GREY, TEXT, WIDTH, colour, dashes, style, svg};
use murmurate::results::listening::Listening;

/// Deliveries and delays of messages in one column of a study, for a figure.
#[derive(Clone, Debug)]
pub struct DelayColumn<'a> {
    /// Name of the column, a set of conditions in a study.
    pub name: &'a str,
    /// Deliveries and delays of messages in the column.
    pub listening: &'a Listening,
}

const HEIGHT: u32 = 560;
/// Height of the figure's title \[pixels\].
const HEAD: i32 = 52;
/// Delays at which the paper's network study reports shares \[s\].
const MARKS_S: [f64; 2] = [0.02, 0.05];
/// Lower and upper end of the delay axis \[s\].
const ENDS_S: (f64, f64) = (1e-4, 1.0);

/// Draws the delays of messages from publication to arrival and to the control step that uses them, as cumulative
/// shares, with a line for every column in which messages cross a link. Returns the SVG.
pub fn delays(title: &str, columns: &[DelayColumn]) -> Result<String, FigureError> {
    let crossing: Vec<(usize, &DelayColumn)> =
        columns.iter().enumerate().filter(|(_, column)| column.listening.due > 0).collect();
    let below = 16 + 30 * crossing.len().div_ceil(3) as u32;
    svg(HEIGHT + below, |area| {
        area.draw(&Text::new(title.to_owned(), (20, 14), style(TEXT + 3, BLACK, HPos::Left, VPos::Top)))?;
        let half = (WIDTH / 2, HEIGHT - HEAD as u32);
        let left = area.clone().shrink((0, HEAD), half);
        let right = area.clone().shrink((half.0 as i32, HEAD), half);
        panel(&left, "publication to arrival", "share of messages due", &crossing, arrived)?;
        let step = |heard: &Listening| heard.age.cumulative();
        panel(&right, "publication to control step", "share of messages in use", &crossing, step)?;
        legend(area, &crossing)
    })
}

/// Returns the share of the messages due that had arrived within each delay \[s\].
fn arrived(heard: &Listening) -> Vec<(f64, f64)> {
    let share = heard.delivered().unwrap_or(0.0);
    heard.delay.cumulative().into_iter().map(|(edge, within)| (edge, share * within)).collect()
}

/// Draws the ages of messages at control steps as cumulative shares, one line per column. Returns the SVG.
pub fn ages(title: &str, columns: &[DelayColumn]) -> Result<String, FigureError> {
    let age = |heard: &Listening| heard.age.cumulative();
    single(title, ("publication to control step", "share of messages in use"), columns, age)
}

/// Draws the delays of messages until their arrival as cumulative shares of the messages due, one line per column.
/// Returns the SVG.
pub fn arrivals(title: &str, columns: &[DelayColumn]) -> Result<String, FigureError> {
    single(title, ("sending to arrival", "share of messages due"), columns, arrived)
}

/// Draws one panel with the heading and the name of its axis `names`, one line per column.
fn single(
    title: &str,
    names: (&str, &str),
    columns: &[DelayColumn],
    line: impl Fn(&Listening) -> Vec<(f64, f64)>,
) -> Result<String, FigureError> {
    // Lines that coincide differ in width, and their colours are far from each other.
    let columns: Vec<(usize, &DelayColumn)> = columns.iter().enumerate().map(|(at, column)| (3 * at, column)).collect();
    svg(HEIGHT + 46, |area| {
        area.draw(&Text::new(title.to_owned(), (20, 14), style(TEXT + 3, BLACK, HPos::Left, VPos::Top)))?;
        let below = area.clone().shrink((0, HEAD), (WIDTH, HEIGHT - HEAD as u32));
        panel(&below, names.0, names.1, &columns, line)?;
        legend(area, &columns)
    })
}

fn legend(area: &Area, columns: &[(usize, &DelayColumn)]) -> Drawn {
    for (place, (at, column)) in columns.iter().enumerate() {
        let (x, y) = (60 + 370 * (place % 3) as i32, HEIGHT as i32 + 30 * (place / 3) as i32 + 14);
        area.draw(&PathElement::new(vec![(x, y), (x + 36, y)], colour(*at).stroke_width(4)))?;
        let text = style(TEXT - 1, BLACK, HPos::Left, VPos::Center);
        area.draw(&Text::new(column.name.to_owned(), (x + 46, y), text))?;
    }
    Ok(())
}

fn panel(
    area: &Area,
    title: &str,
    what: &str,
    columns: &[(usize, &DelayColumn)],
    line: impl Fn(&Listening) -> Vec<(f64, f64)>,
) -> Drawn {
    area.draw(&Text::new(title.to_owned(), (86, 4), style(TEXT, BLACK, HPos::Left, VPos::Top)))?;
    let mut chart = ChartBuilder::on(area)
        .margin_top(36)
        .margin_right(24)
        .margin_left(14)
        .margin_bottom(14)
        .x_label_area_size(56)
        .y_label_area_size(72)
        .build_cartesian_2d((1000.0 * ENDS_S.0..1000.0 * ENDS_S.1).log_scale(), 0.0..1.02)?;
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(WHITE).x_labels(5).y_labels(6).x_desc("delay [ms]").y_desc(what);
    mesh.x_label_formatter(&|x| format!("{x}")).y_label_formatter(&|y| format!("{y:.1}"));
    mesh.label_style(("sans-serif", TEXT - 2)).axis_desc_style(("sans-serif", TEXT - 1)).draw()?;
    for mark in MARKS_S.map(|mark| 1000.0 * mark) {
        let pieces = dashes((mark, 0.0), (mark, 1.0), 30);
        chart.draw_series(pieces.map(|piece| PathElement::new(piece, GREY.stroke_width(1))))?;
        let text = style(TEXT - 4, GREY, HPos::Right, VPos::Top);
        chart.draw_series([Text::new(format!("{mark:.0} ms "), (mark, 0.08), text)])?;
    }
    for (at, column) in columns {
        let points = line(column.listening).into_iter().filter(|(edge, _)| *edge <= ENDS_S.1);
        let points: Vec<(f64, f64)> = points.map(|(edge, share)| (1000.0 * edge, share)).collect();
        // Lines may coincide, so later ones are thinner.
        let width = 7 - (*at as u32).min(5);
        chart.draw_series([PathElement::new(points, colour(*at).stroke_width(width))])?;
    }
    Ok(())
}
