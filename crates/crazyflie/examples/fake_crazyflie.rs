//! Fake Crazyflies for clients of others and for hosts: `fake_crazyflie [COUNT]` serves them at `udp://127.0.0.1:19850`
//! and the ports after it. Its output are lines of a tracker for the source `program`, its errors what the robots do,
//! as JSON lines ten times a second. It ends with its input.

#[path = "../tests/firmware/mod.rs"]
#[allow(dead_code)] // Each program uses its part.
mod firmware;

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use firmware::Firmware;

/// Port of the first robot, as simulators of the firmware have it.
const PORT: u16 = 19850;
/// Steps of the model between two readings.
const READING: u64 = 10;

struct Served {
    robot: Firmware,
    socket: UdpSocket,
    client: Option<SocketAddr>,
}

impl Served {
    fn new(number: u16) -> Served {
        let socket = UdpSocket::bind(("127.0.0.1", PORT + number)).expect("the port is free");
        socket.set_nonblocking(true).expect("it can be set");
        // Two columns, each robot looking in another direction.
        let (row, column) = (f64::from(number / 2), f64::from(number % 2));
        let robot = Firmware::new(1.5 * row - 1.5, 1.5 * column - 0.75, 0.7 * f64::from(number));
        Served { robot, socket, client: None }
    }

    fn step(&mut self) {
        let mut buffer = [0; 64];
        loop {
            match self.socket.recv_from(&mut buffer) {
                Ok((length, from)) => {
                    self.client = Some(from);
                    for answer in self.robot.take(&buffer[..length]) {
                        let _ = self.socket.send_to(&answer, from);
                    }
                }
                // An ICMP error of a client that has gone.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
                Err(_) => break,
            }
        }
        for packet in self.robot.step(0.002) {
            let _ = self.client.map(|client| self.socket.send_to(&packet, client));
        }
    }

    fn reading(&self, number: usize) -> String {
        let air = &self.robot.air;
        let heading = air.yaw.sin().atan2(air.yaw.cos());
        let ([x, y, _], [vx, vy, _]) = (air.at, air.velocity);
        format!(
            r#"{{"robot": {number}, "stamp_s": {}, "x": {x}, "y": {y}, "vx": {vx}, "vy": {vy}, "heading": {heading}}}"#,
            air.now
        )
    }

    fn state(&self, number: usize) -> String {
        let (air, robot) = (&self.robot.air, &self.robot);
        format!(
            r#"{{"robot": {number}, "x": {:.3}, "y": {:.3}, "z": {:.3}, "motors": {}, "crashed": {}, "setpoints": {}, "cuts": {}}}"#,
            air.at[0],
            air.at[1],
            air.at[2],
            air.motors,
            air.crashed,
            robot.setpoints.len(),
            robot.cuts
        )
    }
}

fn main() {
    let count: u16 = std::env::args().nth(1).map_or(1, |count| count.parse().expect("a number of robots"));
    let mut all: Vec<Served> = (0..count).map(Served::new).collect();
    let over = Arc::new(AtomicBool::new(false));
    let ends = Arc::clone(&over);
    std::thread::spawn(move || {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        ends.store(true, Ordering::Relaxed);
    });
    let (began, mut steps) = (Instant::now(), 0u64);
    while !over.load(Ordering::Relaxed) {
        steps += 1;
        all.iter_mut().for_each(Served::step);
        let (mut out, mut log) = (std::io::stdout(), std::io::stderr());
        for (number, served) in all.iter().enumerate() {
            if steps.is_multiple_of(READING) {
                let _ = writeln!(out, "{}", served.reading(number));
            }
            if steps.is_multiple_of(50) {
                let _ = writeln!(log, "{}", served.state(number));
            }
        }
        let _ = out.flush();
        let next = began + Duration::from_millis(2 * steps);
        // The fake robots live in real time, in which the programs of others speak to them.
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
}
