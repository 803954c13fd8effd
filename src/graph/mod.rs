//! Wiring of the whole actor graph: which actors run, with which settings and phases, and what each output becomes.
//! Only this module connects actors.

mod agents;
mod airborne;
pub mod bench;
mod bodies;
mod delivery;
pub mod devices;
mod emulated;
pub mod end;
pub mod event;
pub(crate) mod host;
mod injection;
pub mod inputs;
pub mod operator;
pub mod process;
mod senses;
pub mod sockets;

use std::collections::BTreeSet;
use std::rc::Rc;

use tracing::info_span;

use crate::actors::agent;
use crate::actors::agent::apart::{self, Apart};
use crate::actors::agent::timed::Timed;
use crate::actors::cache::{self, Cache};
use crate::actors::controller::{self, Controller};
use crate::actors::network;
use crate::actors::recorder::{self, Recorder};
use crate::actors::state_server;
use crate::actors::status;
use crate::actors::witness::Finding;
use crate::chassis::Chassis;
use crate::deploy::{Routes, Stepping};
use crate::graph::agents::{agent_of, deadlines, max_wait, parts_of};
use crate::graph::delivery::{deliveries, wire_server, wire_status};
use crate::graph::emulated::{Reception, wire_links};
use crate::graph::event::{Event, Report};
use crate::graph::process::{Graph, Process};
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Wire;
use crate::runtime::clock::Clock;
use crate::runtime::shell::start;
use crate::safety::{Switch, filter};
use crate::time::Span;
use crate::trial::Trial;
use crate::world::Placement;

/// Time after its arrival at the Body for which a motor command is valid: four control periods of the paper's system,
/// of 50 ms each.
pub const COMMAND_VALIDITY: Span = Span::from_millis(200);

/// Starts and connects the actors of all hosts of a trial in one process, with emulated links. They run on `clock`.
/// `report` is called with each event of the process, such as a message, in the order in which they happen; without it,
/// hosts may take latents later than they arrive, as of their arrival. `output` is called with the results of episodes
/// and steps.
pub(crate) fn wire(
    clock: &Clock,
    trial: &Trial,
    report: Option<Report>,
    output: impl FnMut(recorder::Out) + 'static,
) -> Rc<Graph> {
    let routes = Routes::of(&trial.deployment);
    let reception = if report.is_some() { Reception::AtOnce } else { Reception::Left };
    let process = Process::all_hosts(trial, &routes, report.unwrap_or_else(|| Rc::new(|_, _| {})));
    wire_all(clock, trial, (&process, routes, reception), output)
}

/// Starts all hosts of a trial in one process, as `process` describes, with the routes of its deployment.
fn wire_all(
    clock: &Clock,
    trial: &Trial,
    (process, routes, reception): (&Process, Routes, Reception),
    output: impl FnMut(recorder::Out) + 'static,
) -> Rc<Graph> {
    let trial = &Rc::new(trial.clone());
    let graph = Rc::new(Graph::new(trial, routes, process));
    wire_hosts(clock, trial, &graph, process);
    wire_links(clock, trial, &graph, reception);
    wire_recorder(clock, trial, &graph, output);
    injection::schedule(clock, trial, &graph);
    if let Some(until) = trial.until {
        let recorder = graph.recorder.clone();
        clock.call(until, Box::new(move || recorder.iter().for_each(|recorder| recorder.send(recorder::In::Closing))));
    }
    for (at, stop) in trial.stops.iter().copied() {
        let network = graph.network_of(stop.by);
        clock.call(at, Box::new(move || network.send(network::In::Publish(Wire::Stop(stop)))));
    }
    graph
}

/// Starts the actors of the hosts that run in this process.
pub(super) fn wire_hosts(clock: &Clock, trial: &Rc<Trial>, graph: &Graph, process: &Process) {
    let here = |host: HostId| process.runs(host);
    let chassis = trial.deployment.team_chassis();
    for robot in RobotId::team(trial.deployment.robots) {
        if here(graph.routes.agent_host(robot)) {
            wire_robot(clock, trial, graph, robot, (&chassis, process));
        }
        if here(graph.routes.actuator_host(robot)) {
            bodies::wire_body(clock, trial, graph, robot, process);
            senses::wire_senses(clock, trial, graph, robot);
        }
        if graph.routes.world_host(robot).is_some_and(here) {
            bodies::wire_sensor(clock, trial, graph, robot, &chassis);
        }
    }
    for host in 0..trial.deployment.hosts.len() {
        let host = HostId(u16::try_from(host).expect("hosts are counted in u16"));
        if here(host) {
            wire_host(clock, trial, graph, host, process);
        }
    }
    if here(graph.routes.server_host()) {
        wire_server(clock, trial, graph);
    }
}

/// Starts the Recorder, the actor that judges episodes and collects the results of the run; `output` receives them.
/// Panics if this process has no Recorder.
pub(super) fn wire_recorder(
    clock: &Clock,
    trial: &Trial,
    graph: &Graph,
    mut output: impl FnMut(recorder::Out) + 'static,
) {
    let config = recorder::Config {
        layouts: trial.layouts.clone(),
        repeat: trial.repeat,
        scenario: std::sync::Arc::clone(&trial.scenario),
        steps: trial.steps,
        receivers: trial.deployment.hosts.iter().filter(|host| !host.agents.is_empty()).count() as u64 - 1,
        judged: trial.deployment.judged(),
        placed: trial.placement() == Placement::Exact,
        wall_radius_m: trial.physics.wall_radius_m,
        chassis: trial.deployment.team_chassis(),
    };
    let robots = trial.deployment.robots;
    let make = move |_| Recorder::new(config.clone(), robots);
    let mailbox = graph.recorder.as_ref().expect("a Recorder is started where one runs");
    let (events, host) = (Rc::clone(&graph.events), trial.deployment.judge());
    start(clock, mailbox, info_span!("recorder"), make, move |out| {
        events.emit(host, Event::Recorded(&out));
        output(out);
    });
}

/// Returns the offset of a robot's tick or heartbeat within its period: half the period in lock step, otherwise drawn
/// from the random stream of `name` and the robot.
fn phase(trial: &Trial, name: &str, robot: RobotId, period: Span) -> Span {
    match trial.deployment.stepping {
        Stepping::Lockstep => Span::from_nanos(period.as_nanos() / 2),
        Stepping::Seeded => {
            use rand::RngExt;
            let mut stream = trial.streams().stream(&format!("{name}/{}/phase", robot.0));
            Span::from_nanos(stream.random_range(0..period.as_nanos()))
        }
    }
}

/// Returns the configuration of a robot's guard, which gets a command each `period`. `chassis` has one entry for each
/// robot of the team. The guard sees commanded points, which lie ahead of the centre of a differential drive. Therefore
/// the least distances of the guard are larger by the offset of these points, and its geofence is smaller.
fn guard_config(trial: &Trial, robot: RobotId, period: Span, chassis: &[Chassis]) -> filter::Settings {
    let own = &chassis[robot.index()];
    let others = RobotId::team(chassis.len()).zip(chassis.iter()).filter(|(other, _)| *other != robot);
    let farthest_m = others.map(|(_, other)| other.point_ahead_m).fold(0.0, f32::max);
    filter::Settings {
        safety: trial.safety.about_point(own.point_ahead_m, farthest_m),
        half_extent: trial.scenario.arena().half_extent.add_scalar(-own.point_ahead_m),
        walls: trial.scenario.arena().keep_outs.as_slice().into(),
        movers: trial.scenario.arena().movers.as_slice().into(),
        // At most the speed of the chassis, so that the guard judges the velocity that is really driven.
        limit_m_s: trial.models.of(robot).interface().limit_m_s.min(own.speed_m_s),
        clamp: trial.clamp,
        period,
    }
}

/// Starts Cache and Controller of one robot, and its Agent if the robot is the first of that Agent. `chassis` has one
/// entry for each robot of the team.
fn wire_robot(
    clock: &Clock,
    trial: &Rc<Trial>,
    graph: &Graph,
    robot: RobotId,
    (chassis, process): (&[Chassis], &Process),
) {
    let (at, id, seed) = (robot.index(), robot.0, trial.streams());
    let first = graph.routes.agent_robots(robot)[0];
    let interface = trial.models.of(robot).interface();
    let period = trial.models.tick(graph.routes.agent_robots(robot));
    let config = cache::Config {
        robot,
        period,
        // All robots of an agent tick at the same time, for a synchronous joint step.
        phase: trial.deployment.tick_offset(first).unwrap_or_else(|| phase(trial, "agent", first, period)),
        range: trial.comm_range(robot),
        hold: interface.hold,
        handling: trial.handling,
        estimator: trial.estimator,
        sensor_delay: trial.reading_delay(),
        own_age: Span::from_secs(trial.safety.own_state_s),
        // Of all robots, since what others say is held against it.
        limit_m_s: trial.models.limit_m_s(),
        senses: trial.deployment.sense_names().len(),
    };
    let make = move |incarnation| Cache::new(config, seed.stream(&format!("cache/{id}/range/{incarnation}")));
    let (agent, controller) = (graph.agents[at].clone(), graph.controllers[at].clone());
    let watched = trial.safety.own_state == Switch::On;
    let (events, observed) = (Rc::clone(&graph.events), trial.steps.follow_messages());
    let host = graph.routes.agent_host(robot);
    let status = graph.status_of(host);
    start(clock, &graph.caches[at], info_span!("cache", robot = id), make, move |out| match out {
        cache::Out::Percept(percept) => {
            if observed {
                let heard: Vec<_> = percept.heard.iter().map(|heard| (heard.robot, heard.age)).collect();
                events.emit(host, Event::Perceived(robot, &heard));
            }
            agent.send(agent::In::Percept(percept));
        }
        // Not sent if the age of own state is not checked: it would be a fifth of all messages.
        cache::Out::Fresh if watched => controller.send(controller::In::Fresh),
        cache::Out::Fresh => {}
        cache::Out::Found(other, found) => {
            if found == Finding::Suspect {
                controller.send(controller::In::Suspect);
            }
            status.send(status::In::Found(robot, (other, found)));
        }
    });

    if first == robot {
        wire_agent(clock, trial, graph, robot, process);
    }
    wire_controller(clock, trial, graph, robot, chassis);
}

/// Starts the Controller of one robot. `chassis` has one entry for each robot of the team.
fn wire_controller(clock: &Clock, trial: &Trial, graph: &Graph, robot: RobotId, chassis: &[Chassis]) {
    let (host, mailbox) = (graph.routes.agent_host(robot), &graph.controllers[robot.index()]);
    let config = controller::Config {
        robot,
        guard: guard_config(trial, robot, trial.models.tick(graph.routes.agent_robots(robot)), chassis),
        valid_for: COMMAND_VALIDITY,
        phase: phase(trial, "controller", robot, controller::HEARTBEAT_PERIOD),
        signed: graph.signed,
        marks: graph.marks,
        goals: trial.scenario.goals(),
        flies: trial.deployment.flight(robot).is_some(),
    };
    let (network, status) = (graph.network_of(host), graph.status_of(host));
    let events = Rc::clone(&graph.events);
    let layouts = trial.layouts.clone();
    let make = move |_| Controller::new(config.clone()).with_layouts(layouts.clone());
    start(clock, mailbox, info_span!("controller", robot = robot.0), make, move |out| match out {
        controller::Out::MotorCommand(m) => network.send(network::In::Publish(Wire::MotorCommand(m))),
        controller::Out::Heartbeat(m) => {
            status.send(status::In::Phase(robot, m.phase));
            network.send(network::In::Publish(Wire::Heartbeat(m)));
        }
        controller::Out::Follows(latch) => status.send(status::In::Controller(robot, latch)),
        controller::Out::Counts(counts) => {
            status.send(status::In::Guard(robot, counts));
            events.emit(host, Event::Safety(robot, counts));
        }
    });
}

/// Starts the Agent, the actor that runs the policy of one or more robots, whose first robot is `robot`.
fn wire_agent(clock: &Clock, trial: &Rc<Trial>, graph: &Graph, robot: RobotId, process: &Process) {
    let network = graph.network_of(graph.routes.agent_host(robot));
    let controllers = graph.controllers.clone();
    let robots = graph.routes.agent_robots(robot).to_vec();
    let (mailbox, span) = (&graph.agents[robot.index()], info_span!("agent", robot = robot.0));
    let (trial, events, host) = (Rc::clone(trial), Rc::clone(&graph.events), graph.routes.agent_host(robot));
    let sink = move |out| match out {
        agent::Out::Remembered(said) => events.emit(host, Event::Remembered(said)),
        agent::Out::Latent(latent) => network.send(network::In::Publish(Wire::Latent(latent))),
        agent::Out::Action(action) => controllers[action.robot.index()].send(controller::In::Action(action)),
    };
    if process.emulated && trial.step_takes > Span::ZERO {
        let make = move |incarnation| {
            let apart = Apart::new(&robots, max_wait(&trial, &robots), deadlines(&trial, &robots));
            Timed::new(apart, agent_of(&trial, &robots, incarnation), trial.step_takes)
        };
        start(clock, mailbox, span, make, sink);
        return;
    }
    let Some(gate) = process.devices.agents.get(&robot).cloned() else {
        start(clock, mailbox, span, move |incarnation| agent_of(&trial, &robots, incarnation), sink);
        return;
    };
    let (wait, deadlines) = (max_wait(&trial, &robots), deadlines(&trial, &robots));
    let make = move |_| Apart::new(&robots, wait, deadlines);
    start(clock, mailbox, span, make, move |out| match out {
        apart::Out::Agent(out) => sink(out),
        apart::Out::Ask(packet) => gate.iter().for_each(|gate| gate.borrow_mut().send(packet.clone())),
    });
}

/// Starts the Network and the Status of one host, and its World if the host simulates robots.
fn wire_host(clock: &Clock, trial: &Trial, graph: &Graph, host: HostId, process: &Process) {
    let entry = &trial.deployment.hosts[usize::from(host.0)];
    // Sorted by id, as a plant moves its robots in this order.
    let here = |robots: &[u16]| robots.iter().copied().map(RobotId).collect::<BTreeSet<_>>().into_iter().collect();
    let (agents, simulated): (Vec<RobotId>, Vec<RobotId>) = (here(&entry.agents.concat()), here(&entry.simulates));
    let bodies: Vec<RobotId> = here(&[&entry.simulates[..], &entry.actuates].concat());
    let measures = process.devices.source.is_some();
    let deliver = deliveries(graph, host, &agents, (&bodies, &simulated), measures);
    wire_status(clock, graph, host, status::Config { host, controllers: agents, bodies });
    wire_network(clock, trial, graph, host, process, deliver);
    if !simulated.is_empty() {
        bodies::wire_world(clock, trial, graph, host, process, simulated);
    }
}

/// Starts the Network of a host; received messages are passed to `deliver`.
fn wire_network(
    clock: &Clock,
    trial: &Trial,
    graph: &Graph,
    host: HostId,
    process: &Process,
    deliver: impl Fn(Wire) + 'static,
) {
    let name = trial.deployment.hosts[usize::from(host.0)].name.clone();
    let (end, network) = (&process.ends[&host], &graph.networks[usize::from(host.0)]);
    let what = (graph.routes.router(host), parts_of(&trial.models), info_span!("network", host = name));
    let events = Rc::clone(&graph.events);
    let server = (graph.routes.server_host() == host).then(|| graph.server.clone());
    let report = move |event: Event| {
        if let (Event::Members(roster), Some(server)) = (event, &server) {
            server.send(state_server::In::Members(roster.members.keys().copied().collect()));
        }
        events.emit(host, event);
    };
    if process.emulated {
        end.start(clock, network, what, (deliver, emulated::to(Rc::clone(&graph.media))), report);
    } else {
        end.start(clock, network, what, (deliver, end::to(Rc::clone(&graph.transports))), report);
    }
}
