//! The table of the kinds of wire messages: who publishes each kind, for whom, and how it travels.
//!
//! Routing, permission, the codec, the routes of operators and the table in docs/wire.md derive from it. A new kind is
//! a line here, a struct with `Body`, and the actors that send and receive it.

use serde::de::{Deserialize, DeserializeSeed, Deserializer};
use serde::{Deserialize as Read, Serialize};

use super::aloft::Aloft;
use super::body::{Body, Publisher, Receiver, Unfit};
use super::exchange::{Latent, MotorCommand, Reading};
use super::ids::{HostId, RobotId};
use super::leading::{Heartbeat, Mode, Stop};
use super::place::{Located, Place};
use super::release::Release;
use super::sensed::Sensed;
use super::status::Status;
use super::telemetry::{Observe, Telemetry};

/// Line of the table: how messages of one kind are published, routed and sent.
#[derive(Clone, Copy, Debug)]
struct Row {
    publisher: Publisher,
    receiver: Receiver,
    and_operators: bool,
    soft: bool,
    with_the_stop: bool,
    signed: bool,
    across_hops: bool,
}

const fn row(publisher: Publisher, receiver: Receiver) -> Row {
    let (and_operators, soft, with_the_stop, signed, across_hops) = (false, false, false, false, false);
    Row { publisher, receiver, and_operators, soft, with_the_stop, signed, across_hops }
}

impl Row {
    /// Operators on any machine receive it, too.
    const fn and_operators(self) -> Row {
        Row { and_operators: true, ..self }
    }

    /// It is soft state, which waits for a datagram with data.
    const fn soft(self) -> Row {
        Row { soft: true, ..self }
    }

    /// It travels on the link of the emergency stop, whatever a deployment says.
    const fn with_the_stop(self) -> Row {
        Row { with_the_stop: true, ..self }
    }

    /// It is signed by its publisher where members have keys of their own.
    const fn signed(self) -> Row {
        Row { signed: true, ..self }
    }

    /// Hosts of a mesh pass it on, as an entry with the proof of its publisher.
    const fn across_hops(self) -> Row {
        Row { across_hops: true, ..self }
    }
}

/// Defines the kinds from the lines of the table, in the order of their numbers on the wire.
macro_rules! kinds {
    ($($(#[$doc:meta])* $kind:ident = $row:expr;)*) => {
        /// A message that may cross hosts, of any kind. Each variant names the sending and receiving actors.
        #[derive(Clone, Debug, PartialEq, Serialize)]
        #[serde(untagged)]
        pub enum Wire {
            $($(#[$doc])* $kind($kind),)*
        }

        /// Kind of a wire message. The routing table of a deployment names messages by their kind.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Read)]
        #[serde(rename_all = "kebab-case")]
        pub enum Kind {
            $($(#[$doc])* $kind,)*
        }

        /// All kinds of wire messages, in the order of their numbers on the wire.
        pub const KINDS: [Kind; [$(Kind::$kind),*].len()] = [$(Kind::$kind),*];

        const ROWS: [Row; KINDS.len()] = [$($row),*];

        impl Wire {
            /// Returns the kind of this message, as used by routing tables.
            pub fn kind(&self) -> Kind {
                match self {
                    $(Wire::$kind(_) => Kind::$kind,)*
                }
            }

            /// Returns the robot that sends the message, is measured in it or is commanded by it. For `Mode`, `Status`,
            /// `Telemetry` and `Located` it is the first robot of the message's list; for `Stop`, `Observe` and an
            /// empty list, robot 0.
            pub fn robot(&self) -> RobotId {
                match self {
                    $(Wire::$kind(body) => body.robot(),)*
                }
            }

            /// Checks that the message's numbers and list lengths are in range, and returns the first violation found.
            /// The sending and the receiving host both check each message.
            pub fn check(&self) -> Result<(), Unfit> {
                match self {
                    $(Wire::$kind(body) => body.check(),)*
                }
            }

            /// Returns whether the host `sender` may publish the message; `is` tells whether it is this publisher of
            /// that robot.
            pub(crate) fn is_permitted(&self, sender: HostId, is: impl Fn(Publisher, RobotId) -> bool) -> bool {
                match self {
                    $(Wire::$kind(body) => {
                        let named = body.author().is_none_or(|author| author == sender);
                        named && is(Kind::$kind.publisher(), body.robot()) && body.is_for(is)
                    })*
                }
            }
        }

        /// Reads the body of a message of this kind.
        impl<'de> DeserializeSeed<'de> for Kind {
            type Value = Wire;

            fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<Wire, D::Error> {
                match self {
                    $(Kind::$kind => <$kind as Deserialize>::deserialize(from).map(Wire::$kind),)*
                }
            }
        }
    };
}

kinds! {
    /// Measurement of a robot's pose and velocity, from the Localizer that measures the robot to its Cache and other
    /// users.
    Reading = row(Publisher::Localizer, Receiver::Readers);
    /// Features of a robot's policy and its motion, from the robot's Agent to the Caches of its neighbours.
    Latent = row(Publisher::Agent, Receiver::OtherAgents);
    /// Velocity command, from a robot's Controller to its Body.
    MotorCommand = row(Publisher::Agent, Receiver::Actuator);
    /// Progress of a robot in the episode, from the robot's Controller to the state server.
    Heartbeat = row(Publisher::Agent, Receiver::StateServer).soft().across_hops();
    /// Instruction for the team's episode, from the state server (the team's coordinator) to every host.
    Mode = row(Publisher::StateServer, Receiver::All).soft().signed().across_hops();
    /// Emergency stop, re-arm or resume, from an operator or any host to every host.
    Stop = row(Publisher::Anyone, Receiver::Movers).signed();
    /// Emergency stop states of a host's robots, from the host to operators and the state server.
    Status = row(Publisher::Member, Receiver::StateServer).and_operators().with_the_stop().across_hops();
    /// Request for telemetry, from an observer to every host.
    Observe = row(Publisher::Operator, Receiver::Movers).with_the_stop();
    /// Conditions of a host's robots, from the host to observers.
    Telemetry = row(Publisher::Member, Receiver::Nobody).and_operators().soft().with_the_stop();
    /// Statement of where a robot is, from an operator to the Localizer that measures the robot.
    Place = row(Publisher::Operator, Receiver::Localizers).with_the_stop();
    /// Robots whose poses are unknown, from the Localizer that measures them to Controllers, the state server and
    /// operators.
    Located = row(Publisher::Member, Receiver::Movers).and_operators().with_the_stop();
    /// Signed re-arm or resume, from an operator to every host, and repeated by the state server.
    Release = row(Publisher::Anyone, Receiver::Movers).with_the_stop().across_hops();
    /// Values of a sense of a robot, such as a scan of its lidar, from the host of its Body to its Cache.
    Sensed = row(Publisher::Actuator, Receiver::Perceiver);
    /// State of the flight of a robot that flies, from its Body to its Controller and operators.
    Aloft = row(Publisher::Actuator, Receiver::Movers).and_operators().with_the_stop();
}

impl Kind {
    fn row(self) -> &'static Row {
        &ROWS[self as usize]
    }

    /// Returns who may publish messages of this kind.
    pub fn publisher(self) -> Publisher {
        self.row().publisher
    }

    /// Returns which hosts receive messages of this kind.
    pub fn receiver(self) -> Receiver {
        self.row().receiver
    }

    /// Whether messages of this kind are sent even if no host receives them, since operators on any machine do.
    pub fn is_for_operators(self) -> bool {
        self.row().and_operators
    }

    /// Whether operators use messages of this kind if their link carries them: all but those between two hosts, and
    /// those that only operators publish.
    pub(crate) fn interests_operators(self) -> bool {
        self.publisher() != Publisher::Operator && self.receiver() != Receiver::Actuator
    }

    /// Whether operators publish messages of this kind.
    pub(crate) fn is_of_operators(self) -> bool {
        matches!(self.publisher(), Publisher::Operator | Publisher::Anyone)
    }

    /// Whether messages of this kind are soft state, which is repeated and may wait for a datagram with data.
    pub fn is_soft(self) -> bool {
        self.row().soft
    }

    /// Whether messages of this kind always travel on the link that carries the emergency stop, so that a deployment
    /// does not list them.
    pub fn follows_the_stop(self) -> bool {
        self.row().with_the_stop
    }

    /// Whether messages of this kind are signed by their publisher, and believed with its signature alone, where
    /// members have keys of their own.
    pub fn is_signed(self) -> bool {
        self.row().signed
    }

    /// Whether hosts of a mesh pass messages of this kind on, as entries.
    pub fn crosses_hops(self) -> bool {
        self.row().across_hops
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn publisher(kind: Kind) -> &'static str {
        match kind.publisher() {
            Publisher::Localizer => "host that measures the robot",
            Publisher::Agent => "host of the robot's agent",
            Publisher::Actuator => "host that drives the robot's motors",
            Publisher::StateServer => "host of the state server",
            Publisher::Member => "any host of the team, in its own name",
            Publisher::Operator => "operators, each in its own name",
            Publisher::Anyone => "anyone",
        }
    }

    fn receiver(kind: Kind) -> &'static str {
        match kind.receiver() {
            Receiver::Readers => "hosts of its agent and motors, simulators of others, the judge",
            Receiver::OtherAgents => "hosts of other agents",
            Receiver::Actuator => "host that drives the robot's motors",
            Receiver::Perceiver => "host of the robot's agent, in a team with senses",
            Receiver::StateServer => "host of the state server",
            Receiver::All => "all hosts",
            Receiver::Movers => "hosts with agents or motors, host of the state server",
            Receiver::Localizers => "hosts that measure robots",
            Receiver::Nobody => "no host",
        }
    }

    #[test]
    fn the_page_on_the_wire_has_the_table_of_kinds() {
        let mut table = String::from(
            "| byte | kind | publisher | receivers | soft state | with the stop | signed | across hops |\n\
             |---|---|---|---|---|---|---|---|\n",
        );
        for (byte, kind) in KINDS.into_iter().enumerate() {
            let yes = |is: bool| if is { "yes" } else { "" };
            let operators = if kind.is_for_operators() { "; operators" } else { "" };
            let (from, to) = (publisher(kind), receiver(kind));
            let (soft, with) = (yes(kind.is_soft()), yes(kind.follows_the_stop()));
            let (signed, across) = (yes(kind.is_signed()), yes(kind.crosses_hops()));
            let row =
                format!("| {byte} | `{kind:?}` | {from} | {to}{operators} | {soft} | {with} | {signed} | {across} |\n");
            table += &row;
        }
        let page = include_str!("../../docs/wire.md");
        assert!(page.contains(&table), "docs/wire.md needs this table:\n{table}");
    }
}
