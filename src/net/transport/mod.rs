//! Transports: what moves frames between hosts. A transport is a file or a folder here and one line in `REGISTRY`.
//!
//! An [`Entry`] reads the fields of a team file that are its own into a [`Way`], which is opened for one host as a
//! [`Transport`]. What a frame says never matters here, but for one thing: reports go to more addresses than data do on
//! a unicast link. The emulated ether of one-process runs (`net/media/ether.rs`) takes the same [`In`].

pub mod interface;
pub mod settings;
pub mod udp;
mod way;

pub use settings::{Field, Given};
pub use way::{Claim, Filter, Finding, Fitness, OpenError, Place, Way};

use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::rc::Rc;
use std::sync::Arc;

use crate::config::ConfigError;
use crate::messages::ids::HostId;
use crate::messages::local::Truth;
use crate::net::protocol::codec::Frame;
use crate::net::protocol::link::Guest;
use crate::net::protocol::router::Audience;
use crate::time::Time;

/// A link of one host that is open, on the thread that drives it: nothing here may wait. What has to wait belongs on a
/// thread of its own behind a channel of `edge`, whose bell is then the descriptor.
pub trait Transport {
    /// The descriptor that is watched: whenever it has something to read, `receive` is to be called.
    fn bell(&self) -> Rc<dyn AsFd>;

    /// Hands over what has arrived, each frame with the address that it came from, where the transport has addresses:
    /// no more at once than a quarter of a millisecond of work, so that the other actors have their turn. What is left
    /// rings again.
    fn receive(&mut self, now: Time, take: &mut dyn FnMut(Option<SocketAddr>, &[u8]));

    /// Until when it is to be left alone, because more arrives than is worth a wake-up each.
    fn rests_until(&self) -> Option<Time> {
        None
    }

    /// Does what a Network says: sends a frame to everyone or to one host, or from now on to a guest, too. What does
    /// not get out is counted and gone, as a frame that is lost on the air.
    fn handle(&mut self, now: Time, input: In);

    /// What it has counted so far.
    fn counts(&self) -> Counts;
}

/// What a transport counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames that did not get out.
    pub unsent: u64,
    /// Frames that have arrived and were dropped because a queue of the transport was full.
    pub dropped: u64,
}

/// A transport by name.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name in a team file.
    pub name: &'static str,
    /// Whom a frame reaches on it, in a line.
    pub about: &'static str,
    /// The fields of a link that are its own, beside `transport` and `reliability`.
    pub fields: &'static [Field],
    /// Reads the way of one host onto a link; an error names the field.
    pub read: fn(&Given) -> Result<Arc<dyn Way>, ConfigError>,
}

/// All transports.
pub const REGISTRY: &[Entry] = &[udp::multicast::ENTRY, udp::unicast::ENTRY];

/// The fields of a link that no transport may have for its own.
pub const RESERVED: [&str; 2] = ["transport", "reliability"];

/// The transport of a link that names none.
pub const USUAL: &str = "multicast";

/// Input of a transport.
#[derive(Clone, Debug)]
pub enum In {
    /// A Network sends a frame.
    Transmit(Transmit),
    /// Where robots truly are: from a simulated World, for an ether with a range. Real waves know it.
    Truth(Truth),
    /// A host whose address is in no file is to be sent to for a while; only an addressed link has to be told.
    Admit(Guest),
}

/// A frame handed to a transport.
#[derive(Clone, Debug)]
pub struct Transmit {
    /// The host that sends it.
    pub from: HostId,
    /// The hosts that it is for.
    pub audience: Audience,
    /// The bytes.
    pub frame: Frame,
}

/// A frame that has arrived on the emulated ether.
#[derive(Clone, Debug)]
pub struct Arrive {
    /// The host that it has reached.
    pub to: HostId,
    /// The address that it came from; none on an emulated link.
    pub from: Option<SocketAddr>,
    /// The bytes.
    pub frame: Frame,
}
