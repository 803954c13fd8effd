//! Reports of results: what a host reports while it runs, summaries and comparisons of trials with their statistics,
//! and figures, pictures and pages of them.

#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod comparison;
pub mod cost;
pub mod event;
#[cfg(feature = "figures")]
pub mod figures;
pub mod grid;
pub mod heard;
pub mod outcomes;
pub mod statistics;
pub mod summary;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");
