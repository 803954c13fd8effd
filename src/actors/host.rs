//! One host of a deployment as a process of its own: its part of the graph, in real time, on sockets. What an actor
//! does never lives here, nor what a person is shown.

use std::cell::RefCell;
use std::rc::Rc;

use tracing::info_span;

use super::Core;
use super::clock::Clock;
use super::graph::{Plan, wire_hosts, wire_recorder};
use super::network;
use super::process::{Graph, Heard, Process};
use super::real::Readers;
use super::recorder;
use super::shell::start;
use crate::messages::ids::{HostId, LinkId};
use crate::net::key::Key;
use crate::net::reliability::Setup;
use crate::net::transport::udp::Udp;
use crate::net::transport::{self, Arrive};
use crate::time::Time;

/// A host: which one it is, and its links.
pub struct Host {
    /// Its number in the deployment.
    pub id: HostId,
    /// The team's number.
    pub team: u16,
    /// Which of its lives this is.
    pub incarnation: u32,
    /// The team's key; none on a machine that keeps to itself.
    pub key: Option<Key>,
    /// How its links are set up, in the order of the deployment.
    pub links: Vec<Setup>,
    /// Its sockets by link, for the links that it uses.
    pub sockets: Vec<(LinkId, Udp)>,
}

/// Starts the actors of one host. `heard` is told what its Network makes known; `said` takes what the Recorder says,
/// which runs where the whole team is simulated.
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
        key: host.key,
        links: Some(host.links),
        records: plan.deployment.hosts[usize::from(host.id.0)].world.len() == plan.deployment.robots,
        hear: Rc::new(heard),
    };
    let graph = Rc::new(Graph::new(plan, &process));
    wire_hosts(clock, plan, &graph, &process);
    for (link, udp) in host.sockets {
        let mailbox = graph.transports[usize::from(link.0)].clone();
        let bell = mailbox.clone();
        readers.watch(udp.ears(), move || bell.send(transport::In::Readable));
        // A socket outlives its actor: what waits in it would be lost with it.
        let udp = Rc::new(RefCell::new(udp));
        let make = move |_| Shared::new(&udp);
        let network = graph.network_of(host.id);
        let name = &plan.deployment.links[usize::from(link.0)].name;
        start(clock, &mailbox, info_span!("udp", link = name), make, move |Arrive { frame, .. }| {
            network.send(network::In::Frame(link, frame));
        });
    }
    if process.records {
        wire_recorder(clock, plan, &graph, said);
    }
    graph
}

/// A core whose state outlives it.
pub(super) struct Shared<C>(Rc<RefCell<C>>);

impl<C> Shared<C> {
    pub(super) fn new(core: &Rc<RefCell<C>>) -> Shared<C> {
        Shared(Rc::clone(core))
    }
}

impl<C: Core> Core for Shared<C> {
    type In = C::In;
    type Out = C::Out;

    fn handle(&mut self, now: Time, input: C::In, out: &mut Vec<C::Out>) {
        self.0.borrow_mut().handle(now, input, out);
    }

    fn wake_at(&self) -> Option<Time> {
        self.0.borrow().wake_at()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<C::Out>) {
        self.0.borrow_mut().wake(now, out);
    }
}
