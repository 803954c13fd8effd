//! Network study measured between hosts: a coordinator starts each case, the participants measure.
//!
//! They communicate over TCP (`connection`) between cases, while no measured message is in flight. The coordinator
//! compares each participant's clock before and after each case: of several requests, the one with the shortest
//! round-trip time counts (RFC 5905, section 8). The uncertainty of a clock is half of that time plus the drift during
//! the case. One-way delays are differences of two such clocks.

mod connection;
mod coordinator;
mod gather;
mod participant;

pub use coordinator::{Measured, measure};
pub use participant::{Participation, participate};

use std::time::Duration;

use crate::study::network::peer::{StationResult, Task};
use serde::{Deserialize, Serialize};

/// Timeout of each of a new connection's first two lines, the nonce and the host's name.
const GREETING: Duration = Duration::from_secs(5);

/// Request of the coordinator.
#[derive(Debug, Serialize, Deserialize)]
enum Request {
    /// Read the clock.
    Clock,
    /// Measure this case, from this time of the participant's clock \[ns\].
    Measure(Task, u64),
    /// The study is finished.
    Done,
}

/// Response of a participant.
#[derive(Debug, Serialize, Deserialize)]
enum Response {
    /// Its name, sent first.
    Host(String),
    /// Time of its clock \[ns\].
    Clock(u64),
    /// Result of a case.
    Found(StationResult),
}
