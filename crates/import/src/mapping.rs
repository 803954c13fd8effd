//! The mapping: a TOML file that says what the columns or topics of a run are. docs/lab-run.md lists its fields.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use murmurate::config::{self, ConfigError, in_range, regular};

use crate::error::ImportError;

/// Longest mapping \[bytes\].
const LONGEST: u64 = 256 << 10;
/// Most robots of a run.
const MOST_ROBOTS: usize = 2000;
/// Word in a column's or topic's name that stands for the name of a robot.
pub const ROBOT: &str = "{robot}";

/// Kind of the files of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Tables of comma-separated values with a line of column names.
    Csv,
    /// A folder of `ros2 bag record`, with storage `mcap` or `sqlite3`, or one file of it.
    Rosbag2,
}

/// Robots of a run.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged, expecting = "a number of robots, or a list of their names")]
enum Robots {
    Count(usize),
    Names(Vec<String>),
}

/// What tells the episodes of a run apart.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(untagged, expecting = "a length in seconds, the name of a column, or a list of [begin, end]")]
pub enum Episodes {
    /// Length of the pieces into which the run is cut \[s\].
    Every(f64),
    /// Column of the poses' table, whose value changes from one episode to the next.
    Column(String),
    /// Begin and end of each episode \[s\], from the first pose on.
    Spans(Vec<[f64; 2]>),
}

/// Frame in which a velocity is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Frame {
    /// Axes of the poses.
    World,
    /// Axes of the robot: x ahead, y to the left.
    Body,
}

/// Time that counts for a message of a bag.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stamps {
    /// Time at which the recorder received it.
    #[default]
    Bag,
    /// Time in the message's own header.
    Header,
}

/// Topics of a bag: a template for all robots, or one topic for each.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged, expecting = "a topic with {robot} in it, or a list with a topic of each robot")]
enum Topics {
    Template(String),
    List(Vec<String>),
}

/// Units of the numbers in a CSV file.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Units {
    /// Unit of lengths, also of those in speeds; metres by default.
    #[serde(default)]
    pub length: Length,
    /// Unit of angles, also of those in rates; radians by default.
    #[serde(default)]
    pub angle: Angle,
    /// Unit of times; seconds by default.
    #[serde(default)]
    pub time: TimeUnit,
}

/// Unit of lengths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Length {
    /// Metres.
    #[default]
    M,
    /// Centimetres.
    Cm,
    /// Millimetres.
    Mm,
}

/// Unit of angles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Angle {
    /// Radians.
    #[default]
    Rad,
    /// Degrees.
    Deg,
}

/// Unit of times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// Seconds.
    #[default]
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

/// Place of the run's axes in the arena: a point is turned by `turn_rad` and then moved by `move_m`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axes {
    /// Rotation, counter-clockwise \[rad\].
    #[serde(default)]
    pub turn_rad: f64,
    /// Translation after the rotation \[m\].
    #[serde(default)]
    pub move_m: [f64; 2],
}

/// Limits of the robots' drive, which a fit takes as given; a field that is absent is no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Largest speed \[m/s\].
    pub speed_m_s: Option<f64>,
    /// Largest acceleration along each axis \[m/s^2\].
    pub axis_m_s2: Option<f64>,
    /// Largest acceleration in any direction \[m/s^2\].
    pub total_m_s2: Option<f64>,
}

/// Table `poses`: where the robots were.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseFields {
    time: Option<String>,
    robot: Option<String>,
    x: Option<String>,
    y: Option<String>,
    yaw: Option<String>,
    quaternion: Option<[String; 4]>,
    velocity: Option<[String; 2]>,
    velocity_frame: Option<Frame>,
    #[serde(default)]
    touches: Vec<String>,
    topic: Option<Topics>,
}

/// Table `commands`: what the robots were told to drive.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct CommandFields {
    path: Option<PathBuf>,
    frame: Option<Frame>,
    time: Option<String>,
    robot: Option<String>,
    x: Option<String>,
    y: Option<String>,
    topic: Option<Topics>,
}

/// Table `receipts`: messages between robots, and when they arrived. Always a CSV file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Receipts {
    /// CSV file with a row for each message and robot that should have received it.
    pub path: PathBuf,
    /// Column with the time at which it was sent.
    pub sent: String,
    /// Column with the time at which it was received; empty for a message that was lost.
    pub received: String,
    /// Column with the robot that sent it.
    pub sender: String,
    /// Column with the robot that should have received it.
    pub receiver: String,
    /// Unit of the times; that of `units` by default.
    pub time: Option<TimeUnit>,
}

/// The mapping as it is written.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    format: Format,
    path: PathBuf,
    robots: Robots,
    period_s: f64,
    episodes: Episodes,
    task: Option<String>,
    hull_m: Option<f32>,
    half_extent_m: Option<[f32; 2]>,
    #[serde(default)]
    stamps: Option<Stamps>,
    units: Option<Units>,
    #[serde(default)]
    axes: Axes,
    #[serde(default)]
    limits: Limits,
    poses: PoseFields,
    commands: Option<CommandFields>,
    receipts: Option<Receipts>,
}

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

/// A mapping that was checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// The file of the poses, or the bag; from the mapping's folder on.
    pub path: PathBuf,
    /// Names of the robots in the files, in the order of their ids.
    pub names: Vec<String>,
    /// Time from one step of a robot to the next, for fits \[s\].
    pub period_s: f64,
    /// What tells the episodes apart.
    pub episodes: Episodes,
    /// Name of the task, whose ground and walls are drawn; `None` for a plain ground.
    pub task: Option<String>,
    /// Radius of a robot's hull \[m\]; `None` for the task's.
    pub hull_m: Option<f32>,
    /// Half the size of the ground \[m\]; `None` for the task's, or for as much as the robots used.
    pub half_extent_m: Option<[f32; 2]>,
    /// Place of the run's axes in the arena.
    pub axes: Axes,
    /// Limits of the robots' drive.
    pub limits: Limits,
    /// Where poses and commands are.
    pub source: Source,
    /// Frame of the commands; `None` if there are none.
    pub command_frame: Option<Frame>,
    /// Where receipts of messages are; `None` if there are none.
    pub receipts: Option<Receipts>,
}

impl Mapping {
    /// Reads a mapping, and returns it with its text.
    pub fn read(path: &Path) -> Result<(Mapping, String), ImportError> {
        let wrong = |error| ImportError::Mapping { path: path.to_owned(), error };
        let bytes = regular::read(path, LONGEST).map_err(|error| ImportError::file(path, error))?;
        let text = String::from_utf8(bytes).map_err(|_| ImportError::file(path, "it is no text in UTF-8"))?;
        let mut mapping = Mapping::of_text(&text).map_err(wrong)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        mapping.path = folder.join(&mapping.path);
        if let Source::Csv(_, Some(commands), _) = &mut mapping.source {
            commands.path = folder.join(&commands.path);
        }
        if let Some(receipts) = &mut mapping.receipts {
            receipts.path = folder.join(&receipts.path);
        }
        Ok((mapping, text))
    }

    /// Reads the text of a mapping, and checks it. Paths stay as they are written. The error names the line or field.
    pub fn of_text(text: &str) -> Result<Mapping, ConfigError> {
        let fields: Fields = config::from_toml(text)?;
        let names = names(&fields.robots)?;
        in_range("period_s", fields.period_s, (0.001, 10.0))?;
        check_episodes(&fields.episodes, fields.format)?;
        fields.hull_m.map_or(Ok(()), |hull_m| in_range("hull_m", hull_m, (0.001, 100.0)))?;
        for half in fields.half_extent_m.into_iter().flatten() {
            in_range("half_extent_m", half, (0.01, 10_000.0))?;
        }
        in_range("axes.turn_rad", fields.axes.turn_rad, (-10.0, 10.0))?;
        fields.axes.move_m.iter().try_for_each(|side| in_range("axes.move_m", *side, (-1e5, 1e5)))?;
        let Limits { speed_m_s, axis_m_s2, total_m_s2 } = fields.limits;
        for (name, limit) in [("speed_m_s", speed_m_s), ("axis_m_s2", axis_m_s2), ("total_m_s2", total_m_s2)] {
            limit.map_or(Ok(()), |limit| in_range(&format!("limits.{name}"), limit, (1e-3, 1e4)))?;
        }
        let time = fields.units.as_ref().map(|units| units.time);
        let (source, command_frame) = match fields.format {
            Format::Csv => csv(&fields, names.len())?,
            Format::Rosbag2 => bag(&fields, &names)?,
        };
        Ok(Mapping {
            path: fields.path,
            names,
            period_s: fields.period_s,
            episodes: fields.episodes,
            task: fields.task,
            hull_m: fields.hull_m,
            half_extent_m: fields.half_extent_m,
            axes: fields.axes,
            limits: fields.limits,
            source,
            command_frame,
            receipts: fields.receipts.map(|receipts| Receipts { time: receipts.time.or(time), ..receipts }),
        })
    }

    /// Returns the period of steps \[ns\].
    pub fn period_ns(&self) -> i64 {
        (self.period_s * 1e9).round() as i64
    }

    /// Returns the numbers of columns or topics that `template` stands for: one for each robot.
    pub fn of_robot(template: &str, name: &str) -> String {
        template.replace(ROBOT, name)
    }
}

fn names(robots: &Robots) -> Result<Vec<String>, ConfigError> {
    let names: Vec<String> = match robots {
        Robots::Count(count) => {
            in_range("robots", *count, (1, MOST_ROBOTS))?;
            (0..*count).map(|robot| robot.to_string()).collect()
        }
        Robots::Names(names) => names.clone(),
    };
    in_range("robots", names.len(), (1, MOST_ROBOTS))?;
    let mut sorted: Vec<&String> = names.iter().collect();
    sorted.sort_unstable();
    if sorted.windows(2).any(|pair| pair[0] == pair[1]) || sorted[0].trim().is_empty() {
        return Err(ConfigError::field("robots", "two robots have one name, or one has none"));
    }
    Ok(names)
}

fn check_episodes(episodes: &Episodes, format: Format) -> Result<(), ConfigError> {
    match episodes {
        Episodes::Every(length_s) => in_range("episodes", *length_s, (0.1, 1e6)),
        Episodes::Column(_) if format == Format::Rosbag2 => {
            Err(ConfigError::field("episodes", "a bag has no columns: write a length [s], or a list of [begin, end]"))
        }
        Episodes::Column(_) => Ok(()),
        Episodes::Spans(spans) => {
            let ends: Vec<f64> = spans.iter().flatten().copied().collect();
            let sound = ends.iter().all(|end| (0.0..=1e9).contains(end)) && ends.is_sorted();
            if spans.is_empty() || !sound || spans.iter().any(|[begin, end]| begin >= end) {
                let why = "write [begin, end] of each episode [s] from the first pose on, one after the other";
                return Err(ConfigError::field("episodes", why));
            }
            Ok(())
        }
    }
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

fn csv(fields: &Fields, robots: usize) -> Result<(Source, Option<Frame>), ConfigError> {
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
    let told = CommandColumns {
        path: commands.path.clone().unwrap_or_else(|| fields.path.clone()),
        time: commands.time.clone().unwrap_or_else(|| columns.time.clone()),
        robot: commands.robot.clone().or_else(|| columns.robot.clone()),
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

fn bag(fields: &Fields, names: &[String]) -> Result<(Source, Option<Frame>), ConfigError> {
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
        Some(Topics::Template(template)) => names.iter().map(|name| Mapping::of_robot(template, name)).collect(),
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
