//! Source `gpsd`: localizes one robot by its own satellite receiver, read from gpsd.
//!
//! The worker (I/O thread) passes the lines from gpsd on unchanged. The source itself does no I/O: it judges the
//! quality of each fix by mode and status, and its error by GST reports. The field `eph` is not used: in a measurement
//! it was 11.4 m where GST gave 0.01 m. A fix below `fix_least` gives no reading, so the guard stops the robot.
//!
//! For a receiver at 10 Hz, `own_state_s` must be at least 0.25 s, because gaps of up to 0.12 s were measured.

pub mod geodesy;
pub mod report;
mod settings;
mod worker;

use std::f64::consts::FRAC_PI_2;

use crate::config::ConfigError;
use crate::edge::Settings;
use crate::localization::{In, Out, Parts, Source};
use crate::messages::geometry::{Deviation, MAX_SIZE, Pose, Twist, Vec2};
use crate::messages::ids::RobotId;
use crate::messages::wire::Reading;
use crate::time::Time;

use geodesy::Geodetic;
use report::{Fix, Gst, Malformed, Report, Tpv};
use settings::{Config, Heading};

/// Description of the source `gpsd` in one line, for lists of all sources.
pub const ABOUT: &str = "the robot's own satellite receiver, by gpsd";

/// Lowest speed at which the course over ground is used as the heading \[m/s\]. At lower speeds, the noise of the
/// course is too large.
const LEAST_SPEED_M_S: f64 = 0.3;
/// Largest time by which a report may be older than the newest one and be dropped as late \[ns\]. A report that is
/// older still is used: it means that the receiver's clock was set back.
const LATE_NS: u64 = 1_000_000_000;
/// Largest time between a fix and the GST report used for it \[ns\]. Receivers send GST every second or faster.
const STATISTICS_NS: u64 = 2_000_000_000;

/// Makes the source that localizes one robot by its satellite receiver, and the worker that reads gpsd. The error names
/// the wrong setting.
pub fn make(settings: &Settings, robots: &[RobotId]) -> Result<Parts, ConfigError> {
    let config = Config::read(settings)?;
    let [robot] = *robots else {
        let why = "gpsd tells where its own robot is; give each robot's host one robot in `localizes`";
        return Err(ConfigError::field("name", why));
    };
    let worker = Box::new(worker::Subscriber { address: config.address, robot });
    Ok(Parts { source: Box::new(move || Box::new(Gpsd::new(robot, &config))), worker })
}

/// Logic of the source `gpsd`, without I/O: converts lines from gpsd to readings of one robot.
struct Gpsd {
    robot: RobotId,
    config: Config,
    /// Newest GST report, with the standard deviations of the position; `None` before the first.
    statistics: Option<Gst>,
    /// Time of measurement of the last fix that gave a reading \[ns since 1970, UTC\]; `None` before the first.
    last_ns: Option<u64>,
    /// Last known height above the ellipsoid \[m\]. An error of 100 m changes a horizontal distance of 1 km by 16 mm.
    height_m: f64,
}

impl Gpsd {
    fn new(robot: RobotId, config: &Config) -> Gpsd {
        Gpsd { robot, config: config.clone(), statistics: None, last_ns: None, height_m: 0.0 }
    }

    fn is_of(&self, device: Option<&str>) -> bool {
        self.config.device.as_deref().is_none_or(|own| device == Some(own))
    }

    fn line(&mut self, line: &[u8], out: &mut Vec<Out>) -> Result<(), Malformed> {
        match report::decode(line)? {
            Report::Tpv(tpv) if self.is_of(tpv.device.as_deref()) => out.extend(self.fix(&tpv)?.map(checked)),
            Report::Gst(statistics) if self.is_of(statistics.device.as_deref()) => self.statistics = Some(statistics),
            Report::Error => return Err(Malformed("gpsd reports an error; is it of version 3.20 or later?")),
            Report::Tpv(_) | Report::Gst(_) | Report::Other => {}
        }
        Ok(())
    }

    /// Returns the reading of a fix; `None` if the fix is repeated, late or without a time. An error is the reason for
    /// which the fix is refused.
    fn fix(&mut self, tpv: &Tpv) -> Result<Option<Reading>, Malformed> {
        let fix = Fix::of(tpv).ok_or(Malformed("the receiver has no fix in three dimensions from satellites"))?;
        if fix < self.config.fix_least {
            return Err(Malformed("the receiver's fix is worse than fix_least; see its corrections and its sky"));
        }
        // The first reports of a receiver have no time.
        let Some(time_ns) = tpv.time_ns else { return Ok(None) };
        if self.last_ns.is_some_and(|last_ns| time_ns <= last_ns && last_ns - time_ns < LATE_NS) {
            // gpsd sends a fix again whenever a further sentence adds data to it.
            return Ok(None);
        }
        let deviation_m = self.deviation_m(time_ns);
        if self.config.deviation_most_m.is_some_and(|most_m| deviation_m.is_none_or(|error_m| error_m > most_m)) {
            return Err(Malformed("the receiver's GST says more than deviation_most_m, or it sends no GST"));
        }
        let (Some(latitude_deg), Some(longitude_deg)) = (tpv.latitude_deg, tpv.longitude_deg) else {
            return Err(Malformed("a fix of gpsd has no position"));
        };
        let speed_m_s = tpv.speed_m_s.ok_or(Malformed("a fix of gpsd has no speed; the receiver has to send RMC"))?;
        self.height_m = tpv.height_m.unwrap_or(self.height_m);
        let place = Geodetic { latitude_deg, longitude_deg, height_m: self.height_m };
        let [east, north, _] = self.config.frame.east_north_up(&place);
        if !(0.0..=f64::from(MAX_SIZE)).contains(&libm::hypot(east, north)) {
            return Err(Malformed(
                "the receiver is over 100 km from the origin; correct origin_latitude_deg and ..longitude",
            ));
        }
        let [x, y] = self.config.axes.position(east, north);
        // Courses are clockwise from north, angles of the team's frame counter-clockwise from its x axis.
        let course = tpv.track_deg.map(|track_deg| self.config.axes.heading(FRAC_PI_2 - track_deg.to_radians()));
        let velocity = velocity(speed_m_s, course)?;
        self.last_ns = Some(time_ns);
        let moving = self.config.heading == Heading::Track && speed_m_s >= LEAST_SPEED_M_S;
        Ok(Some(Reading {
            robot: self.robot,
            stamp_ns: time_ns,
            pose: Pose {
                position: Vec2::new(x as f32, y as f32),
                heading: course.filter(|_| moving).map(|course| course as f32),
            },
            twist: Twist { velocity, yaw_rate: None },
            deviation: Deviation { position_m: deviation_m.map(|error_m| error_m as f32), ..Deviation::default() },
        }))
    }

    /// Returns the standard deviation of the position \[m\], the larger of north and east, from the newest GST report;
    /// `None` if that report is not within 2 s of `time_ns` \[ns since 1970, UTC\].
    fn deviation_m(&self, time_ns: u64) -> Option<f64> {
        let statistics = self.statistics.as_ref()?;
        let fresh = statistics.time_ns.is_some_and(|at_ns| at_ns.abs_diff(time_ns) <= STATISTICS_NS);
        Some(statistics.north_m?.max(statistics.east_m?)).filter(|_| fresh)
    }
}

/// Returns the velocity \[m/s\] in the team's frame, from a speed and the course in that frame \[rad\]. Without a
/// course, the velocity of a slow receiver is zero, and that of a fast one an error.
fn velocity(speed_m_s: f64, course: Option<f64>) -> Result<Vec2, Malformed> {
    match course {
        Some(course) => {
            let (sin, cos) = libm::sincos(course);
            Ok(Vec2::new((speed_m_s * cos) as f32, (speed_m_s * sin) as f32))
        }
        None if speed_m_s < LEAST_SPEED_M_S => Ok(Vec2::zeros()),
        None => Err(Malformed("a fix of gpsd has a speed and no course")),
    }
}

fn checked(reading: Reading) -> Out {
    reading.unfit().map_or(Out::Reading(reading), Out::Refused)
}

impl Source for Gpsd {
    fn take(&mut self, _: Time, input: In, out: &mut Vec<Out>) {
        let In::Packet(line) = input else { return };
        if let Err(Malformed(why)) = self.line(line, out) {
            out.push(Out::Refused(why));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROBOT: RobotId = RobotId(3);

    fn source(more: &str) -> Box<dyn Source> {
        let table = format!("origin_latitude_deg = 52.2053\norigin_longitude_deg = 0.1218\n{more}").parse().unwrap();
        let settings = Settings { name: "gpsd".to_owned(), table };
        (make(&settings, &[ROBOT]).map_err(|error| error.to_string()).unwrap().source)()
    }

    /// Line of a TPV report `tenths` tenths of a second after the first one.
    fn tpv(tenths: u32, status: u8, more: &str) -> String {
        let time = format!("2026-11-22T12:00:{:02}.{}00Z", tenths / 10, tenths % 10);
        let start = r#"{"class":"TPV","device":"/dev/ttyACM0","mode":3,"lat":52.2054,"lon":0.1218"#;
        format!(r#"{start},"status":{status},"time":"{time}"{more}}}"#)
    }

    fn take(source: &mut dyn Source, line: &str) -> Result<Option<Reading>, &'static str> {
        let mut out = Vec::new();
        source.take(Time::ZERO, In::Packet(line.as_bytes()), &mut out);
        assert!(out.len() <= 1);
        match out.pop() {
            None => Ok(None),
            Some(Out::Reading(reading)) => Ok(Some(reading)),
            Some(Out::Refused(why)) => Err(why),
        }
    }

    const MOVING: &str = r#","altHAE":0.0,"track":90.0,"speed":0.5"#;
    const GST: &str =
        r#"{"class":"GST","device":"/dev/ttyACM0","time":"2026-11-22T12:00:00.000Z","lat":0.01,"lon":0.02}"#;

    #[test]
    fn a_fix_is_turned_into_the_teams_frame() {
        let mut plain = source("");
        assert_eq!(take(&mut *plain, GST), Ok(None));
        let reading = take(&mut *plain, &tpv(0, 3, MOVING)).unwrap().unwrap();
        assert!((reading.pose.position - Vec2::new(0.0, 11.127)).norm() < 1e-2, "{reading:?}");
        assert!((reading.twist.velocity - Vec2::new(0.5, 0.0)).norm() < 1e-6, "east");
        assert!(reading.pose.heading.unwrap().abs() < 1e-6 && reading.twist.yaw_rate.is_none());
        assert_eq!((reading.robot, reading.stamp_ns), (ROBOT, 1_795_348_800_000_000_000));
        assert_eq!(reading.deviation.position_m, Some(0.02), "the larger one");
        let mut turned = source("yaw_rad = 1.5707963267948966");
        let reading = take(&mut *turned, &tpv(0, 3, MOVING)).unwrap().unwrap();
        assert!((reading.pose.position - Vec2::new(-11.127, 0.0)).norm() < 1e-2, "{reading:?}");
        assert!((reading.twist.velocity - Vec2::new(0.0, 0.5)).norm() < 1e-6);
        assert!((reading.pose.heading.unwrap() - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
        assert_eq!(reading.deviation.position_m, None, "no GST yet");
    }

    #[test]
    fn a_fix_below_the_least_gives_no_reading() {
        for (least, accepted) in [("rtk-fixed", 1), ("rtk-float", 2), ("dgps", 3), ("3d", 4)] {
            let mut source = source(&format!("fix_least = '{least}'"));
            let statuses = [3, 4, 2, 1, 5, 8].into_iter().enumerate();
            let read = statuses.filter(|(at, status)| take(&mut *source, &tpv(*at as u32, *status, MOVING)).is_ok());
            assert_eq!(read.count(), accepted, "{least}");
        }
        let mut source = source("deviation_most_m = 0.015");
        take(&mut *source, &tpv(0, 3, MOVING)).expect_err("no GST");
        take(&mut *source, GST).unwrap();
        take(&mut *source, &tpv(0, 3, MOVING)).expect_err("GST says 2 cm");
        take(&mut *source, &GST.replace("0.02", "0.015")).unwrap();
        assert!(take(&mut *source, &tpv(0, 3, MOVING)).unwrap().is_some());
        take(&mut *source, &tpv(30, 3, MOVING)).expect_err("GST has stopped");
    }

    #[test]
    fn a_repeated_fix_gives_no_reading() {
        let mut source = source("");
        assert!(take(&mut *source, &tpv(5, 3, MOVING)).unwrap().is_some());
        assert_eq!(take(&mut *source, &tpv(5, 3, MOVING)), Ok(None));
        assert_eq!(take(&mut *source, &tpv(4, 3, MOVING)), Ok(None), "late");
        assert!(take(&mut *source, &tpv(6, 3, MOVING)).unwrap().is_some());
        assert_eq!(take(&mut *source, &tpv(6, 3, MOVING).replace(r#""time":"#, r#""when":"#)), Ok(None), "no time");
    }

    #[test]
    fn a_robot_that_stands_has_no_heading_and_no_velocity() {
        let mut source = source("");
        let reading = take(&mut *source, &tpv(0, 3, r#","altHAE":0.0,"speed":0.05"#)).unwrap().unwrap();
        assert_eq!((reading.pose.heading, reading.twist.velocity), (None, Vec2::zeros()));
        let slow = r#","altHAE":0.0,"track":0.0,"speed":0.2"#;
        let reading = take(&mut *source, &tpv(1, 3, slow)).unwrap().unwrap();
        assert!(reading.pose.heading.is_none() && (reading.twist.velocity - Vec2::new(0.0, 0.2)).norm() < 1e-6);
        take(&mut *source, &tpv(2, 3, r#","speed":1.0"#)).expect_err("a speed without a course");
        take(&mut *source, &tpv(2, 3, "")).expect_err("no speed");
        take(&mut *source, &tpv(2, 3, &MOVING.replace("0.5", "1e300"))).expect_err("out of range");
        let far = tpv(3, 3, MOVING).replace("52.2054", "-33.9");
        assert!(take(&mut *source, &far).expect_err("far").contains("origin"));
        assert!(take(&mut *source, &tpv(3, 3, MOVING)).unwrap().is_some());
    }

    #[test]
    fn mutated_lines_never_panic() {
        use crate::random::{RngExt, Seed};
        let (mut source, mut random) = (source(""), Seed::of_run(1).stream("mutation"));
        let mut out = Vec::new();
        for round in 0..20_000 {
            let mut line = tpv(round % 600, 3, MOVING).into_bytes();
            for _ in 0..random.random_range(1..4) {
                let at = random.random_range(0..line.len());
                line[at] = random.random();
            }
            line.truncate(random.random_range(0..=line.len() + 20));
            source.take(Time::ZERO, In::Packet(&line), &mut out);
        }
        let sound = |said: &Out| match said {
            Out::Reading(reading) => reading.unfit().is_none(),
            Out::Refused(_) => true,
        };
        assert!(out.iter().all(sound) && out.iter().any(|said| matches!(said, Out::Reading(_))));
    }
}
