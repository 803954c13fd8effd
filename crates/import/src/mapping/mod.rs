//! The mapping: a TOML file that says what the columns or topics of a run are. docs/lab-run.md lists its fields.

mod fields;
mod sources;

use std::path::{Path, PathBuf};

use murmurate::config::{self, ConfigError, in_range, regular};

use crate::error::ImportError;
pub use fields::{Angle, Axes, Episodes, Format, Frame, Length, Limits, Receipts, Stamps, TimeUnit, Units};
use fields::{Fields, Robots};
pub use sources::{CommandColumns, HeadingColumns, PoseColumns, Source, of_robot};
use sources::{bag, csv};

/// Longest mapping \[bytes\].
const LONGEST: u64 = 256 << 10;
/// Most robots of a run.
const MOST_ROBOTS: usize = 2000;
/// A mapping that was checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// The file of the poses, or the bag; from the mapping's folder on.
    pub path: PathBuf,
    /// Names of the robots in the files, in the order of their ids.
    pub names: Vec<String>,
    /// Time from one step of a robot to the next, for fits \[s\].
    pub period_s: f64,
    /// Rule by which the run is divided into episodes.
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
