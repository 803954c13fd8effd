//! Figure of the densities of makespans: one row per column, with dashed medians of the row and of the baseline.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::{Drawn, FigureError, GREY, TEXT, colour, dashes, style, svg};
use crate::statistics::quantile;

/// Makespans of the episodes in one column (set of conditions) of a study, for a figure.
#[derive(Clone, Debug)]
pub struct Makespans {
    /// Name of the column, a set of conditions in a study.
    pub name: String,
    /// Makespans of the successful episodes \[s\].
    pub values_s: Vec<f64>,
    /// Number of episodes, successful or not.
    pub episodes: usize,
}

/// Height of a row, and of the space above and below all rows \[pixels\].
const ROW: u32 = 92;
const FRAME: u32 = 90;
/// Number of points of a density curve.
const POINTS: usize = 240;

/// Density of the values at `x`, estimated with a Gaussian kernel (Silverman, Density Estimation, 1986, eq. 3.31).
fn density(values: &[f64], bandwidth: f64, x: f64) -> f64 {
    let kernel = |value: &f64| (-0.5 * ((x - value) / bandwidth).powi(2)).exp();
    let sum: f64 = values.iter().map(kernel).sum();
    sum / (values.len() as f64 * bandwidth * (2.0 * std::f64::consts::PI).sqrt())
}

fn bandwidth(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let deviation = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt();
    let quartiles = quantile(values, 0.75).zip(quantile(values, 0.25)).map_or(0.0, |(high, low)| (high - low) / 1.34);
    let spread = if quartiles > 0.0 { deviation.min(quartiles) } else { deviation };
    // At least one World step, since makespans are multiples of it.
    (0.9 * spread * n.powf(-0.2)).max(0.05)
}

/// Draws the distributions of makespans, one row per column, each with its median. The median of the row named
/// `baseline` is shown in all rows. Returns the SVG.
pub fn makespans(title: &str, rows: &[Makespans], baseline: &str) -> Result<String, FigureError> {
    let height = FRAME + 40 + ROW * rows.len() as u32;
    let last = rows.iter().flat_map(|row| &row.values_s).copied().fold(10.0, f64::max) * 1.08;
    let line = |row: &Makespans| -> Vec<(f64, f64)> {
        let width = bandwidth(&row.values_s);
        let share = row.values_s.len() as f64 / row.episodes.max(1) as f64;
        let at = |point: usize| last * point as f64 / POINTS as f64;
        (0..=POINTS).map(|point| (at(point), share * density(&row.values_s, width, at(point)))).collect()
    };
    let lines: Vec<Vec<(f64, f64)>> =
        rows.iter().map(|row| if row.values_s.is_empty() { Vec::new() } else { line(row) }).collect();
    let highest = lines.iter().flatten().map(|point| point.1).fold(0.0, f64::max).max(1e-9);
    let reference = rows.iter().find(|row| row.name == baseline).and_then(|row| quantile(&row.values_s, 0.5));
    svg(height, |area| {
        area.draw(&Text::new(title.to_owned(), (20, 14), style(TEXT + 3, BLACK, HPos::Left, VPos::Top)))?;
        let count = rows.len() as f64;
        let mut chart = ChartBuilder::on(area)
            .margin_top(50)
            .margin_left(20)
            .margin_right(24)
            .x_label_area_size(58)
            .margin_bottom(8)
            .build_cartesian_2d(0.0..last, 0.0..count)?;
        let mut mesh = chart.configure_mesh();
        mesh.disable_y_mesh().disable_y_axis().x_labels(14).x_label_formatter(&|x| format!("{x:.0}"));
        mesh.light_line_style(WHITE).x_desc("makespan [s]").label_style(("sans-serif", TEXT));
        mesh.axis_desc_style(("sans-serif", TEXT)).draw()?;
        for (at, (row, line)) in rows.iter().zip(&lines).enumerate() {
            let (foot, colour) = (count - 1.0 - at as f64, colour(at));
            let tall = |&(x, y): &(f64, f64)| (x, foot + 0.9 * y / highest);
            let mut outline: Vec<(f64, f64)> = line.iter().map(tall).collect();
            chart.draw_series([PathElement::new(vec![(0.0, foot), (last, foot)], GREY.mix(0.5))])?;
            chart.draw_series([PathElement::new(outline.clone(), colour.stroke_width(2))])?;
            outline.extend([(last, foot), (0.0, foot)]);
            chart.draw_series([Polygon::new(outline, colour.mix(0.35))])?;
            let median = quantile(&row.values_s, 0.5);
            if let Some(median) = median {
                let pieces = dashes((median, foot), (median, foot + 0.95), 8);
                chart.draw_series(pieces.map(|piece| PathElement::new(piece, colour.stroke_width(3))))?;
            }
            let second = median.map_or("no success".to_owned(), |median| format!("median {median:.2} s"));
            let share = 100.0 * row.values_s.len() as f64 / row.episodes.max(1) as f64;
            let named = style(TEXT, BLACK, HPos::Left, VPos::Top);
            chart.draw_series([Text::new(row.name.clone(), (0.1, foot + 0.92), named)])?;
            let small = style(TEXT - 3, GREY, HPos::Left, VPos::Top);
            chart.draw_series([Text::new(format!("{second}, {share:.1} %"), (0.1, foot + 0.62), small)])?;
        }
        if let Some(reference) = reference {
            let pieces = dashes((reference, 0.0), (reference, count), 14 * rows.len());
            chart.draw_series(pieces.map(|piece| PathElement::new(piece, BLACK.stroke_width(1))))?;
        }
        Drawn::Ok(())
    })
}
