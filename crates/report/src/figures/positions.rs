//! Figure of the density of robots' positions on the ground, with the obstacles: one panel per column.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::{Area, Drawn, FigureError, GREY, PANELS, TEXT, WIDTH, panels, rows, style, svg};
use crate::grid::Grid;
use murmurate::scenario::Arena;

/// Robots' positions in one column of a study, for a figure.
#[derive(Clone, Debug)]
pub struct Positions<'a> {
    /// Name of the column, a set of conditions in a study.
    pub name: &'a str,
    /// Histogram of the positions over x and y \[m\], world frame.
    pub grid: &'a Grid,
}

/// Height of the figure's title, and margins of a panel above, below and beside its ground \[pixels\].
const HEAD: u32 = 52;
const ABOVE: u32 = 40;
const BELOW: u32 = 62;
const BESIDE: u32 = 70;

/// Returns the colour for a share of the scale, 0 to 1: white, blue, nearly black.
fn shade(share: f64) -> RGBColor {
    let stops = [(255.0, 255.0, 255.0), (150.0, 200.0, 230.0), (0.0, 114.0, 178.0), (0.0, 25.0, 60.0)];
    let at = share.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let (low, t) = ((at as usize).min(stops.len() - 2), at - (at as usize).min(stops.len() - 2) as f64);
    let mix = |a: f64, b: f64| (a + (b - a) * t).round() as u8;
    let (from, to) = (stops[low], stops[low + 1]);
    RGBColor(mix(from.0, to.0), mix(from.1, to.1), mix(from.2, to.2))
}

/// Returns the share of all robots' time that was spent in a bin, per area \[1/m²\].
fn per_area(grid: &Grid, x: usize, y: usize) -> f64 {
    let area = f64::from(grid.x.width() * grid.y.width());
    grid.count(x, y) as f64 / (grid.total().max(1) as f64 * area)
}

/// Draws the density of robots' positions on the ground of `arena`, one panel per column, all on one colour scale.
/// Returns the SVG.
pub fn positions(title: &str, columns: &[Positions], arena: &Arena) -> Result<String, FigureError> {
    let ratio = f64::from(arena.half_extent.y / arena.half_extent.x);
    let ground = WIDTH / PANELS as u32 - BESIDE - 20;
    let high = (f64::from(ground) * ratio).round() as u32;
    let count = columns.len() + 1;
    let mut all: Vec<f64> = columns.iter().flat_map(|column| densities(column.grid)).collect();
    all.sort_by(f64::total_cmp);
    // The scale ends below the densest bins; otherwise one in which all robots wait would make the others pale.
    let most = all.get((all.len() * 995 / 1000).min(all.len().saturating_sub(1))).copied().unwrap_or(1.0).max(1e-9);
    let panel = ABOVE + high + BELOW;
    svg(HEAD + panel * rows(count), |area| {
        area.draw(&Text::new(title.to_owned(), (20, 14), style(TEXT + 3, BLACK, HPos::Left, VPos::Top)))?;
        let areas = panels(area, count, (HEAD, panel));
        for (column, area) in columns.iter().zip(&areas) {
            draw(area, column, arena, most)?;
        }
        legend(&areas[columns.len()], most, high)
    })
}

fn densities(grid: &Grid) -> impl Iterator<Item = f64> + '_ {
    let bins = (0..grid.y.bins).flat_map(|y| (0..grid.x.bins).map(move |x| (x, y)));
    bins.map(|(x, y)| per_area(grid, x, y)).filter(|density| *density > 0.0)
}

fn draw(area: &Area, column: &Positions, arena: &Arena, most: f64) -> Drawn {
    let half = (f64::from(arena.half_extent.x), f64::from(arena.half_extent.y));
    area.draw(&Text::new(column.name.to_owned(), (BESIDE as i32, 8), style(TEXT, BLACK, HPos::Left, VPos::Top)))?;
    let mut chart = ChartBuilder::on(area)
        .margin_top(ABOVE)
        .margin_right(20)
        .margin_left(12)
        .x_label_area_size(BELOW - 8)
        .margin_bottom(8)
        .y_label_area_size(BESIDE - 12)
        .build_cartesian_2d(-half.0..half.0, -half.1..half.1)?;
    let mut mesh = chart.configure_mesh();
    mesh.disable_mesh().x_labels(5).y_labels(7).x_desc("x [m]").y_desc("y [m]");
    let whole = |value: &f64| format!("{value:.0}").replace("-0", "0");
    mesh.x_label_formatter(&whole).y_label_formatter(&whole);
    mesh.label_style(("sans-serif", TEXT - 2)).axis_desc_style(("sans-serif", TEXT - 2)).draw()?;
    let grid = column.grid;
    let bins = (0..grid.y.bins).flat_map(|y| (0..grid.x.bins).map(move |x| (x, y)));
    let corner = |x: usize, y: usize| (f64::from(grid.x.at(x)), f64::from(grid.y.at(y)));
    chart.draw_series(bins.filter(|&(x, y)| grid.count(x, y) > 0).map(|(x, y)| {
        let colour = shade((per_area(grid, x, y) / most).sqrt());
        Rectangle::new([corner(x, y), corner(x + 1, y + 1)], colour.filled())
    }))?;
    for block in &arena.keep_outs {
        let corners = [block.min, block.max].map(|corner| (f64::from(corner.x), f64::from(corner.y)));
        let rim: Vec<(f64, f64)> = block.solid().rim().into_iter().map(|[x, y]| (x.into(), y.into())).collect();
        if block.is_rect() {
            chart.draw_series([Rectangle::new(corners, GREY.mix(0.85).filled())])?;
        } else {
            chart.draw_series([Polygon::new(rim.clone(), GREY.mix(0.85).filled())])?;
        }
        let closed = rim.iter().chain(rim.first()).copied();
        chart.draw_series([PathElement::new(closed.collect::<Vec<_>>(), BLACK.stroke_width(1))])?;
    }
    let ends = [(-half.0, -half.1), (half.0, half.1)];
    chart.draw_series([Rectangle::new(ends, BLACK.stroke_width(1))])?;
    Ok(())
}

fn legend(area: &Area, most: f64, high: u32) -> Drawn {
    let (left, top, bottom) = (BESIDE as i32, ABOVE as i32, (ABOVE + high) as i32);
    let steps = 60;
    let at = |step: i32| bottom - (bottom - top) * step / steps;
    for step in 0..steps {
        let colour = shade(f64::from(step) / f64::from(steps));
        area.draw(&Rectangle::new([(left, at(step + 1)), (left + 30, at(step))], colour.filled()))?;
    }
    area.draw(&Rectangle::new([(left, top), (left + 30, bottom)], BLACK.stroke_width(1)))?;
    for quarter in 0..=4 {
        let share = f64::from(quarter) / 4.0;
        let y = bottom - ((f64::from(bottom - top)) * share) as i32;
        let sign = if quarter == 4 { " or more" } else { "" };
        let text = format!("{:.2}{sign}", most * share * share);
        area.draw(&Text::new(text, (left + 40, y), style(TEXT - 2, BLACK, HPos::Left, VPos::Center)))?;
    }
    let lines = ["share of the robots'", "time, per m²"];
    for (line, text) in lines.into_iter().enumerate() {
        let at = (left, bottom + 12 + 24 * line as i32);
        area.draw(&Text::new(text, at, style(TEXT - 2, BLACK, HPos::Left, VPos::Top)))?;
    }
    Ok(())
}
