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
use super::latch::Latch;
pub use super::phase::Phase;
use super::round::MAX_TERM;
pub use super::round::Round;
pub use super::status::{Following, Hindrance, Leading, MAX_HINDRANCES, Status};
pub use super::telemetry::{Condition, MAX_CONDITIONS, Observe, Seen, Telemetry};
use crate::time::Span;

/// Largest feature: a policy that exceeds it has diverged.
pub const MAX_FEATURE: f32 = 1e6;
/// Most robots in one `Mode` block: 64 x 16 bytes fit into one datagram.
pub const MAX_BLOCK: usize = 64;
/// Longest validity of a command: robots that lose their team must not drive on for longer.
pub const MAX_VALIDITY: Span = Span::from_millis(1000);

/// Measurement of a robot by a sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// The robot that is measured.
    pub robot: RobotId,
    /// Time of measurement \[ns\] on the sensor's clock, which is compared with no other. It distinguishes a new
    /// reading from a repeated one and gives the interval between two.
    pub stamp_ns: u64,
    /// Measured position and heading.
    pub pose: Pose,
    /// Measured velocity and yaw rate.
    pub twist: Twist,
    /// Standard deviations of the measurement.
    pub deviation: Deviation,
}

impl Reading {
    /// Reading of a sensor that measures a point: without heading, with unknown deviations.
    pub fn of_point(robot: RobotId, stamp_ns: u64, motion: Motion) -> Reading {
        Reading {
            robot,
            stamp_ns,
            pose: Pose { position: motion.position, heading: None },
            twist: Twist { velocity: motion.velocity, yaw_rate: None },
            deviation: Deviation::default(),
        }
    }

    /// Reason why the reading is out of range; none if it may be published.
    pub fn unfit(&self) -> Option<&'static str> {
        match () {
            () if !is_sound(self.pose.position) => Some("a position is not finite, or beyond 100 km"),
            () if !self.pose.is_sound() => Some("a heading is not within -pi and pi: wrap it"),
            () if !self.twist.is_sound() => Some("a velocity or a yaw rate is not finite, or beyond any robot's"),
            () if !self.deviation.is_sound() => Some("a standard deviation is negative or not finite"),
            () => None,
        }
    }

    /// Position and velocity, which policies use.
    pub fn motion(&self) -> Motion {
        Motion { position: self.pose.position, velocity: self.twist.velocity }
    }
}

/// Broadcast of a robot to its neighbours.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Latent {
    /// The sender.
    pub robot: RobotId,
    /// Round it acts in; a receiver in another round ignores the message.
    pub round: Round,
    /// Phase it acts in: latents of the reset policy and of the policy under test do not mix.
    pub phase: Phase,
    /// The sender's own estimate.
    pub motion: Motion,
    /// Message of its policy.
    pub features: Features,
}

/// Command for a robot's motors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorCommand {
    /// The robot.
    pub robot: RobotId,
    /// Commanded velocity \[m/s\], world frame.
    #[serde(with = "floats::vec2")]
    pub velocity: Vec2,
    /// Time after arrival during which it is valid; then the body stops.
    pub valid_for: Span,
}

/// Progress of a robot in the episode; soft state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Heartbeat {
    /// The robot.
    pub robot: RobotId,
    /// Last round that it has received.
    pub round: Round,
    /// Its own phase in that round.
    pub phase: Phase,
    /// Latch that it follows.
    pub latch: Latch,
}

/// Instruction of the state server for one block of robots; soft state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mode {
    /// The round.
    pub round: Round,
    /// Index of the trial among the repeats of the experiment.
    pub repeat: u32,
    /// Phase that the team is to be in.
    pub phase: Phase,
    /// First robot of the block.
    pub first: RobotId,
    /// Start and goal of each robot of the block.
    #[serde(with = "floats::tasks")]
    pub tasks: Arc<[Task]>,
    /// Latch that the state server follows.
    pub latch: Latch,
}

impl Mode {
    /// The task of `robot`, if it is in this block.
    pub fn task_of(&self, robot: RobotId) -> Option<Task> {
        robot.0.checked_sub(self.first.0).and_then(|offset| self.tasks.get(usize::from(offset))).copied()
    }
}

/// Emergency stop, its re-arm or the resume after it, from an operator or a host to every host. It is not soft state;
/// hosts that receive it repeat its latch in `Heartbeat` and `Mode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stop {
    /// Host that sent it.
    pub by: HostId,
    /// Latch that is to hold.
    pub latch: Latch,
}

impl Stop {
    /// Stops all robots. `seen` is the latest latch that `by` knows of; none is needed.
    pub fn engage(by: HostId, seen: Latch) -> Stop {
        Stop { by, latch: Latch::engaged(seen.number() + 1) }
    }

    /// Takes the stop back; the team is held. `seen` is the latest latch that `by` knows of: a later stop stays
    /// engaged.
    pub fn rearm(by: HostId, seen: Latch) -> Stop {
        Stop { by, latch: Latch::held(seen.number() + 1) }
    }

    /// Ends the hold and begins the next episode, if the state server agrees. `seen` is the hold that is meant.
    pub fn resume(by: HostId, seen: Latch) -> Stop {
        Stop { by, latch: Latch::clear(seen.number() + 1) }
    }

    /// Asks every host for its `Status`; it changes nothing.
    pub fn ask(by: HostId) -> Stop {
        Stop { by, latch: Latch::default() }
    }
}

/// A message that may cross hosts.
#[derive(Clone, Debug, PartialEq)]
pub enum Wire {
    /// Body to Cache.
    Reading(Reading),
    /// Agent to the Caches of its neighbours.
    Latent(Latent),
    /// Controller to Body.
    MotorCommand(MotorCommand),
    /// Controller to StateServer.
    Heartbeat(Heartbeat),
    /// StateServer to everyone.
    Mode(Mode),
    /// Anyone to everyone.
    Stop(Stop),
    /// A host to operators and to the StateServer.
    Status(Status),
    /// An observer to everyone.
    Observe(Observe),
    /// A host to observers.
    Telemetry(Telemetry),
}

/// The kinds of wire messages, as the deployment's table names them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A [`Reading`].
    Reading,
    /// A [`Latent`].
    Latent,
    /// A [`MotorCommand`].
    MotorCommand,
    /// A [`Heartbeat`].
    Heartbeat,
    /// A [`Mode`].
    Mode,
    /// A [`Stop`].
    Stop,
    /// A [`Status`]; it travels on the link of the stop.
    Status,
    /// An [`Observe`]; likewise.
    Observe,
    /// A [`Telemetry`]; likewise.
    Telemetry,
}

impl Kind {
    /// Whether it is between hosts and operators: it is routed like `Stop`, and no deployment names it.
    pub fn follows_the_stop(self) -> bool {
        matches!(self, Kind::Status | Kind::Observe | Kind::Telemetry)
    }
}

/// All kinds, in the order of their numbers on the wire.
pub const KINDS: [Kind; 9] = [
    Kind::Reading,
    Kind::Latent,
    Kind::MotorCommand,
    Kind::Heartbeat,
    Kind::Mode,
    Kind::Stop,
    Kind::Status,
    Kind::Observe,
    Kind::Telemetry,
];

/// Reason for which a message may not be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unfit {
    /// A position, velocity or feature is NaN, infinite or too large.
    #[error("a number is not finite or out of range")]
    Number,
    /// A list is empty or longer than its limit.
    #[error("a list is empty or too long")]
    Length,
    /// The validity of a command exceeds `MAX_VALIDITY`.
    #[error("the validity of a command is too long")]
    Validity,
    /// A `Mode` block exceeds the largest robot id.
    #[error("a block of robots exceeds the largest robot id")]
    Block,
    /// The term of a round is out of range.
    #[error("the term of a round is out of range")]
    Term,
}

/// Whether no number is NaN, infinite or larger than `MAX_FEATURE`. No early return, so that it compiles to a few
/// vector instructions. NaN is never at most anything.
pub fn all_sound(floats: &[f32]) -> bool {
    floats.iter().fold(true, |all, float| all & (float.abs() <= MAX_FEATURE))
}

impl Wire {
    /// The message's kind.
    pub fn kind(&self) -> Kind {
        match self {
            Wire::Reading(_) => Kind::Reading,
            Wire::Latent(_) => Kind::Latent,
            Wire::MotorCommand(_) => Kind::MotorCommand,
            Wire::Heartbeat(_) => Kind::Heartbeat,
            Wire::Mode(_) => Kind::Mode,
            Wire::Stop(_) => Kind::Stop,
            Wire::Status(_) => Kind::Status,
            Wire::Observe(_) => Kind::Observe,
            Wire::Telemetry(_) => Kind::Telemetry,
        }
    }

    /// Robot that the message is about: sender or target. For `Mode`, `Status` and `Telemetry` the first of its block,
    /// for `Stop` and `Observe` the first of the team.
    pub fn robot(&self) -> RobotId {
        match self {
            Wire::Reading(m) => m.robot,
            Wire::Latent(m) => m.robot,
            Wire::MotorCommand(m) => m.robot,
            Wire::Heartbeat(m) => m.robot,
            Wire::Mode(m) => m.first,
            Wire::Stop(_) | Wire::Observe(_) => RobotId(0),
            Wire::Telemetry(m) => m.robots.first().map_or(RobotId(0), |condition| condition.robot),
            Wire::Status(m) => m.robots.first().map_or(RobotId(0), |following| following.robot),
        }
    }

    /// Checks the message's own ranges; both ends of a link call it.
    pub fn check(&self) -> Result<(), Unfit> {
        let sound = match self {
            Wire::Reading(m) => m.pose.is_sound() && m.twist.is_sound() && m.deviation.is_sound(),
            Wire::Latent(m) => m.motion.is_sound() && all_sound(&m.features.0),
            Wire::MotorCommand(m) => is_sound(m.velocity),
            Wire::Telemetry(m) => m.robots.iter().filter_map(|robot| robot.seen).all(|seen| seen.pose.is_sound()),
            Wire::Heartbeat(_) | Wire::Stop(_) | Wire::Status(_) | Wire::Observe(_) => true,
            Wire::Mode(m) => m.tasks.iter().all(|task| is_sound(task.start) && is_sound(task.goal)),
        };
        if !sound {
            return Err(Unfit::Number);
        }
        let round = match self {
            Wire::Latent(m) => m.round,
            Wire::Heartbeat(m) => m.round,
            Wire::Mode(m) => m.round,
            _ => Round::default(),
        };
        if round.term > MAX_TERM {
            return Err(Unfit::Term);
        }
        match self {
            Wire::Latent(m) if m.features.0.len() > MAX_FEATURES => Err(Unfit::Length),
            Wire::MotorCommand(m) if m.valid_for > MAX_VALIDITY => Err(Unfit::Validity),
            Wire::Mode(m) if m.tasks.is_empty() || m.tasks.len() > MAX_BLOCK => Err(Unfit::Length),
            Wire::Mode(m) if usize::from(m.first.0) + m.tasks.len() > 1 + usize::from(u16::MAX) => Err(Unfit::Block),
            Wire::Status(m) if m.robots.len() > MAX_BLOCK => Err(Unfit::Length),
            Wire::Telemetry(m) if m.robots.len() > MAX_CONDITIONS => Err(Unfit::Length),
            Wire::Telemetry(m) if m.robots.iter().filter(|robot| robot.reason.is_some()).count() > 1 => {
                Err(Unfit::Length)
            }
            Wire::Status(m) if m.leading.as_ref().is_some_and(|l| l.hindrances.len() > MAX_HINDRANCES) => {
                Err(Unfit::Length)
            }
            _ => Ok(()),
        }
    }
}
