//! Moving obstacles in pictures of an episode: their paths, and where they are at some moments.

use super::scene::Backdrop;
use super::sheet::{View, px};
use murmurate::messages::geometry::Vec2;
use murmurate::scenario::Mover;
use murmurate::time::Span;

/// Returns SVG lines along the paths of the moving obstacles.
pub fn paths(view: &View, stage: &Backdrop) -> String {
    let path = |round: &[Vec2]| {
        let points = round.iter().map(|at| view.at(*at));
        let points: Vec<String> = points.map(|at| format!("{},{}", px(at.x), px(at.y))).collect();
        let line = "<polyline class=\"goal c7\" stroke-width=\"2\" stroke-dasharray=\"2 7\"";
        format!("{line} points=\"{}\"/>\n", points.join(" "))
    };
    stage.arena.movers.iter().map(|mover| path(mover.round())).collect()
}

/// Returns an SVG shape for each moving obstacle where it is at this time since the start of the episode; `rest` holds
/// further attributes of the elements.
pub fn standing(view: &View, stage: &Backdrop, time: Span, rest: &str) -> Vec<String> {
    stage.arena.movers.iter().map(|mover| view.solid("wall", &mover.block(time).solid(), rest)).collect()
}

/// Returns for each moving obstacle the offset \[m\], world frame, from its place at the start of the episode to that
/// at this time.
pub fn offsets(stage: &Backdrop, time: Span) -> Vec<Vec2> {
    let offset = |mover: &Mover| mover.motion(time).position - mover.motion(Span::ZERO).position;
    stage.arena.movers.iter().map(offset).collect()
}
