//! Configuration of a host's UDP sockets on a link, and its implementation of an endpoint.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

use super::peers::PeerAddress;
use super::{Udp, fitness};
use crate::config::ConfigError;
use crate::config::fields::{FieldType, Value};
use crate::messages::ids::HostId;
use crate::net::protocol::reliability::{Reliabilities, Setup};
use crate::net::transport::interface::{self, LOOPBACK};
use crate::net::transport::{Claim, Endpoint, Field, Filter, Finding, LinkSettings, OpenError, Transport};

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
            Addressing::Multicast(group) => group.is_ipv6(),
            Addressing::Unicast { listen, peers } => peers.values().chain([listen]).any(is_ipv6),
            Addressing::Guest { peers } => peers.values().any(is_ipv6),
        }
    }
}

impl SocketConfig {
    fn with(&self, addressing: Addressing) -> Arc<dyn Endpoint> {
        Arc::new(SocketConfig { addressing, ..self.clone() })
    }
}

impl Endpoint for SocketConfig {
    fn open(&self, host: HostId, filter: Filter) -> Result<Box<dyn Transport>, OpenError> {
        let mut udp = Udp::open(host, self, filter)?;
        udp.keep(self, filter)?;
        Ok(Box::new(udp))
    }

    fn for_guest(&self, beside: HostId) -> Arc<dyn Endpoint> {
        match &self.addressing {
            Addressing::Unicast { listen, peers } => {
                let all = peers.iter().map(|(host, at)| (*host, at.clone()));
                let peers = all.chain([(beside, listen.clone())]).collect();
                self.with(Addressing::Guest { peers })
            }
            // A guest joins a multicast group like any host.
            _ => Arc::new(self.clone()),
        }
    }

    fn setup(&self, reliability: Reliabilities) -> Setup {
        match self.addressing {
            Addressing::Multicast(_) => Setup::multicast(reliability),
            _ => Setup::unicast(reliability),
        }
    }

    fn is_local(&self) -> bool {
        match &self.addressing {
            Addressing::Multicast(_) => self.interface == LOOPBACK,
            Addressing::Unicast { listen, peers } => peers.values().chain([listen]).all(PeerAddress::is_loopback),
            Addressing::Guest { peers } => peers.values().all(PeerAddress::is_loopback),
        }
    }

    fn claim(&self) -> Claim {
        match &self.addressing {
            Addressing::Multicast(group) => {
                Claim { field: "group", what: group.to_string(), on: self.interface.clone() }
            }
            Addressing::Unicast { listen, .. } => Claim { field: "peers", what: listen.to_string(), on: String::new() },
            Addressing::Guest { peers } => {
                let all: Vec<String> = peers.values().map(PeerAddress::to_string).collect();
                Claim { field: "peers", what: all.join(", "), on: String::new() }
            }
        }
    }

    fn restricted_to(&self, hosts: &[HostId]) -> Arc<dyn Endpoint> {
        let those = |peers: &BTreeMap<HostId, PeerAddress>| {
            peers.iter().filter(|(host, _)| hosts.contains(host)).map(|(host, at)| (*host, at.clone())).collect()
        };
        self.with(match &self.addressing {
            Addressing::Multicast(group) => Addressing::Multicast(*group),
            Addressing::Unicast { listen, peers } => {
                Addressing::Unicast { listen: listen.clone(), peers: those(peers) }
            }
            Addressing::Guest { peers } => Addressing::Guest { peers: those(peers) },
        })
    }

    fn interface(&self) -> Option<&str> {
        Some(&self.interface)
    }

    fn is_available(&self) -> bool {
        // If the kernel does not list the interfaces, the error is reported when the endpoint is opened.
        let there = |all: Vec<interface::Interface>| all.iter().any(|one| one.up && one.name == self.interface);
        matches!(self.addressing, Addressing::Guest { .. }) || interface::interfaces().map_or(true, there)
    }

    fn on_all_interfaces(&self) -> Vec<Arc<dyn Endpoint>> {
        let outward = interface::interfaces().unwrap_or_default().into_iter().filter(|one| one.up && !one.loopback);
        let by = |one: interface::Interface| SocketConfig { interface: one.name, ..self.clone() };
        outward.map(|one| Arc::new(by(one)) as Arc<dyn Endpoint>).collect()
    }

    fn check(&self, host: HostId, link: &str, mtu: &dyn Fn(&str) -> Option<usize>) -> Vec<Finding> {
        fitness::check(self, (host, link), mtu)
    }
}
