//! Transports: actors that take a frame to transmit and give the frames that arrive. One file each.
//!
//! Here are the emulated ether of one-process runs and the sockets of real hosts. What a frame says never
//! matters here, but for one thing: reports go to more addresses than data do on a unicast link.

pub mod interface;
pub mod socket;
pub mod udp;

use std::net::SocketAddr;

use crate::messages::ids::HostId;
use crate::messages::local::Truth;
use crate::net::protocol::codec::Frame;
use crate::net::protocol::link::Guest;
use crate::net::protocol::router::Audience;

/// Input of a transport.
#[derive(Clone, Debug)]
pub enum In {
    /// A Network sends a frame.
    Transmit(Transmit),
    /// Where robots truly are: from a simulated World, for an ether with a range.
    Truth(Truth),
    /// A host whose address is in no file is to be sent to for a while; only a unicast link has to be told.
    Admit(Guest),
}

/// A frame handed to a transport.
#[derive(Clone, Debug)]
pub struct Transmit {
    /// The host that sends it.
    pub from: HostId,
    /// The hosts that it is for.
    pub audience: Audience,
    /// The bytes.
    pub frame: Frame,
}

/// A frame that has arrived.
#[derive(Clone, Debug)]
pub struct Arrive {
    /// The host that it has reached.
    pub to: HostId,
    /// The address that it came from; none on an emulated link.
    pub from: Option<SocketAddr>,
    /// The bytes.
    pub frame: Frame,
}
