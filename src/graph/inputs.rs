//! Inputs of a host from outside its graph: datagrams, packets of its devices' workers, and orders of its own process.
//! All of them come in through `Graph::take`, so that a record of a host has them all and a replay gives them again.

use std::net::SocketAddr;

use crate::edge::Packet;
use crate::messages::ids::{LinkId, RobotId};
use crate::net::protocol::codec::Frame;

/// Driver or source of a host, whose worker does its I/O.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceId {
    /// The driver of a robot's motors.
    Driver(RobotId),
    /// The host's source of readings.
    Source,
}

/// Input of a host from outside its graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// Datagram that has arrived on a link, with its source address if the transport has addresses.
    Frame(LinkId, Frame, Option<SocketAddr>),
    /// Number of datagrams that a transport of the link has dropped because a queue was full.
    Dropped(LinkId, u64),
    /// Packet of a device's worker (I/O thread).
    Packet(DeviceId, Packet),
    /// The worker of a device has ended.
    Ended(DeviceId),
    /// Order of the host's process to leave the team: its robots stop, then it announces the leave.
    Leave,
    /// Order of the host's process to engage the team's emergency stop.
    Stop,
}

impl Input {
    /// Whether the input is an order of the host's own process.
    pub fn is_order(&self) -> bool {
        matches!(self, Input::Leave | Input::Stop)
    }
}
