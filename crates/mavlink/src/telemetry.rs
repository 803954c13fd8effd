//! Telemetry of an autopilot: its attitude, its battery, its clock since it was switched on, and what is made of its
//! positions.

use mavlink::dialects::common::{
    ATTITUDE_DATA, BATTERY_STATUS_DATA, GLOBAL_POSITION_INT_DATA, LOCAL_POSITION_NED_DATA, SYS_STATUS_DATA,
};
use murmurate::edge::sender_clock::{Novelty, SenderClock};
use murmurate::localization::geodesy::Geodetic;
use murmurate::messages::geometry::{Deviation, Pose, Twist, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;
use murmurate::time::{Span, Time};

use super::axes::{Axes, NorthEast, turned_over};

/// Largest age of an attitude that is the heading of a position: three of them at 10 Hz.
const ATTITUDE: Span = Span::from_millis(300);
/// Number of older stamps in a row that show a clock that was set back: datagrams may overtake each other.
const OVERTAKEN: u32 = 3;
/// Step back of the time since switching on, in milliseconds, that only a restart makes.
const RESTART_MS: u32 = 2000;

/// Attitudes and stamps of one autopilot.
#[derive(Clone, Debug)]
pub struct Telemetry {
    robot: RobotId,
    axes: Axes,
    /// Newest attitude, with its arrival; `None` before the first.
    attitude: Option<(Time, ATTITUDE_DATA)>,
    clock: SenderClock,
    /// Newest time since switching on \[ms\]; `None` before the first.
    boot_ms: Option<u32>,
}

impl Telemetry {
    /// Makes the telemetry of a robot that has sent nothing. What is made of it is in the axes `axes`.
    pub fn new(robot: RobotId, axes: Axes) -> Telemetry {
        Telemetry { robot, axes, attitude: None, clock: SenderClock::new(OVERTAKEN), boot_ms: None }
    }

    /// Takes the time since the autopilot was switched on \[ms\]. Returns whether it has begun anew since the last one.
    pub fn restarted(&mut self, boot_ms: u32) -> bool {
        let before = self.boot_ms.replace(boot_ms);
        let restarted = before.is_some_and(|before| before.saturating_sub(boot_ms) >= RESTART_MS);
        if restarted {
            (self.attitude, self.clock) = (None, SenderClock::new(OVERTAKEN));
        }
        restarted
    }

    /// Takes an attitude. The error is the reason for which it is refused.
    pub fn attitude(&mut self, now: Time, attitude: &ATTITUDE_DATA) -> Result<(), &'static str> {
        if !(attitude.yaw.is_finite() && attitude.yawspeed.is_finite() && attitude.yaw.abs() <= 7.0) {
            return Err("an ATTITUDE has a yaw that is none");
        }
        self.attitude = Some((now, attitude.clone()));
        Ok(())
    }

    /// Returns heading and yaw rate, as far as they are known and not old.
    fn heading(&self, now: Time) -> (Option<f32>, Option<f32>) {
        let fresh = self.attitude.as_ref().filter(|(at, _)| now.since(*at) <= ATTITUDE);
        let heading = fresh.map(|(_, attitude)| self.axes.heading(attitude.yaw.into()) as f32);
        (heading, fresh.map(|(_, attitude)| turned_over(attitude.yawspeed.into()) as f32))
    }

    /// Returns the reading of a place \[m\] and a velocity that were measured `boot_ms` after switching on; `None` if
    /// it is repeated or late. The error is the reason for which it is refused.
    pub fn reading(
        &mut self,
        now: Time,
        boot_ms: u32,
        place: [f64; 2],
        velocity: NorthEast,
    ) -> Result<Option<Reading>, &'static str> {
        let [x, y] = place.map(|m| m as f32);
        let [vx, vy] = self.axes.to_team(velocity).map(|m_s| m_s as f32);
        let (heading, yaw_rate) = self.heading(now);
        let mut reading = Reading {
            robot: self.robot,
            stamp_ns: 0,
            pose: Pose { position: Vec2::new(x, y), heading },
            twist: Twist { velocity: Vec2::new(vx, vy), yaw_rate },
            deviation: Deviation::default(),
        };
        if let Some(why) = reading.unfit() {
            return Err(why);
        }
        match self.clock.take(now, u64::from(boot_ms) * 1_000_000) {
            Novelty::Old => Ok(None),
            Novelty::New(stamp_ns) | Novelty::Anew(stamp_ns) => {
                reading.stamp_ns = stamp_ns;
                Ok(Some(reading))
            }
        }
    }
}

/// Returns the place of a LOCAL_POSITION_NED from the autopilot's origin \[m\], and its velocity \[m/s\].
pub fn local(position: &LOCAL_POSITION_NED_DATA) -> (NorthEast, NorthEast) {
    let of = |north: f32, east: f32| NorthEast { north: north.into(), east: east.into() };
    (of(position.x, position.y), of(position.vx, position.vy))
}

/// Returns the place on the earth of latitude and longitude in units of 1e-7 degrees, and of a height in millimetres
/// above the sea; an error if there is no such place. The sea is taken for the ellipsoid, which moves a place 1 km from
/// the origin by 2 cm where the two differ by 100 m.
pub fn place(latitude: i32, longitude: i32, height_mm: i32) -> Result<Geodetic, &'static str> {
    let [latitude_deg, longitude_deg] = [latitude, longitude].map(|e7| f64::from(e7) * 1e-7);
    if (latitude, longitude) == (0, 0) {
        return Err("its position on the earth is zero, which is unknown");
    }
    if latitude_deg.abs() > 90.0 || longitude_deg.abs() > 180.0 {
        return Err("its position on the earth is none");
    }
    let height_m = f64::from(height_mm) * 1e-3;
    let height_m = if (-1000.0..=20_000.0).contains(&height_m) { height_m } else { 0.0 };
    Ok(Geodetic { latitude_deg, longitude_deg, height_m })
}

/// Returns the velocity of a GLOBAL_POSITION_INT \[m/s\].
pub fn velocity(position: &GLOBAL_POSITION_INT_DATA) -> NorthEast {
    NorthEast { north: f64::from(position.vx) * 0.01, east: f64::from(position.vy) * 0.01 }
}

/// Charge of an autopilot's battery, as its messages say it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Charge {
    /// Charge \[%\] of the first battery by BATTERY_STATUS; `None` before the first that knows it.
    battery: Option<u8>,
    /// Charge \[%\] by SYS_STATUS.
    system: Option<u8>,
}

impl Charge {
    /// Takes the state of a battery. The error is the reason for which it is refused.
    pub fn battery(&mut self, status: &BATTERY_STATUS_DATA) -> Result<(), &'static str> {
        if status.id == 0 {
            self.battery = percent(status.battery_remaining)?;
        }
        Ok(())
    }

    /// Takes the state of the system. The error is the reason for which it is refused.
    pub fn system(&mut self, status: &SYS_STATUS_DATA) -> Result<(), &'static str> {
        self.system = percent(status.battery_remaining)?;
        Ok(())
    }

    /// Returns the charge \[%\]; `None` if it is unknown.
    pub fn percent(&self) -> Option<u8> {
        self.battery.or(self.system)
    }
}

fn percent(remaining: i8) -> Result<Option<u8>, &'static str> {
    match remaining {
        -1 => Ok(None),
        0..=100 => Ok(Some(remaining.unsigned_abs())),
        _ => Err("a battery is neither 0 to 100 % nor unknown"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::FRAC_PI_2;

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn attitude(yaw: f32, yawspeed: f32) -> ATTITUDE_DATA {
        ATTITUDE_DATA { yaw, yawspeed, ..ATTITUDE_DATA::DEFAULT }
    }

    const STILL: NorthEast = NorthEast { north: 0.0, east: 0.0 };

    #[test]
    fn a_heading_is_that_of_the_last_fresh_attitude() {
        let mut telemetry = Telemetry::new(RobotId(2), Axes::default());
        let read = |telemetry: &mut Telemetry, ms: u64| telemetry.reading(at(ms), ms as u32, [1.0, 2.0], STILL);
        let first = read(&mut telemetry, 10).expect("sound").expect("new");
        assert_eq!((first.pose.heading, first.robot, first.stamp_ns), (None, RobotId(2), 10_000_000));
        telemetry.attitude(at(20), &attitude(0.0, 0.5)).expect("sound");
        let second = read(&mut telemetry, 30).expect("sound").expect("new");
        assert!((second.pose.heading.expect("north is along y") - FRAC_PI_2).abs() < 1e-6);
        assert_eq!(second.twist.yaw_rate, Some(-0.5), "clockwise");
        assert_eq!(read(&mut telemetry, 400).expect("sound").expect("new").pose.heading, None, "it is old");
        for (yaw, rate) in [(f32::NAN, 0.0), (90.0, 0.0), (0.0, f32::INFINITY)] {
            telemetry.attitude(at(500), &attitude(yaw, rate)).expect_err("it is none");
        }
    }

    #[test]
    fn a_doubled_a_late_and_an_unsound_position_give_no_reading() {
        let mut telemetry = Telemetry::new(RobotId(0), Axes::default());
        assert!(telemetry.reading(at(0), 100, [0.0; 2], STILL).expect("sound").is_some());
        assert_eq!(telemetry.reading(at(1), 100, [0.0; 2], STILL), Ok(None), "doubled");
        assert_eq!(telemetry.reading(at(2), 90, [0.0; 2], STILL), Ok(None), "late");
        telemetry.reading(at(3), 120, [f64::NAN, 0.0], STILL).expect_err("no place");
        telemetry.reading(at(3), 120, [0.0; 2], NorthEast { north: 1e9, east: 0.0 }).expect_err("no velocity");
        assert!(telemetry.reading(at(4), 120, [0.0; 2], STILL).expect("sound").is_some());
    }

    #[test]
    fn a_clock_that_begins_anew_is_a_restart_and_a_late_message_is_none() {
        let mut telemetry = Telemetry::new(RobotId(0), Axes::default());
        let restarted = [60_000, 60_020, 59_500, 60_040, 100, 120].map(|ms| telemetry.restarted(ms));
        assert_eq!(restarted, [false, false, false, false, true, false]);
    }

    #[test]
    fn a_charge_is_that_of_the_first_battery_and_else_of_the_system() {
        let battery = |id, battery_remaining| BATTERY_STATUS_DATA { id, battery_remaining, ..Default::default() };
        let system = |battery_remaining| SYS_STATUS_DATA { battery_remaining, ..Default::default() };
        let mut charge = Charge::default();
        charge.system(&system(70)).expect("sound");
        assert_eq!(charge.percent(), Some(70));
        charge.battery(&battery(1, 3)).expect("sound");
        charge.battery(&battery(0, 64)).expect("sound");
        assert_eq!(charge.percent(), Some(64));
        charge.battery(&battery(0, -1)).expect("sound");
        assert_eq!(charge.percent(), Some(70), "unknown");
        charge.battery(&battery(0, 101)).expect_err("it lies");
        charge.system(&system(-7)).expect_err("it lies");
    }

    #[test]
    fn a_place_on_the_earth_is_in_degrees_and_zero_is_unknown() {
        let found = place(522_053_000, 1_218_000, 12_000).expect("a place");
        assert!((found.latitude_deg - 52.2053).abs() < 1e-9 && (found.longitude_deg - 0.1218).abs() < 1e-9);
        assert_eq!(found.height_m, 12.0);
        for (latitude, longitude) in [(0, 0), (910_000_000, 0), (0, 1_810_000_000)] {
            place(latitude, longitude, 0).expect_err("no place");
        }
        assert_eq!(place(1, 1, i32::MAX).expect("a place").height_m, 0.0, "its height is none");
    }
}
