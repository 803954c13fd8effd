//! Wiring of Bodies with their drivers, Localizers with their sources, and Worlds.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;

use tracing::info_span;

use super::devices::Device;
use super::emulated::users_m;
use super::event::Event;
use super::process::{Graph, Process};
use crate::actors::body::{self, Body};
use crate::actors::localizer::{self, Localizer};
use crate::actors::world::{self, PersistentPlant, World};
use crate::actors::{controller, network, senses, status};
use crate::chassis::Chassis;
use crate::deploy::{Deployment, Link};
use crate::drivers::Driver;
use crate::drivers::simulated::{Lift, Simulated};
use crate::estimation;
use crate::localization::screen::Screen;
use crate::localization::{self, Source, plausibility};
use crate::messages::geometry::Vec2;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Wire;
use crate::net::media::ether;
use crate::net::media::radio::Radio;
use crate::runtime::clock::Clock;
use crate::runtime::shell::{Mailbox, start};
use crate::safety::hardware::HardwareLimits;
use crate::trial::Trial;

/// Charge at which a simulated robot that flies lands, if its settings give none \[%\]: less than a landing uses.
const FLAT_PERCENT: u8 = 10;

/// Starts the Body of one robot (the actor that drives its motors), and passes its output to the other actors. The
/// driver is the robot's own in `process.devices`, or that of a simulated robot if there is none.
pub(super) fn wire_body(clock: &Clock, trial: &Trial, graph: &Graph, robot: RobotId, process: &Process) {
    let host = graph.routes.actuator_host(robot);
    let (network, status) = (graph.network_of(host), graph.status_of(host));
    let (at, world) = (robot.index(), graph.worlds[robot.index()].clone());
    let source = process.devices.source.as_ref().map(|_| graph.source.clone());
    let controller = (graph.routes.agent_host(robot) == host).then(|| graph.controllers[at].clone());
    let (events, airborne) = (Rc::clone(&graph.events), graph.airborne.clone());
    let out = move |out| match out {
        body::Out::Drive(drive) => world.send(world::In::Drive(drive)),
        body::Out::Send(_) => {}
        body::Out::Odometry(reading) => {
            source.iter().for_each(|source| source.send(localizer::In::Odometry(reading.clone())));
        }
        body::Out::Condition(hardware) => {
            events.emit(host, Event::Hardware(robot, &hardware));
            status.send(status::In::Condition(robot, hardware));
        }
        body::Out::Permit(permit) => {
            controller.iter().for_each(|controller| controller.send(controller::In::Permit(permit)));
        }
        body::Out::Aloft(aloft) => {
            airborne.take(aloft);
            network.send(network::In::Publish(Wire::Aloft(aloft)));
        }
        body::Out::Follows(latch) => status.send(status::In::Body(robot, latch)),
        body::Out::Stop(stop) => network.send(network::In::Publish(Wire::Stop(stop))),
    };
    match process.devices.drivers.get(&robot) {
        Some(device) => {
            let about = (device, &trial.deployment, graph.signed);
            start_body(clock, &graph.bodies[at], (host, robot), about, out);
        }
        None => {
            let (signed, flight) = (graph.signed, trial.deployment.flight(robot));
            let limits = flight.map_or_else(HardwareLimits::default, |_| {
                let own = trial.deployment.hardware_limits(robot);
                HardwareLimits { battery_least: own.battery_least.or(Some(FLAT_PERCENT)), ..own }
            });
            // The height outlives restarts of the Body, as that of a real robot does.
            let lift = flight.map(|_| Rc::new(RefCell::new(Lift::default())));
            let make = move |_| {
                let driver = Box::new(Simulated::with(lift.clone()));
                let body = Body::new((host, robot), driver, Chassis::default()).limited(limits).flying(flight);
                body.with_signed_orders(signed)
            };
            start(clock, &graph.bodies[at], info_span!("body", robot = robot.0), make, out);
        }
    }
}

/// Starts the Body of a real robot (the actor that drives its motors) with the driver in `device`. Packets from the
/// driver go to the driver's worker; `out` receives all other output of the Body. `signed` says whether the team's
/// orders are signed where they end a stop or a hold.
pub(super) fn start_body(
    clock: &Clock,
    mailbox: &Mailbox<body::In>,
    (host, robot): (HostId, RobotId),
    (device, deployment, signed): (&Device<dyn Driver>, &Deployment, bool),
    mut out: impl FnMut(body::Out) + 'static,
) {
    let (driver, gate) = (Rc::clone(&device.make), device.gate.clone());
    let (chassis, limits) = (deployment.chassis(robot), deployment.hardware_limits(robot));
    let flight = deployment.flight(robot);
    let make =
        move |_| Body::new((host, robot), driver(), chassis).limited(limits).with_signed_orders(signed).flying(flight);
    start(clock, mailbox, info_span!("body", robot = robot.0), make, move |said| match said {
        body::Out::Send(packet) => gate.iter().for_each(|gate| gate.borrow_mut().send(packet.clone())),
        other => out(other),
    });
}

/// Starts the Localizer of one simulated robot, the actor that makes its readings from the true states of the World.
/// `chassis` holds the chassis of every robot of the team.
pub(super) fn wire_sensor(clock: &Clock, trial: &Trial, graph: &Graph, robot: RobotId, chassis: &Rc<[Chassis]>) {
    let network = graph.network_of(graph.routes.localizer_host(robot));
    let (sensor, seed, chassis) = (trial.physics.sensor, trial.streams(), Rc::clone(chassis));
    let make = move |incarnation| {
        let stream = seed.stream(&format!("body/{}/sensor/{incarnation}", robot.0));
        Localizer::new(Box::new(localization::simulated::Simulated::new(sensor, stream)), Rc::clone(&chassis))
    };
    let mailbox = &graph.sensors[robot.index()];
    start(clock, mailbox, info_span!("localizer", robot = robot.0), make, move |out| {
        network.send(network::In::Publish(published(out)));
    });
}

/// Returns the message in which an output of a Localizer is published.
fn published(out: localizer::Out) -> Wire {
    match out {
        localizer::Out::Reading(reading) => Wire::Reading(reading),
        localizer::Out::Located(located) => Wire::Located(located),
    }
}

/// Starts the Localizer of a process, the actor that runs its source of readings of real robots, and publishes the
/// readings. Does nothing if the process has no source.
pub(super) fn wire_source(clock: &Clock, trial: &Trial, graph: &Graph, process: &Process) {
    let (Some(host), Some(device)) = (process.ends.keys().next().copied(), &process.devices.source) else { return };
    let network = graph.network_of(host);
    let axis_m_s = Some(trial.models.limit_m_s());
    start_source(clock, &graph.source, device, (&trial.deployment, host, &trial.estimator, axis_m_s), move |out| {
        network.send(network::In::Publish(published(out)));
    });
}

/// Starts the Localizer that runs the source of readings in `device` on a host, for the team's deployment and
/// the estimator that uses the readings; `out` receives its output. `axis_m_s` is the largest speed along each axis
/// that the policy commands \[m/s\], if it is known.
pub(super) fn start_source(
    clock: &Clock,
    mailbox: &Mailbox<localizer::In>,
    device: &Device<dyn Source>,
    (deployment, host, estimator, axis_m_s): (&Deployment, HostId, &estimation::Entry, Option<f32>),
    out: impl FnMut(localizer::Out) + 'static,
) {
    let (source, chassis) = (Rc::clone(&device.make), deployment.team_chassis());
    let entry = &deployment.hosts[usize::from(host.0)];
    let settings = entry.source.as_ref().expect("a checked host that localizes has a source");
    let limits = |robot: &u16| {
        let robot = RobotId(*robot);
        let own = plausibility::limits(settings, robot, (&chassis[robot.index()], axis_m_s));
        (robot, own.expect("a checked deployment has sound limits"))
    };
    let screen = Screen::new(host, entry.localizes.iter().map(limits).collect());
    let positions_suffice = (estimator.make)(&estimation::Settings::default()).finds_velocities();
    let make = move |_| {
        let mut source = source();
        if positions_suffice {
            source.positions_suffice();
        }
        Localizer::new(source, Rc::clone(&chassis)).screened(screen.clone())
    };
    start(clock, mailbox, info_span!("localizer"), make, out);
}

/// Starts the World of a host, the actor that runs its simulator. `simulated` holds the robots to simulate, in
/// ascending order; it must not be empty.
pub(super) fn wire_world(
    clock: &Clock,
    trial: &Trial,
    graph: &Graph,
    host: HostId,
    process: &Process,
    simulated: Vec<RobotId>,
) {
    let (sensors, events) = (graph.sensors.clone(), Rc::clone(&graph.events));
    let ranged = ranged_media(trial, graph, process);
    let others: Vec<RobotId> =
        RobotId::team(trial.deployment.robots).filter(|robot| simulated.binary_search(robot).is_err()).collect();
    // Robots stand at their first starts before the run begins, as if people had placed them.
    let task = |robot: &RobotId| trial.layouts.episode(0)[robot.index()];
    let starts: Vec<Vec2> = simulated.iter().chain(&others).map(|robot| task(robot).start).collect();
    let others: Vec<(RobotId, Chassis)> =
        others.into_iter().map(|robot| (robot, trial.deployment.chassis(robot))).collect();
    let seed = trial.streams().child(&format!("world/{}", host.0));
    let mut plant = (trial.plant_entry().build)(trial.scenario.arena(), &trial.physics, &starts, seed);
    for (index, robot) in simulated.iter().enumerate() {
        let chassis = trial.deployment.chassis(*robot);
        if chassis != Chassis::default() {
            plant.equip(index, chassis, task(robot).heading());
        }
    }
    let (persistent, placement) = (Rc::new(RefCell::new(PersistentPlant::new(plant))), trial.placement());
    let place = &graph.worlds[simulated[0].index()];
    let scenario = Arc::clone(&trial.scenario);
    let (senses, perceives) = (graph.senses.clone(), !trial.deployment.sense_names().is_empty());
    let (perceiving, layouts, all) = (simulated.clone(), trial.layouts.clone(), trial.deployment.team_chassis());
    let make = move |_| {
        World::new(Rc::clone(&persistent), Arc::clone(&scenario), placement, &simulated, &others)
            .with_scenes(perceives)
            .with_layouts(layouts.clone())
            .observing(Rc::clone(&all))
    };
    start(clock, place, info_span!("world", host = host.0), make, move |out| match out {
        world::Out::Sample(sample) => sensors[sample.robot.index()].send(localizer::In::Sample(sample)),
        world::Out::Truth(truth) => {
            ranged.iter().for_each(|medium| medium.send(ether::In::Truth(truth.clone())));
            events.emit(host, Event::Truth(&truth));
        }
        world::Out::Scene(scene) => {
            perceiving.iter().for_each(|robot| senses[robot.index()].send(senses::In::Scene(scene.clone())));
        }
    });
}

/// Returns the mailboxes of the emulated media that carry frames by the robots' positions.
fn ranged_media(trial: &Trial, graph: &Graph, process: &Process) -> Vec<Mailbox<ether::In>> {
    let links = trial.deployment.links.iter().zip(graph.media.iter()).filter(|_| process.emulated);
    let is_ranged = |link: &Link| {
        let by_radio = link.radio.as_ref().is_some_and(Radio::needs_positions);
        by_radio || link.range_m.or_else(|| users_m(trial, link)).is_some()
    };
    let ranged = links.filter(|(link, _)| is_ranged(link));
    ranged.map(|(_, medium)| medium.clone()).collect()
}
