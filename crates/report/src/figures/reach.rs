//! Map of stations: who hears whom, and who senses whom alone.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::{Drawn, FigureError, GREY, TEXT, WIDTH, colour, dashes, dashes_along, style, svg};

/// Space above the map, beside it, and below it \[pixels\].
const ABOVE: u32 = 90;
const BESIDE: u32 = 70;
/// Largest height of the map \[pixels\].
const MOST: f64 = 760.0;
/// Number of dashes between stations that only sense each other.
const DASHES: usize = 14;
/// Height of a bent line over its length.
const BEND: f64 = 0.1;

/// Pairs of stations that a transmission of one of them reaches, by their indices, smaller first.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pairs {
    /// Pairs that read each other.
    pub read: Vec<(usize, usize)>,
    /// Pairs that sense each other, and read nothing.
    pub sensed: Vec<(usize, usize)>,
}

/// Draws stations at their places \[m\], a line between those that hear each other, and a dashed one between those that
/// only sense each other. Returns the SVG.
pub fn reach(title: &str, places: &[[f32; 2]], pairs: &Pairs) -> Result<String, FigureError> {
    let places: Vec<(f64, f64)> = places.iter().map(|[x, y]| (f64::from(*x), f64::from(*y))).collect();
    let ends = |of: fn(&(f64, f64)) -> f64| {
        let low = places.iter().map(of).fold(f64::INFINITY, f64::min);
        let high = places.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
        (low, high)
    };
    let (x, y) = (ends(|place| place.0), ends(|place| place.1));
    // A tenth on each side, and so much that a line of stations has a height.
    let wide = (x.1 - x.0).max(0.2 * (y.1 - y.0)).max(1.0) * 1.2;
    let high = (y.1 - y.0).max(0.15 * wide) * 1.2;
    let (middle_x, middle_y) = (0.5 * (x.0 + x.1), 0.5 * (y.0 + y.1));
    let scale = (f64::from(WIDTH - BESIDE - 30) / wide).min(MOST / high);
    let (width, height) = ((wide * scale) as u32, (high * scale) as u32);
    svg(ABOVE + height + BESIDE, |area| {
        area.draw(&Text::new(title.to_owned(), (20, 14), style(TEXT + 3, BLACK, HPos::Left, VPos::Top)))?;
        legend(area)?;
        let ground = area.clone().shrink((0, ABOVE as i32), (width + BESIDE + 20, height + BESIDE));
        let mut chart = ChartBuilder::on(&ground)
            .margin_right(20)
            .x_label_area_size(BESIDE)
            .y_label_area_size(BESIDE)
            .build_cartesian_2d(
                middle_x - 0.5 * wide..middle_x + 0.5 * wide,
                middle_y - 0.5 * high..middle_y + 0.5 * high,
            )?;
        let mut mesh = chart.configure_mesh();
        mesh.disable_mesh().x_labels(8).y_labels(6).x_desc("x [m]").y_desc("y [m]");
        let whole = |value: &f64| format!("{value:.0}").replace("-0", "0");
        mesh.x_label_formatter(&whole).y_label_formatter(&whole);
        mesh.label_style(("sans-serif", TEXT - 2)).axis_desc_style(("sans-serif", TEXT - 2)).draw()?;
        for &(from, to) in &pairs.sensed {
            let pieces = bent(places[from], places[to]);
            chart.draw_series(pieces.map(|piece| PathElement::new(piece, colour(5).stroke_width(2))))?;
        }
        let line =
            |&(from, to): &(usize, usize)| PathElement::new(vec![places[from], places[to]], colour(0).stroke_width(2));
        chart.draw_series(pairs.read.iter().map(line))?;
        chart.draw_series(places.iter().map(|place| Circle::new(*place, 13, colour(1).filled())))?;
        chart.draw_series(places.iter().enumerate().map(|(station, place)| {
            Text::new(station.to_string(), *place, style(TEXT - 5, WHITE, HPos::Center, VPos::Center))
        }))?;
        Ok(())
    })
}

/// Returns the dashes of a bent line between two points, which shows beside a straight one of others.
fn bent(from: (f64, f64), to: (f64, f64)) -> impl Iterator<Item = Vec<(f64, f64)>> {
    let (x, y) = (to.0 - from.0, to.1 - from.1);
    let at = move |t: f64| {
        let bulge = BEND * 4.0 * t * (1.0 - t);
        (from.0 + x * t - y * bulge, from.1 + y * t + x * bulge)
    };
    dashes_along(at, DASHES)
}

fn legend(area: &super::Area) -> Drawn {
    let text =
        |label: &str, x: i32| Text::new(label.to_owned(), (x, 64), style(TEXT - 2, GREY, HPos::Left, VPos::Center));
    area.draw(&PathElement::new(vec![(20, 64), (70, 64)], colour(0).stroke_width(2)))?;
    area.draw(&text("hear each other", 80))?;
    for piece in dashes((290.0, 64.0), (350.0, 64.0), 5) {
        let piece: Vec<(i32, i32)> = piece.into_iter().map(|(x, y)| (x as i32, y as i32)).collect();
        area.draw(&PathElement::new(piece, colour(5).stroke_width(2)))?;
    }
    area.draw(&text("only sense each other; without a line: hidden from each other", 360))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_stations_is_drawn_with_its_pairs() {
        let pairs = Pairs { read: vec![(0, 1), (1, 2)], sensed: vec![(0, 2)] };
        let svg = reach("Three", &[[0.0, 0.0], [25.0, 0.0], [50.0, 0.0]], &pairs).expect("a figure");
        assert!(svg.matches("<circle").count() == 3 && svg.contains("hear each other"), "{svg}");
        assert!(reach("One", &[[1.0, 1.0]], &Pairs::default()).is_ok());
    }
}
