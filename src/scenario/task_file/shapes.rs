//! Shapes in a task file: walls, areas, and obstacles that are drawn, with the ranges of their values.

use serde::Deserialize;

use crate::config::{ConfigError, in_range};
use crate::messages::geometry::Vec2;
use crate::scenario::KeepOut;
use crate::scenario::polygon::Polygon;

/// Largest coordinate and length \[m\] in a task file.
pub const FARTHEST_M: f32 = 1000.0;
/// Smallest side of the ground, of a wall and of an obstacle, and the smallest radius \[m\].
pub const SMALLEST_M: f32 = 0.001;
/// Largest number of walls and obstacles together. Scripted navigation compares all of their corners with each other.
pub const MOST_BLOCKS: usize = 100;
/// Largest number of corners of a polygon.
const MOST_CORNERS: usize = 64;
/// Largest number of areas and of points in one of them.
const MOST_AREAS: usize = 2000;

/// Shape of a wall or of an area \[m\], world frame.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    /// Rectangle: smallest x and y, then largest x and y.
    Rect([f32; 4]),
    /// Disc: x and y of its centre, then its radius.
    Disc([f32; 3]),
    /// Polygon: its corners, in either order of rotation.
    Polygon(Vec<[f32; 2]>),
    /// Formation: points, of which each robot of the team takes one.
    Points(Vec<[f32; 2]>),
}

/// Obstacles of one shape and size, which are drawn within bounds: once, or for each episode.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Obstacles {
    /// Number of obstacles.
    pub count: usize,
    /// Size of rectangles along x and y \[m\].
    pub size_m: Option<[f32; 2]>,
    /// Radius of discs \[m\].
    pub radius_m: Option<f32>,
    /// Corners of convex polygons \[m\], wherever their origin is.
    pub polygon: Option<Vec<[f32; 2]>>,
    /// Bounds within which they lie \[m\]: smallest x and y, then largest x and y.
    pub within: [f32; 4],
    /// Seed of the draw. Without `each_episode` the obstacles are the same in every run of the file.
    #[serde(default)]
    pub seed: u32,
    /// Whether they are drawn anew for each episode, from the seed of the run too.
    #[serde(default)]
    pub each_episode: bool,
}

impl Obstacles {
    /// Checks the values; `field` is the path of the field in the file. An error names the wrong one.
    pub fn check(&self, field: &str) -> Result<(), ConfigError> {
        in_range(&format!("{field}.count"), self.count, (1, MOST_BLOCKS))?;
        check_rect(&format!("{field}.within"), self.within)?;
        let [left, low, right, high] = self.within;
        let room_m = [right - left, high - low];
        self.body().check(field, room_m)
    }

    /// Returns one of the obstacles, somewhere \[m\]; a rectangle has its smallest x and y at the origin.
    pub fn block(&self, scale: f32) -> KeepOut {
        self.body().block(scale)
    }

    fn body(&self) -> Body<'_> {
        Body { size_m: self.size_m, radius_m: self.radius_m, polygon: self.polygon.as_deref() }
    }
}

/// Body of an obstacle: one of a rectangle, a disc and a convex polygon.
#[derive(Clone, Copy, Debug)]
pub struct Body<'a> {
    /// Size of a rectangle along x and y \[m\].
    pub size_m: Option<[f32; 2]>,
    /// Radius of a disc \[m\].
    pub radius_m: Option<f32>,
    /// Corners of a convex polygon \[m\].
    pub polygon: Option<&'a [[f32; 2]]>,
}

impl Body<'_> {
    /// Checks the values; `field` is the path of the obstacle in the file, and `room_m` the largest size along x and y
    /// \[m\]. An error names the wrong one.
    pub fn check(&self, field: &str, room_m: [f32; 2]) -> Result<(), ConfigError> {
        match (self.size_m, self.radius_m, self.polygon) {
            (Some(size_m), None, None) => (0..2).try_for_each(|axis| {
                in_range(&format!("{field}.size_m[{axis}]"), size_m[axis], (SMALLEST_M, room_m[axis]))
            }),
            (None, Some(radius_m), None) => {
                in_range(&format!("{field}.radius_m"), radius_m, (SMALLEST_M, room_m[0].min(room_m[1]) / 2.0))
            }
            (None, None, Some(corners)) => {
                let field = format!("{field}.polygon");
                let [block] = &check_polygon(&field, corners)?.inside()[..] else {
                    return Err(ConfigError::field(field, "it is not convex, as an obstacle has to be"));
                };
                let size_m = block.max - block.min;
                if size_m.x > room_m[0] || size_m.y > room_m[1] {
                    return Err(ConfigError::field(field, format!("it is larger than {:?} m, its bounds", room_m)));
                }
                Ok(())
            }
            _ => Err(ConfigError::field(format!("{field}.size_m"), "give one of size_m, radius_m and polygon")),
        }
    }

    /// Returns the body \[m\] with lengths multiplied by `scale`. A rectangle has its smallest x and y at the origin, a
    /// disc its centre, and a polygon is where its corners are.
    pub fn block(&self, scale: f32) -> KeepOut {
        let of_file = "one is given, and it is sound: the check says so";
        match (self.size_m, self.radius_m, self.polygon) {
            (Some(size_m), ..) => KeepOut::rect(Vec2::zeros(), Vec2::from(size_m) * scale),
            (_, Some(radius_m), _) => KeepOut::disc(Vec2::zeros(), radius_m * scale),
            (.., corners) => {
                let polygon = polygon(corners.expect(of_file), scale).expect(of_file);
                polygon.inside().swap_remove(0)
            }
        }
    }
}

impl Shape {
    /// Returns the blocks that fill a shape whose lengths are multiplied by `scale`; none for a formation.
    pub fn blocks(&self, scale: f32) -> Vec<KeepOut> {
        match self {
            Shape::Rect([x, y, far_x, far_y]) => {
                vec![KeepOut::rect(Vec2::new(*x, *y) * scale, Vec2::new(*far_x, *far_y) * scale)]
            }
            Shape::Disc([x, y, radius_m]) => vec![KeepOut::disc(Vec2::new(*x, *y) * scale, radius_m * scale)],
            Shape::Polygon(corners) => {
                polygon(corners, scale).expect("it is sound: the check of the fields says so").inside()
            }
            Shape::Points(_) => Vec::new(),
        }
    }

    /// Returns the polygon, with lengths multiplied by `scale`; `None` for another shape.
    pub fn polygon(&self, scale: f32) -> Option<Polygon> {
        match self {
            Shape::Polygon(corners) => polygon(corners, scale).ok(),
            _ => None,
        }
    }

    /// Checks the values; `field` is the path of the field in the file. An error names the wrong one.
    pub fn check(&self, field: &str) -> Result<(), ConfigError> {
        match self {
            Shape::Polygon(corners) => check_polygon(&format!("{field}.polygon"), corners).map(drop),
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

/// Checks the coordinates of points \[m\]. An error names the wrong one.
pub fn check_points(field: &str, points: &[[f32; 2]]) -> Result<(), ConfigError> {
    for (at, point) in points.iter().enumerate() {
        for (axis, coordinate) in point.iter().enumerate() {
            in_range(&format!("{field}[{at}][{axis}]"), *coordinate, (-FARTHEST_M, FARTHEST_M))?;
        }
    }
    Ok(())
}

fn polygon(corners: &[[f32; 2]], scale: f32) -> Result<Polygon, &'static str> {
    Ok(Polygon::of(corners.iter().map(|corner| Vec2::from(*corner)).collect())?.scaled(scale))
}

fn check_polygon(field: &str, corners: &[[f32; 2]]) -> Result<Polygon, ConfigError> {
    if corners.len() > MOST_CORNERS {
        let why = format!("it has {} corners, more than {MOST_CORNERS}", corners.len());
        return Err(ConfigError::field(field, why));
    }
    check_points(field, corners)?;
    polygon(corners, 1.0).map_err(|why| ConfigError::field(field, why))
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

/// Checks that there are enough of the entries of a list, and not too many.
pub fn within_count(field: &str, count: usize, least: usize) -> Result<(), ConfigError> {
    if (least..=MOST_AREAS).contains(&count) {
        return Ok(());
    }
    Err(ConfigError::field(field, format!("there are {count}, which is not {least} to {MOST_AREAS}")))
}
