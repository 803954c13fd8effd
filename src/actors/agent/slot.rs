//! Robots of an Agent: their policies, and what each keeps from one step to the next.

use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::ids::RobotId;
use crate::messages::local::Percept;
use crate::messages::wire::{MAX_FEATURES, Phase, all_sound};
use crate::observation::{Bound, Dynamics, Known, Observation};
use crate::policy::Policy;
use crate::random::Stream;
use crate::scenario::Scenario;
use crate::time::{Span, Time};

/// Policies with which an Agent drives one of its robots, and the random streams of that robot.
pub struct RobotPolicies {
    /// Robot that the policies control.
    pub robot: RobotId,
    /// How the robot follows the velocities that the policies command; a part of their observation.
    pub dynamics: Dynamics,
    /// Channels that the policy under test takes.
    pub channels: Bound,
    /// Policy under test, used in running episodes.
    pub run: Box<dyn Policy>,
    /// Policy that drives the robot to its start in a reset.
    pub reset: Box<dyn Policy>,
    /// Random stream from which both policies sample their actions.
    pub actions: Stream,
    /// Random stream of the communication ranges between this robot and the others of the same Agent.
    pub ranges: Stream,
}

impl RobotPolicies {
    /// Returns the policy that is used in `phase`.
    pub(super) fn of(&mut self, phase: Phase) -> &mut dyn Policy {
        if phase == Phase::Running { &mut *self.run } else { &mut *self.reset }
    }

    /// Returns the observation of the robot, which is bound for the goal of `task`, without values of channels.
    pub(super) fn observe(
        &self,
        scenario: &dyn Scenario,
        task: &Task,
        percept: &Percept,
        elapsed: Span,
    ) -> Observation<'static> {
        let frame = scenario.frame(task);
        let heading = percept.heading.map(|heading| frame.turn_angle(heading));
        let (dynamics, yaw_rate) = (self.dynamics, percept.yaw_rate);
        Observation { dynamics, frame, heading, yaw_rate, elapsed, ..scenario.observe(task, &percept.estimate) }
    }
}

/// State of one robot within an Agent: its policies, task, newest percept and latent.
pub(super) struct Slot {
    pub policies: RobotPolicies,
    pub task: Option<Task>,
    pub percept: Option<Percept>,
    /// Observation of the robot in the current step, without values of channels.
    pub own: Observation<'static>,
    /// Values of the channels that the policy under test takes, in the current step.
    pub values: Vec<f32>,
    /// Times of the robot's last step in a running episode, and of the one before it; `None` if there is none.
    stepped: [Option<Time>; 2],
    /// Latent features that the robot broadcasts in the current step.
    pub features: Vec<f32>,
    /// Whether `features` is a valid latent: finite and of the declared length. If not, the policy has failed and its
    /// actions are not used.
    pub valid: bool,
    /// Whether the step counts as none, because the policy says that it has failed.
    pub failed: bool,
    /// Whether the robot broadcasts `features` in this step.
    pub says: bool,
    /// Whether the policy under test has begun a step in the Agent's last step, which can be taken back.
    pub fresh: bool,
    /// Whether the log has said that the latent is invalid, since it was last valid.
    pub reported: bool,
    /// Expected lengths of the latent features: of the policy under test, and of the reset policy.
    pub widths: [usize; 2],
}

impl Slot {
    pub fn new(policies: RobotPolicies) -> Slot {
        let widths = [&policies.run, &policies.reset].map(|policy| policy.interface().features);
        let values = vec![0.0; policies.channels.floats()];
        Slot {
            policies,
            task: None,
            percept: None,
            own: Observation::new(Motion::default(), Vec2::zeros()),
            values,
            stepped: [None; 2],
            features: Vec::new(),
            valid: true,
            failed: false,
            says: false,
            fresh: false,
            reported: false,
            widths,
        }
    }

    pub fn width(&self, phase: Phase) -> usize {
        self.widths[usize::from(phase != Phase::Running)]
    }

    /// Takes the broadcast that the policy has computed together with its action in `phase`, if it has; none if the
    /// step has failed.
    pub fn take_broadcast(&mut self, phase: Phase) {
        if self.failed || !self.valid {
            return;
        }
        let policy = self.policies.of(phase);
        if policy.failed() {
            self.fail(phase);
            return;
        }
        let Some(broadcast) = policy.broadcast() else { return };
        self.features.clear();
        self.features.extend_from_slice(broadcast);
        self.says = true;
        self.check(self.features.len(), self.width(phase));
    }

    /// Checks and returns whether `features` is a valid latent of a policy that has declared `declared` floats, and now
    /// `width`.
    pub fn check(&mut self, width: usize, declared: usize) -> bool {
        let valid = width == declared && width <= MAX_FEATURES && all_sound(&self.features);
        if !valid && !self.reported {
            tracing::error!(width, declared, "the policy's output is not a valid latent; its robot stops");
            self.reported = true;
        }
        self.valid = valid;
        valid
    }

    /// Puts the policy under test back to its start, for a new episode.
    pub fn begin(&mut self) {
        self.stepped = [None; 2];
        self.policies.run.reset();
    }

    /// Notes a step of a running episode at `now`, in which the robot's observation is `own` without the values of
    /// channels, and computes these. Puts the policy back to its start if its last step is too long ago.
    pub fn steps(&mut self, now: Time, known: &Known) {
        self.policies.channels.write(known, &mut self.values);
        self.fresh = true;
        let before = self.stepped[0];
        self.stepped = [Some(now), before];
        let Some((before, longest)) = before.zip(self.policies.run.forgets_after()) else { return };
        if now.since(before) > longest {
            self.policies.run.reset();
        }
    }

    /// Notes that the step of the policy that is used in `phase` has failed, so that it counts as none.
    pub fn fail(&mut self, phase: Phase) {
        (self.failed, self.says) = (true, false);
        if phase == Phase::Running {
            self.stepped[0] = self.stepped[1];
        }
    }

    /// Takes back the step of the policy under test in the Agent's last step, which counts as none, if there was one.
    pub fn undo(&mut self) {
        if !std::mem::take(&mut self.fresh) {
            return;
        }
        self.stepped[0] = self.stepped[1];
        self.policies.run.undo();
    }
}
