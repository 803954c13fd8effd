//! Numbers of robots, hosts and links: small integers, fixed width on the wire.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Number of a robot in its team. The robots of a team are numbered from 0 without gaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RobotId(pub u16);

/// Number of a host, which is one process on the team's network. Hosts of a deployment are numbered by their index in
/// the deployment; operators have numbers from 49152 (0xc000).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct HostId(pub u16);

/// Number of a link, a network connection between hosts: the link's index in the deployment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct LinkId(pub u16);

/// Smallest host number of an operator, a process outside the deployment; hosts of a deployment have smaller numbers.
const FIRST_OPERATOR: u16 = 0xc000;

impl HostId {
    /// Count of the host numbers that are reserved for operators, which are processes outside the deployment that give
    /// orders or observe.
    pub const OPERATORS: u16 = u16::MAX - FIRST_OPERATOR;

    /// Returns the host number of an operator, a process outside the deployment that gives orders or observes.
    /// `number`, which each operator process draws at random, is reduced modulo `OPERATORS` (16 383).
    pub const fn operator(number: u16) -> HostId {
        HostId(FIRST_OPERATOR + number % HostId::OPERATORS)
    }

    /// Whether this number is that of an operator, a process outside the deployment, and not of a host of a deployment.
    pub const fn is_operator(self) -> bool {
        self.0 >= FIRST_OPERATOR
    }
}

impl RobotId {
    /// Returns the robot's number as an index into tables with one entry for each robot.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// Iterates over the robots 0 to `count` - 1, which form a team. Panics if a number exceeds 65 535.
    pub fn team(count: usize) -> impl Iterator<Item = RobotId> {
        (0..count).map(|index| RobotId(u16::try_from(index).expect("a team has at most 65 535 robots")))
    }
}

impl fmt::Display for RobotId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "robot {}", self.0)
    }
}
