//! Endpoint: the configuration of one host on one link, before its sockets are opened.

use std::fmt::Debug;
use std::sync::Arc;

use super::Transport;
use crate::fitness::{Finding, Fitness};
use crate::messages::ids::HostId;
use crate::net::protocol::reliability::{Reliabilities, Setup};

/// Endpoint: the configuration of one host on a link, as its transport has read it from the team file. No socket is
/// open yet.
pub trait Endpoint: Debug + Send + Sync {
    /// Opens the sockets for the host `host`; `filter` says which frames have to be received. A host that is not in the
    /// team file, such as an operator, needs the endpoint that `for_guest` returns.
    fn open(&self, host: HostId, filter: Filter) -> Result<Box<dyn Transport>, OpenError>;

    /// Returns the endpoint on the same link for a guest: a host that is not in the team file, such as an operator, on
    /// any machine. `beside` is the host that this endpoint belongs to.
    fn for_guest(&self, beside: HostId) -> Arc<dyn Endpoint>;

    /// Returns the setup of the link layer, which depends on whether datagrams reach every host or only the addressed
    /// one. `reliability` are the reliability modes by kind of message.
    fn setup(&self, reliability: Reliabilities) -> Setup;

    /// Whether frames that are sent through this endpoint stay on this machine.
    fn is_local(&self) -> bool;

    /// Returns the resource, such as a multicast group, that no other link of the host may use. Two endpoints for
    /// guests with equal claims are equal.
    fn claim(&self) -> Claim;

    /// Returns the endpoint on the same link that sends only to the given hosts, if the transport sends to single
    /// hosts.
    fn restricted_to(&self, hosts: &[HostId]) -> Arc<dyn Endpoint>;

    /// Returns the name of the network interface that the endpoint is bound to; `None` if it is bound to none.
    fn interface(&self) -> Option<&str> {
        None
    }

    /// Whether the network interface that the endpoint is bound to exists on this machine and is up.
    fn is_available(&self) -> bool {
        true
    }

    /// Returns endpoints on all network interfaces of this machine that are up, except loopback, in place of this one,
    /// which is bound to an interface of another machine. Empty if the transport is bound to no interface.
    fn on_all_interfaces(&self) -> Vec<Arc<dyn Endpoint>> {
        Vec::new()
    }

    /// Checks whether this machine can use the endpoint for `host`; returns the findings. `link` is the name of the
    /// link, for advice. `mtu` returns the largest packet of the interface with the given name \[bytes\]; `None` if
    /// unknown.
    fn check(&self, host: HostId, link: &str, mtu: &dyn Fn(&str) -> Option<usize>) -> Vec<Finding> {
        let _ = (link, mtu);
        vec![match self.open(host, Filter::All) {
            Ok(_) => Finding::ok("endpoint", self.claim().what),
            Err(error) => Finding { fitness: Fitness::Fail, ..Finding::ok("endpoint", error.to_string()) },
        }]
    }
}

/// Resource that only one link of a host may use: two links with the same one would receive each other's frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claim {
    /// Name of the field in the team file that sets the resource, such as `group`.
    pub field: &'static str,
    /// The resource, such as a multicast group or an address.
    pub what: String,
    /// Network interface on which the resource is used; empty for the whole machine.
    pub on: String,
}

/// Participation of a host in one link: its endpoint, and the reliability modes from the team file.
#[derive(Clone, Debug)]
pub struct Place {
    /// Configuration of the host's sockets on the link.
    pub endpoint: Arc<dyn Endpoint>,
    /// Reliability modes by kind of message, from the team file. Kinds that are left out have the mode that the
    /// deployment sets for the link.
    pub reliability: Reliabilities,
}

impl Place {
    /// Returns the setup of the link layer. `of_link` are the reliability modes that the deployment sets for the link;
    /// those of the team file take precedence.
    pub fn setup(&self, of_link: &Reliabilities) -> Setup {
        let mut reliability = of_link.clone();
        reliability.extend(self.reliability.clone());
        self.endpoint.setup(reliability)
    }

    /// Returns the participation of a guest (a host that is not in the team file, such as an operator) in the same
    /// link. `beside` is the host that this participation belongs to.
    pub fn for_guest(&self, beside: HostId) -> Place {
        Place { endpoint: self.endpoint.for_guest(beside), reliability: self.reliability.clone() }
    }
}

/// Frames that a transport has to pass to the link layer. It may pass others, which the link layer drops at a higher
/// cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// All frames, so that the link layer can report the cause of each refusal.
    All,
    /// Frames that can be from the given team, by their length, version and team number.
    Team {
        /// Team number of the frames.
        number: u16,
        /// Whether the team has a key, so that each frame ends with a tag.
        tagged: bool,
    },
}

/// Reason why an endpoint cannot be opened.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// The team file does not fit this machine; the text says why.
    #[error("{0}")]
    Wrong(String),
    /// Opening may succeed later, for example when an interface is up; the text says why it failed now.
    #[error("{0}")]
    NotNow(String),
}
