//! Still picture of an episode: paths, and robots at some moments along them, more opaque with time.

use std::fmt::Write as _;

use super::movers;
use super::scene::{Scene, SceneFrame};
use super::sheet::{COLOURS, View, goal_mark, goals, legend, px, sheet, verdict, waypoint_mark};
use murmurate::time::Span;

/// Approximate number of moments at which each robot is drawn.
const MOMENTS: u64 = 7;
/// Possible intervals between two moments at which robots are drawn \[ms\]; the first that gives few enough moments is
/// used.
const BETWEEN_MS: [u64; 8] = [250, 500, 1000, 2000, 5000, 10_000, 30_000, 60_000];
/// Lower limit of the opacity of robots that are drawn at moments before the end of the episode.
const FAINT: f32 = 0.10;
/// Opacity of robots that are drawn at the last moment before the end of the episode.
const STRONG: f32 = 0.55;

/// Returns an SVG file that shows the whole episode: the robots' paths, and the robots at some seven moments along
/// them, more opaque with time.
pub fn still(scene: &Scene) -> String {
    let view = View::new(&scene.stage);
    let drawn = drawn(scene, &view) + &verdict(scene, "");
    sheet(&view, scene, "", &drawn, &legend(&view, &marks(scene)))
}

/// Returns the entries of a still picture's legend, for starts, goals, and robots at moments in between. Each is a mark
/// (SVG), the width of the mark \[pixels\] and its text.
pub fn marks(scene: &Scene) -> Vec<(String, f32, String)> {
    let every = format!("every {} s, stronger with time", between(scene.length()).as_secs());
    let dot = |x: u32, opacity: f32| format!("<circle class=\"dot c7\" cx=\"{x}\" r=\"9\" opacity=\"{opacity}\"/>");
    let start = "<circle class=\"start c7\" cx=\"10\" r=\"9\" stroke-width=\"2\"/>".to_owned();
    let dots = dot(10, 0.15) + &dot(20, 0.4) + &dot(30, 1.0);
    let start = (start, 20.0, "start".to_owned());
    [start].into_iter().chain(waypoint_mark(scene)).chain([goal_mark(scene), (dots, 40.0, every)]).collect()
}

/// Returns the SVG elements of goals, starts, paths and robots of a still picture. The animated picture also contains
/// them, for viewers who prefer reduced motion.
pub fn drawn(scene: &Scene, view: &View) -> String {
    let stage = &scene.stage;
    let last = &scene.frames[scene.frames.len() - 1];
    let mut text = movers::paths(view, stage) + &goals(view, scene, true, |_| String::new());
    for (robot, at) in scene.frames[0].at.iter().enumerate() {
        let start = view.circle("start", *at, stage.radius_m, " stroke-width=\"2\"");
        let _ = writeln!(text, "<g class=\"c{}\">{start}</g>", robot % COLOURS);
    }
    let between = between(scene.length());
    let mut moments: Vec<&SceneFrame> = Vec::new();
    for frame in &scene.frames[1..] {
        let due = between.as_nanos() * (moments.len() as u64 + 1);
        if frame.time.as_nanos() >= due && frame.time.as_nanos() + between.as_nanos() / 2 < last.time.as_nanos() {
            moments.push(frame);
        }
    }
    let faded = |index: usize| {
        let opacity = FAINT + (STRONG - FAINT) * (index + 1) as f32 / moments.len() as f32;
        format!(" opacity=\"{opacity:.2}\"")
    };
    for (index, moment) in moments.iter().enumerate() {
        text += &movers::standing(view, stage, moment.time, &faded(index)).concat();
    }
    text += &movers::standing(view, stage, last.time, "").concat();
    for robot in 0..scene.robots() {
        let _ = write!(text, "<g class=\"c{}\">{}", robot % COLOURS, path(scene, view, robot));
        for (index, moment) in moments.iter().enumerate() {
            let rest = faded(index);
            // A robot that waits at its goal is drawn there only once.
            if (moment.at[robot] - last.at[robot]).norm() > stage.radius_m * 0.5 {
                text += &view.circle("dot", moment.at[robot], stage.radius_m, &rest);
            }
        }
        text += "</g>\n";
    }
    for (robot, at) in last.at.iter().enumerate() {
        let disc = view.circle("disc", *at, stage.radius_m, " stroke-width=\"2\"");
        let (at, size) = (view.at(*at), px(view.number(stage, robot)));
        let (x, y) = (px(at.x), px(at.y));
        let number = format!("<text class=\"number\" x=\"{x}\" y=\"{y}\" style=\"font-size:{size}px\">{robot}</text>");
        let _ = writeln!(text, "<g class=\"c{}\">{disc}{number}</g>", robot % COLOURS);
    }
    for ring in &scene.ending.rings {
        text += &view.circle("ring", ring.at, ring.radius_m, " stroke-width=\"4\"");
    }
    text
}

/// Returns an SVG polyline with the path of `robot` in the whole episode.
pub fn path(scene: &Scene, view: &View, robot: usize) -> String {
    let mut points: Vec<String> = Vec::new();
    for frame in &scene.frames {
        let at = view.at(frame.at[robot]);
        let point = format!("{},{}", px(at.x), px(at.y));
        if points.last() != Some(&point) {
            points.push(point);
        }
    }
    format!("<polyline class=\"trail\" stroke-width=\"2.5\" opacity=\".65\" points=\"{}\"/>", points.join(" "))
}

/// Returns the interval between two moments at which robots are drawn, for an episode of this length.
fn between(length: Span) -> Span {
    let fits = |ms: &&u64| length.as_nanos() / (**ms * 1_000_000) <= MOMENTS;
    Span::from_millis(*BETWEEN_MS.iter().find(fits).unwrap_or(&BETWEEN_MS[BETWEEN_MS.len() - 1]))
}
