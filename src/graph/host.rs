//! One host of a deployment as a process: its part of the actor graph, in real time, on sockets.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use super::bodies::wire_source;
use super::devices::{self, Devices};
use super::end::HostEnd;
use super::event::Event;
use super::inputs::{DeviceId, Input};
use super::process::{Graph, Process};
use super::sockets::{self, Take, Tell};
use crate::actors::recorder;
use crate::deploy::Routes;
use crate::edge::Gate;
use crate::graph::{wire_hosts, wire_recorder};
use crate::messages::ids::HostId;
use crate::runtime::clock::Clock;
use crate::runtime::real::Readers;
use crate::trial::Trial;

/// Creates and connects the actors of one host of a team. The event loop that watches `readers` runs them in real time.
///
/// `clock` is the host's clock. The host's sockets and devices are added to `readers`, the file descriptors that the
/// event loop watches. `trial` has the settings of the whole team, `end` the identity and the open links of this host,
/// `devices` its drivers and source. `report` is called with each event of the process (see [`Event`]), `output` with
/// results of episodes, on the host that judges them. The returned graph has the mailboxes of all actors.
pub fn wire(
    (clock, readers): (&Clock, &mut Readers),
    trial: Trial,
    (mut end, devices): (HostEnd, Devices),
    report: impl Fn(HostId, Event) + 'static,
    output: impl FnMut(recorder::Out) + 'static,
) -> Rc<Graph> {
    let (trial, id) = (&Rc::new(trial), end.me.host);
    let transports = std::mem::take(&mut end.transports);
    let ends = BTreeMap::from([(id, end)]);
    let process = Process { ends, emulated: false, devices, report: Rc::new(report) };
    let graph = Rc::new(Graph::new(trial, Routes::of(&trial.deployment), &process));
    let _ = graph.clock.set(clock.clone());
    wire_hosts(clock, trial, &graph, &process);
    let inside = Rc::clone(&graph);
    let take: Take = Rc::new(move |input| inside.take(id, input));
    wire_gates((clock, readers), trial, &graph, &process, &take);
    let events = Rc::clone(&graph.events);
    let tell: Tell = Rc::new(move |link, renewed| events.emit(id, Event::Link(link, renewed)));
    sockets::wire_all((clock, readers), transports, &graph.transports, (&take, &tell));
    if graph.recorder.is_some() {
        wire_recorder(clock, trial, &graph, output);
    }
    graph
}

/// Passes the packets of the workers of drivers and source to `take`, and starts the Localizer of the
/// source. The event loop that watches `readers` then reads the packets.
fn wire_gates((clock, readers): (&Clock, &mut Readers), trial: &Trial, graph: &Graph, process: &Process, take: &Take) {
    for (robot, device) in &process.devices.drivers {
        watch(readers, device.gate.as_ref(), DeviceId::Driver(*robot), take);
    }
    for (robot, gate) in &process.devices.agents {
        watch(readers, gate.as_ref(), DeviceId::Agent(*robot), take);
    }
    for ((robot, sense), gate) in &process.devices.senses {
        watch(readers, Some(gate), DeviceId::Sense(*robot, *sense), take);
    }
    if let Some(device) = &process.devices.source {
        wire_source(clock, trial, graph, process);
        watch(readers, device.gate.as_ref(), DeviceId::Source, take);
    }
}

fn watch(readers: &mut Readers, gate: Option<&Rc<RefCell<Gate>>>, id: DeviceId, take: &Take) {
    let Some(gate) = gate else { return };
    let (packets, end) = (Rc::clone(take), Rc::clone(take));
    devices::watch(gate, readers, move |packet| packets(Input::Packet(id, packet)), move || end(Input::Ended(id)));
}
