//! Transports, which move frames between hosts. A transport is a file or a folder here and one line in `REGISTRY`.
//!
//! An [`Entry`] reads its own fields of a team file into an [`Endpoint`], which is opened for one host as a
//! [`Transport`]. Transports do not interpret frames, except that on a unicast link reports go to more addresses than
//! data. The emulated link of one-process runs (`net/media/ether.rs`) takes the same [`In`].

mod endpoint;
pub mod interface;
pub mod settings;
pub mod udp;

pub use endpoint::{Claim, Endpoint, Filter, Finding, Fitness, OpenError, Place};
pub use settings::{Field, LinkSettings};

use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::rc::Rc;
use std::sync::Arc;

use crate::config::ConfigError;
use crate::faults::ManualLinkFault;
use crate::messages::ids::HostId;
use crate::messages::local::Truth;
use crate::net::protocol::codec::Frame;
use crate::net::protocol::link::Guest;
use crate::net::protocol::router::Audience;
use crate::time::Time;

/// An open link of one host, on the thread that drives it: no method may block. Blocking work belongs on a thread of
/// its own behind a channel of `edge`, whose event descriptor is then the one that is watched.
pub trait Transport {
    /// Returns the descriptor to watch: `receive` is called while it is readable.
    fn descriptor(&self) -> Rc<dyn AsFd>;

    /// Passes on received frames, each with its source address if the transport has addresses. Takes a quarter of a
    /// millisecond at most, so that the other actors have their turn; the descriptor stays readable while frames are
    /// left.
    fn receive(&mut self, now: Time, take: &mut dyn FnMut(Option<SocketAddr>, &[u8]));

    /// Time until which `receive` is not to be called, because frames arrive too fast for a wake-up each.
    fn paused_until(&self) -> Option<Time> {
        None
    }

    /// Handles an input of the Network: sends a frame to all hosts or to one, or adds a guest as a receiver. A frame
    /// that cannot be sent is counted and dropped, like one lost on the medium.
    fn handle(&mut self, now: Time, input: In);

    /// Returns its counters.
    fn counts(&self) -> Counts;
}

/// Counters of a transport.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames that could not be sent.
    pub unsent: u64,
    /// Frames that arrived and were dropped because a queue of the transport was full.
    pub dropped: u64,
}

/// Registry entry of a transport.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name in a team file.
    pub name: &'static str,
    /// One line on which hosts a frame reaches.
    pub about: &'static str,
    /// Fields of a link that belong to this transport, beside `transport` and `reliability`.
    pub fields: &'static [Field],
    /// Reads the endpoint of one host on a link; an error names the field.
    pub read: fn(&LinkSettings) -> Result<Arc<dyn Endpoint>, ConfigError>,
}

/// All transports.
pub const REGISTRY: &[Entry] = &[udp::multicast::ENTRY, udp::unicast::ENTRY];

/// Fields of a link that no transport may define.
pub const RESERVED: [&str; 2] = ["transport", "reliability"];

/// Transport of a link that names none.
pub const USUAL: &str = "multicast";

/// Input of a transport.
#[derive(Clone, Debug)]
pub enum In {
    /// A frame to send.
    Transmit(Transmit),
    /// True positions of the robots, from a simulated World: for an emulated link with a limited range.
    Truth(Truth),
    /// An episode that begins: for an emulated link with faults that are timed from its start.
    EpisodeBegins(u32),
    /// A fault that a person has chosen: for an emulated link.
    Manual(ManualLinkFault),
    /// A host whose address is in no file, to be sent to for a while; only unicast links use it.
    Admit(Guest),
}

/// A frame to send.
#[derive(Clone, Debug)]
pub struct Transmit {
    /// Host that sends it.
    pub from: HostId,
    /// Its receivers.
    pub audience: Audience,
    /// The bytes.
    pub frame: Frame,
}

/// A frame received on an emulated link or from a transport.
#[derive(Clone, Debug)]
pub struct Arrive {
    /// Host that receives it.
    pub to: HostId,
    /// Source address; none on an emulated link.
    pub from: Option<SocketAddr>,
    /// The bytes.
    pub frame: Frame,
}
