//! Status of one host, for operators and for the state server.

use serde::{Deserialize, Serialize};

use super::body::{Body, Unfit};
use super::body::{MAX_BLOCK, REVISION};
use super::ids::{HostId, RobotId};
use super::latch::Latch;
use super::numbered::numbered;

/// States of the emergency stop that the controller and the body of one robot follow, as known to one host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Following {
    /// Number of the robot whose latches are given.
    pub robot: RobotId,
    /// Latch (emergency stop state) of the robot's controller; `None` if the controller runs on another host or has
    /// sent nothing.
    pub controller: Option<Latch>,
    /// Latch (emergency stop state) of the robot's body, the actor that drives the motors. `None` if the body runs on
    /// another host or has sent nothing.
    pub body: Option<Latch>,
}

/// Reason for which a robot keeps the state server (the team's coordinator) from granting a resume after an emergency
/// stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", from = "u8")]
pub enum Hindrance {
    /// No recent heartbeats have arrived from the robot.
    Missing,
    /// A host of the robot has announced that it shuts down, and is not back.
    Left,
    /// The robot has not yet taken over the re-arm: it still follows an earlier state of the emergency stop.
    Latched,
    /// The robot's host has messages of another revision than the state server's.
    Unequal,
    /// The robot runs another policy than that of the state server's team file.
    Policy,
    /// The robot's host has another task file than the state server's.
    Task,
    /// A reason of a later version.
    Other = 255,
}

impl Hindrance {
    /// All reasons of this version, in the order of their numbers.
    pub(crate) const ALL: [Hindrance; 6] = [
        Hindrance::Missing,
        Hindrance::Left,
        Hindrance::Latched,
        Hindrance::Unequal,
        Hindrance::Policy,
        Hindrance::Task,
    ];
}

numbered!(Hindrance);

/// Emergency stop state of the state server (the team's coordinator), with the robots that keep it from granting a
/// resume.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leading {
    /// Emergency stop state that the state server follows.
    pub latch: Latch,
    /// Robots that prevent a resume, each with the reason; empty if none does. At most the first 16 (`MAX_HINDRANCES`)
    /// are listed.
    pub hindrances: Vec<(RobotId, Hindrance)>,
}

/// Largest number of robots that the list `hindrances` of one [`Leading`] contains.
pub const MAX_HINDRANCES: usize = 16;

/// Status of one host. Operators read from it how far the robots follow the emergency stop. The state server (the
/// team's coordinator) reads from it whether the host leaves or takes part.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Number of the host that sends the status.
    pub host: HostId,
    /// Whether the host is shutting down: its robots stand, and the host will send nothing more.
    pub leaves: bool,
    /// Emergency stop states of robots of the host, in the order of robot ids: at most 64 (`MAX_BLOCK`) in one message;
    /// a host with more robots sends several.
    pub robots: Vec<Following>,
    /// Emergency stop state of the state server, sent by the host that runs it; `None` from every other host.
    pub leading: Option<Leading>,
    /// Revision of the host's messages: see [`REVISION`]; 0 in records from before there were any.
    #[serde(default)]
    pub revision: u16,
}

impl Status {
    /// Makes the status of a host of this revision, from the fields of these names.
    pub fn of(host: HostId, leaves: bool, robots: Vec<Following>, leading: Option<Leading>) -> Status {
        Status { host, leaves, robots, leading, revision: REVISION }
    }
}

impl Body for Status {
    fn robot(&self) -> RobotId {
        self.robots.first().map_or(RobotId(0), |following| following.robot)
    }

    fn check(&self) -> Result<(), Unfit> {
        let hindrances = self.leading.as_ref().map_or(0, |leading| leading.hindrances.len());
        if self.robots.len() > MAX_BLOCK || hindrances > MAX_HINDRANCES { Err(Unfit::Length) } else { Ok(()) }
    }

    fn author(&self) -> Option<HostId> {
        Some(self.host)
    }
}
