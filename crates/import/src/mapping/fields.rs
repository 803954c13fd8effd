//! Fields of a mapping as they are written.

use std::path::PathBuf;

use serde::Deserialize;

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
pub(super) enum Robots {
    Count(usize),
    Names(Vec<String>),
}

/// Rule by which a run is divided into episodes.
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
pub(super) enum Topics {
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
pub(super) struct PoseFields {
    pub(super) time: Option<String>,
    pub(super) robot: Option<String>,
    pub(super) x: Option<String>,
    pub(super) y: Option<String>,
    pub(super) yaw: Option<String>,
    pub(super) quaternion: Option<[String; 4]>,
    pub(super) velocity: Option<[String; 2]>,
    pub(super) velocity_frame: Option<Frame>,
    #[serde(default)]
    pub(super) touches: Vec<String>,
    pub(super) topic: Option<Topics>,
}

/// Table `commands`: what the robots were told to drive.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CommandFields {
    pub(super) path: Option<PathBuf>,
    pub(super) frame: Option<Frame>,
    pub(super) time: Option<String>,
    pub(super) robot: Option<String>,
    pub(super) x: Option<String>,
    pub(super) y: Option<String>,
    pub(super) topic: Option<Topics>,
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
pub(super) struct Fields {
    pub(super) format: Format,
    pub(super) path: PathBuf,
    pub(super) robots: Robots,
    pub(super) period_s: f64,
    pub(super) episodes: Episodes,
    pub(super) task: Option<String>,
    pub(super) hull_m: Option<f32>,
    pub(super) half_extent_m: Option<[f32; 2]>,
    #[serde(default)]
    pub(super) stamps: Option<Stamps>,
    pub(super) units: Option<Units>,
    #[serde(default)]
    pub(super) axes: Axes,
    #[serde(default)]
    pub(super) limits: Limits,
    pub(super) poses: PoseFields,
    pub(super) commands: Option<CommandFields>,
    pub(super) receipts: Option<Receipts>,
}
