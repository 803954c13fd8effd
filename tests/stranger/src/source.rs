//! The source `bench`: a robot on a test bench, which takes its velocity as datagrams of two numbers (`driver.rs`) and
//! reports the position that it would have. The deployment gives its start.

use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use murmurate::config::ConfigError;
use murmurate::edge::{Port, Settings, Worker};
use murmurate::localization::{Entry, In, Made, Out, Source};
use murmurate::messages::geometry::{Deviation, Pose, Twist, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;
use murmurate::time::{Span, Time};
use serde::Deserialize;

/// Entry in a registry.
pub const BENCH: Entry = Entry { name: "bench", about: "a robot on a test bench, driven by datagrams", make };

/// Time without a datagram after which the robot stops.
const PATIENCE: Duration = Duration::from_millis(500);

/// Settings in a deployment.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Address at which the robot listens.
    listens: SocketAddr,
    /// Start position \[m\].
    begins: [f32; 2],
}

fn make(settings: &Settings, robots: &[RobotId]) -> Result<Made, ConfigError> {
    let config: Config = settings.read()?;
    let [robot] = *robots else {
        return Err(ConfigError::field("name", "a bench holds one robot".to_owned()));
    };
    Ok(Made { source: Box::new(move || Box::new(Bench { robot })), worker: Box::new(Robot { config }) })
}

/// Source on the control thread, without I/O.
struct Bench {
    robot: RobotId,
}

impl Source for Bench {
    fn take(&mut self, _: Time, input: In, out: &mut Vec<Out>) {
        let In::Packet(packet) = input else { return };
        let Some((stamp, numbers)) = packet.split_at_checked(8).filter(|(_, numbers)| numbers.len() == 16) else {
            out.push(Out::Refused("it is no word of a bench"));
            return;
        };
        let number = |at: usize| f32::from_le_bytes(numbers[4 * at..4 * at + 4].try_into().expect("four bytes"));
        out.push(Out::Reading(Reading {
            robot: self.robot,
            stamp_ns: u64::from_le_bytes(stamp.try_into().expect("eight bytes")),
            pose: Pose { position: Vec2::new(number(0), number(1)), heading: None },
            twist: Twist { velocity: Vec2::new(number(2), number(3)), yaw_rate: None },
            deviation: Deviation::default(),
        }));
    }
}

/// Worker on its own thread, which simulates the bench.
struct Robot {
    config: Config,
}

impl Worker for Robot {
    fn run(self: Box<Self>, port: Port) {
        let socket = UdpSocket::bind(self.config.listens).expect("nobody else has the robot's port");
        socket.set_read_timeout(Some(Duration::from_millis(20))).expect("a socket can wait");
        let (began, sender) = (Instant::now(), port.sender());
        let (mut position, mut velocity) = (Vec2::from(self.config.begins), Vec2::zeros());
        let (mut heard, mut before) = (began, began);
        while !sender.is_closed() {
            let mut bytes = [0; 8];
            let came = matches!(socket.recv(&mut bytes), Ok(8));
            let now = Instant::now();
            position += velocity * now.duration_since(before).as_secs_f32();
            before = now;
            if came {
                let (x, y) = bytes.split_at(4);
                let number = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().expect("four bytes"));
                (velocity, heard) = (Vec2::new(number(x), number(y)), now);
            } else if now.duration_since(heard) > PATIENCE {
                velocity = Vec2::zeros();
            }
            let stamp = Span::from_secs(now.duration_since(began).as_secs_f64()).as_nanos().to_le_bytes();
            let numbers = [position.x, position.y, velocity.x, velocity.y].map(f32::to_le_bytes);
            sender.send([&stamp[..], &numbers.concat()].concat().into());
        }
    }
}
