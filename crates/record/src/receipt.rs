//! Messages of the topic `/receipts` of an imported record: what was sent between two robots, and when it arrived.

use serde::{Deserialize, Serialize};

/// A message that one robot has sent to another, with the times of both ends, each on the clock of its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Receipt {
    /// Id of the robot that sent it.
    pub from: u16,
    /// Id of the robot that should have received it.
    pub to: u16,
    /// Time at which it was sent \[ns\], on the time axis of the record's messages.
    pub sent_ns: i64,
    /// Time at which it was received \[ns\]; `None` if it was lost.
    pub received_ns: Option<i64>,
}
