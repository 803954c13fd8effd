//! Draws a team as Foxglove messages: walls, goals, hulls, headings, robot numbers, and lines between robots in
//! communication range.

use ::foxglove::messages::line_primitive::Type as LineType;
use ::foxglove::messages::packed_element_field::NumericType;
use ::foxglove::messages::{
    ArrowPrimitive, Color, CubePrimitive, CylinderPrimitive, FrameTransform, FrameTransforms, LaserScan, LinePrimitive,
    PackedElementField, PointCloud, PoseInFrame, SceneEntity, TextPrimitive, TriangleListPrimitive,
};

use super::foxglove::{self, MAP, colour};
use super::stage::Stage;
use murmurate::messages::geometry::{Planar, Vec2};
use murmurate::messages::wire::Sensed;
use murmurate::scenario::{DrawnMover, Solid};
use murmurate::time::Span;

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
const GREY: Color = colour([0.5, 0.5, 0.5, 1.0]);
const DARK: Color = colour([0.1, 0.1, 0.1, 1.0]);
const LINK: Color = colour([0.1, 0.7, 0.2, 0.8]);
/// Colours of the robots (red, green, blue, opacity) by number, repeated after the last. The pictures of `sim` use the
/// same.
const ROBOTS: [Color; 6] = [
    colour([0.12, 0.47, 0.71, 1.0]),
    colour([1.0, 0.5, 0.05, 1.0]),
    colour([0.17, 0.63, 0.17, 1.0]),
    colour([0.84, 0.15, 0.16, 1.0]),
    colour([0.58, 0.4, 0.74, 1.0]),
    colour([0.55, 0.34, 0.29, 1.0]),
];

fn colour_of(robot: usize) -> Color {
    ROBOTS[robot % ROBOTS.len()]
}

fn point(at: Vec2, height_m: f64) -> [f64; 3] {
    [f64::from(at.x), f64::from(at.y), height_m]
}

/// Returns the entities of a Foxglove scene update for the walls and waypoints of `stage` in an episode and the robots'
/// `goals` \[m\], world frame, in the order of robot ids. `at` is the time of the update \[ns\], since 1970 or the
/// start of a simulation.
pub fn walls_and_goals(at: u64, (stage, episode): (&Stage, u32), goals: &[Vec2]) -> [SceneEntity; 2] {
    let width = f64::from(stage.hull_m) * 2.0;
    let waypoints = stage.waypoints.get(episode as usize).into_iter().flatten().enumerate();
    let waypoints = waypoints.flat_map(|(robot, places)| places.iter().map(move |place| (robot, *place)));
    let waypoint = |(robot, place): (usize, [f32; 2])| {
        let size = [width / 4.0, width / 4.0, 0.01];
        disc(point(Vec2::from(place), 0.005), size, Color { a: 0.35, ..colour_of(robot) })
    };
    let goal = |(robot, goal): (usize, &Vec2)| {
        let colour = if stage.unlabelled { GREY } else { colour_of(robot) };
        disc(point(*goal, 0.005), [width, width, 0.01], Color { a: 0.35, ..colour })
    };
    [
        solids(at, "walls", stage.walls_in(episode)),
        SceneEntity {
            cylinders: goals.iter().enumerate().map(goal).chain(waypoints.map(waypoint)).collect(),
            ..foxglove::entity(at, "goals".to_owned())
        },
    ]
}

/// Returns the entity of a Foxglove scene update for the obstacles that move in an episode, at the time `elapsed` since
/// it runs; without shapes if none runs, and `None` if there are no such obstacles. `at` is the time of the update
/// \[ns\], since 1970 or the start of a simulation.
pub fn movers(at: u64, (stage, episode): (&Stage, u32), elapsed: Option<Span>) -> Option<SceneEntity> {
    let place = |mover: &DrawnMover| Some(mover.body.moved(mover.place(episode, elapsed?)?.to_array()));
    let bodies: Vec<Solid> = stage.movers.iter().filter_map(place).collect();
    (!stage.movers.is_empty()).then(|| solids(at, "moving obstacles", &bodies))
}

/// Returns an entity with walls of these shapes.
fn solids(at: u64, id: &str, walls: &[Solid]) -> SceneEntity {
    let cube = |wall: &Solid| {
        let Solid::Rect([x, y, far_x, far_y]) = *wall else { return None };
        let (min, max) = (Vec2::new(x, y), Vec2::new(far_x, far_y));
        let (middle, size) = ((min + max) * 0.5, max - min);
        Some(CubePrimitive {
            pose: foxglove::pose(point(middle, WALL_HEIGHT_M / 2.0), 0.0),
            size: foxglove::vector(point(size, WALL_HEIGHT_M)),
            color: Some(GREY),
        })
    };
    let others = walls.iter().filter(|wall| !matches!(wall, Solid::Rect(_)));
    let triangles = others.map(|wall| TriangleListPrimitive {
        pose: foxglove::pose([0.0; 3], 0.0),
        points: wall.prism(WALL_HEIGHT_M as f32).into_iter().map(|at| foxglove::point(at.map(f64::from))).collect(),
        color: Some(GREY),
        ..TriangleListPrimitive::default()
    });
    let (cubes, triangles) = (walls.iter().filter_map(cube).collect(), triangles.collect());
    SceneEntity { cubes, triangles, ..foxglove::entity(at, id.to_owned()) }
}

/// Returns the entities of a Foxglove scene update for the robots, their headings and ids, and lines between robots in
/// communication range (of the first 64 robots only). `at` is the time of the update \[ns\], since 1970 or the start of
/// a simulation. `team` has the robots' poses in the order of ids; a robot whose pose is `None` is left out.
pub fn team(at: u64, stage: &Stage, team: &[Option<Body>]) -> Vec<SceneEntity> {
    let width = f64::from(stage.hull_m) * 2.0;
    let robots = team.iter().enumerate().filter_map(|(robot, body)| Some(entity_of(at, width, robot, (*body)?)));
    let ends = pairs(team, stage.range_m.unwrap_or(f32::INFINITY)).into_iter().flat_map(<[Vec2; 2]>::from);
    let links = LinePrimitive {
        r#type: LineType::LineList.into(),
        pose: foxglove::pose([0.0, 0.0, HEIGHT_M / 2.0], 0.0),
        thickness: 0.02,
        points: ends.map(|end| foxglove::point(point(end, 0.0))).collect(),
        color: Some(LINK),
        ..LinePrimitive::default()
    };
    let links = SceneEntity { lines: vec![links], ..foxglove::entity(at, "links".to_owned()) };
    robots.chain([links]).collect()
}

/// Returns the shapes of a robot of the width `width` \[m\]: its hull, heading and id.
fn entity_of(at: u64, width: f64, robot: usize, body: Body) -> SceneEntity {
    let arrow = body.heading.map(|heading| ArrowPrimitive {
        pose: foxglove::pose(point(body.position, HEIGHT_M + 0.05), f64::from(heading)),
        shaft_length: width * 0.6,
        shaft_diameter: 0.06,
        head_length: 0.12,
        head_diameter: 0.12,
        color: Some(DARK),
    });
    let text = TextPrimitive {
        pose: foxglove::pose(point(body.position, HEIGHT_M + 0.25), 0.0),
        billboard: true,
        font_size: 0.2,
        scale_invariant: false,
        color: Some(DARK),
        text: robot.to_string(),
    };
    SceneEntity {
        arrows: arrow.into_iter().collect(),
        cylinders: vec![disc(point(body.position, HEIGHT_M / 2.0), [width, width, HEIGHT_M], colour_of(robot))],
        texts: vec![text],
        ..foxglove::entity(at, format!("robot/{robot}"))
    }
}

/// Returns, for each pair of robots within a range \[m\], both positions \[m\]. Only the first 64 robots of the team
/// count.
fn pairs(team: &[Option<Body>], range_m: f32) -> Vec<(Vec2, Vec2)> {
    let seen: Vec<Vec2> = team.iter().take(64).flatten().map(|body| body.position).collect();
    let all = seen.iter().enumerate().flat_map(|(at, one)| seen[at + 1..].iter().map(|other| (*one, *other)));
    all.filter(|(one, other)| (*one - *other).norm() < range_m).collect()
}

fn disc(at: [f64; 3], size: [f64; 3], colour: Color) -> CylinderPrimitive {
    CylinderPrimitive {
        pose: foxglove::pose(at, 0.0),
        size: foxglove::vector(size),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color: Some(colour),
    }
}

/// Returns the robots as a Foxglove point cloud: each point has a position and the robot's id. `at` is its time \[ns\],
/// since 1970 or the start of a simulation. `team` has the robots' poses in the order of ids; a robot whose pose is
/// `None` is left out.
pub fn cloud(at: u64, team: &[Option<Body>]) -> PointCloud {
    let field = |name: &str, offset, kind: NumericType| PackedElementField {
        name: name.to_owned(),
        offset,
        r#type: kind.into(),
    };
    let mut points = Vec::with_capacity(team.len() * 16);
    for (robot, body) in (0u32..).zip(team) {
        let Some(body) = body else { continue };
        for coordinate in [body.position.x, body.position.y, 0.0] {
            points.extend(coordinate.to_le_bytes());
        }
        points.extend(robot.to_le_bytes());
    }
    PointCloud {
        timestamp: foxglove::time(at),
        frame_id: MAP.to_owned(),
        pose: foxglove::pose([0.0; 3], 0.0),
        point_stride: 16,
        fields: vec![
            field("x", 0, NumericType::Float32),
            field("y", 4, NumericType::Float32),
            field("z", 8, NumericType::Float32),
            field("robot", 12, NumericType::Uint32),
        ],
        data: points.into(),
    }
}

/// Returns the name of a robot's own frame.
fn frame_of(robot: usize) -> String {
    format!("robot_{robot}/base_link")
}

/// Returns a Foxglove message with the transforms from the world frame to the robots' frames `robot_N/base_link`. `at`
/// is its time \[ns\], since 1970 or the start of a simulation. `team` has the robots' poses in the order of ids; an
/// unknown heading is written as 0, and a robot whose pose is `None` is left out.
pub fn transforms(at: u64, team: &[Option<Body>]) -> FrameTransforms {
    let transform = |(robot, body): (usize, &Option<Body>)| {
        let body = (*body)?;
        Some(FrameTransform {
            timestamp: foxglove::time(at),
            parent_frame_id: MAP.to_owned(),
            child_frame_id: frame_of(robot),
            translation: foxglove::vector(point(body.position, 0.0)),
            rotation: foxglove::rotation(f64::from(body.heading.unwrap_or(0.0))),
        })
    };
    FrameTransforms { transforms: team.iter().enumerate().filter_map(transform).collect() }
}

/// Returns a Foxglove message with the pose of a robot in the world frame. `at` is its time \[ns\], since 1970 or the
/// start of a simulation. An unknown heading is written as 0.
pub fn pose(at: u64, body: Body) -> PoseInFrame {
    PoseInFrame {
        timestamp: foxglove::time(at),
        frame_id: MAP.to_owned(),
        pose: foxglove::pose(point(body.position, 0.0), f64::from(body.heading.unwrap_or(0.0))),
    }
}

/// Returns the scan of a robot's sense as Foxglove draws it, in the robot's frame. `rays_rad` are the angles of the
/// first and the last ray \[rad\], and `mount_m` is the place of the sense on the robot \[m\].
pub fn scan(at: u64, sensed: &Sensed, (rays_rad, mount_m): ([f64; 2], [f32; 2])) -> LaserScan {
    let [start_angle, end_angle] = rays_rad;
    let [ahead, left] = mount_m.map(f64::from);
    LaserScan {
        timestamp: foxglove::time(at),
        frame_id: frame_of(sensed.robot.index()),
        pose: foxglove::pose([ahead, left, 0.0], 0.0),
        start_angle,
        end_angle,
        ranges: sensed.values.0.iter().copied().map(f64::from).collect(),
        intensities: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::trial::Trial;

    #[test]
    fn moving_obstacles_are_drawn_while_an_episode_runs_and_only_where_there_are_some() {
        let still = Stage::of(&Trial::preset("sim", "passage").expect("it is a preset"));
        assert_eq!(movers(0, (&still, 0), Some(Span::ZERO)), None);
        let cart = DrawnMover {
            body: Solid::Rect([-0.1, -0.2, 0.1, 0.2]),
            round: vec![[0.0, 1.0], [2.0, 1.0], [0.0, 1.0]],
            speed_m_s: 0.5,
            phases: vec![0.0],
        };
        let stage = Stage { movers: vec![cart], ..still };
        let drawn = |elapsed| movers(0, (&stage, 3), elapsed).expect("there is one").cubes;
        let [cube] = &drawn(Some(Span::from_secs(3.0)))[..] else { panic!("there is one") };
        let at = cube.pose.and_then(|pose| pose.position).expect("it has a place");
        assert_eq!(((at.x * 100.0).round(), (at.y * 100.0).round()), (150.0, 100.0));
        assert!(drawn(None).is_empty(), "what was drawn before is taken away");
    }
}
