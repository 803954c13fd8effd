//! The processes of a team on one machine: `supervisor` starts, restarts and ends them together, and `results` collects
//! the events that they report. The caller provides their commands, and shows the events of the run.

#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod outcome;
pub mod results;
pub mod supervisor;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");
