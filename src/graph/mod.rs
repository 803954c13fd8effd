//! Wiring of the whole actor graph. Only this module connects actors. Contains no logic.

pub mod attachment;
pub mod bench;
mod bodies;
mod delivery;
pub mod devices;
mod emulated;
pub(crate) mod host;
mod injection;
pub mod inputs;
pub mod operator;
pub mod process;
pub mod sockets;

use std::collections::BTreeSet;
use std::rc::Rc;
use std::sync::Arc;

use tracing::info_span;

use crate::actors::agent::{self, Agent, RobotPolicies};
use crate::actors::cache::{self, Cache};
use crate::actors::controller::{self, Controller};
use crate::actors::network;
use crate::actors::recorder::{self, Recorder};
use crate::actors::status;
use crate::chassis::Chassis;
use crate::deploy::{Deployment, Stepping};
use crate::estimation;
use crate::faults::FaultPlan;
use crate::graph::attachment::Attachment;
use crate::graph::delivery::{deliveries, wire_server, wire_status};
use crate::graph::emulated::wire_links;
use crate::graph::process::{Graph, Process, ProcessEvent, Report};
use crate::hearing::CommRange;
use crate::hearing::Handling;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::{Stop, Wire};
use crate::policy::Model;
use crate::random::Seed;
use crate::runtime::clock::Clock;
use crate::runtime::shell::start;
use crate::safety::{Safety, Switch, guard};
use crate::scenario::layout::Layouts;
use crate::scenario::{Dynamics, Scenario};
use crate::time::{Span, Time};
use crate::world::{Clamp, Entry, Physics, Placement};

/// Time after its arrival at the Body for which a motor command is valid: four control periods of the paper's system,
/// of 50 ms each.
pub const COMMAND_VALIDITY: Span = Span::from_millis(200);

/// All settings of a run, from which its actors are made and connected.
#[derive(Clone)]
pub struct Plan {
    /// Hosts with their actors, and links between hosts.
    pub deployment: Deployment,
    /// Scenario: the task of the team, with its arena and rules.
    pub scenario: Arc<dyn Scenario>,
    /// Registry entry of the plant (simulator) that moves the simulated robots.
    pub(crate) plant: Entry,
    /// Properties of the simulated robots, such as the errors of their sensors.
    pub physics: Physics,
    /// Policy that drives the robots while an episode runs.
    pub(crate) run: Model,
    /// Policy that drives the robots to their starts before an episode.
    pub(crate) reset: Model,
    /// Communication range: largest distance at which a robot uses a neighbour's message.
    pub range: CommRange,
    /// Hold time: age up to which a neighbour's message is used.
    pub hold: Span,
    /// Whether a neighbour's message is used in every control step within the hold time, or only once.
    pub handling: Handling,
    /// Estimator that computes a robot's state from its readings.
    pub(crate) estimator: estimation::Entry,
    /// Known delay from a measurement to the arrival of its reading, for which the estimator can compensate.
    pub(crate) sensor_delay: Span,
    /// Limit on the velocities of policies: that of training, where the simulator limits acceleration, or that of the
    /// paper's robots.
    pub(crate) clamp: Clamp,
    /// Conditions in which robots are stopped or slowed.
    pub(crate) safety: Safety,
    /// Emergency stop messages to send during the run, with their times.
    pub(crate) stops: Vec<(Time, Stop)>,
    /// Starts and goals of the robots in each episode.
    pub(crate) layouts: Layouts,
    /// Index of this run among the repeats of the experiment, from zero.
    pub(crate) repeat: u32,
    /// Seed from which all random streams of the run are derived.
    pub(crate) seed: Seed,
    /// Faults to inject during the run, such as crashes of actors or failures of links.
    pub(crate) faults: FaultPlan,
    /// Time at which the run ends, even during an episode; `None` to end with the last episode.
    pub(crate) until: Option<Time>,
    /// Whether the Recorder reports the robots' true states after each step of the simulator, and with them whose
    /// messages each robot then uses.
    pub(crate) steps: recorder::Steps,
}

impl Plan {
    /// Returns how a robot follows the velocities that its policy commands. The lag of a simulated robot is that of its
    /// simulator, and that of a real one is in `safety`.
    fn dynamics(&self, robot: RobotId) -> Dynamics {
        let real = self.deployment.hosts.iter().any(|host| host.actuates.contains(&robot.0));
        let lag_s = if real { self.safety.lag_s } else { self.physics.lag_s };
        Dynamics { filtered: self.safety.distance == Switch::On, lag_s }
    }
}

/// Starts and connects the actors of all hosts of a plan in one process, with emulated links. They run on `clock`.
/// `report` is called with each event of the process, such as a message, and `output` with the results of episodes and
/// steps.
pub(crate) fn wire(
    clock: &Clock,
    plan: Plan,
    report: Report,
    output: impl FnMut(recorder::Out) + 'static,
) -> Rc<Graph> {
    wire_all(clock, plan, Process::all_hosts(report), output)
}

/// Starts all hosts of a plan in one process, as `process` says. With setups of links in it, the protocol on the
/// emulated links is that of real ones.
fn wire_all(clock: &Clock, plan: Plan, process: Process, output: impl FnMut(recorder::Out) + 'static) -> Rc<Graph> {
    let plan = &Rc::new(plan);
    let graph = Rc::new(Graph::new(plan, &process));
    wire_hosts(clock, plan, &graph, &process);
    wire_links(clock, plan, &graph, process.links.is_some());
    wire_recorder(clock, plan, &graph, output);
    injection::schedule(clock, plan, &graph);
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

/// Starts the actors of the hosts that run in this process: of the host `process.only`, or of all hosts if that is
/// `None`.
pub(super) fn wire_hosts(clock: &Clock, plan: &Rc<Plan>, graph: &Graph, process: &Process) {
    let here = |host: HostId| process.only.is_none_or(|only| only == host);
    let chassis = plan.deployment.team_chassis();
    for robot in RobotId::team(plan.deployment.robots) {
        if here(graph.routes.agent_host(robot)) {
            wire_robot(clock, plan, graph, robot, &chassis, process);
        }
        if here(graph.routes.actuator_host(robot)) {
            bodies::wire_body(clock, plan, graph, robot, process);
        }
        if graph.routes.world_host(robot).is_some_and(here) {
            bodies::wire_sensor(clock, plan, graph, robot, &chassis);
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

/// Starts the Recorder, the actor that judges episodes and collects the results of the run; `output` receives them.
/// Panics if this process has no Recorder.
pub(super) fn wire_recorder(
    clock: &Clock,
    plan: &Plan,
    graph: &Graph,
    mut output: impl FnMut(recorder::Out) + 'static,
) {
    let config = recorder::Config {
        layouts: plan.layouts.clone(),
        repeat: plan.repeat,
        rules: plan.scenario.rules(),
        cost: plan.scenario.cost(),
        steps: plan.steps,
        receivers: plan.deployment.hosts.iter().filter(|host| !host.agents.is_empty()).count() as u64 - 1,
        judged: plan.deployment.judged(),
        placed: plan.deployment.placement == Placement::Exact,
        arena: plan.scenario.arena().clone(),
        wall_radius_m: plan.physics.wall_radius_m,
        chassis: plan.deployment.team_chassis(),
    };
    let robots = plan.deployment.robots;
    let make = move |_| Recorder::new(config.clone(), robots);
    let mailbox = graph.recorder.as_ref().expect("a Recorder is started where one runs");
    let (report, host) = (Rc::clone(&graph.report), plan.deployment.judge());
    start(clock, mailbox, info_span!("recorder"), make, move |out| {
        report(host, ProcessEvent::Recorded(&out));
        output(out);
    });
}

/// Returns the offset of a robot's tick or heartbeat within its period: half the period in lock step, otherwise drawn
/// from the random stream of `name` and the robot.
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

/// Returns the configuration of a robot's guard. `chassis` has one entry for each robot of the team. The guard sees
/// commanded points, which lie ahead of the centre of a differential drive. Therefore the least distances of the guard
/// are larger by the offset of these points, and its geofence is smaller.
fn guard_config(plan: &Plan, robot: RobotId, chassis: &[Chassis]) -> guard::Config {
    let interface = plan.run.interface();
    let own = &chassis[robot.index()];
    let others = RobotId::team(chassis.len()).zip(chassis.iter()).filter(|(other, _)| *other != robot);
    let farthest_m = others.map(|(_, other)| other.point_ahead_m).fold(0.0, f32::max);
    guard::Config {
        safety: plan.safety.about_point(own.point_ahead_m, farthest_m),
        half_extent: plan.scenario.arena().half_extent.add_scalar(-own.point_ahead_m),
        walls: plan.scenario.arena().keep_outs.as_slice().into(),
        // At most the speed of the chassis, so that the guard judges the velocity that is really driven.
        limit_m_s: interface.limit_m_s.min(own.speed_m_s),
        clamp: plan.clamp,
        period: interface.period,
    }
}

/// Starts Cache and Controller of one robot, and its Agent if the robot is the first of that Agent. `chassis` has one
/// entry for each robot of the team.
fn wire_robot(clock: &Clock, plan: &Rc<Plan>, graph: &Graph, robot: RobotId, chassis: &[Chassis], process: &Process) {
    let at = robot.index();
    let (id, seed) = (robot.0, plan.seed);
    let first = graph.routes.agent_robots(robot)[0];
    let interface = plan.run.interface();
    let home = graph.network_of(graph.routes.agent_host(robot));

    let config = cache::Config {
        robot,
        period: interface.period,
        // All robots of an agent tick at the same time, for a synchronous joint step.
        phase: plan.deployment.tick_offset(first).unwrap_or_else(|| phase(plan, "agent", first, interface.period)),
        range: plan.range,
        hold: plan.hold,
        handling: plan.handling,
        estimator: plan.estimator,
        sensor_delay: plan.sensor_delay,
        own_age: Span::from_secs(plan.safety.own_state_s),
    };
    let make = move |incarnation| Cache::new(config, seed.stream(&format!("cache/{id}/range/{incarnation}")));
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
        // Not sent if the age of own state is not checked: it would be a fifth of all messages.
        cache::Out::Fresh if watched => controller.send(controller::In::Fresh),
        cache::Out::Fresh => {}
    });

    if first == robot {
        wire_agent(clock, plan, graph, robot);
    }

    let config = controller::Config {
        robot,
        guard: guard_config(plan, robot, chassis),
        valid_for: COMMAND_VALIDITY,
        phase: phase(plan, "controller", robot, controller::HEARTBEAT_PERIOD),
    };
    let (network, status) = (home, graph.status_of(host));
    let (record, report) = (graph.record(), Rc::clone(&process.report));
    let make = move |_| Controller::new(config.clone());
    start(clock, &graph.controllers[at], info_span!("controller", robot = id), make, move |out| match out {
        controller::Out::MotorCommand(m) => network.send(network::In::Publish(Wire::MotorCommand(m))),
        controller::Out::Heartbeat(m) => {
            status.send(status::In::Phase(robot, m.phase));
            network.send(network::In::Publish(Wire::Heartbeat(m)));
        }
        controller::Out::Follows(latch) => status.send(status::In::Controller(robot, latch)),
        controller::Out::Counts(counts) => {
            status.send(status::In::Guard(robot, counts));
            report(host, ProcessEvent::Safety(robot, counts));
            record(recorder::In::Safety(robot, counts));
        }
    });
}

/// Starts the Agent, the actor that runs the policy of one or more robots, whose first robot is `robot`.
fn wire_agent(clock: &Clock, plan: &Rc<Plan>, graph: &Graph, robot: RobotId) {
    let id = robot.0;
    let network = graph.network_of(graph.routes.agent_host(robot));
    let controllers = graph.controllers.clone();
    let robots = graph.routes.agent_robots(robot).to_vec();
    let period = plan.run.interface().period;
    let max_wait = Span::from_nanos(period.as_nanos() / 4);
    let plan = Rc::clone(plan);
    let make = move |incarnation: u32| {
        let policies = |&robot: &RobotId| {
            // A policy sees the commanded point, so the hull of a differential drive is wider for it.
            let arena = plan.scenario.arena().about_point(plan.deployment.chassis(robot).point_ahead_m);
            RobotPolicies {
                robot,
                dynamics: plan.dynamics(robot),
                run: plan.run.instance(&arena),
                reset: plan.reset.instance(&arena),
                actions: plan.seed.stream(&format!("agent/{}/action/{incarnation}", robot.0)),
                ranges: plan.seed.stream(&format!("agent/{}/range/{incarnation}", robot.0)),
            }
        };
        Agent::new(Arc::clone(&plan.scenario), plan.range, max_wait, robots.iter().map(policies).collect())
    };
    start(clock, &graph.agents[robot.index()], info_span!("agent", robot = id), make, move |out| match out {
        agent::Out::Latent(latent) => network.send(network::In::Publish(Wire::Latent(latent))),
        agent::Out::Action(action) => controllers[action.robot.index()].send(controller::In::Action(action)),
    });
}

/// Starts the Network and the Status of one host, and its World if the host simulates robots.
fn wire_host(clock: &Clock, plan: &Plan, graph: &Graph, host: HostId, process: &Process) {
    let entry = &plan.deployment.hosts[usize::from(host.0)];
    // Sorted by id, as a plant moves its robots in this order.
    let here = |robots: &[u16]| robots.iter().copied().map(RobotId).collect::<BTreeSet<_>>().into_iter().collect();
    let (agents, simulated): (Vec<RobotId>, Vec<RobotId>) = (here(&entry.agents.concat()), here(&entry.simulates));
    let bodies: Vec<RobotId> = here(&[&entry.simulates[..], &entry.actuates].concat());
    let measures = process.devices.source.is_some();
    let deliver = deliveries(graph, host, &agents, (&bodies, &simulated), measures);
    wire_status(clock, graph, host, status::Config { host, controllers: agents, bodies });
    wire_network(clock, plan, graph, host, process, deliver);
    if !simulated.is_empty() {
        bodies::wire_world(clock, plan, graph, host, process, simulated);
    }
}

/// Starts the Network of a host; received messages are passed to `deliver`.
fn wire_network(
    clock: &Clock,
    plan: &Plan,
    graph: &Graph,
    host: HostId,
    process: &Process,
    deliver: impl Fn(Wire) + 'static,
) {
    let name = plan.deployment.hosts[usize::from(host.0)].name.clone();
    let attachment = Attachment {
        me: network::Identity { host, team: process.team, incarnation: process.incarnation },
        key: process.key.clone(),
        links: process.setups(&plan.deployment, &graph.routes, host),
        router: graph.routes.router(host),
        seed: process.secret.unwrap_or(plan.seed),
        stream: format!("network/{}", host.0),
        span: info_span!("network", host = name),
    };
    let (report, alone, record) = (Rc::clone(&process.report), process.only.is_some(), graph.record());
    let judges = plan.deployment.judge_of_readings() == Some(host);
    attachment.start(clock, &graph.networks[usize::from(host.0)], Rc::clone(&graph.transports), move |out| match out {
        attachment::Out::Deliver(message) => {
            report(host, ProcessEvent::Message(&message));
            // The Recorder of this process gets no other copy of messages from other processes.
            if alone && matches!(message, Wire::Mode(_) | Wire::MotorCommand(_)) {
                record(recorder::In::Received(message.clone()));
            }
            if judges && let Wire::Reading(reading) = &message {
                record(recorder::In::Reading(reading.clone()));
            }
            deliver(message);
        }
        attachment::Out::Tap(frame) => {
            report(host, ProcessEvent::Published(&frame));
            record(recorder::In::Tap(frame));
        }
        attachment::Out::Counts(counts) => {
            report(host, ProcessEvent::Counts(&counts));
            record(recorder::In::Counts(host, counts));
        }
        attachment::Out::Refused(link, cause, frame) => report(host, ProcessEvent::Refused(link, cause, &frame)),
        attachment::Out::Peers(peers) => report(host, ProcessEvent::Peers(&peers)),
        attachment::Out::Sent(link, frame) => report(host, ProcessEvent::Sent(link, &frame)),
        attachment::Out::Duplicate(duplicate) => report(host, ProcessEvent::Duplicate(duplicate)),
    });
}
