//! Body: the motors of one robot, reached through its driver. It runs where the motors are attached: on the robot, or
//! beside the World that simulates it.
//!
//! A Body stops its motors when the last command expires, even if other actors have crashed. It follows the emergency
//! stop itself, so that a command delivered after a stop does not move the robot. It stops while the battery or the
//! temperature is beyond its limit. All motor commands pass through it. The Body of a robot that flies has a pilot
//! (`flight.rs`), which decides when the robot rises and lands.

mod flight;

use crate::actor::Core;
use crate::chassis::Chassis;
use crate::drivers::{self, Command, Driver, Vertical};
use crate::flight as flights;
use crate::messages::geometry::{Planar, Vec2};
use crate::messages::ids::{HostId, RobotId};
use crate::messages::latch::{Latch, LatchFollower};
use crate::messages::local::Drive;
use crate::messages::wire::{Aloft, Flight, Hardware, Health, MotorCommand, Phase, Reading, Stop};
use crate::safety::hardware::{HardwareLimits, HardwareWatch, Permit};
use crate::time::{Span, Time};
use flight::Pilot;

/// Shortest interval between two messages in which a Body reports its engaged or held emergency stop latch to a state
/// server that does not know of it.
const CORRECTION_PERIOD: Span = Span::from_millis(200);

/// Shortest interval at which a Body converts its command again with a newly measured heading and sends it to the
/// driver. Without it, a tracker of 100 Hz or more would flood the robot.
const FOLLOW_PERIOD: Span = Span::from_millis(20);

/// Period at which the state of a flight is repeated, as often as a heartbeat.
const ALOFT_PERIOD: Span = Span::from_millis(200);

/// Input message of a Body, the actor that drives the motors of one robot.
#[derive(Clone, Debug)]
pub enum In {
    /// Velocity command from the robot's Controller.
    MotorCommand(MotorCommand),
    /// Reading (measured state) of the Body's robot; sent only if the robot is not simulated.
    Reading(Reading),
    /// Packet of bytes from the worker of the robot's driver.
    Packet(Box<[u8]>),
    /// The worker of the robot's driver has ended or begins again: the robot cannot be commanded until it reports.
    WorkerEnded,
    /// Emergency stop message: engage, re-arm or resume.
    Stop(Stop),
    /// Emergency stop state (latch) and phase of the team in an instruction of the state server.
    Instruction(Latch, Phase),
    /// The Body's host is shutting down; the Body stops the robot for good.
    Leave,
}

/// Output message of a Body, the actor that drives the motors of one robot.
#[derive(Clone, Debug)]
pub enum Out {
    /// Command for the World that simulates the robot.
    Drive(Drive),
    /// Packet of bytes for the worker of the robot's driver.
    Send(Box<[u8]>),
    /// Pose and velocity from the robot's own sensors, for the Localizer of its host.
    Odometry(Reading),
    /// Condition of the robot's hardware (health, battery, temperature), for the Status of its host and for the code
    /// that runs the process.
    Condition(Hardware),
    /// Permission to move, which depends on battery and temperature; sent on a change to the robot's Controller if that
    /// runs on the same host.
    Permit(Permit),
    /// State of the flight of a robot that flies: at each change, and repeated.
    Aloft(Aloft),
    /// State of the emergency stop latch that this Body obeys now, for the Status of its host.
    Follows(Latch),
    /// Stop message with the Body's emergency stop state, for the whole team; sent if the state server's state is
    /// older.
    Stop(Stop),
}

/// Returns an order of the pilot as text for the log.
fn words(order: Vertical) -> String {
    match order {
        Vertical::Rise { height_m } => format!("rises to {height_m} m"),
        Vertical::Land => "lands".to_owned(),
        Vertical::Cut => "its motors are switched off".to_owned(),
    }
}

/// Body: the actor that passes velocity commands to the driver of one robot, and stops the robot when they expire or
/// are not permitted.
pub struct Body {
    robot: RobotId,
    /// Host of the Body.
    host: HostId,
    driver: Box<dyn Driver>,
    outputs: Vec<drivers::Out>,
    chassis: Chassis,
    /// Last measured heading \[rad\] in the world frame, and its arrival time.
    heading: Option<(Time, f32)>,
    /// Command in force, if its conversion to the robot's frame uses a measured heading, and the time at which the
    /// driver last received it. `None` if the robot stands or its heading is unknown.
    driven: Option<(Drive, Time)>,
    hardware: HardwareWatch,
    /// Whether a warning was logged that a hardware value with a limit is unknown.
    warned: bool,
    /// Number of packets from the driver's worker that could not be decoded.
    refused: u64,
    /// Time at which the command in force expires; `None` without a command.
    expires: Option<Time>,
    latch: LatchFollower,
    /// Time at which the Body last reported its latch to a state server that did not know of it; `None` if never.
    corrected: Option<Time>,
    /// Whether the host is shutting down.
    leaves: bool,
    /// Pilot of a robot that flies; `None` for one that stays on the ground.
    pilot: Option<Pilot>,
    /// State of the flight that was said last, and the time at which it is repeated.
    aloft: Option<(Flight, Time)>,
}

impl Body {
    /// Creates the Body of a robot on a host, at rest, with the driver that moves the robot and the robot's chassis.
    pub fn new((host, robot): (HostId, RobotId), driver: Box<dyn Driver>, chassis: Chassis) -> Body {
        Body {
            robot,
            host,
            driver,
            outputs: Vec::new(),
            chassis,
            heading: None,
            driven: None,
            hardware: HardwareWatch::new(HardwareLimits::default()),
            warned: false,
            refused: 0,
            expires: None,
            latch: LatchFollower::default(),
            corrected: None,
            leaves: false,
            pilot: None,
            aloft: None,
        }
    }

    /// Returns the Body with its limits of battery and temperature set to `limits`.
    pub fn limited(self, limits: HardwareLimits) -> Body {
        Body { hardware: HardwareWatch::new(limits), ..self }
    }

    /// Returns the Body of a robot that flies as `settings` say; `None` for a robot that stays on the ground.
    pub(crate) fn flying(self, settings: Option<flights::Settings>) -> Body {
        Body { pilot: settings.map(Pilot::new), ..self }
    }

    /// Returns the Body for a team whose orders are `signed` where they end a stop or a hold.
    pub(crate) fn with_signed_orders(self, signed: bool) -> Body {
        Body { latch: LatchFollower::new(signed), ..self }
    }

    /// Whether the motors may turn: the state server was heard, no stop is engaged or held, the host is not shutting
    /// down, the hardware permits motion, and a robot that flies is at its height.
    fn may_move(&self) -> bool {
        let permit = self.hardware.permit() == Permit::Granted;
        let at_height = self.pilot.as_ref().is_none_or(Pilot::is_at_height);
        self.latch.is_informed() && self.latch.latch().is_clear() && !self.leaves && permit && at_height
    }

    /// Handles the hardware condition that the driver reports, and stops the robot if it is beyond a limit.
    fn condition(&mut self, now: Time, hardware: Hardware, out: &mut Vec<Out>) {
        let before = self.hardware.permit();
        self.hardware.take(&hardware);
        self.judge(now, before, hardware, out);
    }

    /// Reports the hardware condition, and the permission to move if it has changed from `before`. Stops the robot if
    /// the permission has been withdrawn.
    fn judge(&mut self, now: Time, before: Permit, hardware: Hardware, out: &mut Vec<Out>) {
        let permit = self.hardware.permit();
        out.push(Out::Condition(self.hardware.judged(hardware)));
        if permit == before {
            return;
        }
        match self.hardware.reason() {
            Some(reason) => tracing::error!("{} stands: {reason}", self.robot),
            None if before == Permit::Withdrawn => tracing::warn!("{} may move again: it is ready", self.robot),
            None => {}
        }
        out.push(Out::Permit(permit));
        if permit == Permit::Withdrawn {
            self.halt(now, out);
        }
    }

    /// Logs once that the robot is commanded to move although a hardware value with a limit is unknown.
    fn warn_unknown(&mut self, command: &MotorCommand) {
        let unknown = self.hardware.permit() == Permit::Unknown && command.velocity != Vec2::zeros();
        if unknown && !std::mem::replace(&mut self.warned, true) {
            tracing::error!("{} stands: {}", self.robot, self.hardware.reason().unwrap_or_default());
        }
    }

    fn apply(&mut self, now: Time, command: &MotorCommand, out: &mut Vec<Out>) {
        self.warn_unknown(command);
        // Cap the speed at the robot's limit; the direction stays.
        let most = self.driver.limits().speed_m_s;
        let velocity = if self.may_move() { command.velocity.capped(most) } else { Vec2::zeros() };
        let until = now + command.valid_for;
        self.expires = Some(until);
        self.drive(now, Drive { robot: self.robot, velocity, until }, out);
    }

    fn halt(&mut self, now: Time, out: &mut Vec<Out>) {
        self.expires = None;
        self.drive(now, Drive { robot: self.robot, velocity: Vec2::zeros(), until: now }, out);
    }

    fn drive(&mut self, now: Time, drive: Drive, out: &mut Vec<Out>) {
        let heading = self.heading.filter(|(arrived, _)| now.since(*arrived) <= self.chassis.heading_age);
        let body = self.chassis.twist(drive.velocity, heading.map(|(_, heading)| heading));
        // Only a robot that moves by a measured heading gets its command again when the heading changes.
        let moves = drive.velocity != Vec2::zeros() && heading.is_some();
        self.driven = moves.then_some((drive, now));
        self.driver.drive(now, &Command { drive, body }, &mut self.outputs);
        self.forward(now, out);
    }

    /// Stores a measured heading. If the robot moves, repeats its command with the new heading.
    fn measured(&mut self, now: Time, reading: &Reading, out: &mut Vec<Out>) {
        self.driver.measured(now, reading, &mut self.outputs);
        self.forward(now, out);
        if let Some(heading) = reading.pose.heading {
            self.heading = Some((now, heading));
            match self.driven {
                Some((drive, at)) if now.since(at) >= FOLLOW_PERIOD => self.drive(now, drive, out),
                _ => {}
            }
        }
    }

    /// Returns the time at which the heading of a moving robot becomes too old.
    fn heading_lapses(&self) -> Option<Time> {
        let (arrived, _) = self.heading?;
        // One nanosecond after the largest permitted age.
        self.driven.map(|_| arrived + self.chassis.heading_age + Span::from_nanos(1))
    }

    fn forward(&mut self, now: Time, out: &mut Vec<Out>) {
        for output in std::mem::take(&mut self.outputs) {
            match output {
                drivers::Out::Drive(drive) => out.push(Out::Drive(drive)),
                drivers::Out::Send(packet) => out.push(Out::Send(packet)),
                drivers::Out::Odometry(reading) => out.push(Out::Odometry(reading)),
                drivers::Out::Condition(hardware) => self.condition(now, hardware, out),
                drivers::Out::Flight(flight) => self.pilot.iter_mut().for_each(|pilot| pilot.take(flight)),
                drivers::Out::Refused(why) => {
                    self.refused += 1;
                    // Log only the counts 1, 2, 4, 8, ...: a faulty robot may send nothing else.
                    if self.refused.is_power_of_two() {
                        let (refused, robot) = (self.refused, self.robot);
                        tracing::warn!(refused, "{robot}: output of the driver's worker is refused: {why}");
                    }
                }
            }
        }
    }

    /// Gives the order of the pilot that is due to the driver, and says the state of the flight where that is due.
    fn steer(&mut self, now: Time, out: &mut Vec<Out>) {
        let Some(pilot) = &mut self.pilot else { return };
        pilot.latched(now, self.latch.latch());
        let fit = self.hardware.permit() == Permit::Granted;
        let before = pilot.is_at_height();
        let order = pilot.order(now, fit, self.leaves);
        let lands = before && !pilot.is_at_height();
        if let Some(order) = order {
            tracing::info!("{}: {}", self.robot, words(order));
            self.driver.fly(now, order, &mut self.outputs);
        }
        if lands {
            self.halt(now, out);
        }
        self.forward(now, out);
        let flight = self.pilot.as_ref().and_then(Pilot::flight);
        let due = |(said, again): &(Flight, Time)| Some(*said) != flight || *again <= now;
        if let Some(flight) = flight.filter(|_| self.aloft.as_ref().is_none_or(due)) {
            self.aloft = Some((flight, now + ALOFT_PERIOD));
            out.push(Out::Aloft(Aloft { robot: self.robot, flight }));
        }
    }

    fn latched(&mut self, now: Time, changed: bool, out: &mut Vec<Out>) {
        if changed && !self.may_move() {
            self.halt(now, out);
        }
    }

    /// Sends the Body's latch to the team if it is engaged or held and newer than `heard`, the state server's. So a
    /// stop that only Bodies remember survives a restart of the state server.
    fn correct(&mut self, now: Time, heard: Latch, out: &mut Vec<Out>) {
        let own = self.latch.latch();
        let due = self.corrected.is_none_or(|at| now.since(at) >= CORRECTION_PERIOD);
        if !own.is_clear() && own > heard && due {
            self.corrected = Some(now);
            out.push(Out::Stop(Stop { by: self.host, latch: own }));
        }
    }
}

impl Core for Body {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::MotorCommand(command) => self.apply(now, &command, out),
            In::Reading(reading) => self.measured(now, &reading, out),
            In::WorkerEnded => {
                let before = self.hardware.permit();
                self.hardware.end();
                let ended = Hardware::of(Health::Silent).because("its driver has ended and is started again");
                self.judge(now, before, ended, out);
            }
            In::Packet(packet) => {
                self.driver.receive(now, &packet, &mut self.outputs);
                self.forward(now, out);
            }
            In::Stop(stop) => {
                let changed = self.latch.apply(stop.latch, stop.by.is_operator());
                self.latched(now, changed, out);
                out.push(Out::Follows(self.latch.latch()));
            }
            In::Instruction(heard, phase) => {
                self.pilot.iter_mut().for_each(|pilot| pilot.instructed(now, phase));
                let changed = self.latch.update(heard);
                self.latched(now, changed, out);
                self.correct(now, heard, out);
                if changed {
                    out.push(Out::Follows(self.latch.latch()));
                }
            }
            In::Leave => {
                self.leaves = true;
                self.halt(now, out);
            }
        }
        self.steer(now, out);
    }

    fn wake_at(&self) -> Option<Time> {
        let (pilot, said) = (self.pilot.as_ref().and_then(Pilot::wake_at), self.aloft.map(|(_, again)| again));
        [self.expires, self.heading_lapses(), self.driver.wake_at(), pilot, said].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.expires.is_some_and(|expires| expires <= now) {
            self.halt(now, out);
        }
        match self.driven {
            // The driver is told that the heading is unknown.
            Some((drive, _)) if self.heading_lapses().is_some_and(|lapses| lapses <= now) => {
                self.drive(now, drive, out)
            }
            _ => {}
        }
        if self.driver.wake_at().is_some_and(|at| at <= now) {
            self.driver.wake(now, &mut self.outputs);
            self.forward(now, out);
        }
        self.steer(now, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drivers::simulated::Simulated;

    fn body() -> Body {
        let mut body = Body::new((HostId(3), RobotId(0)), Box::new(Simulated::default()), Chassis::default());
        body.handle(Time::ZERO, In::Instruction(Latch::default(), Phase::Running), &mut Vec::new());
        body
    }

    fn command(x: f32) -> In {
        let velocity = Vec2::new(x, 0.0);
        In::MotorCommand(MotorCommand { robot: RobotId(0), velocity, valid_for: Span::from_millis(200) })
    }

    fn handle(body: &mut Body, ms: u64, input: In) -> Vec<Out> {
        let mut out = Vec::new();
        body.handle(Time::ZERO + Span::from_millis(ms), input, &mut out);
        out
    }

    /// Speed at which the robot is driven after a command of 1 m/s.
    fn driven(body: &mut Body, ms: u64) -> f32 {
        let out = handle(body, ms, command(1.0));
        let [Out::Drive(drive)] = &out[..] else { panic!("{out:?}") };
        drive.velocity.x
    }

    #[test]
    fn a_command_that_is_released_after_a_stop_drives_nobody_until_a_resume() {
        let mut body = body();
        assert_eq!(driven(&mut body, 0), 1.0);
        let out = handle(&mut body, 10, In::Stop(Stop::engage(HostId(9), Latch::default())));
        assert!(matches!(&out[0], Out::Drive(drive) if drive.velocity == Vec2::zeros()), "at once");
        assert!(matches!(&out[1], Out::Follows(latch) if latch.is_engaged()));
        assert_eq!(driven(&mut body, 45_000), 0.0);
        handle(&mut body, 45_010, In::Stop(Stop::rearm(HostId::operator(9), Latch::engaged(1))));
        assert_eq!(driven(&mut body, 45_020), 0.0, "held");
        handle(&mut body, 45_030, In::Instruction(Latch::clear(3), Phase::Running));
        assert_eq!(driven(&mut body, 45_040), 1.0);
    }

    #[test]
    fn a_robot_whose_driver_has_ended_stands_until_it_reports_ready() {
        let mut body = Body::new((HostId(3), RobotId(0)), Box::new(Charged), Chassis::default());
        handle(&mut body, 0, In::Instruction(Latch::default(), Phase::Running));
        let speed = |out: &[Out]| match out {
            [.., Out::Drive(drive)] => drive.velocity.x,
            _ => panic!("{out:?}"),
        };
        assert_eq!(speed(&handle(&mut body, 10, command(1.0))), 1.0, "before a first report");
        let out = handle(&mut body, 20, In::WorkerEnded);
        let [Out::Condition(hardware), Out::Permit(Permit::Withdrawn), Out::Drive(_)] = &out[..] else {
            panic!("{out:?}")
        };
        assert_eq!((hardware.health, speed(&out)), (Health::Silent, 0.0));
        assert_eq!(speed(&handle(&mut body, 30, command(1.0))), 0.0, "its new driver is not ready");
        let out = handle(&mut body, 40, In::Packet([87].into()));
        assert!(matches!(&out[..], [Out::Condition(_), Out::Permit(Permit::Granted)]), "{out:?}");
        assert_eq!(speed(&handle(&mut body, 50, command(1.0))), 1.0);
    }

    #[test]
    fn a_fresh_body_moves_nothing_before_the_state_server_is_heard() {
        let mut body = Body::new((HostId(3), RobotId(0)), Box::new(Simulated::default()), Chassis::default());
        assert_eq!(driven(&mut body, 0), 0.0);
        handle(&mut body, 10, In::Instruction(Latch::default(), Phase::Running));
        assert_eq!(driven(&mut body, 20), 1.0);
        handle(&mut body, 30, In::Leave);
        assert_eq!(driven(&mut body, 40), 0.0, "its host is about to end");
    }

    #[test]
    fn a_state_server_that_has_forgotten_a_hold_is_told() {
        let mut body = body();
        handle(&mut body, 0, In::Instruction(Latch::held(2), Phase::Running));
        let told = |out: &[Out]| out.iter().any(|said| matches!(said, Out::Stop(s) if s.latch == Latch::held(2)));
        assert!(told(&handle(&mut body, 100, In::Instruction(Latch::default(), Phase::Running))));
        assert!(
            !told(&handle(&mut body, 200, In::Instruction(Latch::default(), Phase::Running))),
            "not with every instruction"
        );
        assert!(told(&handle(&mut body, 300, In::Instruction(Latch::default(), Phase::Running))));
        assert!(!told(&handle(&mut body, 600, In::Instruction(Latch::held(2), Phase::Running))), "it knows");
    }

    /// Speed ahead of the last command to the driver; none while the robot has no heading.
    #[derive(Default)]
    struct Log(std::rc::Rc<std::cell::RefCell<Vec<Option<f32>>>>);

    impl Driver for Log {
        fn limits(&self) -> drivers::Limits {
            drivers::Limits { speed_m_s: f32::INFINITY }
        }

        fn drive(&mut self, _: Time, command: &Command, _: &mut Vec<drivers::Out>) {
            self.0.borrow_mut().push(command.body.map(|body| body.forward));
        }

        fn receive(&mut self, _: Time, _: &[u8], _: &mut Vec<drivers::Out>) {}
    }

    #[test]
    fn a_robot_is_driven_by_its_newest_heading_and_stands_without_one() {
        let driver = Log::default();
        let driven = std::rc::Rc::clone(&driver.0);
        let mut body = Body::new((HostId(3), RobotId(0)), Box::new(driver), Chassis::default());
        handle(&mut body, 0, In::Instruction(Latch::default(), Phase::Running));
        let towards = |heading| {
            let mut reading = Reading::of_point(RobotId(0), 1, crate::messages::geometry::Motion::default());
            reading.pose.heading = Some(heading);
            In::Reading(reading)
        };
        handle(&mut body, 0, command(1.0));
        assert_eq!(driven.take(), [None], "there is no heading yet");
        handle(&mut body, 10, towards(0.0));
        handle(&mut body, 50, command(1.0));
        handle(&mut body, 60, towards(std::f32::consts::PI));
        assert_eq!(driven.take(), [Some(1.0)], "not twice within 20 ms");
        handle(&mut body, 70, towards(std::f32::consts::PI));
        assert_eq!(driven.take(), [Some(-1.0)], "at once, in the other direction");
        let lapse = body.wake_at().expect("a heading does not count for ever");
        assert_eq!(lapse, Time::ZERO + Span::from_millis(170) + Span::from_nanos(1));
        body.wake(lapse, &mut Vec::new());
        assert_eq!(driven.take(), [None]);
        let expiry = Time::ZERO + Span::from_millis(250);
        assert_eq!(body.wake_at(), Some(expiry));
        body.wake(expiry, &mut Vec::new());
        assert_eq!((driven.take(), body.wake_at()), (vec![Some(0.0)], None));
    }

    /// Driver whose packets are the charge of the battery \[%\].
    struct Charged;

    impl Driver for Charged {
        fn limits(&self) -> drivers::Limits {
            drivers::Limits { speed_m_s: f32::INFINITY }
        }

        fn drive(&mut self, _: Time, command: &Command, out: &mut Vec<drivers::Out>) {
            out.push(drivers::Out::Drive(command.drive));
        }

        fn receive(&mut self, _: Time, packet: &[u8], out: &mut Vec<drivers::Out>) {
            let battery = packet.first().copied();
            out.push(drivers::Out::Condition(Hardware { battery, ..Hardware::of(Health::Ready) }));
        }
    }

    #[test]
    fn a_flat_battery_stops_the_robot_and_refuses_to_start_it() {
        let limits = HardwareLimits { battery_least: Some(20), ..HardwareLimits::default() };
        let mut body = Body::new((HostId(3), RobotId(0)), Box::new(Charged), Chassis::default()).limited(limits);
        handle(&mut body, 0, In::Instruction(Latch::default(), Phase::Running));
        assert_eq!(driven(&mut body, 0), 0.0, "the charge is not known yet");
        let charge = |body: &mut Body, ms, percent: u8| handle(body, ms, In::Packet([percent].into()));
        let known = charge(&mut body, 10, 60);
        assert!(matches!(&known[..], [Out::Condition(_), Out::Permit(Permit::Granted)]), "{known:?}");
        assert_eq!(driven(&mut body, 20), 1.0);
        let low = charge(&mut body, 30, 20);
        let [Out::Condition(hardware), Out::Permit(Permit::Withdrawn), Out::Drive(drive)] = &low[..] else {
            panic!("{low:?}")
        };
        assert_eq!((hardware.health, drive.velocity), (Health::Faulty, Vec2::zeros()));
        assert!(hardware.reason.as_ref().unwrap().text().starts_with("battery 20 %"), "{hardware:?}");
        assert_eq!(driven(&mut body, 40), 0.0);
        charge(&mut body, 50, 29);
        assert_eq!(driven(&mut body, 60), 0.0, "it recovers while its motors are off");
        charge(&mut body, 70, 95);
        assert_eq!(driven(&mut body, 80), 1.0, "it was charged");
    }

    #[test]
    fn the_motors_stop_when_the_command_lapses() {
        let mut body = body();
        let mut out = Vec::new();
        body.handle(Time::ZERO, command(1.0), &mut out);
        body.handle(Time::ZERO + Span::from_millis(50), command(0.5), &mut out);
        let lapse = Time::ZERO + Span::from_millis(250);
        assert_eq!(body.wake_at(), Some(lapse), "the newest command counts");
        body.wake(lapse, &mut out);
        assert!(matches!(out[2], Out::Drive(drive) if drive.velocity == Vec2::zeros()));
        assert_eq!(body.wake_at(), None);
    }
}
