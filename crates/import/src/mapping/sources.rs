//! Where poses and commands of a run are, checked: columns of tables, or topics of a bag.

use std::path::PathBuf;

use murmurate::config::ConfigError;

use super::fields::{Fields, Frame, Stamps, Topics, Units};

/// Word in a column's or topic's name that stands for the name of a robot.
const ROBOT: &str = "{robot}";

/// Columns of a CSV file with the poses of robots.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseColumns {
    /// Column of the time.
    pub time: String,
    /// Column with the robot's name; `None` if each robot has columns of its own.
    pub robot: Option<String>,
    /// Columns of the position.
    pub position: [String; 2],
    /// Columns of the heading; `None` if it is not known.
    pub heading: Option<HeadingColumns>,
    /// Columns of the velocity, and its frame; `None` to take the differences of the positions.
    pub velocity: Option<([String; 2], Frame)>,
    /// Columns that are not zero while the robot touches something.
    pub touches: Vec<String>,
}

/// Columns of a heading.
#[derive(Clone, Debug, PartialEq)]
pub enum HeadingColumns {
    /// Rotation about the z axis.
    Yaw(String),
    /// Quaternion x, y, z, w.
    Quaternion([String; 4]),
}

/// Columns of a CSV file with the commands of robots.
#[derive(Clone, Debug, PartialEq)]
pub struct CommandColumns {
    /// The file.
    pub path: PathBuf,
    /// Column of the time.
    pub time: String,
    /// Column with the robot's name; `None` if each robot has columns of its own.
    pub robot: Option<String>,
    /// Column of the velocity along x.
    pub x: String,
    /// Column of the velocity along y; `None` for robots that only drive ahead.
    pub y: Option<String>,
}

/// Place of poses and commands.
#[derive(Clone, Debug, PartialEq)]
pub enum Source {
    /// Columns of CSV files.
    Csv(Box<PoseColumns>, Option<CommandColumns>, Units),
    /// Topics of a bag with the poses and the commands of each robot, and the time that counts.
    Bag(Vec<String>, Option<Vec<String>>, Stamps, Option<Frame>),
}

/// Returns the name of a robot's column or topic: `template` with the robot's name in place of `{robot}`.
pub fn of_robot(template: &str, name: &str) -> String {
    template.replace(ROBOT, name)
}

/// Returns the column that a field names. The error names the field, which belongs to the table `table`.
fn needed(table: &str, field: &str, column: &Option<String>) -> Result<String, ConfigError> {
    let why = || ConfigError::field(format!("{table}.{field}"), "it is missing: name the column");
    column.clone().filter(|name| !name.is_empty()).ok_or_else(why)
}

/// Fails if one of these fields of the table `table`, of which each is given or not, is given.
fn refused(table: &str, fields: &[(&str, bool)], why: &str) -> Result<(), ConfigError> {
    let given = fields.iter().find(|(_, given)| *given);
    given.map_or(Ok(()), |(field, _)| Err(ConfigError::field(format!("{table}.{field}"), why)))
}

/// Checks that columns tell `robots` robots apart: by a column with their names, or by `{robot}` in these names.
fn told_apart(table: &str, robot: &Option<String>, columns: &[&String], robots: usize) -> Result<(), ConfigError> {
    let named = columns.iter().all(|column| column.contains(ROBOT));
    if robot.is_none() && robots > 1 && !named {
        let why = "name the column that says which robot a row is of, or write {robot} in the names of the others";
        return Err(ConfigError::field(format!("{table}.robot"), why));
    }
    Ok(())
}

/// Checks the columns of a mapping of CSV files. Returns them, and the frame of the commands if there are any.
pub(super) fn csv(fields: &Fields, robots: usize) -> Result<(Source, Option<Frame>), ConfigError> {
    let poses = &fields.poses;
    const TOPICS: &str = "a CSV file has no topics: name columns";
    refused("poses", &[("topic", poses.topic.is_some())], TOPICS)?;
    if fields.stamps.is_some() {
        return Err(ConfigError::field("stamps", "a CSV file has no stamps of messages: name the column poses.time"));
    }
    let heading = match (&poses.yaw, &poses.quaternion) {
        (Some(_), Some(_)) => return Err(ConfigError::field("poses.quaternion", "give the yaw or the quaternion")),
        (Some(yaw), None) => Some(HeadingColumns::Yaw(yaw.clone())),
        (None, Some(columns)) => Some(HeadingColumns::Quaternion(columns.clone())),
        (None, None) => None,
    };
    let velocity_frame = poses.velocity_frame.unwrap_or(Frame::World);
    let columns = PoseColumns {
        time: needed("poses", "time", &poses.time)?,
        robot: poses.robot.clone(),
        position: [needed("poses", "x", &poses.x)?, needed("poses", "y", &poses.y)?],
        heading,
        velocity: poses.velocity.clone().map(|columns| (columns, velocity_frame)),
        touches: poses.touches.clone(),
    };
    told_apart("poses", &columns.robot, &[&columns.position[0], &columns.position[1]], robots)?;
    let turned = columns.velocity.is_some() && velocity_frame == Frame::Body;
    if turned && columns.heading.is_none() {
        return Err(ConfigError::field("poses.velocity_frame", BODY));
    }
    let Some(commands) = &fields.commands else {
        return Ok((Source::Csv(Box::new(columns), None, fields.units.clone().unwrap_or_default()), None));
    };
    refused("commands", &[("topic", commands.topic.is_some())], TOPICS)?;
    let Some(frame) = commands.frame else {
        return Err(ConfigError::field("commands.frame", "it is missing: write \"world\" or \"body\""));
    };
    if frame == Frame::Body && columns.heading.is_none() {
        return Err(ConfigError::field("commands.frame", BODY));
    }
    // Columns of each robot need no other that names it.
    let wide = [&commands.x, &commands.y].into_iter().flatten().any(|column| column.contains(ROBOT));
    let told = CommandColumns {
        path: commands.path.clone().unwrap_or_else(|| fields.path.clone()),
        time: commands.time.clone().unwrap_or_else(|| columns.time.clone()),
        robot: commands.robot.clone().or_else(|| columns.robot.clone().filter(|_| !wide)),
        x: needed("commands", "x", &commands.x)?,
        y: commands.y.clone(),
    };
    let named: Vec<&String> = [&told.x].into_iter().chain(&told.y).collect();
    told_apart("commands", &told.robot, &named, robots)?;
    let units = fields.units.clone().unwrap_or_default();
    Ok((Source::Csv(Box::new(columns), Some(told), units), Some(frame)))
}

/// Why velocities in the robot's axes cannot be used.
const BODY: &str = "\"body\" needs the robots' headings: name poses.yaw or poses.quaternion";

/// Checks the topics of a mapping of a bag. Returns them, and the frame of the commands if there are any.
pub(super) fn bag(fields: &Fields, names: &[String]) -> Result<(Source, Option<Frame>), ConfigError> {
    const COLUMNS: &str = "a bag has no columns: name poses.topic and commands.topic";
    let poses = &fields.poses;
    let given = [
        ("time", poses.time.is_some()),
        ("robot", poses.robot.is_some()),
        ("x", poses.x.is_some()),
        ("y", poses.y.is_some()),
        ("yaw", poses.yaw.is_some()),
        ("quaternion", poses.quaternion.is_some()),
        ("velocity", poses.velocity.is_some()),
        ("touches", !poses.touches.is_empty()),
    ];
    refused("poses", &given, COLUMNS)?;
    if fields.units.is_some() {
        return Err(ConfigError::field("units", "messages of ROS have metres, radians and nanoseconds: leave it out"));
    }
    let of_poses = topics("poses.topic", &poses.topic, names)?;
    let (mut frame, mut of_commands) = (None, None);
    if let Some(commands) = &fields.commands {
        let given = [
            ("path", commands.path.is_some()),
            ("time", commands.time.is_some()),
            ("robot", commands.robot.is_some()),
            ("x", commands.x.is_some()),
            ("y", commands.y.is_some()),
        ];
        refused("commands", &given, COLUMNS)?;
        frame = Some(commands.frame.unwrap_or(Frame::Body));
        let told = topics("commands.topic", &commands.topic, names)?;
        if let Some(topic) = told.iter().find(|topic| of_poses.contains(topic)) {
            return Err(ConfigError::field("commands.topic", format!("'{topic}' is a topic of poses, too")));
        }
        of_commands = Some(told);
    }
    let stamps = fields.stamps.unwrap_or_default();
    Ok((Source::Bag(of_poses, of_commands, stamps, poses.velocity_frame), frame))
}

/// Returns the topic of each robot. The error names the field.
fn topics(field: &str, topics: &Option<Topics>, names: &[String]) -> Result<Vec<String>, ConfigError> {
    let wrong = |why: String| Err(ConfigError::field(field, why));
    let all = match topics {
        None => return wrong("it is missing: name the topic, with {robot} for the name of a robot".to_owned()),
        Some(Topics::Template(template)) if names.len() > 1 && !template.contains(ROBOT) => {
            return wrong("write {robot} in it, or a list with a topic of each robot".to_owned());
        }
        Some(Topics::Template(template)) => names.iter().map(|name| of_robot(template, name)).collect(),
        Some(Topics::List(list)) if list.len() != names.len() => {
            return wrong(format!("it has {} topics, and there are {} robots", list.len(), names.len()));
        }
        Some(Topics::List(list)) => list.clone(),
    };
    let mut sorted: Vec<&String> = all.iter().collect();
    sorted.sort_unstable();
    if sorted.windows(2).any(|pair| pair[0] == pair[1]) {
        return wrong("two robots have one topic".to_owned());
    }
    Ok(all)
}
