//! Chassis: the way a robot moves. It turns a velocity of the world frame into a motion of the robot in its own frame.
//!
//! A policy commands the velocity of a point. A *holonomic* chassis moves its centre at any velocity. A *differential*
//! one cannot move sideways, so a point ahead of its axle is commanded and reported. With `d` metres between them, the
//! velocity `v` of the point and the heading `h`, the robot drives forward at `v . h` and turns at `(h x v) / d`
//! (feedback linearisation, as in Siciliano et al., Robotics, 2009, section 11.6.1).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::config::ConfigError;
use crate::flight::{self, InAir};
use crate::messages::geometry::{Motion, Planar, Pose, Vec2, limit_below, toward_zero, wrapped};
use crate::messages::local::{BodyTwist, Sample};
use crate::messages::wire::Reading;
use crate::time::Span;

/// Gain of the yaw rate that holds a heading \[1/s\]: an error of 0.1 rad is reduced to a third in half a second.
const HEADING_GAIN: f32 = 2.0;

/// Kind of a robot's chassis, by the directions in which it can move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DriveKind {
    /// The robot can move in every direction without turning: mecanum or omnidirectional wheels, or a drone.
    Holonomic,
    /// The robot has two driven wheels on one axle and cannot move sideways.
    Differential,
}

/// Whether a holonomic robot controls its heading while it follows a velocity command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HeadingMode {
    /// The robot turns to the heading that the setting `heading_rad` gives, and keeps it.
    Hold,
    /// The robot's heading is not controlled: the commanded yaw rate is zero.
    Free,
}

/// Settings of a robot's chassis in a deployment. A value left out (`None`) is taken from the settings for all robots,
/// then from [`Chassis::default`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Kind of the chassis, holonomic or differential; `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drive: Option<DriveKind>,
    /// Distance \[m\] from the axle of a differential drive forward to the point whose velocity the policy commands;
    /// `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub point_ahead_m: Option<f32>,
    /// Whether a holonomic robot holds a heading or leaves it free; `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heading: Option<HeadingMode>,
    /// Heading that a holonomic robot holds \[rad\], counter-clockwise from the x axis of the world frame; `None` if
    /// left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heading_rad: Option<f32>,
    /// Largest speed of the robot's centre \[m/s\]; `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_m_s: Option<f32>,
    /// Largest yaw rate of the robot \[rad/s\]; `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub yaw_rate_rad_s: Option<f32>,
    /// Largest speed of each wheel of a differential drive along the ground \[m/s\]; `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wheel_speed_m_s: Option<f32>,
    /// Distance between the left and right wheels of a differential drive \[m\]; `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub track_m: Option<f32>,
    /// Age of the last measured heading at which the robot has to stand still \[s\]; `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heading_age_s: Option<f64>,
    /// Charge of the battery, 0 to 1, at which the robot has to stand still; `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub battery_least: Option<f32>,
    /// Temperature of the hardware \[°C\] at which the robot has to stand still; `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_most_c: Option<f32>,
    /// Height above the ground at which the robot flies \[m\], the same for all episodes; `None` for a robot that stays
    /// on the ground.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height_m: Option<f32>,
    /// Action of a robot that flies after an emergency stop, once it has hovered for a second; `None` if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stop_in_air: Option<InAir>,
}

/// Kind of a robot's chassis and the limits of its motion, used to turn a commanded velocity into a motion of the
/// robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chassis {
    /// Kind of the chassis, holonomic or differential.
    pub drive: DriveKind,
    /// Distance \[m\] from the robot's centre forward to the point whose velocity the policy commands; 0 for a
    /// holonomic chassis.
    pub point_ahead_m: f32,
    /// Heading that a holonomic robot holds \[rad\], counter-clockwise from the x axis of the world frame. `None` if
    /// the heading is not controlled.
    pub(crate) held_rad: Option<f32>,
    /// Largest speed of the robot's centre \[m/s\]; infinite if not limited.
    pub speed_m_s: f32,
    /// Largest yaw rate of the robot \[rad/s\]; infinite if not limited.
    pub yaw_rate_rad_s: f32,
    /// Largest speed of a wheel along the ground \[m/s\] and distance between the two wheels \[m\], which is not below
    /// the decimal that was written. `None` if wheel speeds are not limited.
    pub wheels: Option<(f32, f32)>,
    /// Age of the last measured heading at which the robot has to stand still.
    pub(crate) heading_age: Span,
}

impl Default for Chassis {
    /// Returns a holonomic chassis that does not control its heading and has no limits of speed. A measured heading may
    /// be up to 100 ms old.
    fn default() -> Chassis {
        Chassis {
            drive: DriveKind::Holonomic,
            point_ahead_m: 0.0,
            held_rad: None,
            speed_m_s: f32::INFINITY,
            yaw_rate_rad_s: f32::INFINITY,
            wheels: None,
            heading_age: Span::from_millis(100),
        }
    }
}

impl Settings {
    /// Whether all settings are left out (`None`).
    pub fn is_empty(&self) -> bool {
        *self == Settings::default()
    }

    /// Returns the settings of one robot (`self`), with left-out values taken from `all`, the settings for all robots.
    pub fn or(&self, all: &Settings) -> Settings {
        Settings {
            drive: self.drive.or(all.drive),
            point_ahead_m: self.point_ahead_m.or(all.point_ahead_m),
            heading: self.heading.or(all.heading),
            heading_rad: self.heading_rad.or(all.heading_rad),
            speed_m_s: self.speed_m_s.or(all.speed_m_s),
            yaw_rate_rad_s: self.yaw_rate_rad_s.or(all.yaw_rate_rad_s),
            wheel_speed_m_s: self.wheel_speed_m_s.or(all.wheel_speed_m_s),
            track_m: self.track_m.or(all.track_m),
            heading_age_s: self.heading_age_s.or(all.heading_age_s),
            battery_least: self.battery_least.or(all.battery_least),
            temperature_most_c: self.temperature_most_c.or(all.temperature_most_c),
            height_m: self.height_m.or(all.height_m),
            stop_in_air: self.stop_in_air.or(all.stop_in_air),
        }
    }

    /// Returns the settings of the robot's flight; `None` for a robot that stays on the ground. An error names the
    /// setting that is wrong.
    pub fn flight(&self) -> Result<Option<flight::Settings>, ConfigError> {
        match (self.height_m, self.stop_in_air) {
            (Some(height_m), stop) if height_m > 0.0 && height_m <= flight::MOST_M => {
                Ok(Some(flight::Settings { height_m, stop: stop.unwrap_or_default() }))
            }
            (Some(height_m), _) => {
                let why = format!("{height_m} is no height above 0 and up to {} m", flight::MOST_M);
                Err(ConfigError::field("height_m", why))
            }
            (None, Some(_)) => {
                Err(ConfigError::field("stop_in_air", "it is for robots that fly: say height_m".to_owned()))
            }
            (None, None) => Ok(None),
        }
    }

    /// Checks the settings and makes a [`Chassis`] from them. The error names the setting that is wrong or missing.
    pub fn chassis(&self) -> Result<Chassis, ConfigError> {
        let wrong = |field: &str, why: &str| Err(ConfigError::field(field, why.to_owned()));
        for (field, value) in [
            ("point_ahead_m", self.point_ahead_m),
            ("speed_m_s", self.speed_m_s),
            ("yaw_rate_rad_s", self.yaw_rate_rad_s),
            ("wheel_speed_m_s", self.wheel_speed_m_s),
            ("track_m", self.track_m),
        ] {
            if value.is_some_and(|value| value.is_nan() || value <= 0.0) {
                return wrong(field, "it is not above zero");
            }
        }
        if self.heading_age_s.is_some_and(|age| !(0.001..=10.0).contains(&age)) {
            return wrong("heading_age_s", "it is not 0.001 to 10 s");
        }
        if self.heading_rad.is_some_and(|heading| !(-7.0..=7.0).contains(&heading)) {
            return wrong("heading_rad", "it is not an angle in radians, -7 to 7");
        }
        let drive = self.drive.unwrap_or(DriveKind::Holonomic);
        let [of_wheels, of_heading] = [
            [("point_ahead_m", self.point_ahead_m.is_some()), ("wheel_speed_m_s", self.wheel_speed_m_s.is_some())],
            [("heading", self.heading.is_some()), ("heading_rad", self.heading_rad.is_some())],
        ];
        let (foreign, other) = match drive {
            DriveKind::Holonomic => {
                (of_wheels, "of a differential drive; write drive = \"differential\", or leave it out")
            }
            DriveKind::Differential => {
                (of_heading, "of a holonomic drive; a differential one turns to where it drives")
            }
        };
        if let Some((field, _)) = foreign.iter().find(|(_, given)| *given) {
            return wrong(field, &format!("it is a setting {other}"));
        }
        let default = Chassis::default();
        let point_ahead_m = match (drive, self.point_ahead_m) {
            (DriveKind::Holonomic, _) => 0.0,
            (DriveKind::Differential, Some(ahead)) => ahead,
            (DriveKind::Differential, None) => {
                return wrong(
                    "point_ahead_m",
                    "missing: a differential drive is commanded by a point ahead of its axle",
                );
            }
        };
        let wheels = match (self.wheel_speed_m_s, self.track_m) {
            (Some(speed), Some(track)) => Some((speed, track)),
            (None, None) => None,
            (Some(_), None) => {
                return wrong("track_m", "missing: wheel_speed_m_s needs the distance between the wheels");
            }
            (None, Some(_)) => return wrong("wheel_speed_m_s", "missing: track_m is for limits of the wheels' speeds"),
        };
        let held = drive == DriveKind::Holonomic && self.heading.unwrap_or(HeadingMode::Free) == HeadingMode::Hold;
        Ok(Chassis {
            drive,
            point_ahead_m,
            held_rad: held.then(|| self.heading_rad.unwrap_or(0.0)),
            speed_m_s: limit_below(self.speed_m_s.unwrap_or(default.speed_m_s)),
            yaw_rate_rad_s: limit_below(self.yaw_rate_rad_s.unwrap_or(default.yaw_rate_rad_s)),
            wheels: wheels.map(|(speed_m_s, track_m)| (limit_below(speed_m_s), track_m.next_up())),
            heading_age: self.heading_age_s.map_or(default.heading_age, Span::from_secs),
        })
    }
}

impl Chassis {
    /// Returns the motion in the robot's own frame, within the limits of the chassis, with which its commanded point
    /// moves at `velocity` \[m/s\], world frame. `heading` is the robot's heading \[rad\]. Returns `None` if the
    /// heading is unknown and the velocity is not zero; then the robot has to stand.
    pub fn twist(&self, velocity: Vec2, heading: Option<f32>) -> Option<BodyTwist> {
        if velocity == Vec2::zeros() {
            return Some(BodyTwist::default());
        }
        let heading = heading?;
        let own = Pose { position: Vec2::zeros(), heading: Some(heading) }.in_body_frame(velocity)?;
        Some(self.limit(match self.drive {
            DriveKind::Holonomic => {
                let turn = |held: f32| HEADING_GAIN * wrapped(f64::from(held - heading)) as f32;
                BodyTwist { forward: own.x, left: own.y, yaw_rate: self.held_rad.map_or(0.0, turn) }
            }
            DriveKind::Differential => BodyTwist { forward: own.x, left: 0.0, yaw_rate: own.y / self.point_ahead_m },
        }))
    }

    /// Returns a motion reduced to the limits of the chassis, which hold for the result as it is rounded. On a
    /// differential drive, forward speed and yaw rate are reduced by the same factor, so that the robot follows the
    /// same curve.
    fn limit(&self, twist: BodyTwist) -> BodyTwist {
        let BodyTwist { forward, left, yaw_rate } = twist;
        match self.drive {
            DriveKind::Holonomic => {
                let speed = Vec2::new(forward, left).capped(self.speed_m_s);
                let yaw_rate = yaw_rate.clamp(-self.yaw_rate_rad_s, self.yaw_rate_rad_s);
                BodyTwist { forward: speed.x, left: speed.y, yaw_rate }
            }
            DriveKind::Differential => {
                let all = self.share(forward, yaw_rate);
                let (mut forward, mut yaw_rate) = (forward * all, yaw_rate * all);
                while !self.holds(forward.abs().into(), yaw_rate) {
                    (forward, yaw_rate) = (toward_zero(forward), toward_zero(yaw_rate));
                }
                BodyTwist { forward, left: 0.0, yaw_rate }
            }
        }
    }

    /// Returns whether the limits of a differential drive hold exactly for a motion with the speed `forward` \[m/s\],
    /// zero or above, and `yaw_rate` \[rad/s\]; true if one of them is not a number.
    fn holds(&self, forward: f64, yaw_rate: f32) -> bool {
        let yaw_rate = f64::from(yaw_rate).abs();
        let wheel_is_faster =
            self.wheels.is_some_and(|(most, track_m)| forward + yaw_rate * f64::from(track_m) / 2.0 > f64::from(most));
        !(forward > f64::from(self.speed_m_s) || yaw_rate > f64::from(self.yaw_rate_rad_s) || wheel_is_faster)
    }

    /// Returns a motion of a differential drive that is within its limits but for a few millionths, within them:
    /// `velocity` of its centre \[m/s\], world frame, and `yaw_rate` \[rad/s\].
    pub fn settled(&self, velocity: Vec2, yaw_rate: f32) -> (Vec2, f32) {
        let holds = |velocity: Vec2, yaw_rate| self.holds(libm::hypot(velocity.x.into(), velocity.y.into()), yaw_rate);
        if holds(velocity, yaw_rate) {
            return (velocity, yaw_rate);
        }
        let all = self.share(velocity.norm(), yaw_rate);
        let (mut velocity, mut yaw_rate) = (velocity * all, yaw_rate * all);
        while !holds(velocity, yaw_rate) {
            (velocity, yaw_rate) = (velocity.map(toward_zero), toward_zero(yaw_rate));
        }
        (velocity, yaw_rate)
    }

    /// Returns the factor, up to 1, that reduces a motion of a differential drive to its limits: `forward` is its speed
    /// \[m/s\], `yaw_rate` in \[rad/s\].
    fn share(&self, forward: f32, yaw_rate: f32) -> f32 {
        let share = |value: f32, most: f32| if value.abs() > most { most / value.abs() } else { 1.0 };
        let of_wheels =
            self.wheels.map_or(1.0, |(most, track_m)| share(forward.abs() + yaw_rate.abs() * track_m / 2.0, most));
        share(forward, self.speed_m_s).min(share(yaw_rate, self.yaw_rate_rad_s)).min(of_wheels)
    }

    /// Returns the velocity \[m/s\] of the commanded point that the chassis can carry out at `heading` \[rad\]. It has
    /// the direction of the wanted `velocity` and is reduced to the limits; both are in the world frame.
    pub fn limited(&self, velocity: Vec2, heading: f32) -> Vec2 {
        match self.drive {
            DriveKind::Holonomic => velocity.capped(self.speed_m_s),
            DriveKind::Differential => {
                let (sin, cos) = libm::sincosf(heading);
                let (forward, left) = (cos * velocity.x + sin * velocity.y, cos * velocity.y - sin * velocity.x);
                velocity * self.share(forward, left / self.point_ahead_m)
            }
        }
    }

    /// Converts a reading of the robot's centre into a reading of the point that policies command. Returns `None` if
    /// that point is ahead of the centre and the reading has no heading.
    pub fn point(&self, centre: Reading) -> Option<Reading> {
        if self.point_ahead_m == 0.0 {
            return Some(centre);
        }
        let heading = centre.pose.heading?;
        let point = self.point_motion(&centre.motion(), heading, centre.twist.yaw_rate.unwrap_or(0.0));
        let mut reading = centre;
        (reading.pose.position, reading.twist.velocity) = (point.position, point.velocity);
        Some(reading)
    }

    /// Returns position and velocity of the point that policies command, in the world frame. `centre` is the motion of
    /// the robot's centre, with `heading` \[rad\] and `yaw_rate` \[rad/s\].
    pub fn point_motion(&self, centre: &Motion, heading: f32, yaw_rate: f32) -> Motion {
        if self.point_ahead_m == 0.0 {
            return *centre;
        }
        let ahead = self.ahead(heading);
        let turning = Vec2::new(-ahead.y, ahead.x) * yaw_rate;
        Motion { position: centre.position + ahead, velocity: centre.velocity + turning }
    }

    /// Returns the position \[m\], world frame, of the point that policies command, from the true state `sample` of a
    /// simulated robot.
    pub fn point_of(&self, sample: &Sample) -> Vec2 {
        self.point_motion(&sample.motion, sample.heading, sample.yaw_rate).position
    }

    /// Returns the position of the robot's centre \[m\], world frame, from a reading of the point that policies
    /// command. Without a heading, returns the position of that point.
    pub fn centre(&self, reading: &Reading) -> Vec2 {
        match reading.pose.heading {
            Some(heading) if self.point_ahead_m > 0.0 => reading.pose.position - self.ahead(heading),
            _ => reading.pose.position,
        }
    }

    /// Returns the vector \[m\] in the world frame from the robot's centre to the point that policies command, at
    /// `heading` \[rad\].
    pub fn ahead(&self, heading: f32) -> Vec2 {
        let (sin, cos) = libm::sincosf(heading);
        Vec2::new(cos, sin) * self.point_ahead_m
    }
}

/// Chassis settings of single robots that differ from those for all robots. A key is the robot's number as text, as in
/// a TOML table.
pub(crate) type ByRobot = BTreeMap<String, Settings>;

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;

    use super::*;
    use crate::messages::ids::RobotId;

    fn differential() -> Settings {
        Settings { drive: Some(DriveKind::Differential), point_ahead_m: Some(0.1), ..Settings::default() }
    }

    /// Moves a pose for a millisecond.
    fn moved(pose: Pose, twist: BodyTwist) -> Pose {
        let heading = pose.heading.unwrap();
        let (sin, cos) = heading.sin_cos();
        let velocity = Vec2::new(cos * twist.forward - sin * twist.left, sin * twist.forward + cos * twist.left);
        Pose {
            position: pose.position + velocity * 1e-3,
            heading: Some(wrapped(f64::from(heading + twist.yaw_rate * 1e-3)) as f32),
        }
    }

    fn reading(pose: Pose) -> Reading {
        let mut reading = Reading::of_point(RobotId(0), 1, Motion::at_rest(pose.position));
        reading.pose = pose;
        reading
    }

    #[test]
    fn the_point_ahead_of_a_differential_drive_moves_as_commanded_in_every_direction() {
        let chassis = differential().chassis().unwrap();
        for direction in [0.0_f32, 0.7, FRAC_PI_2, 3.0, -2.0] {
            let wanted = Vec2::new(direction.cos(), direction.sin()) * 0.2;
            let mut pose = Pose { position: Vec2::zeros(), heading: Some(0.0) };
            for _ in 0..100 {
                let before = chassis.point(reading(pose)).unwrap();
                pose = moved(pose, chassis.twist(wanted, pose.heading).unwrap());
                let after = chassis.point(reading(pose)).unwrap();
                let velocity = (after.pose.position - before.pose.position) / 1e-3;
                assert!((velocity - wanted).norm() < 2e-3, "{velocity:?} for {wanted:?}");
                assert!((chassis.centre(&after) - pose.position).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn limits_keep_the_curve_of_a_differential_drive_and_the_direction_of_a_holonomic_one() {
        let settings = Settings { wheel_speed_m_s: Some(0.3), track_m: Some(0.2), ..differential() };
        let twist = settings.chassis().unwrap().twist(Vec2::new(0.3, 0.4), Some(0.0)).unwrap();
        assert!((twist.forward.abs() + twist.yaw_rate.abs() * 0.1 - 0.3).abs() < 1e-6, "{twist:?}");
        assert!((twist.yaw_rate / twist.forward - 4.0 / 0.3).abs() < 1e-4, "{twist:?}");
        let slow = Settings { speed_m_s: Some(0.5), ..Settings::default() }.chassis().unwrap();
        let twist = slow.twist(Vec2::new(3.0, 4.0), Some(FRAC_PI_2)).unwrap();
        assert!((twist.forward - 0.4).abs() < 1e-6 && (twist.left + 0.3).abs() < 1e-6, "{twist:?}");
    }

    #[test]
    fn without_a_heading_a_robot_stands_and_a_held_one_is_turned_back_by_the_shorter_way() {
        let free = Chassis::default();
        assert_eq!(free.twist(Vec2::x(), None), None);
        assert_eq!(free.twist(Vec2::zeros(), None), Some(BodyTwist::default()), "to stand needs no heading");
        let held = Settings { heading: Some(HeadingMode::Hold), heading_rad: Some(3.0), ..Settings::default() };
        let twist = held.chassis().unwrap().twist(Vec2::x(), Some(-3.0)).unwrap();
        assert!(twist.yaw_rate < 0.0 && twist.yaw_rate > -1.0, "{twist:?}");
        assert_eq!(differential().chassis().unwrap().point(Reading::of_point(RobotId(0), 1, Motion::default())), None);
    }

    #[test]
    fn settings_that_do_not_fit_together_are_refused_by_name() {
        let refused = |settings: Settings| settings.chassis().unwrap_err().to_string();
        let of_drive = |drive| Settings { drive: Some(drive), ..Settings::default() };
        assert!(refused(of_drive(DriveKind::Differential)).contains("point_ahead_m"));
        assert!(refused(Settings { point_ahead_m: Some(0.1), ..Settings::default() }).contains("differential"));
        assert!(refused(Settings { heading_rad: Some(0.1), ..differential() }).contains("heading_rad"));
        assert!(refused(Settings { wheel_speed_m_s: Some(0.3), ..differential() }).contains("track_m"));
        assert!(refused(Settings { speed_m_s: Some(-1.0), ..Settings::default() }).contains("speed_m_s"));
        assert!(refused(Settings { heading_age_s: Some(60.0), ..Settings::default() }).contains("heading_age_s"));
        let all = Settings { speed_m_s: Some(0.3), ..differential() };
        let one = Settings { speed_m_s: Some(0.2), ..Settings::default() }.or(&all).chassis().unwrap();
        assert_eq!((one.drive, one.speed_m_s), (DriveKind::Differential, limit_below(0.2)));
    }

    #[test]
    fn limits_hold_after_rounding_for_whoever_reads_them_as_decimals() {
        use rand::RngExt;
        let mut stream = crate::random::Seed::of_run(2).stream("limits");
        for case in 0..40_000 {
            let mut of = |least: u16, most: u16| f64::from(stream.random_range(least..=most)) / 100.0;
            // Decimals as in a file: 0.2 m/s and the like.
            let (speed, yaw, wheel, track) = (of(5, 100), of(50, 400), of(5, 100), of(5, 60));
            let settings = Settings {
                wheel_speed_m_s: Some(wheel as f32),
                track_m: Some(track as f32),
                speed_m_s: Some(speed as f32),
                yaw_rate_rad_s: Some(yaw as f32),
                ..differential()
            };
            let chassis = settings.chassis().unwrap();
            let mut axis = || stream.random_range(-3.0..3.0f32);
            let (velocity, heading) = (Vec2::new(axis(), axis()), axis());
            let BodyTwist { forward, yaw_rate, .. } = chassis.twist(velocity, Some(heading)).unwrap();
            let (forward, yaw_rate) = (f64::from(forward).abs(), f64::from(yaw_rate).abs());
            let outer = forward + yaw_rate * track / 2.0;
            assert!(forward <= speed && yaw_rate <= yaw && outer <= wheel, "case {case}: {settings:?}, {velocity:?}");
            let holonomic = Settings { speed_m_s: Some(speed as f32), ..Settings::default() }.chassis().unwrap();
            let BodyTwist { forward, left, .. } = holonomic.twist(velocity, Some(heading)).unwrap();
            assert!(libm::hypot(forward.into(), left.into()) <= speed, "case {case}: {velocity:?}");
            let limited = holonomic.limited(velocity, heading);
            assert!(libm::hypot(limited.x.into(), limited.y.into()) <= speed, "case {case}: {velocity:?}");
        }
    }
}
