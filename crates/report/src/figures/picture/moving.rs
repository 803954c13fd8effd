//! Animation of an episode as an SVG file without a script. Viewers that prefer reduced motion show the still picture.

use std::fmt::Write as _;

use super::movers;
use super::scene::{Link, Scene, SceneFrame};
use super::sheet::{AGES, COLOURS, View, goal_mark, goals, legend, px, sheet, verdict, waypoint_mark};
use super::still::{self, drawn, path};
use murmurate::messages::geometry::Vec2;
use murmurate::time::Span;

/// Time for which the last frame is shown before the animation repeats \[s\].
const REST_S: f64 = 2.5;
/// Shortest time between two samples \[s\]. Positions between samples are interpolated linearly.
const LEAST_S: f64 = 0.1;
/// Approximate limit of the size of all samples \[bytes\].
const ROOM: usize = 190_000;
/// Approximate size of a robot's sample, and of a link's sample \[bytes\].
const ROBOT: usize = 24;
const PAIR: usize = 36;
/// Largest number of values that the clock shows.
const READINGS: f64 = 130.0;

/// Episode, sampled for an animation.
struct Reel<'a> {
    scene: &'a Scene<'a>,
    /// Duration of one round of the animation with the pause at its end \[s\].
    lasts_s: f64,
    /// Samples at equal intervals over one round: two successive frames, and the fraction of the way between them.
    samples: Vec<(&'a SceneFrame, &'a SceneFrame, f32)>,
}

impl<'a> Reel<'a> {
    fn new(scene: &'a Scene<'a>) -> Reel<'a> {
        let lasts_s = scene.length().as_secs() + REST_S;
        let each = scene.robots() * ROBOT + scene.pairs().len() * PAIR;
        let count = ((lasts_s / LEAST_S) as usize).min(ROOM / each).max(8);
        let sample = |index: usize| {
            let time_s = lasts_s * index as f64 / count as f64;
            let next = scene.frames.partition_point(|frame| frame.time.as_secs() <= time_s).min(scene.frames.len() - 1);
            let (from, to) = (&scene.frames[next.saturating_sub(1)], &scene.frames[next]);
            let (begins, lasts) = (from.time.as_secs(), to.time.as_secs() - from.time.as_secs());
            let share = if lasts > 0.0 { ((time_s - begins) / lasts).clamp(0.0, 1.0) } else { 1.0 };
            (from, to, share as f32)
        };
        Reel { scene, lasts_s, samples: (0..=count).map(sample).collect() }
    }

    /// Returns a robot's position in each sample.
    fn positions(&self, robot: usize) -> impl Iterator<Item = Vec2> + '_ {
        self.samples.iter().map(move |(from, to, share)| from.at[robot] + (to.at[robot] - from.at[robot]) * *share)
    }

    /// Returns the SVG that animates an attribute through these values at equal intervals. `discrete`: without
    /// interpolation.
    fn follows(&self, attribute: &str, discrete: bool, values: &[String]) -> String {
        if values.iter().all(|value| *value == values[0]) {
            return format!("<set attributeName=\"{attribute}\" to=\"{}\"/>", values[0]);
        }
        let (mode, values) = (if discrete { " calcMode=\"discrete\"" } else { "" }, values.join(";"));
        format!("<animate attributeName=\"{attribute}\"{mode} values=\"{values}\" {}/>", self.round())
    }

    /// Returns the SVG that sets an attribute to these values at these times \[s\].
    fn changes(&self, attribute: &str, values: &[(&str, f64)]) -> String {
        let keys: Vec<String> =
            values.iter().map(|(_, at)| format!("{:.4}", (at / self.lasts_s).clamp(0.0, 1.0))).collect();
        let values: Vec<&str> = values.iter().map(|(value, _)| *value).collect();
        let (keys, values) = (keys.join(";"), values.join(";"));
        let rest = format!("calcMode=\"discrete\" {}", self.round());
        format!("<animate attributeName=\"{attribute}\" values=\"{values}\" keyTimes=\"{keys}\" {rest}/>")
    }

    /// Returns the SVG that moves an element to these places, of the form `x,y` \[pixels\], at equal intervals.
    fn translated(&self, places: &[String]) -> String {
        let values = places.join(";");
        let round = self.round();
        format!("<animateTransform attributeName=\"transform\" type=\"translate\" values=\"{values}\" {round}/>")
    }

    fn round(&self) -> String {
        format!("dur=\"{:.3}s\" repeatCount=\"indefinite\"", self.lasts_s)
    }

    /// Returns the SVG that makes an element visible from this time to the end of a round.
    fn shown_from(&self, at: Span) -> String {
        if at == Span::ZERO {
            return String::new();
        }
        self.changes("visibility", &[("hidden", 0.0), ("visible", at.as_secs())])
    }
}

/// Returns an SVG file that plays the episode as an animation, without a script.
pub fn moving(scene: &Scene) -> String {
    let view = View::new(&scene.stage);
    let reel = Reel::new(scene);
    let mut text =
        format!("<g class=\"still\">{}{}</g>\n<g class=\"moving\">\n", drawn(scene, &view), verdict(scene, ""));
    text += &movers::paths(&view, &scene.stage);
    text += &bodies(&reel, &view);
    text += &aims(&reel, &view);
    for robot in 0..scene.robots() {
        text += &trail(&reel, &view, robot);
    }
    // Lines of a large team are thinner and more transparent.
    let (width, opacity) = if scene.robots() > COLOURS { ("1.3", ".6") } else { ("2.5", "1") };
    let _ = writeln!(text, "<g stroke-width=\"{width}\" opacity=\"{opacity}\">");
    for pair in scene.pairs() {
        text += &link(&reel, &view, pair);
    }
    text += "</g>\n";
    for robot in 0..scene.robots() {
        text += &disc(&reel, &view, robot);
    }
    for ring in &scene.ending.rings {
        let circle = view.circle("ring", ring.at, ring.radius_m, " stroke-width=\"4\"");
        text += &circle.replace("/>", &format!(">{}</circle>\n", reel.shown_from(ring.from)));
    }
    text += &verdict(scene, &reel.shown_from(scene.length()));
    text += &clock(&reel, &view);
    text += "</g>\n";
    let style = ".still{display:none}.clock{font-size:26px}\
                 @media(prefers-reduced-motion:reduce){.still{display:inline}.moving{display:none}}";
    let legends = [("still", still::marks(scene)), ("moving", marks(scene))];
    let legends =
        legends.map(|(class, marks)| format!("<g class=\"{class}\">{}</g>\n", legend(&view, &marks))).concat();
    sheet(&view, scene, style, &text, &legends)
}

/// Returns the legend of the animation: goals, links by age, and one-way links. Without links, as in mode `sim`, where
/// messages are perfect and go nowhere, they are not explained.
fn marks(scene: &Scene) -> Vec<(String, f32, String)> {
    if scene.pairs().is_empty() {
        return waypoint_mark(scene).into_iter().chain([goal_mark(scene)]).collect();
    }
    let line = |(at, strong): (usize, &&str)| {
        format!("<path class=\"link\" d=\"M{} 0h26\" stroke-width=\"3\" stroke-opacity=\"{strong}\"/>", 28 * at)
    };
    let lines = AGES.iter().enumerate().map(line).collect();
    let heard = format!("heard, new to {} s old", scene.stage.window.as_secs());
    let dashed = "<path class=\"link\" d=\"M0 0h30\" stroke-width=\"3\" stroke-dasharray=\"7 6\"/>".to_owned();
    let links = [(lines, 138.0, heard), (dashed, 30.0, "one way".to_owned())];
    waypoint_mark(scene).into_iter().chain([goal_mark(scene)]).chain(links).collect()
}

/// Draws the moving obstacles.
fn bodies(reel: &Reel, view: &View) -> String {
    let stage = &reel.scene.stage;
    let time = |(from, to, share): &(&SceneFrame, &SceneFrame, f32)| {
        let between_s = to.time.as_secs() - from.time.as_secs();
        from.time + Span::from_secs(between_s * f64::from(*share))
    };
    let offsets: Vec<Vec<Vec2>> = reel.samples.iter().map(|sample| movers::offsets(stage, time(sample))).collect();
    let body = |(at, shape): (usize, String)| {
        let moved = offsets.iter().map(|all| view.at(all[at]) - view.at(Vec2::zeros()));
        let moved: Vec<String> = moved.map(|at| format!("{},{}", px(at.x), px(at.y))).collect();
        let moves = reel.translated(&moved);
        format!("<g>{shape}{moves}</g>\n")
    };
    movers::standing(view, stage, Span::ZERO, "").into_iter().enumerate().map(body).collect()
}

/// Draws the goals, whose dashed circles become solid at the arrival of their robots.
fn aims(reel: &Reel, view: &View) -> String {
    let arrivals = reel.scene.arrivals();
    goals(view, reel.scene, false, |robot| {
        let solid = arrivals[robot].map(|at| reel.changes("stroke-dasharray", &[("5 4", 0.0), ("none", at.as_secs())]));
        solid.unwrap_or_default()
    })
}

/// Draws the part of a robot's path up to the present: the whole path, of which a growing dash is visible.
fn trail(reel: &Reel, view: &View, robot: usize) -> String {
    let mut gone = vec![0.0f32];
    for pair in reel.scene.frames.windows(2) {
        let leg = view.at(pair[1].at[robot]) - view.at(pair[0].at[robot]);
        gone.push(gone[gone.len() - 1] + leg.norm());
    }
    let whole = gone[gone.len() - 1] + 1.0;
    let at = |time: Span| reel.scene.frames.partition_point(|frame| frame.time < time);
    let left = |(from, to, share): &(&SceneFrame, &SceneFrame, f32)| {
        let (from, to) = (gone[at(from.time)], gone[at(to.time)]);
        px(whole - from - (to - from) * share)
    };
    let values: Vec<String> = reel.samples.iter().map(left).collect();
    let dash = format!(" stroke-dasharray=\"{0} {0}\"", px(whole));
    let moves = reel.follows("stroke-dashoffset", false, &values);
    let path = path(reel.scene, view, robot).replace("/>", &format!("{dash}>{moves}</polyline>"));
    format!("<g class=\"c{}\">{path}</g>\n", robot % COLOURS)
}

fn link(reel: &Reel, view: &View, (one, other): (usize, usize)) -> String {
    let ends = reel.positions(one).zip(reel.positions(other));
    let line = |(from, to): (Vec2, Vec2)| {
        let (from, to) = (view.at(from), view.at(to));
        let [a, b, c, d] = [from.x, from.y, to.x, to.y].map(|number| px(number.round()));
        format!("M{a} {b}L{c} {d}")
    };
    let lines: Vec<String> = ends.map(line).collect();
    let links = reel.samples.iter().map(|(from, to, share)| {
        let frame = if *share < 1.0 { from } else { to };
        frame.links.iter().find(|link| (link.one, link.other) == (one, other))
    });
    let strong =
        |link: &Option<&Link>| link.map_or("0", |link| AGES[level(link.age, reel.scene.stage.window)]).to_owned();
    let dash = |link: &Option<&Link>| if link.is_some_and(|link| !link.mutual) { "7 6" } else { "0" }.to_owned();
    let links: Vec<Option<&Link>> = links.collect();
    let strengths = reel.follows("stroke-opacity", true, &links.iter().map(strong).collect::<Vec<_>>());
    let dashes = reel.follows("stroke-dasharray", true, &links.iter().map(dash).collect::<Vec<_>>());
    let moves = reel.follows("d", false, &lines);
    format!("<path class=\"link\" d=\"{}\">{moves}{strengths}{dashes}</path>\n", lines[0])
}

/// Returns the index in `AGES` for a link whose message has this age.
fn level(age: Span, window: Span) -> usize {
    let levels = AGES.len() as u64;
    (age.as_nanos() * levels / window.as_nanos().max(1)).min(levels - 1) as usize
}

fn disc(reel: &Reel, view: &View, robot: usize) -> String {
    let stage = &reel.scene.stage;
    let places: Vec<String> = reel
        .positions(robot)
        .map(|at| {
            let at = view.at(at);
            format!("{},{}", px(at.x), px(at.y))
        })
        .collect();
    let moves = reel.translated(&places);
    let (radius, size) = (px(stage.radius_m * view.scale), px(view.number(stage, robot)));
    let disc = format!("<circle class=\"disc\" r=\"{radius}\" stroke-width=\"2\"/>");
    let number = format!("<text class=\"number\" style=\"font-size:{size}px\">{robot}</text>");
    format!("<g class=\"c{}\" transform=\"translate({})\">{disc}{number}{moves}</g>\n", robot % COLOURS, places[0])
}

/// Draws the clock as one text element per value.
fn clock(reel: &Reel, view: &View) -> String {
    let length_s = reel.scene.length().as_secs();
    let step_s =
        [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0].into_iter().find(|step| length_s / step <= READINGS).unwrap_or(60.0);
    let count = (length_s / step_s + 1e-6) as usize;
    let (x, mut text) = (px(view.size.x - 24.0), String::new());
    for index in 0..=count {
        let from = step_s * index as f64;
        let mut values = vec![("visible", from)];
        if index > 0 {
            values.insert(0, ("hidden", 0.0));
        }
        if index < count {
            values.push(("hidden", from + step_s));
        }
        let shown = reel.changes("visibility", &values);
        let _ = writeln!(text, "<text class=\"clock\" x=\"{x}\" y=\"38\">{from:.1} s{shown}</text>");
    }
    format!("<g style=\"text-anchor:end;font-variant-numeric:tabular-nums;font-weight:650\">\n{text}</g>\n")
}
