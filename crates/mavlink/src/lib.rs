//! Robots with PX4 or ArduPilot, by MAVLink over UDP or a serial line: the driver and the source `mavlink`.
//!
//! Each has a part without I/O, which a replay runs again, and a worker with the link. MAVLink itself is behind the
//! feature `mavlink`; without it settings are read and checked, and no robot is driven.

#![deny(clippy::print_stdout, clippy::print_stderr)]

#[cfg(not(feature = "mavlink"))]
mod absent;
pub mod address;
pub mod axes;
#[cfg(feature = "mavlink")]
pub mod control;
#[cfg(feature = "mavlink")]
pub mod driver;
#[cfg(feature = "mavlink")]
pub mod firmware;
#[cfg(feature = "mavlink")]
pub mod frames;
#[cfg(feature = "mavlink")]
pub mod lift;
pub mod link;
#[cfg(feature = "mavlink")]
pub mod orders;
#[cfg(feature = "mavlink")]
pub mod requests;
#[cfg(feature = "mavlink")]
mod serial;
#[cfg(feature = "mavlink")]
pub mod session;
pub mod settings;
#[cfg(feature = "mavlink")]
pub mod signing;
#[cfg(feature = "mavlink")]
mod sockets;
#[cfg(feature = "mavlink")]
pub mod source;
#[cfg(feature = "mavlink")]
pub mod telemetry;
#[cfg(feature = "mavlink")]
mod worker;

use murmurate::config::ConfigError;
use murmurate::messages::ids::RobotId;
use murmurate::registry::Registry;
use murmurate::{drivers, localization};

#[cfg(not(feature = "mavlink"))]
use absent::{make_driver, make_source};
#[cfg(feature = "mavlink")]
use driver::make as make_driver;
#[cfg(feature = "mavlink")]
use source::make as make_source;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Whether MAVLink is built in: the feature `mavlink`.
pub const BUILT: bool = cfg!(feature = "mavlink");

/// Error text for a user whose program was built without the feature `mavlink`, but whose deployment has a driver or a
/// source that needs it.
pub const NOT_BUILT: &str =
    "this program is built without MAVLink; build it by `cargo install --path crates/cli --features mavlink`";

/// Description of the driver in one line, for lists of all drivers.
const ABOUT_DRIVER: &str = "a robot with PX4 or ArduPilot: MAVLink over UDP or a serial line";
/// Description of the source in one line, for lists of all sources.
const ABOUT_SOURCE: &str = "what the robot's own autopilot estimates, by MAVLink";

/// Adds the driver and the source `mavlink` to a registry.
pub fn add(registry: Registry) -> Registry {
    registry
        .with_driver(drivers::Entry { name: "mavlink", about: ABOUT_DRIVER, make: make_driver })
        .with_source(localization::Entry { name: "mavlink", about: ABOUT_SOURCE, make: make_source })
}

/// Returns the one robot that a source localizes; an error if there are several or none.
fn only(robots: &[RobotId]) -> Result<RobotId, ConfigError> {
    match *robots {
        [robot] => Ok(robot),
        _ => {
            let why = "an autopilot tells where its own robot is; give each robot's host one robot in `localizes`";
            Err(ConfigError::field("name", why))
        }
    }
}
