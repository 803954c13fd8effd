//! Drivers: access of a Body to its robot's motors. A driver is one file and one line in `REGISTRY`.
//!
//! A driver does no I/O: it turns velocities into packets for its worker, and the worker's packets into the robot's
//! condition. The Body handles expiry of commands and the emergency stop, for all drivers alike.

mod program;
pub(crate) mod simulated;

use crate::config::ConfigError;
use crate::edge::{Packet, Settings, Worker};
use crate::messages::ids::RobotId;
use crate::messages::local::{BodyTwist, Drive};
use crate::messages::wire::{Flight, Hardware, Reading};
use crate::time::Time;

/// Output of a driver: a command or packet that moves its robot, or something that it has learned of the robot.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// Velocity command for the World, the actor that simulates the robot; only the driver of simulated robots has it.
    Drive(Drive),
    /// Packet for the driver's worker, the thread that does its input and output.
    Send(Packet),
    /// Pose and velocity that the robot has measured itself, in a frame of its own that drifts: odometry. The source of
    /// readings of the robot's host may use it.
    Odometry(Reading),
    /// Condition of the robot: health, and charge, temperature and the reason of a fault where they are known.
    Condition(Hardware),
    /// State of the robot's flight, at each change and after an order that changes nothing; only of a robot that flies.
    Flight(Flight),
    /// Packet of the worker that was not understood, with the reason.
    Refused(&'static str),
}

/// Limits of a robot's motion, as its driver states them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest speed \[m/s\]; infinite if the robot limits its own speed.
    pub speed_m_s: f32,
}

/// Velocity command for a driver, in the world frame and in the robot's own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Commanded velocity of the robot in the world frame, and the time at which the robot has to stop without a newer
    /// command.
    pub drive: Drive,
    /// The velocity of `drive` as a motion in the robot's own frame, within the limits of its chassis. `None` while the
    /// heading is unknown or too old; a driver that needs the heading then stops the robot.
    pub body: Option<BodyTwist>,
}

/// Order of a Body about the height of a robot that flies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Vertical {
    /// Rise from the ground to this height above it \[m\], and stay there while velocities of the plane are driven.
    Rise {
        /// Height above the ground at which the robot flies \[m\], above zero.
        height_m: f32,
    },
    /// Land where the robot is, and switch its motors off.
    Land,
    /// Switch the motors off at once, wherever the robot is. Only an operator's own, confirmed order leads to it.
    Cut,
}

/// Part of one robot's driver that does no I/O: turns velocities into packets for the driver's worker, and the worker's
/// packets into the robot's condition.
pub trait Driver {
    /// Returns the limits of the robot's motion. A Body caps every commanded speed at them.
    fn limits(&self) -> Limits;

    /// Carries out a command: appends packets or drive commands to `out`. While the robot moves, the Body calls it
    /// again with the newest command, converted with the newest measured heading, as readings arrive.
    fn drive(&mut self, now: Time, command: &Command, out: &mut Vec<Out>);

    /// Handles a packet that the driver's worker has sent, and appends the driver's output to `out`.
    fn receive(&mut self, now: Time, packet: &[u8], out: &mut Vec<Out>);

    /// Returns whether the robot flies: whether `fly` has an effect, and the driver reports the state of the flight.
    fn flies(&self) -> bool {
        false
    }

    /// Carries out an order about the height of a robot that flies. The Body repeats an order that the reported state
    /// of the flight does not follow, so a second one must be harmless. Between the orders, a robot at its height holds
    /// its place while it is driven at zero velocity, or is not driven.
    fn fly(&mut self, _now: Time, _order: Vertical, _out: &mut Vec<Out>) {}

    /// Takes a reading of the robot by the team's source, world frame, for a robot that has to be told where it is.
    fn measured(&mut self, _now: Time, _reading: &Reading, _out: &mut Vec<Out>) {}

    /// Returns the time at which `wake` has to be called next; `None` if the driver needs no wake-up.
    fn wake_at(&self) -> Option<Time> {
        None
    }

    /// Does the driver's work that is due at `now`, such as repeating a stand command, and appends its output to `out`.
    fn wake(&mut self, _now: Time, _out: &mut Vec<Out>) {}
}

/// The two parts of a robot's driver, made from its settings: a constructor of the part without I/O, which is called at
/// each start of the robot's Body, and the worker.
pub struct Parts {
    /// Makes a new instance of the part without I/O.
    pub driver: Box<dyn Fn() -> Box<dyn Driver>>,
    /// Worker that does the driver's I/O; `None` if the driver needs none.
    pub worker: Option<Box<dyn Worker>>,
}

/// Entry of a kind of driver in the registry: its name, its description, and the function that makes it.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name by which a deployment selects the driver.
    pub name: &'static str,
    /// Description of the driver in one line, for the program's help text.
    pub about: &'static str,
    /// Makes the driver of a robot from its settings; an error names the wrong setting.
    pub make: fn(&Settings, RobotId) -> Result<Parts, ConfigError>,
}

/// All drivers of real robots in this crate, from which a deployment selects one by name.
pub const REGISTRY: &[Entry] = &[Entry { name: "program", about: program::ABOUT, make: program::make }];
