//! How a host's socket on a link is set up, as data.

use std::collections::BTreeMap;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};

use crate::messages::ids::HostId;
use crate::net::protocol::reliability::Reliabilities;

/// The name of the loopback interface.
pub const LOOPBACK: &str = "lo";

/// The socket of a host on a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SocketConfig {
    /// Who is talked to, and where.
    pub transport: Transport,
    /// The network interface, by name.
    pub interface: String,
    /// What the socket's receive buffer is asked to hold \[bytes\].
    pub receive_buffer_bytes: usize,
    /// How messages are made to arrive, by kind; those left out as their link has it.
    pub reliability: Reliabilities,
}

/// How frames travel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transport {
    /// To a group that all hosts listen to.
    Multicast {
        /// The group.
        group: SocketAddr,
    },
    /// To each host by itself.
    Unicast {
        /// Where this host listens.
        listen: SocketAddr,
        /// Where the others listen.
        peers: BTreeMap<HostId, SocketAddr>,
    },
}

impl SocketConfig {
    /// Whether frames stay on this machine.
    pub fn stays_on_loopback(&self) -> bool {
        match &self.transport {
            Transport::Multicast { .. } => self.interface == LOOPBACK,
            Transport::Unicast { listen, peers } => {
                peers.values().chain([listen]).all(|address| address.ip().is_loopback())
            }
        }
    }

    /// The socket of an operator beside this one of `host`: an operator is no peer, speaks from a port of its own, and
    /// is answered there.
    pub fn of_guest(mut self, host: HostId) -> SocketConfig {
        if let Transport::Unicast { listen, peers } = &mut self.transport {
            peers.insert(host, *listen);
            let any = if listen.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
            *listen = SocketAddr::new(any, 0);
        }
        self
    }
}
