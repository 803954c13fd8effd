//! Guard: the state machine between a robot's policy and its motors. Every motor command is a `Granted` velocity, and
//! only a guard can make one.
//!
//! Depending on the trigger, a guard stops the robot while the trigger lasts, aborts a running episode, or stays
//! latched until a re-arm. It reads no clock: the time is an argument, and `wake_at` is its next deadline. The Body,
//! the actor of the motors, expires the last command by itself, even if the guard has died.

pub use super::counts::SafetyCounts;
use super::filter::{Filter, Filtered, Settings};
use super::hardware::Permit;
use super::limits::distance_outside;

use super::Switch;
use crate::messages::geometry::{Motion, Vec2, is_finite};
use crate::messages::ids::RobotId;
use crate::messages::latch::{Latch, LatchFollower};
use crate::messages::local::Action;
use crate::messages::place::Whereabouts;
pub use crate::messages::trigger::Trigger;
use crate::messages::wire::Stop;
use crate::scenario::Arena;
use crate::time::{Span, Time};

/// Number of neighbours for which there is room from the start.
const MOST_NEIGHBOURS: usize = 64;
/// Time since a trigger has last begun to act after which it counts as new in the log. Readings that are too rare make
/// one begin at nearly every tick.
const NEW_AFTER: Span = Span::from_millis(5000);

impl Trigger {
    /// Returns the decision while this trigger acts.
    fn decision(self) -> Decision {
        match self {
            Trigger::Stop
            | Trigger::Silence
            | Trigger::Output
            | Trigger::Hardware
            | Trigger::Outside
            | Trigger::Jump => Decision::Abort,
            Trigger::LateTick
            | Trigger::OwnState
            | Trigger::Fence
            | Trigger::Distance
            | Trigger::Walls
            | Trigger::Claim => Decision::Stop,
        }
    }
}

/// Velocity that a guard has approved; only such a velocity becomes a motor command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Granted(Vec2);

impl Granted {
    /// Returns the approved velocity \[m/s\], world frame.
    pub fn velocity(self) -> Vec2 {
        self.0
    }
}

/// Decision of a guard on one action of the policy or on one deadline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decision {
    /// The robot may drive at this velocity.
    Drive(Granted),
    /// The robot has to stop while the trigger lasts; the episode continues.
    Stop,
    /// The robot has to stop, and a running episode has to be aborted.
    Abort,
}

/// Guard of one robot: the state machine that alone turns the policy's velocities into approved motor commands.
#[derive(Debug)]
pub struct Guard {
    settings: Settings,
    latch: LatchFollower,
    /// Time of the state server's newest message; none before the first, and after a silence.
    server: Option<Time>,
    /// Arrival of the robot's newest reading.
    own: Option<Time>,
    /// Due time of the tick whose command the robot follows; none while it stands.
    driving: Option<Time>,
    /// True if the policy's output was not finite since the last instruction.
    invalid_output: bool,
    /// True while battery or temperature is beyond its limit.
    unfit: bool,
    /// True while the robot flies and is not at its height.
    off_height: bool,
    /// Whether the robot's pose is known to the host that measures it.
    whereabouts: Whereabouts,
    filter: Filter,
    /// Time since which the episode runs; `None` while none runs.
    running: Option<Time>,
    /// By neighbour, in the order of ids: time of its last update, the age of its state at that time, and its state.
    neighbours: Vec<(RobotId, Time, Span, Motion)>,
    /// Triggers that act at the moment.
    acting: Vec<Trigger>,
    counts: SafetyCounts,
    /// Time of the last call that had one.
    now: Time,
    /// By trigger: time at which it last began to act, and how many times it has begun since it was new.
    begun: [(Time, u64); Trigger::ALL.len()],
}

impl Guard {
    /// Returns a guard with these settings that has received nothing yet, and so stops the robot.
    pub fn new(settings: Settings) -> Guard {
        Guard {
            filter: Filter::new(settings.clone()),
            settings,
            latch: LatchFollower::default(),
            server: None,
            own: None,
            driving: None,
            invalid_output: false,
            unfit: false,
            off_height: false,
            whereabouts: Whereabouts::Known,
            running: None,
            neighbours: Vec::with_capacity(MOST_NEIGHBOURS),
            acting: Vec::with_capacity(Trigger::ALL.len()),
            counts: SafetyCounts::default(),
            now: Time::ZERO,
            begun: [(Time::ZERO, 0); Trigger::ALL.len()],
        }
    }

    /// Returns the guard for a team whose orders are `signed` where they end a stop or a hold.
    pub(crate) fn with_signed_orders(self, signed: bool) -> Guard {
        Guard { latch: LatchFollower::new(signed), ..self }
    }

    /// Returns the state of the emergency stop that this guard follows: clear, engaged, or held after a re-arm.
    pub(crate) fn latch(&self) -> Latch {
        self.latch.latch()
    }

    /// Returns how often each trigger has become active in this guard.
    pub(crate) fn counts(&self) -> SafetyCounts {
        self.counts
    }

    /// Returns the guard of a robot that `flies` or not: one that does is not driven before it is known to be at its
    /// height.
    pub(crate) fn of_a_flight(self, flies: bool) -> Guard {
        Guard { off_height: flies, ..self }
    }

    /// Applies an operator's emergency stop or re-arm; returns true if the guard's state of the stop has changed.
    pub(crate) fn apply_stop(&mut self, stop: &Stop) -> bool {
        let before = self.latch();
        self.latch.apply(stop.latch, stop.by.is_operator()) && self.changed(before)
    }

    /// Applies the state of the emergency stop that the state server repeats; returns true if the guard's own state has
    /// changed.
    pub(crate) fn learn_latch(&mut self, latch: Latch) -> bool {
        let before = self.latch();
        self.latch.update(latch) && self.changed(before)
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
            let number = latch.number();
            if latch.is_held() {
                // No operator has stopped the team: it is held, as after a failed reset.
                let why = if before.is_clear() { "held" } else { "re-armed" };
                tracing::warn!(number, "{why}: the robot stands until a resume");
            } else if !before.is_engaged() {
                tracing::error!(number, "emergency stop: it holds until a resume");
            }
        }
        true
    }

    /// Records that a message of the state server has arrived at time `now`, which ends its silence.
    pub fn server_heard(&mut self, now: Time) {
        (self.server, self.now) = (Some(now), now);
        self.end(Trigger::Silence);
    }

    /// Sets the solid blocks and moving obstacles of the arena, world frame, that the robot must not touch from now on.
    pub(crate) fn enter(&mut self, arena: &Arena) {
        self.filter.enter(arena);
    }

    /// Sets the time since which the episode runs, by which moving obstacles are where they are; `None` while none
    /// runs.
    pub(crate) fn runs(&mut self, since: Option<Time>) {
        self.running = since;
    }

    /// Records that the state server has given a new instruction, which ends a stop for an invalid policy output.
    pub(crate) fn new_instruction(&mut self) {
        self.invalid_output = false;
        self.end(Trigger::Output);
    }

    /// Applies the decision of the limits of battery and temperature: the guard stops the robot while `permit` is
    /// `Permit::Withdrawn`.
    pub(crate) fn hardware(&mut self, permit: Permit) {
        self.unfit = permit == Permit::Withdrawn;
        self.set(Trigger::Hardware, self.unfit);
    }

    /// Sets whether the robot flies and is not at its height, while it must not be driven. It is the course of a
    /// flight, so it counts as no trigger.
    pub(crate) fn set_off_height(&mut self, off_height: bool) {
        self.off_height = off_height;
    }

    /// Applies what the host that measures the robot says of its pose: the guard stops the robot while that is lost.
    /// Returns true if it was known until now and the robot has to stop.
    pub(crate) fn located(&mut self, whereabouts: Whereabouts) -> bool {
        let before = std::mem::replace(&mut self.whereabouts, whereabouts);
        if whereabouts.is_lost() && before != whereabouts {
            let (reason, remedy) = (whereabouts.reason(), whereabouts.remedy());
            tracing::error!("the robot stops: {reason}; {remedy}");
        }
        self.set(Trigger::Jump, whereabouts.is_lost());
        whereabouts.is_lost() && !before.is_lost()
    }

    /// Counts one more robot whose messages contradict the tracker. It is avoided where it is measured, so nothing else
    /// changes for this robot.
    pub(crate) fn suspect(&mut self) {
        *self.counts.of_mut(Trigger::Claim) += 1;
    }

    /// Returns the approved velocity zero, which is always granted, for the Controller to stop the robot.
    pub(crate) fn stop(&mut self) -> Granted {
        self.driving = None;
        Granted(Vec2::zeros())
    }

    /// Records that a new reading of the robot's own state has arrived at time `now`. None arrives of a robot whose
    /// pose is lost, so the pose is known again.
    pub fn own_state(&mut self, now: Time) {
        (self.own, self.now) = (Some(now), now);
        self.located(Whereabouts::Known);
    }

    /// Decides at time `now` on an action of the policy, which must belong to the current phase of the episode. The
    /// robot may drive at the action's velocity, limited in speed and by geofence, walls and neighbours, unless a
    /// trigger forbids motion.
    pub fn decide(&mut self, now: Time, action: &Action) -> Decision {
        self.now = now;
        self.remember(now, action);
        let Settings { clamp, limit_m_s, .. } = self.settings;
        // Without a velocity the tick counts as missing, and the robot stands.
        let velocity = action.velocity.unwrap_or_default();
        let wanted = clamp.limit(velocity, action.estimate.velocity, limit_m_s);
        self.invalid_output |= !is_finite(velocity) || !is_finite(wanted);
        if self.off_height {
            self.driving = None;
            return Decision::Stop;
        }
        if let Some(trigger) = self.blocking_trigger(now, action) {
            self.begin(trigger);
            self.driving = None;
            return trigger.decision();
        }
        self.acting.retain(|at| matches!(at, Trigger::Fence | Trigger::Distance | Trigger::Walls));
        let granted = self.filtered(now, &action.estimate, wanted);
        self.driving = (granted != Vec2::zeros()).then_some(action.due);
        Decision::Drive(Granted(granted))
    }

    /// Returns the first trigger that forbids any motion.
    fn blocking_trigger(&self, now: Time, action: &Action) -> Option<Trigger> {
        let Settings { safety, half_extent, .. } = self.settings;
        let late = now.since(action.due) > Span::from_secs(safety.late_tick_s);
        let old = self.own.is_none_or(|at| now.since(at) > Span::from_secs(safety.own_state_s));
        let beyond = distance_outside(half_extent, action.estimate.position) > safety.geofence_stop_m;
        [
            (Trigger::Stop, !self.latch().is_clear()),
            (Trigger::Silence, self.server.is_none()),
            (Trigger::Output, self.invalid_output),
            (Trigger::Hardware, self.unfit),
            (Trigger::Jump, self.whereabouts.is_lost()),
            (Trigger::LateTick, action.velocity.is_none() || safety.late_tick == Switch::On && late),
            (Trigger::OwnState, safety.own_state == Switch::On && old),
            (Trigger::Outside, safety.geofence == Switch::On && beyond),
        ]
        .into_iter()
        .find_map(|(trigger, holds)| holds.then_some(trigger))
    }

    fn remember(&mut self, now: Time, action: &Action) {
        if self.settings.safety.distance == Switch::Off {
            return;
        }
        // An action may have several motions of one robot, whose place is in doubt; all of them replace those before.
        for other in &action.others {
            let place = |known: &(RobotId, Time, Span, Motion)| known.0;
            while let Ok(at) = self.neighbours.binary_search_by_key(&other.robot, place) {
                self.neighbours.remove(at);
            }
        }
        for other in &action.others {
            let at = self.neighbours.partition_point(|known| known.0 <= other.robot);
            self.neighbours.insert(at, (other.robot, now, other.age, other.motion));
        }
        let longest = Span::from_secs(self.settings.safety.distance_age_s);
        self.neighbours.retain(|(_, heard, age, _)| *age + now.since(*heard) <= longest);
    }

    /// Returns the velocity after the safety filter; counts what it has removed.
    fn filtered(&mut self, now: Time, own: &Motion, wanted: Vec2) -> Vec2 {
        let known = self.neighbours.iter();
        let known = known.map(|(_, heard, age, motion)| (*motion, (*age + now.since(*heard)).as_secs() as f32));
        self.filter.elapse(self.running.map(|since| now.since(since)));
        let Filtered { velocity, fence, walls, distance } = self.filter.apply(own, known, wanted);
        self.set(Trigger::Fence, fence);
        self.set(Trigger::Walls, walls);
        self.set(Trigger::Distance, distance);
        velocity
    }

    fn set(&mut self, trigger: Trigger, acts: bool) {
        if acts { self.begin(trigger) } else { self.end(trigger) }
    }

    fn begin(&mut self, trigger: Trigger) {
        if self.acting.contains(&trigger) {
            return;
        }
        self.acting.push(trigger);
        *self.counts.of_mut(trigger) += 1;
        if let Some(often) = self.log_due(trigger) {
            log(trigger, &often);
        }
    }

    /// Returns whether to log that a trigger begins to act, and how often it has begun by now, in words: at the first
    /// time after a while, and then at the 2nd, 4th, 8th time in a row. All are counted.
    fn log_due(&mut self, trigger: Trigger) -> Option<String> {
        let (last, times) = &mut self.begun[usize::from(u8::from(trigger))];
        if self.now.since(*last) >= NEW_AFTER {
            *times = 0;
        }
        (*last, *times) = (self.now, *times + 1);
        let often = if *times == 1 { String::new() } else { format!(" ({times} times in a row)") };
        times.is_power_of_two().then_some(often)
    }

    fn end(&mut self, trigger: Trigger) {
        self.acting.retain(|acting| *acting != trigger);
    }

    /// Returns the next time at which the robot is stopped if nothing arrives before, and the trigger.
    fn deadline(&self) -> Option<(Time, Trigger)> {
        let Settings { safety, period, .. } = self.settings;
        // The limit itself is allowed: the deadline is one nanosecond past it.
        let past = |seconds: f64| Span::from_secs(seconds) + Span::from_nanos(1);
        let silence = self.server.map(|heard| (heard + Span::from_secs(safety.silence_s), Trigger::Silence));
        let own = self.own.filter(|_| self.driving.is_some() && safety.own_state == Switch::On);
        let own = own.map(|at| (at + past(safety.own_state_s), Trigger::OwnState));
        let tick = self.driving.filter(|_| safety.late_tick == Switch::On);
        let tick = tick.map(|due| (due + period + past(safety.late_tick_s), Trigger::LateTick));
        [silence, own, tick].into_iter().flatten().min_by_key(|(at, _)| *at)
    }

    /// Returns the next time at which the guard stops the robot if nothing arrives before; `None` if there is none.
    pub(crate) fn wake_at(&self) -> Option<Time> {
        self.deadline().map(|(at, _)| at)
    }

    /// Handles the earliest deadline that has passed at time `now`. Returns the decision, to stop the
    /// robot or to abort the episode as well; `None` if no deadline has passed.
    pub(crate) fn wake(&mut self, now: Time) -> Option<Decision> {
        self.now = now;
        let (_, trigger) = self.deadline().filter(|(at, _)| *at <= now)?;
        if trigger == Trigger::Silence {
            self.server = None;
        }
        self.driving = None;
        self.begin(trigger);
        Some(trigger.decision())
    }
}

/// Logs that a trigger begins to act; `often` says how often in a row, in words.
fn log(trigger: Trigger, often: &str) {
    match trigger {
        // Reported where the latch changes, with its state.
        Trigger::Stop => {}
        Trigger::Silence => tracing::warn!("the state server has fallen silent; the robot stops{often}"),
        Trigger::Output => tracing::error!("the policy's output is not finite; the robot stops for the episode{often}"),
        Trigger::LateTick => {
            tracing::warn!("a control tick is late or failed; the robot stops until one is in time{often}")
        }
        Trigger::OwnState => tracing::warn!("the robot's own state is too old; it stops{often}"),
        // Reported where it is learnt, with its reason.
        Trigger::Jump => {}
        // Reported where it is found, with the robot.
        Trigger::Claim => {}
        // The Body says which, and what to do.
        Trigger::Hardware => tracing::info!("battery or temperature is beyond its limit; the robot stops{often}"),
        Trigger::Outside => tracing::error!("the robot is far outside its ground; it stops: carry it back{often}"),
        Trigger::Fence => tracing::info!("the geofence limits the robot's velocity{often}"),
        Trigger::Distance => tracing::info!("the minimum distance to a neighbour limits the robot's velocity{often}"),
        Trigger::Walls => tracing::info!("the minimum distance to a wall limits the robot's velocity{often}"),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::messages::ids::HostId;
    use crate::messages::local::{OtherRobot, Progress};
    use crate::messages::wire::{Phase, Round};
    use crate::safety::{Clamp, Safety};

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// Returns a guard that has just received a message of the state server and a reading.
    fn guard(safety: Safety) -> Guard {
        let (half_extent, period) = (Vec2::new(2.0, 3.0), Span::from_millis(50));
        let mut guard = Guard::new(Settings {
            safety,
            half_extent,
            walls: Arc::default(),
            movers: Arc::default(),
            limit_m_s: 1.5,
            clamp: Clamp::Training,
            period,
        });
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
            velocity: Some(velocity),
            estimate: Motion::default(),
            others: Vec::new(),
            progress: Progress::Underway,
        }
    }

    const EAST: Vec2 = Vec2::new(0.9, 0.0);
    const DRIVE: Decision = Decision::Drive(Granted(EAST));

    #[test]
    fn nothing_moves_before_the_state_server_is_heard_or_after_it_falls_silent() {
        let mut guard = Guard::new(guard(Safety::emulated()).settings.clone());
        assert_eq!(guard.decide(at_ms(0), &action(0, EAST)), Decision::Abort);
        guard.server_heard(at_ms(10));
        assert_eq!(guard.decide(at_ms(50), &action(50, EAST)), DRIVE);
        assert_eq!(guard.wake_at(), Some(at_ms(1010)));
        assert_eq!(guard.wake(at_ms(1009)), None, "not yet");
        assert_eq!(guard.wake(at_ms(1010)), Some(Decision::Abort));
        assert_eq!(guard.wake_at(), None, "once");
        assert_eq!(guard.decide(at_ms(1050), &action(1050, EAST)), Decision::Abort);
        guard.server_heard(at_ms(1060));
        assert_eq!(guard.decide(at_ms(1100), &action(1100, EAST)), DRIVE);
        assert_eq!(guard.counts().silence, 2);
    }

    #[test]
    fn an_output_that_is_not_finite_stops_the_robot_until_the_next_instruction() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut guard = guard(Safety::emulated());
            assert_eq!(guard.decide(at_ms(0), &action(0, Vec2::new(0.0, bad))), Decision::Abort);
            assert_eq!(guard.decide(at_ms(50), &action(50, EAST)), Decision::Abort);
            guard.new_instruction();
            assert_eq!(guard.decide(at_ms(100), &action(100, EAST)), DRIVE);
            assert_eq!(guard.counts().output, 1);
        }
    }

    #[test]
    fn an_own_state_that_is_too_old_stops_at_once_and_a_new_reading_ends_it() {
        let mut guard = guard(Safety { late_tick: Switch::Off, ..Safety::deployed() });
        assert_eq!(guard.decide(at_ms(60), &action(60, EAST)), DRIVE);
        let deadline = at_ms(100) + Span::from_nanos(1);
        assert_eq!(guard.wake_at(), Some(deadline), "100 ms are not yet too old");
        assert_eq!(guard.wake(deadline), Some(Decision::Stop));
        assert_eq!(guard.decide(at_ms(110), &action(110, EAST)), Decision::Stop);
        guard.own_state(at_ms(120));
        assert_eq!(guard.decide(at_ms(160), &action(160, EAST)), DRIVE);
        assert_eq!(guard.counts().own_state, 1);
    }

    #[test]
    fn a_state_that_is_too_old_at_every_tick_is_counted_each_time_and_logged_ever_more_rarely() {
        let mut guard = guard(Safety { late_tick: Switch::Off, ..Safety::deployed() });
        let mut logged = Vec::new();
        for beginning in 1..=100u64 {
            // A reading every 150 ms, and one may be 100 ms old.
            let at = 150 * beginning;
            guard.server_heard(at_ms(at));
            guard.own_state(at_ms(at));
            assert_eq!(guard.decide(at_ms(at), &action(at, EAST)), DRIVE);
            let last = guard.begun[usize::from(u8::from(Trigger::OwnState))].1;
            assert_eq!(guard.wake(at_ms(at + 101)), Some(Decision::Stop));
            let times = guard.begun[usize::from(u8::from(Trigger::OwnState))].1;
            assert_eq!((times, guard.counts().own_state), (last + 1, beginning));
            logged.extend(times.is_power_of_two().then_some(beginning));
        }
        assert_eq!(logged, [1, 2, 4, 8, 16, 32, 64]);
        guard.server_heard(at_ms(30_000));
        guard.own_state(at_ms(30_000));
        assert_eq!(guard.decide(at_ms(30_000), &action(30_000, EAST)), DRIVE);
        guard.wake(at_ms(30_101));
        assert_eq!(guard.begun[usize::from(u8::from(Trigger::OwnState))].1, 1, "after a while it is new");
    }

    #[test]
    fn a_tick_that_is_late_or_never_comes_stops_until_one_is_in_time() {
        let mut guard = guard(Safety { own_state: Switch::Off, ..Safety::deployed() });
        assert_eq!(guard.decide(at_ms(50), &action(0, EAST)), DRIVE, "50 ms late are allowed");
        assert_eq!(guard.decide(at_ms(101), &action(50, EAST)), Decision::Stop, "more are not");
        assert_eq!(guard.decide(at_ms(110), &action(100, EAST)), DRIVE);
        let missing = at_ms(100 + 50 + 50) + Span::from_nanos(1);
        assert_eq!(guard.wake_at(), Some(missing));
        assert_eq!(guard.wake(missing), Some(Decision::Stop));
        assert_eq!(guard.wake_at(), Some(at_ms(1000)), "a standing robot only has the deadline of the state server");
        assert_eq!(guard.counts().late_tick, 2);
    }

    #[test]
    fn the_emergency_stop_is_latched_until_a_later_re_arm_and_a_resume() {
        let mut guard = guard(Safety::emulated());
        assert_eq!(guard.decide(at_ms(0), &action(0, EAST)), DRIVE);
        assert!(guard.apply_stop(&Stop::engage(HostId(1), Latch::default())));
        assert!(!guard.apply_stop(&Stop::engage(HostId(2), Latch::default())), "again");
        assert!(!guard.apply_stop(&Stop::rearm(HostId::operator(1), Latch::default())), "no later than the stop");
        assert_eq!(guard.decide(at_ms(50), &action(50, EAST)), Decision::Abort);
        guard.new_instruction();
        assert_eq!(guard.decide(at_ms(100), &action(100, EAST)), Decision::Abort, "no instruction takes it back");
        assert!(guard.apply_stop(&Stop::rearm(HostId::operator(1), guard.latch())));
        assert_eq!(guard.latch(), Latch::held(2));
        assert_eq!(guard.decide(at_ms(150), &action(150, EAST)), Decision::Abort, "a re-arm alone moves nothing");
        assert!(!guard.apply_stop(&Stop::resume(HostId(1), guard.latch())), "the state server grants it");
        assert!(guard.learn_latch(Latch::clear(3)));
        assert_eq!(guard.decide(at_ms(200), &action(200, EAST)), DRIVE);
        assert!(!guard.learn_latch(Latch::engaged(1)), "older than the re-arm");
        assert!(guard.learn_latch(Latch::engaged(4)), "a later stop");
        assert_eq!(guard.counts().stop, 2);
    }

    #[test]
    fn the_geofence_holds_and_far_outside_the_robot_stops() {
        let mut guard = guard(Safety { late_tick: Switch::Off, own_state: Switch::Off, ..Safety::deployed() });
        let mut from = |x: f32, velocity: Vec2| {
            let estimate = Motion::at_rest(Vec2::new(x, 0.0));
            guard.decide(at_ms(0), &Action { estimate, ..action(0, velocity) })
        };
        let north = Vec2::new(0.0, 0.2);
        assert_eq!(from(1.0, EAST), DRIVE);
        assert_eq!(from(2.3, EAST + north), Decision::Drive(Granted(north)), "the outward part alone");
        assert_eq!(from(2.3, -EAST), Decision::Drive(Granted(-EAST)), "it may come back");
        assert_eq!(from(3.1, -EAST), Decision::Abort);
        assert_eq!(from(1.0, EAST), DRIVE, "someone has carried it back");
        assert_eq!((guard.counts().fence, guard.counts().outside), (1, 1));
    }

    #[test]
    fn the_minimum_distance_holds_after_a_neighbour_is_no_longer_heard() {
        let mut guard = guard(Safety { late_tick: Switch::Off, own_state: Switch::Off, ..Safety::deployed() });
        let motion = Motion::at_rest(Vec2::new(0.55, 0.0));
        let others = vec![OtherRobot { robot: RobotId(1), motion, age: Span::from_millis(100) }];
        let mut speed =
            |ms: u64, others: Vec<OtherRobot>| match guard.decide(at_ms(ms), &Action { others, ..action(0, EAST) }) {
                Decision::Drive(granted) => granted.velocity().x,
                decision => panic!("{decision:?}"),
            };
        assert!((speed(0, others) - 5.0 * (0.15 - 0.2 * 0.5)).abs() < 1e-5, "0.15 m are left, it may have started");
        assert_eq!(speed(900, Vec::new()), 0.0, "1 s old: it may have come nearer");
        assert!(speed(901, Vec::new()) > 0.49, "older than 1 s");
        assert_eq!(guard.counts().distance, 1);
    }

    #[test]
    fn both_places_of_a_robot_in_doubt_are_avoided_until_it_is_known_where_it_is() {
        let mut guard = guard(Safety { late_tick: Switch::Off, own_state: Switch::Off, ..Safety::deployed() });
        let mut drive = |ms: u64, places: &[f32]| {
            let other = |x: &f32| OtherRobot {
                robot: RobotId(1),
                motion: Motion::at_rest(Vec2::new(*x, 0.0)),
                age: Span::ZERO,
            };
            let others = places.iter().map(other).collect();
            match guard.decide(at_ms(ms), &Action { others, ..action(0, EAST) }) {
                Decision::Drive(granted) => granted.velocity().x,
                decision => panic!("{decision:?}"),
            }
        };
        assert_eq!((drive(0, &[0.4, 3.0]), drive(50, &[3.0, 0.4])), (0.0, 0.0), "in whatever order");
        assert!(drive(100, &[3.0]) > 0.49, "it is there alone");
        assert_eq!(drive(150, &[0.4]), 0.0);
    }

    #[test]
    fn the_emulated_settings_change_no_velocity() {
        let mut guard = guard(Safety::emulated());
        let motion = Motion::at_rest(Vec2::new(9.1, 0.0));
        let others = vec![OtherRobot { robot: RobotId(1), motion, age: Span::ZERO }];
        let estimate = Motion::at_rest(Vec2::new(9.0, 0.0));
        assert_eq!(guard.decide(at_ms(900), &Action { estimate, others, ..action(0, EAST) }), DRIVE);
        assert_eq!((guard.counts(), guard.wake_at()), (SafetyCounts::default(), Some(at_ms(1000))));
    }

    #[test]
    fn a_tick_whose_step_counts_as_none_stops_the_robot_for_that_tick_alone() {
        let mut guard = guard(Safety::emulated());
        let none = |ms: u64| Action { velocity: None, ..action(ms, EAST) };
        assert_eq!(guard.decide(at_ms(50), &none(50)), Decision::Stop);
        assert_eq!(guard.decide(at_ms(100), &none(100)), Decision::Stop);
        assert_eq!(guard.decide(at_ms(150), &action(150, EAST)), DRIVE);
        assert_eq!(guard.counts().late_tick, 1, "counted once until a step succeeds");
        assert_eq!(guard.counts().output, 0);
    }
}
