//! Fields of a task file, as they are written, and the ranges of their values.

use serde::Deserialize;

use crate::config::{self, ConfigError, in_range};
use crate::scenario::Weights;

/// Longest text of a task file \[bytes\]; files that people write have a few thousand.
pub const LONGEST: usize = 256 << 10;
/// Largest coordinate and length \[m\] in a task file.
const FARTHEST_M: f32 = 1000.0;
/// Smallest side of the ground, of a wall and of an obstacle, and the smallest radius \[m\].
const SMALLEST_M: f32 = 0.001;
/// Longest name of a task \[characters\].
const LONGEST_NAME: usize = 40;
/// Longest description of a task \[characters\].
const LONGEST_ABOUT: usize = 200;
/// Largest number of robots of a team.
const MOST_ROBOTS: usize = 2000;
/// Largest number of walls and obstacles together. Scripted navigation compares all of their corners with each other.
pub const MOST_BLOCKS: usize = 100;
/// Largest number of areas and of points in one of them.
const MOST_AREAS: usize = 2000;
/// Shortest and longest time limit of an episode \[s\].
const LIMITS_S: (f64, f64) = (1.0, 3600.0);
/// Largest weight of a term of the reward.
const LARGEST_WEIGHT: f32 = 1000.0;

/// Content of a task file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fields {
    /// Name of the task: lower-case letters, digits and hyphens.
    pub name: String,
    /// Description in one line.
    #[serde(default)]
    pub about: String,
    /// Team sizes.
    pub robots: Robots,
    /// Half the size of the ground along x and y \[m\]: largest distance of a robot's centre from the middle.
    pub half_extent_m: [f32; 2],
    /// Radius of a robot's hull \[m\].
    #[serde(default = "paper_hull")]
    pub hull_m: f32,
    /// Walls, which do not move.
    #[serde(default)]
    pub walls: Vec<Shape>,
    /// Obstacles that are drawn.
    #[serde(default)]
    pub obstacles: Vec<Obstacles>,
    /// Area in which the team starts, in every second episode.
    pub start: Option<Shape>,
    /// Area to which the team goes, and in which it starts the next episode.
    pub goal: Option<Shape>,
    /// Area in which every robot gets another place in each episode.
    pub area: Option<Shape>,
    /// Areas among which the robots are shared out: in each episode every robot goes to another one.
    pub exchange: Option<Vec<Shape>>,
    /// Places \[m\] of which each robot has one, and in each episode gets that of another.
    pub places: Option<Vec<[f32; 2]>>,
    /// Criteria for success and failure of an episode.
    pub rules: RuleFields,
    /// Weights of the terms of the reward in training, in place of those of a preset.
    #[serde(default)]
    pub reward: Weights,
    /// Success rate, 0 to 1, that scripted navigation must reach.
    #[serde(default = "usual_success")]
    pub scripted_success: f64,
}

/// Team sizes of a task.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Robots {
    /// Team size where none is given.
    pub default: usize,
    /// Smallest team size.
    pub least: usize,
    /// Largest team size.
    pub most: usize,
}

/// Shape of a wall or of an area \[m\], world frame.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    /// Rectangle: smallest x and y, then largest x and y.
    Rect([f32; 4]),
    /// Disc: x and y of its centre, then its radius.
    Disc([f32; 3]),
    /// Formation: points, of which each robot of the team takes one.
    Points(Vec<[f32; 2]>),
}

/// Rectangular obstacles of one size, which are drawn within bounds: once, or for each episode.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Obstacles {
    /// Number of obstacles.
    pub count: usize,
    /// Size along x and y \[m\].
    pub size_m: [f32; 2],
    /// Bounds within which they lie \[m\]: smallest x and y, then largest x and y.
    pub within: [f32; 4],
    /// Seed of the draw. Without `each_episode` the obstacles are the same in every run of the file.
    #[serde(default)]
    pub seed: u32,
    /// Whether they are drawn anew for each episode, from the seed of the run too.
    #[serde(default)]
    pub each_episode: bool,
}

/// Criteria for success and failure of an episode.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RuleFields {
    /// Distance \[m\] from its goal within which a robot has arrived.
    pub arrival_m: f32,
    /// Time within which every robot must arrive \[s\].
    pub limit_s: f64,
    /// Distance of two centres below which robots have collided \[m\]; `None` for two hulls.
    pub separation_m: Option<f32>,
}

fn paper_hull() -> f32 {
    crate::scenario::size::HULL_M
}

fn usual_success() -> f64 {
    0.9
}

impl Fields {
    /// Reads the text of a task file and checks every value by itself. Areas and places may be absent if `are_drawn`,
    /// by other means than the file. An error is one line that names the field.
    pub fn read(text: &str, are_drawn: bool) -> Result<Fields, ConfigError> {
        if text.len() > LONGEST {
            return Err(ConfigError::Syntax(format!("it is longer than {} kB, which no task file is", LONGEST >> 10)));
        }
        let table: toml::Table = config::from_toml(text)?;
        let fields: Fields = config::from_table(&table)?;
        fields.check()?;
        if !are_drawn {
            fields.check_places_given()?;
        }
        Ok(fields)
    }

    fn check(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, why: String| Err(ConfigError::field(field, why));
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if !self.name.starts_with(|c: char| c.is_ascii_lowercase()) || !self.name.chars().all(plain) {
            return wrong(
                "name",
                "it is not of lower-case letters, digits and hyphens, with a letter first".to_owned(),
            );
        }
        if self.name.len() > LONGEST_NAME {
            return wrong("name", format!("it is longer than {LONGEST_NAME} characters"));
        }
        if self.about.chars().any(char::is_control) || self.about.chars().count() > LONGEST_ABOUT {
            return wrong("about", format!("it is not one line of at most {LONGEST_ABOUT} characters"));
        }
        self.check_robots()?;
        for (axis, half_m) in self.half_extent_m.into_iter().enumerate() {
            in_range(&format!("half_extent_m[{axis}]"), half_m, (SMALLEST_M, FARTHEST_M))?;
        }
        in_range("hull_m", self.hull_m, crate::scenario::size::HULLS_M)?;
        self.check_blocks()?;
        self.check_areas()?;
        in_range("rules.arrival_m", self.rules.arrival_m, (SMALLEST_M, FARTHEST_M))?;
        in_range("rules.limit_s", self.rules.limit_s, LIMITS_S)?;
        if let Some(separation_m) = self.rules.separation_m {
            in_range("rules.separation_m", separation_m, (SMALLEST_M, FARTHEST_M))?;
        }
        for (term, weight) in self.reward.given() {
            in_range(&format!("reward.{term}"), weight, (0.0, LARGEST_WEIGHT))?;
        }
        in_range("scripted_success", self.scripted_success, (0.0, 1.0))
    }

    fn check_robots(&self) -> Result<(), ConfigError> {
        let Robots { default, least, most } = self.robots;
        in_range("robots.least", least, (1, MOST_ROBOTS))?;
        in_range("robots.most", most, (least, MOST_ROBOTS))?;
        in_range("robots.default", default, (least, most))
    }

    fn check_blocks(&self) -> Result<(), ConfigError> {
        let drawn = self.obstacles.iter().fold(0usize, |sum, obstacles| sum.saturating_add(obstacles.count));
        if drawn.saturating_add(self.walls.len()) > MOST_BLOCKS {
            let field = if drawn > self.walls.len() { "obstacles" } else { "walls" };
            let why = format!("with both walls and obstacles there are more than {MOST_BLOCKS} of them");
            return Err(ConfigError::field(field, why));
        }
        for (at, wall) in self.walls.iter().enumerate() {
            let field = format!("walls[{at}]");
            match wall {
                Shape::Rect(_) => wall.check(&field)?,
                Shape::Disc(_) | Shape::Points(_) => {
                    return Err(ConfigError::field(field, "a wall is a rectangle: { rect = [x, y, x, y] }"));
                }
            }
        }
        for (at, Obstacles { count, size_m, within: bounds, .. }) in self.obstacles.iter().enumerate() {
            let field = format!("obstacles[{at}]");
            in_range(&format!("{field}.count"), *count, (1, MOST_BLOCKS))?;
            check_rect(&format!("{field}.within"), *bounds)?;
            for axis in 0..2 {
                let room_m = bounds[axis + 2] - bounds[axis];
                in_range(&format!("{field}.size_m[{axis}]"), size_m[axis], (SMALLEST_M, room_m))?;
            }
        }
        Ok(())
    }

    /// Checks that the file says where robots start and go to.
    fn check_places_given(&self) -> Result<(), ConfigError> {
        let any = [self.area.is_some(), self.start.is_some(), self.exchange.is_some(), self.places.is_some()];
        if any.contains(&true) {
            return Ok(());
        }
        Err(ConfigError::field("start", "it is missing: give start and goal, area, exchange, or places"))
    }

    fn check_areas(&self) -> Result<(), ConfigError> {
        let kinds = [
            ("start", self.start.is_some() || self.goal.is_some()),
            ("area", self.area.is_some()),
            ("exchange", self.exchange.is_some()),
            ("places", self.places.is_some()),
        ];
        let given: Vec<&str> = kinds.iter().filter(|(_, given)| *given).map(|(field, _)| *field).collect();
        if let [first, second, ..] = given[..] {
            let why = format!("there is '{first}' already: give start and goal, area, exchange, or places");
            return Err(ConfigError::field(second, why));
        }
        let missing = |field: &str| Err(ConfigError::field(field, "it is missing: start and goal belong together"));
        match (&self.start, &self.goal) {
            (Some(_), None) => missing("goal")?,
            (None, Some(_)) => missing("start")?,
            _ => {}
        }
        for (field, area) in [("start", &self.start), ("goal", &self.goal), ("area", &self.area)] {
            area.iter().try_for_each(|area| area.check(field))?;
        }
        if let Some(areas) = &self.exchange {
            within_count("exchange", areas.len(), 2)?;
            areas.iter().enumerate().try_for_each(|(at, area)| area.check(&format!("exchange[{at}]")))?;
        }
        if let Some(places) = &self.places {
            within_count("places", places.len(), self.robots.most.max(2))?;
            check_points("places", places)?;
        }
        Ok(())
    }
}

impl Shape {
    fn check(&self, field: &str) -> Result<(), ConfigError> {
        match self {
            Shape::Rect(rect) => check_rect(&format!("{field}.rect"), *rect),
            Shape::Disc([x, y, radius_m]) => {
                for (at, coordinate) in [x, y].into_iter().enumerate() {
                    in_range(&format!("{field}.disc[{at}]"), *coordinate, (-FARTHEST_M, FARTHEST_M))?;
                }
                in_range(&format!("{field}.disc[2]"), *radius_m, (SMALLEST_M, FARTHEST_M))
            }
            Shape::Points(points) => {
                within_count(&format!("{field}.points"), points.len(), 1)?;
                check_points(&format!("{field}.points"), points)
            }
        }
    }
}

fn check_points(field: &str, points: &[[f32; 2]]) -> Result<(), ConfigError> {
    for (at, point) in points.iter().enumerate() {
        for (axis, coordinate) in point.iter().enumerate() {
            in_range(&format!("{field}[{at}][{axis}]"), *coordinate, (-FARTHEST_M, FARTHEST_M))?;
        }
    }
    Ok(())
}

fn check_rect(field: &str, rect: [f32; 4]) -> Result<(), ConfigError> {
    for (at, coordinate) in rect.into_iter().enumerate() {
        in_range(&format!("{field}[{at}]"), coordinate, (-FARTHEST_M, FARTHEST_M))?;
    }
    for (axis, name) in ["x", "y"].into_iter().enumerate() {
        if rect[axis + 2] - rect[axis] < SMALLEST_M {
            let why = format!("the smallest {name} comes first and the largest two after it: [x, y, x, y]");
            return Err(ConfigError::field(format!("{field}[{axis}]"), why));
        }
    }
    Ok(())
}

fn within_count(field: &str, count: usize, least: usize) -> Result<(), ConfigError> {
    if (least..=MOST_AREAS).contains(&count) {
        return Ok(());
    }
    Err(ConfigError::field(field, format!("there are {count}, which is not {least} to {MOST_AREAS}")))
}
