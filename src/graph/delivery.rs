//! Wiring of the state server, of message delivery within a host, and of the host's Status. Contains no logic.

use std::cell::Cell;
use std::collections::BTreeSet;
use std::rc::Rc;

use tracing::info_span;

use super::event::Event;
use super::process::Graph;
use crate::actors::state_server::{self, StateServer};
use crate::actors::status::{self, Status};
use crate::actors::{agent, body, cache, controller, localizer, network, world};
use crate::messages::ids::{HostId, RobotId};
use crate::messages::phase::Phase;
use crate::messages::wire::{Mode, Stop, Wire};
use crate::runtime::clock::Clock;
use crate::runtime::shell::{Mailbox, start};
use crate::scenario::cost::Ending;
use crate::trial::Trial;

/// Mailboxes of the actors of one host that receive the state server's instructions ([`Mode`]) and emergency stop
/// messages ([`Stop`]).
struct Followers {
    agents: Vec<Mailbox<agent::In>>,
    controllers: Vec<Mailbox<controller::In>>,
    bodies: Vec<Mailbox<body::In>>,
    world: Option<Mailbox<world::In>>,
    status: Mailbox<status::In>,
}

impl Followers {
    /// Delivers an instruction of the state server to the World, Agents and Controllers of this host. Its Bodies get
    /// only the emergency stop latch of the instruction, and its Status only the phase of the episode.
    fn follow(&self, mode: &Mode) {
        self.world.iter().for_each(|world| world.send(world::In::Mode(mode.clone())));
        self.agents.iter().for_each(|agent| agent.send(agent::In::Mode(mode.clone())));
        self.controllers.iter().for_each(|controller| controller.send(controller::In::Mode(mode.clone())));
        self.bodies.iter().for_each(|body| body.send(body::In::Latch(mode.latch)));
        self.status.send(status::In::Mode(mode.phase));
    }

    /// Delivers an emergency stop message to the Controllers, Bodies and Status of this host.
    fn stop(&self, stop: Stop) {
        self.controllers.iter().for_each(|controller| controller.send(controller::In::Stop(stop)));
        self.bodies.iter().for_each(|body| body.send(body::In::Stop(stop)));
        self.status.send(status::In::Stop(stop));
    }
}

/// Returns a function that delivers each received message to the actors of a host that use it. `agents` and `bodies`
/// are the robots whose Agents and Bodies the host runs, `simulated` those that the host's World simulates. `measures`
/// says whether this process runs a source of readings of real robots.
pub(super) fn deliveries(
    graph: &Graph,
    host: HostId,
    agents: &[RobotId],
    (bodies, simulated): (&[RobotId], &[RobotId]),
    measures: bool,
) -> impl Fn(Wire) + use<> {
    let firsts: BTreeSet<RobotId> = agents.iter().map(|robot| graph.routes.agent_robots(*robot)[0]).collect();
    // One entry per agent: its robots, and their caches.
    let team_of = |first: &RobotId| graph.routes.agent_robots(*first).to_vec();
    let caches_of = |robots: &[RobotId]| robots.iter().map(|robot| graph.caches[robot.index()].clone()).collect();
    let caches: Vec<(Vec<RobotId>, Vec<Mailbox<cache::In>>)> =
        firsts.iter().map(team_of).map(|robots| (robots.clone(), caches_of(&robots))).collect();
    let by_robot = (graph.caches.clone(), graph.bodies.clone(), graph.server.clone(), graph.controllers.clone());
    let leads = graph.routes.server_host() == host;
    let driven: BTreeSet<RobotId> = bodies.iter().copied().collect();
    let source = measures.then(|| graph.source.clone());
    let real: BTreeSet<RobotId> = driven.iter().copied().filter(|robot| !simulated.contains(robot)).collect();
    // Robots that this host's World simulates.
    let own: BTreeSet<RobotId> = simulated.iter().copied().collect();
    let decided: BTreeSet<RobotId> = agents.iter().copied().collect();
    let team = Followers {
        agents: firsts.iter().map(|robot| graph.agents[robot.index()].clone()).collect(),
        controllers: agents.iter().map(|robot| graph.controllers[robot.index()].clone()).collect(),
        bodies: driven.iter().map(|robot| graph.bodies[robot.index()].clone()).collect(),
        world: simulated.first().map(|robot| graph.worlds[robot.index()].clone()),
        status: graph.status_of(host),
    };
    // Readings and latents are many, so the Status gets them only after an observer's first message.
    let observed = Cell::new(false);
    move |message| match message {
        Wire::Reading(m) => {
            if real.contains(&m.robot) {
                by_robot.1[m.robot.index()].send(body::In::Reading(m.clone()));
            }
            if decided.contains(&m.robot) {
                if observed.get() {
                    team.status.send(status::In::Seen(m.robot, m.pose));
                }
                by_robot.0[m.robot.index()].send(cache::In::Reading(m.clone()));
            }
            if !own.contains(&m.robot) {
                team.world.iter().for_each(|world| world.send(world::In::Reading(m.clone())));
            }
        }
        Wire::MotorCommand(m) => by_robot.1[m.robot.index()].send(body::In::MotorCommand(m)),
        Wire::Heartbeat(m) => by_robot.2.send(state_server::In::Heartbeat(m)),
        Wire::Latent(m) => {
            if observed.get() && !decided.is_empty() {
                team.status.send(status::In::Latent(m.robot));
            }
            for (_, caches) in caches.iter().filter(|(robots, _)| robots.binary_search(&m.robot).is_err()) {
                caches.iter().for_each(|cache| cache.send(cache::In::Latent(m.clone())));
            }
        }
        Wire::Mode(m) => team.follow(&m),
        Wire::Stop(m) => {
            team.stop(m);
            if leads {
                by_robot.2.send(state_server::In::Stop(m));
            }
        }
        Wire::Status(m) => by_robot.2.send(state_server::In::Status(m)),
        Wire::Observe(_) => {
            observed.set(true);
            team.status.send(status::In::Observe);
        }
        Wire::Place(m) => source.iter().for_each(|source| source.send(localizer::In::Place(m))),
        Wire::Located(m) => {
            for (robot, whereabouts) in m.robots.iter().filter(|(robot, _)| decided.contains(robot)) {
                by_robot.3[robot.index()].send(controller::In::Located(*whereabouts));
            }
            if leads {
                by_robot.2.send(state_server::In::Located(m));
            }
        }
        // Telemetry is for observers, which are outside the deployment.
        Wire::Telemetry(_) => {}
    }
}

/// Starts the Status of one host, the actor that answers operators and sends telemetry; its messages are published by
/// the host's Network.
pub(super) fn wire_status(clock: &Clock, graph: &Graph, host: HostId, config: status::Config) {
    let network = graph.network_of(host);
    let make = move |_| Status::new(&config);
    start(clock, &graph.statuses[usize::from(host.0)], info_span!("status"), make, move |output| {
        network.send(network::In::Publish(match output {
            status::Out::Status(status) => Wire::Status(status),
            status::Out::Telemetry(telemetry) => Wire::Telemetry(telemetry),
        }));
    });
}

/// Starts the state server, the actor that leads the episodes; its instructions are published by the Network of its
/// host.
pub(super) fn wire_server(clock: &Clock, trial: &Trial, graph: &Graph) {
    let config = state_server::Config {
        layouts: trial.layouts.clone(),
        repeat: trial.repeat,
        placement: trial.placement(),
        limit: trial.scenario.rules().limit,
        ending: Ending::of(&*trial.scenario),
        hosts: (0..trial.deployment.hosts.len()).map(|host| graph.routes.robots_of(host).to_vec()).collect(),
        real: RobotId::team(trial.deployment.robots)
            .filter(|robot| graph.routes.world_host(*robot).is_none())
            .collect(),
    };
    let (host, robots) = (graph.routes.server_host(), trial.deployment.robots);
    let (network, status) = (graph.network_of(host), graph.status_of(host));
    let make = move |incarnation| StateServer::new(config.clone(), robots, incarnation);
    let episodes = graph.episodes.clone();
    let events = Rc::clone(&graph.events);
    start(clock, &graph.server, info_span!("state server"), make, move |out| match out {
        state_server::Out::Mode(mode) => {
            if mode.phase == Phase::Running {
                episodes.runs(mode.round.episode);
            }
            network.send(network::In::Publish(Wire::Mode(mode)));
        }
        state_server::Out::Leading(leading) => status.send(status::In::Leading(leading)),
        state_server::Out::Aborted(episode, reason) => {
            events.emit(host, Event::Aborted(episode, reason));
        }
    });
}
