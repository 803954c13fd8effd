//! Learning curve of a training: one row per iteration, as CSV and as a plot.

use anyhow::{Context, Result};
use murmurate_train::evaluate::Scores;
use murmurate_train::trainer::Metrics;
use plotters::prelude::*;
use serde::{Deserialize, Serialize};

/// Colours of the lines: blue, vermilion and green of the palette for colour-blind readers by Okabe and Ito.
const COLOURS: [RGBColor; 3] = [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115)];
/// Width and height of the plot \[pixels\].
pub(super) const SIZE: (u32, u32) = (900, 720);

/// Row of a training's learning curve: the metrics of one iteration.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    elapsed_s: f64,
    progress: f64,
    iteration: u64,
    decisions: u64,
    env_steps: u64,
    stage: usize,
    earned: f32,
    success: f32,
    arrived: f32,
    length_s: f32,
    epochs: f32,
    divergence: f32,
    entropy: f32,
    value_loss: f32,
    gradient: f32,
    learning_rate: f32,
    #[serde(default)]
    disagreement: Option<f32>,
    perfect_success: Option<f64>,
    perfect_makespan_s: Option<f64>,
    disturbed_success: Option<f64>,
    disturbed_makespan_s: Option<f64>,
}

impl Row {
    /// Returns the row of an iteration from its metrics. `elapsed_s` \[s\] is the duration of the training so far, and
    /// `progress` (0 to 1) the part of it that is done.
    pub fn new(elapsed_s: f64, progress: f64, metrics: &Metrics) -> Row {
        Row {
            elapsed_s,
            progress,
            iteration: metrics.iteration,
            decisions: metrics.decisions,
            env_steps: metrics.env_steps,
            stage: metrics.stage,
            earned: metrics.earned,
            success: metrics.success,
            arrived: metrics.arrived,
            length_s: metrics.length_s,
            epochs: metrics.epochs,
            divergence: metrics.divergence,
            entropy: metrics.entropy,
            value_loss: metrics.value_loss,
            gradient: metrics.gradient,
            learning_rate: metrics.learning_rate,
            disagreement: metrics.disagreement,
            perfect_success: None,
            perfect_makespan_s: None,
            disturbed_success: None,
            disturbed_makespan_s: None,
        }
    }

    fn set_scores(&mut self, scores: &Scores) {
        let of = |conditions: &str| scores.with_default_draw(conditions).map(|score| (score.success, score.makespan_s));
        if let Some((success, makespan_s)) = of("perfect") {
            (self.perfect_success, self.perfect_makespan_s) = (Some(success), makespan_s);
        }
        if let Some((success, makespan_s)) = of("disturbed") {
            (self.disturbed_success, self.disturbed_makespan_s) = (Some(success), makespan_s);
        }
    }
}

/// Learning curve of a training: a row for each iteration so far.
#[derive(Debug, Default)]
pub struct Curve {
    rows: Vec<Row>,
}

impl Curve {
    /// Parses a learning curve from CSV, and keeps its rows up to the iteration `iterations`.
    pub fn from_csv(text: &str, iterations: u64) -> Result<Curve, csv::Error> {
        let rows: Result<Vec<Row>, csv::Error> = csv::Reader::from_reader(text.as_bytes()).deserialize().collect();
        Ok(Curve { rows: rows?.into_iter().filter(|row| row.iteration <= iterations).collect() })
    }

    /// Returns the learning curve as CSV with a header.
    pub fn to_csv(&self) -> Result<String> {
        let mut csv = csv::Writer::from_writer(Vec::new());
        for row in &self.rows {
            csv.serialize(row).context("a row is plain data")?;
        }
        String::from_utf8(csv.into_inner().context("memory takes everything")?).context("a number is text")
    }

    /// Adds the row of the next iteration.
    pub fn push(&mut self, row: Row) {
        self.rows.push(row);
    }

    /// Returns the duration of the training up to the last row \[s\]; 0 without a row.
    pub fn elapsed_s(&self) -> f64 {
        self.rows.last().map_or(0.0, |row| row.elapsed_s)
    }

    /// Adds the results of an evaluation to the last row.
    pub fn set_last_scores(&mut self, scores: &Scores) {
        if let Some(row) = self.rows.last_mut() {
            row.set_scores(scores);
        }
    }

    /// Returns a text of one line about the last 20 iterations: return, success rate, and decisions per second.
    /// `decisions` is the number of all decisions so far.
    /// `stages` is the number of stages of the curriculum.
    pub fn summary(&self, decisions: u64, stages: usize) -> String {
        let Some(last) = self.rows.last() else { return String::new() };
        let recent = &self.rows[self.rows.len().saturating_sub(20)..];
        let per_s = recent[0..].first().map_or(0.0, |first| {
            (last.decisions - first.decisions) as f64 / (last.elapsed_s - first.elapsed_s).max(1e-9)
        });
        // In iterations without the end of an episode, metrics of episodes are NaN.
        let newest = |pick: fn(&Row) -> f32| recent.iter().rev().map(pick).find(|value| value.is_finite());
        let shown = |value: Option<f32>, factor: f32| {
            value.map_or("-".to_owned(), |value| format!("{:.*}", if factor > 1.0 { 0 } else { 2 }, factor * value))
        };
        format!(
            "stage {} of {stages}, return {}, success {} %, {decisions} decisions, {:.1} k/s",
            last.stage + 1,
            shown(newest(|row| row.earned), 1.0),
            shown(newest(|row| row.success), 100.0),
            per_s / 1000.0
        )
    }

    /// Returns the number of decisions, in millions, after which each stage of the curriculum but the first began, with
    /// the number of the stage, from 2.
    fn stages(&self) -> Vec<(f64, usize)> {
        let changes = self.rows.windows(2).filter(|pair| pair[1].stage != pair[0].stage);
        changes.map(|pair| (pair[0].decisions as f64 / 1e6, pair[1].stage + 1)).collect()
    }

    /// Plots success rate and return against the number of decisions, with marks where stages of the curriculum begin,
    /// and returns the SVG. `scenario` is the name of the scenario.
    pub fn plot(&self, scenario: &str) -> Result<String> {
        let mut svg = String::new();
        {
            let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
            area.fill(&WHITE)?;
            let (upper, lower) = area.split_vertically(SIZE.1 / 2);
            let last = self.rows.last().map_or(1.0, |row| row.decisions as f64 / 1e6).max(1e-6);
            let line = |pick: fn(&Row) -> Option<f64>| -> Vec<(f64, f64)> {
                let point =
                    |row: &Row| Some((row.decisions as f64 / 1e6, pick(row).filter(|value| value.is_finite())?));
                self.rows.iter().filter_map(point).collect()
            };
            let stages = self.stages();
            let success = [
                ("in training", smooth(&line(|row| Some(100.0 * f64::from(row.success))))),
                ("evaluated, perfect messages", line(|row| Some(100.0 * row.perfect_success?))),
                ("evaluated, as in training", line(|row| Some(100.0 * row.disturbed_success?))),
            ];
            chart(&upper, &format!("Training '{scenario}'"), (last, 0.0..100.0), "success [%]", (&success, &stages))?;
            let earned = smooth(&line(|row| Some(f64::from(row.earned))));
            let low = earned.iter().map(|point| point.1).fold(f64::INFINITY, f64::min).clamp(-10.0, 0.0);
            let high = earned.iter().map(|point| point.1).fold(f64::NEG_INFINITY, f64::max).max(low + 0.1);
            let range = low - 0.05 * (high - low)..high + 0.05 * (high - low);
            chart(&lower, "", (last, range), "return of a robot", (&[("in training", earned)], &stages))?;
            area.present()?;
        }
        Ok(svg)
    }
}

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// Line of a chart: its name, and its points.
pub(super) type Line<'a> = (&'a str, Vec<(f64, f64)>);

/// Draws lines against millions of decisions, up to `last`. Dashed lines with the numbers of `stages` mark where these
/// begin.
pub(super) fn chart(
    area: &Area,
    title: &str,
    (last, range): (f64, std::ops::Range<f64>),
    unit: &str,
    (lines, stages): (&[Line], &[(f64, usize)]),
) -> Result<()> {
    let (low, high) = (range.start, range.end);
    let mut chart = ChartBuilder::on(area)
        .margin(14)
        .caption(title, ("sans-serif", 22))
        .x_label_area_size(48)
        .y_label_area_size(70)
        .build_cartesian_2d(0.0..last, range)?;
    let mesh = &mut chart.configure_mesh();
    mesh.x_desc("decisions [million]").y_desc(unit).label_style(("sans-serif", 17)).axis_desc_style(("sans-serif", 18));
    mesh.light_line_style(WHITE).draw()?;
    for &(at, stage) in stages {
        chart.draw_series(DashedLineSeries::new([(at, low), (at, high)], 6, 5, BLACK.mix(0.55).stroke_width(1)))?;
        let name = Text::new(format!(" stage {stage}"), (at, high), ("sans-serif", 15).into_font().color(&BLACK));
        chart.draw_series([name])?;
    }
    for (index, (name, points)) in lines.iter().enumerate().filter(|(_, (_, points))| !points.is_empty()) {
        let colour = COLOURS[index % COLOURS.len()];
        // A diverging training has values outside the axes.
        let points: Vec<(f64, f64)> = points.iter().map(|&(x, y)| (x, y.clamp(low, high))).collect();
        let drawn = chart.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?;
        drawn.label(*name).legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], colour.stroke_width(3)));
        if index > 0 {
            chart.draw_series(points.iter().map(|&at| Circle::new(at, 3, colour.filled())))?;
        }
    }
    let mut labels = chart.configure_series_labels();
    labels.position(SeriesLabelPosition::LowerRight).background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3));
    labels.label_font(("sans-serif", 17)).draw()?;
    Ok(())
}

/// Returns the moving average of a line over ten points, since few episodes end in one iteration.
pub(super) fn smooth(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    points
        .iter()
        .enumerate()
        .map(|(at, &(x, _))| {
            let window = &points[at.saturating_sub(9)..=at];
            (x, window.iter().map(|point| point.1).sum::<f64>() / window.len() as f64)
        })
        .collect()
}
