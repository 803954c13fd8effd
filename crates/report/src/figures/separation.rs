//! Figure of robots' distances to each other against their distance from the origin: one panel per column.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::{Area, COLOURS, Drawn, FigureError, TEXT, dashes, panels, rows, style, svg};
use crate::grid::Grid;

/// Heights of the figure's title and of a panel \[pixels\].
const HEAD: u32 = 52;
const PANEL: u32 = 330;
/// Smallest count with which a bin is drawn.
const LEAST: u64 = 40;

/// Draws the distance of robots to the nearest other robot against their distance from the origin, one panel for each
/// column of a study. `columns` has for each its name, and a histogram over distance from the origin (x) and distance
/// to the nearest other robot (y) \[m\]. Two robots closer than `limit_m` \[m\] have collided. Returns the SVG.
pub fn separation(title: &str, columns: &[(&str, &Grid)], limit_m: f32) -> Result<String, FigureError> {
    let count = columns.len() + 1;
    svg(HEAD + PANEL * rows(count), |area| {
        area.draw(&Text::new(title.to_owned(), (20, 14), style(TEXT + 3, BLACK, HPos::Left, VPos::Top)))?;
        let areas = panels(area, count, (HEAD, PANEL));
        for ((name, grid), area) in columns.iter().zip(&areas) {
            draw(area, name, grid, f64::from(limit_m))?;
        }
        legend(&areas[columns.len()], limit_m)
    })
}

fn draw(area: &Area, name: &str, grid: &Grid, limit_m: f64) -> Drawn {
    let colour = COLOURS[0];
    area.draw(&Text::new(name.to_owned(), (72, 8), style(TEXT, BLACK, HPos::Left, VPos::Top)))?;
    let used = (0..grid.x.bins).rev().find(|&x| grid.quantile(x, 0.5, LEAST).is_some()).unwrap_or(grid.x.bins - 1);
    let (last, most) = (f64::from(grid.x.at(used + 1)), f64::from(grid.y.high));
    let mut chart = ChartBuilder::on(area)
        .margin_top(40)
        .margin_right(20)
        .margin_left(12)
        .margin_bottom(10)
        .x_label_area_size(54)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..last, 0.0..most)?;
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(WHITE).x_labels(5).y_labels(5).x_desc("d_origin [m]").y_desc("d_min [m]");
    mesh.x_label_formatter(&|x| format!("{x:.0}")).y_label_formatter(&|y| format!("{y:.1}"));
    mesh.label_style(("sans-serif", TEXT - 2)).axis_desc_style(("sans-serif", TEXT - 2)).draw()?;
    let line = |q: f64| -> Vec<(f64, f64)> {
        let at = |x: usize| (f64::from(grid.x.at(x)) + f64::from(grid.x.width()) / 2.0, grid.quantile(x, q, LEAST));
        (0..grid.x.bins).map(at).filter_map(|(x, y)| Some((x, f64::from(y?)))).collect()
    };
    let (low, middle, high) = (line(0.05), line(0.5), line(0.95));
    let band: Vec<(f64, f64)> = low.iter().copied().chain(high.into_iter().rev()).collect();
    chart.draw_series([Polygon::new(band, colour.mix(0.25))])?;
    chart.draw_series([PathElement::new(middle, colour.stroke_width(3))])?;
    chart.draw_series([PathElement::new(low, colour.stroke_width(1))])?;
    let limit = dashes((0.0, limit_m), (last, limit_m), 20);
    chart.draw_series(limit.map(|piece| PathElement::new(piece, COLOURS[1].stroke_width(2))))?;
    Ok(())
}

fn legend(area: &Area, limit_m: f32) -> Drawn {
    let text = |y: i32, text: String| Text::new(text, (70, y), style(TEXT - 2, BLACK, HPos::Left, VPos::Center));
    let blue = COLOURS[0];
    area.draw(&PathElement::new(vec![(20, 70), (60, 70)], blue.stroke_width(3)))?;
    area.draw(&text(70, "median".to_owned()))?;
    area.draw(&Rectangle::new([(20, 98), (60, 122)], blue.mix(0.25).filled()))?;
    area.draw(&text(110, "5 to 95 % of steps".to_owned()))?;
    for piece in 0..4 {
        area.draw(&PathElement::new(vec![(20 + 11 * piece, 150), (26 + 11 * piece, 150)], COLOURS[1].stroke_width(2)))?;
    }
    area.draw(&text(150, format!("collision below {limit_m} m")))?;
    Ok(())
}
