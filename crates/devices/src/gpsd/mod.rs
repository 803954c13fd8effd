//! Source `gpsd`: localizes one robot by its own satellite receiver, read from gpsd.
//!
//! The worker passes the lines from gpsd on unchanged. The source itself does no I/O: it judges the quality of each fix
//! by mode and status, and its error by GST reports. The field `eph` is used for fixes with dead reckoning alone, whose
//! status does not tell their quality: in a measurement it was 11.4 m where GST gave 0.01 m. A fix below `fix_least`
//! gives no reading, so the guard stops the robot.
//!
//! For a receiver at 10 Hz, `own_state_s` must be at least 0.25 s, because gaps of up to 0.12 s were measured.

mod places;
mod receivers;
mod report;
mod settings;
mod worker;

use std::f64::consts::FRAC_PI_2;

use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use murmurate::edge::sender_clock::{Novelty, SenderClock};
use murmurate::localization::fix::Fix;
use murmurate::localization::plausibility::Quality;
use murmurate::localization::{In, Out, Parts, Source};
use murmurate::messages::geometry::{Deviation, MAX_SIZE, Pose, Twist, Vec2, wrapped};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;
use murmurate::time::{Span, Time};

use murmurate::localization::geodesy::Geodetic;
use places::Places;
use receivers::Receivers;
use report::{Att, GpsdReport, Gst, Kind, Malformed, Tpv};
use settings::{Config, Heading};

/// Description of the source `gpsd` in one line, for lists of all sources.
pub const ABOUT: &str = "the robot's own satellite receiver, by gpsd";

/// Lowest speed at which the course over ground is used as the heading \[m/s\]. At lower speeds, the noise of the
/// course is too large.
const LEAST_SPEED_M_S: f64 = 0.3;
/// Standard deviations of a heading \[rad\]: of a course, of which any two are possible within six of them, and of the
/// direction between two antennas.
const HEADING_RAD: (f64, f64) = (0.6, 0.05);
/// Largest time between a fix and the GST report used for it \[ns\]. Receivers send GST every second or faster.
const STATISTICS_NS: u64 = 2_000_000_000;
/// Largest age of an attitude that is the heading of a fix: that of three reports at 10 Hz.
const ATTITUDE: Span = Span::from_millis(300);
/// Error within which 95 % of all positions are, in standard deviations along each axis (Rayleigh distribution).
const SIGMAS_95: f64 = 2.448;
/// Number of older stamps in a row that show a clock that was set back: reports of gpsd come in order, over TCP.
const IN_ORDER: u32 = 2;
/// Time without a report of a position after which the sky alone is worth a notice.
const SKY_ALONE: Span = Span::from_millis(2000);
/// Lowest and highest height above the ellipsoid that is believed \[m\]: of the Dead Sea, and of aircraft.
const HEIGHTS_M: std::ops::RangeInclusive<f64> = -1000.0..=20_000.0;

/// Makes the source that localizes one robot by its satellite receiver, and the worker that reads gpsd. The error names
/// the wrong setting.
pub fn make(settings: &Settings, robots: &[RobotId]) -> Result<Parts, ConfigError> {
    let config = Config::read(settings)?;
    let [robot] = *robots else {
        let why = "gpsd tells where its own robot is; give each robot's host one robot in `localizes`";
        return Err(ConfigError::field("name", why));
    };
    let worker = Box::new(worker::Subscriber { address: config.address.clone(), robot });
    Ok(Parts { source: Box::new(move || Box::new(Gpsd::new(robot, &config))), worker })
}

/// Logic of the source `gpsd`, without I/O: converts lines from gpsd to readings of one robot.
struct Gpsd {
    robot: RobotId,
    config: Config,
    receivers: Receivers,
    /// Newest GST report, with the standard deviations of the position; `None` before the first.
    statistics: Option<Gst>,
    /// Newest direction between the receiver's antennas \[deg\], clockwise from north, with its arrival; `None` before
    /// the first.
    attitude: Option<(Time, f64)>,
    /// Clock of the receiver, as the fixes that gave readings show it.
    clock: SenderClock,
    /// Last places of the robot, from which its velocity is found where a report has none.
    places: Places,
    /// True if nothing needs velocities and headings of this source.
    positions_suffice: bool,
    /// Arrival of the last fix with satellites that gave a reading; `None` before the first.
    satellites: Option<Time>,
    /// Arrival of the first report of any class, and of the last one of a position; `None` before.
    begun: Option<Time>,
    positioned: Option<Time>,
    /// Last known height above the ellipsoid \[m\]. An error of 100 m changes a horizontal distance of 1 km by 16 mm.
    height_m: f64,
    /// What may be assumed of the last fix that gave a reading.
    quality: Quality,
}

impl Gpsd {
    fn new(robot: RobotId, config: &Config) -> Gpsd {
        Gpsd {
            robot,
            config: config.clone(),
            receivers: Receivers::new(robot, config.device.clone()),
            statistics: None,
            attitude: None,
            clock: SenderClock::new(IN_ORDER),
            places: Places::default(),
            positions_suffice: config.heading == Heading::None,
            satellites: None,
            begun: None,
            positioned: None,
            height_m: 0.0,
            quality: Quality::MEASURED,
        }
    }

    fn line(&mut self, now: Time, line: &[u8], out: &mut Vec<Out>) -> Result<(), Malformed> {
        let begun = *self.begun.get_or_insert(now);
        match report::decode(line)? {
            GpsdReport::Tpv(tpv) => {
                self.positioned = Some(now);
                if self.receivers.take(now, tpv.device.as_deref(), tpv.mode >= 2)? {
                    out.extend(self.fix(now, &tpv)?);
                }
            }
            GpsdReport::Gst(statistics) if self.receivers.is_own(statistics.device.as_deref()) => {
                let sound = |error_m: Option<f64>| error_m.is_none_or(|m| (0.0..=f64::from(MAX_SIZE)).contains(&m));
                if !(sound(statistics.north_m) && sound(statistics.east_m)) {
                    return Err(Malformed("the receiver's GST has a standard deviation that is none"));
                }
                self.statistics = Some(statistics);
            }
            GpsdReport::Att(Att { device, heading_deg: Some(heading_deg) })
                if self.receivers.is_own(device.as_deref()) =>
            {
                if heading_deg.abs() > 720.0 {
                    return Err(Malformed("the receiver's ATT has a heading that is none"));
                }
                self.attitude = Some((now, heading_deg));
            }
            GpsdReport::Sky if now.since(self.positioned.unwrap_or(begun)) >= SKY_ALONE => {
                return Err(Malformed("gpsd sends the satellites of its receiver (SKY) and no position (TPV)"));
            }
            GpsdReport::Devices(0) => {
                return Err(Malformed("gpsd has no receiver: name its device to gpsd, or plug it in"));
            }
            GpsdReport::Error => return Err(Malformed("gpsd reports an error; is it of version 3.20 or later?")),
            GpsdReport::Gst(_) | GpsdReport::Att(_) | GpsdReport::Sky | GpsdReport::Devices(_) | GpsdReport::Other => {}
        }
        Ok(())
    }

    /// Returns the reading of a fix; `None` if the fix is repeated or late. An error is the reason for which the fix is
    /// refused.
    fn fix(&mut self, now: Time, tpv: &Tpv) -> Result<Option<Out>, Malformed> {
        let kind = Kind::of(tpv);
        let deviation_m = self.deviation_m(tpv, kind);
        self.check_quality(now, kind, deviation_m)?;
        let time_ns = tpv.time_ns.ok_or(Malformed("the receiver does not know the time yet"))?;
        let may_leap = report::may_leap(time_ns);
        // gpsd sends a fix again whenever a further sentence adds data to it.
        if self.clock.is_repeated(time_ns) && !may_leap {
            return Ok(None);
        }
        if self.config.deviation_most_m.is_some_and(|most_m| deviation_m.is_none_or(|error_m| error_m > most_m)) {
            return Err(Malformed("the receiver's GST says more than deviation_most_m, or it sends no GST"));
        }
        let ([x, y], height_m) = self.place_of(tpv)?;
        // Courses are clockwise from north, angles of the team's frame counter-clockwise from its x axis.
        let turned = |clockwise_deg: f64| self.config.axes.heading(FRAC_PI_2 - clockwise_deg.to_radians());
        let course = tpv.track_deg.map(turned);
        let measured = self.velocity(tpv.speed_m_s, course)?;
        let heading = match self.config.heading {
            Heading::Track => course.filter(|_| tpv.speed_m_s.is_some_and(|speed| speed >= LEAST_SPEED_M_S)),
            Heading::Att => {
                let fresh = self.attitude.filter(|(at, _)| now.since(*at) <= ATTITUDE);
                // The receiver's direction, less where it points in the robot's own frame.
                fresh.map(|(_, deg)| wrapped(turned(deg) - self.config.antennas_rad))
            }
            Heading::None => None,
        };
        let novelty = if may_leap { self.clock.take_in_leap(now, time_ns) } else { self.clock.take(now, time_ns) };
        let stamp_ns = match novelty {
            Novelty::Old => return Ok(None),
            Novelty::Anew(stamp_ns) => {
                self.places = Places::default();
                stamp_ns
            }
            Novelty::New(stamp_ns) => stamp_ns,
        };
        self.height_m = height_m;
        if kind != Kind::DeadReckoning {
            self.satellites = Some(now);
        }
        self.quality = quality(kind, self.config.heading, measured.is_some());
        let by_places = self.places.take(stamp_ns, [x, y]);
        let reading = Reading {
            robot: self.robot,
            stamp_ns,
            pose: Pose { position: Vec2::new(x as f32, y as f32), heading: heading.map(|heading| heading as f32) },
            twist: Twist { velocity: measured.unwrap_or(by_places), yaw_rate: None },
            deviation: Deviation { position_m: deviation_m.map(|error_m| error_m as f32), ..Deviation::default() },
        };
        Ok(Some(reading.unfit().map_or(Out::Reading(reading), |why| Out::RefusedOf(self.robot, why))))
    }

    /// Checks that a position of this kind may be used, by `fix_least` and `dead_reckoning_s`. `deviation_m` is its
    /// standard deviation \[m\], as far as it is stated. An error is the reason why not.
    fn check_quality(&self, now: Time, kind: Kind, deviation_m: Option<f64>) -> Result<(), Malformed> {
        let fix = match kind {
            Kind::None => return Err(Malformed("the receiver has no fix in three dimensions from satellites")),
            Kind::NotMeasured => {
                return Err(Malformed("the receiver's position is surveyed or simulated, not measured"));
            }
            Kind::DeadReckoning => {
                let longest = self.config.dead_reckoning;
                let within = self.satellites.is_some_and(|at| now.since(at) <= longest);
                if within && longest > Span::ZERO {
                    return Ok(());
                }
                return Err(Malformed("the receiver goes by dead reckoning alone, for longer than dead_reckoning_s"));
            }
            Kind::Satellites(fix) => fix,
            Kind::WithDeadReckoning => report::fix_of_error(deviation_m),
        };
        if fix < self.config.fix_least {
            return Err(Malformed("the receiver's fix is worse than fix_least; see its corrections and its sky"));
        }
        Ok(())
    }

    /// Returns the place of a fix in the team's frame \[m\], and its height above the ellipsoid \[m\], which is the
    /// last known one where the report has none or an impossible one.
    fn place_of(&self, tpv: &Tpv) -> Result<([f64; 2], f64), Malformed> {
        let (Some(latitude_deg), Some(longitude_deg)) = (tpv.latitude_deg, tpv.longitude_deg) else {
            return Err(Malformed("a fix of gpsd has no position"));
        };
        if latitude_deg.abs() > 90.0 || longitude_deg.abs() > 360.0 {
            return Err(Malformed("a fix of gpsd has a latitude or longitude that is none"));
        }
        let height_m = tpv.height_m.filter(|height_m| HEIGHTS_M.contains(height_m)).unwrap_or(self.height_m);
        let [east, north, _] = self.config.frame.east_north_up(&Geodetic { latitude_deg, longitude_deg, height_m });
        if !(0.0..=f64::from(MAX_SIZE)).contains(&libm::hypot(east, north)) {
            return Err(Malformed(
                "the receiver is over 100 km from the origin; correct origin_latitude_deg and ..longitude",
            ));
        }
        Ok((self.config.axes.position(east, north), height_m))
    }

    /// Returns the standard deviation of the position of a fix \[m\], the larger of north and east: that of the newest
    /// GST report if it is within 2 s of the fix; for a fix with dead reckoning, else that of its `eph`. `None` if
    /// unknown.
    fn deviation_m(&self, tpv: &Tpv, kind: Kind) -> Option<f64> {
        let of_statistics = || {
            let statistics = self.statistics.as_ref()?;
            let fresh = statistics.time_ns?.abs_diff(tpv.time_ns?) <= STATISTICS_NS;
            // A receiver that does not know its error says zero.
            Some(statistics.north_m?.max(statistics.east_m?)).filter(|error_m| fresh && *error_m > 0.0)
        };
        let reckons = matches!(kind, Kind::WithDeadReckoning | Kind::DeadReckoning);
        let stated = tpv.error_95_m.filter(|error_m| reckons && (0.0..=f64::from(MAX_SIZE)).contains(error_m));
        of_statistics().or(stated.map(|error_m| error_m / SIGMAS_95))
    }

    /// Returns the velocity \[m/s\] in the team's frame, from a speed and the course in that frame \[rad\]. Without a
    /// course, the velocity of a slow receiver is zero. Otherwise a velocity that lacks a part is `None` where none is
    /// needed, and else an error.
    fn velocity(&self, speed_m_s: Option<f64>, course: Option<f64>) -> Result<Option<Vec2>, Malformed> {
        match (speed_m_s, course) {
            (Some(speed_m_s), Some(course)) => {
                let (sin, cos) = libm::sincos(course);
                Ok(Some(Vec2::new((speed_m_s * cos) as f32, (speed_m_s * sin) as f32)))
            }
            (Some(speed_m_s), None) if speed_m_s < LEAST_SPEED_M_S => Ok(Some(Vec2::zeros())),
            _ if self.positions_suffice => Ok(None),
            (Some(_), None) => Err(Malformed(
                "a fix has a speed and no course; heading = \"none\", `fuse` or the estimator kalman need none",
            )),
            (None, _) => Err(Malformed(
                "a fix has no speed: does the receiver send RMC or VTG? heading = \"none\", `fuse` or kalman need none",
            )),
        }
    }
}

/// Returns what may be assumed of a position of this kind without GST. A receiver measures its velocity by the Doppler
/// shift. Its course says little about its heading: it is noise at low speed, and the robot may drive backwards.
fn quality(kind: Kind, heading: Heading, moves_as_measured: bool) -> Quality {
    let position_m = match kind {
        Kind::Satellites(Fix::RtkFixed) => 0.02,
        Kind::Satellites(Fix::RtkFloat) => 0.3,
        Kind::Satellites(Fix::Dgps) => 1.0,
        _ => 3.0,
    };
    let heading_rad = if heading == Heading::Att { HEADING_RAD.1 } else { HEADING_RAD.0 };
    let reckoned = kind == Kind::DeadReckoning;
    Quality { reckoned, moves_as_measured, position_m, heading_rad, ..Quality::MEASURED }
}

impl Source for Gpsd {
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        let In::Packet(line) = input else { return };
        if let Err(Malformed(why)) = self.line(now, line, out) {
            out.push(Out::RefusedOf(self.robot, why));
        }
    }

    fn positions_suffice(&mut self) {
        self.positions_suffice = true;
    }

    fn quality(&self, _: RobotId) -> Quality {
        self.quality
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
            Some(Out::Refused(why) | Out::RefusedOf(_, why)) => Err(why),
            Some(lost @ Out::Lost(..)) => panic!("{lost:?}"),
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
        let without = tpv(6, 3, MOVING).replace(r#""time":"#, r#""when":"#);
        assert!(take(&mut *source, &without).expect_err("no time").contains("time"));
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

    /// Feeds reports that arrive ten times a second; returns what is said to each.
    fn feed(
        source: &mut dyn Source,
        lines: impl IntoIterator<Item = String>,
    ) -> Vec<Result<Option<Reading>, &'static str>> {
        let one = |(tenth, line): (usize, String)| {
            let mut out = Vec::new();
            source.take(Time::ZERO + Span::from_millis(100 * tenth as u64), In::Packet(line.as_bytes()), &mut out);
            match out.pop() {
                None => Ok(None),
                Some(Out::Reading(reading)) => Ok(Some(reading)),
                Some(Out::Refused(why) | Out::RefusedOf(_, why)) => Err(why),
                Some(lost @ Out::Lost(..)) => panic!("{lost:?}"),
            }
        };
        lines.into_iter().enumerate().map(one).collect()
    }

    fn count(said: &[Result<Option<Reading>, &'static str>]) -> usize {
        said.iter().filter(|said| matches!(said, Ok(Some(_)))).count()
    }

    #[test]
    fn a_fix_without_course_or_speed_is_a_position_where_no_velocity_is_needed() {
        // 0.6 m/s to the north, by positions alone.
        let moving = |tenths: u32, more: &str| {
            let latitude = format!("\"lat\":{:.9}", 52.2054 + 0.06 * f64::from(tenths) / 111_270.0);
            tpv(tenths, 3, more).replace("\"lat\":52.2054", &latitude)
        };
        for more in [r#","altHAE":0.0,"speed":0.6"#, r#","altHAE":0.0"#, r#","altHAE":0.0,"track":3.0"#] {
            let lines = || (0..20).map(|tenths| moving(tenths, more));
            assert_eq!(count(&feed(&mut *source(""), lines())), 0, "the heading and the velocity are needed: {more}");
            let mut fused = source("");
            fused.positions_suffice();
            for mut source in [source("heading = 'none'"), fused] {
                let said = feed(&mut *source, lines());
                assert_eq!(count(&said), 20, "{more}: {said:?}");
                let last = said[19].clone().unwrap().unwrap();
                assert!((last.twist.velocity - Vec2::new(0.0, 0.6)).norm() < 1e-2, "{last:?}");
                assert!(last.pose.heading.is_none() && last.deviation.velocity_m_s.is_none(), "{last:?}");
            }
        }
        let why = feed(&mut *source(""), [tpv(0, 3, r#","speed":0.6"#), tpv(1, 3, "")]);
        assert!(why[0].as_ref().unwrap_err().contains("speed and no course"));
        assert!(why[1].as_ref().unwrap_err().contains("does the receiver send RMC"));
    }

    #[test]
    fn satellites_with_dead_reckoning_are_a_fix_of_their_stated_error() {
        // Standard deviation and what it counts as: eph is for 95 % of all fixes.
        for (eph, quality) in [(0.1, 4), (1.0, 3), (4.0, 2), (20.0, 1)] {
            let more = format!("{MOVING},\"eph\":{eph}");
            for (at, least) in ["3d", "dgps", "rtk-float", "rtk-fixed"].into_iter().enumerate() {
                let said = feed(&mut *source(&format!("fix_least = '{least}'")), [tpv(0, 6, &more)]);
                assert_eq!(count(&said) == 1, at < quality, "{eph} {least}: {said:?}");
                if let Ok(Some(reading)) = &said[0] {
                    assert!((reading.deviation.position_m.unwrap() - eph / 2.448).abs() < 1e-6);
                }
            }
        }
        assert_eq!(count(&feed(&mut *source("fix_least = '3d'"), [tpv(0, 6, MOVING)])), 1, "no error is stated");
        assert_eq!(count(&feed(&mut *source(""), [GST.to_owned(), tpv(1, 6, MOVING)])), 1, "GST says 2 cm");
    }

    #[test]
    fn dead_reckoning_alone_counts_by_its_field_and_for_its_time() {
        let lines = || (0..60).map(|tenths| tpv(tenths, if (10..50).contains(&tenths) { 5 } else { 3 }, MOVING));
        let accepted = |text: &str| {
            let said = feed(&mut *source(text), lines());
            let kept: Vec<usize> = (0..60).filter(|at| matches!(said[*at], Ok(Some(_)))).collect();
            (kept.len(), kept.contains(&29), kept.contains(&30), kept.contains(&50))
        };
        assert_eq!(accepted(""), (20, false, false, true));
        assert_eq!(accepted("dead_reckoning_s = 2.0"), (40, true, false, true));
        let first = feed(&mut *source("dead_reckoning_s = 2.0"), [tpv(0, 5, MOVING)]);
        assert_eq!(count(&first), 0, "before a fix nothing is known");
    }

    #[test]
    fn a_receiver_with_two_antennas_gives_a_heading_also_at_rest() {
        let att = |deg: f64| format!(r#"{{"class":"ATT","device":"/dev/ttyACM0","heading":{deg}}}"#);
        let rest = r#","altHAE":0.0,"speed":0.0"#;
        let heading = |text: &str, lines: Vec<String>| {
            let said = feed(&mut *source(&format!("heading = 'att'\n{text}")), lines);
            said.last().unwrap().clone().unwrap().unwrap().pose.heading
        };
        // North is a quarter turn from east, which is x.
        let north = heading("", vec![att(0.0), tpv(1, 3, rest)]).unwrap();
        assert!((north - std::f32::consts::FRAC_PI_2).abs() < 1e-6, "{north}");
        let across = heading("antennas_rad = 1.5707963267948966", vec![att(0.0), tpv(1, 3, rest)]).unwrap();
        assert!(across.abs() < 1e-6, "the second antenna is to the left: {across}");
        let old: Vec<String> = std::iter::once(att(0.0)).chain((1..6).map(|at| tpv(at, 3, rest))).collect();
        assert_eq!(heading("", old), None, "an attitude that is half a second old");
        assert_eq!(heading("", vec![tpv(1, 3, rest)]), None);
        assert!(feed(&mut *source("heading = 'att'"), [att(1e9)])[0].is_err());
    }

    #[test]
    fn a_leap_second_and_a_repeated_second_cost_no_reading() {
        let line = |time: String| tpv(0, 3, MOVING).replace("2026-11-22T12:00:00.000Z", &time);
        let leap = (0..50).map(|k| match k {
            0..20 => line(format!("2026-12-31T23:59:{:06.3}Z", 58.0 + 0.1 * f64::from(k))),
            20..30 => line(format!("2026-12-31T23:59:{:06.3}Z", 60.0 + 0.1 * f64::from(k - 20))),
            _ => line(format!("2027-01-01T00:00:{:06.3}Z", 0.1 * f64::from(k - 30))),
        });
        let twice = (0..50).map(|k| match k {
            0..20 => line(format!("2026-12-31T23:59:{:06.3}Z", 58.0 + 0.1 * f64::from(k))),
            20..30 => line(format!("2026-12-31T23:59:{:06.3}Z", 59.0 + 0.1 * f64::from(k - 20))),
            _ => line(format!("2027-01-01T00:00:{:06.3}Z", 0.1 * f64::from(k - 30))),
        });
        for lines in [leap.collect::<Vec<_>>(), twice.collect()] {
            let said = feed(&mut *source(""), lines);
            assert_eq!(count(&said), 50, "{said:?}");
            let stamps: Vec<u64> = said.into_iter().map(|said| said.unwrap().unwrap().stamp_ns).collect();
            assert!(stamps.windows(2).all(|pair| pair[1] - pair[0] == 100_000_000), "no jump: {stamps:?}");
        }
    }

    #[test]
    fn a_receivers_clock_that_is_set_costs_a_tenth_of_a_second_at_most() {
        for step_ms in [-18_000i64, -500, -100, 500, 1024 * 7 * 86_400_000] {
            let lines = (0..60u64).map(|k| {
                let ms = (1_795_348_800_000 + 100 * k as i64 + if k >= 30 { step_ms } else { 0 }) as u64;
                let (day, ms) = (ms / 86_400_000 - 20_000, ms % 86_400_000);
                // The calendar of the test is one of days since 2024-10-04, within a month.
                let date = if day > 5000 { "2046-07-08".to_owned() } else { format!("2026-11-{:02}", day - 757) };
                let time = format!(
                    "{date}T{:02}:{:02}:{:02}.{:03}Z",
                    ms / 3_600_000,
                    ms / 60_000 % 60,
                    ms / 1000 % 60,
                    ms % 1000
                );
                tpv(0, 3, MOVING).replace("2026-11-22T12:00:00.000Z", &time)
            });
            let said = feed(&mut *source(""), lines);
            assert!(count(&said) >= 59, "{step_ms}: {said:?}");
        }
    }

    #[test]
    fn a_bad_report_costs_itself_alone() {
        let bad = [
            r#"{"class":"TPV","mode":3,"status":3,"time":"2026-11-22T12:00:01.050Z","lat":NaN,"lon":0.1}"#.to_owned(),
            tpv(1, 3, &MOVING.replace("\"altHAE\":0.0", "\"altHAE\":1e300")),
            tpv(1, 3, MOVING).replace("52.2054", "412.2054"),
            tpv(1, 3, MOVING).replace("52.2054", "0.0"),
            tpv(1, 3, MOVING).replace("0.1218", "\"east\""),
            GST.replace("0.02", "-0.02"),
            GST.replace("0.02", "1e300"),
            tpv(1, 3, MOVING).replace("2026-11-22T", ""),
        ];
        for line in bad {
            let mut source = source("deviation_most_m = 0.05");
            let lines = [GST.to_owned(), tpv(0, 3, MOVING), line.clone(), tpv(2, 3, r#","track":90.0,"speed":0.5"#)];
            let said = feed(&mut *source, lines);
            let [before, after] = [1, 3].map(|at| said[at].clone().unwrap().unwrap());
            assert!((after.pose.position - before.pose.position).norm() < 1e-3, "{line}: {after:?}");
        }
    }

    #[test]
    fn what_gpsd_lacks_is_said() {
        let why = |lines: Vec<String>| feed(&mut *source(""), lines).into_iter().find_map(Result::err);
        let devices = r#"{"class":"DEVICES","devices":[]}"#.to_owned();
        assert!(why(vec![devices]).unwrap().contains("gpsd has no receiver"));
        assert!(why(vec![r#"{"class":"SKY"}"#.to_owned(); 30]).unwrap().contains("no position (TPV)"));
        let other = tpv(0, 3, MOVING).replace("ttyACM0", "ttyUSB1");
        assert!(why(vec![tpv(0, 3, MOVING), other.clone()]).unwrap().contains("several receivers"));
        let mut named = source("device = '/dev/ttyUSB9'");
        let said = feed(&mut *named, vec![other; 30]).into_iter().find_map(Result::err);
        assert!(said.unwrap().contains("other receivers than `device`"));
    }

    #[test]
    fn mutated_lines_never_panic() {
        use murmurate::random::{RngExt, Seed};
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
            Out::Refused(_) | Out::RefusedOf(..) => true,
            Out::Lost(..) => false,
        };
        assert!(out.iter().all(sound) && out.iter().any(|said| matches!(said, Out::Reading(_))));
    }
}
