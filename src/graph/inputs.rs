//! Inputs of a host from outside its graph: datagrams, packets of its devices' workers, and orders of its own process.
//! All of them come in here, so that a record of a host has them all and a replay gives them again.

use std::net::SocketAddr;

use super::process::{Graph, ProcessEvent};
use crate::actors::{body, controller, localizer, network, state_server, status};
use crate::edge::Packet;
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::latch::Latch;
use crate::messages::wire::{Stop, Wire};
use crate::net::protocol::codec::Frame;

/// Driver or source of a host, whose worker does its I/O.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceId {
    /// The driver of a robot's motors.
    Driver(RobotId),
    /// The host's source of readings.
    Source,
}

/// Input of a host from outside its graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// Datagram that has arrived on a link, with its source address if the transport has addresses.
    Frame(LinkId, Frame, Option<SocketAddr>),
    /// Number of datagrams that a transport of the link has dropped because a queue was full.
    Dropped(LinkId, u64),
    /// Packet of a device's worker (I/O thread).
    Packet(DeviceId, Packet),
    /// The worker of a device has ended.
    Ended(DeviceId),
    /// Order of the host's process to leave the team: its robots stop, then it announces the leave.
    Leave,
    /// Order of the host's process to engage the team's emergency stop.
    Stop,
}

impl Input {
    /// Whether the input is an order of the host's own process.
    pub fn is_order(&self) -> bool {
        matches!(self, Input::Leave | Input::Stop)
    }
}

impl Graph {
    /// Passes an input on to the actors of a host that runs here, and reports it.
    pub fn take(&self, host: HostId, input: Input) {
        (self.report)(host, ProcessEvent::Input(&input));
        match input {
            Input::Frame(link, frame, from) => {
                self.networks[usize::from(host.0)].send(network::In::Frame(link, frame, from));
            }
            Input::Dropped(link, count) => {
                self.networks[usize::from(host.0)].send(network::In::Dropped(link, count));
            }
            Input::Packet(DeviceId::Driver(robot), packet) => {
                self.bodies[robot.index()].send(body::In::Packet(packet));
            }
            Input::Packet(DeviceId::Source, packet) => self.source.send(localizer::In::Packet(packet)),
            Input::Ended(DeviceId::Driver(robot)) => self.bodies[robot.index()].send(body::In::WorkerEnded),
            Input::Ended(DeviceId::Source) => {
                tracing::error!("the source of this host has ended: no more readings; restart the host");
            }
            Input::Leave => self.send_leave(host),
            Input::Stop => {
                let stop = Stop::engage(host, Latch::default());
                self.networks[usize::from(host.0)].send(network::In::Publish(Wire::Stop(stop)));
            }
        }
    }

    fn send_leave(&self, host: HostId) {
        for robot in RobotId::team(self.bodies.len()) {
            if self.routes.actuator_host(robot) == host {
                self.bodies[robot.index()].send(body::In::Leave);
            }
            if self.routes.agent_host(robot) == host {
                self.controllers[robot.index()].send(controller::In::Leave);
            }
        }
        if self.routes.server_host() == host {
            self.server.send(state_server::In::Leave);
        }
        self.statuses[usize::from(host.0)].send(status::In::Leave);
    }
}
