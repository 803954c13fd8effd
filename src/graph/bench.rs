//! Bench: runs the Bodies and the Localizer of one host without a Network or a team, in real time, for checks of its
//! devices. A Wiggle may drive the robots; otherwise they stand still.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::rc::Rc;

use tracing::info_span;

use super::airborne::Airborne;
use super::bodies::{start_body, start_source};
use super::devices::Devices;
use crate::actors::drive_check::DriveCheck;
use crate::actors::wiggle::{self, Wiggle};
use crate::actors::{body, localizer};
use crate::deploy::Deployment;
use crate::estimation;
use crate::messages::geometry::Vec2;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::latch::Latch;
use crate::messages::wire::{Hardware, MotorCommand, Phase, Reading};
use crate::runtime::clock::Clock;
use crate::runtime::real::Readers;
use crate::runtime::shell::{Mailbox, start};
use crate::time::{Span, Time};

/// Period and validity of commands to stand still. A command expires just when the next one is sent.
const STAND_PERIOD: Span = Span::from_millis(100);

/// Longest time for which robots that fly rise before a Wiggle begins. One that is not at its height by then does not
/// move, which the Wiggle finds.
const RISING: Span = Span::from_millis(15_000);

/// Event of a bench, on which the devices of one host run without a team, for checks.
#[derive(Clone, Debug)]
pub enum Event {
    /// Reading of a robot from the host's source of readings.
    Reading(Reading),
    /// Odometry (the robot's own measurement of its motion) from the driver of a robot.
    Odometry(Reading),
    /// Condition of a robot's hardware, as reported by the Body, the actor that drives the motors.
    Hardware(RobotId, Hardware),
    /// The worker of the source of readings has ended.
    SourceEnded,
    /// The Wiggle, a check that drives each robot a short way, now drives this robot.
    Begins(RobotId),
    /// The Wiggle, a check that drives each robot a short way, has judged a robot.
    Result(RobotId, DriveCheck),
    /// The Wiggle, a check that drives each robot a short way, has ended.
    Over,
}

/// Bench: the running devices of one host without a team, for checks, with the mailboxes of their actors.
pub struct Bench {
    bodies: BTreeMap<RobotId, Mailbox<body::In>>,
    wiggle: Option<Mailbox<wiggle::In>>,
    source: Mailbox<localizer::In>,
    /// Whether the host has a source. If not, the robots' odometry is used instead.
    localizes: bool,
    /// Robots that fly, the states of their flights, and since when they rise for the Wiggle; `None` before.
    fliers: Vec<RobotId>,
    airborne: Airborne,
    rising: Cell<Option<Time>>,
    ends: Cell<bool>,
}

impl Bench {
    /// Starts the Wiggle, a check that drives each robot a short way. Without a configured Wiggle, nothing happens.
    /// Robots that fly rise for it first.
    pub fn begin(&self) {
        match self.fliers.is_empty() {
            true => self.send(wiggle::In::Begin),
            false => self.rising.set(self.rising.get().or(Some(Time::MAX))),
        }
    }

    /// Whether a robot of the bench is in the air, for whose landing the caller has to wait.
    pub fn is_airborne(&self) -> bool {
        self.airborne.any()
    }

    /// Stands in for the state server of robots that fly: they rise once the Wiggle is to begin, and it begins when all
    /// are at their heights, or when the longest time for that is over.
    fn lead_fliers(&self, now: Time) {
        let phase = if self.rising.get().is_some() { Phase::Resetting } else { Phase::NeedReset };
        for robot in &self.fliers {
            self.bodies[robot].send(body::In::Instruction(Latch::default(), phase));
        }
        let since = match self.rising.get() {
            Some(Time::MAX) => now,
            Some(since) => since,
            None => return,
        };
        self.rising.set(Some(since));
        if self.fliers.iter().all(|robot| self.airborne.flies(*robot)) || now.since(since) >= RISING {
            self.send(wiggle::In::Begin);
        }
    }

    /// Ends the Wiggle (the check that drives each robot a short way), if it runs, and stops all robots for good.
    pub fn leave(&self) {
        self.ends.set(true);
        self.send(wiggle::In::End);
        self.bodies.values().for_each(|body| body.send(body::In::Leave));
    }

    /// Passes a reading on to the robot's Body and to the Wiggle.
    fn reading(&self, reading: &Reading) {
        if let Some(body) = self.bodies.get(&reading.robot) {
            body.send(body::In::Reading(reading.clone()));
        }
        self.send(wiggle::In::Reading(reading.clone()));
    }

    fn send(&self, input: wiggle::In) {
        if let Some(wiggle) = &self.wiggle {
            wiggle.send(input);
        }
    }
}

/// Starts a bench in real time: the given devices of one host of a deployment, without a team. The host uses readings
/// by the given estimator. If `wiggle` is given,
/// that check drives the robots after [`Bench::begin`] is called. `report` is called with each event.
pub fn wire(
    (clock, readers): (&Clock, &mut Readers),
    (deployment, host, estimator): (&Deployment, HostId, &estimation::Entry),
    devices: &Devices,
    wiggle: Option<wiggle::Config>,
    report: impl Fn(Event) + 'static,
) -> Rc<Bench> {
    let report: Rc<dyn Fn(Event)> = Rc::new(report);
    let named = |robot: &RobotId| (*robot, Mailbox::new(format!("body of {robot}")));
    let bench = Rc::new(Bench {
        bodies: devices.drivers.keys().map(named).collect(),
        wiggle: wiggle.is_some().then(|| Mailbox::new("wiggle")),
        source: Mailbox::new("localizer"),
        localizes: devices.source.is_some(),
        fliers: devices.drivers.keys().copied().filter(|robot| deployment.flight(*robot).is_some()).collect(),
        airborne: Airborne::default(),
        rising: Cell::new(None),
        ends: Cell::new(false),
    });
    if !bench.fliers.is_empty() {
        lead(clock, &bench);
    }
    for (robot, device) in &devices.drivers {
        let (robot, mailbox) = (*robot, bench.bodies[robot].clone());
        let out = of_body(&bench, robot, Rc::clone(&report));
        start_body(clock, &mailbox, (host, robot), (device, deployment, false), out);
        // Bodies move only after a clear latch. The caller has checked the team's latch before; only a Wiggle commands
        // motion here.
        mailbox.send(body::In::Instruction(Latch::default(), Phase::Running));
        let ended = mailbox.clone();
        let take = move |packet| mailbox.send(body::In::Packet(packet));
        device.watch(readers, take, move || ended.send(body::In::WorkerEnded));
    }
    if let Some(device) = &devices.source {
        let (to, report_reading) = (Rc::clone(&bench), Rc::clone(&report));
        start_source(clock, &bench.source, device, (deployment, host, estimator, None), move |out| match out {
            localizer::Out::Reading(reading) => {
                to.reading(&reading);
                report_reading(Event::Reading(reading));
            }
            // The log says which robot is lost, and why.
            localizer::Out::Located(_) => {}
        });
        let (source, report) = (bench.source.clone(), Rc::clone(&report));
        let take = move |packet| source.send(localizer::In::Packet(packet));
        device.watch(readers, take, move || report(Event::SourceEnded));
    }
    match (wiggle, &bench.wiggle) {
        (Some(config), Some(mailbox)) => wire_wiggle((clock, mailbox), &bench.bodies, config, report),
        _ => stand(clock, &bench),
    }
    bench
}

/// Leads the robots that fly, periodically, until the bench ends.
fn lead(clock: &Clock, bench: &Rc<Bench>) {
    bench.lead_fliers(clock.now());
    let (again, bench) = (clock.clone(), Rc::clone(bench));
    let lead_on = move || {
        if !bench.ends.get() {
            lead(&again, &bench)
        }
    };
    clock.call(clock.now() + STAND_PERIOD, Box::new(lead_on));
}

/// Commands all robots to stand still, periodically, so that a driver that has ended is noticed.
fn stand(clock: &Clock, bench: &Rc<Bench>) {
    for (robot, body) in &bench.bodies {
        let velocity = Vec2::zeros();
        body.send(body::In::MotorCommand(MotorCommand { robot: *robot, velocity, valid_for: STAND_PERIOD }));
    }
    let (again, bench) = (clock.clone(), Rc::clone(bench));
    clock.call(clock.now() + STAND_PERIOD, Box::new(move || stand(&again, &bench)));
}

/// Returns the function that handles the output of the Body of `robot` on a bench: it reports odometry and hardware
/// condition, and passes them to the Wiggle.
fn of_body(bench: &Rc<Bench>, robot: RobotId, report: Rc<dyn Fn(Event)>) -> impl FnMut(body::Out) + use<> {
    let bench = Rc::clone(bench);
    move |out| match out {
        body::Out::Odometry(reading) => {
            if bench.localizes {
                bench.source.send(localizer::In::Odometry(reading.clone()));
            } else {
                bench.reading(&reading);
            }
            report(Event::Odometry(reading));
        }
        body::Out::Condition(hardware) => {
            bench.send(wiggle::In::Hardware(robot, hardware.clone()));
            report(Event::Hardware(robot, hardware));
        }
        body::Out::Aloft(aloft) => bench.airborne.take(aloft),
        body::Out::Drive(_)
        | body::Out::Send(_)
        | body::Out::Permit(_)
        | body::Out::Follows(_)
        | body::Out::Stop(_) => {}
    }
}

fn wire_wiggle(
    (clock, mailbox): (&Clock, &Mailbox<wiggle::In>),
    bodies: &BTreeMap<RobotId, Mailbox<body::In>>,
    config: wiggle::Config,
    report: Rc<dyn Fn(Event)>,
) {
    let bodies = bodies.clone();
    let make = move |_| Wiggle::new(config.clone());
    start(clock, mailbox, info_span!("wiggle"), make, move |out| match out {
        wiggle::Out::Command(command) => bodies[&command.robot].send(body::In::MotorCommand(command)),
        wiggle::Out::Begins(robot) => report(Event::Begins(robot)),
        wiggle::Out::Result(robot, verdict) => report(Event::Result(robot, verdict)),
        wiggle::Out::Over => report(Event::Over),
    });
}
