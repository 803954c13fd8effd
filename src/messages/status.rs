//! Status of one host, for operators and for the state server.

use serde::{Deserialize, Serialize};

use super::ids::{HostId, RobotId};
use super::latch::Latch;

/// Latches that one robot follows, as known to a host that runs a part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Following {
    /// The robot.
    pub robot: RobotId,
    /// Latch of its controller; none if that runs on another host or has sent nothing.
    pub controller: Option<Latch>,
    /// Latch of its body; none likewise.
    pub body: Option<Latch>,
}

/// Reason for which the state server refuses a resume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", try_from = "u8")]
pub enum Hindrance {
    /// The robot's heartbeats are missing.
    Missing,
    /// Its host has left and is not back.
    Left,
    /// It does not follow the re-arm yet.
    Latched,
}

impl From<Hindrance> for u8 {
    fn from(hindrance: Hindrance) -> u8 {
        hindrance as u8
    }
}

impl TryFrom<u8> for Hindrance {
    type Error = String;
    fn try_from(byte: u8) -> Result<Hindrance, String> {
        let all = [Hindrance::Missing, Hindrance::Left, Hindrance::Latched];
        all.get(usize::from(byte)).copied().ok_or_else(|| format!("no hindrance has the number {byte}"))
    }
}

/// The state server's latch, and the robots that keep it from granting a resume.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leading {
    /// Latch that it follows.
    pub latch: Latch,
    /// Robots that prevent a resume, the first `MAX_HINDRANCES`.
    pub hindrances: Vec<(RobotId, Hindrance)>,
}

/// Most robots that one `Leading` names.
pub const MAX_HINDRANCES: usize = 16;

/// Status of one host: to operators, how far its robots follow the emergency stop; to the state server, whether it
/// leaves or takes part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// The host.
    pub host: HostId,
    /// The host is shutting down: its robots stand, and it will send nothing more.
    pub leaves: bool,
    /// Latches of its robots: at most `MAX_BLOCK`, in the order of their ids.
    pub robots: Vec<Following>,
    /// The state server's view, on the host that runs it.
    pub leading: Option<Leading>,
}
