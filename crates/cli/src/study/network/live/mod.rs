//! Measures the cases of a network study between hosts: a coordinator starts the cases, and participants send and count
//! messages.
//!
//! Coordinator and participants communicate over TCP (`connection`) between cases, so that this traffic does not
//! disturb measured messages. The coordinator compares each participant's clock before and after each case, using the
//! request with the shortest round trip (RFC 5905, section 8). The uncertainty of a clock is half of that round trip
//! plus the drift during the case. One-way delays are differences of two such clocks.

mod connection;
mod coordinator;
mod gather;
mod participant;

pub use coordinator::{Measured, measure};
pub use participant::{Participation, participate};

use std::time::Duration;

use murmurate_study::network::peer::{StationResult, Task};
use serde::{Deserialize, Serialize};

/// Longest time for the arrival of each of a new connection's first two lines: the nonce and the host's name.
const GREETING: Duration = Duration::from_secs(5);

/// Message from the coordinator of a measurement to a participant.
#[derive(Debug, Serialize, Deserialize)]
enum Request {
    /// Asks for the time of the participant's clock.
    Clock,
    /// Asks to measure a case, which starts at this time of the participant's clock \[ns\].
    Measure(Task, u64),
    /// Tells the participant that the measurement is over.
    Done,
}

/// Message from a participant of a measurement to the coordinator.
#[derive(Debug, Serialize, Deserialize)]
enum Response {
    /// Name of the participant's host, sent first.
    Host(String),
    /// Time of the participant's clock \[ns\].
    Clock(u64),
    /// Result of the measured case at the participant's station.
    Found(StationResult),
}
