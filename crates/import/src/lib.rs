//! Runs from elsewhere as records: poses, commands and receipts in CSV files or in a bag of ROS 2 (`rosbag2`), and a
//! mapping that says what is where. docs/lab-run.md is a guide.
//!
//! [`mapping`] is the mapping. The files are read into [`samples`], made into [`steps`] at the period of a fit, and
//! written as a [`mod@record`].

#![deny(clippy::print_stdout, clippy::print_stderr)]

mod bag;
pub mod error;
pub mod mapping;
pub mod record;
pub mod samples;
pub mod steps;
mod tables;

use std::path::Path;
use std::sync::Arc;

use murmurate::config::ConfigError;
use murmurate::registry::Registry;
use murmurate::scenario::{Scenario, Settings, task_file};
use murmurate_record::topics::Stage;

pub use error::ImportError;
use mapping::{Mapping, Source};
use samples::Samples;
use steps::Steps;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// A run that was read from the files of another program.
pub struct Imported {
    /// Mapping by which it was read.
    pub mapping: Mapping,
    /// Text of the mapping.
    pub text: String,
    /// States of the robots at the period of the mapping.
    pub steps: Steps,
    /// Poses, commands and receipts of the files.
    pub samples: Samples,
    /// Robots, hosts and ground, for pictures.
    pub stage: Stage,
}

/// Reads a run by the mapping in the file `path`. The error is one line that names the file, and its line or field.
pub fn read(path: &Path, registry: &Registry) -> Result<Imported, ImportError> {
    let (mapping, text) = Mapping::read(path)?;
    let wrong = |error| ImportError::Mapping { path: path.to_owned(), error };
    let scenario = scenario(path, &mapping, registry).map_err(wrong)?;
    let mut samples = Samples::of(mapping.names.len());
    match &mapping.source {
        Source::Csv(poses, commands, units) => {
            tables::poses(&mapping, (poses, units), &mut samples)?;
            if let Some(commands) = commands {
                tables::commands((commands, units), &mapping.names, &mut samples)?;
            }
        }
        Source::Bag(poses, commands, stamps, velocity_frame) => {
            let wanted = bag::Wanted::of((poses, commands.as_deref()), *stamps, *velocity_frame);
            bag::read(&mapping.path, &wanted, &mut samples)?;
        }
    }
    if let Some(receipts) = &mapping.receipts {
        tables::receipts(receipts, &mapping.names, &mut samples)?;
    }
    let steps = steps::of(&mapping, &mut samples).map_err(|(field, why)| wrong(ConfigError::field(field, why)))?;
    let stage = record::stage(&mapping, &steps, scenario.as_deref());
    Ok(Imported { mapping, text, steps, samples, stage })
}

/// Returns the task that the mapping in the file `path` names, a task file from the mapping's folder on; `None` if it
/// names none. The task is only drawn, so one that is not for as many robots is made for its own number.
fn scenario(path: &Path, mapping: &Mapping, registry: &Registry) -> Result<Option<Arc<dyn Scenario>>, ConfigError> {
    let Some(task) = &mapping.task else { return Ok(None) };
    let file = path.parent().filter(|_| task_file::is_task_file(task)).map(|folder| folder.join(task));
    let name = file.as_ref().map_or(task.into(), |file| file.to_string_lossy());
    let own = Settings { hull_m: mapping.hull_m, ..Settings::default() };
    let made = registry.scenario(&name, &Settings { robots: Some(mapping.names.len()), ..own });
    let made = made.or_else(|error| registry.scenario(&name, &own).map_err(|_| error));
    made.map(Some).map_err(|error| ConfigError::field("task", error.to_string()))
}
