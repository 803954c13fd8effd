//! Session with one autopilot: the part of the driver that does no I/O.
//!
//! It sends setpoints at a rate of its own while this host commands the vehicle, or prepares to. Each has the newest
//! velocity, or zero once that has expired. After a takeover it sends none.

mod airborne;

use mavlink::dialects::common::{
    COMMAND_ACK_DATA, HEARTBEAT_DATA, MavCmd, MavMessage, MavModeFlag, MavResult, MavState,
};
use murmurate::drivers::{Command, Driver, Limits, Out, Vertical};
use murmurate::messages::geometry::{Vec2, limit_below};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{Flight, Hardware, Health, Reason};
use murmurate::time::{Span, Time};

use super::axes::{Axes, flipped};
use super::control::{Control, Order, Seen};
use super::firmware::{Mode, mismatch};
use super::frames::{Found, Framer, Splitter, Version, parse};
use super::lift::Lift;
use super::link::{FromWorker, Hold, Refusal, ToWorker};
use super::orders::{self, Wanted};
use super::requests::Requests;
use super::settings::{AUTOPILOT, DriverConfig, Vehicle};
use super::telemetry::{Charge, Telemetry, local};

/// Period of this host's heartbeat.
const HEARTBEAT: Span = Span::from_millis(1000);
/// Time without any frame of the autopilot after which it is silent: its heartbeat comes once a second at least.
const SILENCE: Span = Span::from_millis(1500);
/// Time without a heartbeat after which it is silent, whatever else it sends.
const NO_HEARTBEAT: Span = Span::from_millis(3500);
/// Shortest time between two setpoints: that of commands at 50 Hz.
const SHORTEST: Span = Span::from_millis(20);

/// Part without I/O of the driver of one robot.
pub struct Session {
    robot: RobotId,
    config: DriverConfig,
    control: Control,
    telemetry: Telemetry,
    charge: Charge,
    requests: Requests,
    splitter: Splitter,
    /// Reason for which the link is not open, as the worker says it; `None` while it is open.
    closed: Option<String>,
    /// Last refusal of frames since the autopilot was heard; `None` if none.
    refusal: Option<Refusal>,
    /// Arrivals of the last heartbeat, and of the last frame of any kind; `None` before the first heartbeat.
    heard: Option<(Time, Time)>,
    /// Reason for which the autopilot is none that these settings are for; `None` if it is.
    wrong: Option<String>,
    /// Last warning that the autopilot has sent as text.
    text: String,
    /// Motion that is wanted, with the end of its validity; `None` to stand.
    wanted: Option<(Wanted, Time)>,
    /// Time of the last setpoint, and whether it was to stand.
    sent: Option<(Time, bool)>,
    /// Time of the next heartbeat of this host.
    beat: Time,
    /// Whether the worker has the frame that makes the vehicle stand.
    prepared: bool,
    /// Last condition that was reported.
    told: Option<Hardware>,
    /// Whether the robot was ready since the start of its host.
    was_ready: bool,
    /// Height of a copter; `None` of a rover.
    lift: Option<Lift>,
    /// Last state of the flight that was reported.
    flight: Option<Flight>,
}

impl Session {
    /// Makes a session with an autopilot that has not been heard.
    pub fn new(robot: RobotId, config: DriverConfig) -> Session {
        let config = DriverConfig {
            speed_m_s: limit_below(config.speed_m_s),
            yaw_rate_rad_s: limit_below(config.yaw_rate_rad_s),
            ..config
        };
        Session {
            robot,
            control: Control::new(config.firmware, config.vehicle, config.arm),
            telemetry: Telemetry::new(robot, Axes::default()),
            charge: Charge::default(),
            requests: Requests::new(config.firmware, config.vehicle),
            splitter: Splitter::default(),
            closed: Some("its link is not open yet".to_owned()),
            refusal: None,
            heard: None,
            wrong: None,
            text: String::new(),
            wanted: None,
            sent: None,
            beat: Time::ZERO,
            prepared: false,
            told: None,
            was_ready: false,
            lift: (config.vehicle == Vehicle::Copter).then(|| Lift::new(config.firmware)),
            flight: None,
            config,
        }
    }

    fn is_silent(&self, now: Time) -> bool {
        self.heard.is_none_or(|(beat, any)| now.since(any) >= SILENCE || now.since(beat) >= NO_HEARTBEAT)
    }

    /// Whether setpoints are sent.
    fn streams(&self) -> bool {
        let may = self.heard.is_some() && self.closed.is_none() && self.wrong.is_none();
        may && self.control.streams() && !self.lift.as_ref().is_some_and(|lift| lift.lands() || lift.rises_by_itself())
    }

    fn health(&self, now: Time) -> (Health, Option<String>) {
        if let Some(why) = &self.closed {
            return (Health::Silent, Some(why.clone()));
        }
        if self.is_silent(now) {
            let why = match (self.refusal, self.heard) {
                (Some(Refusal::Damaged) | None, None) => {
                    format!("no heartbeat of system {} at {}", self.config.link.system, self.config.link.address)
                }
                (Some(Refusal::Damaged) | None, Some(_)) => "the autopilot is silent".to_owned(),
                (Some(refusal), _) => refusal.why().to_owned(),
            };
            return (Health::Silent, Some(why));
        }
        let emergency = || {
            let seen = self.control.seen().filter(|seen| seen.failsafe)?;
            let text = if self.text.is_empty() { "no text" } else { &self.text };
            Some(format!("it reports a failsafe in {}: {text}", self.name(seen.mode)))
        };
        let fault = self.wrong.clone().or_else(|| self.control.fault()).or_else(emergency);
        (if fault.is_some() { Health::Faulty } else { Health::Ready }, fault)
    }

    fn name(&self, mode: Mode) -> String {
        mode.name(self.config.firmware, self.config.vehicle)
    }

    /// Reports the condition if it has changed.
    fn report(&mut self, now: Time, out: &mut Vec<Out>) {
        let (health, why) = self.health(now);
        let reason = why.as_deref().and_then(Reason::new);
        let hardware = Hardware { health, battery: self.charge.percent(), temperature: None, reason };
        if self.told.as_ref() != Some(&hardware) {
            // Before it was ready for the first time, its state is no news.
            self.was_ready |= health == Health::Ready;
            if let Some(why) =
                why.filter(|_| self.was_ready && self.told.as_ref().map(|told| &told.reason) != Some(&hardware.reason))
            {
                tracing::error!("{}: {why}", self.robot);
            }
            self.told = Some(hardware.clone());
            out.push(Out::Condition(hardware));
        }
    }

    fn encoded(&self, message: &MavMessage) -> Vec<u8> {
        let (system, component) = self.config.link.own;
        Framer::new(system, component, Version::Two).frame(0, message)
    }

    fn send(&self, hold: Hold, messages: &[MavMessage], out: &mut Vec<Out>) {
        let frames: Vec<u8> = messages.iter().flat_map(|message| self.encoded(message)).collect();
        out.push(Out::Send(ToWorker::Send(hold, &frames).encode()));
    }

    /// Returns the motion that is valid at `now`.
    fn valid(&self, now: Time) -> Option<(Wanted, Time)> {
        let may = self.control.is_ready() && !self.is_silent(now) && self.lift.as_ref().is_none_or(Lift::is_driven);
        self.wanted.filter(|(_, until)| *until > now && may)
    }

    /// Sends the setpoint of the moment.
    fn set(&mut self, now: Time, out: &mut Vec<Out>) {
        let (wanted, hold) = match self.valid(now) {
            Some((wanted, until)) => (wanted, Hold::For(until.since(now))),
            None => (Wanted::STAND, Hold::Standing),
        };
        let climb_m_s = self.lift.as_ref().map_or(0.0, |lift| lift.climb_m_s(now));
        if !self.prepared {
            self.prepared = true;
            let stand = orders::setpoint(&self.config, now, &Wanted::STAND);
            out.push(Out::Send(ToWorker::Stand(&self.encoded(&stand)).encode()));
        }
        self.sent = Some((now, hold == Hold::Standing));
        self.send(hold, &[orders::setpoint(&self.config, now, &Wanted { climb_m_s, ..wanted })], out);
    }

    /// Returns the time at which the next setpoint is due; `None` if none are sent.
    fn setpoint_at(&self) -> Option<Time> {
        let period = Span::from_secs(1.0 / f64::from(self.config.setpoint_hz));
        let expires = self.wanted.map(|(_, until)| until).filter(|_| self.sent.is_some_and(|(_, stands)| !stands));
        let next = self.sent.map_or(Time::ZERO, |(at, _)| at + period);
        self.streams().then(|| expires.map_or(next, |until| until.min(next)))
    }

    /// Stops what the worker would send by itself when a motion's validity ends.
    fn forget(&mut self, out: &mut Vec<Out>) {
        if self.sent.take().is_some() {
            self.wanted = None;
            self.send(Hold::Standing, &[], out);
        }
    }

    fn frames(&mut self, now: Time, bytes: &[u8], out: &mut Vec<Out>) {
        let mut splitter = std::mem::take(&mut self.splitter);
        splitter.take(bytes, |found| match found {
            Found::Frame(frame) => match parse(frame) {
                Ok(received) if (received.system, received.component) == (self.config.link.system, AUTOPILOT) => {
                    if let Err(why) = self.message(now, &received.message, out) {
                        out.push(Out::Refused(why));
                    }
                }
                Ok(_) => {}
                Err(why) => out.push(Out::Refused(why)),
            },
            Found::Unknown | Found::Damaged => out.push(Out::Refused("the worker's frame is none")),
        });
        splitter.end();
        self.splitter = splitter;
    }

    fn message(&mut self, now: Time, message: &MavMessage, out: &mut Vec<Out>) -> Result<(), &'static str> {
        if let Some((_, any)) = &mut self.heard {
            *any = now;
        }
        match message {
            MavMessage::HEARTBEAT(heartbeat) => self.heartbeat(now, heartbeat),
            MavMessage::CURRENT_MODE(mode) => {
                // It says nothing of arming, so that a heartbeat has to come first.
                if let Some(seen) = self.control.seen() {
                    self.control.see(now, Seen { mode: Mode(mode.custom_mode), ..seen });
                }
            }
            MavMessage::ATTITUDE(attitude) => self.telemetry.attitude(now, attitude)?,
            MavMessage::LOCAL_POSITION_NED(position) => {
                if self.telemetry.restarted(position.time_boot_ms) {
                    self.control.restarted();
                    self.requests.begin_again();
                }
                self.lift.iter_mut().for_each(|lift| lift.height(now, flipped(position.z.into())));
                let (place, velocity) = local(position);
                let place = Axes::default().to_team(place);
                let reading = self.telemetry.reading(now, position.time_boot_ms, place, velocity)?;
                out.extend(reading.map(Out::Odometry));
            }
            MavMessage::EXTENDED_SYS_STATE(state) => {
                self.lift.iter_mut().for_each(|lift| lift.landed(state.landed_state));
            }
            MavMessage::BATTERY_STATUS(status) => self.charge.battery(status)?,
            MavMessage::SYS_STATUS(status) => self.charge.system(status)?,
            MavMessage::PARAM_VALUE(value) => self.requests.take(value),
            MavMessage::COMMAND_ACK(answer) => self.answered(answer),
            MavMessage::STATUSTEXT(text) if text.severity as u32 <= 4 => {
                let said = text.text.to_str().unwrap_or_default();
                self.text = said.chars().map(|c| if c.is_ascii_graphic() { c } else { ' ' }).collect();
            }
            _ => {}
        }
        Ok(())
    }

    fn heartbeat(&mut self, now: Time, heartbeat: &HEARTBEAT_DATA) {
        (self.heard, self.refusal) = (Some((now, now)), None);
        self.wrong = mismatch(heartbeat, self.config.firmware, self.config.vehicle);
        let failsafe = matches!(heartbeat.system_status, MavState::MAV_STATE_CRITICAL | MavState::MAV_STATE_EMERGENCY);
        let armed = heartbeat.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
        if self.wrong.is_none() {
            self.control.see(now, Seen { mode: Mode(heartbeat.custom_mode), armed, failsafe });
            self.armed(now, armed);
        }
    }

    fn answered(&mut self, answer: &COMMAND_ACK_DATA) {
        let order = match answer.command {
            MavCmd::MAV_CMD_DO_SET_MODE => Order::Mode,
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => Order::Arm,
            _ => return,
        };
        let Some(why) = refusal(answer.result) else { return };
        let why = if self.text.is_empty() { why.to_owned() } else { format!("{why}, {}", self.text) };
        self.control.refuse(order, &why);
    }

    /// Sends what is due beside setpoints: heartbeats, requests and orders.
    fn advance(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.closed.is_some() {
            return;
        }
        let mut messages = Vec::new();
        if self.beat <= now {
            self.beat = now + HEARTBEAT;
            messages.push(orders::heartbeat());
        }
        if self.heard.is_some() && self.wrong.is_none() {
            let due = self.requests.wake(now);
            if due.rates {
                messages.extend(orders::intervals(&self.config.link, self.config.position_hz));
            }
            messages.extend(due.parameters.iter().map(|name| orders::parameter(&self.config.link, name)));
            if let Some(finding) = self.requests.finding() {
                tracing::warn!("{}: {finding}", self.robot);
            }
            match self.control.wake(now) {
                Some(Order::Mode) => {
                    let mode = Mode::followed(self.config.firmware, self.config.vehicle);
                    messages.push(orders::set_mode(&self.config, mode));
                }
                Some(Order::Arm) => messages.push(orders::arm(&self.config.link)),
                None => {}
            }
        }
        messages.extend(self.takes_off(now));
        if !messages.is_empty() {
            self.send(Hold::Keep, &messages, out);
        }
    }

    /// Does what the moment asks for, and reports the condition.
    fn go_on(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.is_silent(now) {
            self.control.silent();
        }
        self.advance(now, out);
        if !self.streams() {
            self.forget(out);
        } else if self.setpoint_at().is_some_and(|at| at <= now) {
            self.set(now, out);
        }
        self.report(now, out);
        self.report_flight(out);
    }
}

/// Returns the refusal of a command in words; `None` if it is accepted.
fn refusal(result: MavResult) -> Option<&'static str> {
    match result {
        MavResult::MAV_RESULT_ACCEPTED | MavResult::MAV_RESULT_IN_PROGRESS => None,
        MavResult::MAV_RESULT_TEMPORARILY_REJECTED => Some("not now"),
        MavResult::MAV_RESULT_DENIED => Some("denied"),
        MavResult::MAV_RESULT_UNSUPPORTED => Some("unsupported"),
        _ => Some("failed"),
    }
}

impl Driver for Session {
    fn limits(&self) -> Limits {
        Limits { speed_m_s: self.config.speed_m_s }
    }

    fn drive(&mut self, now: Time, command: &Command, out: &mut Vec<Out>) {
        let Command { drive, body } = command;
        let moves = drive.until > now && drive.velocity != Vec2::zeros();
        let wanted = Wanted { velocity: drive.velocity, body: *body, climb_m_s: 0.0 };
        self.wanted = moves.then_some((wanted, drive.until));
        if !self.streams() {
            return;
        }
        // To stand is sent at once; a new velocity within the rate of commands.
        let stops = !moves && self.sent.is_some_and(|(_, stands)| !stands);
        let paced = self.sent.is_none_or(|(at, _)| now.since(at) >= SHORTEST);
        if stops || (moves && paced) {
            self.set(now, out);
        }
    }

    fn receive(&mut self, now: Time, packet: &[u8], out: &mut Vec<Out>) {
        match FromWorker::decode(packet) {
            None => out.push(Out::Refused("it is not a packet of the driver's worker")),
            Some(FromWorker::Opened) => {
                (self.closed, self.beat, self.prepared) = (None, now, false);
                // The Body takes a worker that has begun again for silent until it hears more.
                self.told = None;
            }
            Some(FromWorker::Closed(why)) => {
                self.closed = Some(String::from_utf8_lossy(why).into_owned());
                self.control.silent();
            }
            Some(FromWorker::Refused(why)) => {
                self.refusal = Some(why);
                out.push(Out::Refused(why.why()));
            }
            Some(FromWorker::Frames(frames)) => self.frames(now, frames, out),
        }
        self.go_on(now, out);
    }

    fn flies(&self) -> bool {
        self.lift.is_some()
    }

    fn fly(&mut self, now: Time, order: Vertical, out: &mut Vec<Out>) {
        self.steer(now, order, out);
    }

    fn wake_at(&self) -> Option<Time> {
        if self.closed.is_some() {
            return None;
        }
        let silent = self.heard.map(|(beat, any)| (any + SILENCE).min(beat + NO_HEARTBEAT));
        let silent = silent.filter(|_| self.told.as_ref().is_some_and(|told| told.health != Health::Silent));
        let requests = self.heard.filter(|_| self.wrong.is_none()).map(|_| self.requests.wake_at());
        let control = self.control.wake_at().filter(|_| self.wrong.is_none());
        [Some(self.beat), silent, requests, control, self.setpoint_at()].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        self.go_on(now, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Firmware, tests_config};
    use mavlink::dialects::common::{
        BATTERY_STATUS_DATA, CURRENT_MODE_DATA, LOCAL_POSITION_NED_DATA, MavAutopilot, MavType,
        SET_POSITION_TARGET_LOCAL_NED_DATA,
    };
    use murmurate::messages::local::Drive;

    const MANUAL: u32 = 1 << 16;
    const OFFBOARD: u32 = 6 << 16;

    /// Session and its autopilot under virtual time.
    struct Bench {
        session: Session,
        now: Time,
        /// Mode and arming that the autopilot says; it obeys no order by itself.
        mode: u32,
        armed: bool,
        said: Vec<(Time, MavMessage)>,
        conditions: Vec<Hardware>,
        refused: Vec<&'static str>,
        odometry: usize,
        flights: Vec<Flight>,
        kind: MavType,
    }

    impl Bench {
        fn new(more: &str) -> Bench {
            let mut bench = Bench {
                session: Session::new(RobotId(0), tests_config(more)),
                now: Time::ZERO,
                mode: MANUAL,
                armed: false,
                said: Vec::new(),
                conditions: Vec::new(),
                refused: Vec::new(),
                odometry: 0,
                flights: Vec::new(),
                kind: MavType::MAV_TYPE_GROUND_ROVER,
            };
            bench.packet(&FromWorker::Opened.encode());
            bench
        }

        fn note(&mut self, out: Vec<Out>) {
            for output in out {
                match output {
                    Out::Send(packet) => match ToWorker::decode(&packet).expect("a packet for the worker") {
                        ToWorker::Send(_, frames) => Splitter::default().take(frames, |found| match found {
                            Found::Frame(frame) => {
                                self.said.push((self.now, parse(frame).expect("sound").message));
                            }
                            other => panic!("{other:?}"),
                        }),
                        ToWorker::Stand(_) => {}
                    },
                    Out::Condition(hardware) => self.conditions.push(hardware),
                    Out::Refused(why) => self.refused.push(why),
                    Out::Odometry(_) => self.odometry += 1,
                    Out::Flight(flight) => self.flights.push(flight),
                    other => panic!("{other:?}"),
                }
            }
        }

        fn packet(&mut self, packet: &[u8]) {
            let mut out = Vec::new();
            self.session.receive(self.now, packet, &mut out);
            self.note(out);
        }

        fn hear(&mut self, message: &MavMessage) {
            let frame = Framer::new(1, 1, Version::Two).frame(0, message);
            self.packet(&FromWorker::Frames(&frame).encode());
        }

        fn heartbeat(&mut self) {
            let armed = if self.armed { MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED } else { MavModeFlag::empty() };
            self.hear(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
                custom_mode: self.mode,
                mavtype: self.kind,
                autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
                base_mode: armed,
                system_status: MavState::MAV_STATE_ACTIVE,
                mavlink_version: 3,
            }));
        }

        /// Goes on by a time in which the autopilot sends heartbeats twice a second, if it `lives`. Wakes are in time.
        fn run(&mut self, ms: u64, lives: bool) {
            for _ in 0..ms {
                self.now += Span::from_millis(1);
                if lives && (self.now.as_nanos() / 1_000_000).is_multiple_of(500) {
                    self.heartbeat();
                }
                let mut out = Vec::new();
                while self.session.wake_at().is_some_and(|at| at <= self.now) && out.len() < 100 {
                    self.session.wake(self.now, &mut out);
                }
                assert!(out.len() < 100, "it wakes without end");
                self.note(out);
            }
        }

        fn drive(&mut self, x: f32, y: f32) {
            let (velocity, until) = (Vec2::new(x, y), self.now + Span::from_millis(200));
            let drive = Drive { robot: RobotId(0), velocity, until };
            let mut out = Vec::new();
            self.session.drive(self.now, &Command { drive, body: None }, &mut out);
            self.note(out);
        }

        fn fly(&mut self, order: Vertical) {
            let mut out = Vec::new();
            self.session.fly(self.now, order, &mut out);
            self.note(out);
        }

        fn height(&mut self, time_boot_ms: u32, height_m: f32) {
            let place = LOCAL_POSITION_NED_DATA { time_boot_ms, z: -height_m, ..Default::default() };
            self.hear(&MavMessage::LOCAL_POSITION_NED(place));
        }

        fn setpoints(&self) -> Vec<(Time, SET_POSITION_TARGET_LOCAL_NED_DATA)> {
            let all = self.said.iter().filter_map(|(at, message)| match message {
                MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint) => Some((*at, setpoint.clone())),
                _ => None,
            });
            all.collect()
        }

        fn reason(&self) -> (Health, &str) {
            let last = self.conditions.last().expect("a condition");
            (last.health, last.reason.as_ref().map_or("", Reason::text))
        }

        /// Brings a rover to where it follows.
        fn ready(more: &str) -> Bench {
            let mut bench = Bench::new(more);
            bench.run(600, true);
            (bench.mode, bench.armed) = (OFFBOARD, true);
            bench.run(1000, true);
            assert_eq!(bench.reason(), (Health::Ready, ""));
            bench
        }
    }

    #[test]
    fn setpoints_are_sent_for_a_second_before_the_mode_is_asked_for() {
        let mut bench = Bench::new("");
        bench.run(2000, true);
        let asked = bench
            .said
            .iter()
            .position(|(_, m)| matches!(m, MavMessage::COMMAND_LONG(c) if c.command == MavCmd::MAV_CMD_DO_SET_MODE));
        let asked = bench.said[asked.expect("it is asked for")].0;
        let before: Vec<_> = bench.setpoints().into_iter().filter(|(at, _)| *at <= asked).collect();
        assert!((20..=22).contains(&before.len()), "{}", before.len());
        assert!(before.iter().all(|(_, setpoint)| (setpoint.vx, setpoint.vy) == (0.0, 0.0)));
        let arms = bench.said.iter().any(
            |(_, m)| matches!(m, MavMessage::COMMAND_LONG(c) if c.command == MavCmd::MAV_CMD_COMPONENT_ARM_DISARM),
        );
        assert!(!arms, "arm is not set");
    }

    #[test]
    fn a_velocity_is_sent_at_once_repeated_and_zero_once_it_has_expired() {
        let mut bench = Bench::ready("");
        bench.run(30, true);
        let (from, driven) = (bench.setpoints().len(), bench.now);
        bench.drive(0.5, 0.0);
        bench.run(400, true);
        let sent = bench.setpoints().split_off(from);
        assert_eq!((sent[0].1.vx, sent[0].1.vy), (0.0, 0.5), "x is east");
        let stopped = sent.iter().position(|(_, setpoint)| setpoint.vy == 0.0).expect("it expires");
        assert_eq!(sent[stopped].0.since(driven), Span::from_millis(200));
        assert!(sent[stopped..].iter().all(|(_, setpoint)| setpoint.vy == 0.0));
        assert!(sent.windows(2).all(|pair| pair[1].0.since(pair[0].0) <= Span::from_millis(50)));
        bench.drive(0.5, 0.0);
        bench.drive(0.0, 0.0);
        assert_eq!(bench.setpoints().last().expect("sent").1.vy, 0.0, "to stand is sent at once");
    }

    #[test]
    fn a_pilot_who_takes_over_is_obeyed_with_the_message_that_says_so() {
        let mut bench = Bench::ready("arm = true");
        bench.drive(0.5, 0.5);
        let mode = CURRENT_MODE_DATA { custom_mode: MANUAL, ..CURRENT_MODE_DATA::DEFAULT };
        bench.hear(&MavMessage::CURRENT_MODE(mode));
        bench.mode = MANUAL;
        let (after, said) = (bench.setpoints().len(), bench.said.len());
        assert_eq!(bench.reason(), (Health::Faulty, "the pilot took over: mode MANUAL"));
        for k in 0..50 {
            bench.drive(0.5, 0.5);
            bench.run(100, true);
            // He changes his mind, and disarms and arms.
            (bench.mode, bench.armed) = (if k % 7 == 3 { OFFBOARD } else { MANUAL }, k % 5 != 0);
        }
        assert_eq!(bench.setpoints().len(), after, "no setpoint, ever");
        let commands = bench.said[said..].iter().filter(|(_, m)| {
            matches!(m, MavMessage::COMMAND_LONG(c) if c.command != MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL
                && c.command != MavCmd::MAV_CMD_REQUEST_MESSAGE)
        });
        assert_eq!(commands.count(), 0, "nor any order");
        assert_eq!(bench.reason(), (Health::Faulty, "the pilot took over: mode MANUAL"));
    }

    #[test]
    fn silence_is_a_condition_and_setpoints_are_zero_meanwhile() {
        let mut bench = Bench::ready("");
        bench.run(1300, false);
        assert_eq!(bench.reason().0, Health::Ready);
        bench.run(200, false);
        assert_eq!(bench.reason(), (Health::Silent, "the autopilot is silent"));
        bench.drive(0.5, 0.0);
        assert_eq!(bench.setpoints().last().expect("sent").1.vy, 0.0);
        bench.heartbeat();
        assert_eq!(bench.reason(), (Health::Ready, ""), "it is back, in the same mode");
    }

    #[test]
    fn other_firmware_and_other_vehicles_are_named_and_get_nothing() {
        for (more, part) in [("autopilot = 'ardupilot'", "firmware is Px4"), ("vehicle = 'copter'", "it is a rover")] {
            let mut bench = Bench::new(more);
            bench.run(3000, true);
            assert!(bench.reason().0 == Health::Faulty && bench.reason().1.contains(part), "{:?}", bench.reason());
            assert!(bench.setpoints().is_empty());
        }
    }

    #[test]
    fn refused_frames_are_counted_and_are_the_reason_of_silence() {
        let mut bench = Bench::new("");
        assert!(bench.reason().1.contains("no heartbeat of system 1"), "{:?}", bench.reason());
        bench.packet(&FromWorker::Refused(Refusal::Unsigned).encode());
        assert!(bench.reason().0 == Health::Silent && bench.reason().1.contains("unsigned"), "{:?}", bench.reason());
        assert_eq!(bench.refused, [Refusal::Unsigned.why()]);
        bench.packet(&FromWorker::Closed(b"/dev/ttyACM0: no such file").encode());
        assert_eq!(bench.reason(), (Health::Silent, "/dev/ttyACM0: no such file"));
        bench.packet(b"junk");
        assert_eq!(bench.refused.len(), 2);
    }

    #[test]
    fn a_battery_and_odometry_are_passed_on_and_what_lies_is_refused() {
        let mut bench = Bench::ready("");
        let battery = |battery_remaining| {
            MavMessage::BATTERY_STATUS(BATTERY_STATUS_DATA { battery_remaining, ..Default::default() })
        };
        bench.hear(&battery(55));
        assert_eq!(bench.conditions.last().expect("a condition").battery, Some(55));
        bench.hear(&battery(120));
        let at = |time_boot_ms, x| {
            MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA { time_boot_ms, x, ..Default::default() })
        };
        [at(5000, 1.0), at(5000, 1.0), at(5020, f32::NAN), at(5040, 1.0)].iter().for_each(|m| bench.hear(m));
        assert_eq!((bench.odometry, bench.refused.len()), (2, 2), "{:?}", bench.refused);
        bench.hear(&at(10, 0.0));
        assert_eq!(bench.reason(), (Health::Faulty, "it has restarted; start its host again"));
    }

    #[test]
    fn an_autopilot_that_refuses_is_quoted() {
        let mut bench = Bench::new("arm = true");
        bench.mode = OFFBOARD;
        bench.run(600, true);
        let text = mavlink::types::CharArray::from("PreArm: no GPS");
        let severity = mavlink::dialects::common::MavSeverity::MAV_SEVERITY_CRITICAL;
        bench.hear(&MavMessage::STATUSTEXT(mavlink::dialects::common::STATUSTEXT_DATA { severity, text }));
        bench.hear(&MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
            result: MavResult::MAV_RESULT_FAILED,
        }));
        assert_eq!(bench.reason(), (Health::Faulty, "it refuses to arm: failed, PreArm: no GPS"));
    }

    #[test]
    fn a_copter_rises_hovers_lands_and_is_cut_only_by_the_order_to_cut() {
        let mut bench = Bench::new("vehicle = 'copter'\narm = true");
        (bench.kind, bench.mode) = (MavType::MAV_TYPE_QUADROTOR, OFFBOARD);
        bench.run(600, true);
        assert_eq!((bench.reason(), bench.flights.last()), ((Health::Ready, ""), Some(&Flight::Grounded)));
        let commands = |bench: &Bench, command| {
            let asks = |m: &MavMessage| matches!(m, MavMessage::COMMAND_LONG(c) if c.command == command);
            bench.said.iter().filter(|(_, m)| asks(m)).count()
        };
        assert_eq!(commands(&bench, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM), 0, "nobody has ordered it to rise");
        bench.fly(Vertical::Rise { height_m: 1.0 });
        bench.run(10, true);
        assert_eq!(commands(&bench, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM), 1);
        bench.armed = true;
        bench.heartbeat();
        bench.height(100, 0.0);
        bench.run(60, true);
        let up = bench.setpoints().last().expect("sent").1.clone();
        assert!(up.vz < -0.5 && bench.flights.last() == Some(&Flight::Rising), "{up:?}");
        bench.drive(0.5, 0.0);
        assert_eq!(bench.setpoints().last().expect("sent").1.vy, 0.0, "it is not at its height");
        bench.height(200, 0.95);
        bench.run(30, true);
        bench.drive(0.5, 0.0);
        assert_eq!((bench.setpoints().last().expect("sent").1.vy, bench.flights.last()), (0.5, Some(&Flight::Flying)));
        let before = bench.setpoints().len();
        bench.fly(Vertical::Land);
        assert_eq!(bench.flights.last(), Some(&Flight::Landing));
        bench.mode = Mode::landing(Firmware::Px4).0;
        bench.run(1000, true);
        assert_eq!(bench.setpoints().len(), before, "the autopilot lands by itself");
        bench.armed = false;
        bench.run(500, true);
        assert_eq!(bench.flights.last(), Some(&Flight::Grounded));
        bench.mode = OFFBOARD;
        bench.run(500, true);
        assert_eq!(bench.reason(), (Health::Ready, ""), "for the next rise");
        let forced = |bench: &Bench| {
            bench
                .said
                .iter()
                .filter(|(_, m)| {
                    matches!(m, MavMessage::COMMAND_LONG(c)
            if c.command == MavCmd::MAV_CMD_COMPONENT_ARM_DISARM && c.param1 == 0.0)
                })
                .count()
        };
        assert_eq!(forced(&bench), 0);
        bench.fly(Vertical::Cut);
        assert_eq!(forced(&bench), 1);
    }
}
