//! Telemetry: how the robots of a host are, for whoever looks at the team; and the word by which somebody does.

use serde::{Deserialize, Serialize};

use super::geometry::Pose;
use super::ids::{HostId, RobotId};
use super::phase::Phase;

/// Somebody looks at the team: an observer, to everyone, once a second. It changes nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Observe {
    /// The observer.
    pub by: HostId,
}

/// How well a robot's hardware is, as its driver has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", try_from = "u8")]
pub enum Health {
    /// It does what it is told.
    Ready,
    /// It answers, and says that something is wrong with it.
    Faulty,
    /// It does not answer.
    Silent,
}

impl From<Health> for u8 {
    fn from(health: Health) -> u8 {
        health as u8
    }
}

impl TryFrom<u8> for Health {
    type Error = String;
    fn try_from(byte: u8) -> Result<Health, String> {
        let all = [Health::Ready, Health::Faulty, Health::Silent];
        all.get(usize::from(byte)).copied().ok_or_else(|| format!("no health has the number {byte}"))
    }
}

/// Where a robot was measured last.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    /// Where it was.
    pub pose: Pose,
    /// How long ago that has arrived \[ms\].
    pub age_ms: u32,
}

/// How one robot is, as far as one host knows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Condition {
    /// The robot.
    pub robot: RobotId,
    /// Where it is in the episode; of the host that runs its agent.
    pub phase: Option<Phase>,
    /// Where it was measured last; of the same host.
    pub seen: Option<Seen>,
    /// How well it is; of the host that its motors hang on.
    pub health: Option<Health>,
    /// What is left of its battery \[%\]; of the same host.
    pub battery: Option<u8>,
}

/// How some robots of a host are; said while an observer is there, and to nobody in particular.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// The host.
    pub host: HostId,
    /// At most `MAX_CONDITIONS` of its robots.
    pub robots: Vec<Condition>,
}

/// The most robots in one `Telemetry`: 32 x 28 bytes stay inside one datagram.
pub const MAX_CONDITIONS: usize = 32;
