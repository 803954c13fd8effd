//! Wiring of what moves and what measures: Bodies with their drivers, Localizers with their sources, and Worlds.

use std::cell::RefCell;
use std::rc::Rc;

use tracing::info_span;

use super::Plan;
use super::process::{Graph, Process};
use crate::actors::body::{self, Body};
use crate::actors::localizer::{self, Localizer};
use crate::actors::world::{self, Ground, World};
use crate::actors::{network, recorder, status};
use crate::drivers::Driver;
use crate::drivers::simulated::Simulated;
use crate::edge::Gate;
use crate::localization;
use crate::messages::geometry::Vec2;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Wire;
use crate::net::transport;
use crate::runtime::clock::Clock;
use crate::runtime::shell::{Mailbox, start};

/// Body of one robot, with the driver of its process or the simulated one.
pub(super) fn wire_body(clock: &Clock, graph: &Graph, robot: RobotId, process: &Process) {
    let host = graph.routes.actuator_host(robot);
    let (network, status) = (graph.network_of(host), graph.status_of(host));
    let (at, world) = (robot.index(), graph.worlds[robot.index()].clone());
    let device = process.devices.drivers.get(&robot).cloned();
    let gate: Option<Rc<RefCell<Gate>>> = device.as_ref().and_then(|device| device.gate.clone());
    let make = move |_| {
        let driver: Box<dyn Driver> = match &device {
            Some(device) => (device.make)(),
            None => Box::new(Simulated),
        };
        Body::new((host, robot), driver)
    };
    start(clock, &graph.bodies[at], info_span!("body", robot = robot.0), make, move |out| match out {
        body::Out::Drive(drive) => world.send(world::In::Drive(drive)),
        body::Out::Tell(packet) => gate.iter().for_each(|gate| gate.borrow_mut().send(packet.clone())),
        body::Out::Condition(health, battery) => status.send(status::In::Condition(robot, health, battery)),
        body::Out::Follows(latch) => status.send(status::In::Body(robot, latch)),
        body::Out::Stop(stop) => network.send(network::In::Publish(Wire::Stop(stop))),
    });
}

/// Localizer of one simulated robot.
pub(super) fn wire_sensor(clock: &Clock, plan: &Plan, graph: &Graph, robot: RobotId) {
    let network = graph.network_of(graph.routes.localizer_host(robot));
    let (sensor, seed) = (plan.physics.sensor, plan.seed);
    let make = move |life| {
        let stream = seed.stream(&format!("body/{}/sensor/{life}", robot.0));
        Localizer::new(Box::new(localization::simulated::Simulated::new(sensor, stream)))
    };
    let mailbox = &graph.sensors[robot.index()];
    start(clock, mailbox, info_span!("localizer", robot = robot.0), make, move |reading| {
        network.send(network::In::Publish(Wire::Reading(reading)));
    });
}

/// Localizer of a source of this process.
pub(super) fn wire_source(clock: &Clock, graph: &Graph, process: &Process, mailbox: &Mailbox<localizer::In>) {
    let (Some(host), Some(device)) = (process.only, process.devices.source.clone()) else { return };
    let network = graph.network_of(host);
    let make = move |_| Localizer::new((device.make)());
    start(clock, mailbox, info_span!("localizer"), make, move |reading| {
        network.send(network::In::Publish(Wire::Reading(reading)));
    });
}

/// The World of a host, with the robots that it simulates; at least one.
pub(super) fn wire_world(
    clock: &Clock,
    plan: &Plan,
    graph: &Graph,
    host: HostId,
    process: &Process,
    simulated: Vec<RobotId>,
) {
    let (sensors, record) = (graph.sensors.clone(), graph.record());
    let ranged = ranged_ethers(plan, graph, process);
    // On the floor before anything starts, as people would put them there.
    let starts: Vec<Vec2> = simulated.iter().map(|robot| plan.layouts.episode(0)[robot.index()].start).collect();
    let seed = plan.seed.child(&format!("world/{}", host.0));
    let plant = (plan.plant.build)(plan.scenario.arena(), &plan.physics, &starts, seed);
    let (ground, placement) = (Rc::new(RefCell::new(Ground::new(plant))), plan.deployment.placement);
    let place = &graph.worlds[simulated[0].index()];
    let make = move |_| World::new(Rc::clone(&ground), placement, &simulated);
    start(clock, place, info_span!("world", host = host.0), make, move |out| match out {
        world::Out::Sample(sample) => sensors[sample.robot.index()].send(localizer::In::Sample(sample)),
        world::Out::Truth(truth) => {
            ranged.iter().for_each(|ether| ether.send(transport::In::Truth(truth.clone())));
            record(recorder::In::Truth(truth));
        }
    });
}

/// The emulated links on which it matters where robots are.
fn ranged_ethers(plan: &Plan, graph: &Graph, process: &Process) -> Vec<Mailbox<transport::In>> {
    let links = plan.deployment.links.iter().zip(graph.transports.iter()).filter(|_| process.only.is_none());
    let ranged = links.filter(|(link, _)| link.range_m.or(link.radio.as_ref().and_then(|r| r.range_m)).is_some());
    ranged.map(|(_, ether)| ether.clone()).collect()
}
