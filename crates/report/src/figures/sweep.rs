//! Figure of values over the steps of a sweep: panels of lines with intervals.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::{Area, Drawn, FigureError, TEXT, WIDTH, colour, mark, style, svg};

/// Panel of a figure: lines over a common x axis.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Title of the panel.
    pub title: String,
    /// Label of the y axis, with its unit.
    pub y: String,
    /// Lower and upper end of the y axis; `None` fits the axis to the points.
    pub ends: Option<(f64, f64)>,
    /// Lines of the panel.
    pub lines: Vec<Line>,
}

/// Line of a figure's panel.
#[derive(Clone, Debug)]
pub struct Line {
    /// Name of the line in the figure's legend.
    pub name: String,
    /// One point for each place on the x axis; `None` for a place without a value.
    pub points: Vec<Option<Point>>,
}

/// Point of a line: a value with an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Value at which the point is drawn.
    pub value: f64,
    /// Lower and upper end of the interval.
    pub within: [f64; 2],
}

impl Point {
    /// Returns a point at this value; its interval is the value alone.
    pub fn exactly(value: f64) -> Point {
        Point { value, within: [value; 2] }
    }
}

impl Panel {
    /// Returns a panel. `y` is the label of its y axis; `ends` are the axis' ends, or `None` to fit them to the points.
    pub fn new(title: &str, y: &str, ends: Option<(f64, f64)>, lines: Vec<Line>) -> Panel {
        Panel { title: title.to_owned(), y: y.to_owned(), ends, lines }
    }
}

const PANEL: u32 = 480;
const HEAD: u32 = 52;

/// Draws a figure of several panels, two per row. `x` is the label of the x axes, and `places` are the labels of the
/// points on them. Returns the SVG.
pub fn sweep(title: &str, x: &str, places: &[String], panels: &[Panel]) -> Result<String, FigureError> {
    let rows = panels.len().div_ceil(2) as u32;
    let names: Vec<&str> = panels.first().map_or(Vec::new(), |p| p.lines.iter().map(|l| l.name.as_str()).collect());
    let legend = 32 * names.len() as u32;
    svg(HEAD + legend + PANEL * rows, |area| {
        area.draw(&Text::new(title.to_owned(), (20, 14), style(TEXT + 3, BLACK, HPos::Left, VPos::Top)))?;
        for (at, name) in names.iter().enumerate() {
            let y = (HEAD + 32 * at as u32 + 10) as i32;
            area.draw(&PathElement::new(vec![(90, y), (130, y)], colour(at).stroke_width(3)))?;
            mark(area, (110, y), at, colour(at))?;
            let text = style(TEXT - 1, BLACK, HPos::Left, VPos::Center);
            area.draw(&Text::new((*name).to_owned(), (142, y), text))?;
        }
        for (at, panel) in panels.iter().enumerate() {
            let (column, row) = ((at % 2) as u32, (at / 2) as u32);
            let corner = ((column * WIDTH / 2) as i32, (HEAD + legend + row * PANEL) as i32);
            draw(&area.clone().shrink(corner, (WIDTH / 2, PANEL)), x, places, panel)?;
        }
        Ok(())
    })
}

fn draw(area: &Area, x: &str, places: &[String], panel: &Panel) -> Drawn {
    area.draw(&Text::new(panel.title.clone(), (86, 10), style(TEXT, BLACK, HPos::Left, VPos::Top)))?;
    let points = || panel.lines.iter().flat_map(|line| &line.points).flatten();
    let (low, high) = points().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), point| {
        (low.min(point.within[0]), high.max(point.within[1]))
    });
    let (low, high) = panel.ends.unwrap_or(if low < high { (low, high) } else { (0.0, 1.0) });
    let room = 0.06 * (high - low).max(1e-6);
    let last = places.len() as f64 - 1.0;
    let mut chart = ChartBuilder::on(area)
        .margin_top(48)
        .margin_right(24)
        .margin_left(14)
        .margin_bottom(10)
        .x_label_area_size(62)
        .y_label_area_size(72)
        .build_cartesian_2d(-0.4..last + 0.4, (low - room).max(0.0)..high + room)?;
    let mut mesh = chart.configure_mesh();
    mesh.disable_x_mesh().x_labels(0).light_line_style(WHITE).x_desc(x).y_desc(panel.y.as_str());
    let digits = if high - low > 8.0 { 0 } else { 1 };
    let number = move |y: &f64| format!("{y:.digits$}");
    mesh.y_label_formatter(&number);
    mesh.label_style(("sans-serif", TEXT - 1)).axis_desc_style(("sans-serif", TEXT - 1)).draw()?;
    let base = area.get_base_pixel();
    let (_, foot) = chart.plotting_area().map_coordinate(&(0.0, (low - room).max(0.0)));
    let pixel = |x: f64, y: f64| {
        let (x, y) = chart.plotting_area().map_coordinate(&(x, y));
        (x - base.0, y - base.1)
    };
    for (place, name) in places.iter().enumerate() {
        let (x, _) = pixel(place as f64, low);
        let text = style(TEXT - 2, BLACK, HPos::Center, VPos::Top);
        area.draw(&Text::new(name.clone(), (x, foot - base.1 + 8), text))?;
    }
    for (at, line) in panel.lines.iter().enumerate() {
        // Shifted sideways, so that intervals do not cover each other.
        let aside = 0.06 * (at as f64 - (panel.lines.len() as f64 - 1.0) / 2.0);
        let there = line.points.iter().enumerate().filter_map(|(place, point)| Some((place as f64 + aside, (*point)?)));
        let there: Vec<(f64, Point)> = there.collect();
        let path: Vec<(i32, i32)> = there.iter().map(|(x, point)| pixel(*x, point.value)).collect();
        area.draw(&PathElement::new(path, colour(at).stroke_width(2)))?;
        for (x, point) in there {
            let ends = point.within.map(|end| pixel(x, end));
            area.draw(&PathElement::new(ends.to_vec(), colour(at).stroke_width(2)))?;
            mark(area, pixel(x, point.value), at, colour(at))?;
        }
    }
    Ok(())
}
