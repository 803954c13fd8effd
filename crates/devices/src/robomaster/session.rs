//! Session with one robot: the part of the driver that does no I/O.
//!
//! A session consists of opening, the lines of the set-up, and driving. One line at a time waits for its answer,
//! because the robot queues lines and executes them late; only the newest velocity is kept to be sent next. A stand
//! command does not wait: it is sent at once and repeated.

use super::Config;
use super::battery::Battery;
use super::chassis::Chassis;
use super::link::{FromWorker, Hold, ToWorker};
use super::motion::Motion;
use super::odometry::{Odometry, is_sound};
use super::protocol::{Answer, Line, Malformed, Push, Splitter, decode_answer, decode_hit, decode_push};
use super::reporter::Reporter;
use super::times::{ENTRY_PATIENCE, FIRST_PUSH, OPENING, PATIENCE, PAUSE, RETRY, SETUP_PATIENCE, SILENCE, UNANSWERED};
use murmurate::drivers::{Command, Driver, Limits, Out};
use murmurate::messages::geometry::limit_below;
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{Health, Reason};
use murmurate::time::{Span, Time};

/// State of a session's connection with the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    /// There is no connection; the next one is opened at this time.
    Closed(Time),
    /// The worker is opening a connection, until this time.
    Opening(Time),
    /// The connection is open. The set-up begins at this time.
    Opened(Time),
    /// The line of the set-up with this index is to be sent next, or waits for its answer.
    SetUp(usize),
    /// The set-up is complete, and the robot accepts velocities.
    Driving,
}

/// Line that was sent to the robot and that it has not answered yet.
#[derive(Clone, Copy, Debug)]
struct Flight {
    seq: u32,
    line: Line,
    /// Time at which the wait for the answer began: when a line was sent, or the last unrelated answer came.
    since: Time,
}

/// Session of the RoboMaster driver with one robot: opens and sets up the connection, and sends velocities.
pub struct Session {
    robot: RobotId,
    config: Config,
    chassis: Chassis,
    state: State,
    /// Number of the connection that the worker has opened last.
    connection: u32,
    answers: Splitter,
    events: Splitter,
    /// Sequence number of the last line that was sent.
    seq: u32,
    /// Whether the robot's answers repeat the sequence numbers.
    numbers: bool,
    flight: Option<Flight>,
    motion: Motion,
    /// Time of the last state datagram that the robot pushed. At the start of driving, a time that leaves `FIRST_PUSH`
    /// for the first one.
    heard: Time,
    /// Whether the robot has pushed a state datagram on this connection.
    pushed: bool,
    odometry: Odometry,
    battery: Battery,
    rolled_over: bool,
    /// Longest wait for the robot's answer to the present line of the set-up.
    setup_patience: Span,
    /// Number of connections that were given up since the robot was last ready.
    given_up: u64,
    reporter: Reporter,
}

impl Session {
    /// Makes a session without a connection, which opens one at its first wake-up.
    pub fn new(robot: RobotId, config: Config) -> Session {
        let [speed_m_s, yaw_rate_rad_s] = [config.speed_m_s(), config.yaw_rate_rad_s].map(limit_below);
        let chassis = Chassis { speed_m_s, yaw_rate_rad_s, step_m_s: config.speed_step_m_s };
        let battery = Battery::new(config.battery_least, config.battery_period_s);
        let motion = Motion::new(config.command_hz);
        Session {
            robot,
            config,
            chassis,
            state: State::Closed(Time::ZERO),
            connection: 0,
            answers: Splitter::default(),
            events: Splitter::default(),
            seq: 0,
            numbers: false,
            flight: None,
            motion,
            heard: Time::ZERO,
            pushed: false,
            odometry: Odometry::new(robot),
            battery,
            rolled_over: false,
            setup_patience: ENTRY_PATIENCE,
            given_up: 0,
            reporter: Reporter::default(),
        }
    }

    /// Returns the line of the connection's set-up with this index, such as entering SDK mode; `None` after the last.
    fn set_up(&self, index: usize) -> Option<Line> {
        let hits = self.config.events.then_some(Line::HitEvents);
        [Some(Line::Enter), Some(Line::Stand), Some(Line::Free), Some(Line::Pushes(self.config.push_hz)), hits]
            .into_iter()
            .flatten()
            .nth(index)
    }

    /// Whether the robot may move: it is connected, set up, sends its state, is upright and has enough charge.
    fn may_move(&self) -> bool {
        self.state == State::Driving && self.pushed && !self.battery.low && !self.rolled_over
    }

    /// Whether a line has waited too long for its answer.
    fn is_late(&self, now: Time) -> bool {
        self.state == State::Driving && self.flight.is_some_and(|flight| now.since(flight.since) >= UNANSWERED)
    }

    fn report_condition(&mut self, now: Time, out: &mut Vec<Out>) {
        let reason = |text: &str| Reason::new(text);
        let (health, reason) = if self.state != State::Driving || !self.pushed {
            (Health::Silent, self.reporter.unconnected.clone())
        } else if self.is_late(now) {
            (Health::Silent, reason("it does not answer"))
        } else if self.rolled_over {
            (Health::Faulty, reason("it lies on its side"))
        } else if self.battery.low {
            (Health::Faulty, reason("its battery is below battery_least of the driver"))
        } else {
            self.given_up = 0;
            (Health::Ready, None)
        };
        self.reporter.report(health, reason, self.battery.charge, out);
    }

    fn write(&mut self, line: Line, hold: Hold, out: &mut Vec<Out>) {
        self.seq += 1;
        let (connection, line) = (self.connection, line.encode(self.seq));
        out.push(Out::Send(ToWorker::Write { connection, hold, line: &line }.encode()));
    }

    /// Sends a line to the robot, and stores it as the line that waits for its answer.
    fn send(&mut self, now: Time, line: Line, hold: Hold, out: &mut Vec<Out>) {
        self.write(line, hold, out);
        // A line that is overtaken by standing is still to be answered: its time counts on.
        let since = self.flight.map_or(now, |flight| flight.since);
        self.flight = Some(Flight { seq: self.seq, line, since });
        self.motion.sent(now, &line);
    }

    /// Stops the robot: sends a stand command at once, without waiting for an answer, if the robot moves.
    fn halt(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.motion.stop() && self.state == State::Driving {
            self.send(now, Line::Stand, Hold::Standing, out);
        }
    }

    /// Sends the next line that is due, unless a line still waits for its answer.
    fn advance(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.flight.is_some() {
            return;
        }
        match self.state {
            State::Closed(_) | State::Opening(_) | State::Opened(_) => {}
            State::SetUp(index) => match self.set_up(index) {
                Some(line) => self.send(now, line, Hold::Standing, out),
                None => {
                    self.state = State::Driving;
                    self.heard = now + (FIRST_PUSH - SILENCE);
                    self.battery.due = now;
                    self.advance(now, out);
                }
            },
            State::Driving if self.battery.due <= now => {
                self.battery.asked(now);
                self.send(now, Line::Battery, Hold::Keep, out);
            }
            State::Driving if self.motion.due().is_some_and(|due| due <= now) => {
                let (line, hold) = self.motion.next(now);
                self.send(now, line, hold, out);
            }
            State::Driving => {}
        }
    }

    /// Gives the connection up for the reason `why`, and asks the worker to open another.
    fn reopen(&mut self, now: Time, why: &str, out: &mut Vec<Out>) {
        self.given_up += 1;
        if self.given_up.is_power_of_two() {
            tracing::warn!(times = self.given_up, "{}: {why}; the connection is opened again", self.robot);
        }
        self.reporter.unconnected = Reason::new(why);
        self.open(now, out);
    }

    fn open(&mut self, now: Time, out: &mut Vec<Out>) {
        self.state = State::Opening(now + OPENING);
        (self.flight, self.pushed) = (None, false);
        out.push(Out::Send(ToWorker::Open.encode()));
        self.reporter.unconnected(self.battery.charge, out);
    }

    /// Begins anew on the connection with number `connection`, which the worker has opened.
    fn opened(&mut self, now: Time, connection: u32) {
        (self.state, self.connection) = (State::Opened(now + PAUSE), connection);
        (self.answers, self.events) = (Splitter::default(), Splitter::default());
        (self.flight, self.pushed) = (None, false);
        self.motion.reset();
        (self.seq, self.numbers, self.odometry) = (0, false, Odometry::new(self.robot));
        self.setup_patience = ENTRY_PATIENCE;
    }

    fn closed(&mut self, now: Time, connection: u32, why: &[u8], out: &mut Vec<Out>) {
        let current = connection == self.connection && !matches!(self.state, State::Closed(_));
        if current || matches!(self.state, State::Opening(_)) {
            self.state = State::Closed(now + RETRY);
            (self.flight, self.pushed) = (None, false);
            self.reporter.unconnected = Reason::new(&String::from_utf8_lossy(why));
            self.reporter.unconnected(self.battery.charge, out);
        }
    }

    fn statement(&mut self, now: Time, statement: Result<&str, Malformed>, out: &mut Vec<Out>) {
        match statement.and_then(decode_answer) {
            Ok(answer) => self.answered(now, &answer, out),
            Err(error) => out.push(Out::Refused(error.reason())),
        }
    }

    fn answered(&mut self, now: Time, answer: &Answer, out: &mut Vec<Out>) {
        let Some(flight) = self.flight.as_mut() else { return };
        // An error about what an earlier program left behind comes without a number (see `Line::Enter`).
        let stray = self.numbers || (flight.line == Line::Enter && !answer.is_ok());
        if answer.seq.map_or(stray, |seq| seq != flight.seq) {
            // An unrelated answer still shows that the robot is alive.
            flight.since = now;
            return;
        }
        let line = flight.line;
        (self.flight, self.numbers) = (None, answer.seq.is_some());
        if line == Line::Battery {
            self.charge(now, answer.percent(), out);
        } else if !answer.is_ok() && !self.survives(now, line, answer.result, out) {
            return;
        }
        if let State::SetUp(index) = self.state {
            self.state = State::SetUp(index + 1);
            // Without `ok` an earlier session goes on, and with it the SDK. It may yet end with its connection.
            let starts = line != Line::Enter || answer.result == "ok";
            self.setup_patience = if starts { SETUP_PATIENCE } else { PATIENCE };
        }
        self.report_condition(now, out);
        self.advance(now, out);
    }

    /// Handles the robot's refusal of a line. Returns whether the session goes on; if not, it will be opened again.
    fn survives(&mut self, now: Time, line: Line, result: &str, out: &mut Vec<Out>) -> bool {
        if matches!(line, Line::Free | Line::HitEvents) {
            tracing::warn!("{} answers {result:?} to {line:?}: it has no gimbal or no armour; going on", self.robot);
            return true;
        }
        self.given_up += 1;
        if self.given_up.is_power_of_two() {
            let times = self.given_up;
            tracing::warn!(times, "{} answers {result:?} to {line:?}: its SDK is started again", self.robot);
        }
        self.write(Line::Stand, Hold::Standing, out);
        (self.state, self.pushed) = (State::Closed(now + RETRY), false);
        let why = Reason::new(&format!("it answers {result:?} to {line:?}"));
        self.reporter.report(Health::Faulty, why, self.battery.charge, out);
        false
    }

    fn charge(&mut self, now: Time, percent: Option<u8>, out: &mut Vec<Out>) {
        let Some(percent) = percent else {
            return out.push(Out::Refused("the robot's battery is not a number within 0 and 100"));
        };
        let was_low = self.battery.low;
        self.battery.take(percent);
        if self.battery.low && !was_low {
            tracing::error!("{} has {percent} % of charge left and stands: charge its battery", self.robot);
            self.halt(now, out);
        }
        // The condition is reported again, with this charge.
        self.reporter.repeat();
    }

    fn push(&mut self, now: Time, stamp_ns: u64, datagram: &[u8], out: &mut Vec<Out>) {
        let push = match decode_push(datagram) {
            Ok(push) => push,
            Err(error) => return out.push(Out::Refused(error.reason())),
        };
        // Nothing is in a push of another module, which an earlier program may have switched on.
        if self.state != State::Driving || push == Push::default() {
            return;
        }
        out.extend(push.refused.map(|why| Out::Refused(why.reason())));
        (self.heard, self.pushed) = (now, true);
        if let Some(rolled_over) = push.rolled_over.filter(|rolled_over| *rolled_over != self.rolled_over) {
            self.rolled_over = rolled_over;
            if rolled_over {
                tracing::error!("{} lies on its side: set it on its wheels", self.robot);
                self.halt(now, out);
            }
        }
        match self.odometry.take(stamp_ns, &push) {
            Some(reading) if is_sound(&reading) => out.push(Out::Odometry(reading)),
            Some(_) => out.push(Out::Refused("the robot's odometry is out of range")),
            None => {}
        }
        self.report_condition(now, out);
        self.advance(now, out);
    }

    fn event(&self, statement: Result<&str, Malformed>, out: &mut Vec<Out>) {
        match statement.and_then(decode_hit) {
            Ok(Some((plate, hit))) => tracing::warn!("{} was hit at plate {plate}: {hit:?}", self.robot),
            Ok(None) => {}
            Err(error) => out.push(Out::Refused(error.reason())),
        }
    }

    /// Returns the time at which the robot counts as silent, or its connection as lost, unless it sends something.
    fn silent_at(&self) -> Time {
        let answer = self.flight.map(|flight| match self.state {
            State::Driving => flight.since + if self.reporter.is_silent() { PATIENCE } else { UNANSWERED },
            _ => flight.since + self.setup_patience,
        });
        let push = (self.state == State::Driving).then(|| self.heard + SILENCE);
        answer.into_iter().chain(push).min().unwrap_or(Time::MAX)
    }
}

impl Driver for Session {
    fn limits(&self) -> Limits {
        Limits { speed_m_s: self.config.speed_m_s() }
    }

    fn drive(&mut self, now: Time, command: &Command, out: &mut Vec<Out>) {
        let until = command.drive.until;
        let speed = command.body.as_ref().and_then(|twist| self.chassis.follow(twist)).filter(|_| until > now);
        let Some(speed) = speed.filter(|_| self.may_move() && !self.is_late(now)) else {
            return self.halt(now, out);
        };
        self.motion.want(speed, until);
        self.advance(now, out);
        if self.motion.waits() {
            // The new velocity waits for an answer. Until it is sent, the old one stays valid for as long.
            let (connection, hold) = (self.connection, Hold::For(until.since(now)));
            out.push(Out::Send(ToWorker::Write { connection, hold, line: "" }.encode()));
        }
    }

    fn receive(&mut self, now: Time, packet: &[u8], out: &mut Vec<Out>) {
        match FromWorker::decode(packet) {
            None => out.push(Out::Refused("it is not a packet of the driver's worker")),
            Some(FromWorker::Opened(connection)) => self.opened(now, connection),
            Some(FromWorker::Closed(connection, why)) => self.closed(now, connection, why, out),
            Some(FromWorker::Push(stamp_ns, datagram)) => self.push(now, stamp_ns, datagram, out),
            Some(FromWorker::Control(connection, bytes)) if connection == self.connection => {
                let mut answers = std::mem::take(&mut self.answers);
                answers.take(bytes, |statement| self.statement(now, statement, out));
                self.answers = answers;
            }
            Some(FromWorker::Event(connection, bytes)) if connection == self.connection => {
                let mut events = std::mem::take(&mut self.events);
                events.take(bytes, |statement| self.event(statement, out));
                self.events = events;
            }
            // Of a connection that was given up.
            Some(FromWorker::Control(..) | FromWorker::Event(..)) => {}
        }
    }

    fn wake_at(&self) -> Option<Time> {
        let line = match self.state {
            State::Closed(at) | State::Opening(at) | State::Opened(at) => return Some(at),
            State::SetUp(_) => None,
            State::Driving if self.flight.is_none() => self.motion.due().into_iter().chain([self.battery.due]).min(),
            State::Driving => None,
        };
        [Some(self.silent_at()), line, self.motion.expires()].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        match self.state {
            State::Closed(at) | State::Opening(at) if at <= now => return self.open(now, out),
            State::Opened(at) if at <= now => self.state = State::SetUp(0),
            State::Closed(_) | State::Opening(_) | State::Opened(_) => return,
            State::SetUp(_) if self.silent_at() <= now => {
                return self.reopen(now, "no answer during the set-up", out);
            }
            State::Driving if self.heard + SILENCE <= now => {
                let port = "no push on UDP port 40924 (if that is from the start, open the port in the firewall)";
                let why = if self.pushed { "no push for 250 ms" } else { port };
                return self.reopen(now, why, out);
            }
            State::Driving if self.flight.is_some_and(|flight| flight.since + PATIENCE <= now) => {
                return self.reopen(now, "no answer for 600 ms", out);
            }
            State::SetUp(_) | State::Driving => {}
        }
        if self.is_late(now) || self.motion.expires().is_some_and(|until| until <= now) {
            self.halt(now, out);
        }
        if self.state == State::Driving {
            self.report_condition(now, out);
        }
        self.advance(now, out);
    }
}
