//! A driver and a fake Crazyflie, with a network between them that delays and loses packets.

use std::collections::VecDeque;

use murmurate::drivers::{Command, Driver, Out, Vertical};
use murmurate::edge::Settings;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::local::{BodyTwist, Drive};
use murmurate::messages::wire::{Flight, Hardware, Reading};
use murmurate::time::{Span, Time};
use murmurate_crazyflie::ENTRY;
use murmurate_crazyflie::link::{FromWorker, ToWorker};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::firmware::Firmware;

/// Delay of the network in each direction \[ms\].
const DELAY_MS: u64 = 3;

/// Driver and worker of one robot, and the simulated robot.
pub struct Bench {
    pub now_ms: u64,
    pub driver: Box<dyn Driver>,
    pub robot: Firmware,
    /// Share of packets that are lost in each direction.
    pub loss: f64,
    draws: ChaCha8Rng,
    to_robot: VecDeque<(u64, Vec<u8>)>,
    to_driver: VecDeque<(u64, Vec<u8>)>,
    /// Whether the driver's thread runs, and the source sees the robot.
    pub runs: bool,
    pub sees: bool,
    /// Place that the source adds to the robot's.
    pub shift: Vec2,
    /// Velocity that is commanded ten times a second.
    pub command: Option<Vec2>,
    pub flights: Vec<(u64, Flight)>,
    pub conditions: Vec<(u64, Hardware)>,
    pub odometry: Vec<Reading>,
    pub refused: u64,
    /// Time at which the worker would make the robot land.
    pub lands_ms: Option<u64>,
}

impl Bench {
    pub fn new(settings: &str, robot: Firmware) -> Bench {
        let table = format!("uri = 'udp://127.0.0.1:19850'\n{settings}").parse().expect("TOML");
        let parts = (ENTRY.make)(&Settings { name: "crazyflie".to_owned(), table }, RobotId(3)).expect("it is sound");
        Bench {
            now_ms: 0,
            driver: (parts.driver)(),
            robot,
            loss: 0.0,
            draws: ChaCha8Rng::seed_from_u64(7),
            to_robot: VecDeque::new(),
            to_driver: VecDeque::new(),
            runs: true,
            sees: true,
            shift: Vec2::zeros(),
            command: None,
            flights: Vec::new(),
            conditions: Vec::new(),
            odometry: Vec::new(),
            refused: 0,
            lands_ms: None,
        }
    }

    pub fn now(&self) -> Time {
        Time::ZERO + Span::from_millis(self.now_ms)
    }

    /// Returns a bench whose robot was seen, connected, and has risen to 0.5 m.
    pub fn aloft(settings: &str, robot: Firmware) -> Bench {
        let mut bench = Bench::new(settings, robot);
        bench.rise();
        bench
    }

    /// Connects, rises to 0.5 m, and waits until the robot is there.
    pub fn rise(&mut self) {
        self.run(2500);
        self.order(Vertical::Rise { height_m: 0.5 });
        self.until(6000, |bench| bench.state() == Some(Flight::Flying));
    }

    pub fn state(&self) -> Option<Flight> {
        self.flights.last().map(|(_, flight)| *flight)
    }

    pub fn condition(&self) -> &Hardware {
        &self.conditions.last().expect("there is one").1
    }

    pub fn order(&mut self, order: Vertical) {
        let mut out = Vec::new();
        self.driver.fly(self.now(), order, &mut out);
        self.carry(out);
    }

    pub fn drive(&mut self, velocity: Vec2) {
        let drive = Drive { robot: RobotId(3), velocity, until: self.now() + Span::from_millis(200) };
        let mut out = Vec::new();
        self.driver.drive(self.now(), &Command { drive, body: Some(BodyTwist::default()) }, &mut out);
        self.carry(out);
    }

    /// Runs for a time \[ms\].
    pub fn run(&mut self, ms: u64) {
        (0..ms).for_each(|_| self.step());
    }

    /// Runs until something holds, for at most a time \[ms\]; returns how long that took.
    pub fn until(&mut self, most_ms: u64, holds: impl Fn(&Bench) -> bool) -> u64 {
        let began = self.now_ms;
        while !holds(self) {
            let so_far = (self.flights.last(), self.conditions.last(), self.robot.air.at);
            assert!(self.now_ms < began + most_ms, "it does not happen: {so_far:?}");
            self.step();
        }
        self.now_ms - began
    }

    fn lost(&mut self) -> bool {
        self.draws.random_bool(self.loss)
    }

    fn step(&mut self) {
        self.now_ms += 1;
        let now = self.now_ms;
        while let Some((_, bytes)) = self.to_robot.pop_front_due(now) {
            for answer in self.robot.take(&bytes) {
                self.reply(answer);
            }
        }
        for packet in self.robot.step(0.001) {
            self.reply(packet);
        }
        if !self.runs {
            self.to_driver.clear();
            return;
        }
        let mut out = Vec::new();
        while let Some((_, bytes)) = self.to_driver.pop_front_due(now) {
            self.driver.receive(self.now(), &FromWorker::Crtp(&bytes).encode(), &mut out);
        }
        if now.is_multiple_of(10) && self.sees {
            let at = self.robot.air.at;
            let position = Vec2::new(at[0] as f32, at[1] as f32) + self.shift;
            let mut reading =
                Reading::of_point(RobotId(3), now * 1_000_000, Motion { position, velocity: Vec2::zeros() });
            reading.pose.heading = Some(self.robot.air.yaw as f32);
            self.driver.measured(self.now(), &reading, &mut out);
        }
        if self.driver.wake_at().is_some_and(|at| at <= self.now()) {
            self.driver.wake(self.now(), &mut out);
        }
        self.carry(out);
        if let Some(velocity) = self.command.filter(|_| now.is_multiple_of(100)) {
            self.drive(velocity);
        }
    }

    fn reply(&mut self, packet: Vec<u8>) {
        if !self.lost() {
            self.to_driver.push_back((self.now_ms + DELAY_MS, packet));
        }
    }

    fn carry(&mut self, out: Vec<Out>) {
        for out in out {
            match out {
                Out::Send(packet) => {
                    let packet = ToWorker::decode(&packet).expect("it is one");
                    let hold_ms = packet.hold.as_nanos() / 1_000_000;
                    self.lands_ms = (hold_ms > 0).then_some(self.now_ms + hold_ms);
                    if !packet.crtp.is_empty() && !self.lost() {
                        self.to_robot.push_back((self.now_ms + DELAY_MS, packet.crtp.to_vec()));
                    }
                }
                Out::Odometry(reading) => self.odometry.push(reading),
                Out::Condition(hardware) => self.conditions.push((self.now_ms, hardware)),
                Out::Flight(flight) => self.flights.push((self.now_ms, flight)),
                Out::Refused(_) => self.refused += 1,
                Out::Drive(_) => panic!("it is no simulated robot"),
            }
        }
    }
}

/// Queue of what arrives at a time \[ms\].
trait Due {
    fn pop_front_due(&mut self, now_ms: u64) -> Option<(u64, Vec<u8>)>;
}

impl Due for VecDeque<(u64, Vec<u8>)> {
    fn pop_front_due(&mut self, now_ms: u64) -> Option<(u64, Vec<u8>)> {
        self.front().is_some_and(|(at, _)| *at <= now_ms).then(|| self.pop_front()).flatten()
    }
}
