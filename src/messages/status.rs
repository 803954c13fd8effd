//! Status: what one host says of itself, to operators and to the state server.

use serde::{Deserialize, Serialize};

use super::ids::{HostId, RobotId};
use super::latch::Latch;

/// How one robot follows the emergency stop, as a host knows it that runs a part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Following {
    /// The robot.
    pub robot: RobotId,
    /// The latch that its controller follows; none where that runs elsewhere or says nothing.
    pub controller: Option<Latch>,
    /// The same of its body.
    pub body: Option<Latch>,
}

/// Why the state server refuses a resume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", try_from = "u8")]
pub enum Hindrance {
    /// The robot is silent.
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

/// The state server's view of the emergency stop, and of what keeps it from granting a resume.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leading {
    /// The latch that it follows.
    pub latch: Latch,
    /// The robots that stand in the way of a resume, the first `MAX_HINDRANCES`.
    pub hindrances: Vec<(RobotId, Hindrance)>,
}

/// The most robots that are named in one `Leading`.
pub const MAX_HINDRANCES: usize = 16;

/// One host's word of itself: to operators, how far its robots follow the emergency stop; to the state server, that
/// it leaves or is here.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// The host.
    pub host: HostId,
    /// It has been told to end: its robots stand, and it will not be heard any more.
    pub leaves: bool,
    /// Its robots: at most `MAX_BLOCK`, in the order of their ids.
    pub robots: Vec<Following>,
    /// Where it runs the state server.
    pub leading: Option<Leading>,
}
