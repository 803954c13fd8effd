//! Fields of a task file, as they are written, and the ranges of their values.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::movers::{self, MoverFields};
use super::shapes::{FARTHEST_M, MOST_BLOCKS, Obstacles, SMALLEST_M, Shape, check_points, within_count};
use crate::config::{self, ConfigError, in_range};
use crate::messages::geometry::Vec2;
use crate::scenario::{Goals, Weights};

/// Longest text of a task file \[bytes\]; files that people write have a few thousand.
pub const LONGEST: usize = 256 << 10;
/// Longest name of a task \[characters\].
const LONGEST_NAME: usize = 40;
/// Longest description of a task \[characters\].
const LONGEST_ABOUT: usize = 200;
/// Largest number of robots of a team.
const MOST_ROBOTS: usize = 2000;
/// Largest number of waypoints of a robot.
const MOST_WAYPOINTS: usize = 16;
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
    /// Half the size of the ground along x and y \[m\]: largest distance of a robot's centre from the middle. `None`
    /// for a ground that is a polygon.
    pub half_extent_m: Option<[f32; 2]>,
    /// Ground that is a polygon, whose sides are walls.
    pub ground: Option<Shape>,
    /// Radius of a robot's hull \[m\].
    #[serde(default = "paper_hull")]
    pub hull_m: f32,
    /// Walls, which do not move.
    #[serde(default)]
    pub walls: Vec<Shape>,
    /// Obstacles that are drawn.
    #[serde(default)]
    pub obstacles: Vec<Obstacles>,
    /// Obstacles that move along paths.
    #[serde(default)]
    pub movers: Vec<MoverFields>,
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
    /// Areas in which each robot has waypoints, in the order in which it passes them.
    #[serde(default)]
    pub waypoints: Vec<Shape>,
    /// Whether each robot has a goal of its own, or any robot may go to any.
    #[serde(default)]
    pub goals: Goals,
    /// Senses of each robot, by their names: the `kind` of each, and settings that this kind alone reads.
    #[serde(default)]
    pub senses: BTreeMap<String, toml::Table>,
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
        self.check_ground()?;
        in_range("hull_m", self.hull_m, crate::scenario::size::HULLS_M)?;
        self.check_blocks()?;
        movers::check(&self.movers)?;
        self.check_areas()?;
        self.check_senses()?;
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

    /// Checks that each sense has a kind. Which kinds there are the registry knows.
    fn check_senses(&self) -> Result<(), ConfigError> {
        let has_kind = |settings: &toml::Table| settings.get("kind").is_some_and(toml::Value::is_str);
        match self.senses.iter().find(|(_, settings)| !has_kind(settings)) {
            Some((name, _)) => Err(ConfigError::field(format!("senses.{name}.kind"), "it is missing, or no text")),
            None => Ok(()),
        }
    }

    fn check_robots(&self) -> Result<(), ConfigError> {
        let Robots { default, least, most } = self.robots;
        in_range("robots.least", least, (1, MOST_ROBOTS))?;
        in_range("robots.most", most, (least, MOST_ROBOTS))?;
        in_range("robots.default", default, (least, most))
    }

    fn check_ground(&self) -> Result<(), ConfigError> {
        match (self.half_extent_m, &self.ground) {
            (Some(half_extent_m), None) => half_extent_m.into_iter().enumerate().try_for_each(|(axis, half_m)| {
                in_range(&format!("half_extent_m[{axis}]"), half_m, (SMALLEST_M, FARTHEST_M))
            }),
            (None, Some(ground @ Shape::Polygon(_))) => ground.check("ground"),
            (None, Some(_)) => {
                Err(ConfigError::field("ground", "it is a polygon: { polygon = [[x, y], ...] }; else half_extent_m"))
            }
            (Some(_), Some(_)) => {
                Err(ConfigError::field("ground", "there is 'half_extent_m' already: leave one of them out"))
            }
            (None, None) => Err(ConfigError::field("half_extent_m", "it is missing: give it, or a ground")),
        }
    }

    /// Returns the largest distance of a robot's centre from the middle along x and y \[m\].
    pub fn half_extent(&self) -> Vec2 {
        let polygon = self.ground.as_ref().and_then(|ground| ground.polygon(1.0));
        let given = || Vec2::from(self.half_extent_m.expect("it is given without a ground: the check says so"));
        polygon.map_or_else(given, |polygon| polygon.half_extent())
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
            if let Shape::Points(_) = wall {
                return Err(ConfigError::field(field, "a wall is a rect, a disc or a polygon"));
            }
            wall.check(&field)?;
        }
        self.obstacles.iter().enumerate().try_for_each(|(at, of)| of.check(&format!("obstacles[{at}]")))
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
        self.waypoints.iter().enumerate().try_for_each(|(at, area)| area.check(&format!("waypoints[{at}]")))?;
        if self.waypoints.len() > MOST_WAYPOINTS {
            let why = format!("there are {}, more than {MOST_WAYPOINTS}", self.waypoints.len());
            return Err(ConfigError::field("waypoints", why));
        }
        if self.goals.are_unlabelled() && !self.waypoints.is_empty() {
            let why = "a robot passes them before its own goal, and unlabelled goals belong to no robot";
            return Err(ConfigError::field("waypoints", why));
        }
        if self.goals.are_unlabelled() && self.places.is_some() {
            let why = "robots would stand at unlabelled goals before they begin: give start and goal, area or exchange";
            return Err(ConfigError::field("places", why));
        }
        if let Some(places) = &self.places {
            within_count("places", places.len(), self.robots.most.max(2))?;
            check_points("places", places)?;
        }
        Ok(())
    }
}
