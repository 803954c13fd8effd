//! Properties of all wire messages: their publishers and receivers, the limits of their values, and the trait that
//! each of them implements.

use super::ids::{HostId, RobotId};

/// Revision of what this program's messages mean. It is raised with any change for which hosts from before and after it
/// must not drive together: a team of unequal revisions stands, while stops, re-arms and status work among all of it.
pub const REVISION: u16 = 1;
/// Largest number of robots in one `Mode` or `Status` message. The starts and goals of so many robots take 64 x 16
/// bytes and fit into one datagram.
pub const MAX_BLOCK: usize = 64;
/// Largest number of robots in one `Mode` message that is signed, so that it fits into one datagram with its signature,
/// and with the tags and the encryption of the largest team.
pub const MAX_SIGNED_BLOCK: usize = 32;

/// Who may publish a message, by what the deployment gives to each host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Publisher {
    /// The host that measures the robot.
    Localizer,
    /// The host of the robot's Agent.
    Agent,
    /// The host that drives the robot's motors.
    Actuator,
    /// The host of the state server.
    StateServer,
    /// Any host of the team, in its own name.
    Member,
    /// Operators, each in its own name.
    Operator,
    /// Any host.
    Anyone,
}

/// Hosts that receive a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Receiver {
    /// The hosts that need the robot's readings: those of its Agent and of its motors, those that simulate other
    /// robots, and that of the judge.
    Readers,
    /// The hosts with an Agent, but not one whose only Agent is the robot's.
    OtherAgents,
    /// The host that drives the robot's motors.
    Actuator,
    /// The host of the robot's Agent, if the team has senses.
    Perceiver,
    /// The host of the state server.
    StateServer,
    /// All hosts.
    All,
    /// The hosts with an Agent or a Body, and that of the state server.
    Movers,
    /// The hosts that measure robots.
    Localizers,
    /// No host of the team.
    Nobody,
}

/// Content of a wire message, of any kind.
pub(crate) trait Body {
    /// Returns the robot that the message is about; the first one of several, robot 0 if it is about none.
    fn robot(&self) -> RobotId {
        RobotId(0)
    }

    /// Returns the first violation of a range; `Ok` if the message may be sent and used.
    fn check(&self) -> Result<(), Unfit> {
        Ok(())
    }

    /// Returns the host in whose name the message speaks, which has to be its sender; `None` if it names none.
    fn author(&self) -> Option<HostId> {
        None
    }

    /// Returns whether the sender may say what the message says beyond its kind. `is` tells whether the sender is this
    /// publisher of that robot.
    fn is_for(&self, _is: impl Fn(Publisher, RobotId) -> bool) -> bool {
        true
    }
}

/// Reason for which a wire message is invalid and may not be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unfit {
    /// A position, velocity or feature is NaN, infinite or too large.
    #[error("a number is not finite or out of range")]
    Number,
    /// A list of the message is longer than its limit, or empty where at least one entry is needed; or a telemetry
    /// message has more than one fault reason.
    #[error("a list is empty or too long")]
    Length,
    /// The validity of a motor command exceeds `MAX_VALIDITY`, one second.
    #[error("the validity of a command is too long")]
    Validity,
    /// The block of robots of a `Mode` message goes beyond the largest robot id, 65 535.
    #[error("a block of robots exceeds the largest robot id")]
    Block,
    /// The term of a round (the number of the state server's start) is too large to be valid.
    #[error("the term of a round is out of range")]
    Term,
}
