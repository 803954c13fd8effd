//! Drivers of robots, source of readings and observer of messages of one process, created from the deployment. Their
//! workers, which do the I/O, are actors on threads of their own.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::time::Duration;

use super::agents::agent_of;
use crate::actors::agent::apart;
use crate::config::ConfigError;
use crate::deploy::Host;
use crate::drivers::Driver;
use crate::edge::exclusive::Exclusive;
use crate::edge::{self, Gate, Packet, Running, Worker, WorkerState};
use crate::localization::Source;
use crate::messages::ids::RobotId;
use crate::messages::wire::Wire;
use crate::observers::Observer;
use crate::registry::Registry;
use crate::runtime::real::Readers;
use crate::time::Time;
use crate::trial::Trial;

/// Longest time that all workers together have to end.
const PATIENCE: Duration = Duration::from_secs(1);

/// Driver of a robot or source of readings: a function that makes its state machine, and the channel to its worker (I/O
/// thread).
pub(crate) struct Device<T: ?Sized> {
    /// Function that makes a new driver or source; it is called at each start of the actor that uses it.
    pub(crate) make: Rc<dyn Fn() -> Box<T>>,
    /// Channel to the worker of the driver or source; `None` if there is no worker.
    pub(crate) gate: Option<Rc<RefCell<Gate>>>,
}

/// Registers a worker with the event loop of `readers`: it calls `take` with each packet from the worker, and `ended`
/// when the worker has ended or begins again. `gate` is the channel to the worker.
pub(super) fn watch(
    gate: &Rc<RefCell<Gate>>,
    readers: &mut Readers,
    take: impl Fn(Packet) + 'static,
    ended: impl Fn() + 'static,
) {
    let gate = Rc::clone(gate);
    let (bell, over) = (gate.borrow().bell(), Cell::new(false));
    readers.watch(Rc::new(bell), move || {
        let state = gate.borrow_mut().take(&take);
        let over = match state {
            WorkerState::Running => true,
            WorkerState::Restarted => false,
            WorkerState::Ended => over.replace(true),
        };
        if !over {
            ended();
        }
    });
}

impl<T: ?Sized> Device<T> {
    /// Registers the device's worker with the event loop of `readers`, as [`watch`] does. Does nothing without a
    /// worker.
    pub(crate) fn watch(&self, readers: &mut Readers, take: impl Fn(Packet) + 'static, ended: impl Fn() + 'static) {
        if let Some(gate) = &self.gate {
            watch(gate, readers, take, ended);
        }
    }
}

impl<T: ?Sized> Clone for Device<T> {
    fn clone(&self) -> Device<T> {
        Device { make: Rc::clone(&self.make), gate: self.gate.clone() }
    }
}

/// Drivers and source of readings of the real robots in one process.
#[derive(Clone, Default)]
pub struct Devices {
    /// Driver of each real robot whose motors this process drives.
    pub(crate) drivers: BTreeMap<RobotId, Device<dyn Driver>>,
    /// Source of readings of the robots that this process localizes; `None` if there is none.
    pub(crate) source: Option<Device<dyn Source>>,
    /// Channels to the workers that compute policies, by the first robot of each Agent; `None` in a replay, which has
    /// their answers. Empty if Agents compute their policies themselves.
    pub(crate) agents: BTreeMap<RobotId, Option<Rc<RefCell<Gate>>>>,
    /// Channels to the workers of the senses of this process's robots, by robot and index of the sense; empty in a
    /// replay, which has their packets.
    pub(crate) senses: BTreeMap<(RobotId, u8), Rc<RefCell<Gate>>>,
    /// Observer of the messages that reach this process; `None` if it is not configured.
    pub(crate) observer: Option<Observed>,
}

/// Observer of one process, with the channel to its worker.
#[derive(Clone)]
pub(crate) struct Observed {
    observer: Rc<RefCell<Box<dyn Observer>>>,
    gate: Rc<RefCell<Gate>>,
}

impl Observed {
    /// Passes a message that has reached this process at `now` to the observer, and what it makes of it to the worker.
    /// Never waits.
    pub(crate) fn receive(&self, now: Time, message: &Wire) {
        let (mut packets, mut gate) = (Vec::new(), self.gate.borrow_mut());
        self.observer.borrow_mut().receive(now, message, &mut packets);
        // To look for the worker's answers is a system call, which most messages are not worth.
        if packets.is_empty() {
            return;
        }
        packets.into_iter().for_each(|packet| gate.send(packet));
        gate.take(|_| {});
    }
}

/// Running workers, which do the input and output of drivers and sources. They end after the [`Devices`] are dropped.
#[derive(Default)]
pub struct Workers {
    running: Vec<Running>,
    /// Name of each worker, and the lock on its robot if it claims one.
    locks: Vec<(String, Option<Exclusive>)>,
}

impl Workers {
    /// Waits until all workers have ended, for up to a second in total. The [`Devices`] must be dropped before, since
    /// only then the workers end.
    pub fn join(self) {
        let ended = edge::join_all(self.running, PATIENCE);
        for ((name, lock), _) in self.locks.into_iter().zip(ended).filter(|(_, ended)| !ended) {
            tracing::warn!("the worker of {name} does not end; its thread is abandoned");
            // It may still use the robot.
            std::mem::forget(lock);
        }
    }
}

/// Error while drivers and sources are created and started.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// A setting of a driver or source is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The operating system has no file descriptor or thread left for a worker.
    #[error("a worker cannot be started: {0}")]
    Machine(#[from] std::io::Error),
    /// Another process of this machine uses the same robot.
    #[error("{0} is used by another program on this machine, such as a host of the same robot; end that one first")]
    InUse(String),
}

/// Creates the drivers and the source of one host of a checked deployment, without workers and so without access to
/// hardware, for a replay. An error names the wrong setting.
pub(crate) fn closed(host: &Host, trial: &Trial, registry: &Registry) -> Result<Devices, DeviceError> {
    let mut devices = make(host, registry, |_, _, _| Ok(None))?;
    devices.agents = agents_apart(host, trial).map(|robots| (robots[0], None)).collect();
    Ok(devices)
}

/// Returns the robots of each Agent of a host whose policies are computed by a worker.
fn agents_apart(host: &Host, trial: &Trial) -> impl Iterator<Item = Vec<RobotId>> {
    let all = host.agents.iter().filter(|_| trial.models.run_apart());
    all.map(|robots| robots.iter().copied().map(RobotId).collect::<BTreeSet<_>>().into_iter().collect())
}

/// A program that a host runs, for a driver or a source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunBy {
    /// Name of the driver or the source that runs it, such as `driver 2`.
    pub device: String,
    /// The program file, followed by its arguments.
    pub command: Vec<String>,
}

/// Returns the programs that the drivers and the source of one host of a checked deployment run. Nothing is started. An
/// error names the wrong setting.
pub fn programs(host: &Host, registry: &Registry) -> Result<Vec<RunBy>, DeviceError> {
    let mut programs = Vec::new();
    make(host, registry, |worker, _, device| {
        programs.extend(worker.runs().map(|command| RunBy { device, command }));
        Ok(None)
    })?;
    Ok(programs)
}

/// Creates the drivers and the source of one host of a checked deployment, and starts their workers.
/// `robots` is the number of robots of the team. An error names the wrong setting, or says that a worker cannot be
/// started.
pub fn open(host: &Host, robots: usize, registry: &Registry) -> Result<(Devices, Workers), DeviceError> {
    let mut workers = Workers::default();
    let mut devices = make(host, registry, |worker, field, name| {
        worker.check().map_err(|error| error.within(field).within("host"))?;
        Ok(Some(start_worker(worker, name, &mut workers)?))
    })?;
    if let Some(settings) = &host.observe {
        let team: Vec<RobotId> = RobotId::team(robots).collect();
        let parts = registry.observer(settings, &team).map_err(|error| error.within("host"))?;
        parts.worker.check().map_err(|error| error.within("observe").within("host"))?;
        let gate = start_worker(parts.worker, "observer".to_owned(), &mut workers)?;
        devices.observer = Some(Observed { observer: Rc::new(RefCell::new(parts.observer)), gate });
    }
    Ok((devices, workers))
}

/// Starts the workers that compute the policies of a host's Agents, if those of `trial` are computed apart. An error
/// says that a worker cannot be started.
pub(crate) fn open_agents(
    host: &Host,
    trial: &Trial,
    (devices, workers): (&mut Devices, &mut Workers),
) -> Result<(), DeviceError> {
    for robots in agents_apart(host, trial) {
        let (first, trial) = (robots[0], trial.clone());
        let worker = apart::worker(move || agent_of(&trial, &robots, 1));
        let gate = start_worker(worker, format!("policy {}", first.0), workers)?;
        devices.agents.insert(first, Some(gate));
    }
    Ok(())
}

/// Starts the workers of the senses of the robots whose Bodies a host runs. An error names the wrong setting, or says
/// that a worker cannot be started.
pub(crate) fn open_senses(
    host: &Host,
    trial: &Trial,
    (devices, workers): (&mut Devices, &mut Workers),
) -> Result<(), DeviceError> {
    for robot in host.simulates.iter().chain(&host.actuates).copied().map(RobotId) {
        for (index, name, parts) in trial.senses(robot)? {
            let Some(worker) = parts.worker else { continue };
            worker.check().map_err(|error| error.within(&name).within("senses"))?;
            let gate = start_worker(worker, format!("{name} {}", robot.0), workers)?;
            devices.senses.insert((robot, index), gate);
        }
    }
    Ok(())
}

/// Makes the drivers and the source of one host. `start` gets each worker with the field of the deployment that it
/// belongs to and a name for its thread, and returns the channel to the worker if it runs.
fn make(
    host: &Host,
    registry: &Registry,
    mut start: impl FnMut(Box<dyn Worker>, &'static str, String) -> Result<Option<Rc<RefCell<Gate>>>, DeviceError>,
) -> Result<Devices, DeviceError> {
    let mut devices = Devices::default();
    for &robot in &host.actuates {
        let settings = host.driver.as_ref().expect("a checked host that actuates has a driver");
        let parts = registry.driver(settings, RobotId(robot)).map_err(|error| error.within("host"))?;
        let gate = match parts.worker {
            Some(worker) => start(worker, "driver", format!("driver {robot}"))?,
            None => None,
        };
        devices.drivers.insert(RobotId(robot), Device { make: Rc::from(parts.driver), gate });
    }
    if !host.localizes.is_empty() {
        let settings = host.source.as_ref().expect("a checked host that localizes has a source");
        let robots: Vec<RobotId> = host.localizes.iter().copied().map(RobotId).collect();
        let parts = registry.source(settings, &robots).map_err(|error| error.within("host"))?;
        let gate = start(parts.worker, "source", "source".to_owned())?;
        devices.source = Some(Device { make: Rc::from(parts.source), gate });
    }
    Ok(devices)
}

/// Starts a worker under the given name, adds it to `workers`, with the lock on its robot if it claims one, and returns
/// the channel to the worker.
fn start_worker(
    worker: Box<dyn Worker>,
    name: String,
    workers: &mut Workers,
) -> Result<Rc<RefCell<Gate>>, DeviceError> {
    let claim = worker.claim();
    let lock = claim.as_deref().map(Exclusive::lock).transpose()?.flatten();
    if let Some(robot) = claim.filter(|_| lock.is_none()) {
        return Err(DeviceError::InUse(robot));
    }
    let (gate, running) = edge::start(worker, &name)?;
    workers.running.push(running);
    workers.locks.push((name, lock));
    Ok(Rc::new(RefCell::new(gate)))
}
