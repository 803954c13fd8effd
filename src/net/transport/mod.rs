//! Transports, which move frames between hosts. Each is a file or a folder in this module, and an entry in `REGISTRY`.
//!
//! An [`Entry`] reads its fields of a team file into an [`Endpoint`], which is opened for one host as a [`Transport`].
//! Transports do not interpret frames, with one exception: a unicast link sends reports to more addresses than data.
//! The emulated link of one-process runs (`net/media/ether.rs`) takes the same [`In`].

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

/// Open link of one host, used by the thread that drives the robot: no method may block. Blocking work belongs on
/// another thread, connected by a channel of `edge`, whose event descriptor is then watched.
pub trait Transport {
    /// Returns the descriptor to watch; `receive` is called while it is readable.
    fn descriptor(&self) -> Rc<dyn AsFd>;

    /// Passes received frames to `take`, each with its source address if the transport has addresses. Runs for a
    /// quarter of a millisecond at most, so that other actors are not delayed. The descriptor stays readable while
    /// frames are left.
    fn receive(&mut self, now: Time, take: &mut dyn FnMut(Option<SocketAddr>, &[u8]));

    /// Time until which `receive` must not be called, because frames arrive too fast for a wake-up each; `None`
    /// otherwise.
    fn paused_until(&self) -> Option<Time> {
        None
    }

    /// Handles an input: sends a frame to all hosts or to one, or adds a guest as a receiver. A frame that cannot be
    /// sent is counted and dropped.
    fn handle(&mut self, now: Time, input: In);

    /// Returns the counters of the transport.
    fn counts(&self) -> Counts;
}

/// Counters of a transport.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of frames that could not be sent.
    pub unsent: u64,
    /// Number of received frames that were dropped because a queue of the transport was full.
    pub dropped: u64,
}

/// Registry entry of a transport.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name of the transport in a team file.
    pub name: &'static str,
    /// Description in one line: which hosts a frame reaches.
    pub about: &'static str,
    /// Fields of a link that belong to this transport, in addition to `transport` and `reliability`.
    pub fields: &'static [Field],
    /// Reads the endpoint of one host on a link. An error names the field.
    pub read: fn(&LinkSettings) -> Result<Arc<dyn Endpoint>, ConfigError>,
}

/// All transports of this crate.
pub const REGISTRY: &[Entry] = &[udp::multicast::ENTRY, udp::unicast::ENTRY];

/// Names of a link's fields that no transport may define.
pub const RESERVED: [&str; 2] = ["transport", "reliability"];

/// Default transport of a link.
pub const USUAL: &str = "multicast";

/// Input of a transport.
#[derive(Clone, Debug)]
pub enum In {
    /// Frame to send.
    Transmit(Transmit),
    /// True positions of the robots, from a simulated World. Only for emulated links with a limited range.
    Truth(Truth),
    /// Number of the episode that begins. Only for emulated links with faults timed from it.
    EpisodeBegins(u32),
    /// Fault set by hand. Only for emulated links.
    Manual(ManualLinkFault),
    /// Host that is not in the team file, to which frames are sent for a while. Only for unicast links.
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

/// Frame that an emulated link delivers to a host.
#[derive(Clone, Debug)]
pub struct Arrive {
    /// Host that receives the frame.
    pub to: HostId,
    /// Source address of the frame; `None` on an emulated link.
    pub from: Option<SocketAddr>,
    /// Bytes of the frame.
    pub frame: Frame,
}
