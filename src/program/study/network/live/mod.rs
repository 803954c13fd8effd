//! The network study measured between hosts: a coordinator says what is measured when, each participant measures.
//!
//! They talk over TCP (`line`), while the network is otherwise idle: it carries no measured message, and nothing on it
//! is timed but the clocks. The clock of each participant is compared before and after each case: of several questions
//! and answers that with the shortest way there and back counts (RFC 5905, section 8), and half of that way, with what
//! the clock has run away between the two, is how far off it may be. One-way delays are then differences of two such
//! clocks.

mod coordinator;
mod gather;
mod line;
mod participant;

pub use coordinator::{Measured, measure};
pub use participant::{Part, participate};

use std::time::Duration;

use crate::study::network::peer::{Notes, Task};
use serde::{Deserialize, Serialize};

/// How long a new connection may take for each of its first two lines, of the number and of the name.
const GREETING: Duration = Duration::from_secs(5);

/// What the coordinator says.
#[derive(Debug, Serialize, Deserialize)]
enum Instruction {
    /// Say what your clock shows.
    Clock,
    /// Measure this; it begins then on your clock \[ns\].
    Measure(Task, u64),
    /// That was all.
    Done,
}

/// What a participant says.
#[derive(Debug, Serialize, Deserialize)]
enum Answer {
    /// Its name, as the first thing.
    Host(String),
    /// What its clock shows \[ns\].
    Clock(u64),
    /// What it has found.
    Found(Notes),
}
