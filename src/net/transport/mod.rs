//! Transports, which move frames between hosts. Each is a file or a folder in this module, and an entry in `REGISTRY`.
//!
//! An [`Entry`] reads its fields of a team file into an [`Endpoint`], which is opened for one host as a [`Transport`].
//! Transports do not interpret frames, with one exception: a unicast link sends reports to more addresses than data.
//! Links of runs in one process have an emulated medium (`net/media/ether.rs`) in place of transports.

mod endpoint;
pub mod flood;
pub mod interface;
pub mod link_watch;
#[cfg(target_os = "linux")]
mod netlink;
mod removed;
pub mod settings;
pub mod udp;

pub use endpoint::{Claim, Endpoint, Filter, OpenError, Place};
pub use settings::{Field, LinkSettings};

use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::rc::Rc;
use std::sync::Arc;

use crate::config::ConfigError;
use crate::messages::ids::HostId;
use crate::net::protocol::codec::Frame;
use crate::net::protocol::link::Guest;
use crate::net::protocol::router::Audience;
use crate::time::Time;

/// Open link of one host, used by the thread that drives the robot: no method may block. Blocking work belongs on
/// another thread, connected by a channel of `edge`, whose event descriptor is then watched.
pub trait Transport {
    /// Returns the file descriptor for the event loop to watch, which calls `receive` while it is readable.
    fn descriptor(&self) -> Rc<dyn AsFd>;

    /// Passes received frames to `take`, each with its source address if the transport has addresses. Returns after a
    /// quarter of a millisecond at most, so that other actors are not delayed. The descriptor stays readable while
    /// frames are left.
    fn receive(&mut self, now: Time, take: &mut dyn FnMut(Option<SocketAddr>, &[u8]));

    /// Returns the time until which `receive` must not be called, because frames arrive too fast for a wake-up each;
    /// `None` without such a pause.
    fn paused_until(&self) -> Option<Time> {
        None
    }

    /// Handles an input: sends a frame to all hosts or to one, or adds a guest (such as an operator) as a receiver. A
    /// frame that cannot be sent is counted and dropped.
    fn handle(&mut self, now: Time, input: In);

    /// Returns the counters of frames that were not sent or dropped.
    fn counts(&self) -> Counts;

    /// Returns a descriptor that is readable when another thread has closed the link's sockets, opened them again or
    /// found an address of a host; then `renew` has to be called. `None` if sockets are never opened again.
    fn changes(&self) -> Option<Rc<dyn AsFd>> {
        None
    }

    /// Takes over what another thread has prepared. Calls `tell` when the link was closed or is open again;
    /// `descriptor` is another one then.
    fn renew(&mut self, tell: &mut dyn FnMut(Renewed)) {
        let _ = tell;
    }
}

/// Change of an open link: its network interface or address has gone, or it is open again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Renewed {
    /// The sockets were closed; the text says why. They are opened again when the interface is fit.
    Closed(String),
    /// The sockets are open again; the text says at which address and interface.
    Open(String),
}

/// Counters of a transport on one link of one host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of frames that could not be sent.
    pub unsent: u64,
    /// Number of received frames that were dropped because a queue of the transport was full.
    pub dropped: u64,
}

/// Registry entry of a transport, such as `multicast`.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name of the transport, by which a team file selects it.
    pub name: &'static str,
    /// Description in one line: which hosts a frame reaches.
    pub about: &'static str,
    /// Fields of a link in a team file that this transport reads, in addition to `transport` and `reliability`.
    pub fields: &'static [Field],
    /// Makes the endpoint (socket configuration) of one host on a link from the settings in a team file. An error names
    /// the field.
    pub read: fn(&LinkSettings) -> Result<Arc<dyn Endpoint>, ConfigError>,
}

/// Registry entries of all transports of this crate.
pub const REGISTRY: &[Entry] = &[udp::multicast::ENTRY, udp::unicast::ENTRY, udp::auto::ENTRY];

/// Names of fields of a link that no transport may define, since every link has them.
pub(crate) const RESERVED: [&str; 2] = ["transport", "reliability"];

/// Name of the transport that a link has if the team file names none.
pub(crate) const USUAL: &str = "multicast";

/// Input of a transport.
#[derive(Clone, Debug)]
pub enum In {
    /// Frame to send, with its receivers.
    Transmit(Transmit),
    /// Host that is not in the team file, such as an operator, to which frames are sent for a while; used only by
    /// unicast links.
    Admit(Guest),
}

/// Frame to send, with its sender and its receivers.
#[derive(Clone, Debug)]
pub struct Transmit {
    /// Host that sends the frame.
    pub from: HostId,
    /// Receivers of the frame.
    pub audience: Audience,
    /// Bytes of the frame.
    pub frame: Frame,
}
