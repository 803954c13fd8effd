//! Driver `crazyflie`: the quadrotor of Bitcraze by its protocol, CRTP. It rises and lands by the robot's high-level
//! commander, follows velocities in the air, and tells the robot where the team's source sees it.
//!
//! The part without I/O connects, flies and judges the robot; the worker, behind the feature `link`, carries packets.

#![deny(clippy::print_stdout, clippy::print_stderr)]

mod axes;
mod connection;
mod estimate;
mod flight;
pub mod link;
pub mod packet;
mod requests;
mod session;
mod settings;
mod status;
mod toc;
#[cfg_attr(not(feature = "link"), path = "absent.rs")]
mod worker;

use std::cell::RefCell;
use std::rc::Rc;

use murmurate::config::ConfigError;
use murmurate::drivers::{Entry, Parts};
use murmurate::edge::Settings;
use murmurate::messages::ids::RobotId;
use murmurate::registry::Registry;

use self::session::Session;
use self::settings::Config;
use self::worker::Wire;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Whether the link to a robot is built in: the feature `link`.
pub const BUILT: bool = cfg!(feature = "link");

/// Entry of the driver in the registry of drivers.
pub const ENTRY: Entry = Entry { name: "crazyflie", about: "Crazyflie quadrotors, by CRTP over UDP", make };

/// Adds the driver to a registry.
pub fn add(registry: Registry) -> Registry {
    registry.with_driver(ENTRY)
}

/// Makes the driver of `robot` and its worker; an error names the wrong setting.
fn make(settings: &Settings, robot: RobotId) -> Result<Parts, ConfigError> {
    let config = Config::of(settings)?;
    let worker = Wire { robot, address: config.address()? };
    // Tables of contents outlive the Body, as the robot's firmware does.
    let kept = Rc::new(RefCell::default());
    Ok(Parts {
        driver: Box::new(move || Box::new(Session::new(robot, config.clone(), Rc::clone(&kept)))),
        worker: Some(Box::new(worker)),
    })
}
