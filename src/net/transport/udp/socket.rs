//! Configuration of a host's UDP sockets on a link.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use super::peers::PeerAddress;
use crate::config::ConfigError;
use crate::config::fields::{FieldType, Value};
use crate::messages::ids::HostId;
use crate::net::transport::{Field, LinkSettings};

/// Field `interface` of a link in a team file: the network interface. Both UDP transports have it.
pub(super) const INTERFACE: Field = Field::new("interface", FieldType::Interface);

/// Field `receive_buffer_bytes` of a link in a team file: the receive buffer requested from the kernel, 4 MiB by
/// default. Both UDP transports have it.
pub(super) const RECEIVE_BUFFER: Field = Field {
    default: Some(|_| (4 << 20).to_string()),
    ..Field::new("receive_buffer_bytes", FieldType::Whole(4096, 1 << 30))
};

/// Reads the network interface and the size of the receive buffer \[bytes\] of a link. An error names a missing field.
pub(super) fn bound(settings: &LinkSettings) -> Result<(String, usize), ConfigError> {
    let advice = || {
        let (link, host) = (settings.link, settings.host_name());
        format!(", so link '{link}' cannot be set up on host '{host}'; name the network interface, such as \"wlan0\"")
    };
    let interface = settings.need("interface", advice)?.text().to_owned();
    let bytes = settings.find("receive_buffer_bytes").map(Value::whole).expect("it has a default");
    Ok((interface, usize::try_from(bytes).expect("its range is smaller")))
}

/// Configuration of a host's UDP sockets on a link: addresses, network interface and receive buffer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SocketConfig {
    /// Addresses to which datagrams are sent, and at which they are received.
    pub addressing: Addressing,
    /// Network interface that the sockets use: its name, or `auto` for the only suitable one. An operator's socket on a
    /// unicast link uses any.
    pub interface: String,
    /// Size of the receive buffer that is requested from the kernel \[bytes\].
    pub receive_buffer_bytes: usize,
}

/// Addresses that a host's UDP sockets on a link use: a multicast group, or one address for each host of the link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Addressing {
    /// Multicast: address and port of the group that all hosts of the link join.
    Multicast(SocketAddr),
    /// The same, and unicast to each host at the address from which it is heard, at the port of the group.
    Both(SocketAddr),
    /// Unicast to the address of each host.
    Unicast {
        /// Address at which this host receives.
        listen: PeerAddress,
        /// Addresses of the other hosts.
        peers: BTreeMap<HostId, PeerAddress>,
    },
    /// Unicast from an operator, whose address is not in the team file, to each host. It uses a port that the kernel
    /// chooses, on the interface with a route to the host; hosts answer to that port.
    Guest {
        /// Addresses of all hosts of the link.
        peers: BTreeMap<HostId, PeerAddress>,
    },
}

impl Addressing {
    /// Whether the link uses IPv6: one of its addresses is of that family. Names alone mean IPv4.
    pub(super) fn is_ipv6(&self) -> bool {
        let is_ipv6 = |at: &PeerAddress| at.fixed().is_some_and(|at| at.is_ipv6());
        match self {
            Addressing::Multicast(group) | Addressing::Both(group) => group.is_ipv6(),
            Addressing::Unicast { listen, peers } => peers.values().chain([listen]).any(is_ipv6),
            Addressing::Guest { peers } => peers.values().any(is_ipv6),
        }
    }
}
