//! Inputs of a host from outside its actor graph: datagrams, packets of devices' workers, and orders of its own
//! process. All pass through `Graph::take`, so that a record holds all of them and a replay can repeat them.

use std::net::SocketAddr;

use crate::edge::Packet;
use crate::messages::ids::{LinkId, RobotId};
use crate::net::protocol::codec::Frame;

/// Identity of a device of a host: a driver or the source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceId {
    /// The driver of a robot's motors.
    Driver(RobotId),
    /// The host's source of readings.
    Source,
}

/// Input of a host from outside its actor graph.
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
    /// Order of the host's process to shut down: its robots stop, and then it announces this.
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
