//! Robots of an Agent: their policies, and what each keeps from one step to the next.

use rand::RngExt;

use crate::actors::neighbours::Step;
use crate::hearing::CommRange;
use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::ids::RobotId;
use crate::messages::local::{Percept, Remembered};
use crate::messages::wire::{Encoding, MAX_FLOATS, Phase, Round, all_sound};
use crate::observation::{Bound, Dynamics, Known, Observation};
use crate::policy::{Broadcast, Policy};
use crate::random::Stream;
use crate::scenario::course::Course;
use crate::scenario::{Arena, Scenario};
use crate::time::{Span, Time};

/// Policies with which an Agent drives one of its robots, and the random streams of that robot.
pub struct RobotPolicies {
    /// Robot that the policies control.
    pub robot: RobotId,
    /// How the robot follows the velocities that the policies command; a part of their observation.
    pub dynamics: Dynamics,
    /// Communication range within which the robot hears the others of its Agent.
    pub range: CommRange,
    /// Distance \[m\] of the point that the policies command ahead of the robot's centre.
    pub point_ahead_m: f32,
    /// Number of control ticks from one step of the policy under test to the next; at least 1.
    pub every: u32,
    /// Channels that the policy under test takes.
    pub channels: Bound,
    /// Policy under test, used in running episodes.
    pub run: Box<dyn Policy>,
    /// Policy that drives the robot to its start in a reset.
    pub reset: Box<dyn Policy>,
    /// Random stream from which both policies sample their actions.
    pub actions: Stream,
    /// Random stream of the seeds with which the policy under test begins anew.
    pub resets: Stream,
    /// Random stream of the communication ranges between this robot and the others of the same Agent.
    pub ranges: Stream,
}

impl RobotPolicies {
    /// Tells the policies the arena of the episode that begins, in the world frame. A policy sees the commanded point,
    /// so the hull of a differential drive is wider for it.
    pub(super) fn enter(&mut self, arena: &Arena) {
        let arena = arena.about_point(self.point_ahead_m);
        self.run.enter(&arena);
        // There are no moving obstacles while robots drive to their starts.
        self.reset.enter(&arena.at(None));
    }

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
        let own = Observation::in_frame(frame, task.goal, &percept.estimate);
        Observation { dynamics, heading, yaw_rate, elapsed, ..own }
    }
}

/// State of one robot within an Agent: its policies, task, newest percept and latent.
pub(super) struct Slot {
    pub policies: RobotPolicies,
    pub task: Option<Task>,
    /// Waypoints of the robot in the present episode.
    pub course: Course,
    pub percept: Option<Percept>,
    /// Observation of the robot in the current step, without values of channels.
    pub own: Observation<'static>,
    /// Values of the channels that the policy under test takes, in the current step.
    pub values: Vec<f32>,
    /// Memories that these channels have of the robot's episode.
    memory: Vec<f32>,
    /// Times of the robot's last step in a running episode, and of the one before it; `None` if there is none.
    stepped: [Option<Time>; 2],
    /// Result of the last step of the policy under test, which holds until the next one; `None` after a step that
    /// counts as none, and before the first one.
    held: Option<Held>,
    /// Whether the policy under test makes its latent in `act`, as of its last step.
    computes: bool,
    /// Period of the policy under test.
    period: Span,
    /// Time since when the robot holds an unlabelled goal; `None` while it holds none.
    pub held_since: Option<Time>,
    /// Latent features that the robot broadcasts in the current step.
    pub features: Vec<f32>,
    /// Time at which the robot's next latent is due, where it does not broadcast in every step.
    next_latent: Time,
    /// Outcome of the current step so far.
    pub outcome: Outcome,
    /// Whether the log has said that the latent is invalid, since it was last valid.
    pub reported: bool,
    /// Expected lengths of the latent features: of the policy under test, and of the reset policy.
    pub widths: [usize; 2],
    /// Encodings to which the latent features are rounded: of the policy under test, and of the reset policy.
    encodings: [Encoding; 2],
    /// Ages up to which messages are used: by the policy under test, and by the reset policy.
    holds: [Span; 2],
    /// Longest time between two steps after which the policy under test goes on from its state.
    forgets_after: Option<Span>,
}

/// Result of a step of a policy, which holds in the ticks until its next step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    /// Wanted velocity \[m/s\], policy frame.
    pub velocity: Vec2,
    /// Estimate of the robot's motion in that step, world frame.
    pub motion: Motion,
    /// Whether the step's latent is sound.
    pub sound: bool,
}

/// Outcome of a robot's step, which decides whether it acts and what it broadcasts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// The robot has a step, which has not begun.
    Due,
    /// The robot acts, and broadcasts its latent features.
    Sound,
    /// The robot acts, and broadcasts nothing.
    Silent,
    /// The policy has no step in this tick: what it made of its last one holds.
    Held,
    /// The step counts as none: the robot stands for this tick and broadcasts nothing.
    Failed,
    /// The latent features are not finite or not of the declared length: the policy has diverged, which ends the
    /// episode.
    Invalid,
}

impl Slot {
    pub fn new(policies: RobotPolicies) -> Slot {
        let widths = [&policies.run, &policies.reset].map(|policy| policy.interface().features);
        let period = policies.run.interface().period;
        let holds = [&policies.run, &policies.reset].map(|policy| policy.interface().hold);
        let encodings = [&policies.run, &policies.reset].map(|policy| policy.form().encoding);
        let (values, forgets_after) = (vec![0.0; policies.channels.floats()], policies.run.forgets_after());
        let memory = vec![0.0; policies.channels.memory()];
        Slot {
            policies,
            task: None,
            course: Course::default(),
            percept: None,
            own: Observation::new(Motion::default(), Vec2::zeros()),
            values,
            memory,
            stepped: [None; 2],
            held: None,
            computes: false,
            period,
            held_since: None,
            features: Vec::new(),
            next_latent: Time::ZERO,
            outcome: Outcome::Silent,
            reported: false,
            widths,
            encodings,
            holds,
            forgets_after,
        }
    }

    /// Returns whether the robot broadcasts a latent in the step at `now`, with a mean time `between` two latents. One
    /// that is due within half a period counts as due, so that steps which come a little early do not put it off.
    pub fn broadcasts(&mut self, now: Time, between: Span) -> bool {
        if between == Span::ZERO {
            return true;
        }
        if now + Span::from_nanos(self.period.as_nanos() / 2) < self.next_latent {
            return false;
        }
        // After a silence there is nothing to make up for.
        let due = if self.next_latent + between > now { self.next_latent } else { now };
        self.next_latent = due + between;
        true
    }

    fn width(&self, phase: Phase) -> usize {
        self.widths[usize::from(phase != Phase::Running)]
    }

    /// Returns what decides about the messages that the robot gets in this step; `shared` has the latent features of
    /// the Agent's robots.
    pub fn step<'a>(&self, (round, phase): (Round, Phase), shared: &'a [f32]) -> Step<'a> {
        let (range, width, frame) = (self.policies.range, self.width(phase), self.own.frame);
        let hold = self.holds[usize::from(phase != Phase::Running)];
        Step { range, round, phase, width, hold, frame, shared }
    }

    /// Takes the outcome of the step from the policy that is used in `phase`, after its `encode`.
    pub fn encoded(&mut self, phase: Phase) {
        match self.policies.of(phase).broadcast() {
            Broadcast::Nothing => self.outcome = Outcome::Silent,
            Broadcast::Failed => self.fail(phase),
            Broadcast::Encoded | Broadcast::Computed(_) => self.check(phase),
        }
    }

    /// Takes the outcome of the step from the policy that is used in `phase`, after its `act`.
    pub fn acted(&mut self, phase: Phase) {
        match self.policies.of(phase).broadcast() {
            Broadcast::Encoded | Broadcast::Nothing => {}
            Broadcast::Failed => self.fail(phase),
            Broadcast::Computed(features) => {
                self.computes = true;
                self.features.clear();
                self.features.extend_from_slice(features);
                self.check(phase);
            }
        }
    }

    /// Notes whether the latent features are valid: finite, and as many as the policy that is used in `phase` has
    /// declared at its start.
    pub fn check(&mut self, phase: Phase) {
        let (width, declared) = (self.features.len(), self.width(phase));
        let encoding = self.encodings[usize::from(phase != Phase::Running)];
        let is_valid = |features: &[f32]| width == declared && width <= MAX_FLOATS && all_sound(features);
        let mut valid = is_valid(&self.features);
        if valid && encoding != Encoding::F32 {
            encoding.round(&mut self.features);
            valid = is_valid(&self.features);
        }
        if !valid && !self.reported {
            tracing::error!(width, declared, "the policy's output is not a valid latent; its robot stops");
            self.reported = true;
        }
        self.outcome = if valid { Outcome::Sound } else { Outcome::Invalid };
    }

    /// Notes that the step of the policy that is used in `phase` counts as none.
    fn fail(&mut self, phase: Phase) {
        self.outcome = Outcome::Failed;
        if phase == Phase::Running {
            self.stepped[0] = self.stepped[1];
        }
    }

    /// Puts the policy under test back to its start, for a new episode.
    pub fn begin(&mut self) {
        self.stepped = [None; 2];
        (self.held, self.held_since) = (None, None);
        self.course = std::mem::take(&mut self.course).after(0);
        self.memory.fill(0.0);
        self.reset();
    }

    fn reset(&mut self) {
        let seed = self.policies.resets.random();
        self.policies.run.reset(seed);
    }

    /// Returns whether the policy that is used in `phase` has a step in the control tick at `now`: its period is over,
    /// or its last step counts as none.
    pub fn is_due(&self, now: Time, phase: Phase) -> bool {
        let every = u64::from(self.policies.every);
        if phase != Phase::Running || every == 1 {
            return true;
        }
        // A tick may be early or late by less than half of the ticks' period.
        let margin = Span::from_nanos(self.period.as_nanos() / every / 2);
        self.stepped[0].is_none_or(|stepped| now.since(stepped) + margin >= self.period)
    }

    /// Returns what the last step has made, for a tick without one; `None` if the robot stands and says nothing.
    pub fn held(&self) -> Option<Held> {
        self.held
    }

    /// Keeps the velocity of this step for the ticks until the next one.
    pub fn hold(&mut self, velocity: Option<Vec2>) {
        let motion = self.percept.as_ref().map(|percept| percept.estimate);
        let sound = self.outcome == Outcome::Sound;
        self.held = velocity.zip(motion).map(|(velocity, motion)| Held { velocity, motion, sound });
    }

    /// Returns the digest of what the policy under test remembers after its step; `None` if it has not stepped, or has
    /// no state.
    pub fn remembered(&self) -> Option<Remembered> {
        if !matches!(self.outcome, Outcome::Sound | Outcome::Silent) || self.percept.is_none() {
            return None;
        }
        let mut hasher = blake3::Hasher::new();
        for float in self.policies.run.memory()? {
            hasher.update(&float.to_le_bytes());
        }
        let [a, b, c, d, e, f, g, h, ..] = *hasher.finalize().as_bytes();
        let digest = u64::from_be_bytes([a, b, c, d, e, f, g, h]);
        Some(Remembered { robot: self.policies.robot, digest })
    }

    /// Returns the age at `now` of the latent that the robot's Agent has: the time since the step that has made it. For
    /// robots whose policies step in each tick it is zero, as if the latent were of this tick.
    pub fn age(&self, now: Time) -> Span {
        let made = match self.outcome {
            Outcome::Held => self.stepped[0],
            _ if self.computes && self.policies.every > 1 => self.stepped[1],
            _ => None,
        };
        made.map_or(Span::ZERO, |made| now.since(made))
    }

    /// Notes a step of a running episode at `now`. The robot's task is `task`, the tasks of its team are `team`, and
    /// its observation is `own` without the values of channels, which this computes. Puts the policy back to its start
    /// if its last step is too long ago.
    pub fn steps(&mut self, now: Time, (task, team): (&Task, &[Option<Task>]), own: &Observation) {
        let sensed = self.percept.as_ref().map_or(&[][..], |percept| &percept.sensed);
        self.policies.channels.write(&mut self.memory, &Known { task, team, own, sensed }, &mut self.values);
        let before = self.stepped[0];
        self.stepped = [Some(now), before];
        let Some((before, longest)) = before.zip(self.forgets_after) else { return };
        if now.since(before) > longest {
            self.reset();
        }
    }

    /// Takes back the step of the policy under test at `at`, which counts as none, if there was one that succeeded.
    pub fn undo(&mut self, at: Time) {
        if self.stepped[0] == Some(at) {
            self.stepped[0] = self.stepped[1];
            // It was not used, so nothing of it holds, and the next tick makes up for it.
            self.held = None;
            self.policies.run.undo();
        }
    }
}
