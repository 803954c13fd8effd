//! Starts and goals of a task file's episodes: which area or place each robot has, from episode to episode.
//!
//! Placement 0 has the starts of episode 0, and placement `n` the goals of episode `n - 1`, which are the starts of
//! episode `n`.

use rand::RngExt;
use rand::seq::SliceRandom;

use super::areas::{Area, least_m};
use super::fields::Fields;
use super::shapes::Shape;
use crate::config::ConfigError;
use crate::config::shown::counted;
use crate::messages::geometry::Vec2;
use crate::random::Seed;
use crate::scenario::{Arena, Mover};

/// Distance \[m\] by which a start is farther from its goal than robots arrive at, so that rounding does not decide.
const BEYOND_M: f32 = 1e-3;
/// Number of draws of a placement, before robots may be where they were.
const TRIES: usize = 64;
/// Number of placements that are drawn to see whether robots find other places.
const TRIED: u32 = 8;

/// Rule by which robots get their places.
#[derive(Clone, Debug)]
pub enum Places {
    /// The whole team goes from the first area to the second, and back in the next episode.
    Sides([Area; 2]),
    /// Every robot gets another place of the area in each episode.
    Within(Area),
    /// The robots are shared out among areas, and in each episode every robot goes to another one.
    Exchange(Vec<Area>),
    /// Each robot has one of these places \[m\], world frame, and in each episode gets that of another.
    Fixed(Vec<Vec2>),
}

impl Places {
    /// Returns the places of a task file whose lengths are multiplied by `scale`.
    pub fn of(fields: &Fields, scale: f32) -> Places {
        let area = |shape: &Shape| Area::of(shape, scale);
        match fields {
            Fields { start: Some(start), goal: Some(goal), .. } => Places::Sides([area(start), area(goal)]),
            Fields { area: Some(shape), .. } => Places::Within(area(shape)),
            Fields { exchange: Some(areas), .. } => Places::Exchange(areas.iter().map(area).collect()),
            Fields { places: Some(places), .. } => {
                Places::Fixed(places.iter().map(|place| Vec2::from(*place) * scale).collect())
            }
            _ => unreachable!("the fields have one of these: their check says so"),
        }
    }

    /// Checks that `robots` robots have room in `arena`, and that no start is within `arrival_m` \[m\] of its goal. An
    /// error names the field.
    pub fn check(&self, robots: usize, arena: &Arena, arrival_m: f32) -> Result<(), ConfigError> {
        match self {
            Places::Sides(areas) => {
                for (field, area) in ["start", "goal"].into_iter().zip(areas) {
                    check_area(field, area, robots, arena)?;
                }
                check_apart(("goal", "start"), areas[0].distance(&areas[1]), arrival_m + BEYOND_M)
            }
            Places::Within(area) => {
                check_area("area", area, robots, arena)?;
                let moves = |index| {
                    let [before, after] =
                        [index, index + 1].map(|at| self.placement((robots, arena, arrival_m), 0, at));
                    before.iter().zip(&after).all(|(before, after)| (after - before).norm() > arrival_m)
                };
                if (0..TRIED).all(moves) {
                    return Ok(());
                }
                let why =
                    format!("robots there find no place farther than {arrival_m} m from their own: make it larger");
                Err(ConfigError::field("area", why))
            }
            Places::Exchange(areas) => {
                let field = |at: usize| format!("exchange[{at}]");
                for (at, area) in areas.iter().enumerate() {
                    check_area(&field(at), area, robots.div_ceil(areas.len()), arena)?;
                    for (other, before) in areas[..at].iter().enumerate() {
                        let least = least_m(arena).max(arrival_m + BEYOND_M);
                        check_apart((&field(at), &field(other)), area.distance(before), least)?;
                    }
                }
                Ok(())
            }
            Places::Fixed(places) => {
                let field = |at: usize| format!("places[{at}]");
                for (at, place) in places.iter().enumerate() {
                    if !arena.has_room(*place) {
                        return Err(ConfigError::field(field(at), no_room(arena, *place)));
                    }
                    for (other, before) in places[..at].iter().enumerate() {
                        let least = least_m(arena).max(arrival_m + BEYOND_M);
                        check_apart((&field(at), &field(other)), (place - before).norm(), least)?;
                    }
                }
                Ok(())
            }
        }
    }

    /// Returns the positions \[m\] of `robots` robots in the placement `index` of the run with this seed, world frame.
    /// Robots arrive within `arrival_m` \[m\] of their goals.
    pub fn placement(&self, (robots, arena, arrival_m): (usize, &Arena, f32), seed: u64, index: u32) -> Vec<Vec2> {
        let stream = |what: &str| Seed::of_run(seed).stream(&format!("task-file/{what}/{index}"));
        match self {
            Places::Sides(areas) => areas[index as usize % 2].draw(arena, robots, &mut stream("places")),
            Places::Within(area) => {
                let stream = &mut stream("places");
                if index.is_multiple_of(2) {
                    return area.draw(arena, robots, stream);
                }
                // Those before and after are drawn by themselves, so that each placement can be had without all others.
                let beside = [index - 1, index + 1].map(|even| {
                    let stream = &mut Seed::of_run(seed).stream(&format!("task-file/places/{even}"));
                    area.draw(arena, robots, stream)
                });
                let farther = (0..TRIES).find_map(|_| {
                    let drawn = area.draw(arena, robots, stream);
                    exchanged(drawn, &beside, arrival_m + BEYOND_M)
                });
                farther.unwrap_or_else(|| area.draw(arena, robots, stream))
            }
            Places::Exchange(areas) => {
                let (order, shift) = (shuffled(seed, robots), shift(seed, index, areas.len()));
                let mut places = vec![Vec2::zeros(); robots];
                let mut stream = stream("places");
                for (at, area) in areas.iter().enumerate() {
                    let here = order.iter().enumerate().filter(|(turn, _)| (turn + shift) % areas.len() == at);
                    let here: Vec<usize> = here.map(|(_, robot)| *robot).collect();
                    let drawn = area.draw(arena, here.len(), &mut stream);
                    here.into_iter().zip(drawn).for_each(|(robot, place)| places[robot] = place);
                }
                places
            }
            Places::Fixed(all) => {
                let (order, shift) = (shuffled(seed, all.len()), shift(seed, index, all.len()));
                (0..robots).map(|robot| all[order[(robot + shift) % all.len()]]).collect()
            }
        }
    }
}

/// Returns the places in an order in which each robot is at least `least_m` \[m\] from where it is in both placements
/// `beside`; `None` if exchanges of two robots' places lead to none.
fn exchanged(mut places: Vec<Vec2>, beside: &[Vec<Vec2>; 2], least_m: f32) -> Option<Vec<Vec2>> {
    let suits = |robot: usize, place: Vec2| beside.iter().all(|other| (other[robot] - place).norm() >= least_m);
    for robot in 0..places.len() {
        if !suits(robot, places[robot]) {
            let others = (0..places.len()).filter(|other| *other != robot);
            let mut fits = others.filter(|&other| suits(robot, places[other]) && suits(other, places[robot]));
            let other = fits.next()?;
            places.swap(robot, other);
        }
    }
    Some(places)
}

/// Returns the numbers below `count` in an order of the run with this seed.
fn shuffled(seed: u64, count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    order.shuffle(&mut Seed::of_run(seed).stream("task-file/order"));
    order
}

/// Returns the shift of the placement `index` among `count` areas or places. No two in a row are equal: those of even
/// placements are in the lower half of the range, and those of odd ones in the upper.
fn shift(seed: u64, index: u32, count: usize) -> usize {
    let half = count / 2;
    let mut stream = Seed::of_run(seed).stream(&format!("task-file/shift/{index}"));
    stream.random_range(if index.is_multiple_of(2) { 0..half } else { half..count })
}

fn check_area(field: &str, area: &Area, robots: usize, arena: &Arena) -> Result<(), ConfigError> {
    let points = area.points();
    if let Some(at) = points.iter().position(|point| !arena.has_room(*point)) {
        return Err(ConfigError::field(format!("{field}.points[{at}]"), no_room(arena, points[at])));
    }
    for (at, point) in points.iter().enumerate() {
        let near = points[..at].iter().position(|other| (other - point).norm() < least_m(arena));
        if let Some(other) = near {
            let why = format!("robots there and at points[{other}] overlap: they need {:.3} m", least_m(arena));
            return Err(ConfigError::field(format!("{field}.points[{at}]"), why));
        }
    }
    let room = area.room(arena, robots);
    if room >= robots {
        return Ok(());
    }
    let why = format!(
        "it has room for {} with a hull of {} m, and {robots} belong there: make it larger, the robots fewer or their \
         hulls smaller",
        counted(room, "robot"),
        arena.hull_m()
    );
    Err(ConfigError::field(field, why))
}

fn check_apart((field, other): (&str, &str), apart_m: f32, least_m: f32) -> Result<(), ConfigError> {
    if apart_m >= least_m {
        return Ok(());
    }
    let why = format!("it is {apart_m:.3} m from {other}, and robots there need {least_m:.3} m");
    Err(ConfigError::field(field, why))
}

fn no_room(arena: &Arena, place: Vec2) -> String {
    let radius_m = arena.robot_radius_m;
    let is_near = |mover: &Mover| mover.ways().iter().any(|way| way.distance(place) <= radius_m);
    if let Some(at) = arena.movers.iter().position(is_near) {
        return format!("no robot may stand there: it keeps {radius_m:.3} m from the way of movers[{at}]");
    }
    format!("no robot fits there: it keeps {radius_m:.3} m from walls, and its centre on the ground")
}
