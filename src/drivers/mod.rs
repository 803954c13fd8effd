//! Drivers: access of a Body to its robot's motors. A driver is one file and one line in `REGISTRY`.
//!
//! A driver is pure: it turns velocities into packets for its worker, and the worker's packets into the robot's
//! condition. The Body handles expiry of commands and the emergency stop, for all drivers alike.

pub mod program;
pub mod robomaster;
pub mod ros2;
pub mod simulated;

use crate::config::ConfigError;
use crate::edge::{Packet, Settings, Worker};
use crate::messages::ids::RobotId;
use crate::messages::local::{BodyTwist, Drive};
use crate::messages::wire::{Hardware, Reading};
use crate::time::Time;

/// Output of a driver.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// Command for the World that simulates the robot.
    Drive(Drive),
    /// Packet for its worker.
    Send(Packet),
    /// Pose and velocity that the robot has measured itself, in a frame of its own that drifts: odometry. The host's
    /// source may use it.
    Odometry(Reading),
    /// Condition of the robot: health, and charge, temperature and the reason of a fault where they are known.
    Condition(Hardware),
    /// Packet of the worker that was not understood, with the reason.
    Refused(&'static str),
}

/// Limits of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest speed \[m/s\]; infinite if the robot limits its own speed.
    pub speed_m_s: f32,
}

/// Command for a driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Velocity of the robot in the world frame, and the time until which it holds.
    pub drive: Drive,
    /// The velocity of `drive` as a motion in the robot's own frame, within the limits of its chassis. `None` while the
    /// heading is unknown or too old; a driver that needs the heading then stops the robot.
    pub body: Option<BodyTwist>,
}

/// Driver of one robot.
pub trait Driver {
    /// The robot's limits. A Body keeps to them.
    fn limits(&self) -> Limits;

    /// Drives the robot. While it moves, the newest command comes again with each reading, in the robot's own frame by
    /// its newest heading.
    fn drive(&mut self, now: Time, command: &Command, out: &mut Vec<Out>);

    /// Takes a packet of the worker.
    fn receive(&mut self, now: Time, packet: &[u8], out: &mut Vec<Out>);

    /// Time of its next wake-up; none if it needs none.
    fn wake_at(&self) -> Option<Time> {
        None
    }

    /// Does what is due at `now`.
    fn wake(&mut self, _now: Time, _out: &mut Vec<Out>) {}
}

/// Parts of a driver made from settings: a constructor of the pure part, called at each start of its actor, and the
/// worker.
pub struct Parts {
    /// Makes a new driver.
    pub driver: Box<dyn Fn() -> Box<dyn Driver>>,
    /// Worker that does the driver's I/O; `None` if the driver needs none.
    pub worker: Option<Box<dyn Worker>>,
}

/// Driver in a registry.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name of the driver in a deployment.
    pub name: &'static str,
    /// Description in one line, for the help.
    pub about: &'static str,
    /// Makes the driver of a robot from its settings; an error names the wrong setting.
    pub make: fn(&Settings, RobotId) -> Result<Parts, ConfigError>,
}

/// All drivers of real robots.
pub const REGISTRY: &[Entry] = &[
    Entry { name: "program", about: program::ABOUT, make: program::make },
    robomaster::ENTRY,
    Entry { name: "ros2", about: ros2::ABOUT, make: ros2::make },
];
