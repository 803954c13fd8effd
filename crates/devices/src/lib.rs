//! Robots and receivers of others: the driver `robomaster` of the RoboMaster EP, the source `natnet` of motion capture
//! by OptiTrack's protocol, and the source `gpsd` of satellite receivers.
//!
//! Each has a part without I/O, which a replay runs again, and a worker with the sockets.

#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod gpsd;
pub mod natnet;
pub mod robomaster;

use murmurate::localization::Entry;
use murmurate::registry::Registry;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Adds the driver and the sources to a registry.
pub fn add(registry: Registry) -> Registry {
    registry
        .with_driver(robomaster::ENTRY)
        .with_source(Entry { name: "gpsd", about: gpsd::ABOUT, make: gpsd::make })
        .with_source(Entry { name: "natnet", about: natnet::ABOUT, make: natnet::make })
}
