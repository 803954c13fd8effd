//! Common parts of the still and the animated SVG picture of an episode: sheet, ground with walls and goals, legend,
//! and projection from the world to the sheet.

use std::fmt::Write as _;

use super::scene::{Backdrop, Scene};
use murmurate::messages::geometry::{Task, Vec2};
use murmurate::scenario::course::Course;
use murmurate::scenario::{KeepOut, Solid};

/// CSS style sheet of the pictures of episodes: colours of light and dark schemes, of robots (Okabe and Ito, which
/// colour-blind readers can distinguish) and of links between robots by the age of the message. The HTML page that
/// plays an episode also uses it.
pub const LOOK: &str = include_str!("look.css");
/// Number of different robot colours in pictures of episodes: robot `i` has colour `i % COLOURS`. The number drawn on
/// each robot distinguishes robots of the same colour.
pub const COLOURS: usize = 8;
/// Colour of goals that belong to no robot: grey.
const UNLABELLED: usize = 7;
/// SVG opacities of the lines that connect a robot with the sender of a message that it uses: one for each of five
/// classes of the message's age, from the newest to the oldest. `LOOK` has the same opacities.
pub const AGES: [&str; 5] = ["1", ".7", ".46", ".28", ".16"];

/// Margin left and right of the drawn ground \[pixels\].
const MARGIN: f32 = 24.0;
/// Height of the space above the drawn ground, for the title and the verdict \[pixels\].
const HEAD: f32 = 88.0;
/// Height of the space below the drawn ground, for the legend and the caption \[pixels\].
const FOOT: f32 = 88.0;
/// Largest width and height of the drawn ground \[pixels\].
const LARGEST: Vec2 = Vec2::new(1000.0, 640.0);
/// Smallest width of the sheet, for its text \[pixels\].
const NARROWEST: f32 = 860.0;

/// Assumed width of a letter in the legend \[pixels\]; the true width depends on the viewer's font.
const LETTER: f32 = 9.8;
/// Radius of the dot of a waypoint \[pixels\].
const DOT_PX: f32 = 4.0;

/// Replaces the characters of a text that XML reserves by their entities.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Formats a length in pixels with at most one decimal.
pub fn px(number: f32) -> String {
    let text = format!("{number:.1}");
    let text = text.strip_suffix(".0").unwrap_or(&text);
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Returns half the size of the drawn ground \[m\]. It exceeds the arena by the hull's radius, as centres stay within
/// the arena.
fn half(stage: &Backdrop) -> Vec2 {
    stage.arena.half_extent + Vec2::repeat(stage.radius_m)
}

/// Returns the walls of the arena. A rectangle at the edge of the arena is extended to the edge of the drawn ground, as
/// no robot can get behind it.
pub fn walls(stage: &Backdrop) -> Vec<Solid> {
    let (inner, outer) = (stage.arena.half_extent, half(stage));
    let to = |at: f32, inner: f32, outer: f32| if at.abs() >= inner - 1e-3 { outer.copysign(at) } else { at };
    let reaching = |block: &KeepOut| match block.solid() {
        Solid::Rect([x, y, far_x, far_y]) => {
            let [x, far_x] = [x, far_x].map(|at| to(at, inner.x, outer.x));
            let [y, far_y] = [y, far_y].map(|at| to(at, inner.y, outer.y));
            Solid::Rect([x, y, far_x, far_y])
        }
        other => other,
    };
    stage.arena.keep_outs.iter().map(reaching).collect()
}

/// Projection of the world frame \[m\] onto the drawing area of an SVG picture \[pixels\].
pub struct View {
    /// Scale of the picture \[pixels/m\].
    pub scale: f32,
    /// Width and height of the drawing area \[pixels\].
    pub size: Vec2,
    half: Vec2,
    turned: bool,
    corner: Vec2,
}

impl View {
    /// Returns the projection for the arena of `stage`. An arena that is deeper than wide is rotated clockwise by a
    /// right angle.
    pub fn new(stage: &Backdrop) -> View {
        let half = half(stage);
        let turned = half.y > half.x;
        let ground = if turned { Vec2::new(half.y, half.x) } else { half } * 2.0;
        let scale = (LARGEST.x / ground.x).min(LARGEST.y / ground.y);
        let drawn = ground * scale;
        let width = (drawn.x + 2.0 * MARGIN).max(NARROWEST);
        let size = Vec2::new(width, drawn.y + HEAD + FOOT);
        View { scale, size, half, turned, corner: Vec2::new((width - drawn.x) / 2.0, HEAD) }
    }

    /// Returns the position \[pixels\] in the picture of a point of the world frame \[m\].
    pub fn at(&self, point: Vec2) -> Vec2 {
        let along = if self.turned {
            Vec2::new(self.half.y + point.y, self.half.x + point.x)
        } else {
            Vec2::new(self.half.x + point.x, self.half.y - point.y)
        };
        self.corner + along * self.scale
    }

    /// Returns an SVG rectangle between two opposite corners in the world frame \[m\], with the CSS class `class`.
    /// `round` is the radius of its rounded corners \[pixels\]; `rest` holds further attributes of the element.
    fn rectangle(&self, class: &str, [one, other]: [Vec2; 2], (round, rest): (f32, &str)) -> String {
        let (a, b) = (self.at(one), self.at(other));
        let (low, high) = (a.inf(&b), a.sup(&b));
        let [x, y, w, h] = [low.x, low.y, high.x - low.x, high.y - low.y].map(px);
        format!("<rect class=\"{class}\" x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" rx=\"{round}\"{rest}/>\n")
    }

    /// Returns the SVG elements of the arena's ground and walls.
    pub fn ground(&self, stage: &Backdrop) -> String {
        let walls = walls(stage);
        let walls = walls.iter().map(|wall| self.solid("wall", wall, ""));
        self.rectangle("ground", [-self.half, self.half], (6.0, "")) + &walls.collect::<String>()
    }

    /// Returns the SVG element of a shape, with the CSS class `class`; `rest` holds further attributes of the element.
    pub fn solid(&self, class: &str, solid: &Solid, rest: &str) -> String {
        match solid {
            Solid::Rect([x, y, far_x, far_y]) => {
                self.rectangle(class, [Vec2::new(*x, *y), Vec2::new(*far_x, *far_y)], (3.0, rest))
            }
            Solid::Disc { disc: [x, y, radius_m] } => self.circle(class, Vec2::new(*x, *y), *radius_m, rest) + "\n",
            Solid::Polygon { polygon } => {
                let corners = polygon.iter().map(|corner| self.at(Vec2::from(*corner)));
                let corners: Vec<String> = corners.map(|at| format!("{},{}", px(at.x), px(at.y))).collect();
                format!("<polygon class=\"{class}\" points=\"{}\"{rest}/>\n", corners.join(" "))
            }
        }
    }

    /// Returns an SVG circle of the radius `radius_m` \[m\] around the point `at` \[m\] of the world frame. `class` is
    /// its CSS class; `rest` holds further attributes of the element.
    pub fn circle(&self, class: &str, at: Vec2, radius_m: f32, rest: &str) -> String {
        let at = self.at(at);
        let [x, y, r] = [at.x, at.y, radius_m * self.scale].map(px);
        format!("<circle class=\"{class}\" cx=\"{x}\" cy=\"{y}\" r=\"{r}\"{rest}/>")
    }

    /// Returns the font size \[pixels\] in which the id `robot` is drawn on that robot; ids of two digits are smaller.
    pub fn number(&self, stage: &Backdrop, robot: usize) -> f32 {
        stage.radius_m * self.scale * if robot < 10 { 1.05 } else { 0.9 }
    }
}

/// Returns the whole SVG file of an episode's picture: style sheet, title, caption, ground, the elements `drawn` and
/// `legend`. `more` is CSS that is added to the style sheet.
pub fn sheet(view: &View, scene: &Scene, more: &str, drawn: &str, legend: &str) -> String {
    let [w, h] = [view.size.x, view.size.y].map(px);
    let stage = &scene.stage;
    let (title, caption, below) = (escaped(&stage.title), escaped(&stage.caption), px(view.size.y - 20.0));
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"look\" viewBox=\"0 0 {w} {h}\" role=\"img\">\n\
         <title>{title}: {}</title>\n<style>{LOOK}svg{{background:var(--paper)}}\n\
         text{{fill:var(--ink);font-size:18px}}\n\
         .soft{{fill:var(--soft)}}.number{{fill:var(--on)}}.whose{{fill:var(--soft)}}{more}</style>\n\
         <rect width=\"{w}\" height=\"{h}\" fill=\"var(--paper)\"/>\n\
         <text x=\"{MARGIN}\" y=\"38\" style=\"font-size:26px;font-weight:650\">{title}</text>\n\
         <text class=\"soft\" x=\"{MARGIN}\" y=\"{below}\">{caption}</text>\n",
        escaped(&scene.ending.text)
    );
    let _ = writeln!(text, "{}{drawn}{legend}</svg>", view.ground(stage));
    text
}

/// Returns the SVG text of the verdict on the episode, which is placed above the ground. `rest` is SVG that is added
/// inside the text element.
pub fn verdict(scene: &Scene, rest: &str) -> String {
    let colour = if scene.ending.success { "good" } else { "bad" };
    let (y, text) = (px(HEAD - 24.0), escaped(&scene.ending.text));
    let style = format!("style=\"fill:var(--{colour});font-weight:650\"");
    format!("<text x=\"{MARGIN}\" y=\"{y}\" {style}>{text}{rest}</text>\n")
}

/// Returns the SVG elements of the legend under the ground. Each entry is a mark (SVG, drawn to the right of the point
/// (0, 0)), the width of the mark \[pixels\] and its meaning.
pub fn legend(view: &View, marks: &[(String, f32, String)]) -> String {
    let (mut x, y) = (MARGIN, px(view.size.y - FOOT + 27.0));
    let mut text = String::new();
    for (mark, width, means) in marks {
        let (at, right, means) = (px(x), px(width + 8.0), escaped(means));
        let _ = writeln!(
            text,
            "<g transform=\"translate({at},{y})\">{mark}<text class=\"soft\" x=\"{right}\" y=\"6\">{means}</text></g>"
        );
        x += width + 8.0 + LETTER * means.chars().count() as f32 + 26.0;
    }
    text
}

/// Returns the SVG elements of the goals: each a circle with its robot's id, or grey and without one if goals are
/// unlabelled. If `stay` is true, the id is left out where the robot covers its goal at the end of the episode. `more`
/// returns, for a robot, SVG to add inside its goal's circle.
pub fn goals(view: &View, scene: &Scene, stay: bool, more: impl Fn(usize) -> String) -> String {
    let (mut text, stage) = (String::new(), &scene.stage);
    if stage.cost.is_some() {
        return text;
    }
    for (robot, task) in stage.tasks.iter().enumerate() {
        let ring =
            view.circle("goal", task.goal, stage.rules.arrival_m, " stroke-width=\"2\" stroke-dasharray=\"5 4\"");
        let ring = ring.replace("/>", &format!(">{}</circle>", more(robot)));
        let (at, size) = (view.at(task.goal), px(stage.rules.arrival_m * view.scale * 0.62));
        let (x, y) = (px(at.x), px(at.y));
        let whose = format!("<text class=\"whose\" x=\"{x}\" y=\"{y}\" style=\"font-size:{size}px\">{robot}</text>");
        let covered = (task.goal - scene.frames[scene.frames.len() - 1].at[robot]).norm() < 2.0 * stage.radius_m;
        let unlabelled = stage.goals.are_unlabelled();
        let whose = if stay && covered || unlabelled { "" } else { &whose };
        let colour = if unlabelled { UNLABELLED } else { robot % COLOURS };
        let course = course(view, task, &stage.courses[robot]);
        let _ = writeln!(text, "<g class=\"c{colour}\">{course}{ring}{whose}</g>");
    }
    text
}

/// Returns the SVG element of a robot's course: a dotted line from its start through its waypoints to its goal; nothing
/// without waypoints.
fn course(view: &View, task: &Task, course: &Course) -> String {
    if course.waypoints().is_empty() {
        return String::new();
    }
    let points = [task.start].into_iter().chain(course.waypoints().iter().copied()).chain([task.goal]);
    let points: Vec<String> = points.map(|at| view.at(at)).map(|at| format!("{} {}", px(at.x), px(at.y))).collect();
    let dots = course.waypoints().iter().map(|at| view.circle("dot", *at, DOT_PX / view.scale, "")).collect::<String>();
    format!(
        "<path class=\"goal\" d=\"M{}\" stroke-width=\"2\" stroke-dasharray=\"1 6\" stroke-opacity=\"0.7\"/>{dots}",
        points.join("L")
    )
}

/// Returns the legend's entry for waypoints: its mark (SVG), the width of the mark \[pixels\] and its text; `None`
/// where robots have none.
pub fn waypoint_mark(scene: &Scene) -> Option<(String, f32, String)> {
    let has_some = scene.stage.courses.iter().any(|course| !course.waypoints().is_empty());
    has_some.then(|| (format!("<circle class=\"dot c7\" cx=\"5\" r=\"{DOT_PX}\"/>"), 10.0, "waypoint".to_owned()))
}

/// Returns the legend's entry for goals: its mark (SVG), the width of the mark \[pixels\] and its text.
pub fn goal_mark(scene: &Scene) -> (String, f32, String) {
    let mark = "<circle class=\"goal c7\" cx=\"10\" r=\"9\" stroke-width=\"2\" stroke-dasharray=\"5 4\"/>".to_owned();
    let any = if scene.stage.goals.are_unlabelled() { " of any robot" } else { "" };
    match scene.stage.cost {
        Some(_) => (String::new(), 0.0, "no goals".to_owned()),
        None => (mark, 20.0, format!("goal{any}, to within {} m", scene.stage.rules.arrival_m)),
    }
}
