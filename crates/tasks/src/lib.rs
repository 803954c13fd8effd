//! Tasks of robot teams, with their ground truth and scripted baselines. The code is pure: it uses no clock, file or
//! socket, and random numbers come from a stream that the caller passes.

pub mod coverage;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");
