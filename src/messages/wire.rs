//! Messages that may cross hosts. Each passes through a Network, within one process too.
//!
//! Positions and velocities are in the world frame, \[m\] and \[m/s\]. Integers have a fixed width. Soft state
//! (`Heartbeat`, `Mode`) is repeated and idempotent; no message asks for an answer.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::floats;
pub use super::floats::{Features, MAX_FEATURES};
use super::geometry::{Deviation, Motion, Pose, Task, Twist, Vec2, is_sound};
pub use super::hardware::{Celsius, Hardware, Health, Reason};
use super::ids::{HostId, RobotId};
use super::kinds::{Body, Publisher};
pub use super::kinds::{KINDS, Kind, Unfit, Wire};
use super::latch::Latch;
pub use super::phase::Phase;
pub use super::place::{Located, Place, Placed, Whereabouts};
use super::round::MAX_TERM;
pub use super::round::Round;
pub use super::status::{Following, Hindrance, Leading, MAX_HINDRANCES, Status};
pub use super::telemetry::{Condition, GuardReport, MAX_CONDITIONS, Observe, Seen, Telemetry};
use crate::time::Span;

/// Revision of what this program's messages mean. It is raised with any change for which hosts from before and after it
/// must not drive together: a team of unequal revisions stands, while stops, re-arms and status work among all of it.
pub const REVISION: u16 = 1;
/// Largest absolute value of a number in the features that a policy sends. A policy that exceeds it counts as diverged.
pub(crate) const MAX_FEATURE: f32 = 1e6;
/// Largest number of robots in one [`Mode`] or [`Status`] message. The starts and goals of so many robots take 64 x 16
/// bytes and fit into one datagram.
pub const MAX_BLOCK: usize = 64;
/// Longest validity of a motor command: 1 s. A robot that no longer receives commands must stop within this time.
pub const MAX_VALIDITY: Span = Span::from_millis(1000);

/// Measurement of a robot's pose and velocity by a sensor, in the world frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Number of the robot that was measured.
    pub robot: RobotId,
    /// Time of measurement \[ns\] on the sensor's clock, whose offset from other clocks is unknown. The stamp
    /// distinguishes a new reading from a repeated one and gives the interval between two readings.
    pub stamp_ns: u64,
    /// Measured position and heading in the world frame.
    pub pose: Pose,
    /// Measured velocity and yaw rate in the world frame.
    pub twist: Twist,
    /// Standard deviations of the measured quantities, `None` for each that is unknown.
    pub deviation: Deviation,
}

impl Reading {
    /// Makes a reading of a sensor that measures only a point. Heading, yaw rate and standard deviations are `None`.
    /// `stamp_ns` is the time of measurement on the sensor's clock, `motion` the measured position and velocity in the
    /// world frame.
    pub fn of_point(robot: RobotId, stamp_ns: u64, motion: Motion) -> Reading {
        Reading {
            robot,
            stamp_ns,
            pose: Pose { position: motion.position, heading: None },
            twist: Twist { velocity: motion.velocity, yaw_rate: None },
            deviation: Deviation::default(),
        }
    }

    /// Returns the reason why a number of the reading is out of range; `None` if the reading is valid and may be
    /// published.
    pub fn unfit(&self) -> Option<&'static str> {
        match () {
            () if !is_sound(self.pose.position) => Some("a position is not finite, or beyond 100 km"),
            () if !self.pose.is_sound() => Some("a heading is not within -pi and pi: wrap it"),
            () if !self.twist.is_sound() => Some("a velocity or a yaw rate is not finite, or beyond any robot's"),
            () if !self.deviation.is_sound() => Some("a standard deviation is negative or not finite"),
            () => None,
        }
    }

    /// Returns the measured position and velocity, without heading and yaw rate, which policies do not use.
    pub fn motion(&self) -> Motion {
        Motion { position: self.pose.position, velocity: self.twist.velocity }
    }
}

/// Message that a robot broadcasts to its neighbours: the numbers from its policy and its own motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Latent {
    /// Number of the robot that sends the message.
    pub robot: RobotId,
    /// Round, the number of the state server's instruction, that the sender follows. A receiver in another round
    /// ignores the message.
    pub round: Round,
    /// Phase of the episode that the sender is in. It keeps messages of the reset policy apart from those of the policy
    /// under test.
    pub phase: Phase,
    /// The sender's estimate of its own position and velocity in the world frame.
    pub motion: Motion,
    /// Numbers from the sender's policy, such as the encoder's output of a graph neural network.
    pub features: Features,
}

/// Velocity command for a robot, sent from its Controller to its Body, the actor that drives the motors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorCommand {
    /// Number of the robot that is to move.
    pub robot: RobotId,
    /// Commanded velocity \[m/s\], world frame.
    #[serde(with = "floats::vec2")]
    pub velocity: Vec2,
    /// Time after arrival for which the command is valid. The Body stops the robot when the time is over without a
    /// newer command.
    pub valid_for: Span,
}

/// Progress of one robot in the episode, repeated to the state server (the team's coordinator).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Heartbeat {
    /// Number of the robot that reports.
    pub robot: RobotId,
    /// Round (number) of the last instruction of the state server that the robot has followed.
    pub round: Round,
    /// Phase of the episode that the robot itself is in.
    pub phase: Phase,
    /// Emergency stop state that the robot follows.
    pub latch: Latch,
    /// Revision of the host's messages: see [`REVISION`]; 0 in records from before there were any.
    #[serde(default)]
    pub revision: u16,
}

/// Instruction of the state server (the team's coordinator) for a block of robots with consecutive numbers. It is
/// repeated, so a lost message does no harm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mode {
    /// Round, the number of this instruction, by which receivers distinguish later instructions from earlier ones.
    pub round: Round,
    /// Index of the trial among the repeats of the experiment, from zero.
    pub repeat: u32,
    /// Phase of the episode that the team is to be in.
    pub phase: Phase,
    /// Number of the first robot of the block.
    pub first: RobotId,
    /// Start and goal of each robot of the block: entry i is for the robot with number `first` + i.
    #[serde(with = "floats::tasks")]
    pub tasks: Arc<[Task]>,
    /// Emergency stop state that the state server follows.
    pub latch: Latch,
}

impl Mode {
    /// Returns start and goal of `robot`; `None` if the robot is not in the block of this message.
    pub fn task_of(&self, robot: RobotId) -> Option<Task> {
        robot.0.checked_sub(self.first.0).and_then(|offset| self.tasks.get(usize::from(offset))).copied()
    }
}

/// Emergency stop, re-arm or resume, sent from an operator or a host to every host. A re-arm takes the stop back but
/// keeps the team standing; a resume lets the robots move again. The message is sent for each change only; receivers
/// repeat its latch in [`Heartbeat`] and [`Mode`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stop {
    /// Number of the host or operator that sends the message.
    pub by: HostId,
    /// Emergency stop state that the receivers are to take over.
    pub latch: Latch,
}

impl Stop {
    /// Makes a message that stops all robots. `by` is the sender, `seen` the latest emergency stop state that the
    /// sender knows of, or the default if it knows of none.
    pub fn engage(by: HostId, seen: Latch) -> Stop {
        Stop { by, latch: Latch::engaged(seen.number() + 1) }
    }

    /// Makes a message that takes an emergency stop back, or holds a team that runs; the team stays held until a
    /// resume. `by` is the sender, `seen` the latest state that the sender knows of. A stop later than `seen` stays
    /// engaged.
    pub fn rearm(by: HostId, seen: Latch) -> Stop {
        Stop { by, latch: Latch::held(seen.number() + 1) }
    }

    /// Makes a message that ends a hold and begins the next episode, if the state server (the team's coordinator)
    /// agrees. `by` is the sender, `seen` the held state that is to end.
    pub fn resume(by: HostId, seen: Latch) -> Stop {
        Stop { by, latch: Latch::clear(seen.number() + 1) }
    }

    /// Makes a message by which the sender `by` asks every host for its [`Status`]. The emergency stop state stays as
    /// it is.
    pub fn ask(by: HostId) -> Stop {
        Stop { by, latch: Latch::default() }
    }
}

/// Whether no number in `floats` is NaN, infinite or larger than [`MAX_FEATURE`] (1e6) in absolute value. There is no
/// early return, so the function compiles to a few vector instructions.
pub(crate) fn all_sound(floats: &[f32]) -> bool {
    floats.iter().fold(true, |all, float| all & (float.abs() <= MAX_FEATURE))
}

impl Body for Reading {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        let sound = self.pose.is_sound() && self.twist.is_sound() && self.deviation.is_sound();
        sound.then_some(()).ok_or(Unfit::Number)
    }
}

impl Body for Latent {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        match () {
            () if !self.motion.is_sound() || !all_sound(&self.features.0) => Err(Unfit::Number),
            () if self.round.term > MAX_TERM => Err(Unfit::Term),
            () if self.features.0.len() > MAX_FEATURES => Err(Unfit::Length),
            () => Ok(()),
        }
    }
}

impl Body for MotorCommand {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        match () {
            () if !is_sound(self.velocity) => Err(Unfit::Number),
            () if self.valid_for > MAX_VALIDITY => Err(Unfit::Validity),
            () => Ok(()),
        }
    }
}

impl Heartbeat {
    /// Makes a heartbeat of `robot`, which follows the instruction of `round`, is in `phase` itself, and follows `latch`.
    pub fn new(robot: RobotId, round: Round, phase: Phase, latch: Latch) -> Heartbeat {
        Heartbeat { robot, round, phase, latch, revision: REVISION }
    }
}

impl Body for Heartbeat {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        if self.round.term > MAX_TERM { Err(Unfit::Term) } else { Ok(()) }
    }
}

impl Body for Mode {
    fn robot(&self) -> RobotId {
        self.first
    }

    fn check(&self) -> Result<(), Unfit> {
        match () {
            () if !self.tasks.iter().all(|task| is_sound(task.start) && is_sound(task.goal)) => Err(Unfit::Number),
            () if self.round.term > MAX_TERM => Err(Unfit::Term),
            () if self.tasks.is_empty() || self.tasks.len() > MAX_BLOCK => Err(Unfit::Length),
            () if usize::from(self.first.0) + self.tasks.len() > 1 + usize::from(u16::MAX) => Err(Unfit::Block),
            () => Ok(()),
        }
    }
}

impl Body for Stop {
    fn robot(&self) -> RobotId {
        RobotId(0)
    }

    fn check(&self) -> Result<(), Unfit> {
        Ok(())
    }

    fn author(&self) -> Option<HostId> {
        (!self.latch.is_engaged()).then_some(self.by)
    }

    /// Every host may stop the team; only an operator, or the host of the state server, may re-arm or resume it.
    fn is_for(&self, is: impl Fn(Publisher, RobotId) -> bool) -> bool {
        let robot = self.robot();
        self.latch.is_engaged() || is(Publisher::Operator, robot) || is(Publisher::StateServer, robot)
    }
}
