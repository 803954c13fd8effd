//! Tasks as data: a scenario that is made from the text of a task file (TOML), without Rust.
//!
//! `fields` and `shapes` have what may be written, `areas`, `places` and `waypoints` the starts, the goals and what is
//! passed between them, `movers` the obstacles that move, `doors` the bottlenecks that it finds, `ways` the lengths of
//! paths, `behaviour` what a caller adds to a file, `built_in` the files that need no reading. A file is read where the
//! program reads files; this code gets its text.

mod areas;
mod behaviour;
mod built_in;
mod doors;
mod fields;
mod movers;
mod places;
mod shapes;
mod waypoints;
mod ways;

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

pub use behaviour::{Behaviour, EpisodeStep};
pub use built_in::BUILT_IN;
use rand::RngExt;

use self::areas::least_m;
use self::fields::Fields;
use self::movers::MoverFields;
use self::places::Places;
use self::shapes::{MOST_BLOCKS, Obstacles, Shape};
use self::waypoints::Waypoints;
use self::ways::Ways;
use super::arena::Arena;
use super::block::KeepOut;
use super::size::Size;
use super::{Goals, Mover, Rules, Scenario, ScenarioError, Settings, TeamSizes, Weights, goals};
use crate::config::ConfigError;
use crate::messages::geometry::{Task, Vec2};
use crate::observation::{Channel, PolicyFrame};
use crate::random::{Seed, Stream};
use crate::time::Span;

/// End of a name that is the path of a task file.
pub const ENDING: &str = ".toml";
/// Number of draws of each obstacle, before there is no room for it.
const TRIES: usize = 1000;
/// Number of episodes for which obstacles are drawn to see whether there is room for them.
const TRIED: u32 = 8;
/// Free ground between a drawn obstacle and other blocks, in radii of the robots: that of a door.
const FREE: f32 = 2.5;

/// Task as data: the content of a task file, which was checked by itself. A scenario is made from it for a team size.
#[derive(Clone, Debug)]
pub struct TaskFile {
    text: Arc<str>,
    fields: Arc<Fields>,
    behaviour: Option<Arc<dyn Behaviour>>,
}

/// Scenario that was made from a task file.
#[derive(Debug)]
struct FromFile {
    file: TaskFile,
    robots: usize,
    /// Factor on the lengths in the file.
    scale: f32,
    arena: Arena,
    /// Rule by which robots get their places; `None` if the behaviour of the task draws them.
    places: Option<Places>,
    waypoints: Waypoints,
    rules: Rules,
    /// Ways through the arena, which training alone needs.
    ways: OnceLock<Ways>,
}

/// Returns whether a name of a scenario is the path of a task file: it ends with `.toml`.
pub fn is_task_file(name: &str) -> bool {
    name.ends_with(ENDING)
}

impl TaskFile {
    /// Reads the text of a task file. An error is one line that names the field.
    pub fn read(text: &str) -> Result<TaskFile, ConfigError> {
        Ok(TaskFile { fields: Arc::new(Fields::read(text, false)?), text: text.into(), behaviour: None })
    }

    /// Reads the text of a task file whose task has the `behaviour` besides. If that draws the layouts, the text may be
    /// without areas and places. An error is one line that names the field.
    pub fn with_behaviour(text: &str, behaviour: Arc<dyn Behaviour>) -> Result<TaskFile, ConfigError> {
        let fields = Arc::new(Fields::read(text, behaviour.draws())?);
        if !fields.waypoints.is_empty() {
            return Err(ConfigError::field("waypoints", "a task with a behaviour of its own has none: leave them out"));
        }
        Ok(TaskFile { fields, text: text.into(), behaviour: Some(behaviour) })
    }

    /// Returns the behaviour of the task beyond its file; `None` if it has none.
    pub fn behaviour(&self) -> Option<&Arc<dyn Behaviour>> {
        self.behaviour.as_ref()
    }

    /// Returns whether the behaviour of the task draws the layouts of episodes, which then do not chain.
    pub fn draws_apart(&self) -> bool {
        self.behaviour.as_ref().is_some_and(|behaviour| behaviour.draws())
    }

    /// Returns the name of the task.
    pub fn name(&self) -> &str {
        &self.fields.name
    }

    /// Returns the description of the task in one line; empty if it has none.
    pub fn about(&self) -> &str {
        &self.fields.about
    }

    /// Returns the radius \[m\] of a robot's hull where none is set.
    pub fn hull_m(&self) -> f32 {
        self.fields.hull_m
    }

    /// Returns the senses of each robot, by their names: the `kind` of each, and settings that this kind alone reads.
    pub fn senses(&self) -> &BTreeMap<String, toml::Table> {
        &self.fields.senses
    }

    /// Returns the text of the file.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Returns a digest of the text of the file: 16 hexadecimal digits.
    pub fn digest(&self) -> String {
        blake3::hash(self.text.as_bytes()).to_hex()[..16].to_owned()
    }

    /// Returns a number by which unequal task files are told apart: the beginning of the digest. Never 0.
    pub fn mark(&self) -> u32 {
        let [a, b, c, d, ..] = *blake3::hash(self.text.as_bytes()).as_bytes();
        u32::from_be_bytes([a, b, c, d]).max(1)
    }

    /// Returns the smallest and the largest number of robots of a team.
    pub fn team_sizes(&self) -> TeamSizes {
        TeamSizes::new(self.fields.robots.least, self.fields.robots.most)
    }

    /// Makes the scenario with a user's `settings`. An error names the setting that the task does not support, or the
    /// field of the file that cannot be.
    pub fn scenario(&self, settings: &Settings) -> Result<Arc<dyn Scenario>, ScenarioError> {
        let name = self.name();
        let robots = self.team_sizes().check(name, settings.robots.unwrap_or(self.fields.robots.default))?;
        if let Some(gap_m) = settings.gap_m {
            let hint = "; the walls of a task file are as wide apart as it says";
            return Err(ScenarioError::Gap { scenario: name.to_owned(), gap_m, hint });
        }
        let hull_m = settings.hull_m.unwrap_or(self.fields.hull_m);
        let size = Size::of(name, &Settings { hull_m: Some(hull_m), ..*settings })?;
        self.check_one_size(size).map_err(|(field, why)| ScenarioError::Size {
            scenario: name.to_owned(),
            field,
            why: why.to_owned(),
        })?;
        let separation_m = self.fields.rules.separation_m;
        if separation_m.is_some() && hull_m != self.fields.hull_m {
            let why = "says rules.separation_m, which is for the hull in its file: leave one of them out".to_owned();
            return Err(ScenarioError::Size { scenario: name.to_owned(), field: "hull_m", why });
        }
        let wrong = |error| ScenarioError::TaskFile { scenario: name.to_owned(), error };
        let arena = self.arena(size).map_err(wrong)?;
        let limit = Span::from_secs(self.fields.rules.limit_s * f64::from(size.scale.max(1.0)));
        let rules = Rules {
            arrival_m: size.length(self.fields.rules.arrival_m),
            separation_m: separation_m.unwrap_or(size.separation_m()),
            limit,
        };
        let places = (!self.draws_apart()).then(|| Places::of(&self.fields, size.scale));
        places.iter().try_for_each(|places| places.check(robots, &arena, rules.arrival_m)).map_err(wrong)?;
        let (file, scale, ways) = (self.clone(), size.scale, OnceLock::new());
        let waypoints = Waypoints::of(&self.fields, size.scale);
        let scenario = FromFile { file, robots, scale, arena, places, waypoints, rules, ways };
        scenario.waypoints.check(&scenario.arena, |episode| scenario.tasks(0, episode)).map_err(wrong)?;
        scenario.check_obstacles().map_err(wrong)?;
        Ok(Arc::new(scenario))
    }

    /// Checks that the size is that of the file, if a behaviour draws places that do not follow it. An error has the
    /// setting and why it is wrong.
    fn check_one_size(&self, size: Size) -> Result<(), (&'static str, &'static str)> {
        match self.draws_apart() {
            true if size.scale != 1.0 => Err(("scale", "draws its own places, which have one scale: leave it out")),
            true if size.hull_m != self.fields.hull_m => {
                Err(("hull_m", "draws its own places, for robots of one hull: leave it out, or set it in the task"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the ground with its walls, the obstacles that are drawn, and the doors between them.
    fn arena(&self, size: Size) -> Result<Arena, ConfigError> {
        let (half_extent, robot_radius_m) = (self.fields.half_extent() * size.scale, size.robot_radius_m());
        let mut keep_outs: Vec<KeepOut> = self.fields.walls.iter().flat_map(|wall| wall.blocks(size.scale)).collect();
        if let Some(ground) = self.fields.ground.as_ref().and_then(|ground| ground.polygon(size.scale)) {
            // As far as robots reach whose centres stay on the ground.
            keep_outs.extend(ground.outside(half_extent.add_scalar(robot_radius_m)));
        }
        let drawn: usize = self.fields.obstacles.iter().map(|obstacles| obstacles.count).sum();
        if keep_outs.len() + drawn > MOST_BLOCKS {
            let field = if self.fields.ground.is_some() { "ground" } else { "walls" };
            let why =
                format!("with the parts of polygons that are not convex there are more than {MOST_BLOCKS} blocks");
            return Err(ConfigError::field(field, why));
        }
        let movers = self.fields.movers.iter().map(|mover| mover.mover(size.scale)).collect();
        let mut arena = Arena { movers, ..Arena::new(half_extent, keep_outs, robot_radius_m) };
        movers::check_ways(&arena, &self.fields.walls, size.scale)?;
        let given: Vec<Vec2> = self.points().into_iter().map(|point| point * size.scale).collect();
        for (at, obstacles) in self.drawn(false) {
            let stream = Seed::of_run(u64::from(obstacles.seed)).stream(&format!("task-file/obstacles/{at}"));
            let drawn = draw(&mut arena, (obstacles, stream), size.scale, &given);
            if drawn < obstacles.count {
                return Err(ConfigError::field(format!("obstacles[{at}]"), no_room(obstacles)));
            }
        }
        arena.portals = doors::portals(&arena);
        Ok(arena)
    }

    /// Returns the obstacles that are drawn for each episode, or those that are drawn once, each with its place in the
    /// file.
    fn drawn(&self, each_episode: bool) -> impl Iterator<Item = (usize, &Obstacles)> {
        self.fields.obstacles.iter().enumerate().filter(move |(_, obstacles)| obstacles.each_episode == each_episode)
    }

    /// Returns the places that the file gives one by one \[m\].
    fn points(&self) -> Vec<Vec2> {
        let Fields { start, goal, area, exchange, places, waypoints, .. } = &*self.fields;
        let shapes = start.iter().chain(goal).chain(area).chain(exchange.iter().flatten()).chain(waypoints);
        let points = shapes.filter_map(|shape| match shape {
            Shape::Points(points) => Some(points),
            Shape::Rect(_) | Shape::Disc(_) | Shape::Polygon(_) => None,
        });
        points.chain(places).flatten().map(|point| Vec2::from(*point)).collect()
    }
}

fn no_room(obstacles: &Obstacles) -> String {
    format!("there is no room for {} of them between what else there is: take fewer or smaller ones", obstacles.count)
}

/// Adds obstacles to an arena, with free ground between them and around the places that are given. Returns their
/// number, which is smaller than that in the file where there is no room for more.
fn draw(arena: &mut Arena, (obstacles, mut stream): (&Obstacles, Stream), scale: f32, places: &[Vec2]) -> usize {
    let [low, far] = [[0, 1], [2, 3]].map(|axes| Vec2::from(axes.map(|axis| obstacles.within[axis])) * scale);
    let obstacle = obstacles.block(scale);
    let room = (far - low - (obstacle.max - obstacle.min)).sup(&Vec2::zeros());
    for drawn in 0..obstacles.count {
        let block = (0..TRIES).find_map(|_| {
            let share = Vec2::new(stream.random_range(0.0..=1.0), stream.random_range(0.0..=1.0));
            let block = obstacle.moved(low + room.component_mul(&share) - obstacle.min);
            let (others, mut ways) = (&arena.keep_outs, arena.movers.iter().flat_map(Mover::ways));
            let is_free = others.iter().all(|other| other.apart_m(&block) >= FREE * arena.robot_radius_m)
                && ways.all(|way| way.apart_m(&block) >= FREE * arena.robot_radius_m)
                && places.iter().all(|place| block.distance(*place) >= least_m(arena));
            is_free.then_some(block)
        });
        let Some(block) = block else { return drawn };
        arena.keep_outs.push(block);
    }
    obstacles.count
}

impl FromFile {
    /// Refuses obstacles for which many of the first episodes have no room.
    fn check_obstacles(&self) -> Result<(), ConfigError> {
        let Some((at, obstacles)) = self.file.drawn(true).next() else { return Ok(()) };
        let wanted: usize = self.file.drawn(true).map(|(_, obstacles)| obstacles.count).sum();
        let fixed = self.arena.keep_outs.len();
        let is_full =
            |episode| self.drawn_arena(0, episode).is_some_and(|arena| arena.keep_outs.len() == fixed + wanted);
        let full = (0..TRIED).filter(|&episode| is_full(episode)).count();
        if full < TRIED as usize / 2 {
            return Err(ConfigError::field(format!("obstacles[{at}]"), no_room(obstacles)));
        }
        Ok(())
    }
}

impl Scenario for FromFile {
    fn name(&self) -> &str {
        self.file.name()
    }

    fn robots(&self) -> usize {
        self.robots
    }

    fn arena(&self) -> &Arena {
        &self.arena
    }

    fn drawn_arena(&self, seed: u64, episode: u32) -> Option<Arena> {
        let begins_anew = |mover: &MoverFields| mover.each_episode;
        if self.file.drawn(true).next().is_none() && !self.file.fields.movers.iter().any(begins_anew) {
            return None;
        }
        let tasks = self.tasks(seed, episode);
        let mut places: Vec<Vec2> = tasks.iter().flat_map(|task| [task.start, task.goal]).collect();
        places.extend(self.waypoints.draw(&self.arena, &tasks, (seed, episode)).concat());
        let mut arena = self.arena.clone();
        let movers = self.file.fields.movers.iter().zip(&mut arena.movers).enumerate();
        for (at, (_, mover)) in movers.filter(|(_, (fields, _))| begins_anew(fields)) {
            let mut stream = Seed::of_run(seed).stream(&format!("task-file/movers/{at}/{episode}"));
            *mover = mover.at_phase(stream.random_range(0.0..1.0));
        }
        for (at, obstacles) in self.file.drawn(true) {
            let name = format!("task-file/obstacles/{at}/{}/{episode}", obstacles.seed);
            // Where the places of an episode leave no room for all of them, there are fewer.
            draw(&mut arena, (obstacles, Seed::of_run(seed).stream(&name)), self.scale, &places);
        }
        arena.portals = doors::portals(&arena);
        Some(arena)
    }

    fn tasks(&self, seed: u64, episode: u32) -> Vec<Task> {
        let Some(places) = &self.places else {
            let behaviour = self.file.behaviour.as_ref().expect("a task without places has one that draws them");
            return behaviour.tasks(self.robots, seed, episode);
        };
        let team = (self.robots, &self.arena, self.rules.arrival_m);
        let placement = |index| places.placement(team, seed, index);
        let (starts, goals) = (placement(episode), placement(episode + 1));
        starts.into_iter().zip(goals).map(|(start, goal)| Task { start, goal }).collect()
    }

    fn waypoints(&self, seed: u64, episode: u32) -> Vec<Vec<Vec2>> {
        if self.file.fields.waypoints.is_empty() {
            return Vec::new();
        }
        self.waypoints.draw(&self.arena, &self.tasks(seed, episode), (seed, episode))
    }

    fn frame(&self, _: &Task) -> PolicyFrame {
        PolicyFrame::World
    }

    #[inline]
    fn goals(&self) -> Goals {
        self.file.fields.goals
    }

    fn channels(&self) -> Vec<Channel> {
        if !self.goals().are_unlabelled() {
            return Vec::new();
        }
        vec![goals::channel(self.robots), goals::nearest()]
    }

    #[inline]
    fn distance_to_go(&self, task: &Task, position: Vec2) -> f32 {
        self.ways.get_or_init(|| Ways::new(&self.arena)).length_m(position, task.goal)
    }

    fn scripted_success(&self) -> f64 {
        self.file.fields.scripted_success
    }

    #[inline]
    fn rules(&self) -> Rules {
        self.rules
    }

    fn weights(&self) -> Weights {
        self.file.fields.reward
    }

    fn task_file(&self) -> Option<&TaskFile> {
        Some(&self.file)
    }
}
