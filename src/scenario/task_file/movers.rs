//! Moving obstacles of a task file: their fields, the ranges of the values, and where their ways may lead.

use serde::Deserialize;

use super::shapes::{Body, FARTHEST_M, Shape, check_points};
use crate::config::{ConfigError, in_range};
use crate::messages::geometry::{Planar, Vec2};
use crate::scenario::{Arena, KeepOut, Mover};

/// Largest number of moving obstacles.
const MOST_MOVERS: usize = 16;
/// Largest number of points of a path.
const MOST_POINTS: usize = 64;
/// Shortest leg of a path \[m\].
const SHORTEST_M: f32 = 0.01;
/// Least and largest speed \[m/s\]. Robots drive at 1 m/s, and get out of the way of what is slower.
const SPEEDS_M_S: (f32, f32) = (0.01, 1.0);

/// Obstacle that moves along a path while an episode runs.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MoverFields {
    /// Size of a rectangle along x and y \[m\]. Its middle follows the path.
    pub size_m: Option<[f32; 2]>,
    /// Radius of a disc \[m\]. Its middle follows the path.
    pub radius_m: Option<f32>,
    /// Corners of a convex polygon \[m\], counted from the point that follows the path.
    pub polygon: Option<Vec<[f32; 2]>>,
    /// Points of the path \[m\], world frame.
    pub path: Vec<[f32; 2]>,
    /// Speed along the path \[m/s\].
    pub speed_m_s: f32,
    /// Whether the path leads from its last point straight to the first; otherwise it is gone back and forth.
    #[serde(default)]
    pub closed: bool,
    /// Share of a round after which it begins, 0 to 1.
    pub phase: Option<f32>,
    /// Whether that share is drawn for each episode.
    #[serde(default)]
    pub each_episode: bool,
}

impl MoverFields {
    fn check(&self, field: &str) -> Result<(), ConfigError> {
        self.body().check(field, [FARTHEST_M; 2])?;
        in_range(&format!("{field}.speed_m_s"), self.speed_m_s, SPEEDS_M_S)?;
        if let Some(phase) = self.phase {
            in_range(&format!("{field}.phase"), phase, (0.0, 1.0))?;
        }
        if self.phase.is_some() && self.each_episode {
            let why = "each_episode draws it: leave one of them out";
            return Err(ConfigError::field(format!("{field}.phase"), why));
        }
        let field = format!("{field}.path");
        if !(2..=MOST_POINTS).contains(&self.path.len()) {
            let why = format!("there are {} points, which is not 2 to {MOST_POINTS}", self.path.len());
            return Err(ConfigError::field(field, why));
        }
        check_points(&field, &self.path)?;
        let legs = if self.closed { self.path.len() } else { self.path.len() - 1 };
        let point = |at: usize| Vec2::from(self.path[at % self.path.len()]);
        match (0..legs).find(|&at| (point(at + 1) - point(at)).norm() < SHORTEST_M) {
            Some(at) => {
                let why = format!("it is not {SHORTEST_M} m from the next point");
                Err(ConfigError::field(format!("{field}[{at}]"), why))
            }
            None => Ok(()),
        }
    }

    fn body(&self) -> Body<'_> {
        Body { size_m: self.size_m, radius_m: self.radius_m, polygon: self.polygon.as_deref() }
    }

    /// Returns the mover, with lengths multiplied by `scale`; its speed is that of the file.
    pub fn mover(&self, scale: f32) -> Mover {
        let body = self.body().block(scale);
        let middle = (body.min + body.max) / 2.0;
        let body = if self.polygon.is_some() { body } else { body.moved(-middle) };
        let path: Vec<Vec2> = self.path.iter().map(|point| Vec2::from(*point) * scale).collect();
        Mover::new(body, &path, self.closed, self.speed_m_s, self.phase.unwrap_or(0.0))
    }
}

/// Checks the values of the moving obstacles by themselves. An error names the wrong one.
pub fn check(movers: &[MoverFields]) -> Result<(), ConfigError> {
    if movers.len() > MOST_MOVERS {
        return Err(ConfigError::field("movers", format!("there are {}, more than {MOST_MOVERS}", movers.len())));
    }
    movers.iter().enumerate().try_for_each(|(at, mover)| mover.check(&format!("movers[{at}]")))
}

/// Checks that the moving obstacles of an arena stay on its ground, and meet neither its blocks nor the `walls` of the
/// file, whose lengths are multiplied by `scale`. An error names the path.
pub fn check_ways(arena: &Arena, walls: &[Shape], scale: f32) -> Result<(), ConfigError> {
    for (at, mover) in arena.movers.iter().enumerate() {
        let field = format!("movers[{at}].path");
        let outside = |point: &Vec2| (point.abs() - arena.half_extent).max() > 0.0;
        if let Some(point) = mover.round().iter().position(outside) {
            let place = mover.round()[point].shown();
            return Err(ConfigError::field(field, format!("it leaves the ground at {place:.2}")));
        }
        let meets = |block: &KeepOut| mover.ways().iter().any(|way| way.apart_m(block) <= 0.0);
        if let Some(wall) = walls.iter().position(|wall| wall.blocks(scale).iter().any(meets)) {
            return Err(ConfigError::field(field, format!("the obstacle runs into walls[{wall}] there")));
        }
        if arena.keep_outs.iter().any(meets) {
            return Err(ConfigError::field(field, "the obstacle leaves the ground there"));
        }
    }
    Ok(())
}
