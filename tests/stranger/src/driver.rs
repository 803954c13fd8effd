//! The driver `datagrams`, for robots that take their velocity as datagrams of two numbers. `source.rs` has one.

use std::net::{SocketAddr, UdpSocket};

use actix::Recipient;
use murmurate::config::ConfigError;
use murmurate::drivers::{Command, Driver, Entry, Limits, Out, Parts};
use murmurate::edge::{Input, Seat, Settings, Worker};
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
        // On a thread of its own, whose actor gets a packet after the other.
        seat.serve(move || {
            let socket = UdpSocket::bind("127.0.0.1:0").expect("a machine has a loopback interface");
            // The next datagram replaces a lost one.
            move |packet| drop(socket.send_to(&packet, self.robot))
        })
    }
}
