//! How a team is led: the robots' heartbeats, the state server's instruction, and the emergency stop.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::body::{Body, MAX_BLOCK, Publisher, REVISION, Unfit};
use super::floats;
use super::geometry::{Task, is_sound};
use super::ids::{HostId, RobotId};
use super::latch::Latch;
use super::phase::Phase;
use super::round::{MAX_TERM, Round};

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
    /// Beginning of the digest of the robot's policy, by which a team of unequal policies is noticed; 0, which is not
    /// sent, in simulations and from versions before it.
    #[serde(default, skip_serializing_if = "is_unsaid")]
    pub policy: u32,
    /// Beginning of the digest of the team's task file, by which hosts with unequal ones are noticed; 0, which is not
    /// sent, in simulations and for a scenario that is not from a file. It is sent with a policy alone.
    #[serde(default, skip_serializing_if = "is_unsaid")]
    pub task: u32,
}

/// Beginnings of the digests of what all hosts of a team must have alike, as heartbeats say them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Marks {
    /// Mark of the policy; 0 in simulations, and where it is not known.
    pub policy: u32,
    /// Mark of the task file; 0 in simulations, and for a scenario that is not from a file.
    pub task: u32,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_unsaid(mark: &u32) -> bool {
    *mark == 0
}

impl Heartbeat {
    /// Makes a heartbeat of `robot`, which follows the instruction of `round`, is in `phase` itself, and follows
    /// `latch`.
    pub fn new(robot: RobotId, round: Round, phase: Phase, latch: Latch) -> Heartbeat {
        Heartbeat { robot, round, phase, latch, revision: REVISION, policy: 0, task: 0 }
    }

    /// Returns the heartbeat with the marks of the robot's host.
    pub(crate) fn of(self, Marks { policy, task }: Marks) -> Heartbeat {
        // A mark after one that is left out would be taken for it.
        Heartbeat { policy, task: if policy == 0 { 0 } else { task }, ..self }
    }
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

    /// Returns whether the message would end a stop or a hold: it is a re-arm, a hold or a resume. Where members have
    /// keys of their own, operators sign these.
    pub(crate) fn releases(&self) -> bool {
        !self.latch.is_engaged() && self.latch != Latch::default()
    }

    /// Makes a message by which the sender `by` asks every host for its `Status`. The emergency stop state stays as
    /// it is.
    pub fn ask(by: HostId) -> Stop {
        Stop { by, latch: Latch::default() }
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
    fn author(&self) -> Option<HostId> {
        (!self.latch.is_engaged()).then_some(self.by)
    }

    /// Every host may stop the team, and its own hosts and operators may say that it is held. Whoever hears that takes
    /// it for a re-arm from operators alone. A resume is for operators, and for the host of the state server.
    fn is_for(&self, is: impl Fn(Publisher, RobotId) -> bool) -> bool {
        let robot = self.robot();
        let member = self.latch.is_held() && is(Publisher::Member, robot) || is(Publisher::StateServer, robot);
        self.latch.is_engaged() || member || is(Publisher::Operator, robot)
    }
}
