//! Endpoint: the configuration of one host on one link, before its sockets are opened.

use std::fmt::Debug;
use std::sync::Arc;

use super::Transport;
use crate::messages::ids::HostId;
use crate::net::protocol::reliability::{Reliabilities, Setup};

/// Configuration of one host on a link, as its transport has read it from the team file.
pub trait Endpoint: Debug + Send + Sync {
    /// Opens the transport for `host`. A host that is not in the team file, such as an operator, needs the endpoint of
    /// a guest.
    fn open(&self, host: HostId, filter: Filter) -> Result<Box<dyn Transport>, OpenError>;

    /// Returns the endpoint of a guest on the same link: a host that is not in the team file, on any machine. `beside`
    /// is the host that this endpoint belongs to.
    fn for_guest(&self, beside: HostId) -> Arc<dyn Endpoint>;

    /// Returns the setup of the link layer: whether datagrams reach every host, or only the addressed one.
    fn setup(&self, reliability: Reliabilities) -> Setup;

    /// Whether frames stay on this machine.
    fn is_local(&self) -> bool;

    /// Returns the resource that no other link of the host may use. Guests' endpoints with equal claims are equal.
    fn claim(&self) -> Claim;

    /// Returns the endpoint on the same link that sends only to these hosts.
    fn restricted_to(&self, hosts: &[HostId]) -> Arc<dyn Endpoint>;

    /// Name of the network interface that the endpoint is bound to; `None` if it is bound to none.
    fn interface(&self) -> Option<&str> {
        None
    }

    /// Whether this machine has the interface that the endpoint is bound to.
    fn is_available(&self) -> bool {
        true
    }

    /// Returns endpoints on all interfaces of this machine, to replace one that is bound to an interface of another
    /// machine.
    fn on_all_interfaces(&self) -> Vec<Arc<dyn Endpoint>> {
        Vec::new()
    }

    /// Checks whether this machine can use the endpoint for `host`; returns the findings. `link` is the name of the
    /// link, for advice. `mtu` returns the largest packet of an interface \[bytes\], if known.
    fn check(&self, host: HostId, link: &str, mtu: &dyn Fn(&str) -> Option<usize>) -> Vec<Finding> {
        let _ = (link, mtu);
        vec![match self.open(host, Filter::All) {
            Ok(_) => Finding::ok("endpoint", self.claim().what),
            Err(error) => Finding { fitness: Fitness::Fail, ..Finding::ok("endpoint", error.to_string()) },
        }]
    }
}

/// Resource that only one link of a host may use. Two links with the same one would receive each other's frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claim {
    /// Field of the team file that sets the resource.
    pub field: &'static str,
    /// The resource, such as a multicast group or an address.
    pub what: String,
    /// Interface to which the resource is limited; empty for the whole machine.
    pub on: String,
}

/// Participation of a host in one link.
#[derive(Clone, Debug)]
pub struct Place {
    /// Endpoint of the host on the link.
    pub endpoint: Arc<dyn Endpoint>,
    /// Reliability modes by kind of message. Kinds that are left out have the mode of the deployment's link.
    pub reliability: Reliabilities,
}

impl Place {
    /// Returns the setup of the link layer. `of_link` are the reliability modes of the deployment's link, which the
    /// team file overrides.
    pub fn setup(&self, of_link: &Reliabilities) -> Setup {
        let mut reliability = of_link.clone();
        reliability.extend(self.reliability.clone());
        self.endpoint.setup(reliability)
    }

    /// Returns the participation of a guest, as [`Endpoint::for_guest`].
    pub fn for_guest(&self, beside: HostId) -> Place {
        Place { endpoint: self.endpoint.for_guest(beside), reliability: self.reliability.clone() }
    }
}

/// Which frames a transport has to pass to the link layer. It may pass others, which the link layer drops at a higher
/// cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// All frames, so that the link layer can report the cause of each refusal.
    All,
    /// Frames that can be from this team, by length, version and team number.
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

/// Result of a check of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fitness {
    /// No defect.
    Ok,
    /// A defect that limits operation.
    Warn,
    /// A defect that prevents operation.
    Fail,
}

/// Result of one check of an endpoint on this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Severity of the result.
    pub fitness: Fitness,
    /// Subject of the check, such as "MTU".
    pub what: &'static str,
    /// Observation on this machine.
    pub found: String,
    /// Advice on how to fix it; empty if none is needed.
    pub advice: String,
}

impl Finding {
    /// Returns a finding without defect.
    pub fn ok(what: &'static str, found: String) -> Finding {
        Finding { fitness: Fitness::Ok, what, found, advice: String::new() }
    }
}
