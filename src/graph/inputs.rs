//! Inputs of a host from outside its actor graph: datagrams, packets of devices' workers, and orders of its own
//! process. All pass through `Graph::take`, so that a record holds all of them and a replay can repeat them.

use std::net::SocketAddr;

use crate::edge::Packet;
use crate::messages::ids::{LinkId, RobotId};
use crate::net::protocol::codec::Frame;
use crate::net::protocol::counts::Refusal;

/// Identity of a device of a host: a driver, the source, or the worker of an Agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceId {
    /// The driver that moves this robot's motors.
    Driver(RobotId),
    /// The host's source of readings (measured poses and velocities of robots).
    Source,
    /// The worker that computes the policies of an Agent, whose first robot is this one.
    Agent(RobotId),
    /// The worker of the sense of this robot with this index.
    Sense(RobotId, u8),
}

/// Input of a host from outside its actors: datagrams, packets of its devices, and orders of its own process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// Datagram that has arrived on a link, with its source address if the link's transport has addresses.
    Frame(LinkId, Frame, Option<SocketAddr>),
    /// Number of datagrams that a transport of the link has dropped because a queue was full, since the last such
    /// input.
    Dropped(LinkId, u64),
    /// Number of datagrams that have arrived on the link and were refused for this cause, without any other effect on
    /// the host. Only in records and replays, in place of their bytes.
    Refused(LinkId, Refusal, u64),
    /// Packet that the worker of a driver or source has passed on, such as data from the hardware.
    Packet(DeviceId, Packet),
    /// Notice that the worker of a driver or of the source has ended; no more packets arrive from it.
    Ended(DeviceId),
    /// Order of the host's own process to shut down: its robots stop, and it tells the team that it leaves.
    Leave,
    /// Order of the host's own process to engage the team's emergency stop.
    Stop,
    /// Notice of the host's own process that the roster with this number is on disk.
    Kept(u32),
}

impl Input {
    /// Returns whether the input comes from the host's own process: `Leave`, `Stop` or `Kept`.
    pub fn is_order(&self) -> bool {
        matches!(self, Input::Leave | Input::Stop | Input::Kept(_))
    }
}
