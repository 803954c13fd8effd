//! Communication with ROS 2 robots without an installation of ROS: messages, a child process of the host that speaks
//! DDS (the DDS process), the packets between both, and a spare DDS process that can take over at once.
//!
//! The driver, the source, the sense and the observer of that name use it. DDS itself is in `dds` alone, behind the
//! feature `dds`.

#![deny(clippy::print_stdout, clippy::print_stderr)]

#[cfg(feature = "dds")]
mod dds;
pub mod discovery;
pub mod driver;
pub mod messages;
#[cfg(feature = "dds")]
pub mod node;
pub mod observe;
pub mod observer;
pub mod packet;
pub mod pair;
pub mod reading;
pub mod sample;
pub mod scan;
pub mod sense;
pub mod settings;
pub mod source;
pub mod supervisor;
pub mod topics;

use murmurate::registry::Registry;
use murmurate::{drivers, localization};

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Whether DDS is built in: the feature `dds`.
pub const BUILT: bool = cfg!(feature = "dds");

/// Adds the driver, the source, the sense and the observer `ros2` to a registry.
pub fn add(registry: Registry) -> Registry {
    registry
        .with_driver(drivers::Entry { name: "ros2", about: driver::ABOUT, make: driver::make })
        .with_source(localization::Entry { name: "ros2", about: source::ABOUT, make: source::make })
        .with_sense(sense::ENTRY)
        .with_observer(observer::ENTRY)
}

/// Name of the hidden subcommand of this program that runs a DDS process: the child process of a host that connects it
/// to ROS 2.
pub const SUBCOMMAND: &str = "ros2-node";
/// Exit code of a DDS process that has reported to its host why it cannot work.
pub const REFUSED: u8 = 3;
/// Error text for a user whose program was built without the feature `ros2`, but whose deployment has a driver or a
/// source that needs it.
pub const NOT_BUILT: &str =
    "this program is built without ROS 2; build it by `cargo install --path crates/cli --features ros2`";
