//! The way of one host onto a link, before anything is opened: what of it others have to know, and how it is opened.

use std::fmt::Debug;
use std::sync::Arc;

use super::Transport;
use crate::messages::ids::HostId;
use crate::net::protocol::reliability::{Reliabilities, Setup};

/// The way of one host onto a link: what its transport has made of the team file.
pub trait Way: Debug + Send + Sync {
    /// Opens it for this host. For one that is in no file, an operator, it has to be the way of a guest.
    fn open(&self, host: HostId, filter: Filter) -> Result<Box<dyn Transport>, OpenError>;

    /// The way of a guest, who is in no file, onto the same link from the machine of `beside` or from any other.
    fn for_guest(&self, beside: HostId) -> Arc<dyn Way>;

    /// How the link layer is set up on it: whether each datagram reaches everyone, or those that it is for.
    fn setup(&self, reliability: Reliabilities) -> Setup;

    /// Whether frames stay on this machine.
    fn stays_here(&self) -> bool;

    /// What no other link of the host may have. Two ways of guests with the same are one.
    fn claim(&self) -> Claim;

    /// The same link with no more hosts than these.
    fn among(&self, hosts: &[HostId]) -> Arc<dyn Way>;

    /// The network interface that it is bound to, by name.
    fn interface(&self) -> Option<&str> {
        None
    }

    /// Whether this machine has what it is bound to.
    fn is_here(&self) -> bool {
        true
    }

    /// The same way by all that this machine has, where what it is bound to is elsewhere.
    fn everywhere(&self) -> Vec<Arc<dyn Way>> {
        Vec::new()
    }

    /// Whether this machine is fit for it as this host, in the order in which it was looked at. `mtu` gives the largest
    /// packet of an interface \[bytes\], if that is known; the advice is for the link of this name.
    fn examine(&self, host: HostId, link: &str, mtu: &dyn Fn(&str) -> Option<usize>) -> Vec<Finding> {
        let _ = (link, mtu);
        vec![match self.open(host, Filter::All) {
            Ok(_) => Finding::ok("way", self.claim().what),
            Err(error) => Finding { fitness: Fitness::Fail, ..Finding::ok("way", error.to_string()) },
        }]
    }
}

/// What a link has for itself: no other one of the same host may have it, or they would hear each other's frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claim {
    /// The field that says it.
    pub field: &'static str,
    /// What it is: a group, an address.
    pub what: String,
    /// Where it is that; empty for everywhere on the machine.
    pub on: String,
}

/// How a host takes part in one link.
#[derive(Clone, Debug)]
pub struct Place {
    /// Its way onto the link.
    pub way: Arc<dyn Way>,
    /// How messages are made to arrive, by kind; those left out as their link has it.
    pub reliability: Reliabilities,
}

impl Place {
    /// How its link layer is set up, on a link that has this reliability where the team file says nothing.
    pub fn setup(&self, of_link: &Reliabilities) -> Setup {
        let mut reliability = of_link.clone();
        reliability.extend(self.reliability.clone());
        self.way.setup(reliability)
    }

    /// That of a guest, as [`Way::for_guest`] has it.
    pub fn for_guest(&self, beside: HostId) -> Place {
        Place { way: self.way.for_guest(beside), reliability: self.reliability.clone() }
    }
}

/// The frames that a transport has to let through to its link. It may let others through, which the link layer drops
/// at a higher cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// All of them, so that the link layer can tell what is wrong with those that it refuses.
    All,
    /// Those that can be of this team.
    Team {
        /// The team's number.
        number: u16,
        /// Whether the team has a key, so that each of them ends with a tag.
        tagged: bool,
    },
}

/// Why a way cannot be opened.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// The team file says what cannot be on this machine.
    #[error("{0}")]
    Wrong(String),
    /// It may go well later, as where an interface is down.
    #[error("{0}")]
    NotNow(String),
}

/// How fit a machine is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fitness {
    /// Nothing is wrong.
    Ok,
    /// It will do.
    Warn,
    /// It will not do.
    Fail,
}

/// What was found of a way on this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What came of it.
    pub fitness: Fitness,
    /// What was looked at.
    pub what: &'static str,
    /// What was found.
    pub found: String,
    /// What to do about it; empty if nothing.
    pub advice: String,
}

impl Finding {
    /// Nothing is wrong.
    pub fn ok(what: &'static str, found: String) -> Finding {
        Finding { fitness: Fitness::Ok, what, found, advice: String::new() }
    }
}
