//! A host's place on a UDP link, from its configuration, before any socket is opened.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::peers::PeerAddress;
use super::socket::{Addressing, SocketConfig};
use super::{Udp, fitness};
use crate::fitness::Finding;
use crate::messages::ids::HostId;
use crate::net::protocol::reliability::{Reliabilities, Setup};
use crate::net::transport::interface::{self, LOOPBACK};
use crate::net::transport::{Claim, Endpoint, Filter, OpenError, Transport};

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
            Addressing::Both(_) => Setup::choosing(reliability),
            _ => Setup::unicast(reliability),
        }
    }

    fn is_local(&self) -> bool {
        match &self.addressing {
            Addressing::Multicast(_) | Addressing::Both(_) => self.interface == LOOPBACK,
            Addressing::Unicast { listen, peers } => peers.values().chain([listen]).all(PeerAddress::is_loopback),
            Addressing::Guest { peers } => peers.values().all(PeerAddress::is_loopback),
        }
    }

    fn claim(&self) -> Claim {
        match &self.addressing {
            Addressing::Multicast(group) | Addressing::Both(group) => {
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
            Addressing::Multicast(_) | Addressing::Both(_) => self.addressing.clone(),
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
