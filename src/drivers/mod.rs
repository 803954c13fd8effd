//! Drivers: access of a Body to its robot's motors. A driver is one file and one line in `REGISTRY`.
//!
//! A driver is pure: it turns velocities into packets for its worker, and the worker's packets into the robot's
//! condition. The Body handles expiry of commands and the emergency stop, for all drivers alike.

pub mod program;
pub mod simulated;

use crate::config::ConfigError;
use crate::edge::{Packet, Settings, Worker};
use crate::messages::geometry::Pose;
use crate::messages::ids::RobotId;
use crate::messages::local::Drive;
use crate::messages::telemetry::Health;
use crate::time::Time;

/// Output of a driver.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// Command for the World that simulates the robot.
    Drive(Drive),
    /// Packet for its worker.
    Send(Packet),
    /// Condition of the robot, and charge of its battery \[%\] if known.
    Condition(Health, Option<u8>),
    /// Packet of the worker that was not understood, with the reason.
    Refused(&'static str),
}

/// Limits of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest speed \[m/s\]; infinite where the robot limits its speed itself.
    pub speed_m_s: f32,
}

/// Driver of one robot.
pub trait Driver {
    /// The robot's limits. A Body keeps to them.
    fn limits(&self) -> Limits;

    /// Drives the robot at a velocity of the world frame until a given time. `pose` is the last measured one; a driver
    /// of wheels uses it to turn the velocity into the robot's own frame.
    fn drive(&mut self, now: Time, drive: &Drive, pose: Option<&Pose>, out: &mut Vec<Out>);

    /// Takes a packet of the worker.
    fn receive(&mut self, now: Time, packet: &[u8], out: &mut Vec<Out>);
}

/// Parts of a driver made from settings: a constructor of the pure part, called at each start of its actor, and the
/// worker.
pub struct Parts {
    /// Makes a new driver.
    pub driver: Box<dyn Fn() -> Box<dyn Driver>>,
    /// Does its I/O, if it has any.
    pub worker: Option<Box<dyn Worker>>,
}

/// Driver in a registry.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name in a deployment.
    pub name: &'static str,
    /// Description in one line.
    pub about: &'static str,
    /// Makes it for a robot; an error names the wrong setting.
    pub make: fn(&Settings, RobotId) -> Result<Parts, ConfigError>,
}

/// All drivers of real robots.
pub const REGISTRY: &[Entry] = &[Entry { name: "program", about: program::ABOUT, make: program::make }];
