//! What may cross hosts. Every message here passes through a Network, also inside one process.
//!
//! Positions and velocities are in the world frame, \[m\] and \[m/s\]. Integers have a fixed width. Soft
//! state (`Heartbeat`, `Mode`) is repeated and idempotent; nothing here asks for an answer.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::floats;
pub use super::floats::{Features, MAX_FEATURES};
use super::geometry::{Deviation, Motion, Pose, Task, Twist, Vec2, is_sound};
use super::ids::{HostId, RobotId};
use super::latch::Latch;
pub use super::phase::Phase;
use super::round::MAX_EPOCH;
pub use super::round::Round;
pub use super::status::{Following, Hindrance, Leading, MAX_HINDRANCES, Status};
pub use super::telemetry::{Condition, Health, MAX_CONDITIONS, Observe, Seen, Telemetry};
use crate::time::Span;

/// The largest feature: a policy that says more has come apart.
pub const MAX_FEATURE: f32 = 1e6;
/// The most robots in one `Mode` block: 64 x 16 bytes stay inside one datagram.
pub const MAX_BLOCK: usize = 64;
/// The longest validity that a command may claim: a lost team must not roll on for longer.
pub const MAX_VALIDITY: Span = Span::from_millis(1000);

/// What a sensor says of a robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// The robot that is measured.
    pub robot: RobotId,
    /// When it was measured \[ns\], on the sensor's clock, which is compared with no other: it tells a new reading from
    /// a repeated one, and how far apart two are.
    pub stamp_ns: u64,
    /// Where it is and where it points.
    pub pose: Pose,
    /// How it moves and turns.
    pub twist: Twist,
    /// How good that is.
    pub deviation: Deviation,
}

impl Reading {
    /// What a sensor says that sees a point and no heading, and not how well it sees.
    pub fn of_point(robot: RobotId, stamp_ns: u64, motion: Motion) -> Reading {
        Reading {
            robot,
            stamp_ns,
            pose: Pose { position: motion.position, heading: None },
            twist: Twist { velocity: motion.velocity, yaw_rate: None },
            deviation: Deviation::default(),
        }
    }

    /// What policies take of it: position and velocity.
    pub fn motion(&self) -> Motion {
        Motion { position: self.pose.position, velocity: self.twist.velocity }
    }
}

/// What a robot broadcasts to its neighbours.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Latent {
    /// The sender.
    pub robot: RobotId,
    /// The round it acts in; a receiver in another round has no use for it.
    pub round: Round,
    /// The phase it acts in: latents of the reset policy and of the policy under test do not mix.
    pub phase: Phase,
    /// The sender's own estimate.
    pub motion: Motion,
    /// The message of its policy.
    pub features: Features,
}

/// What a robot's body is to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorCommand {
    /// The robot.
    pub robot: RobotId,
    /// Commanded velocity \[m/s\], world frame.
    #[serde(with = "floats::vec2")]
    pub velocity: Vec2,
    /// How long after arrival it holds; then the body stops.
    pub valid_for: Span,
}

/// Where a robot stands in the episode; soft state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Heartbeat {
    /// The robot.
    pub robot: RobotId,
    /// The last round that it heard of.
    pub round: Round,
    /// Its own phase in that round.
    pub phase: Phase,
    /// What it knows of the emergency stop.
    pub latch: Latch,
}

/// The whole instruction for one block of robots; soft state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mode {
    /// The round.
    pub round: Round,
    /// Which repeat of the experiment this trial is.
    pub repeat: u32,
    /// What the team is to do.
    pub phase: Phase,
    /// First robot of the block.
    pub first: RobotId,
    /// Start and goal of each robot of the block.
    #[serde(with = "floats::tasks")]
    pub tasks: Arc<[Task]>,
    /// What the state server knows of the emergency stop.
    pub latch: Latch,
}

impl Mode {
    /// The task of `robot`, if it is in this block.
    pub fn task_of(&self, robot: RobotId) -> Option<Task> {
        robot.0.checked_sub(self.first.0).and_then(|offset| self.tasks.get(usize::from(offset))).copied()
    }
}

/// The emergency stop, engaged or taken back, or the hold after it lifted: of an operator or a host, to everyone. It is
/// no soft state; hosts that hear it repeat its latch in `Heartbeat` and `Mode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stop {
    /// The host that says so.
    pub by: HostId,
    /// The latch that is to hold.
    pub latch: Latch,
}

impl Stop {
    /// Everyone is to stand. `seen` is the latest latch that `by` has heard of; none is needed.
    pub fn engage(by: HostId, seen: Latch) -> Stop {
        Stop { by, latch: Latch::engaged(seen.number() + 1) }
    }

    /// The stop is taken back; the team is held. `seen` is the latest latch that `by` has heard of: a later stop stays
    /// engaged.
    pub fn rearm(by: HostId, seen: Latch) -> Stop {
        Stop { by, latch: Latch::held(seen.number() + 1) }
    }

    /// The hold ends and the next episode begins, if the state server agrees. `seen` is the hold that is meant.
    pub fn resume(by: HostId, seen: Latch) -> Stop {
        Stop { by, latch: Latch::clear(seen.number() + 1) }
    }

    /// A question to everyone for their `Status`; it changes nothing.
    pub fn ask(by: HostId) -> Stop {
        Stop { by, latch: Latch::default() }
    }
}

/// Any message that may cross hosts.
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
    /// Whether it is between hosts and operators: it goes where the stop goes, and no deployment names it.
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

/// Why a message has no place on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unfit {
    /// A position, velocity or feature is NaN, infinite or too large.
    #[error("a number is not finite, or too large to be one")]
    Number,
    /// A list is empty or longer than its limit.
    #[error("a list is empty or too long")]
    Length,
    /// A command claims to hold longer than `MAX_VALIDITY`.
    #[error("a command claims too long a validity")]
    Validity,
    /// A `Mode` block runs past the last possible robot.
    #[error("a block of robots runs past the last possible one")]
    Block,
    /// The epoch of a round is larger than any.
    #[error("the epoch of a round is larger than any")]
    Epoch,
}

/// Whether no number is NaN, infinite or larger than `MAX_FEATURE`. Without a way out at the first: so it is a
/// handful of vector instructions. NaN is never at most anything.
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

    /// The robot that the message is about: sender or target; the first of its block for `Mode`, `Status` and
    /// `Telemetry`, the first of the team for `Stop` and `Observe`.
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

    /// Checks the message's own ranges, at both ends of a link.
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
        if round.epoch > MAX_EPOCH {
            return Err(Unfit::Epoch);
        }
        match self {
            Wire::Latent(m) if m.features.0.len() > MAX_FEATURES => Err(Unfit::Length),
            Wire::MotorCommand(m) if m.valid_for > MAX_VALIDITY => Err(Unfit::Validity),
            Wire::Mode(m) if m.tasks.is_empty() || m.tasks.len() > MAX_BLOCK => Err(Unfit::Length),
            Wire::Mode(m) if usize::from(m.first.0) + m.tasks.len() > 1 + usize::from(u16::MAX) => Err(Unfit::Block),
            Wire::Status(m) if m.robots.len() > MAX_BLOCK => Err(Unfit::Length),
            Wire::Telemetry(m) if m.robots.len() > MAX_CONDITIONS => Err(Unfit::Length),
            Wire::Status(m) if m.leading.as_ref().is_some_and(|l| l.hindrances.len() > MAX_HINDRANCES) => {
                Err(Unfit::Length)
            }
            _ => Ok(()),
        }
    }
}
