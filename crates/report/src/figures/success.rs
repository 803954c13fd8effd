//! Figure of success rates: one row per column, with a mark and its interval for each policy, and the paper's rates.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::{Drawn, FigureError, TEXT, colour, mark, style, svg};

/// Success rate with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share {
    /// Success rate, 0 to 1.
    pub rate: f64,
    /// Lower and upper end of the 95 % interval of the success rate, 0 to 1.
    pub ci95: [f64; 2],
}

/// Success rates of all policies in one column of a study.
#[derive(Clone, Debug)]
pub struct Group {
    /// Name of the column, a set of conditions in a study.
    pub name: String,
    /// Success rate of each policy, in the order of the study's policies; `None` for a policy without a result.
    pub shares: Vec<Option<Share>>,
    /// Success rate in the paper, 0 to 1; `None` for a column that is not in its Table I.
    pub paper: Option<f64>,
}

/// Height of a row, and of the space above and below all rows \[pixels\].
const ROW: u32 = 74;
const HEAD: u32 = 52;
const FOOT: u32 = 72;

/// Draws the success rate of each policy with its interval, one row per column. `entrants` are the names of the
/// policies. Returns the SVG.
pub fn success(title: &str, entrants: &[String], groups: &[Group]) -> Result<String, FigureError> {
    let compared = groups.iter().any(|group| group.paper.is_some());
    let legend = 32 * (entrants.len() as u32 + u32::from(compared));
    let count = groups.len() as f64;
    let least = groups.iter().flat_map(|group| &group.shares).flatten().map(|share| share.ci95[0]);
    let least = least.chain(groups.iter().filter_map(|group| group.paper)).fold(0.9, f64::min);
    let first = ((100.0 * least - 2.0) / 10.0).floor().max(0.0) * 10.0;
    svg(HEAD + legend + ROW * groups.len() as u32 + FOOT, |area| {
        area.draw(&Text::new(title.to_owned(), (20, 14), style(TEXT + 3, BLACK, HPos::Left, VPos::Top)))?;
        for (at, name) in entrants.iter().enumerate() {
            let y = (HEAD + 32 * at as u32 + 12) as i32;
            mark(area, (260, y), at, colour(at))?;
            area.draw(&Text::new(name.clone(), (280, y), style(TEXT - 1, BLACK, HPos::Left, VPos::Center)))?;
        }
        if compared {
            let y = (HEAD + legend - 20) as i32;
            cross(area, (260, y))?;
            let label = "the paper's robots (Table I)";
            area.draw(&Text::new(label, (280, y), style(TEXT - 1, BLACK, HPos::Left, VPos::Center)))?;
        }
        let mut chart = ChartBuilder::on(area)
            .margin_top(HEAD + legend)
            .margin_left(240)
            .margin_right(40)
            .margin_bottom(10)
            .x_label_area_size(FOOT - 14)
            .build_cartesian_2d(first..100.5, 0.0..count)?;
        let mut mesh = chart.configure_mesh();
        mesh.disable_y_mesh().disable_y_axis().light_line_style(WHITE).x_desc("success [%]");
        mesh.x_label_formatter(&|x| format!("{x:.0}")).x_labels(11);
        mesh.label_style(("sans-serif", TEXT)).axis_desc_style(("sans-serif", TEXT)).draw()?;
        for (row, group) in groups.iter().enumerate() {
            let middle = count - 0.5 - row as f64;
            let to_pixel = |share: f64, y: f64| chart.plotting_area().map_coordinate(&(100.0 * share, y));
            let (_, y) = to_pixel(1.0, middle);
            area.draw(&Text::new(group.name.clone(), (228, y), style(TEXT, BLACK, HPos::Right, VPos::Center)))?;
            let slots = group.shares.len() as f64;
            for (at, share) in group.shares.iter().enumerate() {
                let Some(share) = share else { continue };
                let place = middle + 0.7 * ((slots - 1.0) / 2.0 - at as f64) / slots.max(1.0);
                let [low, high] = share.ci95.map(|end| to_pixel(end.max(first / 100.0), place));
                area.draw(&PathElement::new(vec![low, high], colour(at).stroke_width(3)))?;
                mark(area, to_pixel(share.rate.max(first / 100.0), place), at, colour(at))?;
            }
            if let Some(paper) = group.paper {
                cross(area, to_pixel(paper, middle))?;
            }
        }
        Drawn::Ok(())
    })
}

fn cross(area: &super::Area, (x, y): (i32, i32)) -> Drawn {
    for turn in [-1, 1] {
        area.draw(&PathElement::new(vec![(x - 8, y - 8 * turn), (x + 8, y + 8 * turn)], BLACK.stroke_width(3)))?;
    }
    Ok(())
}
