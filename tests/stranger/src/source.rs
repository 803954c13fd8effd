//! The source `bench`: a robot on a test bench, which takes its velocity as datagrams of two numbers (`driver.rs`) and
//! reports the position that it would have. The deployment gives its start.

use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use actix::{Actor, ActorContext, AsyncContext, Context, Handler, Recipient, Supervised};
use murmurate::config::ConfigError;
use murmurate::edge::{Input, Port, Seat, Settings, Worker};
use murmurate::localization::{Entry, In, Out, Parts, Source};
use murmurate::messages::geometry::{Deviation, Pose, Twist, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;
use murmurate::time::{Span, Time};
use serde::Deserialize;

/// Entry in a registry.
pub const BENCH: Entry = Entry { name: "bench", about: "a robot on a test bench, driven by datagrams", make };

/// Time without a datagram after which the robot stops.
const PATIENCE: Duration = Duration::from_millis(500);

/// Period of the bench's reports.
const PERIOD: Duration = Duration::from_millis(20);

/// Settings in a deployment.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Address at which the robot listens.
    listens: SocketAddr,
    /// Start position \[m\].
    begins: [f32; 2],
}

fn make(settings: &Settings, robots: &[RobotId]) -> Result<Parts, ConfigError> {
    let config: Config = settings.read()?;
    let [robot] = *robots else {
        return Err(ConfigError::field("name", "a bench holds one robot".to_owned()));
    };
    Ok(Parts { source: Box::new(move || Box::new(Bench { robot })), worker: Box::new(Robot { config }) })
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

/// Worker, which simulates the bench.
struct Robot {
    config: Config,
}

impl Worker for Robot {
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.start(move |port| {
            let socket = UdpSocket::bind(self.config.listens).expect("nobody else has the robot's port");
            socket.set_nonblocking(true).expect("a socket need not wait");
            let now = Instant::now();
            let position = Vec2::from(self.config.begins);
            Platform { socket, port, began: now, position, velocity: Vec2::zeros(), heard: now, before: now }
        })
    }
}

/// Actor of the worker, on a thread of its own.
struct Platform {
    socket: UdpSocket,
    port: Port,
    began: Instant,
    position: Vec2,
    velocity: Vec2,
    heard: Instant,
    before: Instant,
}

impl Actor for Platform {
    type Context = Context<Self>;

    fn started(&mut self, context: &mut Context<Self>) {
        context.run_interval(PERIOD, Platform::step);
    }
}

impl Supervised for Platform {}

impl Handler<Input> for Platform {
    type Result = ();

    fn handle(&mut self, input: Input, context: &mut Context<Self>) {
        if input == Input::Close {
            context.stop();
        }
    }
}

impl Platform {
    fn step(&mut self, _: &mut Context<Self>) {
        let (mut bytes, now) = ([0; 8], Instant::now());
        self.position += self.velocity * now.duration_since(self.before).as_secs_f32();
        self.before = now;
        while let Ok(8) = self.socket.recv(&mut bytes) {
            let (x, y) = bytes.split_at(4);
            let number = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().expect("four bytes"));
            (self.velocity, self.heard) = (Vec2::new(number(x), number(y)), now);
        }
        if now.duration_since(self.heard) > PATIENCE {
            self.velocity = Vec2::zeros();
        }
        let stamp = Span::from_secs(now.duration_since(self.began).as_secs_f64()).as_nanos().to_le_bytes();
        let numbers = [self.position.x, self.position.y, self.velocity.x, self.velocity.y].map(f32::to_le_bytes);
        self.port.send([&stamp[..], &numbers.concat()].concat().into());
    }
}
