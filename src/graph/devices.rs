//! Drivers, sources and observation of one process, made from the deployment. Their workers run on threads of their
//! own.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crate::config::ConfigError;
use crate::deploy::Host;
use crate::drivers::Driver;
use crate::edge::{self, Gate, Packet, Worker, WorkerState};
use crate::localization::Source;
use crate::messages::ids::RobotId;
use crate::registry::Registry;
use crate::ros2::observe::{self, Observation};
use crate::runtime::real::Readers;

/// Constructor of a driver or a source, with the channel to its worker.
pub struct Device<T: ?Sized> {
    /// Makes a new one.
    pub make: Rc<dyn Fn() -> Box<T>>,
    /// Channel to its worker, if it has one.
    pub gate: Option<Rc<RefCell<Gate>>>,
}

impl<T: ?Sized> Device<T> {
    /// Calls `take` with each packet of its worker, and `ended` once when the worker has ended.
    pub fn watch(&self, readers: &mut Readers, take: impl Fn(Packet) + 'static, ended: impl Fn() + 'static) {
        let Some(gate) = self.gate.clone() else { return };
        let (event_fd, over) = (gate.borrow().event_fd(), Cell::new(false));
        readers.watch(Rc::new(event_fd), move || {
            let state = gate.borrow_mut().take(&take);
            if state == WorkerState::Ended && !over.replace(true) {
                ended();
            }
        });
    }
}

impl<T: ?Sized> Clone for Device<T> {
    fn clone(&self) -> Device<T> {
        Device { make: Rc::clone(&self.make), gate: self.gate.clone() }
    }
}

/// Drivers and sources of one process.
#[derive(Clone, Default)]
pub struct Devices {
    /// Driver of each robot.
    pub drivers: BTreeMap<RobotId, Device<dyn Driver>>,
    /// Source of the readings of the robots that the host localizes.
    pub source: Option<Device<dyn Source>>,
    /// Publication of what the host hears, with the channel to its worker.
    pub observation: Option<(Rc<Observation>, Rc<RefCell<Gate>>)>,
}

/// Threads of the workers. They end once the devices are dropped.
pub struct Workers(Vec<JoinHandle<()>>);

impl Workers {
    /// Waits until all have ended, for a second at most. The devices have to be dropped before.
    pub fn join(self) {
        let mut rests = (0..200).map(|_| thread::park_timeout(Duration::from_millis(5)));
        for worker in self.0 {
            let name = worker.thread().name().unwrap_or("worker").to_owned();
            while !worker.is_finished() && rests.next().is_some() {}
            if !worker.is_finished() {
                tracing::warn!("the worker of {name} does not end; its thread is abandoned");
            } else if worker.join().is_err() {
                tracing::error!("the worker of {name} has panicked");
            }
        }
    }
}

/// Error of devices that could not be made.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// Invalid settings.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The machine has no descriptor or thread left.
    #[error("a worker cannot be started: {0}")]
    Machine(#[from] std::io::Error),
}

/// Makes the devices of a host of a checked deployment and starts their workers. `robots` is the size of the team.
pub fn open(host: &Host, robots: usize, registry: &Registry) -> Result<(Devices, Workers), DeviceError> {
    let (mut devices, mut workers) = (Devices::default(), Workers(Vec::new()));
    for &robot in &host.actuates {
        let settings = host.driver.as_ref().expect("a checked host that actuates has a driver");
        let parts = registry.driver(settings, RobotId(robot)).map_err(|error| error.within("host"))?;
        if let Some(worker) = &parts.worker {
            worker.check().map_err(|error| error.within("driver").within("host"))?;
        }
        let gate =
            parts.worker.map(|worker| start_worker(worker, format!("driver {robot}"), &mut workers)).transpose()?;
        devices.drivers.insert(RobotId(robot), Device { make: Rc::from(parts.driver), gate });
    }
    if !host.localizes.is_empty() {
        let settings = host.source.as_ref().expect("a checked host that localizes has a source");
        let robots: Vec<RobotId> = host.localizes.iter().copied().map(RobotId).collect();
        let parts = registry.source(settings, &robots).map_err(|error| error.within("host"))?;
        parts.worker.check().map_err(|error| error.within("source").within("host"))?;
        let gate = Some(start_worker(parts.worker, "source".to_owned(), &mut workers)?);
        devices.source = Some(Device { make: Rc::from(parts.source), gate });
    }
    if let Some(settings) = &host.observe {
        let team: Vec<RobotId> = RobotId::team(robots).collect();
        let made = observe::make(settings, &team).map_err(|error| error.within("observe").within("host"));
        let (observation, worker) = made?;
        worker.check().map_err(|error| error.within("observe").within("host"))?;
        let gate = start_worker(Box::new(worker), "observation".to_owned(), &mut workers)?;
        devices.observation = Some((Rc::new(observation), gate));
    }
    Ok((devices, workers))
}

/// Starts a worker on a thread of its own.
fn start_worker(worker: Box<dyn Worker>, name: String, workers: &mut Workers) -> std::io::Result<Rc<RefCell<Gate>>> {
    let (gate, port) = edge::channel()?;
    workers.0.push(thread::Builder::new().name(name).spawn(move || worker.run(port))?);
    Ok(Rc::new(RefCell::new(gate)))
}
