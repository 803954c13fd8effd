//! Training: proximal policy optimisation over many teams at once, on the very dynamics and rewards that a run
//! has, under delay, loss, asynchrony and lag from the start.
//!
//! Pure: no clock, file or actor. `trainer` is the whole; whoever drives it says how far it has come, writes what
//! it says, and stops it.

pub mod adam;
pub mod batch;
mod checkpoint;
pub mod conditions;
pub mod config;
pub mod crowd;
pub mod evaluate;
mod gradient;
mod limits;
pub mod loss;
pub mod matrix;
pub mod network;
pub mod observe;
pub mod parallel;
pub mod radio;
pub mod record;
pub mod reward;
pub mod rollout;
pub mod trainer;
pub mod update;
