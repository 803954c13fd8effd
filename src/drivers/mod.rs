//! Drivers: what a robot's Body drives it with. A driver is one file and one line in `REGISTRY`.
//!
//! A driver is pure: it turns what the robot is to do into packets for its worker, and what the worker says into the
//! robot's health. Expiry of commands and the emergency stop are the Body's, for all drivers alike.

pub mod program;
pub mod simulated;

use crate::config::ConfigError;
use crate::edge::{Packet, Settings, Worker};
use crate::messages::geometry::Pose;
use crate::messages::ids::RobotId;
use crate::messages::local::Drive;
use crate::messages::telemetry::Health;
use crate::time::Time;

/// What a driver says.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// To the World that simulates the robot.
    Drive(Drive),
    /// To its worker.
    Tell(Packet),
    /// How the robot is, and what is left of its battery \[%\], if anybody knows.
    Condition(Health, Option<u8>),
    /// The worker has said something that is not to be understood; why.
    Refused(&'static str),
}

/// What a robot can do at the most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Speed \[m/s\]; infinite where the robot sees to that itself.
    pub speed_m_s: f32,
}

/// One robot's driver.
pub trait Driver {
    /// What the robot can do. A Body asks for no more.
    fn limits(&self) -> Limits;

    /// The robot is to move at a velocity of the world frame until a given time. `pose` is where it was measured last;
    /// a driver of wheels turns the velocity into the robot's own frame with it.
    fn drive(&mut self, now: Time, drive: &Drive, pose: Option<&Pose>, out: &mut Vec<Out>);

    /// The worker has said something.
    fn told(&mut self, now: Time, packet: &[u8], out: &mut Vec<Out>);
}

/// What is made of settings: the pure part, as often as its actor is started, and the one that does the I/O.
pub struct Made {
    /// Makes the driver afresh.
    pub driver: Box<dyn Fn() -> Box<dyn Driver>>,
    /// Does its I/O, if it has any.
    pub worker: Option<Box<dyn Worker>>,
}

/// A driver by name.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name in a deployment.
    pub name: &'static str,
    /// What it drives, in a line.
    pub about: &'static str,
    /// Makes it for a robot; wrong settings are named.
    pub make: fn(&Settings, RobotId) -> Result<Made, ConfigError>,
}

/// All drivers of robots that are not simulated.
pub const REGISTRY: &[Entry] = &[Entry { name: "program", about: program::ABOUT, make: program::make }];
