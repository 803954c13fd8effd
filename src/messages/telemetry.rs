//! Telemetry: the condition of a host's robots for observers, and the request of an observer for it.

use serde::{Deserialize, Serialize};

use super::geometry::Pose;
use super::hardware::{Celsius, Health, Reason};
use super::ids::{HostId, RobotId};
use super::phase::Phase;

/// Request of an observer for telemetry, to every host, once a second. It changes nothing else.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Observe {
    /// The observer.
    pub by: HostId,
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    /// Temperature of its hottest part; from the same host.
    pub temperature: Option<Celsius>,
    /// Reason of its last fault while it lasts; from the same host, once a second and for one robot of a message.
    pub reason: Option<Reason>,
}

/// Condition of some robots of a host; broadcast while there is an observer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// The host.
    pub host: HostId,
    /// Conditions of at most `MAX_CONDITIONS` of its robots.
    pub robots: Vec<Condition>,
}

/// Most robots in one `Telemetry`: 32 x 31 bytes and one reason fit into one datagram.
pub const MAX_CONDITIONS: usize = 32;
