//! Endpoint: the configuration of one host on a link, before anything is opened.

use std::fmt::Debug;
use std::sync::Arc;

use super::Transport;
use crate::messages::ids::HostId;
use crate::net::protocol::reliability::{Reliabilities, Setup};

/// Endpoint of one host on a link, as its transport has read it from the team file.
pub trait Endpoint: Debug + Send + Sync {
    /// Opens it for this host. A host that is in no file, such as an operator, needs the endpoint of a guest.
    fn open(&self, host: HostId, filter: Filter) -> Result<Box<dyn Transport>, OpenError>;

    /// Returns the endpoint of a guest, which is in no file, on the same link, from the machine of `beside` or any
    /// other.
    fn for_guest(&self, beside: HostId) -> Arc<dyn Endpoint>;

    /// Returns the setup of the link layer: whether each datagram reaches every host, or only its receivers.
    fn setup(&self, reliability: Reliabilities) -> Setup;

    /// Whether frames stay on this machine.
    fn is_local(&self) -> bool;

    /// Returns the resource that no other link of the host may use. Endpoints of guests with the same claim are equal.
    fn claim(&self) -> Claim;

    /// Returns the endpoint on the same link with only these hosts.
    fn restricted_to(&self, hosts: &[HostId]) -> Arc<dyn Endpoint>;

    /// Name of the network interface that it is bound to.
    fn interface(&self) -> Option<&str> {
        None
    }

    /// Whether this machine has the interface that it is bound to.
    fn is_available(&self) -> bool {
        true
    }

    /// Returns endpoints on all interfaces of this machine, in place of one that is bound to an interface elsewhere.
    fn on_all_interfaces(&self) -> Vec<Arc<dyn Endpoint>> {
        Vec::new()
    }

    /// Checks whether this machine is fit for it as this host; returns the findings in order. `mtu` gives the largest
    /// packet of an interface \[bytes\], if known; the advice is for the link of this name.
    fn check(&self, host: HostId, link: &str, mtu: &dyn Fn(&str) -> Option<usize>) -> Vec<Finding> {
        let _ = (link, mtu);
        vec![match self.open(host, Filter::All) {
            Ok(_) => Finding::ok("endpoint", self.claim().what),
            Err(error) => Finding { fitness: Fitness::Fail, ..Finding::ok("endpoint", error.to_string()) },
        }]
    }
}

/// Resource of a link that no other link of the same host may use: both would receive each other's frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claim {
    /// Field that sets it.
    pub field: &'static str,
    /// The resource: a group, an address.
    pub what: String,
    /// Interface to which it is limited; empty for the whole machine.
    pub on: String,
}

/// Participation of a host in one link.
#[derive(Clone, Debug)]
pub struct Place {
    /// Its endpoint on the link.
    pub endpoint: Arc<dyn Endpoint>,
    /// Reliability modes by kind; kinds that are left out have the link's.
    pub reliability: Reliabilities,
}

impl Place {
    /// Returns the setup of the link layer, with the link's reliability modes where the team file has none.
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

/// Frames that a transport has to pass to its link. It may pass others, which the link layer drops at a higher cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// All frames, so that the link layer can report the cause of each refusal.
    All,
    /// Frames that can be of this team.
    Team {
        /// The team's number.
        number: u16,
        /// Whether the team has a key, so that each frame ends with a tag.
        tagged: bool,
    },
}

/// Reason for which an endpoint cannot be opened.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// The team file does not fit this machine.
    #[error("{0}")]
    Wrong(String),
    /// It may work later, for example when an interface is up.
    #[error("{0}")]
    NotNow(String),
}

/// Fitness of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fitness {
    /// No defect.
    Ok,
    /// A defect that limits it.
    Warn,
    /// A defect that prevents its use.
    Fail,
}

/// Result of one check of an endpoint on this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Result.
    pub fitness: Fitness,
    /// Subject of the check.
    pub what: &'static str,
    /// Observation.
    pub found: String,
    /// Remedy; empty if none is needed.
    pub advice: String,
}

impl Finding {
    /// Returns a finding without defect.
    pub fn ok(what: &'static str, found: String) -> Finding {
        Finding { fitness: Fitness::Ok, what, found, advice: String::new() }
    }
}
