//! Wiring of the state server, of message delivery within a host, and of the host's Status.

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
use crate::messages::wire::{Latent, Located, MAX_BLOCK, MAX_SIGNED_BLOCK, Mode, Reading, Stop, Wire};
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
    /// the emergency stop latch of the instruction and the phase, and its Status only the phase of the episode.
    fn follow(&self, mode: &Mode) {
        self.world.iter().for_each(|world| world.send(world::In::Mode(mode.clone())));
        self.agents.iter().for_each(|agent| agent.send(agent::In::Mode(mode.clone())));
        self.controllers.iter().for_each(|controller| controller.send(controller::In::Mode(mode.clone())));
        self.bodies.iter().for_each(|body| body.send(body::In::Instruction(mode.latch, mode.phase)));
        self.status.send(status::In::Mode(mode.phase));
    }

    /// Delivers an emergency stop message to the Controllers, Bodies and Status of this host.
    fn stop(&self, stop: Stop) {
        self.controllers.iter().for_each(|controller| controller.send(controller::In::Stop(stop)));
        self.bodies.iter().for_each(|body| body.send(body::In::Stop(stop)));
        self.status.send(status::In::Stop(stop));
    }
}

/// Receivers of messages on one host: its robots, by what it runs of them, and the mailboxes of their actors.
struct Delivery {
    /// Robots whose Agents the host runs.
    decided: BTreeSet<RobotId>,
    /// Robots that the host's World simulates.
    simulated: BTreeSet<RobotId>,
    /// Real robots whose Bodies the host runs.
    real: BTreeSet<RobotId>,
    /// Robots whose readings hold what they say of themselves against.
    witnessed: BTreeSet<RobotId>,
    /// One entry per agent: its robots, and their caches.
    hearers: Vec<(Vec<RobotId>, Vec<Mailbox<cache::In>>)>,
    /// Mailboxes of all robots' actors, indexed by robot.
    caches: Rc<[Mailbox<cache::In>]>,
    controllers: Rc<[Mailbox<controller::In>]>,
    bodies: Rc<[Mailbox<body::In>]>,
    server: Mailbox<state_server::In>,
    /// Whether the host runs the state server.
    leads: bool,
    /// Localizer of this process's source of readings of real robots, if it has one.
    source: Option<Mailbox<localizer::In>>,
    team: Followers,
    /// Whether an observer has been heard. Readings and latents are many, so the Status gets them only then.
    observed: Cell<bool>,
}

impl Delivery {
    /// Delivers a received message to the actors that use it.
    fn deliver(&self, message: Wire) {
        match message {
            Wire::Reading(m) => self.reading(&m),
            Wire::MotorCommand(m) => self.bodies[m.robot.index()].send(body::In::MotorCommand(m)),
            Wire::Heartbeat(m) => self.server.send(state_server::In::Heartbeat(m)),
            Wire::Latent(m) => self.latent(&m),
            Wire::Mode(m) => self.team.follow(&m),
            Wire::Stop(m) => {
                self.team.stop(m);
                if self.leads {
                    self.server.send(state_server::In::Stop(m));
                }
            }
            Wire::Release(m) => {
                self.team.stop(m.stop());
                if self.leads {
                    self.server.send(state_server::In::Release(m));
                }
            }
            Wire::Status(m) => self.server.send(state_server::In::Status(m)),
            Wire::Observe(_) => {
                self.observed.set(true);
                self.team.status.send(status::In::Observe);
            }
            Wire::Place(m) => self.source.iter().for_each(|source| source.send(localizer::In::Place(m))),
            Wire::Located(m) => self.located(m),
            Wire::Sensed(m) if self.decided.contains(&m.robot) => {
                self.caches[m.robot.index()].send(cache::In::Sensed(m));
            }
            Wire::Sensed(_) => {}
            Wire::Aloft(m) if self.decided.contains(&m.robot) => {
                self.controllers[m.robot.index()].send(controller::In::Aloft(m.flight));
            }
            Wire::Aloft(_) => {}
            // Telemetry is for observers, which are outside the deployment.
            Wire::Telemetry(_) => {}
        }
    }

    fn reading(&self, m: &Reading) {
        if self.real.contains(&m.robot) {
            self.bodies[m.robot.index()].send(body::In::Reading(m.clone()));
        }
        if self.decided.contains(&m.robot) {
            if self.observed.get() {
                self.team.status.send(status::In::Seen(m.robot, m.pose));
            }
            self.caches[m.robot.index()].send(cache::In::Reading(m.clone()));
        }
        if self.witnessed.contains(&m.robot) {
            self.hearers_of(m.robot).for_each(|cache| cache.send(cache::In::Measured(m.clone())));
        }
        if !self.simulated.contains(&m.robot) {
            self.team.world.iter().for_each(|world| world.send(world::In::Reading(m.clone())));
        }
    }

    fn latent(&self, m: &Latent) {
        if self.observed.get() && !self.decided.is_empty() {
            self.team.status.send(status::In::Latent(m.robot));
        }
        self.hearers_of(m.robot).for_each(|cache| cache.send(cache::In::Latent(m.clone())));
    }

    /// Returns the Caches of the robots of this host that another Agent than that of `robot` drives.
    fn hearers_of(&self, robot: RobotId) -> impl Iterator<Item = &Mailbox<cache::In>> {
        let others = self.hearers.iter().filter(move |(robots, _)| robots.binary_search(&robot).is_err());
        others.flat_map(|(_, caches)| caches)
    }

    fn located(&self, m: Located) {
        for (robot, whereabouts) in m.robots.iter().filter(|(robot, _)| self.decided.contains(robot)) {
            self.controllers[robot.index()].send(controller::In::Located(*whereabouts));
        }
        if self.leads {
            self.server.send(state_server::In::Located(m));
        }
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
    let team_of = |first: &RobotId| graph.routes.agent_robots(*first).to_vec();
    let caches_of = |robots: &[RobotId]| robots.iter().map(|robot| graph.caches[robot.index()].clone()).collect();
    let driven: BTreeSet<RobotId> = bodies.iter().copied().collect();
    let delivery = Delivery {
        decided: agents.iter().copied().collect(),
        simulated: simulated.iter().copied().collect(),
        real: driven.iter().copied().filter(|robot| !simulated.contains(robot)).collect(),
        witnessed: RobotId::team(graph.bodies.len()).filter(|robot| graph.routes.is_witnessed(*robot)).collect(),
        hearers: firsts.iter().map(team_of).map(|robots| (robots.clone(), caches_of(&robots))).collect(),
        caches: graph.caches.clone(),
        controllers: graph.controllers.clone(),
        bodies: graph.bodies.clone(),
        server: graph.server.clone(),
        leads: graph.routes.server_host() == host,
        source: measures.then(|| graph.source.clone()),
        team: Followers {
            agents: firsts.iter().map(|robot| graph.agents[robot.index()].clone()).collect(),
            controllers: agents.iter().map(|robot| graph.controllers[robot.index()].clone()).collect(),
            bodies: driven.iter().map(|robot| graph.bodies[robot.index()].clone()).collect(),
            world: simulated.first().map(|robot| graph.worlds[robot.index()].clone()),
            status: graph.status_of(host),
        },
        observed: Cell::new(false),
    };
    move |message| delivery.deliver(message)
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
        host: graph.routes.server_host(),
        hosts: (0..trial.deployment.hosts.len()).map(|host| graph.routes.robots_of(host).to_vec()).collect(),
        real: RobotId::team(trial.deployment.robots)
            .filter(|robot| graph.routes.world_host(*robot).is_none())
            .collect(),
        block: if graph.signed { MAX_SIGNED_BLOCK } else { MAX_BLOCK },
        marks: graph.marks,
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
        state_server::Out::Release(release) => network.send(network::In::Publish(Wire::Release(release))),
        state_server::Out::Leading(leading) => status.send(status::In::Leading(leading)),
        state_server::Out::Aborted(episode, reason) => {
            events.emit(host, Event::Aborted(episode, reason));
        }
    });
}
