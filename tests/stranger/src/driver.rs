//! The driver `datagrams`, for robots that take their velocity as datagrams of two numbers. `source.rs` has one.

use std::net::{SocketAddr, UdpSocket};

use actix::{Actor, ActorContext, Context, Handler, Recipient, Supervised};
use murmurate::config::ConfigError;
use murmurate::drivers::{Command, Driver, Entry, Limits, Out, Parts};
use murmurate::edge::{Input, Port, Seat, Settings, Worker};
use murmurate::messages::geometry::Planar;
use murmurate::messages::ids::RobotId;
use murmurate::time::Time;
use serde::Deserialize;

/// Entry in a registry.
pub const DATAGRAMS: Entry =
    Entry { name: "datagrams", about: "robots that take their velocity as datagrams of two numbers", make };

/// Settings in a deployment.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Address at which the robot listens.
    robot: SocketAddr,
}

fn make(settings: &Settings, _: RobotId) -> Result<Parts, ConfigError> {
    let Config { robot } = settings.read()?;
    Ok(Parts { driver: Box::new(|| Box::new(Datagrams)), worker: Some(Box::new(Sender { robot })) })
}

/// Driver on the control thread, without I/O.
struct Datagrams;

impl Driver for Datagrams {
    fn limits(&self) -> Limits {
        Limits { speed_m_s: 1.5 }
    }

    fn drive(&mut self, _: Time, command: &Command, out: &mut Vec<Out>) {
        let numbers = command.drive.velocity.to_array().map(f32::to_le_bytes);
        out.push(Out::Send(numbers.concat().into()));
    }

    fn receive(&mut self, _: Time, _: &[u8], out: &mut Vec<Out>) {
        out.push(Out::Refused("such a robot says nothing"));
    }
}

/// Worker, which does the I/O.
struct Sender {
    robot: SocketAddr,
}

impl Worker for Sender {
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.start(move |port| {
            let socket = UdpSocket::bind("127.0.0.1:0").expect("a machine has a loopback interface");
            Line { robot: self.robot, socket, _port: port }
        })
    }
}

/// Actor of the worker, on a thread of its own.
struct Line {
    robot: SocketAddr,
    socket: UdpSocket,
    _port: Port,
}

impl Actor for Line {
    type Context = Context<Self>;
}

impl Supervised for Line {}

impl Handler<Input> for Line {
    type Result = ();

    fn handle(&mut self, input: Input, context: &mut Context<Self>) {
        match input {
            // The next datagram replaces a lost one.
            Input::Packet(packet) => drop(self.socket.send_to(&packet, self.robot)),
            Input::Close => context.stop(),
        }
    }
}
