//! Telemetry: the condition of a host's robots for observers, and the request of an observer for it.

use serde::{Deserialize, Serialize};

use super::geometry::Pose;
use super::ids::{HostId, RobotId};
use super::phase::Phase;

/// Request of an observer for telemetry, to every host, once a second. It changes nothing else.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Observe {
    /// The observer.
    pub by: HostId,
}

/// Condition of a robot's hardware, as reported by its driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", try_from = "u8")]
pub enum Health {
    /// The hardware follows its commands.
    Ready,
    /// The hardware answers and reports a fault.
    Faulty,
    /// The hardware does not answer.
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

/// Last measured pose of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    /// Measured pose.
    pub pose: Pose,
    /// Time since it arrived \[ms\].
    pub age_ms: u32,
}

/// Condition of one robot, as far as one host knows it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Condition {
    /// The robot.
    pub robot: RobotId,
    /// Phase of the episode; from the host that runs its agent.
    pub phase: Option<Phase>,
    /// Last measured pose; from the same host.
    pub seen: Option<Seen>,
    /// Condition of its hardware; from the host that drives its motors.
    pub health: Option<Health>,
    /// Battery charge \[%\]; from the same host.
    pub battery: Option<u8>,
}

/// Condition of some robots of a host; broadcast while there is an observer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// The host.
    pub host: HostId,
    /// Conditions of at most `MAX_CONDITIONS` of its robots.
    pub robots: Vec<Condition>,
}

/// Most robots in one `Telemetry`: 32 x 28 bytes fit into one datagram.
pub const MAX_CONDITIONS: usize = 32;
