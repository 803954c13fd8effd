//! Figures as SVG. They have axes with units, are readable at half their size, and use colours that colour-blind
//! readers can distinguish. Callers pass plain data.

mod actions;
mod delays;
mod makespans;
pub mod page;
pub mod picture;
#[cfg(feature = "png")]
pub mod png;
mod positions;
mod reach;
mod separation;
mod success;
mod sweep;

pub use actions::actions;
pub use delays::{DelayColumn, ages, arrivals, delays};
pub use makespans::{Makespans, makespans};
pub use positions::{Positions, positions};
pub use reach::{Pairs, reach};
pub use separation::separation;
pub use success::{Group, Share, success};
pub use sweep::{Line, Panel, Point, sweep};

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::TextStyle;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Figure of a report.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Name of the figure's file, without extension.
    pub name: String,
    /// Title of the figure.
    pub title: String,
    /// Caption that explains how to read the figure.
    pub caption: String,
    /// Drawing as SVG.
    pub svg: String,
}

/// Error: a figure cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[error("cannot draw a figure: {0}")]
pub struct FigureError(String);

impl<E: std::error::Error + Send + Sync> From<DrawingAreaErrorKind<E>> for FigureError {
    fn from(error: DrawingAreaErrorKind<E>) -> FigureError {
        FigureError(error.to_string())
    }
}

/// Colours that colour-blind readers can distinguish (Okabe and Ito): blue, vermilion, green, orange, purple, sky blue,
/// black.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(230, 159, 0),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];
/// Colour of less important elements, such as rules and limits.
const GREY: RGBColor = RGBColor(110, 110, 110);
/// Width of every figure, and size of its text \[pixels\].
const WIDTH: u32 = 1200;
const TEXT: u32 = 21;
/// Number of panels per row.
const PANELS: usize = 4;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), FigureError>;

/// Draws a figure of this height \[pixels\] on a white background, for light and dark pages. Returns the SVG.
fn svg(height: u32, draw: impl FnOnce(&Area) -> Drawn) -> Result<String, FigureError> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, (WIDTH, height)).into_drawing_area();
        area.fill(&WHITE)?;
        draw(&area)?;
        area.present()?;
    }
    // The figure scales with the page that contains it.
    Ok(text.replacen("<svg width=", &format!("<svg style=\"max-width:{WIDTH}px;height:auto\" width="), 1))
}

fn style(size: u32, colour: RGBColor, across: HPos, along: VPos) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&colour).pos(Pos::new(across, along))
}

fn colour(at: usize) -> RGBColor {
    COLOURS[at % COLOURS.len()]
}

/// Returns the pieces of a dashed line between two points.
fn dashes(from: (f64, f64), to: (f64, f64), pieces: usize) -> impl Iterator<Item = Vec<(f64, f64)>> {
    dashes_along(move |t| (from.0 + (to.0 - from.0) * t, from.1 + (to.1 - from.1) * t), pieces)
}

/// Returns the pieces of a dashed line along a curve, whose points `at` gives for 0 to 1.
fn dashes_along(at: impl Fn(f64) -> (f64, f64), pieces: usize) -> impl Iterator<Item = Vec<(f64, f64)>> {
    let step = 1.0 / pieces as f64;
    (0..pieces).map(move |piece| vec![at(step * piece as f64), at(step * (piece as f64 + 0.55))])
}

/// Draws a mark. Its shape also depends on `at`, so that marks differ in more than their colour.
fn mark(area: &Area, (x, y): (i32, i32), at: usize, colour: RGBColor) -> Drawn {
    let filled = colour.filled();
    match at % 4 {
        0 => area.draw(&Circle::new((x, y), 7, filled))?,
        1 => area.draw(&Rectangle::new([(x - 6, y - 6), (x + 6, y + 6)], filled))?,
        2 => area.draw(&Polygon::new(vec![(x, y - 9), (x + 8, y + 6), (x - 8, y + 6)], filled))?,
        _ => area.draw(&Polygon::new(vec![(x, y - 9), (x + 8, y), (x, y + 9), (x - 8, y)], filled))?,
    }
    Ok(())
}

/// Returns the areas of `count` panels, [`PANELS`] per row. Each is `height` pixels high; the first row begins `head`
/// pixels below the top.
fn panels<'a>(area: &Area<'a>, count: usize, (head, height): (u32, u32)) -> Vec<Area<'a>> {
    let width = WIDTH / PANELS as u32;
    let panel = |at: usize| {
        let (column, row) = ((at % PANELS) as u32, (at / PANELS) as u32);
        let (x, y) = ((column * width) as i32, (head + row * height) as i32);
        area.clone().shrink((x, y), (width, height))
    };
    (0..count).map(panel).collect()
}

/// Returns the number of rows that this many panels fill.
fn rows(panels: usize) -> u32 {
    u32::try_from(panels.div_ceil(PANELS)).expect("a figure has few panels")
}
