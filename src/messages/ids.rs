//! Numbers of robots, hosts and links: small integers, fixed width on the wire.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A robot of the team, counted from zero without gaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RobotId(pub u16);

/// A host: one process with one Network. Its number is its index in the deployment, or that of an operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct HostId(pub u16);

/// A link: its number is its index in the deployment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct LinkId(pub u16);

/// First number of an operator; hosts of a deployment have smaller ones.
const FIRST_OPERATOR: u16 = 0xc000;

impl HostId {
    /// Count of numbers for operators.
    pub const OPERATORS: u16 = u16::MAX - FIRST_OPERATOR;

    /// Returns the operator with this number, modulo their count. An operator is in no deployment; every process that
    /// acts as one draws its number anew.
    pub const fn operator(number: u16) -> HostId {
        HostId(FIRST_OPERATOR + number % HostId::OPERATORS)
    }

    /// Whether this is an operator and not a host of a deployment.
    pub const fn is_operator(self) -> bool {
        self.0 >= FIRST_OPERATOR
    }
}

impl RobotId {
    /// Index of the robot in per-robot tables.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// Returns all robots of a team of `count`.
    pub fn team(count: usize) -> impl Iterator<Item = RobotId> {
        (0..count).map(|index| RobotId(u16::try_from(index).expect("a team has at most 65 535 robots")))
    }
}

impl fmt::Display for RobotId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "robot {}", self.0)
    }
}
