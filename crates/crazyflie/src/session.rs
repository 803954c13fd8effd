//! The driver of one Crazyflie, without I/O: what it sends, when, and what it makes of what the robot says.

use std::cell::RefCell;
use std::rc::Rc;

use murmurate::drivers::{Command, Driver, Limits, Out, Vertical};
use murmurate::messages::geometry::{Planar, Vec2, limit_below, wrapped};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{Flight, Hardware, Health, Reading};
use murmurate::time::{Span, Time};

use crate::axes::{self, Motion};
use crate::connection::{Connection, ESTIMATE_BLOCK, STATUS_BLOCK};
use crate::estimate::{Estimate, Stamps};
use crate::flight::{Flights, Seen};
use crate::link::{FromWorker, ToWorker};
use crate::packet::{Packet, port};
use crate::requests;
use crate::settings::{Config, Height, Poses};
use crate::status::Status;
use crate::toc::Kept;

/// Silence after which a robot counts as one that does not answer: the time after which the firmware levels a robot
/// that hears nothing.
const SILENT: Span = Span::from_millis(500);
/// Time for which a robot in the air may fly without a packet of this driver, before its worker makes it land.
const HOLD: Span = Span::from_millis(400);
/// Age at which an estimate is too old to turn velocities by.
const FRESH: Span = Span::from_millis(250);
/// Age at which a reading of the source is too old to take off by.
const SEEN: Span = Span::from_millis(500);
/// Age at which the condition of the robot is unknown.
const STATUS: Span = Span::from_millis(1000);
/// Time after which a robot that cannot be flown as it is is asked again: it may have new firmware.
const AGAIN: Span = Span::from_millis(2000);
/// Largest distance \[m\] and angle \[rad\] between the robot's estimate and the source at which it takes off.
const APART: (f32, f64) = (0.3, 0.5);
/// Those from which on its estimator begins anew where the source sees the robot, and the least time between that.
const ASTRAY: (f32, f64) = (0.15, 0.25);
const ALIGN: Span = Span::from_millis(2000);
/// Periods of the driver's work on the ground: while it connects, and then.
const CONNECTING: Span = Span::from_millis(20);
const WAITING: Span = Span::from_millis(50);
/// Period at which the condition is repeated.
const REPORT: Span = Span::from_millis(1000);

/// Driver of one Crazyflie.
pub struct Session {
    robot: RobotId,
    config: Config,
    /// Tables of contents that were read before.
    kept: Rc<RefCell<Kept>>,
    connection: Connection,
    /// Version of the robot's protocol, also while it is connected again.
    protocol: u8,
    /// Time of the robot's last packet, and of the beginning before there is one.
    heard: Option<Time>,
    began: Option<Time>,
    /// Reason for which the link carries nothing, if it gives one.
    failed: Option<String>,
    status: Option<(Time, Status)>,
    estimate: Option<(Time, Estimate)>,
    stamps: Stamps,
    flights: Flights,
    /// Whether the robot's state in the air or on the ground was looked at when it was connected first.
    met: bool,
    /// Newest velocity in the world frame \[m/s\] and yaw rate \[rad/s\].
    motion: (Vec2, f32),
    /// Newest reading of the source, with its arrival, and the time of the last pose for the robot.
    reading: Option<(Time, Reading)>,
    posed: Option<Time>,
    aligned: Option<Time>,
    /// Last packet that kept the robot in the air.
    sent: Option<Time>,
    /// Condition that was reported last, with its time.
    told: Option<(Time, Hardware)>,
    /// Reason for which the robot did not take off, as it was logged last.
    refusal: String,
    next: Time,
}

impl Session {
    /// Makes the driver of a robot of which nothing is known, with the tables of contents that were read before.
    pub fn new(robot: RobotId, config: Config, kept: Rc<RefCell<Kept>>) -> Session {
        Session {
            robot,
            kept,
            connection: Connection::new(100 / config.estimate_hz),
            protocol: 0,
            heard: None,
            began: None,
            failed: None,
            status: None,
            estimate: None,
            stamps: Stamps::default(),
            flights: Flights::new(config.climb_m_s),
            met: false,
            motion: (Vec2::zeros(), 0.0),
            reading: None,
            posed: None,
            aligned: None,
            sent: None,
            told: None,
            refusal: String::new(),
            next: Time::ZERO,
            config,
        }
    }

    fn seen(&self, now: Time) -> Seen {
        let status = self.status.filter(|(at, _)| now.since(*at) < STATUS).map(|(_, status)| status);
        Seen {
            height_m: self.fresh(now).map(|estimate| estimate.height_m),
            flies: status.map(|status| status.is_flying()),
            led: status.is_some_and(|status| status.is_led()),
            silent: self.heard.is_none_or(|heard| now.since(heard) >= SILENT),
        }
    }

    fn fresh(&self, now: Time) -> Option<Estimate> {
        self.estimate.filter(|(at, _)| now.since(*at) <= FRESH).map(|(_, estimate)| estimate)
    }

    /// Sends a packet, with the time for which the robot may fly without another one.
    fn send(&self, now: Time, packet: Option<&Packet>, out: &mut Vec<Out>) {
        let crtp = packet.map_or(Vec::new(), Packet::encode);
        let hold = if self.flights.state() == Flight::Grounded { Span::ZERO } else { HOLD };
        let landing = Span::from_secs(f64::from(self.flights.landing_s(&self.seen(now))));
        out.push(Out::Send(ToWorker { hold, landing, crtp: &crtp }.encode()));
    }

    /// Sends the newest setpoint. Without an estimate there is no heading to turn a velocity by: the robot hovers.
    fn fly_on(&mut self, now: Time, out: &mut Vec<Out>) {
        let estimate = self.fresh(now);
        let height_m = self.flights.height_m;
        let (velocity, yaw_rate) = if estimate.is_some() { self.motion } else { (Vec2::zeros(), 0.0) };
        let at = estimate.map_or((0.0, height_m), |estimate| (estimate.heading, estimate.height_m));
        let packet = self.config.setpoint.packet(self.protocol, &Motion { velocity, yaw_rate, height_m }, at);
        self.sent = Some(now);
        self.send(now, Some(&packet), out);
    }

    /// Does all that is due at `now`.
    fn work(&mut self, now: Time, out: &mut Vec<Out>) {
        let began = *self.began.get_or_insert(now);
        // A robot that cannot be flown as it is says nothing, since it is asked nothing: it is asked anew.
        let patience = if self.connection.fault.is_some() { AGAIN } else { SILENT };
        let over = self.connection.is_ready() || self.connection.fault.is_some();
        if over && now.since(self.heard.unwrap_or(began)) >= patience {
            self.connection = Connection::new(100 / self.config.estimate_hz);
        }
        for packet in self.connection.due(now) {
            self.send(now, Some(&packet), out);
        }
        self.align(now);
        let seen = self.seen(now);
        let known = self.connection.is_ready() && seen.flies.is_some() && seen.height_m.is_some();
        if known && !self.met {
            self.met = true;
            self.flights.found(now, &seen);
        }
        let orders = self.flights.due(now, &seen);
        if self.is_to_be_armed() && !orders.is_empty() && self.flights.state() == Flight::Rising {
            self.send(now, Some(&requests::arm(self.protocol)), out);
        }
        for packet in orders {
            self.send(now, Some(&packet), out);
        }
        let period = Span::from_nanos(1_000_000_000 / u64::from(self.config.setpoint_hz));
        if self.sent.is_none_or(|sent| now.since(sent) >= period) {
            match self.flights.state() {
                Flight::Flying => self.fly_on(now, out),
                Flight::Grounded => {}
                _ => {
                    self.sent = Some(now);
                    self.send(now, None, out);
                }
            }
        }
        self.report(now, out);
        let idle = self.connection.is_ready() && !self.connection.is_asking();
        self.next = match self.flights.state() {
            Flight::Grounded => now + if idle { WAITING } else { CONNECTING },
            _ => self.sent.unwrap_or(now) + period,
        };
    }

    fn is_to_be_armed(&self) -> bool {
        self.config.arm && self.status.is_some_and(|(_, status)| status.is_to_be_armed())
    }

    /// Reports the state of the flight if it is known and has changed, and the condition of the robot.
    fn report(&mut self, now: Time, out: &mut Vec<Out>) {
        let hardware = self.condition(now);
        let due = |(at, told): &(Time, Hardware)| *told != hardware || now.since(*at) >= REPORT;
        if self.told.as_ref().is_none_or(due) && !self.is_beginning(now) {
            self.told = Some((now, hardware.clone()));
            out.push(Out::Condition(hardware));
        }
        if self.met {
            out.extend(self.flights.news().map(Out::Flight));
        }
    }

    /// Whether nothing can be said of the robot yet, since the driver has just begun.
    fn is_beginning(&self, now: Time) -> bool {
        let began = self.began.unwrap_or(now);
        !self.met && self.failed.is_none() && self.connection.fault.is_none() && now.since(began) < STATUS
    }

    fn condition(&self, now: Time) -> Hardware {
        let silent = |why: &str| Hardware::of(Health::Silent).because(why);
        let faulty = |why: &str| Hardware::of(Health::Faulty).because(why);
        if let Some(fault) = &self.connection.fault {
            return faulty(fault);
        }
        if self.heard.is_none_or(|heard| now.since(heard) >= SILENT) {
            return silent(self.failed.as_deref().unwrap_or("it does not answer: is it on, and at this address?"));
        }
        match self.status {
            Some((at, status)) if now.since(at) < STATUS && self.estimate.is_some() => {
                let deck = self.config.poses == Poses::None
                    || self.config.height == Height::Estimate
                    || self.connection.measures_height()
                    || !self.connection.is_ready();
                match deck {
                    true => status.hardware(self.config.arm),
                    false => faulty("it has no deck that measures its height"),
                }
            }
            _ => silent("it is being connected"),
        }
    }

    /// Returns how far the robot's own estimate is from a fresh reading of the source \[m, rad\]; `None` without both.
    fn apart(&self, now: Time) -> Option<(f32, f64)> {
        let (_, reading) = self.reading.as_ref().filter(|(at, _)| now.since(*at) < SEEN)?;
        let estimate = self.fresh(now)?;
        let angle = reading.pose.heading.map(|heading| wrapped(f64::from(heading) - f64::from(estimate.heading)));
        Some(((reading.pose.position - estimate.position).norm(), angle.unwrap_or(0.0).abs()))
    }

    /// Begins the estimator of a robot on the ground anew where the source sees it, if its own estimate is elsewhere.
    fn align(&mut self, now: Time) {
        let idle = self.connection.is_ready() && !self.connection.is_asking();
        let due = self.aligned.is_none_or(|at| now.since(at) >= ALIGN);
        let grounded = self.flights.state() == Flight::Grounded && self.seen(now).flies == Some(false);
        let astray = self.apart(now).is_some_and(|(distance, angle)| distance > ASTRAY.0 || angle > ASTRAY.1);
        if self.config.poses == Poses::None || !(idle && due && grounded && astray) {
            return;
        }
        let Some((_, reading)) = &self.reading else { return };
        self.aligned = Some(now);
        let position = reading.pose.position;
        self.connection.set("kalman.initialX", position.x);
        self.connection.set("kalman.initialY", position.y);
        self.connection.set("kalman.initialZ", 0.0);
        if let Some(heading) = reading.pose.heading {
            self.connection.set("kalman.initialYaw", heading);
        }
        self.connection.set("kalman.resetEstimation", 1.0);
        self.connection.set("kalman.resetEstimation", 0.0);
    }

    /// Returns why the robot may not take off now.
    fn obstacle(&self, now: Time) -> Option<String> {
        if !self.connection.is_ready() || self.connection.is_asking() {
            return Some("it is being connected".to_owned());
        }
        let hardware = self.condition(now);
        if hardware.health != Health::Ready {
            return Some(hardware.reason.map_or("it is faulty".to_owned(), |reason| reason.text().to_owned()));
        }
        match (self.config.poses, self.apart(now)) {
            (Poses::None, _) => None,
            (_, None) => Some("the team's source does not see it, or it has no estimate".to_owned()),
            (_, Some((distance, angle))) if distance > APART.0 || angle > APART.1 => Some(format!(
                "its estimate is {distance:.2} m and {:.0} degrees from where the source sees it: is it this robot?",
                angle.to_degrees()
            )),
            _ => None,
        }
    }

    fn take(&mut self, now: Time, packet: &Packet, out: &mut Vec<Out>) {
        self.heard = Some(now);
        self.failed = None;
        if (packet.port, packet.channel) != (port::LOG, 2) {
            self.connection.take(packet, &mut self.kept.borrow_mut());
            self.protocol = if self.connection.protocol > 0 { self.connection.protocol } else { self.protocol };
            return;
        }
        let [block, a, b, c, data @ ..] = &packet.data[..] else {
            return out.push(Out::Refused("a log block is too short"));
        };
        match *block {
            ESTIMATE_BLOCK => match Estimate::decode(data) {
                Some(estimate) => {
                    let reading = estimate.reading(self.robot, self.stamps.take(u32::from_le_bytes([*a, *b, *c, 0])));
                    match reading.unfit() {
                        Some(why) => out.push(Out::Refused(why)),
                        None => {
                            self.estimate = Some((now, estimate));
                            out.push(Out::Odometry(reading));
                        }
                    }
                }
                None => out.push(Out::Refused("an estimate is too short, or no number")),
            },
            STATUS_BLOCK => match Status::decode(data) {
                Some(status) => self.status = Some((now, status)),
                None => out.push(Out::Refused("a condition is too short")),
            },
            _ => {}
        }
    }
}

impl Driver for Session {
    fn limits(&self) -> Limits {
        Limits { speed_m_s: limit_below(self.config.speed_m_s) }
    }

    fn drive(&mut self, now: Time, command: &Command, out: &mut Vec<Out>) {
        let before = self.motion.0;
        // The robot turns by its own heading, so a velocity needs none of the source.
        self.motion = (command.drive.velocity, command.body.map_or(0.0, |body| body.yaw_rate));
        // The newest setpoint leaves with the next period; one that stops the robot leaves at once.
        let stops = self.motion.0 == Vec2::zeros() && before != Vec2::zeros();
        if stops && self.flights.state() == Flight::Flying {
            self.fly_on(now, out);
        }
    }

    fn receive(&mut self, now: Time, packet: &[u8], out: &mut Vec<Out>) {
        match FromWorker::decode(packet) {
            Some(FromWorker::Crtp(bytes)) => match Packet::decode(bytes) {
                Some(packet) => self.take(now, &packet, out),
                None => out.push(Out::Refused("a packet of the robot is empty or too long")),
            },
            Some(FromWorker::Failed(why)) => self.failed = Some(String::from_utf8_lossy(why).into_owned()),
            None => out.push(Out::Refused("a packet of the worker is not understood")),
        }
        if self.began.is_some() {
            self.work(now, out);
        }
    }

    fn flies(&self) -> bool {
        true
    }

    fn fly(&mut self, now: Time, order: Vertical, out: &mut Vec<Out>) {
        let seen = self.seen(now);
        match order {
            Vertical::Rise { height_m } => match self.obstacle(now) {
                None => self.flights.rise(now, height_m, &seen),
                Some(why) => {
                    if self.refusal != why {
                        tracing::warn!("{} does not take off: {why}", self.robot);
                        self.refusal = why;
                    }
                    self.flights.tell();
                }
            },
            Vertical::Land => {
                self.flights.land(now, &seen);
                self.flights.tell();
            }
            Vertical::Cut => {
                self.flights.cut();
                self.flights.tell();
                (0..3).for_each(|_| self.send(now, Some(&requests::cut(self.protocol)), out));
            }
        }
        self.motion = (Vec2::zeros(), 0.0);
        self.work(now, out);
    }

    fn measured(&mut self, now: Time, reading: &Reading, out: &mut Vec<Out>) {
        self.reading = Some((now, reading.clone()));
        let period = Span::from_nanos(1_000_000_000 / u64::from(self.config.pose_hz));
        // A tracker of the same rate jitters: half a period is not too soon.
        let due = self.posed.is_none_or(|at| now.since(at) + Span::from_nanos(period.as_nanos() / 2) >= period);
        let Some(estimate) = self.fresh(now).filter(|_| due && self.connection.is_ready()) else { return };
        let [x, y] = reading.pose.position.to_array();
        let position = [x, y, estimate.height_m];
        let packet = match (self.config.poses, reading.pose.heading) {
            (Poses::None, _) => return,
            (Poses::Extpose, Some(heading)) => requests::pose(position, axes::level(heading)),
            _ => requests::position(position),
        };
        self.posed = Some(now);
        self.send(now, Some(&packet), out);
    }

    fn wake_at(&self) -> Option<Time> {
        Some(self.next)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        self.work(now, out);
    }
}
