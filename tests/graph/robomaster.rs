//! The driver `robomaster` against the fake EP, both without I/O, in simulated time: each run is the same every time.

#[path = "../peers/fake_ep.rs"]
#[allow(dead_code)] // Each program of tests uses its part.
mod fake_ep;

use std::collections::VecDeque;

use fake_ep::{Options, Output, Robot};
use murmurate::drivers::{Command, Driver, Out};
use murmurate::edge::Settings;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::messages::local::{BodyTwist, Drive};
use murmurate::messages::wire::{Hardware, Health, Reading};
use murmurate::time::{Span, Time};
use murmurate_devices::robomaster::ENTRY;
use murmurate_devices::robomaster::link::{FromWorker, Hold, ToWorker};

/// Delay of the network in each direction \[ms\].
const DELAY_MS: u64 = 4;

/// A driver, its worker's part, and a robot, with a network between them.
struct Bench {
    now_ms: u64,
    driver: Box<dyn Driver>,
    robot: Robot,
    connection: u32,
    /// Bytes on their way, with their arrival \[ms\] and connection.
    to_robot: VecDeque<(u64, u32, Vec<u8>)>,
    to_driver: VecDeque<(u64, Vec<u8>)>,
    /// Whether the network drops everything.
    dead: bool,
    twist: Option<BodyTwist>,
    /// Speeds forward that were given, with their time.
    given: Vec<(u64, f64)>,
    /// Lines that were written, with their time.
    lines: Vec<(u64, String)>,
    holds: Vec<(u64, Hold)>,
    conditions: Vec<(u64, Health, Option<u8>)>,
    readings: Vec<Reading>,
    refused: usize,
    stops: Vec<u64>,
}

impl Bench {
    fn new(options: Options, more: &str) -> Bench {
        let table = format!("connection = 'usb'\n{more}").parse().unwrap();
        let parts = (ENTRY.make)(&Settings { name: "robomaster".to_owned(), table }, RobotId(3)).unwrap();
        Bench {
            now_ms: 0,
            driver: (parts.driver)(),
            robot: Robot::new(0.0, options),
            connection: 0,
            to_robot: VecDeque::new(),
            to_driver: VecDeque::new(),
            dead: false,
            twist: None,
            given: Vec::new(),
            lines: Vec::new(),
            holds: Vec::new(),
            conditions: Vec::new(),
            readings: Vec::new(),
            refused: 0,
            stops: Vec::new(),
        }
    }

    fn now(&self) -> Time {
        Time::ZERO + Span::from_millis(self.now_ms)
    }

    /// Carries out the driver's output, as its worker and the Body do.
    fn take(&mut self, out: Vec<Out>) {
        for out in out {
            match out {
                Out::Send(packet) => match ToWorker::decode(&packet).expect("the driver's own packets are sound") {
                    ToWorker::Open => {
                        if self.dead {
                            self.to_driver.push_back((
                                self.now_ms + 400,
                                FromWorker::Closed(self.connection, b"no route").encode().into(),
                            ));
                        } else {
                            if self.connection > 0 {
                                self.robot.disconnected(self.now_ms as f64 * 1e-3);
                            }
                            self.connection += 1;
                            self.to_driver.push_back((
                                self.now_ms + 2 * DELAY_MS,
                                FromWorker::Opened(self.connection).encode().into(),
                            ));
                        }
                    }
                    ToWorker::Write { connection, hold, line } => {
                        self.holds.push((self.now_ms, hold));
                        if !line.is_empty() {
                            self.lines.push((self.now_ms, line.to_owned()));
                        }
                        if !self.dead && connection == self.connection {
                            self.to_robot.push_back((self.now_ms + DELAY_MS, connection, line.as_bytes().to_vec()));
                        }
                    }
                },
                Out::Condition(Hardware { health, battery, .. }) => {
                    self.conditions.push((self.now_ms, health, battery));
                }
                Out::Odometry(reading) => self.readings.push(reading),
                Out::Refused(_) => self.refused += 1,
                Out::Drive(_) | Out::Flight(_) => panic!("it is a real robot, on the ground"),
            }
        }
    }

    /// Lets a millisecond pass.
    fn step(&mut self) {
        self.now_ms += 1;
        let seconds = self.now_ms as f64 * 1e-3;
        while self.to_robot.front().is_some_and(|(at, ..)| *at <= self.now_ms) {
            let (_, connection, bytes) = self.to_robot.pop_front().unwrap();
            self.robot.take(seconds, connection, &bytes);
        }
        self.robot.advance(seconds);
        for output in std::mem::take(&mut self.robot.out) {
            let packet = match &output {
                Output::Answer(connection, text) => FromWorker::Control(*connection, text.as_bytes()).encode(),
                Output::Push(text) => FromWorker::Push((self.now_ms + DELAY_MS) * 1_000_000, text.as_bytes()).encode(),
                Output::Report(_) => continue,
            };
            if !self.dead {
                self.to_driver.push_back((self.now_ms + DELAY_MS, packet.into()));
            }
        }
        if self.robot.speed == [0.0; 3] {
            self.stops.push(self.now_ms);
        }
        let mut out = Vec::new();
        while let Some(at) = self.to_driver.iter().position(|(at, _)| *at <= self.now_ms) {
            let (_, packet) = self.to_driver.remove(at).unwrap();
            self.driver.receive(self.now(), &packet, &mut out);
        }
        let mut wakes = 0;
        while self.driver.wake_at().is_some_and(|at| at <= self.now()) {
            self.driver.wake(self.now(), &mut out);
            wakes += 1;
            assert!(wakes < 10, "it wakes for ever at {} ms", self.now_ms);
        }
        if let Some(twist) = self.twist.filter(|_| self.now_ms.is_multiple_of(20)) {
            let until = self.now() + Span::from_millis(200);
            let drive = Drive { robot: RobotId(3), velocity: Vec2::new(twist.forward, twist.left), until };
            self.given.push((self.now_ms, f64::from(twist.forward)));
            self.driver.drive(self.now(), &Command { drive, body: Some(twist) }, &mut out);
        }
        self.take(out);
    }

    fn run(&mut self, ms: u64) {
        (0..ms).for_each(|_| self.step());
    }

    fn give(&mut self, forward: f32, left: f32, yaw_rate: f32) {
        self.twist = Some(BodyTwist { forward, left, yaw_rate });
    }

    fn health(&self) -> Option<Health> {
        self.conditions.last().map(|(_, health, _)| *health)
    }

    fn until(&mut self, health: Health, ms: u64) -> u64 {
        let began = self.now_ms;
        while self.health() != Some(health) {
            self.step();
            assert!(self.now_ms - began < ms, "not {health:?} within {ms} ms: {:?}", self.conditions.last());
        }
        self.now_ms - began
    }
}

fn ready(options: Options, more: &str) -> Bench {
    let mut bench = Bench::new(options, more);
    bench.until(Health::Ready, 3000);
    bench
}

#[test]
fn the_robot_goes_where_it_is_driven_and_its_odometry_says_so() {
    let mut bench = ready(Options::default(), "");
    bench.give(0.5, 0.3, 0.5);
    bench.run(1000);
    bench.give(0.0, 0.0, 0.0);
    bench.run(500);
    let ([x, y, yaw], reading) = (bench.robot.pose, bench.readings.last().unwrap());
    assert!(x > 0.2 && y < -0.2 && (-30.0..-25.0).contains(&yaw), "{x} {y} {yaw}");
    assert!((f64::from(reading.pose.position.x) - x).hypot(f64::from(reading.pose.position.y) + y) < 0.002);
    assert!((f64::from(reading.pose.heading.unwrap().to_degrees()) + yaw).abs() < 0.01);
    assert_eq!((reading.twist.velocity, bench.robot.speed, bench.refused), (Vec2::zeros(), [0.0; 3], 0));
    assert_eq!(bench.conditions.last().unwrap().2, Some(87));
    assert!(!bench.lines.iter().any(|(_, line)| line.starts_with("chassis speed x 0.000 y 0.000 z 0.0")));
}

#[test]
fn one_line_is_in_flight_and_only_the_newest_velocity_waits() {
    for line_s in [0.003, 0.05, 0.15, 0.2] {
        let mut bench = ready(Options { line_s, ..Options::default() }, "command_hz = 50\n");
        let first = bench.lines.len();
        for k in 0..300 {
            bench.give(0.1 * (1 + k % 30) as f32, 0.0, 0.0);
            bench.run(20);
        }
        for (at, line) in &bench.lines[first..] {
            let Some(speed) = line.strip_prefix("chassis speed x ") else { continue };
            let speed: f64 = speed.split(' ').next().unwrap().parse().unwrap();
            // An answer and a command of the same millisecond come in this order.
            let newest = |until: u64| bench.given.iter().rev().find(|(given, _)| *given <= until).unwrap().1;
            let fits = [*at, at - 1].iter().any(|until| (newest(*until) - speed).abs() < 0.01);
            assert!(fits, "{speed} is sent at {at} ms, and {} is the newest", newest(*at));
        }
        let lines = bench.lines.len() - first;
        assert!(lines as f64 <= 6.0 / (line_s + 0.008) + 2.0, "{lines} lines, each of {line_s} s");
        assert!(lines as f64 >= 0.8 * (6.0 / (line_s + 0.030)), "{lines} lines, each of {line_s} s");
    }
}

#[test]
fn standing_overtakes_the_line_in_flight_also_if_the_robot_ignores_the_first() {
    for (overrun, most) in [(false, 330), (true, 500)] {
        for phase in 0..20 {
            let mut bench = ready(Options { line_s: 0.15, overrun, ..Options::default() }, "");
            bench.give(0.5, 0.0, 0.0);
            bench.run(1000 + 13 * phase);
            bench.give(0.0, 0.0, 0.0);
            let at = bench.now_ms;
            bench.run(1000);
            let moved = (at..bench.now_ms).filter(|ms| bench.stops.binary_search(ms).is_err()).max().unwrap_or(at);
            assert!(moved - at <= most, "overrun {overrun}, phase {phase}: it moves for {} ms", moved - at);
        }
    }
}

#[test]
fn a_dead_link_is_noticed_and_the_robot_is_stopped_when_it_is_back() {
    for phase in 0..40 {
        let mut bench = ready(Options::default(), "");
        bench.give(if phase % 2 == 0 { 0.5 } else { 0.0 }, 0.0, 0.0);
        bench.run(500 + 17 * phase);
        bench.dead = true;
        let noticed = bench.until(Health::Silent, 1000);
        assert!(noticed <= 260, "phase {phase}: {noticed} ms");
        bench.run(100 * phase);
        assert_eq!(bench.health(), Some(Health::Silent));
        bench.dead = false;
        let back = bench.now_ms;
        bench.give(0.0, 0.0, 0.0);
        bench.until(Health::Ready, 2500);
        let moved = (back..bench.now_ms).filter(|ms| bench.stops.binary_search(ms).is_err()).max().unwrap_or(back);
        assert!(moved - back <= 700, "phase {phase}: it moves for {} ms", moved - back);
    }
}

#[test]
fn missing_answers_are_noticed_although_pushes_arrive() {
    for phase in 0..40 {
        let mut bench = ready(Options::default(), "");
        bench.give(if phase % 2 == 0 { 0.5 } else { 0.0 }, 0.0, 0.0);
        bench.run(500 + 7 * phase);
        bench.robot.answers = false;
        let noticed = bench.until(Health::Silent, 1000);
        assert!(noticed <= 300, "phase {phase}: {noticed} ms");
        bench.run(50);
        assert_eq!(bench.robot.speed, [0.0; 3], "it was told to stand");
        bench.robot.answers = true;
        bench.until(Health::Ready, 3000);
    }
}

#[test]
fn an_expired_command_is_standing_even_if_the_body_says_nothing() {
    let mut bench = ready(Options::default(), "");
    bench.give(0.5, 0.0, 0.0);
    bench.run(500);
    bench.twist = None;
    bench.run(230);
    assert_eq!(bench.robot.speed, [0.0; 3]);
    let last = bench.holds.iter().rev().find_map(|(at, hold)| match hold {
        Hold::For(span) => Some((*at, span.as_nanos() / 1_000_000)),
        _ => None,
    });
    let (at, ms) = last.expect("each velocity says how long the worker lets it go on");
    assert!(ms <= 200 && at + ms <= bench.now_ms, "{at} {ms}");
}

#[test]
fn an_unknown_heading_and_a_low_battery_and_a_fall_are_standing() {
    let mut bench = ready(Options::default(), "battery_least = 0.2\nbattery_period_s = 1.0\n");
    bench.give(0.5, 0.0, 0.0);
    bench.run(500);
    assert!(bench.robot.speed[0] > 0.4);
    bench.robot.options.battery = 20;
    bench.run(1500);
    assert_eq!((bench.robot.speed, bench.health()), ([0.0; 3], Some(Health::Faulty)));
    bench.robot.options.battery = 30;
    bench.run(1500);
    assert!(bench.robot.speed[0] > 0.4);
    bench.robot.rolled_over = true;
    bench.run(300);
    assert_eq!((bench.robot.speed, bench.health()), ([0.0; 3], Some(Health::Faulty)));
    bench.robot.rolled_over = false;
    bench.run(300);
    assert!(bench.robot.speed[0] > 0.4);
    bench.twist = None;
    let until = bench.now() + Span::from_millis(200);
    let drive = Drive { robot: RobotId(3), velocity: Vec2::new(0.5, 0.0), until };
    let mut out = Vec::new();
    bench.driver.drive(bench.now(), &Command { drive, body: None }, &mut out);
    bench.take(out);
    bench.run(20);
    assert_eq!(bench.robot.speed, [0.0; 3]);
}

#[test]
fn what_an_earlier_program_left_unfinished_does_no_harm() {
    let mut bench = Bench::new(Options::default(), "");
    bench.robot.take(0.0, 99, b"chassis speed x 1 y 0");
    bench.until(Health::Ready, 1000);
    bench.run(100);
    assert_eq!(bench.robot.speed, [0.0; 3]);
}

#[test]
fn a_session_of_another_program_is_taken_over() {
    let mut bench = Bench::new(Options::default(), "");
    bench.robot.take(0.0, 99, b"command;robot mode free;chassis speed x 1 y 0 z 0;");
    bench.run(1);
    bench.until(Health::Ready, 1500);
    bench.run(100);
    assert_eq!((bench.robot.speed, bench.connection), ([0.0; 3], 1), "its error is not taken for an answer");
}

#[test]
fn no_bytes_of_the_robot_panic_the_driver_or_move_the_robot() {
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut below = |limit: u64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state % limit
    };
    let mut bench = ready(Options::default(), "");
    bench.give(0.0, 0.0, 0.0);
    let words: [&[u8]; 10] = [
        b"ok",
        b";",
        b" seq ",
        b"12",
        b"error",
        b"chassis push position 1.000 2.000 ;",
        b"attitude 1 2 3",
        b"\xff",
        b"-9e99",
        b" ",
    ];
    for _ in 0..20_000 {
        let bytes: Vec<u8> = (0..below(6)).flat_map(|_| words[below(10) as usize].to_vec()).collect();
        let packet = match below(5) {
            0 => FromWorker::Control(bench.connection, &bytes).encode(),
            1 => FromWorker::Event(bench.connection, &bytes).encode(),
            2 => FromWorker::Push(below(1 << 40), &bytes).encode(),
            3 => FromWorker::Closed(below(4) as u32, b"no route").encode(),
            _ => bytes.into(),
        };
        let mut out = Vec::new();
        bench.driver.receive(bench.now(), &packet, &mut out);
        bench.take(out);
        bench.step();
        assert_eq!(bench.robot.speed, [0.0; 3]);
    }
    bench.until(Health::Ready, 5000);
}
