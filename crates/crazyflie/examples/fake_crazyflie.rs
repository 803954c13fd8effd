//! Fake Crazyflies for clients of others and for hosts: `fake_crazyflie [COUNT [PORT]]` serves them at
//! `udp://127.0.0.1:19850`, or another first port, and those after it. Its output are lines of a tracker for the source
//! `program`, its errors what the robots do, as JSON lines with the times of CLOCK_MONOTONIC: their states ten times a
//! second, each setpoint, and what changes.
//!
//! Lines of its input disturb a robot, or `all`: `0 battery 15`, `2 tumbled`, `2 crashed`, `2 locked`, `all loss 9` (in
//! percent, both ways), `1 silent 2` (in seconds). It ends with its input.

#[path = "../tests/firmware/mod.rs"]
#[allow(dead_code)] // Each program uses its part.
mod firmware;

use std::io::{BufRead, ErrorKind, Write};
use std::net::{SocketAddr, UdpSocket};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

use nix::time::{ClockId, clock_gettime};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use firmware::Firmware;
use firmware::airframe::{LEVELS_S, Setpoint};

/// Port of the first robot, as simulators of the firmware have it.
const PORT: u16 = 19850;
/// Steps of the model between two readings, and between two states.
const READING: u64 = 10;
const STATE: u64 = 50;

struct Served {
    number: usize,
    robot: Firmware,
    socket: UdpSocket,
    client: Option<SocketAddr>,
    draws: ChaCha8Rng,
    /// Share of packets that are lost, each way, and time of the model until which the robot hears and says nothing.
    loss: f64,
    silent: f64,
    /// Number of orders and of setpoints that were written, and the last state of the motors and commanders.
    written: (usize, usize),
    was: &'static str,
}

impl Served {
    fn new(number: u16, port: u16) -> Served {
        let socket = UdpSocket::bind(("127.0.0.1", port + number)).expect("the port is free");
        socket.set_nonblocking(true).expect("it can be set");
        // Two columns, each robot looking in another direction.
        let (row, column) = (f64::from(number / 2), f64::from(number % 2));
        let robot = Firmware::new(1.5 * row - 1.5, 1.5 * column - 0.75, 0.7 * f64::from(number));
        Served {
            number: number.into(),
            robot,
            socket,
            client: None,
            draws: ChaCha8Rng::seed_from_u64(number.into()),
            loss: 0.0,
            silent: 0.0,
            written: (0, 0),
            was: "off",
        }
    }

    /// Returns whether a packet is lost.
    fn loses(&mut self) -> bool {
        self.robot.air.now < self.silent || self.draws.random::<f64>() < self.loss
    }

    fn step(&mut self) {
        let mut buffer = [0; 64];
        loop {
            match self.socket.recv_from(&mut buffer) {
                Ok((length, from)) => {
                    self.client = Some(from);
                    if self.loses() {
                        continue;
                    }
                    for answer in self.robot.take(&buffer[..length]) {
                        self.send(&answer);
                    }
                    self.write();
                }
                // An ICMP error of a client that has gone.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
                Err(_) => break,
            }
        }
        for packet in self.robot.step(0.002) {
            self.send(&packet);
        }
        self.write();
    }

    fn send(&mut self, packet: &[u8]) {
        if !self.loses() {
            let _ = self.client.map(|client| self.socket.send_to(packet, client));
        }
    }

    /// Carries out a line of the input.
    fn disturb(&mut self, word: &str, number: f64) {
        match word {
            "battery" => self.robot.battery = number as u8,
            "tumbled" => self.robot.air.tumbled = true,
            "crashed" => self.robot.air.crashed = true,
            "locked" => self.robot.air.locked = true,
            "loss" => self.loss = number / 100.0,
            "silent" => self.silent = self.robot.air.now + number,
            _ => panic!("no disturbance is called {word}"),
        }
    }

    /// Returns the commander that flies the robot: none, a setpoint, one that is too old, or the high-level one.
    fn flown(&self) -> &'static str {
        let air = &self.robot.air;
        match air.low {
            _ if !air.motors => "off",
            Some((since, _)) if air.now - since >= LEVELS_S => "level",
            Some(_) => "setpoint",
            None => "high-level",
        }
    }

    /// Writes the setpoints and orders that are new, and the commander if it has changed.
    fn write(&mut self) {
        let (now, number, robot) = (clock_s(), self.number, &self.robot);
        let mut log = std::io::stderr();
        for (_, setpoint) in &robot.setpoints[self.written.0..] {
            let (kind, floats) = match setpoint {
                Setpoint::Hover { velocity: [ahead, left], yaw_rate, height } => {
                    ("hover", [*ahead, *left, *yaw_rate, *height])
                }
                Setpoint::World { velocity: [x, y, z], yaw_rate } => ("world", [*x, *y, *yaw_rate, *z]),
            };
            let yaw = robot.air.estimated_yaw;
            let _ = writeln!(log, r#"{{"robot": {number}, "at": {now}, "{kind}": {floats:?}, "yaw": {yaw}}}"#);
        }
        for (_, order) in &robot.orders[self.written.1..] {
            let _ = writeln!(log, r#"{{"robot": {number}, "at": {now}, "order": {order}}}"#);
        }
        self.written = (robot.setpoints.len(), robot.orders.len());
        let flown = self.flown();
        if flown != self.was {
            let z = robot.air.at[2];
            let _ = writeln!(log, r#"{{"robot": {number}, "at": {now}, "flown": "{flown}", "z": {z:.3}}}"#);
            self.was = flown;
        }
    }

    fn reading(&self) -> String {
        let (air, number) = (&self.robot.air, self.number);
        let heading = air.yaw.sin().atan2(air.yaw.cos());
        let ([x, y, _], [vx, vy, _]) = (air.at, air.velocity);
        format!(
            r#"{{"robot": {number}, "stamp_s": {}, "x": {x}, "y": {y}, "vx": {vx}, "vy": {vy}, "heading": {heading}}}"#,
            air.now
        )
    }

    fn state(&self) -> String {
        let (air, robot) = (&self.robot.air, &self.robot);
        format!(
            r#"{{"robot": {}, "at": {}, "x": {:.3}, "y": {:.3}, "z": {:.3}, "motors": {}, "crashed": {}, "hardest": {:.2}, "setpoints": {}, "cuts": {}, "refused": {}}}"#,
            self.number,
            clock_s(),
            air.at[0],
            air.at[1],
            air.at[2],
            air.motors,
            air.crashed,
            air.hardest,
            robot.setpoints.len(),
            robot.cuts,
            robot.refused
        )
    }
}

/// Returns the time of CLOCK_MONOTONIC, as other programs of this machine read it \[s\].
fn clock_s() -> f64 {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("there is one");
    now.tv_sec() as f64 + 1e-9 * now.tv_nsec() as f64
}

/// Returns the lines of the input. Its end is that of the channel.
fn lines() -> Receiver<String> {
    let (sender, lines) = channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            let _ = sender.send(line);
        }
    });
    lines
}

fn disturb(all: &mut [Served], line: &str) {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [who, word, ..] = words[..] else { panic!("no robot and disturbance: {line}") };
    let number = words.get(2).map_or(0.0, |number| number.parse().expect("a number"));
    let chosen = |served: &&mut Served| who == "all" || who == served.number.to_string();
    all.iter_mut().filter(chosen).for_each(|served| served.disturb(word, number));
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let count: u16 = arguments.next().map_or(1, |count| count.parse().expect("a number of robots"));
    let port: u16 = arguments.next().map_or(PORT, |port| port.parse().expect("a port"));
    let mut all: Vec<Served> = (0..count).map(|number| Served::new(number, port)).collect();
    let input = lines();
    let (began, mut steps) = (Instant::now(), 0u64);
    loop {
        match input.try_recv() {
            Ok(line) => disturb(&mut all, &line),
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => break,
        }
        steps += 1;
        all.iter_mut().for_each(Served::step);
        let (mut out, mut log) = (std::io::stdout(), std::io::stderr());
        for served in &all {
            if steps.is_multiple_of(READING) {
                let _ = writeln!(out, "{}", served.reading());
            }
            if steps.is_multiple_of(STATE) {
                let _ = writeln!(log, "{}", served.state());
            }
        }
        let _ = out.flush();
        let next = began + Duration::from_millis(2 * steps);
        // The fake robots live in real time, in which the programs of others speak to them.
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
}
