//! One host of a deployment as a process of its own: its part of the graph, in real time, on sockets. What an actor
//! does never lives here, nor what a person is shown.

use std::cell::Cell;
use std::rc::Rc;

use super::bodies::wire_source;
use super::devices::Devices;
use super::process::{Graph, Heard, Process};
use super::sockets;
use crate::actors::{body, localizer, recorder};
use crate::edge::WorkerState;
use crate::graph::{Plan, wire_hosts, wire_recorder};
use crate::messages::ids::{HostId, LinkId};
use crate::net::protocol::key::Key;
use crate::net::protocol::reliability::Setup;
use crate::net::transport::Transport;
use crate::random::Seed;
use crate::runtime::clock::Clock;
use crate::runtime::real::Readers;
use crate::runtime::shell::Mailbox;

/// A host: which one it is, and its links.
pub struct Host {
    /// Its number in the deployment.
    pub id: HostId,
    /// The team's number.
    pub team: u16,
    /// The incarnation: a random number that tells this process from former ones of the same host.
    pub incarnation: u32,
    /// The root of what its link layer draws, from the operating system.
    pub secret: Seed,
    /// The team's key; none on a machine that keeps to itself.
    pub key: Option<Key>,
    /// How its links are set up, in the order of the deployment; none where it has no part in one.
    pub links: Vec<Option<Setup>>,
    /// Its drivers and sources.
    pub devices: Devices,
    /// What is open of the links that it uses; several for a link that it uses on several interfaces.
    pub transports: Vec<(LinkId, Box<dyn Transport>)>,
}

/// Starts the actors of one host. `heard` is told what its Network makes known; `said` takes what the Recorder says,
/// which runs on the host that judges.
pub fn wire(
    (clock, readers): (&Clock, &mut Readers),
    plan: Plan,
    host: Host,
    heard: impl Fn(Heard) + 'static,
    said: impl FnMut(recorder::Out) + 'static,
) -> Rc<Graph> {
    let plan = &Rc::new(plan);
    let process = Process {
        only: Some(host.id),
        team: host.team,
        incarnation: host.incarnation,
        secret: Some(host.secret),
        key: host.key,
        links: Some(host.links),
        devices: host.devices,
        records: plan.deployment.judge() == host.id,
        hear: Rc::new(heard),
    };
    let graph = Rc::new(Graph::new(plan, &process));
    wire_hosts(clock, plan, &graph, &process);
    wire_gates((clock, readers), &graph, &process);
    sockets::wire_all((clock, readers), host.transports, &graph.transports, &graph.network_of(host.id));
    if process.records {
        wire_recorder(clock, plan, &graph, said);
    }
    graph
}

/// What workers say goes to the Bodies and the Localizer that they work for.
fn wire_gates((clock, readers): (&Clock, &mut Readers), graph: &Graph, process: &Process) {
    for (robot, device) in &process.devices.drivers {
        let Some(gate) = device.gate.clone() else { continue };
        let (event_fd, body) = (gate.borrow().event_fd(), graph.bodies[robot.index()].clone());
        let ended = Cell::new(false);
        readers.watch(Rc::new(event_fd), move || {
            let state = gate.borrow_mut().take(|packet| body.send(body::In::Packet(packet)));
            if state == WorkerState::Ended && !ended.replace(true) {
                body.send(body::In::WorkerEnded);
            }
        });
    }
    if let Some(gate) = process.devices.source.as_ref().and_then(|device| device.gate.clone()) {
        let (event_fd, localizer) = (gate.borrow().event_fd(), Mailbox::new("localizer"));
        wire_source(clock, graph, process, &localizer);
        let ended = Cell::new(false);
        readers.watch(Rc::new(event_fd), move || {
            let state = gate.borrow_mut().take(|packet| localizer.send(localizer::In::Packet(packet)));
            if state == WorkerState::Ended && !ended.replace(true) {
                tracing::error!("the source of this host has ended: no robot is measured any more; restart the host");
            }
        });
    }
}
