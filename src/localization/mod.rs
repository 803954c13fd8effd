//! Localization: sources of readings (measured poses and velocities) of robots. A source is one module and one line in
//! `REGISTRY`.
//!
//! A source does no I/O: it converts the packets of its worker, or the samples of a World, to readings.

pub mod alignment;
pub mod check;
pub mod fix;
mod fused_state;
pub(crate) mod fusion;
pub mod geodesy;
pub mod odometry;
pub mod plausibility;
pub mod program;
pub mod screen;
pub mod simulated;

use crate::config::ConfigError;
use crate::edge::{Settings, Worker};
use crate::messages::geometry::Pose;
use crate::messages::ids::RobotId;
use crate::messages::local::Sample;
use crate::messages::place::Whereabouts;
use crate::messages::wire::Reading;
use crate::time::Time;
use plausibility::{Limits, Quality};

/// Input of a source of readings, which localizes robots.
#[derive(Clone, Debug)]
pub enum In<'a> {
    /// True state of a simulated robot, from the World.
    Sample(&'a Sample),
    /// Packet from the worker of the source.
    Packet(&'a [u8]),
    /// Pose and velocity that a robot of this host has measured itself, in a frame of its own that drifts.
    Odometry(&'a Reading),
}

/// Output of a source of readings, which localizes robots.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// Measured pose and velocity of one robot.
    Reading(Reading),
    /// Notice that an input could not be used, with the reason.
    Refused(&'static str),
    /// Notice that what an input says of one robot could not be used, with the reason. What it says of others counts.
    RefusedOf(RobotId, &'static str),
    /// Notice that the source does not know any more where a robot is, and why. Its next reading of the robot says that
    /// it knows again.
    Lost(RobotId, Whereabouts),
}

/// Source of readings of robots: converts packets from sensors, or true states of simulated robots, to poses and
/// velocities. Implementations do no I/O.
pub trait Source {
    /// Handles one input at time `now` and appends readings and refusals to `out`.
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>);

    /// Returns the time at which `wake` has to be called next; `None` if no call is needed.
    fn wake_at(&self) -> Option<Time> {
        None
    }

    /// Does the work that is due at time `_now` and appends readings to `_out`; called at the time that `wake_at`
    /// gives.
    fn wake(&mut self, _now: Time, _out: &mut Vec<Out>) {}

    /// Tells the source that nothing uses its velocities and headings, because they are found from its positions: by
    /// fusion with odometry, or by an estimator. So the source may put out positions that it cannot add them to.
    fn positions_suffice(&mut self) {}

    /// Returns what the plausibility check of poses may assume of the newest reading of `_robot`. The default is for
    /// absolute poses.
    fn quality(&self, _robot: RobotId) -> Quality {
        Quality::MEASURED
    }

    /// Tells the source the limits of a robot's motion, once before its first input; for sources that judge poses
    /// themselves.
    fn limit(&mut self, _robot: RobotId, _limits: &Limits) {}

    /// Takes over that `_robot` stands at `_pose` of the team's frame, as a person has said. Returns false if the
    /// source has no state that this could change, such as one that measures absolute poses.
    fn place(&mut self, _now: Time, _robot: RobotId, _pose: &Pose) -> bool {
        false
    }
}

/// Parts of a source of readings: a constructor of its logic, and the worker that does its I/O.
pub struct Parts {
    /// Makes a new source; called at each start of the actor that uses the source.
    pub source: Box<dyn Fn() -> Box<dyn Source>>,
    /// Worker that does the I/O of the source on a thread of its own.
    pub worker: Box<dyn Worker>,
}

/// Entry of a source of readings in the registry.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name of the source, by which a deployment selects it.
    pub name: &'static str,
    /// Description of the source in one line, for lists of all sources.
    pub about: &'static str,
    /// Makes the source from its settings in a deployment and the robots that it has to localize. The error names the
    /// wrong setting.
    pub make: fn(&Settings, &[RobotId]) -> Result<Parts, ConfigError>,
}

/// All sources of readings of real robots that this crate contains.
pub const REGISTRY: &[Entry] = &[
    Entry { name: "odometry", about: odometry::ABOUT, make: odometry::make },
    Entry { name: "program", about: program::ABOUT, make: program::make },
];
