//! Wiggle: drives the robots of one host a short way out and back, one at a time, and judges from readings whether each
//! moved correctly. `doctor` uses it to check robot ids and the signs and order of axes.
//!
//! The direction is 22.5 degrees off an axis of the world frame. So each of the seven ways to swap or mirror axes gives
//! another direction, 45 degrees or more from the commanded one. Velocities pass through a guard. They are open-loop:
//! with a mirrored axis, feedback would drive the robot further and further off.

use std::collections::BTreeMap;

use super::drive_check::{self, DISTANCE_M, DriveCheck, NOISE_M};
use crate::actor::Core;
use crate::chassis::Chassis;
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::ids::RobotId;
use crate::messages::local::{Action, OtherRobot, Progress};
use crate::messages::wire::{Hardware, Health, MotorCommand, Phase, Reading, Round};
use crate::safety::filter;
use crate::safety::guard::{Decision, Guard};
use crate::safety::limits::distance_outside;
use crate::scenario::arena::Arena;
use crate::time::{Span, Time};

/// Speed of a robot's test drive \[m/s\] unless the robot's limits are lower: twice the smallest speed that a
/// RoboMaster can be commanded.
pub const SPEED_M_S: f32 = 0.2;
/// Longest time that a robot is driven in one direction \[s\].
const LONGEST_S: f32 = 5.0;
/// Period at which a Wiggle sends motor commands, equal to the control period of policies.
const PERIOD: Span = Span::from_millis(50);
/// Time from the end of a drive until it is judged, for the delay of robot and tracker and for braking.
const SETTLE: Span = Span::from_millis(400);
/// Age of a robot's newest reading from which the robot counts as not measured.
const LOST: Span = Span::from_millis(600);

/// Input message of a Wiggle, the actor that drives robots a short way to check them.
#[derive(Clone, Debug)]
pub enum In {
    /// Measured pose of a robot, one to be driven or another.
    Reading(Reading),
    /// Condition of the hardware of a robot to be driven.
    Hardware(RobotId, Hardware),
    /// Request to start the test drives, with the first robot.
    Begin,
    /// Request to end the wiggle at once: the driven robot stops.
    End,
}

/// Output message of a Wiggle, the actor that drives robots a short way to check them.
#[derive(Clone, Debug)]
pub enum Out {
    /// Velocity command for a robot's Body.
    Command(MotorCommand),
    /// Notice that the test drive of the robot begins.
    Begins(RobotId),
    /// Result of the test drive of this robot.
    Result(RobotId, DriveCheck),
    /// Notice that all robots have a result, or that the wiggle was ended.
    Over,
}

/// Robot to be driven and judged by a Wiggle.
#[derive(Clone, Copy, Debug)]
pub struct Driven {
    /// Id of the robot.
    pub robot: RobotId,
    /// Chassis of the robot: its drive, holonomic or differential, and its limits of speed.
    pub chassis: Chassis,
    /// Largest speed that the robot's driver permits \[m/s\].
    pub limit_m_s: f32,
}

/// Configuration of a Wiggle, the actor that drives robots a short way to check them.
#[derive(Clone, Debug)]
pub struct Config {
    /// Robots to be driven and judged, in this order.
    pub robots: Vec<Driven>,
    /// Configuration of the guard, which limits the velocities of every test drive for safety.
    pub guard: filter::Settings,
    /// Ground with its walls; robots are not driven toward the walls or the edge.
    pub arena: Arena,
    /// Time after its arrival at the Body for which a motor command is valid.
    pub valid_for: Span,
}

/// Stage of the test drive of the current robot.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// All robots stand still until this time; then the next test drive begins.
    Rest(Time),
    /// The robot drives out: velocity \[m/s\] in the world frame, start time, end time.
    Drive(Vec2, Time, Time),
    /// The robot settles after the drive: its velocity \[m/s\], the drive's duration, and the time at which it is
    /// judged.
    Settle(Vec2, Span, Time),
    /// The robot drives back with this velocity \[m/s\] until this time.
    Back(Vec2, Time),
    /// All robots have a result.
    Over,
}

/// Newest reading of one robot, and its position and noise at rest before the test drives.
#[derive(Clone, Debug)]
struct Track {
    last: Reading,
    at: Time,
    /// First position while the robot stood still, and the largest distance from it \[m\].
    rest: Vec2,
    noise_m: f32,
}

/// Actor that drives the robots of one host out and back, one at a time, and judges whether each moved correctly.
#[derive(Debug)]
pub(crate) struct Wiggle {
    config: Config,
    stage: Stage,
    /// Index of the current robot in the configuration.
    turn: usize,
    guard: Guard,
    tracks: BTreeMap<RobotId, Track>,
    hardware: BTreeMap<RobotId, Hardware>,
    /// Position of each robot when the current test drive began.
    before: BTreeMap<RobotId, Vec2>,
    next: Time,
}

impl Wiggle {
    /// Creates a Wiggle that waits for [`In::Begin`]. Until then all robots must stand still.
    pub(crate) fn new(config: Config) -> Wiggle {
        let guard = Guard::new(config.guard.clone());
        let (tracks, hardware, before) = Default::default();
        Wiggle { config, stage: Stage::Rest(Time::MAX), turn: 0, guard, tracks, hardware, before, next: Time::ZERO }
    }

    fn robot(&self) -> Option<Driven> {
        self.config.robots.get(self.turn).copied()
    }

    fn reading(&mut self, now: Time, reading: Reading) {
        let position = reading.pose.position;
        // Only readings before the first drive measure noise: later, a driven robot may still brake.
        let rests = self.turn == 0 && matches!(self.stage, Stage::Rest(_));
        let driven = self.robot().is_some_and(|driven| driven.robot == reading.robot);
        let track = self.tracks.entry(reading.robot).or_insert_with(|| Track {
            last: reading.clone(),
            at: now,
            rest: position,
            noise_m: 0.0,
        });
        let new = reading.stamp_ns != track.last.stamp_ns;
        if rests {
            track.noise_m = track.noise_m.max((position - track.rest).norm());
        }
        (track.last, track.at) = (reading, if new { now } else { track.at });
        if new && driven {
            self.guard.own_state(now);
        }
    }

    /// Returns the measured positions of a robot; `None` without a reading in the last 0.6 s.
    fn seen(&self, now: Time, robot: RobotId) -> Option<&Track> {
        self.tracks.get(&robot).filter(|track| now.since(track.at) < LOST)
    }

    /// Returns all measured robots except `robot`, as obstacles for the guard: last position, at rest, and its age.
    fn others(&self, now: Time, robot: RobotId) -> Vec<OtherRobot> {
        let other = |(&robot, track): (&RobotId, &Track)| OtherRobot {
            robot,
            motion: Motion::at_rest(track.last.pose.position),
            age: now.since(track.at),
        };
        self.tracks.iter().filter(|(other, _)| **other != robot).map(other).collect()
    }

    /// Returns the direction with the most room for a robot at `from` (unit vector, world frame); `None` if every
    /// direction leads too close to an obstacle.
    fn direction(&self, robot: RobotId, from: Vec2) -> Option<Vec2> {
        let (sin, cos) = libm::sincosf(22.5f32.to_radians());
        let all = [Vec2::new(cos, sin), Vec2::new(-sin, cos), Vec2::new(-cos, -sin), Vec2::new(sin, -cos)];
        let arena = &self.config.arena;
        let least = self.config.guard.safety.distance_min_m;
        let room = |along: Vec2| {
            let to = from + along * DISTANCE_M;
            let edge = -distance_outside(arena.half_extent, to);
            let others = self.tracks.iter().filter(|(other, _)| **other != robot);
            // Half of the distance as margin, so that the guard need not slow the robot.
            let others = others.map(|(_, track)| (track.last.pose.position - to).norm() - least - DISTANCE_M / 2.0);
            others.fold(edge.min(arena.clearance(to) - arena.robot_radius_m), f32::min)
        };
        let best = all.into_iter().max_by(|one, other| room(*one).total_cmp(&room(*other)))?;
        (room(best) > 0.0).then_some(best)
    }

    /// Begins the test drive of the current robot; skips robots that cannot be driven. Ends the wiggle after the last.
    fn begin(&mut self, now: Time, out: &mut Vec<Out>) {
        while let Some(driven) = self.robot() {
            match self.ready(now, driven) {
                Ok((velocity, span)) => {
                    out.push(Out::Begins(driven.robot));
                    self.stage = Stage::Drive(velocity, now, now + span);
                    return;
                }
                Err(verdict) => {
                    out.push(Out::Result(driven.robot, verdict));
                    self.turn += 1;
                }
            }
        }
        self.stage = Stage::Over;
        out.push(Out::Over);
    }

    /// Returns the velocity of a robot's test drive and its duration; the verdict if it cannot be driven.
    fn ready(&mut self, now: Time, driven: Driven) -> Result<(Vec2, Span), DriveCheck> {
        let Driven { robot, chassis, limit_m_s } = driven;
        if let Some(hardware) = self.hardware.get(&robot).filter(|hardware| hardware.health != Health::Ready) {
            return Err(DriveCheck::Unfit(hardware.reason.as_ref().map(|reason| reason.text().to_owned())));
        }
        let track = self.seen(now, robot).ok_or(DriveCheck::Unseen)?;
        if track.noise_m > NOISE_M {
            return Err(DriveCheck::Noisy(track.noise_m));
        }
        let pose = track.last.pose;
        let along = self.direction(robot, pose.position).ok_or(DriveCheck::NoRoom)?;
        let most = SPEED_M_S.min(limit_m_s).min(chassis.speed_m_s).min(self.config.guard.limit_m_s);
        // A differential drive at its limits moves its commanded point more slowly.
        let twist = pose.heading.and_then(|_| chassis.twist(along * most, pose.heading));
        let moves =
            twist.map(|twist| Vec2::new(twist.forward, twist.left + twist.yaw_rate * chassis.point_ahead_m).norm());
        let speed = moves.unwrap_or(most).clamp(DISTANCE_M / LONGEST_S, most.max(DISTANCE_M / LONGEST_S));
        self.before = self.tracks.iter().map(|(robot, track)| (*robot, track.last.pose.position)).collect();
        self.guard = Guard::new(self.config.guard.clone());
        self.guard.learn_latch(Default::default());
        let fresh = self.tracks.get(&robot).map_or(now, |track| track.at);
        self.guard.own_state(fresh);
        Ok((along * speed, Span::from_secs(f64::from(DISTANCE_M / speed))))
    }

    /// Passes a velocity (world frame) through the guard and sends it to the Body of the current robot.
    fn drive(&mut self, now: Time, velocity: Vec2, out: &mut Vec<Out>) {
        let Some(Driven { robot, .. }) = self.robot() else { return };
        let motion = self.tracks.get(&robot).map(|track| track.last.motion());
        // No state server runs during `doctor`; this stands in for it.
        self.guard.server_heard(now);
        let action = Action {
            robot,
            round: Round::default(),
            phase: Phase::Running,
            due: now,
            velocity: Some(velocity),
            estimate: motion.unwrap_or_default(),
            others: self.others(now, robot),
            progress: Progress::Underway,
        };
        let granted = match self.guard.decide(now, &action) {
            Decision::Drive(granted) => granted,
            Decision::Stop | Decision::Abort => self.guard.stop(),
        };
        self.command(robot, granted.velocity(), out);
    }

    fn command(&self, robot: RobotId, velocity: Vec2, out: &mut Vec<Out>) {
        out.push(Out::Command(MotorCommand { robot, velocity, valid_for: self.config.valid_for }));
    }

    fn halt(&mut self, out: &mut Vec<Out>) {
        if let Some(Driven { robot, .. }) = self.robot() {
            let granted = self.guard.stop();
            self.command(robot, granted.velocity(), out);
        }
    }

    /// Returns the verdict on the test drive of `robot` in the direction `along` (world frame).
    fn judge(&self, now: Time, robot: RobotId, along: Vec2) -> DriveCheck {
        let way = |robot: &RobotId, track: &Track| {
            let way = track.last.pose.position - *self.before.get(robot)?;
            drive_check::has_moved(way, track.noise_m).then_some(way)
        };
        let others = self.tracks.iter().filter(|(other, track)| **other != robot && way(other, track).is_some());
        let others: Vec<RobotId> = others.map(|(other, _)| *other).collect();
        match self.seen(now, robot) {
            Some(track) => drive_check::judge(along, way(&robot, track), others, &self.guard.counts()),
            None => DriveCheck::Unseen,
        }
    }

    /// Advances the current robot's test drive to its next stage (rest, drive, settle, back) if that is due.
    fn advance(&mut self, now: Time, out: &mut Vec<Out>) {
        match self.stage {
            Stage::Rest(until) if now >= until => self.begin(now, out),
            Stage::Drive(velocity, since, until) if now >= until => {
                self.stage = Stage::Settle(velocity, now.since(since), now + SETTLE);
            }
            Stage::Settle(velocity, span, until) if now >= until => {
                if let Some(Driven { robot, .. }) = self.robot() {
                    let verdict = self.judge(now, robot, velocity * (1.0 / velocity.norm()));
                    out.push(Out::Result(robot, verdict));
                }
                self.stage = Stage::Back(-velocity, now + span);
            }
            Stage::Back(_, until) if now >= until => {
                self.halt(out);
                self.turn += 1;
                self.stage = Stage::Rest(now + SETTLE);
            }
            _ => {}
        }
    }

    fn end(&mut self, out: &mut Vec<Out>) {
        if self.stage != Stage::Over {
            self.halt(out);
            self.stage = Stage::Over;
            out.push(Out::Over);
        }
    }
}

impl Core for Wiggle {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Reading(reading) => self.reading(now, reading),
            In::Hardware(robot, hardware) => drop(self.hardware.insert(robot, hardware)),
            In::Begin if self.stage == Stage::Rest(Time::MAX) => self.stage = Stage::Rest(now),
            In::Begin => {}
            In::End => self.end(out),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        (self.stage != Stage::Over).then_some(self.next)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        self.advance(now, out);
        match self.stage {
            Stage::Drive(velocity, ..) | Stage::Back(velocity, _) => self.drive(now, velocity, out),
            Stage::Rest(_) => {
                self.config.robots.iter().for_each(|driven| self.command(driven.robot, Vec2::zeros(), out))
            }
            Stage::Settle(..) => self.halt(out),
            Stage::Over => {}
        }
        self.next = now + PERIOD;
    }
}

#[cfg(test)]
mod tests {
    use super::super::drive_check::Axes;
    use super::*;
    use crate::safety::{Clamp, Safety};

    /// Two robots that follow their commands exactly, seen by a tracker at 100 Hz.
    struct Bench {
        wiggle: Wiggle,
        at: [Vec2; 2],
        velocity: [Vec2; 2],
        /// Mistakes of a set-up: in the robots' motions, in the tracker's positions, and in the names that it gives.
        axes: Axes,
        names: [u16; 2],
        silent_from: Option<Time>,
        results: Vec<(u16, DriveCheck)>,
        order: Vec<u16>,
        fastest: f32,
        now_ms: u64,
    }

    impl Bench {
        fn new(at: [Vec2; 2]) -> Bench {
            let safety = Safety::deployed();
            let guard = filter::Settings {
                safety,
                half_extent: Vec2::new(2.0, 2.0),
                walls: Default::default(),
                movers: Default::default(),
                limit_m_s: SPEED_M_S,
                clamp: Clamp::Training,
                period: PERIOD,
            };
            let arena = Arena::new(guard.half_extent, Vec::new(), 0.25);
            let driven = |robot| Driven { robot: RobotId(robot), chassis: Chassis::default(), limit_m_s: 1.0 };
            let robots = vec![driven(0), driven(1)];
            let config = Config { robots, guard, arena, valid_for: Span::from_millis(200) };
            Bench {
                wiggle: Wiggle::new(config),
                at,
                velocity: [Vec2::zeros(); 2],
                axes: Axes::Right,
                names: [0, 1],
                silent_from: None,
                results: Vec::new(),
                order: Vec::new(),
                fastest: 0.0,
                now_ms: 0,
            }
        }

        fn take(&mut self, out: Vec<Out>) {
            for out in out {
                match out {
                    Out::Command(command) => {
                        self.fastest = self.fastest.max(command.velocity.norm());
                        self.velocity[command.robot.index()] = self.axes.apply(command.velocity);
                    }
                    Out::Begins(robot) => self.order.push(robot.0),
                    Out::Result(robot, verdict) => self.results.push((robot.0, verdict)),
                    Out::Over => {}
                }
            }
        }

        /// Runs until a time; returns the results.
        fn run(&mut self, until_ms: u64) -> Vec<(u16, DriveCheck)> {
            for ms in (self.now_ms..until_ms).step_by(10) {
                let now = Time::ZERO + Span::from_millis(ms);
                let mut out = Vec::new();
                if ms == 500 {
                    self.wiggle.handle(now, In::Begin, &mut out);
                }
                for robot in 0..2 {
                    self.at[robot] += self.velocity[robot] * 0.01;
                    let mut reading =
                        Reading::of_point(RobotId(self.names[robot]), ms, Motion::at_rest(self.at[robot]));
                    reading.pose.heading = Some(0.3);
                    if self.silent_from.is_none_or(|from| now < from) {
                        self.wiggle.handle(now, In::Reading(reading), &mut out);
                    }
                }
                while self.wiggle.wake_at().is_some_and(|at| at <= now) {
                    self.wiggle.wake(now, &mut out);
                }
                self.take(out);
            }
            self.now_ms = until_ms;
            self.results.clone()
        }
    }

    const APART: [Vec2; 2] = [Vec2::new(-1.0, -1.0), Vec2::new(1.0, -1.0)];

    #[test]
    fn each_robot_goes_out_and_comes_back() {
        let mut bench = Bench::new(APART);
        let results = bench.run(6000);
        for (robot, verdict) in &results {
            let DriveCheck::Right(distance, off) = *verdict else { panic!("{robot}: {verdict:?}") };
            assert!((distance - 0.1).abs() < 0.011 && off.abs() < 0.01, "{distance} m, {off} rad");
        }
        assert_eq!((results.len(), bench.order.as_slice(), bench.wiggle.wake_at()), (2, &[0, 1][..], None));
        let back = bench.at.iter().zip(APART).map(|(at, from)| (*at - from).norm()).fold(0.0, f32::max);
        assert!(back < 0.011 && bench.fastest <= 0.2001, "{back} m off, at {} m/s", bench.fastest);
        assert_eq!(bench.velocity, [Vec2::zeros(); 2]);
    }

    #[test]
    fn every_mistake_in_the_axes_is_named() {
        for axes in Axes::ALL.into_iter().filter(|axes| *axes != Axes::Right) {
            let mut bench = Bench::new(APART);
            bench.axes = axes;
            let results = bench.run(6000);
            let named =
                |(_, verdict): &(u16, DriveCheck)| matches!(verdict, DriveCheck::Astray(found, _) if *found == axes);
            assert!(results.len() == 2 && results.iter().all(named), "{axes:?}: {results:?}");
        }
    }

    #[test]
    fn swapped_names_are_found_and_so_is_a_robot_that_stands() {
        let mut bench = Bench::new(APART);
        bench.names = [1, 0];
        let results = bench.run(6000);
        assert_eq!(results, [(0, DriveCheck::Still(vec![RobotId(1)])), (1, DriveCheck::Still(vec![RobotId(0)]))]);
        let mut unfit = Bench::new(APART);
        let flat = Hardware::of(Health::Faulty).because("battery 3 %");
        unfit.wiggle.handle(Time::ZERO, In::Hardware(RobotId(0), flat), &mut Vec::new());
        let results = unfit.run(6000);
        assert_eq!(results[0], (0, DriveCheck::Unfit(Some("battery 3 %".to_owned()))));
        assert!(matches!(results[1], (1, DriveCheck::Right(..))) && unfit.order == [1], "{results:?}");
    }

    #[test]
    fn a_tracker_that_dies_stops_the_robot() {
        let mut bench = Bench::new(APART);
        bench.silent_from = Some(Time::ZERO + Span::from_millis(600));
        bench.run(900);
        assert_eq!(bench.velocity[0], Vec2::zeros(), "its own state is too old");
        assert!((bench.at[0] - APART[0]).norm() < 0.05);
        let results = bench.run(6000);
        assert!(matches!(results[0], (0, DriveCheck::Unseen)), "{results:?}");
    }

    #[test]
    fn a_robot_is_driven_where_there_is_room_and_stays_where_there_is_none() {
        let mut corner = Bench::new([Vec2::new(1.95, 1.95), Vec2::new(-1.0, 0.0)]);
        let results = corner.run(6000);
        assert!(matches!(results[0], (0, DriveCheck::Right(..))), "away from the edge: {results:?}");
        let mut crowded = Bench::new([Vec2::zeros(), Vec2::new(0.2, 0.0)]);
        let results = crowded.run(6000);
        assert_eq!(results, [(0, DriveCheck::NoRoom), (1, DriveCheck::NoRoom)]);
        assert_eq!(crowded.fastest, 0.0);
    }

    #[test]
    fn its_end_stops_the_robot_at_once() {
        let mut bench = Bench::new(APART);
        bench.run(700);
        assert!(bench.velocity[0].norm() > 0.1);
        let mut out = Vec::new();
        bench.wiggle.handle(Time::ZERO + Span::from_millis(700), In::End, &mut out);
        assert!(matches!(&out[..], [Out::Command(command), Out::Over] if command.velocity == Vec2::zeros()), "{out:?}");
        assert_eq!(bench.wiggle.wake_at(), None);
    }
}
