//! Plausibility of measured poses: whether a robot can have driven from its last accepted pose to a new one.
//!
//! A pose is *in reach* if the robot can have got there within its limits of speed and yaw rate, and within `SIGMAS`
//! standard deviations of the two measurements. One that is not is no measurement: it is refused. One refused pose
//! means nothing, as a reflection in a tracker: the next pose that is nearer to the last accepted one is accepted.
//! Poses that are refused for `DOUBT` mean that the robot is *lost*. It is known again once poses have agreed with each
//! other, as of one motion, for `Limits::settle`; with dead reckoning only when a person has said where the robot is.

use crate::chassis::Chassis;
use crate::config::ConfigError;
use crate::edge::Settings;
use crate::messages::geometry::{Deviation, Planar, Pose, Vec2, wrapped};
use crate::messages::ids::RobotId;
use crate::messages::place::Whereabouts;
use crate::messages::wire::Reading;
use crate::time::{Span, Time};
use serde::Deserialize;

/// Number of standard deviations of the difference of two measurements by which a pose may be out of reach. Of a normal
/// distribution in two dimensions one in 66 million is beyond six: at 50 Hz one in 15 days, and it costs one reading.
pub(crate) const SIGMAS: f64 = 6.0;
/// Smallest standard deviations of a position \[m\] and of a heading \[rad\] that are used. What a source states is
/// often its best case; and two poses of a tracker are up to 2 cm apart for other reasons than noise.
const LEAST: (f64, f64) = (0.0025, 0.01);
/// Largest standard deviations of dead reckoning that are used, of its position \[m\] and of its heading \[rad\]. What
/// odometry states is how far it has drifted, not how far two of its poses are off each other.
const MOST_RECKONED: (f64, f64) = (0.02, 0.05);
/// Longest time for which a robot is assumed to have driven at its limit between two poses \[s\]. After 0.1 s
/// (`own_state_s`) without a reading its guard has stopped it.
const REACH_S: f64 = 1.0;
/// The same for dead reckoning after a longer silence \[s\]: until the guard and the drive have stopped the robot.
const STOPPED_S: f64 = 0.5;
/// Longest time by which the stamps of two readings may be further apart than their arrivals \[s\]. Beyond it the clock
/// of the source has been set.
const LATE_S: f64 = 0.5;
/// Time for which poses are refused, from the first to the last, before the robot counts as lost.
const DOUBT: Span = Span::from_millis(100);
/// Longest time between two poses of one motion. A slow receiver measures once a second.
const ONE_MOTION: Span = Span::from_millis(2000);
/// Distance from its last accepted pose within which a robot that was stopped is back \[m\]: that of one that stood,
/// and the most of one that drove. The second is also the largest turn \[rad\].
const BACK: (f64, f64) = (0.05, 0.3);
/// Silence of dead reckoning before a pose at its origin, after which it has begun anew \[s\].
const RESTARTED_S: f64 = 0.15;
/// Distance at which a turn counts in the choice of the nearer of two poses \[m/rad\].
const TURN_M: f64 = 0.5;
/// Margin of the limits of speed over what the policy and the chassis allow: wheels are off by some percent, and a
/// drive overshoots.
const MARGIN: f64 = 1.25;
/// Speed \[m/s\] and yaw rate \[rad/s\] of a robot without limits: above those of a RoboMaster EP, 3.5 m/s and 10.5
/// rad/s.
const UNLIMITED: (f64, f64) = (4.0, 11.0);
/// Longest time between two poses for which a measured velocity counts \[s\].
const DRIVEN_S: f64 = 10.0;

/// Limits of the motion of a robot, by which its measured poses are accepted or refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest speed of the robot's centre \[m/s\].
    pub speed_m_s: f64,
    /// Largest yaw rate of the robot \[rad/s\].
    pub yaw_rate_rad_s: f64,
    /// Time for which poses have to agree with each other before a lost robot is known again.
    pub settle: Span,
    /// Whether the source is dead reckoning, such as odometry; `None` if the source itself says so.
    pub drifts: Option<bool>,
}

impl Default for Limits {
    /// Returns the limits of a robot of which nothing is known.
    fn default() -> Limits {
        let (speed_m_s, yaw_rate_rad_s) = UNLIMITED;
        Limits { speed_m_s, yaw_rate_rad_s, settle: Span::from_millis(1000), drifts: None }
    }
}

/// Fields of a source's settings that concern the plausibility of its poses. Every source has them, for all robots or
/// for one.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Fields {
    /// Largest speed of a robot \[m/s\].
    speed_most_m_s: Option<f64>,
    /// Largest yaw rate of a robot \[rad/s\].
    yaw_rate_most_rad_s: Option<f64>,
    /// Time for which poses have to agree with each other after a jump \[s\].
    settle_s: Option<f64>,
    /// Whether the source is dead reckoning, such as odometry.
    drifts: Option<bool>,
}

const FIELDS: [&str; 4] = ["speed_most_m_s", "yaw_rate_most_rad_s", "settle_s", "drifts"];

fn is_field(key: &str) -> bool {
    FIELDS.contains(&key)
}

/// Returns the limits of a robot: those in the settings of its source, or otherwise a quarter more than what its
/// chassis and its policy allow. `axis_m_s` is the largest speed along each axis that the policy commands \[m/s\], if
/// it is known. An error names the wrong setting.
pub fn limits(
    settings: &Settings,
    robot: RobotId,
    (chassis, axis_m_s): (&Chassis, Option<f32>),
) -> Result<Limits, ConfigError> {
    let mut own = settings.for_robot(robot)?;
    own.table.retain(|key, _| is_field(key));
    let fields: Fields = own.read()?;
    let within = [
        ("speed_most_m_s", fields.speed_most_m_s, 0.05, 50.0, "m/s"),
        ("yaw_rate_most_rad_s", fields.yaw_rate_most_rad_s, 0.1, 100.0, "rad/s"),
        ("settle_s", fields.settle_s, 0.2, 60.0, "s"),
    ];
    for (name, value, least, most, unit) in within {
        if value.is_some_and(|value| !(least..=most).contains(&value)) {
            return Err(ConfigError::field(name, format!("it is out of range; give {least} to {most} {unit}")));
        }
    }
    // A policy is limited along each axis, so it is fastest along the diagonal.
    let driven = axis_m_s.map_or(f64::INFINITY, |axis| f64::from(axis) * std::f64::consts::SQRT_2);
    let margin = |most: f64, unlimited: f64| if most.is_finite() { MARGIN * most } else { unlimited };
    let (speed, turn) = (f64::from(chassis.speed_m_s).min(driven), f64::from(chassis.yaw_rate_rad_s));
    Ok(Limits {
        speed_m_s: fields.speed_most_m_s.unwrap_or_else(|| margin(speed, UNLIMITED.0)),
        yaw_rate_rad_s: fields.yaw_rate_most_rad_s.unwrap_or_else(|| margin(turn, UNLIMITED.1)),
        settle: fields.settle_s.map_or(Limits::default().settle, Span::from_secs),
        drifts: fields.drifts,
    })
}

/// Returns the settings of a source without those that concern the plausibility of its poses, which no source reads.
pub(crate) fn without(settings: &Settings) -> Settings {
    let mut rest = settings.clone();
    rest.table.retain(|key, _| !is_field(key));
    if let Some(toml::Value::Table(robots)) = rest.table.get_mut("robot") {
        let own = robots.iter_mut().filter_map(|(_, own)| own.as_table_mut());
        own.for_each(|own| own.retain(|key, _| !is_field(key)));
    }
    rest
}

/// What may be assumed of the newest reading of a source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Whether the pose continues earlier ones by dead reckoning, such as odometry. After a jump nobody but a person
    /// knows where the robot is.
    pub reckoned: bool,
    /// Whether dead reckoning is at its origin: where it is after a restart.
    pub at_origin: bool,
    /// Whether the velocity is measured by itself, as by a satellite receiver, and not computed from positions.
    pub moves_as_measured: bool,
    /// Standard deviation of the position, where the reading has none \[m\].
    pub position_m: f64,
    /// Standard deviation of the heading, where the reading has none \[rad\].
    pub heading_rad: f64,
}

impl Quality {
    /// Absolute poses from a sensor that states no accuracy: 2 cm and 0.02 rad, those of a camera that sees a marker.
    pub const MEASURED: Quality =
        Quality { reckoned: false, at_origin: false, moves_as_measured: false, position_m: 0.02, heading_rad: 0.02 };
    /// Dead reckoning, such as odometry: two poses in a row differ by little more than the resolution of encoders.
    pub const RECKONED: Quality =
        Quality { reckoned: true, position_m: LEAST.0, heading_rad: LEAST.1, ..Quality::MEASURED };
}

/// Measured pose with its time and its standard deviations.
#[derive(Clone, Copy, Debug)]
pub struct Fix {
    /// Time of arrival.
    pub(crate) at: Time,
    /// Time of measurement on the source's clock \[ns\].
    stamp_ns: u64,
    /// Position \[m\].
    pub(crate) position: [f64; 2],
    /// Heading \[rad\] with the time at which it arrived; `None` if none was measured yet.
    heading: Option<(Time, f64)>,
    position_m: f64,
    heading_rad: f64,
    /// Speed of the reading \[m/s\].
    twist_m_s: f64,
    quality: Quality,
}

impl Fix {
    /// Returns the pose of a reading that has arrived at time `now`.
    pub fn of(now: Time, reading: &Reading, quality: Quality) -> Fix {
        let Deviation { position_m, heading_rad, .. } = reading.deviation;
        let most = if quality.reckoned { MOST_RECKONED } else { (f64::INFINITY, f64::INFINITY) };
        let position_m = position_m.map_or(quality.position_m, f64::from).max(LEAST.0).min(most.0);
        let heading_rad = heading_rad.map_or(quality.heading_rad, f64::from).max(LEAST.1).min(most.1);
        let [x, y] = reading.pose.position.to_array();
        Fix {
            at: now,
            stamp_ns: reading.stamp_ns,
            position: [f64::from(x), f64::from(y)],
            heading: reading.pose.heading.map(|heading| (now, f64::from(heading))),
            position_m,
            heading_rad,
            twist_m_s: f64::from(reading.twist.velocity.norm()),
            quality,
        }
    }

    /// Returns whether the pose is one of dead reckoning.
    pub(crate) fn is_reckoned(&self) -> bool {
        self.quality.reckoned
    }

    /// Returns this pose moved to `pose`, as a person has said.
    pub(crate) fn placed(self, now: Time, pose: &Pose) -> Fix {
        let heading = pose.heading.map(|heading| (now, f64::from(heading))).or(self.heading);
        Fix { at: now, position: [f64::from(pose.position.x), f64::from(pose.position.y)], heading, ..self }
    }

    /// Returns the pose as a message has it.
    pub(crate) fn pose(&self) -> Pose {
        let [x, y] = self.position;
        Pose { position: Vec2::new(x as f32, y as f32), heading: self.heading.map(|(_, heading)| heading as f32) }
    }

    /// Returns the distance to the position of `other` \[m\].
    pub(crate) fn distance(&self, other: &Fix) -> f64 {
        libm::hypot(self.position[0] - other.position[0], self.position[1] - other.position[1])
    }

    /// Returns the angle to the heading of `other` \[rad\], from 0 to pi; `None` if one has no heading.
    pub(crate) fn turn(&self, other: &Fix) -> Option<f64> {
        let ((_, own), (_, other)) = self.heading.zip(other.heading)?;
        Some(wrapped(own - other).abs())
    }

    /// Returns `SIGMAS` standard deviations of the difference of two positions \[m\].
    pub(crate) fn noise_m(&self, other: &Fix) -> f64 {
        SIGMAS * libm::hypot(self.position_m, other.position_m)
    }

    /// Returns `SIGMAS` standard deviations of the difference of two headings \[rad\].
    pub(crate) fn noise_rad(&self, other: &Fix) -> f64 {
        SIGMAS * libm::hypot(self.heading_rad, other.heading_rad)
    }

    /// Returns whether the speed of the reading is measured by itself, and not the difference of noisy positions.
    pub(crate) fn has_speed(&self) -> bool {
        self.quality.reckoned || self.quality.moves_as_measured
    }

    /// Returns a distance that also grows with the angle between two poses \[m\].
    fn apart(&self, other: &Fix) -> f64 {
        self.distance(other) + TURN_M * self.turn(other).unwrap_or(0.0)
    }

    /// Returns the time from the measurement of `self` to that of the later pose `to` \[s\]: by the clock of the
    /// source, unless it was set meanwhile.
    fn elapsed_s(&self, to: &Fix) -> f64 {
        let arrived_s = to.at.since(self.at).as_secs();
        let stamped_s = to.stamp_ns.saturating_sub(self.stamp_ns) as f64 * 1e-9;
        if stamped_s > 0.0 && stamped_s <= arrived_s + LATE_S { stamped_s } else { arrived_s }
    }

    /// Returns whether the later pose `to` is of the same kind and of one motion with `self`.
    pub(crate) fn agrees_with(&self, to: &Fix, limits: &Limits) -> bool {
        let one_kind = self.quality.reckoned == to.quality.reckoned;
        one_kind && to.at.since(self.at) <= ONE_MOTION && self.reaches(to, limits)
    }

    /// Returns whether a robot that was at `self` when it was stopped is at `later`: whatever has put its source wrong
    /// is undone.
    fn has_stopped_at(&self, later: &Fix) -> bool {
        let braking_m = (BACK.0 + STOPPED_S * self.twist_m_s).min(BACK.1);
        let turned = self.turn(later).is_none_or(|turn| turn <= BACK.1 + SIGMAS * self.heading_rad);
        self.distance(later) <= braking_m + self.noise_m(later) && turned
    }

    /// Returns whether a robot within `limits` can have driven from `self` to the later pose `to`.
    pub fn reaches(&self, to: &Fix, limits: &Limits) -> bool {
        let elapsed_s = self.elapsed_s(to);
        let reckoned = self.quality.reckoned && to.quality.reckoned;
        let silent = reckoned && elapsed_s.min(to.at.since(self.at).as_secs()) > REACH_S + 0.05;
        let moving_s = elapsed_s.min(if silent { STOPPED_S } else { REACH_S });
        let measured = self.quality.moves_as_measured && to.quality.moves_as_measured;
        let measured_m =
            self.twist_m_s.max(to.twist_m_s) * MARGIN * elapsed_s.min(if measured { DRIVEN_S } else { 0.0 });
        if self.distance(to) > self.noise_m(to) + (limits.speed_m_s * moving_s).max(measured_m) {
            return false;
        }
        if reckoned && to.quality.at_origin && elapsed_s > RESTARTED_S && self.apart(to) > self.noise_m(to) {
            return false;
        }
        let Some((((before, _), (after, _)), turn)) = self.heading.zip(to.heading).zip(self.turn(to)) else {
            return true;
        };
        // A heading may be older than its pose: not every reading has one.
        let turning_s = moving_s.max(after.since(before).as_secs().min(REACH_S));
        let turning_s = if silent { moving_s } else { turning_s };
        turn <= self.noise_rad(to) + limits.yaw_rate_rad_s * turning_s
    }
}

/// Poses in a row that are refused, because they are out of reach of the last accepted one.
#[derive(Clone, Copy, Debug)]
struct Held {
    first: Fix,
    /// Arrival of the first one since which each is in reach of the one before it.
    agree_since: Time,
    newest: Fix,
}

/// What becomes of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Plausibility {
    /// It is accepted: the robot can have driven there.
    Accepted,
    /// It is accepted after a jump: poses have agreed with each other for long enough.
    Settled,
    /// It is refused.
    Refused,
}

/// Poses of one robot: the last accepted one, and those that are refused.
#[derive(Clone, Debug, Default)]
pub(super) struct Track {
    accepted: Option<Fix>,
    held: Option<Held>,
    lost: Option<Whereabouts>,
}

impl Track {
    /// Returns whether the robot's pose is known.
    pub(crate) fn whereabouts(&self) -> Whereabouts {
        self.lost.unwrap_or(Whereabouts::Known)
    }

    /// Returns the last accepted pose; `None` before the first, and after the source has lost the robot.
    pub(crate) fn accepted(&self) -> Option<&Fix> {
        self.accepted.as_ref()
    }

    /// Returns the first of the poses that are refused in a row; `None` while none is.
    pub(crate) fn refused(&self) -> Option<&Fix> {
        self.held.as_ref().map(|held| &held.first)
    }

    /// Judges a new pose of the robot.
    pub(crate) fn take(&mut self, fix: Fix, limits: &Limits) -> Plausibility {
        let Some(accepted) = self.accepted else {
            self.accept(fix);
            return Plausibility::Accepted;
        };
        let is_nearer = |held: Held| accepted.apart(&fix) <= held.newest.apart(&fix);
        if self.lost.is_none() && self.held.is_none_or(is_nearer) && accepted.reaches(&fix, limits) {
            self.accept(fix);
            return Plausibility::Accepted;
        }
        let held = match self.held {
            Some(held) if held.newest.agrees_with(&fix, limits) => Held { newest: fix, ..held },
            Some(held) => Held { newest: fix, agree_since: fix.at, ..held },
            None => Held { first: fix, agree_since: fix.at, newest: fix },
        };
        self.held = Some(held);
        if self.lost.is_none() && fix.at.since(held.first.at) >= DOUBT {
            self.lost = Some(if fix.quality.reckoned { Whereabouts::Adrift } else { Whereabouts::Jumped });
        }
        let settled = fix.at.since(held.agree_since) >= limits.settle && !fix.quality.reckoned;
        // Absolute poses that agree end dead reckoning, too, such as that of a receiver under a bridge.
        let person = matches!(self.lost, Some(Whereabouts::Shifted | Whereabouts::Exchanged));
        if self.lost.is_some() && settled && (!person || accepted.has_stopped_at(&fix)) {
            self.accept(fix);
            return Plausibility::Settled;
        }
        Plausibility::Refused
    }

    fn accept(&mut self, fix: Fix) {
        let before = self.accepted.and_then(|accepted| accepted.heading).filter(|_| self.lost.is_none());
        self.accepted = Some(Fix { heading: fix.heading.or(before), ..fix });
        (self.held, self.lost) = (None, None);
    }

    /// Judges a new pose of dead reckoning of which only the increments count. After a jump its poses are accepted
    /// again once they have agreed with each other for the time `settle`.
    pub(crate) fn reckon(&mut self, fix: Fix, limits: &Limits, settle: Span) -> Plausibility {
        let judgement = self.take(fix, limits);
        let settled = self.held.is_some_and(|held| fix.at.since(held.agree_since) >= settle);
        if judgement == Plausibility::Refused && settled {
            self.place(fix);
            return Plausibility::Settled;
        }
        judgement
    }

    /// Takes a pose over without judging it: a person has said where the robot is.
    pub(crate) fn place(&mut self, fix: Fix) {
        self.lost = None;
        self.accept(fix);
    }

    /// Changes why a lost robot is lost.
    pub(crate) fn blame(&mut self, why: Whereabouts) {
        if self.lost.is_some() {
            self.lost = Some(why);
        }
    }

    /// Marks the robot as lost by its source, whose next reading is accepted wherever it is.
    pub(crate) fn lose(&mut self, why: Whereabouts) {
        (self.accepted, self.held, self.lost) = (None, None, Some(why));
    }
}
