//! One host of a deployment as a process: its part of the actor graph, in real time, on sockets. Contains no logic of
//! actors and no output for people.

use std::rc::Rc;

use super::bodies::wire_source;
use super::devices::{Device, Devices};
use super::inputs::{DeviceId, Input};
use super::process::{Graph, Process, ProcessEvent};
use super::sockets::{self, Take, Tell};
use crate::actors::recorder;
use crate::graph::{Plan, wire_hosts, wire_recorder};
use crate::messages::ids::{HostId, LinkId};
use crate::net::protocol::key::Key;
use crate::net::protocol::reliability::Setup;
use crate::net::transport::Transport;
use crate::random::Seed;
use crate::runtime::clock::Clock;
use crate::runtime::real::Readers;

/// Identity, links and devices of one host that runs as a process of its own, opened and ready to start.
pub struct Host {
    /// Id of the host: its index in the deployment.
    pub id: HostId,
    /// Number of the team, which keeps teams on the same network apart.
    pub team: u16,
    /// Incarnation: random number that distinguishes successive processes of the same host.
    pub incarnation: u32,
    /// Seed of the random streams of the host's link layer, drawn from the operating system.
    pub secret: Seed,
    /// Key that authenticates the team's datagrams; `None` only if no link leaves this machine.
    pub key: Option<Key>,
    /// Setup of each link, in the order of the deployment; `None` for a link in which the host does not take part.
    pub links: Vec<Option<Setup>>,
    /// Drivers and source of readings of the host's robots.
    pub devices: Devices,
    /// Open transports, each with its link; a link that is used on several network interfaces has several.
    pub transports: Vec<(LinkId, Box<dyn Transport>)>,
}

/// Creates and connects the actors of one host of a team. The event loop that watches `readers` runs them in real time.
///
/// `clock` is the host's clock. The host's sockets and devices are added to `readers`, the file descriptors that the
/// event loop watches. `plan` has the settings of the whole team, `host` the identity, links and devices of this host.
/// `report` is called with each event of the process (see [`ProcessEvent`]), `output` with results of episodes, on the
/// host that judges them. The returned graph has the mailboxes of all actors.
pub fn wire(
    (clock, readers): (&Clock, &mut Readers),
    plan: Plan,
    host: Host,
    report: impl Fn(HostId, ProcessEvent) + 'static,
    output: impl FnMut(recorder::Out) + 'static,
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
        report: Rc::new(report),
    };
    let graph = Rc::new(Graph::new(plan, &process));
    let _ = graph.clock.set(clock.clone());
    wire_hosts(clock, plan, &graph, &process);
    let (inside, id) = (Rc::clone(&graph), host.id);
    let take: Take = Rc::new(move |input| inside.take(id, input));
    wire_gates((clock, readers), plan, &graph, &process, &take);
    let (report, id) = (Rc::clone(&process.report), host.id);
    let tell: Tell = Rc::new(move |link, renewed| report(id, ProcessEvent::Link(link, renewed)));
    sockets::wire_all((clock, readers), host.transports, &graph.transports, (&take, &tell));
    if process.records {
        wire_recorder(clock, plan, &graph, output);
    }
    graph
}

/// Passes the packets of the workers (I/O threads) of drivers and source to `take`, and starts the Localizer of the
/// source. The event loop that watches `readers` then reads the packets.
fn wire_gates((clock, readers): (&Clock, &mut Readers), plan: &Plan, graph: &Graph, process: &Process, take: &Take) {
    for (robot, device) in &process.devices.drivers {
        watch(readers, device, DeviceId::Driver(*robot), take);
    }
    if let Some(device) = &process.devices.source {
        wire_source(clock, plan, graph, process);
        watch(readers, device, DeviceId::Source, take);
    }
}

fn watch<T: ?Sized>(readers: &mut Readers, device: &Device<T>, id: DeviceId, take: &Take) {
    let (packets, end) = (Rc::clone(take), Rc::clone(take));
    device.watch(readers, move |packet| packets(Input::Packet(id, packet)), move || end(Input::Ended(id)));
}
