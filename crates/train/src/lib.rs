//! Training: proximal policy optimisation over many teams at once, and imitation of experts. Dynamics and rewards are
//! those of a run, with delay, loss, asynchrony and lag from the start.
//!
//! Both objectives train one kind of `network`, over batches of recorded `graphs`, by the same `learner`. The code uses
//! no clock, file or actor. `trainer` is the entry point, and `imitation::trainer` that of imitation. Their caller
//! passes in the progress, writes the files, and decides when to stop.

#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod adam;
pub mod air;
pub mod batch;
pub mod channels;
mod checkpoint;
mod commands;
pub mod conditions;
pub mod config;
mod courses;
pub mod environments;
pub mod errors;
pub mod evaluate;
pub mod expectation;
pub mod experts;
mod filters;
pub mod graphs;
pub mod imitation;
pub mod learner;
mod legs;
mod limits;
pub mod loss;
pub mod matrix;
pub mod message_buffer;
pub mod network;
pub mod observe;
pub mod parallel;
mod policies;
pub mod policy;
pub mod record;
pub mod reward;
pub mod roles;
mod rolling;
pub mod rollout;
mod scale;
mod sensing;
mod settings;
mod sight;
pub mod snapshot;
mod task;
pub mod trainer;
pub mod update;
pub mod vector;
mod weights;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");
