//! The processes of a team on one machine: starts, restarts and ends them together. The caller provides their commands
//! and interprets their output.

#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod outcome;
pub mod supervisor;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");
