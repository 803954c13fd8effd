//! Wiring of the state server, of what a host hands in to those of its actors that follow it and the emergency stop,
//! and of the host's own voice. No logic lives here.

use tracing::info_span;

use super::process::Graph;
use crate::actors::state_server::{self, StateServer};
use crate::actors::status::{self, Status};
use crate::actors::{agent, body, controller, network, world};
use crate::graph::Plan;
use crate::messages::ids::HostId;
use crate::messages::wire::{Mode, Stop, Wire};
use crate::runtime::clock::Clock;
use crate::runtime::shell::{Mailbox, start};

/// The actors of one host that follow the state server and the emergency stop.
pub(super) struct Led {
    pub agents: Vec<Mailbox<agent::In>>,
    pub controllers: Vec<Mailbox<controller::In>>,
    pub bodies: Vec<Mailbox<body::In>>,
    pub world: Option<Mailbox<world::In>>,
    pub status: Mailbox<status::In>,
}

impl Led {
    /// Hands in an instruction of the state server.
    pub fn follow(&self, mode: &Mode) {
        self.world.iter().for_each(|world| world.send(world::In::Mode(mode.clone())));
        self.agents.iter().for_each(|agent| agent.send(agent::In::Mode(mode.clone())));
        self.controllers.iter().for_each(|controller| controller.send(controller::In::Mode(mode.clone())));
        self.bodies.iter().for_each(|body| body.send(body::In::Latch(mode.latch)));
        self.status.send(status::In::Mode(mode.phase));
    }

    /// Hands in an emergency stop, a re-arm or a question of an operator.
    pub fn stop(&self, stop: Stop) {
        self.controllers.iter().for_each(|controller| controller.send(controller::In::Stop(stop)));
        self.bodies.iter().for_each(|body| body.send(body::In::Stop(stop)));
        self.status.send(status::In::Stop(stop));
    }
}

/// Starts the voice of one host.
pub(super) fn wire_status(clock: &Clock, graph: &Graph, host: HostId, config: status::Config) {
    let network = graph.network_of(host);
    let make = move |_| Status::new(&config);
    start(clock, &graph.statuses[usize::from(host.0)], info_span!("status"), make, move |status| {
        network.send(network::In::Publish(Wire::Status(status)));
    });
}

/// Starts the state server.
pub(super) fn wire_server(clock: &Clock, plan: &Plan, graph: &Graph) {
    let config = state_server::Config {
        layouts: plan.layouts.clone(),
        repeat: plan.repeat,
        placement: plan.deployment.placement,
        limit: plan.scenario.rules().limit,
        hosts: (0..plan.deployment.hosts.len()).map(|host| graph.routes.robots_of(host).to_vec()).collect(),
    };
    let (host, robots) = (graph.routes.server_host(), plan.deployment.robots);
    let (network, status) = (graph.network_of(host), graph.status_of(host));
    let make = move |life| StateServer::new(config.clone(), robots, life);
    start(clock, &graph.server, info_span!("state server"), make, move |out| match out {
        state_server::Out::Mode(mode) => network.send(network::In::Publish(Wire::Mode(mode))),
        state_server::Out::Leading(leading) => status.send(status::In::Leading(leading)),
    });
}
