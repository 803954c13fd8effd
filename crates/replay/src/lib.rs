//! Replays of recorded runs: a host alone with its recorded inputs (`host`), or a simulation from its seed (`rerun`),
//! compared with the record message by message.
//!
//! `fitness` says which records can be replayed, and `files` holds what is attached to them while they are. `sights`
//! reads from a record what the live page shows of it.

#![deny(clippy::print_stdout, clippy::print_stderr)]

mod error;
pub mod files;
pub mod fitness;
pub mod host;
pub mod rerun;
pub mod sights;

pub use error::ReplayError;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");
