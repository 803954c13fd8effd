//! Source `mavlink`: localizes one robot by what its autopilot estimates, indoors from the autopilot's own origin or
//! outdoors on the earth. It does no I/O.

use mavlink::dialects::common::{GPS_GLOBAL_ORIGIN_DATA, GpsFixType, MavMessage};
use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use murmurate::localization::fix::Fix;
use murmurate::localization::geodesy::Geodetic;
use murmurate::localization::plausibility::Quality;
use murmurate::localization::{In, Out, Parts, Source};
use murmurate::messages::geometry::MAX_SIZE;
use murmurate::messages::ids::RobotId;
use murmurate::time::{Span, Time};

use super::axes::NorthEast;
use super::frames::{Found, Splitter, parse};
use super::link::FromWorker;
use super::orders;
use super::settings::{AUTOPILOT, Position, SourceConfig};
use super::telemetry::{Telemetry, local, place, velocity};
use super::worker::Endpoint;

/// Largest age of what the autopilot says of its satellite fix.
const FIX: Span = Span::from_millis(2000);
/// Standard deviation of the heading of an autopilot \[rad\], which has a compass or two antennas.
const HEADING_RAD: f64 = 0.05;

/// Makes the source that localizes one robot by its autopilot, and its worker. The error names the wrong setting.
pub fn make(settings: &Settings, robots: &[RobotId]) -> Result<Parts, ConfigError> {
    let robot = super::only(robots)?;
    let config = SourceConfig::read(settings)?;
    let mut reminders = vec![orders::heartbeat()];
    reminders.extend(orders::intervals(&config.link, config.position_hz));
    let worker = Box::new(Endpoint { link: config.link.clone(), reminders });
    Ok(Parts { source: Box::new(move || Box::new(Autopilot::new(robot, config.clone()))), worker })
}

/// Logic of the source `mavlink`.
struct Autopilot {
    robot: RobotId,
    config: SourceConfig,
    telemetry: Telemetry,
    splitter: Splitter,
    /// Quality of the autopilot's satellite fix, with its arrival; `None` before the first.
    fix: Option<(Time, Option<Fix>)>,
    /// Place of the autopilot's origin on the earth; `None` before it is told.
    origin: Option<Geodetic>,
}

impl Autopilot {
    fn new(robot: RobotId, config: SourceConfig) -> Autopilot {
        let telemetry = Telemetry::new(robot, config.axes);
        Autopilot { robot, config, telemetry, splitter: Splitter::default(), fix: None, origin: None }
    }

    fn message(&mut self, now: Time, message: &MavMessage, out: &mut Vec<Out>) -> Result<(), &'static str> {
        match message {
            MavMessage::ATTITUDE(attitude) => self.telemetry.attitude(now, attitude)?,
            MavMessage::GPS_RAW_INT(raw) => self.fix = Some((now, fix(raw.fix_type))),
            MavMessage::GPS_GLOBAL_ORIGIN(origin) => self.begins(origin)?,
            MavMessage::LOCAL_POSITION_NED(position) if self.config.position == Position::Local => {
                if self.telemetry.restarted(position.time_boot_ms) {
                    // Its origin may be elsewhere now.
                    self.origin = None;
                }
                self.check_fix(now)?;
                let (from_origin, velocity) = local(position);
                let place = self.place_of(from_origin)?;
                let reading = self.telemetry.reading(now, position.time_boot_ms, place, velocity)?;
                out.extend(reading.map(Out::Reading));
            }
            MavMessage::GLOBAL_POSITION_INT(position) if self.config.position == Position::Global => {
                self.telemetry.restarted(position.time_boot_ms);
                self.check_fix(now)?;
                let point = place(position.lat, position.lon, position.alt)?;
                let place = self.on_earth(&point, NorthEast { north: 0.0, east: 0.0 })?;
                let reading = self.telemetry.reading(now, position.time_boot_ms, place, velocity(position))?;
                out.extend(reading.map(Out::Reading));
            }
            _ => {}
        }
        Ok(())
    }

    fn begins(&mut self, origin: &GPS_GLOBAL_ORIGIN_DATA) -> Result<(), &'static str> {
        self.origin = Some(place(origin.latitude, origin.longitude, origin.altitude)?);
        Ok(())
    }

    /// Checks that the satellite fix is as good as `fix_least` asks for.
    fn check_fix(&self, now: Time) -> Result<(), &'static str> {
        let Some(least) = self.config.fix_least else { return Ok(()) };
        match self.fix.filter(|(at, _)| now.since(*at) <= FIX) {
            None => Err("the autopilot says nothing of its satellite fix (GPS_RAW_INT)"),
            Some((_, fix)) if fix.is_none_or(|fix| fix < least) => {
                Err("the autopilot's fix is worse than fix_least; see its corrections and its sky")
            }
            Some(_) => Ok(()),
        }
    }

    /// Returns the place in the team's frame \[m\] of a point that is so far from the autopilot's origin \[m\].
    fn place_of(&self, from_origin: NorthEast) -> Result<[f64; 2], &'static str> {
        if self.config.frame.is_none() {
            return Ok(self.config.alignment.position(from_origin.east, from_origin.north));
        }
        let origin = self.origin.as_ref();
        let origin = origin.ok_or("the autopilot has not said where its origin is on the earth (GPS_GLOBAL_ORIGIN)")?;
        self.on_earth(origin, from_origin)
    }

    /// Returns the place in the team's frame \[m\] of what is so far \[m\] north and east of a point on the earth.
    /// North and east differ between the point and the team's origin by less than 0.2 mrad where they are 1 km apart.
    fn on_earth(&self, point: &Geodetic, further: NorthEast) -> Result<[f64; 2], &'static str> {
        let frame = self.config.frame.ok_or("the team has no place on the earth")?;
        let [east, north, _] = frame.east_north_up(point);
        if !(0.0..=f64::from(MAX_SIZE)).contains(&libm::hypot(east, north)) {
            return Err("the robot is over 100 km from the origin; correct origin_latitude_deg and ..longitude");
        }
        Ok(self.config.alignment.position(east + further.east, north + further.north))
    }
}

/// Returns the quality of a satellite fix; `None` if it is none, or no measurement.
fn fix(kind: GpsFixType) -> Option<Fix> {
    match kind {
        GpsFixType::GPS_FIX_TYPE_3D_FIX => Some(Fix::ThreeD),
        GpsFixType::GPS_FIX_TYPE_DGPS | GpsFixType::GPS_FIX_TYPE_PPP => Some(Fix::Dgps),
        GpsFixType::GPS_FIX_TYPE_RTK_FLOAT => Some(Fix::RtkFloat),
        GpsFixType::GPS_FIX_TYPE_RTK_FIXED => Some(Fix::RtkFixed),
        _ => None,
    }
}

impl Source for Autopilot {
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        let In::Packet(packet) = input else { return };
        let bytes = match FromWorker::decode(packet) {
            None => return out.push(Out::Refused("it is not a packet of the source's worker")),
            Some(FromWorker::Refused(why)) => return out.push(Out::RefusedOf(self.robot, why.why())),
            Some(FromWorker::Opened | FromWorker::Closed(_)) => return,
            Some(FromWorker::Frames(bytes)) => bytes,
        };
        let mut splitter = std::mem::take(&mut self.splitter);
        splitter.take(bytes, |found| {
            let Found::Frame(frame) = found else { return };
            let taken = match parse(frame) {
                Ok(received) if received.component != AUTOPILOT => Ok(()),
                Ok(received) => self.message(now, &received.message, out),
                Err(why) => Err(why),
            };
            if let Err(why) = taken {
                out.push(Out::RefusedOf(self.robot, why));
            }
        });
        splitter.end();
        self.splitter = splitter;
    }

    fn quality(&self, _: RobotId) -> Quality {
        let position_m = match self.config.fix_least.and(self.fix).and_then(|(_, fix)| fix) {
            Some(Fix::ThreeD) => 3.0,
            Some(Fix::Dgps) => 1.0,
            Some(Fix::RtkFloat) => 0.3,
            Some(Fix::RtkFixed) | None => Quality::MEASURED.position_m,
        };
        Quality { position_m, heading_rad: HEADING_RAD, ..Quality::MEASURED }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::{Framer, Version};
    use mavlink::dialects::common::{
        ATTITUDE_DATA, GLOBAL_POSITION_INT_DATA, GPS_RAW_INT_DATA, LOCAL_POSITION_NED_DATA,
    };
    use murmurate::messages::wire::Reading;

    fn source(more: &str) -> Autopilot {
        let table = format!("address = 'udpin://127.0.0.1:14560'\n{more}").parse().expect("TOML");
        let config = SourceConfig::read(&Settings { name: "mavlink".to_owned(), table }).expect("settings");
        Autopilot::new(RobotId(3), config)
    }

    fn take(source: &mut Autopilot, ms: u64, message: MavMessage) -> Result<Option<Reading>, &'static str> {
        let frame = Framer::new(1, 1, Version::Two).frame(0, &message);
        let (now, mut out) = (Time::ZERO + Span::from_millis(ms), Vec::new());
        source.take(now, In::Packet(&FromWorker::Frames(&frame).encode()), &mut out);
        match out.pop() {
            None => Ok(None),
            Some(Out::Reading(reading)) => Ok(Some(reading)),
            Some(Out::RefusedOf(RobotId(3), why) | Out::Refused(why)) => Err(why),
            other => panic!("{other:?}"),
        }
    }

    fn at(time_boot_ms: u32, x: f32, y: f32) -> MavMessage {
        let moving = LOCAL_POSITION_NED_DATA { time_boot_ms, x, y, vx: 0.5, ..LOCAL_POSITION_NED_DATA::DEFAULT };
        MavMessage::LOCAL_POSITION_NED(moving)
    }

    fn gps(fix_type: GpsFixType) -> MavMessage {
        MavMessage::GPS_RAW_INT(GPS_RAW_INT_DATA { fix_type, ..GPS_RAW_INT_DATA::DEFAULT })
    }

    const ORIGIN: &str = "origin_latitude_deg = 52.2053\norigin_longitude_deg = 0.1218\n";
    const FIXED: GpsFixType = GpsFixType::GPS_FIX_TYPE_RTK_FIXED;

    #[test]
    fn indoors_a_place_is_from_the_autopilots_origin_in_the_teams_frame() {
        let mut source = source("origin_m = [1.0, 2.0]");
        take(&mut source, 0, MavMessage::ATTITUDE(ATTITUDE_DATA::DEFAULT)).expect("sound");
        let reading = take(&mut source, 10, at(100, 3.0, 4.0)).expect("sound").expect("new");
        assert_eq!((reading.pose.position.x, reading.pose.position.y), (5.0, 5.0), "east is x");
        assert_eq!((reading.twist.velocity.x, reading.twist.velocity.y), (0.0, 0.5), "north is y");
        assert!((reading.pose.heading.expect("fresh") - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
        assert_eq!((reading.robot, reading.stamp_ns), (RobotId(3), 100_000_000));
    }

    #[test]
    fn outdoors_a_place_needs_the_autopilots_origin_and_a_fix() {
        let mut source = source(ORIGIN);
        let why = take(&mut source, 0, at(0, 0.0, 0.0)).expect_err("no fix");
        assert!(why.contains("GPS_RAW_INT"), "{why}");
        take(&mut source, 0, gps(GpsFixType::GPS_FIX_TYPE_RTK_FLOAT)).expect("sound");
        assert!(take(&mut source, 1, at(1, 0.0, 0.0)).expect_err("float").contains("fix_least"));
        take(&mut source, 1, gps(FIXED)).expect("sound");
        assert!(take(&mut source, 2, at(2, 0.0, 0.0)).expect_err("no origin").contains("GPS_GLOBAL_ORIGIN"));
        let origin = GPS_GLOBAL_ORIGIN_DATA { latitude: 522_054_000, longitude: 1_218_000, altitude: 12_000 };
        take(&mut source, 3, MavMessage::GPS_GLOBAL_ORIGIN(origin)).expect("sound");
        let reading = take(&mut source, 4, at(4, 2.0, 1.0)).expect("sound").expect("new");
        // 1e-4 degrees of latitude are 11.127 m there (the tests of geodesy).
        let [x, y] = [reading.pose.position.x, reading.pose.position.y];
        assert!((x - 1.0).abs() < 1e-3 && (y - 13.127).abs() < 2e-3, "{x} {y}");
        assert!(take(&mut source, 2100, at(2100, 0.0, 0.0)).expect_err("old fix").contains("GPS_RAW_INT"));
    }

    #[test]
    fn a_global_position_is_put_where_it_is_and_a_far_one_is_refused() {
        let mut source = source(&format!("{ORIGIN}position = 'global'"));
        take(&mut source, 0, gps(FIXED)).expect("sound");
        let position = |time_boot_ms, lat, lon| {
            let place = GLOBAL_POSITION_INT_DATA { time_boot_ms, lat, lon, vx: 50, vy: -25, ..Default::default() };
            MavMessage::GLOBAL_POSITION_INT(place)
        };
        let reading = take(&mut source, 5, position(5, 522_054_000, 1_219_000)).expect("sound").expect("new");
        let [x, y] = [reading.pose.position.x, reading.pose.position.y];
        assert!((x - 6.835).abs() < 1e-2 && (y - 11.127).abs() < 1e-2, "{x} {y}");
        assert_eq!((reading.twist.velocity.x, reading.twist.velocity.y), (-0.25, 0.5));
        for (lat, lon, part) in [(0, 0, "zero"), (-522_054_000, 1_219_000, "100 km"), (i32::MAX, 0, "none")] {
            let why = take(&mut source, 6, position(6, lat, lon)).expect_err("no place");
            assert!(why.contains(part), "{why}");
        }
        assert_eq!(take(&mut source, 7, at(7, 0.0, 0.0)), Ok(None), "the other position is not used");
    }

    #[test]
    fn a_restarted_autopilot_has_to_say_its_origin_again() {
        let mut source = source(ORIGIN);
        let origin = GPS_GLOBAL_ORIGIN_DATA { latitude: 522_053_000, longitude: 1_218_000, altitude: 0 };
        take(&mut source, 0, gps(FIXED)).expect("sound");
        take(&mut source, 0, MavMessage::GPS_GLOBAL_ORIGIN(origin)).expect("sound");
        assert!(take(&mut source, 1, at(60_000, 0.0, 0.0)).expect("sound").is_some());
        assert!(take(&mut source, 2, at(50, 0.0, 0.0)).expect_err("restarted").contains("GPS_GLOBAL_ORIGIN"));
    }
}
