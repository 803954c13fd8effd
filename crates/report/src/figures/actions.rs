//! Figure of the difference of two policies' actions over time, one line per robot.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::{FigureError, TEXT, colour, style, svg};

const HEIGHT: u32 = 560;

/// Draws the difference of two policies' actions over time, one line per robot. `robots` has for each robot its id and
/// pairs of time \[s\] and norm of the difference \[m/s\]. Returns the SVG.
pub fn actions(title: &str, robots: &[(u16, Vec<(f64, f64)>)]) -> Result<String, FigureError> {
    let points = || robots.iter().flat_map(|(_, points)| points);
    let last_s = points().map(|(at_s, _)| *at_s).fold(1.0, f64::max);
    let most = points().map(|(_, size)| *size).fold(0.1, f64::max);
    svg(HEIGHT, |area| {
        area.draw(&Text::new(title.to_owned(), (20, 14), style(TEXT + 3, BLACK, HPos::Left, VPos::Top)))?;
        let mut chart = ChartBuilder::on(area)
            .margin_top(56)
            .margin_right(110)
            .margin_left(14)
            .margin_bottom(14)
            .x_label_area_size(56)
            .y_label_area_size(72)
            .build_cartesian_2d(0.0..last_s, 0.0..most * 1.05)?;
        let mut mesh = chart.configure_mesh();
        mesh.light_line_style(WHITE).x_labels(8).y_labels(6).x_desc("time [s]").y_desc("difference [m/s]");
        mesh.label_style(("sans-serif", TEXT - 2)).axis_desc_style(("sans-serif", TEXT - 1)).draw()?;
        for (robot, points) in robots {
            let line = PathElement::new(points.clone(), colour((*robot).into()).stroke_width(2));
            chart.draw_series([line])?;
        }
        for (place, (robot, _)) in robots.iter().take(16).enumerate() {
            let y = 70 + 28 * i32::try_from(place).expect("there are at most 16");
            area.draw(&PathElement::new(vec![(1105, y), (1130, y)], colour((*robot).into()).stroke_width(4)))?;
            let text = style(TEXT - 2, BLACK, HPos::Left, VPos::Center);
            area.draw(&Text::new(format!("robot {robot}"), (1136, y), text))?;
        }
        Ok(())
    })
}
