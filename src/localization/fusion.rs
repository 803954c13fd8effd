//! Fusion of the robots' own odometry with any source of absolute poses: one that is slow, late, or without headings,
//! such as a satellite receiver.
//!
//! The state of the filter is the pose of a robot in the team's frame. Each odometry reading moves the pose and
//! increases its covariance with the distance travelled; each absolute reading corrects it, at the time at which it was
//! measured (extended Kalman filter, as in Thrun et al., Probabilistic Robotics, 2005, section 3.3 and 7.4). So the
//! drift of odometry is bounded, and headings are found from positions. A fused pose is put out at each odometry
//! reading.
//!
//! Increments of the odometry that the robot cannot have driven are no motion. If it begins anew, nothing is put out
//! until the source has agreed with the estimate for a while, or a person has said where the robot is.

use std::collections::{BTreeMap, VecDeque};

use nalgebra::{Vector2, Vector3};
use serde::Deserialize;

use super::fused_state::State;
use super::plausibility::{Fix, Limits, Plausibility, Quality, Track};
use super::{In, Out, Parts, Source, odometry};
use crate::config::ConfigError;
use crate::edge::Settings;
use crate::messages::geometry::{Pose, Vec2, rotated, wrapped};
use crate::messages::ids::RobotId;
use crate::messages::place::Whereabouts;
use crate::messages::wire::Reading;
use crate::time::{Span, Time};

/// Name of the table with the settings of the fusion, within the settings of any source.
const TABLE: &str = "fuse";
/// Standard deviation that is assumed for a heading that the user has set by hand \[rad\].
const BY_HAND_RAD: f64 = 0.2;
/// Standard deviation that is assumed for a measured heading whose source states no accuracy \[rad\].
const MEASURED_RAD: f64 = 0.02;
/// Standard deviation that is assumed for a position whose source states no accuracy, and smallest standard deviation
/// that is used for any position \[m\].
const POSITION_M: (f64, f64) = (0.02, 0.001);
/// Squared Mahalanobis distance of a measured position from the estimated one beyond which the reading is an outlier.
/// Of a normal distribution in two dimensions, one in 270 000 is beyond it.
const GATE: f64 = 25.0;
/// Time for which odometry has to agree with itself after a jump before it counts as restarted.
const RESTART: Span = Span::from_millis(100);
/// Speed \[m/s\] and yaw rate \[rad/s\] that a robot may have had beyond those that its odometry last measured, while
/// that has restarted.
const UNSEEN: (f64, f64) = (0.3, 0.5);
/// Standard deviations that are assumed for a pose that a person has said \[m, rad\].
const BY_EYE: (f64, f64) = (0.1, 0.1);
/// Largest standard deviation of the heading with which a robot may go on after its odometry has restarted \[rad\]: 20
/// degrees.
const KNOWN_RAD: f64 = 0.35;
/// Number of past poses that are stored for late readings: those of two seconds at 50 Hz.
const KEPT: usize = 100;

/// Settings of the fusion of odometry with the readings of a source, for one robot.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Heading of the robot when its host starts \[rad\], for sources that measure none. It may be off by some 20
    /// degrees.
    heading_rad: Option<f64>,
    /// Age of the source's readings at their arrival \[s\].
    #[serde(default)]
    delay_s: f64,
    /// Error of the odometry after 1 m: the same number as distance \[m\] and as heading \[rad\]. It grows with the
    /// square root of the distance.
    #[serde(default = "drift")]
    drift: f64,
    /// Longest time without a reading of the source for which poses are still put out, from odometry alone \[s\].
    #[serde(default = "alone_s")]
    alone_s: f64,
}

/// Returns the default of `Config::drift`, for wheels that sometimes slip: an error of 5 cm after 1 m.
fn drift() -> f64 {
    0.05
}

/// Returns the default of `Config::alone_s` \[s\]: in this time, a robot at 0.8 m/s without corrections drives one or
/// two times its own length.
fn alone_s() -> f64 {
    1.0
}

impl Config {
    fn check(self) -> Result<Config, ConfigError> {
        let wrong = |field: &str, why: &str| Err(ConfigError::field(field, why.to_owned()).within(TABLE));
        if self.heading_rad.is_some_and(|heading| !(-7.0..=7.0).contains(&heading)) {
            return wrong("heading_rad", "it is not an angle in radians, -7 to 7");
        }
        if !(0.0..=1.0).contains(&self.delay_s) {
            return wrong("delay_s", "it is not 0 to 1 s");
        }
        if !(0.001..=1.0).contains(&self.drift) {
            return wrong("drift", "it is not 0.001 to 1");
        }
        if !(0.05..=60.0).contains(&self.alone_s) {
            return wrong("alone_s", "it is not 0.05 to 60 s");
        }
        Ok(self)
    }
}

/// Makes a source with the function `source`, and fuses its readings with the robots' odometry by a Kalman filter. The
/// readings of a robot are fused only if its settings have a table `fuse`; all other readings are passed on unchanged.
///
/// # Errors
///
/// Returns the error of `source`, or the name of a wrong setting in the table `fuse`.
pub fn make(
    settings: &Settings,
    robots: &[RobotId],
    source: impl FnOnce(&Settings, &[RobotId]) -> Result<Parts, ConfigError>,
) -> Result<Parts, ConfigError> {
    let mut configs = BTreeMap::new();
    for robot in robots {
        if let Some(table) = settings.for_robot(*robot)?.table.remove(TABLE) {
            let own = toml::Table::try_from(table).map_err(|_| {
                ConfigError::field(TABLE, "it is no table; write fuse = { heading_rad = 0.0 }".to_owned())
            })?;
            let config: Config = Settings { name: TABLE.to_owned(), table: own }.read()?;
            configs.insert(*robot, config.check()?);
        }
    }
    let mut rest = settings.clone();
    rest.table.remove(TABLE);
    if let Some(toml::Value::Table(robots)) = rest.table.get_mut("robot") {
        robots.iter_mut().filter_map(|(_, own)| own.as_table_mut()).for_each(|own| drop(own.remove(TABLE)));
    }
    let parts = source(&rest, robots)?;
    if configs.is_empty() {
        return Ok(parts);
    }
    let everyone = robots.iter().all(|robot| configs.contains_key(robot));
    let inner = parts.source;
    let fused = move || {
        let filters: BTreeMap<RobotId, Filter> =
            configs.iter().map(|(robot, config)| (*robot, Filter::new(*config))).collect();
        let mut inner = inner();
        if everyone {
            inner.positions_suffice();
        }
        Box::new(Fused { inner, filters, said: Vec::new() }) as Box<dyn Source>
    };
    Ok(Parts { source: Box::new(fused), worker: parts.worker })
}

/// Source that fuses the readings of an inner source with the odometry of its robots.
struct Fused {
    inner: Box<dyn Source>,
    filters: BTreeMap<RobotId, Filter>,
    said: Vec<Out>,
}

impl Fused {
    /// Corrects the filters by the readings that the inner source has put out. Readings of robots without a filter and
    /// refusals are appended to `out`.
    fn absorb(&mut self, now: Time, out: &mut Vec<Out>) {
        for said in self.said.drain(..) {
            match said {
                Out::Reading(reading) => match self.filters.get_mut(&reading.robot) {
                    Some(filter) => {
                        let refused = |why| Out::RefusedOf(reading.robot, why);
                        let quality = self.inner.quality(reading.robot);
                        out.extend(filter.correct(now, &reading, quality).err().map(refused));
                    }
                    None => out.push(Out::Reading(reading)),
                },
                other @ (Out::Refused(_) | Out::RefusedOf(..) | Out::Lost(..)) => out.push(other),
            }
        }
    }
}

impl Source for Fused {
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        if let In::Odometry(odometry) = input
            && let Some(filter) = self.filters.get_mut(&odometry.robot)
        {
            let refused = |why| Out::RefusedOf(odometry.robot, why);
            match filter.advance(now, odometry) {
                Ok(reading) => out.extend(reading.map(|one| one.unfit().map_or(Out::Reading(one), refused))),
                Err(Refusal::Input(why)) => out.push(refused(why)),
                Err(Refusal::Restarted) => out.push(Out::Lost(odometry.robot, Whereabouts::Adrift)),
            }
            return;
        }
        self.inner.take(now, input, &mut self.said);
        self.absorb(now, out);
    }

    fn positions_suffice(&mut self) {
        self.inner.positions_suffice();
    }

    fn wake_at(&self) -> Option<Time> {
        self.inner.wake_at()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        self.inner.wake(now, &mut self.said);
        self.absorb(now, out);
    }

    fn quality(&self, robot: RobotId) -> Quality {
        // Of a fused pose the filter states how well it is known.
        if self.filters.contains_key(&robot) { Quality::MEASURED } else { self.inner.quality(robot) }
    }

    fn limit(&mut self, robot: RobotId, limits: &Limits) {
        self.filters.get_mut(&robot).into_iter().for_each(|filter| filter.limits = *limits);
        self.inner.limit(robot, limits);
    }

    fn place(&mut self, now: Time, robot: RobotId, pose: &Pose) -> bool {
        match self.filters.get_mut(&robot) {
            Some(filter) => filter.place(now, pose),
            None => self.inner.place(now, robot, pose),
        }
    }
}

/// Reason for which odometry gives no fused pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Refusal {
    /// The odometry is unfit or has jumped.
    Input(&'static str),
    /// The odometry has begun anew, so the robot may have moved without being seen.
    Restarted,
}

/// How a filter comes to know the robot's pose again after its odometry has restarted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Recovery {
    /// The pose is known.
    Over,
    /// No reading of the source has agreed with the estimate since the restart.
    Begun,
    /// Readings of the source have agreed with the estimate since this time.
    Agreed(Time),
}

/// Kalman filter that estimates the pose of one robot from its odometry and the readings of a source.
#[derive(Debug)]
struct Filter {
    config: Config,
    /// Limits of the robot's motion.
    limits: Limits,
    /// Odometry readings, by which those out of reach are refused.
    track: Track,
    /// Last accepted odometry reading: its arrival, stamp \[ns\] and pose \[m, m, rad\]; `None` before the first.
    last: Option<(Time, u64, [f64; 3])>,
    /// Speed and yaw rate of the last accepted odometry \[m/s, rad/s\].
    speed: (f64, f64),
    state: Option<State>,
    /// Past estimated poses \[m, m, rad\] with their times, the newest last.
    past: VecDeque<(Time, Vector3<f64>)>,
    /// Time of arrival of the last reading of the source that corrected the pose.
    corrected: Time,
    /// Readings of the source that are far from the estimate and agree with each other: arrival of the first, and the
    /// newest; `None` if the last one was near.
    elsewhere: Option<(Time, Fix)>,
    recovery: Recovery,
}

impl Filter {
    fn new(config: Config) -> Filter {
        Filter {
            config,
            limits: Limits::default(),
            track: Track::default(),
            last: None,
            speed: (0.0, 0.0),
            state: None,
            past: VecDeque::new(),
            corrected: Time::ZERO,
            elsewhere: None,
            recovery: Recovery::Over,
        }
    }

    /// Takes over where a person has said that the robot stands. Without a heading the old one is kept; false if there
    /// is none.
    fn place(&mut self, now: Time, pose: &Pose) -> bool {
        let heading = pose.heading.map(f64::from).or(self.state.map(|state| state.pose.z));
        let Some(heading) = heading else { return false };
        let pose = Vector3::new(f64::from(pose.position.x), f64::from(pose.position.y), heading);
        self.state = Some(State::at(pose, BY_EYE.0, BY_EYE.1));
        (self.corrected, self.elsewhere, self.recovery) = (now, None, Recovery::Over);
        self.past.clear();
        true
    }

    /// Begins the estimate's motion anew at an odometry reading that does not continue the last one: the robot may have
    /// moved meanwhile.
    fn restart(&mut self, now: Time, since: Time) {
        let unseen_s = now.since(since).as_secs().min(1.0);
        let (way, turn) = ((self.speed.0 + UNSEEN.0) * unseen_s, (self.speed.1 + UNSEEN.1) * unseen_s);
        self.state.iter_mut().for_each(|state| state.doubt(Vector3::new(way, way, turn)));
        (self.recovery, self.elsewhere) = (Recovery::Begun, None);
        self.past.clear();
    }

    /// Moves the estimated pose by the motion since the last odometry reading, and returns the new estimate as a
    /// reading. Returns `None` before the first reading of the source, if its last one is older than `alone_s`, if the
    /// odometry is repeated, and after its restart until the pose is known again. An error is the reason for which the
    /// odometry is refused.
    fn advance(&mut self, now: Time, odometry: &Reading) -> Result<Option<Reading>, Refusal> {
        let Pose { position, heading: Some(heading) } = odometry.pose else {
            return Err(Refusal::Input("odometry without a heading cannot be fused"));
        };
        let pose = [f64::from(position.x), f64::from(position.y), f64::from(heading)];
        if !pose.iter().all(|number| number.is_finite()) {
            return Err(Refusal::Input("odometry has a number that is not finite"));
        }
        let last = self.last;
        if last.is_some_and(|(_, stamp_ns, _)| stamp_ns == odometry.stamp_ns) {
            return Ok(None);
        }
        // The increments count, whatever frame they are in: a restart is over once the new poses agree.
        let quality = Quality { reckoned: true, ..odometry::quality(&odometry.pose) };
        match self.track.reckon(Fix::of(now, odometry, quality), &self.limits, RESTART) {
            Plausibility::Accepted => {}
            Plausibility::Refused => {
                return Err(Refusal::Input("odometry has jumped further than its robot can drive"));
            }
            Plausibility::Settled => {
                self.last = Some((now, odometry.stamp_ns, pose));
                let Some((since, ..)) = last.filter(|_| self.state.is_some()) else { return Ok(None) };
                self.restart(now, since);
                return Err(Refusal::Restarted);
            }
        }
        self.last = Some((now, odometry.stamp_ns, pose));
        let rate = f64::from(odometry.twist.yaw_rate.unwrap_or(0.0)).abs();
        self.speed = (f64::from(odometry.twist.velocity.norm()), rate);
        let Some((_, _, before)) = last else { return Ok(None) };
        let (ahead, left) = rotated(-before[2], pose[0] - before[0], pose[1] - before[1]);
        let turn = wrapped(pose[2] - before[2]);
        let Some(state) = &mut self.state else { return Ok(None) };
        state.advance([ahead, left, turn], self.config.drift);
        let state = *state;
        self.past.push_back((now, state.pose));
        if self.past.len() > KEPT {
            self.past.pop_front();
        }
        if self.recovery != Recovery::Over || now.since(self.corrected) > Span::from_secs(self.config.alone_s) {
            return Ok(None);
        }
        let velocity = odometry.twist.velocity;
        let (vx, vy) = rotated(state.pose.z - pose[2], f64::from(velocity.x), f64::from(velocity.y));
        let mut reading = odometry.clone();
        reading.pose.position = state.pose.xy().cast();
        reading.pose.heading = Some(wrapped(state.pose.z) as f32);
        reading.twist.velocity = Vec2::new(vx as f32, vy as f32);
        let variance = (state.covariance.m11 + state.covariance.m22) / 2.0;
        reading.deviation.position_m = Some(variance.sqrt() as f32);
        reading.deviation.heading_rad = Some(state.covariance.m33.sqrt() as f32);
        Ok(Some(reading))
    }

    /// Corrects the estimated pose by a reading of the source; the first reading sets it. An error is the reason for
    /// which the reading is refused, such as an outlier. `quality` is what may be assumed of the reading.
    fn correct(&mut self, now: Time, reading: &Reading, quality: Quality) -> Result<(), &'static str> {
        let measured: Vector2<f64> = reading.pose.position.cast();
        let heading = reading.pose.heading.map(f64::from);
        let deviation = &reading.deviation;
        let position_m = deviation.position_m.map_or(POSITION_M.0, f64::from).max(POSITION_M.1);
        let heading_rad = deviation.heading_rad.map_or(MEASURED_RAD, f64::from).max(POSITION_M.1);
        let Some(state) = &mut self.state else {
            let (first, deviation) = match (heading, self.config.heading_rad) {
                (Some(heading), _) => (heading, heading_rad),
                (None, Some(heading)) => (heading, BY_HAND_RAD),
                (None, None) => return Err("the source measures no heading: say it by hand, as fuse.heading_rad"),
            };
            self.state = Some(State::at(measured.push(first), position_m, deviation));
            self.corrected = now;
            return Ok(());
        };
        // The pose at the time of the measurement, less all corrections since.
        let delay = Span::from_secs(self.config.delay_s);
        let then = self.past.iter().rev().find(|(at, _)| now.since(*at) >= delay).or_else(|| self.past.front());
        let then = then.map_or(state.pose, |(_, pose)| *pose);
        let error = measured - then.xy();
        let variance = position_m * position_m;
        if state.distance(error, variance) > GATE {
            let fix = Fix::of(now, reading, quality);
            let known = self.elsewhere.filter(|(_, newest)| newest.agrees_with(&fix, &self.limits));
            let since = known.map_or(now, |(since, _)| since);
            self.elsewhere = Some((since, fix));
            if now.since(since) < self.limits.settle || quality.reckoned {
                let agreed = matches!(self.recovery, Recovery::Agreed(_));
                self.recovery = if agreed { Recovery::Begun } else { self.recovery };
                return Err("a reading is far from where odometry can have brought the robot");
            }
            // The robot was carried, or the filter has diverged: its heading may be wrong, too. The pose that is put
            // out jumps, so the robot is stopped until that has settled, too.
            state.doubt(error.push(BY_HAND_RAD));
        }
        self.elsewhere = None;
        let before = state.pose;
        state.correct_position(error, variance);
        if let Some(heading) = heading {
            state.correct_heading(wrapped(heading - then.z - (state.pose.z - before.z)), heading_rad * heading_rad);
        }
        let moved = state.pose - before;
        self.past.iter_mut().for_each(|(_, pose)| *pose += moved);
        self.corrected = now;
        self.recovery = match self.recovery {
            Recovery::Over => Recovery::Over,
            Recovery::Begun => Recovery::Agreed(now),
            Recovery::Agreed(since) if now.since(since) < self.limits.settle => Recovery::Agreed(since),
            Recovery::Agreed(_) if state.covariance.m33 <= KNOWN_RAD * KNOWN_RAD => Recovery::Over,
            agreed => agreed,
        };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::random::{RngExt, Seed};

    fn config() -> Config {
        Config { heading_rad: Some(0.0), delay_s: 0.0, drift: 0.05, alone_s: 1.0 }
    }

    fn reading(stamp_ms: u64, [x, y]: [f64; 2], heading: Option<f64>) -> Reading {
        let motion = Motion { position: Vec2::new(x as f32, y as f32), velocity: Vec2::zeros() };
        let mut reading = Reading::of_point(RobotId(0), stamp_ms * 1_000_000, motion);
        reading.pose.heading = heading.map(|heading| wrapped(heading) as f32);
        reading
    }

    /// Drives 400 s along curves. Wheels say 3 % too much way and turn 2 % too little, and the filter was told a
    /// heading that is `off`. Returns the largest errors after the first 20 s: of odometry that was aligned exactly
    /// [m], and of the fusion [m, rad].
    fn drive(config: Config, off: f64) -> (f64, f64, f64) {
        drive_with(config, off, (config.delay_s * 1e3).round() as u64)
    }

    /// Drives as `drive`, with readings that arrive this late [ms].
    fn drive_with(config: Config, off: f64, late: u64) -> (f64, f64, f64) {
        let (mut filter, mut stream) = (Filter::new(config), Seed::of_run(4).stream("fix"));
        let (mut truth, mut wheels) = ([3.0, -2.0, 0.7 + off], [0.0_f64; 3]);
        let mut old: VecDeque<[f64; 3]> = VecDeque::new();
        let (mut alone, mut worst, mut worst_rad) = (0.0_f64, 0.0_f64, 0.0_f64);
        for step in 0..20_000_u64 {
            let (now, ms) = (Time::ZERO + Span::from_millis(20 * step), 20 * step);
            let (speed, turn) = (0.4, 0.3 * libm::sin(step as f64 / 300.0) + 0.05);
            let move_by = |pose: &mut [f64; 3], way: f64, turn: f64| {
                let (dx, dy) = rotated(pose[2] + turn / 2.0, way, 0.0);
                *pose = [pose[0] + dx, pose[1] + dy, pose[2] + turn];
            };
            move_by(&mut truth, 0.02 * speed, 0.02 * turn);
            move_by(&mut wheels, 0.02 * speed * 1.03, 0.02 * turn * 0.98);
            old.push_back(truth);
            if old.len() as u64 > late / 20 + 1 {
                old.pop_front();
            }
            let said = filter.advance(now, &reading(ms, [wheels[0], wheels[1]], Some(wheels[2]))).unwrap();
            if let Some(said) = said {
                let at = said.pose.position;
                let error = libm::hypot(f64::from(at.x) - truth[0], f64::from(at.y) - truth[1]);
                if step > 1000 {
                    let (x, y) = rotated(0.7 + off, wheels[0], wheels[1]);
                    alone = alone.max(libm::hypot(x + 3.0 - truth[0], y - 2.0 - truth[1]));
                    worst = worst.max(error);
                    worst_rad = worst_rad.max(wrapped(f64::from(said.pose.heading.unwrap()) - truth[2]).abs());
                }
            }
            if step % 5 == 0 {
                let then = old[0];
                let mut noise = || 0.02 * (stream.random_range(-1.7..1.7_f64));
                let mut fix = reading(ms, [then[0] + noise(), then[1] + noise()], None);
                fix.deviation.position_m = Some(0.02);
                // Outliers are refused.
                let _ = filter.correct(now, &fix, Quality::MEASURED);
            }
        }
        (alone, worst, worst_rad)
    }

    #[test]
    fn drift_is_bounded_and_the_heading_is_found_from_positions() {
        let by_hand = Config { heading_rad: Some(0.7), delay_s: 0.1, ..config() };
        let (alone, worst, worst_rad) = drive(by_hand, 0.3);
        assert!(alone > 0.5, "wheels drift: {alone}");
        assert!(worst < 0.05 && worst_rad < 0.1, "the filter does not: {worst} m, {worst_rad} rad");
    }

    #[test]
    fn the_delay_of_the_source_is_made_up_for() {
        let told = Config { heading_rad: Some(0.7), delay_s: 0.1, ..config() };
        let (_, known, _) = drive(told, 0.0);
        let (_, ignored, _) = drive_with(Config { delay_s: 0.0, ..told }, 0.0, 100);
        assert!(known < 0.05 && ignored > known + 0.015, "0.1 s at 0.4 m/s are 4 cm: {known}, {ignored}");
    }

    #[test]
    fn without_the_source_a_robot_goes_on_for_a_while_and_then_has_no_reading() {
        let mut filter = Filter::new(config());
        let advance = |filter: &mut Filter, ms: u64| {
            let now = Time::ZERO + Span::from_millis(ms);
            filter.advance(now, &reading(ms, [0.001 * ms as f64, 0.0], Some(0.0))).unwrap()
        };
        assert_eq!(advance(&mut filter, 0), None);
        assert_eq!(advance(&mut filter, 20), None, "its position is unknown");
        filter.correct(Time::ZERO + Span::from_millis(30), &reading(30, [5.0, 5.0], None), Quality::MEASURED).unwrap();
        let said = advance(&mut filter, 40).unwrap();
        assert!((said.pose.position - Vec2::new(5.02, 5.0)).norm() < 1e-5, "{said:?}");
        assert!(advance(&mut filter, 1030).is_some() && advance(&mut filter, 1040).is_none());
        filter
            .correct(Time::ZERO + Span::from_millis(1050), &reading(1050, [6.02, 5.0], None), Quality::MEASURED)
            .unwrap();
        assert!(advance(&mut filter, 1060).is_some());
    }

    #[test]
    fn an_outlier_is_refused_and_a_robot_that_was_carried_is_found_again() {
        let mut filter = Filter::new(config());
        let mut step = |ms: u64, x: f64| {
            let now = Time::ZERO + Span::from_millis(ms);
            filter.advance(now, &reading(ms, [0.0, 0.0], Some(0.0))).unwrap();
            let refused = filter.correct(now, &reading(ms, [x, 0.0], None), Quality::MEASURED).is_err();
            (refused, filter.state.map(|state| state.pose[0]))
        };
        assert_eq!(step(0, 1.0), (false, Some(1.0)));
        assert_eq!(step(100, 3.0), (true, Some(1.0)), "no robot is that fast");
        assert!(!step(200, 1.01).0);
        let refused = (3..30).filter(|at| step(100 * at, 3.0).0).count();
        assert_eq!(refused, 10, "it has to stay there for a second");
        assert!((step(3000, 3.0).1.unwrap() - 3.0).abs() < 0.1, "it was carried");
    }

    #[test]
    fn readings_that_flicker_are_never_believed_however_many_they_are() {
        let mut filter = Filter::new(config());
        for at in 0..200 {
            let now = Time::ZERO + Span::from_millis(50 * at);
            filter.advance(now, &reading(50 * at, [0.0, 0.0], Some(0.0))).unwrap();
            let x = if at % 2 == 0 { 20.0 } else { 40.0 };
            let fix = reading(50 * at, [if at == 0 { 1.0 } else { x }, 0.0], None);
            assert_eq!(filter.correct(now, &fix, Quality::MEASURED).is_err(), at > 0, "{at}");
        }
        assert_eq!(filter.state.unwrap().pose[0], 1.0);
    }

    #[test]
    fn odometry_that_begins_anew_is_no_motion_and_gives_no_pose_before_the_source_has_agreed() {
        for reset in [0.3, 0.08, 5.0] {
            let mut filter = Filter::new(config());
            filter.limits.speed_m_s = 2.0;
            let (mut restarted, mut lost, mut back) = (0, None, None);
            for at in 0..300 {
                let (ms, now) = (20 * at, Time::ZERO + Span::from_millis(20 * at));
                // The robot stands at 7 m; its odometry says where it came from, then counts from zero again.
                let wheels = if at < 100 { reset } else { 0.0 };
                match filter.advance(now, &reading(ms, [wheels, 0.0], Some(0.0))) {
                    Err(Refusal::Restarted) => (restarted, lost) = (restarted + 1, lost.or(Some(at))),
                    Ok(Some(said)) => {
                        assert!((said.pose.position.x - 7.0).abs() < 0.05, "{reset}: {said:?}");
                        back = back.or(Some(at).filter(|_| lost.is_some()));
                    }
                    Ok(None) | Err(Refusal::Input(_)) => {}
                }
                if at % 5 == 0 {
                    filter.correct(now, &reading(ms, [7.0, 0.0], None), Quality::MEASURED).unwrap();
                }
            }
            assert_eq!((restarted, lost), (1, Some(105)), "{reset}");
            assert!((155..=165).contains(&back.unwrap()), "{reset}: a second of the source: {back:?}");
        }
    }

    #[test]
    fn a_person_says_where_a_robot_with_restarted_odometry_is() {
        let mut filter = Filter::new(Config { alone_s: 10.0, ..config() });
        let advance = |filter: &mut Filter, at: u64, x: f64| {
            filter.advance(Time::ZERO + Span::from_millis(20 * at), &reading(20 * at, [x, 0.0], Some(0.0)))
        };
        filter.correct(Time::ZERO, &reading(0, [7.0, 0.0], Some(0.0)), Quality::MEASURED).unwrap();
        (0..10).for_each(|at| assert!(advance(&mut filter, at, 3.0).is_ok()));
        (10..100).for_each(|at| assert!(!matches!(advance(&mut filter, at, 0.0), Ok(Some(_))), "{at}"));
        let pose = Pose { position: Vec2::new(9.0, 1.0), heading: Some(1.5) };
        assert!(filter.place(Time::ZERO + Span::from_millis(2000), &pose));
        let said = advance(&mut filter, 101, 0.0).unwrap().unwrap();
        assert!((said.pose.position - pose.position).norm() < 1e-5 && said.pose.heading == Some(1.5), "{said:?}");
    }

    #[test]
    fn settings_are_of_any_source_and_a_wrong_one_is_named() {
        let settings = |table: &str| Settings { name: "odometry".to_owned(), table: table.parse().unwrap() };
        let made = |table: &str| {
            make(&settings(table), &[RobotId(0), RobotId(1)], |rest, _| {
                assert!(!rest.table.contains_key(TABLE), "the source does not know it");
                crate::localization::odometry::make(rest, &[RobotId(0), RobotId(1)])
            })
        };
        assert!(made("").is_ok() && made("fuse = { heading_rad = 0.0 }").is_ok());
        assert!(made("robot.1 = { fuse = { delay_s = 0.1 }, yaw_rad = 1.0 }").is_ok());
        for (table, field) in [
            ("fuse = 3", "fuse"),
            ("fuse = { delay_s = 2.0 }", "fuse.delay_s"),
            ("fuse = { drift = 0.0 }", "fuse.drift"),
            ("fuse = { heading_rad = 90.0 }", "fuse.heading_rad"),
            ("fuse = { alone_s = 0.0 }", "fuse.alone_s"),
            ("fuse = { wheels = 4 }", "fuse"),
        ] {
            let error = made(table).err().expect(table).to_string();
            assert!(error.starts_with(field), "{error}");
        }
    }
}
