//! Observer: passes what a host hears of its team on to the publication for programs of others.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;

use crate::edge::Gate;

use crate::messages::geometry::Motion;
use crate::messages::ids::RobotId;
use crate::messages::wire::{Features, Wire};
use crate::ros2::observe::Observation;
use crate::time::{Span, Time};

/// Period of the team's state and latents; poses follow their readings.
const PERIOD: Span = Span::from_millis(100);

/// Observer of one host.
pub(super) struct Observer {
    observation: Rc<Observation>,
    gate: Rc<RefCell<Gate>>,
    team: RefCell<BTreeMap<RobotId, Motion>>,
    latents: RefCell<BTreeMap<RobotId, Features>>,
    /// Time of the next state.
    next: Cell<Time>,
}

impl Observer {
    /// Makes one that has heard nothing.
    pub fn new((observation, gate): (Rc<Observation>, Rc<RefCell<Gate>>)) -> Observer {
        let (team, latents) = (RefCell::default(), RefCell::default());
        Observer { observation, gate, team, latents, next: Cell::new(Time::ZERO) }
    }

    /// Takes a message that has reached this host. It never waits: what the worker has no room for is dropped.
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
        // What the worker says of its topics is in its log.
        self.gate.borrow_mut().take(|_| {});
    }
}
