//! Reads poses and commands from a bag of ROS 2: a folder of rosbag2 with its `metadata.yaml`, or one file of it, with
//! storage `mcap` or `sqlite3`.

mod messages;
mod sqlite;

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use murmurate::config::regular;
use murmurate::config::shown;
use murmurate::messages::geometry::rotated;
use murmurate_record::reader::{Item, Reader};

use crate::error::ImportError;
use crate::mapping::{Frame, Stamps};
use crate::samples::{Command, Pose, Samples};
use messages::{COMMANDS, CommandSample, POSES};
use sqlite::{Database, Table, Value};

/// Name of the file that describes a bag.
const METADATA: &str = "metadata.yaml";
/// Longest description of a bag \[bytes\].
const LONGEST: u64 = 16 << 20;
/// Largest position and velocity in a message \[m, m/s\].
const LARGEST: f64 = 1e5;
/// First time that is too late to be one \[ns\].
const LATEST: u64 = 1 << 61;

/// Topics of a bag that are read: that of each robot's poses, and that of its commands.
pub struct Wanted<'a> {
    /// Topics of poses, by robot.
    pub poses: &'a [String],
    /// Topics of commands, by robot; empty if none are read.
    pub commands: &'a [String],
    /// Time that counts.
    pub stamps: Stamps,
    /// Frame of the velocities in odometry.
    pub velocity_frame: Frame,
}

/// Role of a topic: the poses or the commands of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Poses(usize),
    Commands(usize),
}

impl Role {
    fn field(self) -> &'static str {
        if let Role::Poses(_) = self { "poses.topic" } else { "commands.topic" }
    }

    fn kinds(self) -> &'static [&'static str] {
        if let Role::Poses(_) = self { &POSES } else { &COMMANDS }
    }
}

/// Message of a bag.
struct BagMessage<'a> {
    topic: &'a str,
    kind: &'a str,
    at_ns: u64,
    data: &'a [u8],
}

/// Collects the samples of a bag.
struct Reading<'a> {
    wanted: &'a Wanted<'a>,
    roles: BTreeMap<&'a str, Role>,
    /// Topics of the bag that were seen, each with its type.
    topics: BTreeMap<String, String>,
    samples: &'a mut Samples,
    /// Number of messages of each topic that were read.
    counts: BTreeMap<String, u64>,
}

/// Reads the poses and commands of a bag. `path` is its folder or one of its files.
pub fn read(path: &Path, wanted: &Wanted, samples: &mut Samples) -> Result<(), ImportError> {
    let poses = wanted.poses.iter().zip(0..).map(|(topic, robot)| (&**topic, Role::Poses(robot)));
    let commands = wanted.commands.iter().zip(0..).map(|(topic, robot)| (&**topic, Role::Commands(robot)));
    let roles = poses.chain(commands).collect();
    let mut reading = Reading { wanted, roles, topics: BTreeMap::new(), samples, counts: BTreeMap::new() };
    for file in files(path)? {
        match file.extension().and_then(|end| end.to_str()) {
            Some("mcap") => reading.mcap(&file)?,
            Some("db3") => reading.sqlite(&file)?,
            _ => return Err(ImportError::file(&file, "it is no file of a bag: those end in .mcap or .db3")),
        }
    }
    reading.check(path)
}

/// Returns the files of a bag, in their order.
fn files(path: &Path) -> Result<Vec<PathBuf>, ImportError> {
    if !path.metadata().map_err(|error| ImportError::file(path, error))?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let metadata = path.join(METADATA);
    let unread = |error| {
        let why = format!("{error}; a bag without it was cut: 'ros2 bag reindex' writes it, or name one of its files");
        ImportError::file(&metadata, why)
    };
    let bytes = regular::read(&metadata, LONGEST).map_err(unread)?;
    let text = String::from_utf8(bytes).map_err(|_| ImportError::file(&metadata, "it is no text in UTF-8"))?;
    let names = described(&text).map_err(|why| ImportError::file(&metadata, why))?;
    Ok(names.into_iter().map(|name| path.join(name)).collect())
}

/// Returns the names of the files that the description of a bag lists. The error names the line.
///
/// Of YAML it reads what rosbag2 writes: fields on lines of their own, and lists with a line for each entry.
fn described(text: &str) -> Result<Vec<String>, String> {
    let unquoted = |value: &str| value.trim().trim_matches(['"', '\'']).to_owned();
    let (mut names, mut listing) = (Vec::new(), false);
    for (line, number) in text.lines().zip(1..) {
        let entry = line.trim_start().strip_prefix("- ").map(unquoted);
        if let Some(name) = entry.as_ref().filter(|_| listing) {
            // A bag names no files outside of its folder.
            let plain = Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
            if name.is_empty() || !plain {
                return Err(format!("line {number}: relative_file_paths: '{name}' is no file of the bag's folder"));
            }
            if names.contains(name) {
                return Err(format!("line {number}: relative_file_paths: '{name}' is listed twice"));
            }
            names.push(name.clone());
            continue;
        }
        let Some((field, value)) = line.split_once(':') else { continue };
        listing = field.trim() == "relative_file_paths";
        match (field.trim(), unquoted(value).as_str()) {
            ("storage_identifier", "mcap" | "sqlite3") => {}
            ("storage_identifier", _) => {
                return Err(format!("line {number}: storage_identifier: only 'mcap' and 'sqlite3' are read"));
            }
            ("compression_mode", mode) if !mode.is_empty() && !mode.eq_ignore_ascii_case("none") => {
                return Err(format!("line {number}: compression_mode: rewrite it without, by 'ros2 bag convert'"));
            }
            _ => {}
        }
    }
    if names.is_empty() { Err("it lists no files: relative_file_paths is missing".to_owned()) } else { Ok(names) }
}

/// Fails if SQLite left a journal beside a database: a log of changes that are not in it yet (`-wal`), or what a change
/// that was cut off has replaced (`-journal`, which begins with zeros or is empty once the change is whole).
fn unmerged(path: &Path) -> Result<(), ImportError> {
    for (end, hot) in [("db3-wal", None), ("db3-journal", Some(0))] {
        let journal = path.with_extension(end);
        let mut first = [0];
        let read = regular::open(&journal).ok().and_then(|mut file| file.read(&mut first).ok()).unwrap_or(0);
        if read > 0 && hot != Some(first[0]) {
            let why = "it was not closed: open it once with 'sqlite3 FILE .schema', which takes it in";
            return Err(ImportError::file(&journal, why));
        }
    }
    Ok(())
}

impl Reading<'_> {
    fn mcap(&mut self, path: &Path) -> Result<(), ImportError> {
        // Its errors name the file.
        let wrong = |error: murmurate_record::reader::ReadError| {
            let why = error.to_string();
            let named = format!("'{}'", path.display());
            let why = why.trim_start_matches(&named).trim_start_matches([':', ' ']).to_owned();
            ImportError::file(path, if why.contains("no MCAP") { "it is no MCAP file".to_owned() } else { why })
        };
        let mut reader = Reader::open_one(path).map_err(wrong)?;
        if let Some(line) = reader.health().lines(0).first() {
            let why = format!("it is damaged or cut: {line}; 'record repair' keeps what is intact");
            return Err(ImportError::file(path, why));
        }
        let mut kinds = BTreeMap::new();
        while let Some(item) = reader.next_item().map_err(wrong)? {
            match item {
                Item::Schema(schema) => {
                    kinds.insert(schema.id, schema.name.clone());
                }
                Item::Channel(channel) => {
                    let kind = kinds.get(&channel.schema).cloned().unwrap_or_default();
                    self.topics.insert(channel.topic.clone(), kind);
                }
                Item::Message(message) => {
                    let kind = kinds.get(&message.channel.schema).map_or("", |kind| kind);
                    let (topic, data) = (&*message.channel.topic, &*message.data);
                    self.take(path, &BagMessage { topic, kind, at_ns: message.at, data })?;
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn sqlite(&mut self, path: &Path) -> Result<(), ImportError> {
        let wrong = |error: sqlite::SqliteError| ImportError::file(path, error);
        unmerged(path)?;
        let file = regular::open(path).map_err(|error| ImportError::file(path, error))?;
        let mut database = Database::open(file).map_err(wrong)?;
        let mut table = |name: &str, columns: &[&str]| -> Result<(Table, Vec<usize>), ImportError> {
            let found = database.table(name).map_err(wrong)?;
            let found = found.ok_or_else(|| ImportError::file(path, format!("it has no table '{name}'")))?;
            let place = |column: &&str| {
                let at = found.columns.iter().position(|own| own == column);
                at.ok_or_else(|| ImportError::file(path, format!("its table '{name}' has no column '{column}'")))
            };
            let places = columns.iter().map(place).collect::<Result<_, _>>()?;
            Ok((found, places))
        };
        let (topics, of_topics) = table("topics", &["name", "type", "serialization_format"])?;
        let (messages, of_messages) = table("messages", &["topic_id", "timestamp", "data"])?;
        let mut named: BTreeMap<i64, (String, String)> = BTreeMap::new();
        let mut failed = None;
        database
            .rows(&topics, &mut |number, cells| {
                let text = |at: usize| cells.get(of_topics[at]).and_then(Value::text);
                let (Some(name), Some(kind), format) = (text(0), text(1), text(2)) else {
                    failed = Some(format!("table 'topics': row {number}: it has no name or type"));
                    return false;
                };
                if format != Some("cdr") && self.roles.contains_key(name) {
                    failed = Some(format!("table 'topics': row {number}: its messages are not in CDR"));
                }
                named.insert(number, (name.to_owned(), kind.to_owned()));
                failed.is_none()
            })
            .map_err(wrong)?;
        if let Some(why) = failed {
            return Err(ImportError::file(path, why));
        }
        self.topics.extend(named.values().cloned());
        let mut failed = None;
        database
            .rows(&messages, &mut |number, cells| {
                let cell = |at: usize| cells.get(of_messages[at]);
                let topic = cell(0).and_then(Value::integer).and_then(|id| named.get(&id));
                if topic.is_some_and(|(topic, _)| !self.roles.contains_key(&**topic)) {
                    return true;
                }
                if cell(2) == Some(&Value::Unread) {
                    let why = format!("table 'messages': row {number}: it is longer than 64 MiB");
                    failed = Some(ImportError::file(path, why));
                    return false;
                }
                let time = cell(1).and_then(Value::integer).and_then(|time| u64::try_from(time).ok());
                let (Some((topic, kind)), Some(at_ns), Some(Value::Bytes(data))) = (topic, time, cell(2)) else {
                    let why = format!("table 'messages': row {number}: it has no topic, time or data");
                    failed = Some(ImportError::file(path, why));
                    return false;
                };
                failed = self.take(path, &BagMessage { topic, kind, at_ns, data }).err();
                failed.is_none()
            })
            .map_err(wrong)?;
        failed.map_or(Ok(()), Err)
    }

    /// Takes a message, if its topic is wanted.
    fn take(&mut self, path: &Path, message: &BagMessage) -> Result<(), ImportError> {
        let BagMessage { topic, kind, at_ns, data } = *message;
        let Some(role) = self.roles.get(topic).copied() else { return Ok(()) };
        if !role.kinds().contains(&kind) {
            let (field, kinds) = (role.field(), role.kinds().join(", "));
            let why = format!("{field}: '{topic}' has messages of the type {kind}; these can be read: {kinds}");
            return Err(ImportError::file(path, why));
        }
        let count = self.counts.entry(topic.to_owned()).or_default();
        *count += 1;
        let number = *count;
        let wrong =
            |why: &str| ImportError::file(path, format!("message {number} of '{}': {why}", shown::value(topic)));
        if !self.samples.count() {
            return Err(wrong("there are more than can be read: cut the bag"));
        }
        let of = |stamp_ns: u64| match self.wanted.stamps {
            Stamps::Bag => Ok(at_ns),
            Stamps::Header if stamp_ns > 0 => Ok(stamp_ns),
            Stamps::Header => Err("it has no stamp: write stamps = \"bag\""),
        };
        let time = |stamp_ns: u64| {
            let at_ns = of(stamp_ns)?;
            i64::try_from(at_ns).ok().filter(|_| at_ns < LATEST).ok_or("its time is none of a clock")
        };
        let small = |numbers: [f64; 2]| numbers.iter().all(|number| number.abs() <= LARGEST);
        match role {
            Role::Poses(robot) => {
                let pose = messages::pose(kind, data).map_err(&wrong)?;
                let at_ns = time(pose.stamp_ns).map_err(&wrong)?;
                let velocity = pose.twist.and_then(|twist| {
                    let turn = if self.wanted.velocity_frame == Frame::Body { pose.yaw? } else { 0.0 };
                    Some(<[f64; 2]>::from(rotated(turn, twist.x, twist.y)))
                });
                let position = [pose.x, pose.y];
                if !small(position) || velocity.is_some_and(|velocity| !small(velocity)) {
                    return Err(wrong("its numbers are too large"));
                }
                let (yaw, label) = (pose.yaw, Some(0));
                self.samples.poses[robot].push(Pose { at_ns, position, yaw, velocity, touches: false, label });
            }
            Role::Commands(robot) => {
                let CommandSample { stamp_ns, velocity } = messages::command(kind, data).map_err(&wrong)?;
                let at_ns = time(stamp_ns).map_err(&wrong)?;
                if !small(velocity) {
                    return Err(wrong("its numbers are too large"));
                }
                self.samples.commands[robot].push(Command { at_ns, velocity });
            }
        }
        Ok(())
    }

    /// Fails if a topic that the mapping names is not in the bag.
    fn check(&self, path: &Path) -> Result<(), ImportError> {
        let absent = self.roles.iter().find(|(topic, _)| !self.topics.contains_key(**topic));
        let Some((topic, role)) = absent else { return Ok(()) };
        let there: Vec<&str> = self.topics.keys().take(40).map(String::as_str).collect();
        let there = if there.is_empty() { "no others".to_owned() } else { there.join(", ") };
        let why = format!("{}: there is no topic '{topic}'; there are: {there}", role.field());
        Err(ImportError::file(path, why))
    }
}

impl<'a> Wanted<'a> {
    /// Returns what a mapping wants of its bag.
    pub fn of(
        (poses, commands): (&'a [String], Option<&'a [String]>),
        stamps: Stamps,
        velocity_frame: Option<Frame>,
    ) -> Wanted<'a> {
        let velocity_frame = velocity_frame.unwrap_or(Frame::Body);
        Wanted { poses, commands: commands.unwrap_or_default(), stamps, velocity_frame }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_a_bag_lists_twice_is_refused_with_its_line() {
        let text = "rosbag2_bagfile_information:\n  relative_file_paths:\n    - a.db3\n    - b.db3\n";
        assert_eq!(described(text), Ok(vec!["a.db3".to_owned(), "b.db3".to_owned()]));
        let why = described(&text.replace("b.db3", "a.db3")).expect_err("twice");
        assert!(why.contains("line 4") && why.contains("twice"), "{why}");
    }

    #[test]
    fn a_bag_that_is_absent_is_said_to_be() {
        let why = files(Path::new("/nowhere/bag")).expect_err("it is absent").to_string();
        assert!(why.contains("/nowhere/bag") && why.contains("No such file"), "{why}");
    }

    #[test]
    fn a_journal_beside_a_database_is_refused_unless_its_change_is_whole() {
        let folder = tempfile::TempDir::new().expect("a folder");
        let bag = folder.path().join("bag.db3");
        let with = |end: &str, bytes: &[u8]| {
            let journal = bag.with_extension(end);
            std::fs::write(&journal, bytes).expect("the folder is there");
            let result = unmerged(&bag);
            std::fs::remove_file(&journal).expect("it is there");
            result.is_ok()
        };
        assert!(unmerged(&bag).is_ok() && with("db3-wal", &[]) && with("db3-journal", &[]));
        assert!(with("db3-journal", &[0; 28]) && !with("db3-journal", &[0xd9, 0xd5]) && !with("db3-wal", &[0x37]));
    }
}
