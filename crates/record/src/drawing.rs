//! Draws a team as Foxglove messages: walls, goals, hulls, headings, robot numbers, and lines between robots in
//! communication range.

use super::foxglove::{self, Colour, MAP};
use super::protobuf::Message;
use super::stage::Stage;
use murmurate::messages::geometry::Vec2;

/// Pose of a robot in a drawing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Position \[m\], world frame.
    pub position: Vec2,
    /// Heading \[rad\], counter-clockwise from x; `None` if it is unknown.
    pub heading: Option<f32>,
}

const HEIGHT_M: f64 = 0.2;
const WALL_HEIGHT_M: f64 = 0.5;
const GREY: Colour = [0.5, 0.5, 0.5, 1.0];
const DARK: Colour = [0.1, 0.1, 0.1, 1.0];
const LINK: Colour = [0.1, 0.7, 0.2, 0.8];
/// Colours of the robots (red, green, blue, opacity) by number, repeated after the last. The pictures of `sim` use the
/// same.
const ROBOTS: [Colour; 6] = [
    [0.12, 0.47, 0.71, 1.0],
    [1.0, 0.5, 0.05, 1.0],
    [0.17, 0.63, 0.17, 1.0],
    [0.84, 0.15, 0.16, 1.0],
    [0.58, 0.4, 0.74, 1.0],
    [0.55, 0.34, 0.29, 1.0],
];

fn colour_of(robot: usize) -> Colour {
    ROBOTS[robot % ROBOTS.len()]
}

fn point(at: Vec2, height_m: f64) -> [f64; 3] {
    [f64::from(at.x), f64::from(at.y), height_m]
}

/// Writes a Foxglove scene update with the walls of `stage` and the robots' `goals` \[m\], world frame, in the order of
/// robot ids. `at` is the time of the update \[ns\], since 1970 or the start of a simulation.
pub fn walls_and_goals(out: &mut Message, at: u64, stage: &Stage, goals: &[Vec2]) {
    foxglove::entity(out, at, "walls", |entity| {
        for [x, y, far_x, far_y] in &stage.walls {
            let (min, max) = (Vec2::new(*x, *y), Vec2::new(*far_x, *far_y));
            let (middle, size) = ((min + max) * 0.5, max - min);
            entity.message(8, |cube| {
                foxglove::pose(cube, 1, point(middle, WALL_HEIGHT_M / 2.0), 0.0);
                foxglove::vector(cube, 2, point(size, WALL_HEIGHT_M));
                foxglove::colour(cube, 3, GREY);
            });
        }
    });
    foxglove::entity(out, at, "goals", |entity| {
        for (robot, goal) in goals.iter().enumerate() {
            let [red, green, blue, _] = colour_of(robot);
            let width = f64::from(stage.hull_m) * 2.0;
            disc(entity, point(*goal, 0.005), [width, width, 0.01], [red, green, blue, 0.35]);
        }
    });
}

/// Writes a Foxglove scene update with the robots, their headings and ids, and lines between robots in communication
/// range (of the first 64 robots only). `at` is the time of the update \[ns\], since 1970 or the start of a simulation.
/// `team` has the robots' poses in the order of ids; a robot whose pose is `None` is left out.
pub fn team(out: &mut Message, at: u64, stage: &Stage, team: &[Option<Body>]) {
    let width = f64::from(stage.hull_m) * 2.0;
    for (robot, body) in team.iter().enumerate() {
        let Some(body) = body else { continue };
        foxglove::entity(out, at, &format!("robot/{robot}"), |entity| {
            disc(entity, point(body.position, HEIGHT_M / 2.0), [width, width, HEIGHT_M], colour_of(robot));
            if let Some(heading) = body.heading {
                entity.message(7, |arrow| {
                    foxglove::pose(arrow, 1, point(body.position, HEIGHT_M + 0.05), f64::from(heading));
                    for (field, length) in [(2, width * 0.6), (3, 0.06), (4, 0.12), (5, 0.12)] {
                        arrow.double(field, length);
                    }
                    foxglove::colour(arrow, 6, DARK);
                });
            }
            entity.message(13, |text| {
                foxglove::pose(text, 1, point(body.position, HEIGHT_M + 0.25), 0.0);
                text.uint(2, 1);
                text.double(3, 0.2);
                foxglove::colour(text, 5, DARK);
                text.text(6, &robot.to_string());
            });
        });
    }
    foxglove::entity(out, at, "links", |entity| {
        entity.message(11, |line| {
            const LINE_LIST: u64 = 2;
            line.uint(1, LINE_LIST);
            foxglove::pose(line, 2, [0.0, 0.0, HEIGHT_M / 2.0], 0.0);
            line.double(3, 0.02);
            for (one, other) in pairs(team, stage.range_m.unwrap_or(f32::INFINITY)) {
                foxglove::vector(line, 5, point(one, 0.0));
                foxglove::vector(line, 5, point(other, 0.0));
            }
            foxglove::colour(line, 6, LINK);
        });
    });
}

/// Returns, for each pair of robots within a range \[m\], both positions \[m\]. Only the first 64 robots of the team
/// count.
fn pairs(team: &[Option<Body>], range_m: f32) -> Vec<(Vec2, Vec2)> {
    let seen: Vec<Vec2> = team.iter().take(64).flatten().map(|body| body.position).collect();
    let all = seen.iter().enumerate().flat_map(|(at, one)| seen[at + 1..].iter().map(|other| (*one, *other)));
    all.filter(|(one, other)| (*one - *other).norm() < range_m).collect()
}

fn disc(entity: &mut Message, at: [f64; 3], size: [f64; 3], colour: Colour) {
    entity.message(10, |cylinder| {
        foxglove::pose(cylinder, 1, at, 0.0);
        foxglove::vector(cylinder, 2, size);
        cylinder.double(3, 1.0);
        cylinder.double(4, 1.0);
        foxglove::colour(cylinder, 5, colour);
    });
}

/// Writes the robots as a Foxglove point cloud: each point has a position and the robot's id. `at` is its time \[ns\],
/// since 1970 or the start of a simulation. `team` has the robots' poses in the order of ids; a robot whose pose is
/// `None` is left out.
pub fn cloud(out: &mut Message, at: u64, team: &[Option<Body>]) {
    const FLOAT32: u64 = 7;
    const UINT32: u64 = 5;
    foxglove::time(out, 1, at);
    out.text(2, MAP);
    foxglove::pose(out, 3, [0.0; 3], 0.0);
    out.fixed32(4, 16);
    for (name, offset, kind) in [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("robot", 12, UINT32)] {
        out.message(5, |field| {
            field.text(1, name);
            field.fixed32(2, offset);
            field.uint(3, kind);
        });
    }
    let mut points = Vec::with_capacity(team.len() * 16);
    for (robot, body) in (0u32..).zip(team) {
        let Some(body) = body else { continue };
        for coordinate in [body.position.x, body.position.y, 0.0] {
            points.extend(coordinate.to_le_bytes());
        }
        points.extend(robot.to_le_bytes());
    }
    out.bytes(6, &points);
}

/// Writes a Foxglove message with the transforms from the world frame to the robots' frames `robot_N/base_link`. `at`
/// is its time \[ns\], since 1970 or the start of a simulation. `team` has the robots' poses in the order of ids; an
/// unknown heading is written as 0, and a robot whose pose is `None` is left out.
pub fn transforms(out: &mut Message, at: u64, team: &[Option<Body>]) {
    for (robot, body) in team.iter().enumerate() {
        let Some(body) = body else { continue };
        out.message(1, |transform| {
            foxglove::time(transform, 1, at);
            transform.text(2, MAP);
            transform.text(3, &format!("robot_{robot}/base_link"));
            foxglove::vector(transform, 4, point(body.position, 0.0));
            foxglove::rotation(transform, 5, f64::from(body.heading.unwrap_or(0.0)));
        });
    }
}

/// Writes a Foxglove message with the pose of a robot in the world frame. `at` is its time \[ns\], since 1970 or the
/// start of a simulation. An unknown heading is written as 0.
pub fn pose(out: &mut Message, at: u64, body: Body) {
    foxglove::time(out, 1, at);
    out.text(2, MAP);
    foxglove::pose(out, 3, point(body.position, 0.0), f64::from(body.heading.unwrap_or(0.0)));
}
