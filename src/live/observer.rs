//! Observer: forwards poses and latents that a host receives to a worker (I/O thread), which publishes them as ROS
//! messages for other programs.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;

use crate::edge::Gate;

use crate::messages::geometry::Motion;
use crate::messages::ids::RobotId;
use crate::messages::wire::{Features, Wire};
use crate::ros2::observe::Observation;
use crate::time::{Span, Time};

/// Shortest time between two publications of the team's positions, velocities and latents. Single poses are published
/// with each reading.
const PERIOD: Span = Span::from_millis(100);

/// Passes the readings and latents that one host receives to the worker (I/O thread) that publishes them as ROS
/// messages.
pub(super) struct Observer {
    observation: Rc<Observation>,
    gate: Rc<RefCell<Gate>>,
    team: RefCell<BTreeMap<RobotId, Motion>>,
    latents: RefCell<BTreeMap<RobotId, Features>>,
    /// Earliest time of the next publication of the team's positions, velocities and latents.
    next: Cell<Time>,
}

impl Observer {
    /// Creates an observer that has received nothing, from the encoder of ROS messages and the channel to the worker.
    pub fn new((observation, gate): (Rc<Observation>, Rc<RefCell<Gate>>)) -> Observer {
        let (team, latents) = (RefCell::default(), RefCell::default());
        Observer { observation, gate, team, latents, next: Cell::new(Time::ZERO) }
    }

    /// Passes a message that has reached this host at `now` to the worker, if it is a reading or a latent. Never waits:
    /// packets that do not fit into the worker's queue are dropped.
    pub fn hear(&self, now: Time, message: &Wire) {
        let send = |packet: Option<Vec<u8>>| packet.into_iter().for_each(|one| self.gate.borrow_mut().send(one.into()));
        match message {
            Wire::Reading(reading) => {
                let motion = Motion { position: reading.pose.position, velocity: reading.twist.velocity };
                self.team.borrow_mut().insert(reading.robot, motion);
                send(self.observation.pose(reading));
            }
            Wire::Latent(latent) => drop(self.latents.borrow_mut().insert(latent.robot, latent.features.clone())),
            _ => return,
        }
        if now < self.next.get() {
            return;
        }
        self.next.set(now + PERIOD);
        let team: Vec<(RobotId, Motion)> = self.team.borrow().iter().map(|(&robot, &motion)| (robot, motion)).collect();
        send(self.observation.state(&team));
        let latents = self.latents.borrow();
        let rows: Vec<(RobotId, &[f32])> = latents.iter().map(|(robot, features)| (*robot, &features.0[..])).collect();
        send(self.observation.latents(&rows));
        // The worker's answers are discarded: they are in its own log.
        self.gate.borrow_mut().take(|_| {});
    }
}
