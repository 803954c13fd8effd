//! Guard: the one state machine between what a policy wants and what a motor is told. Every motor command of a robot
//! is a `Granted` velocity, and only a guard grants.
//!
//! It stops while a trigger lasts, gives a running episode up, or stays latched until it is re-armed; `Trigger` says
//! which. It reads no clock: it is told the time, and says when it has to be woken. That the last command lapses is
//! the Body's affair, and holds even if this guard has died.

use std::collections::BTreeMap;
use std::iter::Sum;

use serde::{Deserialize, Serialize};

use super::filter::{self, Limit};
use super::{Safety, Switch};
use crate::messages::geometry::{Motion, Vec2, is_finite};
use crate::messages::ids::RobotId;
use crate::messages::latch::{Latch, LatchFollower};
use crate::messages::local::Action;
use crate::messages::wire::Stop;
use crate::time::{Span, Time};
use crate::world::Clamp;

/// Why a robot is stopped or slowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// The emergency stop is engaged, or the team is held after it: it stands until a resume.
    Stop,
    /// The state server is silent: it stands until that is heard again, and a running episode is given up.
    Silence,
    /// The policy's output was no velocity: it stands until the next instruction; a running episode is given up.
    Output,
    /// A control tick is late or missing: it stands until one is in time.
    LateTick,
    /// Its own state is too old: it stands until a new reading has led to an action.
    OwnState,
    /// It is far outside its ground: it stands while that lasts, and a running episode is given up.
    Outside,
    /// It was to leave its ground: the outward part of the velocity is taken away.
    Fence,
    /// It was to come too near to a neighbour: that part of the velocity is taken away.
    Distance,
}

impl Trigger {
    /// What it means for an episode that runs.
    fn ruling(self) -> Ruling {
        match self {
            Trigger::Stop | Trigger::Silence | Trigger::Output | Trigger::Outside => Ruling::GiveUp,
            Trigger::LateTick | Trigger::OwnState | Trigger::Fence | Trigger::Distance => Ruling::Stand,
        }
    }
}

/// How often each trigger has begun to act.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SafetyCounts {
    /// The emergency stop was engaged.
    pub stop: u64,
    /// The state server fell silent.
    pub silence: u64,
    /// A policy's output was no velocity.
    pub output: u64,
    /// A control tick was late or missing.
    pub late_tick: u64,
    /// A robot's own state became too old.
    pub own_state: u64,
    /// A robot was far outside its ground.
    pub outside: u64,
    /// A robot was kept on its ground.
    pub fence: u64,
    /// A robot was kept from a neighbour.
    pub distance: u64,
}

impl SafetyCounts {
    fn of(&mut self, trigger: Trigger) -> &mut u64 {
        match trigger {
            Trigger::Stop => &mut self.stop,
            Trigger::Silence => &mut self.silence,
            Trigger::Output => &mut self.output,
            Trigger::LateTick => &mut self.late_tick,
            Trigger::OwnState => &mut self.own_state,
            Trigger::Outside => &mut self.outside,
            Trigger::Fence => &mut self.fence,
            Trigger::Distance => &mut self.distance,
        }
    }
}

impl SafetyCounts {
    /// What there is to tell: how often, and what.
    pub fn reasons(&self) -> impl Iterator<Item = (u64, &'static str)> {
        let all = [
            (self.stop, "emergency stops"),
            (self.silence, "server silent"),
            (self.output, "unsound outputs"),
            (self.late_tick, "late ticks"),
            (self.own_state, "own state too old"),
            (self.outside, "far outside"),
            (self.fence, "kept on the ground"),
            (self.distance, "kept apart"),
        ];
        all.into_iter().filter(|(times, _)| *times > 0)
    }
}

impl Sum for SafetyCounts {
    fn sum<I: Iterator<Item = SafetyCounts>>(all: I) -> SafetyCounts {
        all.fold(SafetyCounts::default(), |sum, one| SafetyCounts {
            stop: sum.stop + one.stop,
            silence: sum.silence + one.silence,
            output: sum.output + one.output,
            late_tick: sum.late_tick + one.late_tick,
            own_state: sum.own_state + one.own_state,
            outside: sum.outside + one.outside,
            fence: sum.fence + one.fence,
            distance: sum.distance + one.distance,
        })
    }
}

/// A velocity that a guard has let through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Granted(Vec2);

impl Granted {
    /// The velocity \[m/s\], world frame.
    pub fn velocity(self) -> Vec2 {
        self.0
    }
}

/// What a robot is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ruling {
    /// To drive so.
    Drive(Granted),
    /// To stand while it lasts.
    Stand,
    /// To stand, and to give up an episode that runs.
    GiveUp,
}

/// How a guard is set up.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// When it acts.
    pub safety: Safety,
    /// The robot's ground: its centre stays within this of the origin along x and y \[m\].
    pub half_extent: Vec2,
    /// Largest speed along each axis \[m/s\].
    pub limit_m_s: f32,
    /// How the policy's velocity is limited, in episodes and in resets.
    pub clamp: Clamp,
    /// How often the policy acts.
    pub period: Span,
}

/// One robot's guard.
#[derive(Debug)]
pub struct Guard {
    config: Config,
    latch: LatchFollower,
    /// When the state server was last heard; `None` before, and after it fell silent.
    server: Option<Time>,
    /// When the newest reading of the robot has arrived.
    own: Option<Time>,
    /// When the tick was due that the robot drives by; `None` while it stands.
    driving: Option<Time>,
    /// Since the last instruction the policy has said something that is no velocity.
    unsound: bool,
    /// When each neighbour was last told of, how old it was then, and where it was.
    neighbours: BTreeMap<RobotId, (Time, Span, Motion)>,
    /// What acts at the moment.
    acting: Vec<Trigger>,
    counts: SafetyCounts,
}

impl Guard {
    /// A guard that has heard of nothing and lets nothing through.
    pub fn new(config: Config) -> Guard {
        Guard {
            config,
            latch: LatchFollower::default(),
            server: None,
            own: None,
            driving: None,
            unsound: false,
            neighbours: BTreeMap::new(),
            acting: Vec::new(),
            counts: SafetyCounts::default(),
        }
    }

    /// What it knows of the emergency stop.
    pub fn latch(&self) -> Latch {
        self.latch.latch()
    }

    /// How often each trigger has begun to act.
    pub fn counts(&self) -> SafetyCounts {
        self.counts
    }

    /// The emergency stop was engaged or taken back by someone; whether that has changed anything.
    pub fn told(&mut self, stop: &Stop) -> bool {
        let before = self.latch();
        self.latch.told(stop.latch) && self.changed(before)
    }

    /// The state server repeats what it knows of the emergency stop; whether that has changed anything.
    pub fn learn(&mut self, latch: Latch) -> bool {
        let before = self.latch();
        self.latch.learned(latch) && self.changed(before)
    }

    fn changed(&mut self, before: Latch) -> bool {
        let latch = self.latch();
        if latch.is_clear() {
            if !before.is_clear() {
                tracing::warn!(number = latch.number(), "resumed: the robot may move again");
            }
            self.end(Trigger::Stop);
        } else {
            self.begin(Trigger::Stop);
            self.driving = None;
            if latch.is_held() {
                tracing::warn!(number = latch.number(), "re-armed: the robot stands until a resume");
            }
        }
        true
    }

    /// The state server was heard.
    pub fn server_heard(&mut self, now: Time) {
        self.server = Some(now);
        self.end(Trigger::Silence);
    }

    /// It has given a new instruction.
    pub fn instructed(&mut self) {
        self.unsound = false;
        self.end(Trigger::Output);
    }

    /// To stand: always granted.
    pub fn stand(&mut self) -> Granted {
        self.driving = None;
        Granted(Vec2::zeros())
    }

    /// A new reading of the robot has arrived.
    pub fn own_state(&mut self, now: Time) {
        self.own = Some(now);
    }

    /// What becomes of an action that is meant for this moment of the episode.
    pub fn rule(&mut self, now: Time, action: &Action) -> Ruling {
        self.remember(now, action);
        let Config { clamp, limit_m_s, .. } = self.config;
        let wanted = clamp.limit(action.velocity, action.estimate.velocity, limit_m_s);
        self.unsound |= !is_finite(action.velocity) || !is_finite(wanted);
        if let Some(trigger) = self.forbids(now, action) {
            self.begin(trigger);
            self.driving = None;
            return trigger.ruling();
        }
        let acting = std::mem::take(&mut self.acting);
        self.acting = acting.into_iter().filter(|at| matches!(at, Trigger::Fence | Trigger::Distance)).collect();
        let granted = self.filtered(now, action.estimate.position, wanted);
        self.driving = (granted != Vec2::zeros()).then_some(action.due);
        Ruling::Drive(Granted(granted))
    }

    /// Why a robot must not move at all.
    fn forbids(&self, now: Time, action: &Action) -> Option<Trigger> {
        let Config { safety, half_extent, .. } = self.config;
        let late = now.since(action.due) > Span::from_secs(safety.late_tick_s);
        let old = self.own.is_none_or(|at| now.since(at) > Span::from_secs(safety.own_state_s));
        let beyond = filter::beyond(half_extent, action.estimate.position) > safety.geofence_stop_m;
        [
            (Trigger::Stop, !self.latch().is_clear()),
            (Trigger::Silence, self.server.is_none()),
            (Trigger::Output, self.unsound),
            (Trigger::LateTick, safety.late_tick == Switch::On && late),
            (Trigger::OwnState, safety.own_state == Switch::On && old),
            (Trigger::Outside, safety.geofence == Switch::On && beyond),
        ]
        .into_iter()
        .find_map(|(trigger, holds)| holds.then_some(trigger))
    }

    fn remember(&mut self, now: Time, action: &Action) {
        if self.config.safety.distance == Switch::On {
            self.neighbours.extend(action.others.iter().map(|other| (other.robot, (now, other.age, other.motion))));
            let longest = Span::from_secs(self.config.safety.distance_age_s);
            self.neighbours.retain(|_, (told, age, _)| *age + now.since(*told) <= longest);
        }
    }

    /// The velocity without what would carry the robot off its ground or too near to a neighbour.
    fn filtered(&mut self, now: Time, position: Vec2, wanted: Vec2) -> Vec2 {
        let Config { safety, half_extent, .. } = self.config;
        let mut limits: Vec<Limit> = Vec::new();
        let mut kept = wanted;
        if safety.geofence == Switch::On {
            let edge = half_extent.map(|axis| axis + safety.geofence_margin_m);
            limits.extend(filter::fence(edge, safety.geofence_horizon_s, position));
            kept = filter::within(wanted, &limits);
            self.set(Trigger::Fence, kept != wanted);
        }
        if safety.distance == Switch::On {
            let before = kept;
            limits.extend(self.neighbours.values().map(|(told, age, motion)| {
                let age_s = (*age + now.since(*told)).as_secs() as f32;
                let moved = Motion { position: motion.position + motion.velocity * age_s, ..*motion };
                filter::apart(position, moved, safety.distance_min_m, safety.distance_gain_per_s)
            }));
            kept = filter::within(kept, &limits);
            self.set(Trigger::Distance, kept != before);
        }
        kept
    }

    fn set(&mut self, trigger: Trigger, acts: bool) {
        if acts { self.begin(trigger) } else { self.end(trigger) }
    }

    fn begin(&mut self, trigger: Trigger) {
        if self.acting.contains(&trigger) {
            return;
        }
        self.acting.push(trigger);
        *self.counts.of(trigger) += 1;
        match trigger {
            Trigger::Stop => tracing::error!(number = self.latch().number(), "emergency stop: it holds until a resume"),
            Trigger::Silence => tracing::warn!("the state server has fallen silent; the robot stops"),
            Trigger::Output => tracing::error!("the policy's output is no velocity; the robot stops for the episode"),
            Trigger::LateTick => tracing::warn!("a control tick is late; the robot stops until one is in time"),
            Trigger::OwnState => tracing::warn!("the robot's own state is too old; it stops"),
            Trigger::Outside => tracing::error!("the robot is far outside its ground; it stops: carry it back"),
            Trigger::Fence => tracing::info!("the robot is kept on its ground"),
            Trigger::Distance => tracing::info!("the robot is kept from a neighbour"),
        }
    }

    fn end(&mut self, trigger: Trigger) {
        self.acting.retain(|acting| *acting != trigger);
    }

    /// The next moment at which a robot has to be stopped if nothing is heard until then, and why.
    fn deadline(&self) -> Option<(Time, Trigger)> {
        let Config { safety, period, .. } = self.config;
        // Older, or later, than allowed: one nanosecond past it.
        let past = |seconds: f64| Span::from_secs(seconds) + Span::from_nanos(1);
        let silence = self.server.map(|heard| (heard + Span::from_secs(safety.silence_s), Trigger::Silence));
        let own = self.own.filter(|_| self.driving.is_some() && safety.own_state == Switch::On);
        let own = own.map(|at| (at + past(safety.own_state_s), Trigger::OwnState));
        let tick = self.driving.filter(|_| safety.late_tick == Switch::On);
        let tick = tick.map(|due| (due + period + past(safety.late_tick_s), Trigger::LateTick));
        [silence, own, tick].into_iter().flatten().min_by_key(|(at, _)| *at)
    }

    /// When `wake` is next due.
    pub fn wake_at(&self) -> Option<Time> {
        self.deadline().map(|(at, _)| at)
    }

    /// What was due at `now`; `None` if nothing was.
    pub fn wake(&mut self, now: Time) -> Option<Ruling> {
        let (_, trigger) = self.deadline().filter(|(at, _)| *at <= now)?;
        if trigger == Trigger::Silence {
            self.server = None;
        }
        self.driving = None;
        self.begin(trigger);
        Some(trigger.ruling())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::ids::HostId;
    use crate::messages::local::{Other, Progress};
    use crate::messages::wire::{Phase, Round};

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// A guard of everything that has just heard the state server and a reading.
    fn guard(safety: Safety) -> Guard {
        let (half_extent, period) = (Vec2::new(2.0, 3.0), Span::from_millis(50));
        let mut guard = Guard::new(Config { safety, half_extent, limit_m_s: 1.5, clamp: Clamp::Training, period });
        guard.server_heard(Time::ZERO);
        guard.own_state(Time::ZERO);
        guard
    }

    fn action(due_ms: u64, velocity: Vec2) -> Action {
        Action {
            robot: RobotId(0),
            round: Round::default(),
            phase: Phase::Running,
            due: at_ms(due_ms),
            velocity,
            estimate: Motion::default(),
            others: Vec::new(),
            progress: Progress::Underway,
        }
    }

    const EAST: Vec2 = Vec2::new(1.0, 0.0);
    const DRIVE: Ruling = Ruling::Drive(Granted(EAST));

    #[test]
    fn nothing_moves_before_the_state_server_is_heard_or_after_it_falls_silent() {
        let mut guard = Guard::new(guard(Safety::emulated()).config);
        assert_eq!(guard.rule(at_ms(0), &action(0, EAST)), Ruling::GiveUp);
        guard.server_heard(at_ms(10));
        assert_eq!(guard.rule(at_ms(50), &action(50, EAST)), DRIVE);
        assert_eq!(guard.wake_at(), Some(at_ms(1010)));
        assert_eq!(guard.wake(at_ms(1009)), None, "not yet");
        assert_eq!(guard.wake(at_ms(1010)), Some(Ruling::GiveUp));
        assert_eq!(guard.wake_at(), None, "once");
        assert_eq!(guard.rule(at_ms(1050), &action(1050, EAST)), Ruling::GiveUp);
        guard.server_heard(at_ms(1060));
        assert_eq!(guard.rule(at_ms(1100), &action(1100, EAST)), DRIVE);
        assert_eq!(guard.counts().silence, 2);
    }

    #[test]
    fn an_output_that_is_no_velocity_is_distrusted_until_the_next_instruction() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut guard = guard(Safety::emulated());
            assert_eq!(guard.rule(at_ms(0), &action(0, Vec2::new(0.0, bad))), Ruling::GiveUp);
            assert_eq!(guard.rule(at_ms(50), &action(50, EAST)), Ruling::GiveUp);
            guard.instructed();
            assert_eq!(guard.rule(at_ms(100), &action(100, EAST)), DRIVE);
            assert_eq!(guard.counts().output, 1);
        }
    }

    #[test]
    fn an_own_state_that_grows_old_stops_at_once_and_a_new_reading_ends_it() {
        let mut guard = guard(Safety { late_tick: Switch::Off, ..Safety::deployed() });
        assert_eq!(guard.rule(at_ms(60), &action(60, EAST)), DRIVE);
        let deadline = at_ms(100) + Span::from_nanos(1);
        assert_eq!(guard.wake_at(), Some(deadline), "100 ms are not yet too old");
        assert_eq!(guard.wake(deadline), Some(Ruling::Stand));
        assert_eq!(guard.rule(at_ms(110), &action(110, EAST)), Ruling::Stand);
        guard.own_state(at_ms(120));
        assert_eq!(guard.rule(at_ms(160), &action(160, EAST)), DRIVE);
        assert_eq!(guard.counts().own_state, 1);
    }

    #[test]
    fn a_tick_that_is_late_or_never_comes_stops_until_one_is_in_time() {
        let mut guard = guard(Safety { own_state: Switch::Off, ..Safety::deployed() });
        assert_eq!(guard.rule(at_ms(50), &action(0, EAST)), DRIVE, "50 ms late are allowed");
        assert_eq!(guard.rule(at_ms(101), &action(50, EAST)), Ruling::Stand, "more are not");
        assert_eq!(guard.rule(at_ms(110), &action(100, EAST)), DRIVE);
        let missing = at_ms(100 + 50 + 50) + Span::from_nanos(1);
        assert_eq!(guard.wake_at(), Some(missing));
        assert_eq!(guard.wake(missing), Some(Ruling::Stand));
        assert_eq!(guard.wake_at(), Some(at_ms(1000)), "who stands waits for nothing but the state server");
        assert_eq!(guard.counts().late_tick, 2);
    }

    #[test]
    fn the_emergency_stop_is_latched_until_a_later_re_arm_and_a_resume() {
        let mut guard = guard(Safety::emulated());
        assert_eq!(guard.rule(at_ms(0), &action(0, EAST)), DRIVE);
        assert!(guard.told(&Stop::engage(HostId(1), Latch::default())));
        assert!(!guard.told(&Stop::engage(HostId(2), Latch::default())), "again");
        assert!(!guard.told(&Stop::rearm(HostId(1), Latch::default())), "no later than the stop");
        assert_eq!(guard.rule(at_ms(50), &action(50, EAST)), Ruling::GiveUp);
        guard.instructed();
        assert_eq!(guard.rule(at_ms(100), &action(100, EAST)), Ruling::GiveUp, "no instruction takes it back");
        assert!(guard.told(&Stop::rearm(HostId(1), guard.latch())));
        assert_eq!(guard.latch(), Latch::held(2));
        assert_eq!(guard.rule(at_ms(150), &action(150, EAST)), Ruling::GiveUp, "a re-arm alone moves nothing");
        assert!(!guard.told(&Stop::resume(HostId(1), guard.latch())), "the state server grants it");
        assert!(guard.learn(Latch::clear(3)));
        assert_eq!(guard.rule(at_ms(200), &action(200, EAST)), DRIVE);
        assert!(!guard.learn(Latch::engaged(1)), "what was known before the re-arm");
        assert!(guard.learn(Latch::engaged(4)), "a later stop, heard of others");
        assert_eq!(guard.counts().stop, 2);
    }

    #[test]
    fn the_ground_is_not_left_and_far_outside_nobody_moves() {
        let mut guard = guard(Safety { late_tick: Switch::Off, own_state: Switch::Off, ..Safety::deployed() });
        let mut from = |x: f32, velocity: Vec2| {
            let estimate = Motion::at_rest(Vec2::new(x, 0.0));
            guard.rule(at_ms(0), &Action { estimate, ..action(0, velocity) })
        };
        let north = Vec2::new(0.0, 1.0);
        assert_eq!(from(1.0, EAST), DRIVE);
        assert_eq!(from(2.3, EAST + north), Ruling::Drive(Granted(north)), "the outward part alone");
        assert_eq!(from(2.3, -EAST), Ruling::Drive(Granted(-EAST)), "it may come back");
        assert_eq!(from(3.1, -EAST), Ruling::GiveUp);
        assert_eq!(from(1.0, EAST), DRIVE, "someone has carried it back");
        assert_eq!((guard.counts().fence, guard.counts().outside), (1, 1));
    }

    #[test]
    fn a_neighbour_is_not_run_into_even_if_it_is_no_longer_heard() {
        let mut guard = guard(Safety { late_tick: Switch::Off, own_state: Switch::Off, ..Safety::deployed() });
        let motion = Motion::at_rest(Vec2::new(0.5, 0.0));
        let others = vec![Other { robot: RobotId(1), motion, age: Span::from_millis(100) }];
        let mut speed = |ms: u64, others: Vec<Other>| match guard.rule(at_ms(ms), &Action { others, ..action(0, EAST) })
        {
            Ruling::Drive(granted) => granted.velocity().x,
            ruling => panic!("{ruling:?}"),
        };
        assert!((speed(0, others) - 0.1).abs() < 1e-6, "0.1 m are left");
        assert!((speed(400, Vec::new()) - 0.1).abs() < 1e-6, "500 ms old");
        assert_eq!(speed(401, Vec::new()), 1.0, "forgotten");
        assert_eq!(guard.counts().distance, 1);
    }

    #[test]
    fn as_emulated_nothing_comes_between() {
        let mut guard = guard(Safety::emulated());
        let motion = Motion::at_rest(Vec2::new(9.1, 0.0));
        let others = vec![Other { robot: RobotId(1), motion, age: Span::ZERO }];
        let estimate = Motion::at_rest(Vec2::new(9.0, 0.0));
        assert_eq!(guard.rule(at_ms(900), &Action { estimate, others, ..action(0, EAST) }), DRIVE);
        assert_eq!((guard.counts(), guard.wake_at()), (SafetyCounts::default(), Some(at_ms(1000))));
    }
}
