//! The whole actor graph as wiring: one place that says who talks to whom. No logic lives here.

mod bodies;
pub mod devices;
pub mod host;
mod leading;
pub mod operator;
pub mod process;
pub mod sockets;
pub mod station;

use std::collections::BTreeSet;
use std::rc::Rc;
use std::sync::Arc;

use tracing::info_span;

use crate::actors::agent::{self, Agent, Pilot};
use crate::actors::cache::{self, Cache};
use crate::actors::controller::{self, Controller};
use crate::actors::network;
use crate::actors::recorder::{self, Recorder};
use crate::actors::status;
use crate::deploy::{Deployment, Host, Stepping};
use crate::estimation;
use crate::faults::{ActorFault, FaultPlan};
use crate::graph::leading::{deliveries, wire_server, wire_status};
use crate::graph::process::{Graph, Heard, Process};
use crate::graph::station::Station;
use crate::hearing::CommRange;
use crate::hearing::Handling;
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::{Kind, Stop, Wire};
use crate::net::media::emulator::LinkEmulator;
use crate::net::media::ether::{self, Ether};
use crate::net::media::radio_link::RadioLink;
use crate::net::media::reach::Reach;
use crate::net::protocol::codec::Frame;
use crate::net::transport::Arrive;
use crate::policy::Model;
use crate::random::Seed;
use crate::runtime::clock::Clock;
use crate::runtime::shell::start;
use crate::safety::{Safety, Switch, guard};
use crate::scenario::Scenario;
use crate::scenario::layout::Layouts;
use crate::time::{Span, Time};
use crate::world::{Clamp, Entry, Physics, Placement};

/// How long a motor command holds: four of the published control periods (design, section 2).
pub const COMMAND_VALIDITY: Span = Span::from_millis(200);

/// All that a graph is made of.
#[derive(Clone)]
pub struct Plan {
    /// Which host runs what.
    pub deployment: Deployment,
    /// What the team is to do.
    pub scenario: Arc<dyn Scenario>,
    /// What simulated robots live in.
    pub plant: Entry,
    /// What simulated robots are like.
    pub physics: Physics,
    /// What drives it while an episode runs.
    pub run: Model,
    /// What drives it to the starts.
    pub reset: Model,
    /// Who is near enough to be heard.
    pub range: CommRange,
    /// How long a neighbour's message is of use.
    pub hold: Span,
    /// What becomes of it within that time.
    pub handling: Handling,
    /// How a robot's readings become an estimate.
    pub estimator: estimation::Entry,
    /// How Controllers limit what the policies want.
    pub clamp: Clamp,
    /// When robots are stopped or slowed.
    pub safety: Safety,
    /// The emergency stops and re-arms of the run, and when a host says them.
    pub stops: Vec<(Time, Stop)>,
    /// The episodes.
    pub layouts: Layouts,
    /// Which repeat of the experiment this is.
    pub repeat: u32,
    /// The root of all randomness.
    pub seed: Seed,
    /// What goes wrong.
    pub faults: FaultPlan,
    /// When the run ends, if not with its last episode.
    pub until: Option<Time>,
    /// Whether every step is told.
    pub steps: recorder::Steps,
}

/// Starts all actors of a plan; `said` takes what the Recorder says.
pub fn wire(clock: &Clock, plan: Plan, said: impl FnMut(recorder::Out) + 'static) -> Rc<Graph> {
    let plan = &Rc::new(plan);
    let process = Process::whole();
    let graph = Rc::new(Graph::new(plan, &process));
    wire_hosts(clock, plan, &graph, &process);
    wire_links(clock, plan, &graph);
    wire_recorder(clock, plan, &graph, said);
    for fault in plan.faults.actors.iter().filter(|fault| fault.episode.is_none()) {
        inject(clock, &graph, fault, fault.at);
    }
    // Weak, because the graph holds the listener.
    let (later, weak) = (clock.clone(), Rc::downgrade(&graph));
    let timed: Vec<ActorFault> = plan.faults.actors.iter().filter(|fault| fault.episode.is_some()).cloned().collect();
    graph.starts.listen(move |episode, now| {
        let Some(graph) = weak.upgrade() else { return };
        for fault in timed.iter().filter(|fault| fault.episode == Some(episode)) {
            inject(&later, &graph, fault, now + fault.at.since(Time::ZERO));
        }
    });
    if let Some(until) = plan.until {
        let record = graph.record();
        clock.call(until, Box::new(move || record(recorder::In::Closing)));
    }
    for (at, stop) in plan.stops.iter().copied() {
        let network = graph.network_of(stop.by);
        clock.call(at, Box::new(move || network.send(network::In::Publish(Wire::Stop(stop)))));
    }
    graph
}

/// Injects a fault at that time.
fn inject(clock: &Clock, graph: &Rc<Graph>, fault: &ActorFault, at: Time) {
    let (fault, graph) = (fault.clone(), Rc::clone(graph));
    clock.call(at, Box::new(move || graph.inject(fault)));
}

/// The actors of the hosts that run here.
pub(super) fn wire_hosts(clock: &Clock, plan: &Rc<Plan>, graph: &Graph, process: &Process) {
    let here = |host: HostId| process.only.is_none_or(|only| only == host);
    for robot in RobotId::team(plan.deployment.robots) {
        if here(graph.routes.agent_host(robot)) {
            wire_robot(clock, plan, graph, robot, process);
        }
        if here(graph.routes.actuator_host(robot)) {
            bodies::wire_body(clock, graph, robot, process);
        }
        if graph.routes.world_host(robot).is_some_and(here) {
            bodies::wire_sensor(clock, plan, graph, robot);
        }
    }
    for host in 0..plan.deployment.hosts.len() {
        let host = HostId(u16::try_from(host).expect("hosts are counted in u16"));
        if here(host) {
            wire_host(clock, plan, graph, host, process);
        }
    }
    if here(graph.routes.server_host()) {
        wire_server(clock, plan, graph);
    }
}

/// The Recorder of this process.
pub(super) fn wire_recorder(clock: &Clock, plan: &Plan, graph: &Graph, said: impl FnMut(recorder::Out) + 'static) {
    let config = recorder::Config {
        layouts: plan.layouts.clone(),
        repeat: plan.repeat,
        rules: plan.scenario.rules(),
        steps: plan.steps,
        hearers: plan.deployment.hosts.iter().filter(|host| !host.agents.is_empty()).count() as u64 - 1,
        judged: plan.deployment.judged(),
        placed: plan.deployment.placement == Placement::Exact,
        arena: plan.scenario.arena().clone(),
        wall_radius_m: plan.physics.wall_radius_m,
    };
    let robots = plan.deployment.robots;
    let make = move |_| Recorder::new(config.clone(), robots);
    let mailbox = graph.recorder.as_ref().expect("a Recorder is started where one runs");
    start(clock, mailbox, info_span!("recorder"), make, said);
}

/// When in each period a robot's tick or beat falls.
fn phase(plan: &Plan, name: &str, robot: RobotId, period: Span) -> Span {
    match plan.deployment.stepping {
        Stepping::Lockstep => Span::from_nanos(period.as_nanos() / 2),
        Stepping::Seeded => {
            use rand::RngExt;
            let mut stream = plan.seed.stream(&format!("{name}/{}/phase", robot.0));
            Span::from_nanos(stream.random_range(0..period.as_nanos()))
        }
    }
}

/// Cache and Controller of one robot, and its Agent if it is the first of that Agent's robots.
fn wire_robot(clock: &Clock, plan: &Rc<Plan>, graph: &Graph, robot: RobotId, process: &Process) {
    let at = robot.index();
    let (id, seed) = (robot.0, plan.seed);
    let first = graph.routes.companions(robot)[0];
    let interface = plan.run.interface();
    let home = graph.network_of(graph.routes.agent_host(robot));

    let config = cache::Config {
        robot,
        period: interface.period,
        // One tick for all robots of an agent: a joint step is a synchronous one.
        phase: phase(plan, "agent", first, interface.period),
        range: plan.range,
        hold: plan.hold,
        handling: plan.handling,
        estimator: plan.estimator,
        own_age: Span::from_secs(plan.safety.own_state_s),
    };
    let make = move |life| Cache::new(config, seed.stream(&format!("cache/{id}/range/{life}")));
    let (agent, controller) = (graph.agents[at].clone(), graph.controllers[at].clone());
    let watched = plan.safety.own_state == Switch::On;
    let (record, observed) = (graph.record(), plan.steps.kept());
    let host = graph.routes.agent_host(robot);
    start(clock, &graph.caches[at], info_span!("cache", robot = id), make, move |out| match out {
        cache::Out::Percept(percept) => {
            if observed {
                let heard = percept.heard.iter().map(|heard| (heard.robot, heard.age)).collect();
                record(recorder::In::Perceived(host, robot, heard));
            }
            agent.send(agent::In::Percept(percept));
        }
        // Nobody waits for it where own state is not watched, and it would be a fifth of all that goes around.
        cache::Out::Fresh if watched => controller.send(controller::In::Fresh),
        cache::Out::Fresh => {}
    });

    if first == robot {
        wire_agent(clock, plan, graph, robot);
    }

    let config = controller::Config {
        robot,
        guard: guard::Config {
            safety: plan.safety,
            half_extent: plan.scenario.arena().half_extent,
            limit_m_s: interface.limit_m_s,
            clamp: plan.clamp,
            period: interface.period,
        },
        valid_for: COMMAND_VALIDITY,
        phase: phase(plan, "controller", robot, controller::HEARTBEAT_PERIOD),
    };
    let (network, status) = (home, graph.status_of(host));
    let (record, hear) = (graph.record(), Rc::clone(&process.hear));
    let make = move |_| Controller::new(config);
    start(clock, &graph.controllers[at], info_span!("controller", robot = id), make, move |out| match out {
        controller::Out::MotorCommand(m) => network.send(network::In::Publish(Wire::MotorCommand(m))),
        controller::Out::Heartbeat(m) => {
            status.send(status::In::Phase(robot, m.phase));
            network.send(network::In::Publish(Wire::Heartbeat(m)));
        }
        controller::Out::Follows(latch) => status.send(status::In::Controller(robot, latch)),
        controller::Out::Counts(counts) => {
            hear(Heard::Safety(robot, counts));
            record(recorder::In::Safety(robot, counts));
        }
    });
}

/// The Agent whose first robot this is.
fn wire_agent(clock: &Clock, plan: &Rc<Plan>, graph: &Graph, robot: RobotId) {
    let id = robot.0;
    let network = graph.network_of(graph.routes.agent_host(robot));
    let controllers = graph.controllers.clone();
    let robots = graph.routes.companions(robot).to_vec();
    let period = plan.run.interface().period;
    let patience = Span::from_nanos(period.as_nanos() / 4);
    let plan = Rc::clone(plan);
    let make = move |life: u32| {
        let pilot = |&robot: &RobotId| Pilot {
            robot,
            run: plan.run.instance(plan.scenario.arena()),
            reset: plan.reset.instance(plan.scenario.arena()),
            actions: plan.seed.stream(&format!("agent/{}/action/{life}", robot.0)),
            ranges: plan.seed.stream(&format!("agent/{}/range/{life}", robot.0)),
        };
        Agent::new(Arc::clone(&plan.scenario), plan.range, patience, robots.iter().map(pilot).collect())
    };
    start(clock, &graph.agents[robot.index()], info_span!("agent", robot = id), make, move |out| match out {
        agent::Out::Latent(latent) => network.send(network::In::Publish(Wire::Latent(latent))),
        agent::Out::Action(action) => controllers[action.robot.index()].send(controller::In::Action(action)),
    });
}

/// Network, Status and World of one host.
fn wire_host(clock: &Clock, plan: &Plan, graph: &Graph, host: HostId, process: &Process) {
    let entry = &plan.deployment.hosts[usize::from(host.0)];
    // In the order of ids, however the deployment lists them: a plant moves its robots in this order.
    let here = |robots: &[u16]| robots.iter().copied().map(RobotId).collect::<BTreeSet<_>>().into_iter().collect();
    let (agents, simulated): (Vec<RobotId>, Vec<RobotId>) = (here(&entry.agents.concat()), here(&entry.simulates));
    let bodies: Vec<RobotId> = here(&[&entry.simulates[..], &entry.actuates].concat());
    let deliver = deliveries(graph, host, &agents, (&bodies, &simulated));
    wire_status(clock, graph, host, status::Config { host, controllers: agents, bodies });
    wire_network(clock, plan, graph, host, process, deliver);
    if !simulated.is_empty() {
        bodies::wire_world(clock, plan, graph, host, process, simulated);
    }
}

/// The Network of a host; what arrives goes to `deliver`.
fn wire_network(
    clock: &Clock,
    plan: &Plan,
    graph: &Graph,
    host: HostId,
    process: &Process,
    deliver: impl Fn(Wire) + 'static,
) {
    let name = plan.deployment.hosts[usize::from(host.0)].name.clone();
    let station = Station {
        me: network::Identity { host, team: process.team, incarnation: process.incarnation },
        key: process.key.clone(),
        links: process.setups(&plan.deployment, &graph.routes, host),
        router: graph.routes.router(host),
        seed: process.secret.unwrap_or(plan.seed),
        stream: format!("network/{}", host.0),
        span: info_span!("network", host = name),
    };
    let (hear, alone, record) = (Rc::clone(&process.hear), process.only.is_some(), graph.record());
    let judges = plan.deployment.judge_of_readings() == Some(host);
    station.start(clock, &graph.networks[usize::from(host.0)], Rc::clone(&graph.transports), move |out| match out {
        station::Out::Deliver(message) => {
            hear(Heard::Message(&message));
            // What other processes publish is news to a Recorder here.
            if alone && matches!(message, Wire::Mode(_) | Wire::MotorCommand(_)) {
                record(recorder::In::Heard(message.clone()));
            }
            if judges && let Wire::Reading(reading) = &message {
                record(recorder::In::Reading(reading.clone()));
            }
            deliver(message);
        }
        station::Out::Tap(frame) => {
            hear(Heard::Published);
            record(recorder::In::Tap(frame));
        }
        station::Out::Counts(counts) => {
            hear(Heard::Counts(&counts));
            record(recorder::In::Counts(host, counts));
        }
        station::Out::Peers(peers) => hear(Heard::Peers(&peers)),
        station::Out::Duplicate(duplicate) => hear(Heard::Duplicate(duplicate)),
    });
}

fn wire_links(clock: &Clock, plan: &Plan, graph: &Graph) {
    let first_robot = |host: &Host| host.agents.concat().into_iter().min();
    let robots_of: Rc<[Option<u16>]> = plan.deployment.hosts.iter().map(first_robot).collect();
    for (index, link) in plan.deployment.links.iter().enumerate() {
        let id = LinkId(u16::try_from(index).expect("links are counted in u16"));
        let routes = graph.routes.clone();
        let (impairment, faults) = (link.impairment(), plan.faults.of_link(&link.name));
        let (seed, name, starts) = (plan.seed, link.name.clone(), graph.starts.clone());
        let (radio, range_m, robots_of) = (link.radio.clone(), link.range_m, Rc::clone(&robots_of));
        let make = move |life| {
            let stream = seed.stream(&format!("link/{name}/{life}"));
            let emulator = LinkEmulator::new(impairment.clone(), faults.clone(), stream).with_starts(starts.clone());
            let air = || seed.child(&format!("link/{name}/radio/{life}"));
            let radio_link = radio.clone().map(|radio| RadioLink::new(radio, &robots_of, &air()));
            let reach = range_m.map(|range_m| Reach::new(range_m, &robots_of));
            Ether::new(emulator, radio_link, reach, |kind| routes.listeners(kind))
        };
        let (networks, record) = (graph.networks.clone(), graph.record());
        let observed = plan.steps.kept() && link.carries.contains(&Kind::Latent);
        start(clock, &graph.transports[index], info_span!("ether", link = link.name), make, move |out| match out {
            ether::Out::Arrive(Arrive { to, from, frame }) => {
                if observed {
                    record(recorder::In::Arrived(to, Frame::clone(&frame)));
                }
                networks[usize::from(to.0)].send(network::In::Frame(id, frame, from));
            }
            ether::Out::Counts(counts) => record(recorder::In::Radio(id, counts)),
        });
    }
}
