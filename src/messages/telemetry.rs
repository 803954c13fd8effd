//! Telemetry: the condition of a host's robots for observers, and the request of an observer for it.

use serde::{Deserialize, Deserializer, Serialize};

use super::body::REVISION;
use super::body::{Body, Publisher, Unfit};
use super::geometry::Pose;
use super::hardware::{Celsius, Health, Reason};
use super::ids::{HostId, RobotId};
use super::phase::Phase;
use super::trigger::Trigger;

/// Request of an observer (a process that watches the team) for telemetry, sent to every host once a second. The
/// request has no other effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Observe {
    /// Host number of the observer that asks.
    pub by: HostId,
}

/// Last measured pose of a robot, with its age.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    /// Measured position and heading of the robot in the world frame.
    pub pose: Pose,
    /// Time since the measurement arrived at the reporting host \[ms\].
    pub age_ms: u32,
}

/// Counts of a robot's guard, the part that stops or slows the robot for safety, since its Controller was started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GuardReport {
    /// Number of times that the guard has begun to stop or slow the robot; 65 535 stands for that number or more.
    pub acted: u16,
    /// Number of times that control ticks began to be late or missing; 65 535 stands for that number or more.
    pub late_ticks: u16,
    /// Trigger for which the guard has acted last; `None` if it has never acted, or for a trigger of a later version.
    #[serde(deserialize_with = "known")]
    pub last: Option<Trigger>,
}

/// Reads the number of a trigger; one that this version does not know is left out.
fn known<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Trigger>, D::Error> {
    Ok(Option::<u8>::deserialize(from)?.and_then(|number| Trigger::try_from(number).ok()))
}

/// Condition of one robot, as far as one host knows it. A field is `None` if the host does not know the value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Condition {
    /// Number of the robot.
    pub robot: RobotId,
    /// Phase of the episode that the robot is in, from the host that runs the robot's agent; `None` from other hosts.
    pub phase: Option<Phase>,
    /// Last measured pose, from the host that runs the robot's agent; `None` from other hosts or without a measurement.
    pub seen: Option<Seen>,
    /// Health of the hardware, from the host that drives the robot's motors; `None` from other hosts or if unknown.
    pub health: Option<Health>,
    /// Battery charge \[%\], 0 to 100, from the host that drives the robot's motors; `None` if unknown there or from
    /// other hosts.
    pub battery: Option<u8>,
    /// Temperature of the robot's hottest part, from the host that drives its motors; `None` if unknown there or from
    /// other hosts.
    pub temperature: Option<Celsius>,
    /// Reason of a hardware fault that lasts, from the host that drives the robot's motors. Each message gives at most
    /// one robot's reason, about once a second; otherwise the field is `None`.
    pub reason: Option<Reason>,
    /// How often the robot's guard has stopped or slowed it, and why last, from the host that runs the robot's agent;
    /// `None` from other hosts.
    #[serde(default)]
    pub guard: Option<GuardReport>,
    /// Time since the last message of that neighbour which has been silent longest \[ms\], from the host that runs the
    /// robot's agent. Neighbours that have been silent for 1.5 s or more are ignored. `None` if no neighbour is left,
    /// and from other hosts.
    #[serde(default)]
    pub link_age_ms: Option<u16>,
    /// Another robot whose latents contradict the tracker, as the host of this robot's agent finds; the first of
    /// several. `None` if there is none, without a tracker, and from other hosts. Each message gives at most two.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suspect: Option<RobotId>,
}

/// Conditions (such as phase, pose and battery) of the robots of one host, for observers, which are processes that
/// watch the team. A host broadcasts them while an observer asks; one with many robots needs several messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// Number of the host that sends the telemetry.
    pub host: HostId,
    /// Conditions of robots of the host, at most 24 (`MAX_CONDITIONS`) in one message.
    pub robots: Vec<Condition>,
    /// Revision of the host's messages: see [`REVISION`]; 0 in records from before there were any.
    #[serde(default)]
    pub revision: u16,
}

impl Telemetry {
    /// Makes the telemetry of a host of this revision, from the fields of these names.
    pub fn of(host: HostId, robots: Vec<Condition>) -> Telemetry {
        Telemetry { host, robots, revision: REVISION }
    }
}

/// Largest number of robots in one [`Telemetry`] message: 24 x 41 bytes and one reason fit into one datagram.
pub const MAX_CONDITIONS: usize = 24;
/// Largest number of robots in one [`Telemetry`] message whose hosts suspect another: hosts tell of two at once.
const MAX_SUSPECTS: usize = 2;

impl Body for Observe {
    fn author(&self) -> Option<HostId> {
        Some(self.by)
    }
}

impl Body for Telemetry {
    fn robot(&self) -> RobotId {
        self.robots.first().map_or(RobotId(0), |condition| condition.robot)
    }

    fn check(&self) -> Result<(), Unfit> {
        let suspects = self.robots.iter().filter(|robot| robot.suspect.is_some()).count();
        let reasons = self.robots.iter().filter(|robot| robot.reason.is_some()).count();
        match () {
            () if !self.robots.iter().filter_map(|robot| robot.seen).all(|seen| seen.pose.is_sound()) => {
                Err(Unfit::Number)
            }
            () if self.robots.len() > MAX_CONDITIONS || reasons > 1 || suspects > MAX_SUSPECTS => Err(Unfit::Length),
            () => Ok(()),
        }
    }

    fn author(&self) -> Option<HostId> {
        Some(self.host)
    }

    /// Of each robot, the host of its agent tells phase, pose and suspect, that of its motors health and battery.
    fn is_for(&self, is: impl Fn(Publisher, RobotId) -> bool) -> bool {
        self.robots.iter().all(|told| {
            let unsaid = told.phase.is_none() && told.seen.is_none() && told.suspect.is_none();
            let decided = unsaid || is(Publisher::Agent, told.robot);
            let moved = told.health.is_none() && told.battery.is_none() || is(Publisher::Actuator, told.robot);
            decided && moved
        })
    }
}
