//! How the sockets of a host on a link of UDP are set up, as data, and what of that others have to know.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

use super::{Udp, fitness};
use crate::config::ConfigError;
use crate::config::fields::{FieldType, Value};
use crate::messages::ids::HostId;
use crate::net::protocol::reliability::{Reliabilities, Setup};
use crate::net::transport::interface::{self, LOOPBACK};
use crate::net::transport::{Claim, Field, Filter, Finding, Given, OpenError, Transport, Way};

/// The network interface that both transports are bound to.
pub(super) const INTERFACE: Field = Field::new("interface", FieldType::Interface);

/// What the kernel is asked to keep of what has arrived \[bytes\].
pub(super) const RECEIVE_BUFFER: Field = Field {
    default: Some(|_| (4 << 20).to_string()),
    ..Field::new("receive_buffer_bytes", FieldType::Whole(4096, 1 << 30))
};

/// The values of these two.
pub(super) fn bound(given: &Given) -> Result<(String, usize), ConfigError> {
    let advice = || {
        let (link, host) = (given.link, given.host_name());
        format!(", so link '{link}' cannot be set up on host '{host}'; name the network interface, such as \"wlan0\"")
    };
    let interface = given.need("interface", advice)?.text().to_owned();
    let bytes = given.find("receive_buffer_bytes").map(Value::whole).expect("it has a default");
    Ok((interface, usize::try_from(bytes).expect("its range is smaller")))
}

/// The sockets of a host on a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SocketConfig {
    /// Who is talked to, and where.
    pub whom: Whom,
    /// The network interface, by name.
    pub interface: String,
    /// What the socket's receive buffer is asked to hold \[bytes\].
    pub receive_buffer_bytes: usize,
}

/// Who is talked to, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Whom {
    /// Everyone who listens to a group.
    Group(SocketAddr),
    /// Each host by itself.
    Each {
        /// Where this host listens.
        listen: SocketAddr,
        /// Where the others listen.
        peers: BTreeMap<HostId, SocketAddr>,
    },
    /// Each host by itself, from whatever address the machine has: a guest speaks from a port of its own, on whatever
    /// interface leads there, and is answered there.
    FromAnywhere {
        /// Where all hosts of the link listen.
        peers: BTreeMap<HostId, SocketAddr>,
    },
}

impl SocketConfig {
    fn with(&self, whom: Whom) -> Arc<dyn Way> {
        Arc::new(SocketConfig { whom, ..self.clone() })
    }
}

impl Way for SocketConfig {
    fn open(&self, host: HostId, filter: Filter) -> Result<Box<dyn Transport>, OpenError> {
        Ok(Box::new(Udp::open(host, self, filter)?))
    }

    fn for_guest(&self, beside: HostId) -> Arc<dyn Way> {
        match &self.whom {
            Whom::Each { listen, peers } => {
                let peers = peers.iter().map(|(host, at)| (*host, *at)).chain([(beside, *listen)]).collect();
                self.with(Whom::FromAnywhere { peers })
            }
            // A group is open to everyone.
            _ => Arc::new(self.clone()),
        }
    }

    fn setup(&self, reliability: Reliabilities) -> Setup {
        match self.whom {
            Whom::Group(_) => Setup::multicast(reliability),
            _ => Setup::unicast(reliability),
        }
    }

    fn stays_here(&self) -> bool {
        match &self.whom {
            Whom::Group(_) => self.interface == LOOPBACK,
            Whom::Each { listen, peers } => peers.values().chain([listen]).all(|at| at.ip().is_loopback()),
            Whom::FromAnywhere { peers } => peers.values().all(|at| at.ip().is_loopback()),
        }
    }

    fn claim(&self) -> Claim {
        match &self.whom {
            Whom::Group(group) => Claim { field: "group", what: group.to_string(), on: self.interface.clone() },
            Whom::Each { listen, .. } => Claim { field: "peers", what: listen.to_string(), on: String::new() },
            Whom::FromAnywhere { peers } => {
                let all: Vec<String> = peers.values().map(SocketAddr::to_string).collect();
                Claim { field: "peers", what: all.join(", "), on: String::new() }
            }
        }
    }

    fn among(&self, hosts: &[HostId]) -> Arc<dyn Way> {
        let those = |peers: &BTreeMap<HostId, SocketAddr>| {
            peers.iter().filter(|(host, _)| hosts.contains(host)).map(|(host, at)| (*host, *at)).collect()
        };
        self.with(match &self.whom {
            Whom::Group(group) => Whom::Group(*group),
            Whom::Each { listen, peers } => Whom::Each { listen: *listen, peers: those(peers) },
            Whom::FromAnywhere { peers } => Whom::FromAnywhere { peers: those(peers) },
        })
    }

    fn interface(&self) -> Option<&str> {
        Some(&self.interface)
    }

    fn is_here(&self) -> bool {
        // Where the kernel does not tell, opening says why.
        let there = |all: Vec<interface::Interface>| all.iter().any(|one| one.up && one.name == self.interface);
        matches!(self.whom, Whom::FromAnywhere { .. }) || interface::interfaces().map_or(true, there)
    }

    fn everywhere(&self) -> Vec<Arc<dyn Way>> {
        let outward = interface::interfaces().unwrap_or_default().into_iter().filter(|one| one.up && !one.loopback);
        let by = |one: interface::Interface| SocketConfig { interface: one.name, ..self.clone() };
        outward.map(|one| Arc::new(by(one)) as Arc<dyn Way>).collect()
    }

    fn examine(&self, host: HostId, link: &str, mtu: &dyn Fn(&str) -> Option<usize>) -> Vec<Finding> {
        fitness::examine(self, (host, link), mtu)
    }
}
