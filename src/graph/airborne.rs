//! Robots of this process that are in the air, for whose landing the process waits before it ends.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use crate::messages::ids::RobotId;
use crate::messages::wire::{Aloft, Flight};

/// States of the flights of this process's robots, as their Bodies said last. Clones share them.
#[derive(Clone, Debug, Default)]
pub(super) struct Airborne {
    flights: Rc<RefCell<BTreeMap<RobotId, Flight>>>,
}

impl Airborne {
    /// Takes what a Body says of its robot.
    pub(super) fn take(&self, aloft: Aloft) {
        self.flights.borrow_mut().insert(aloft.robot, aloft.flight);
    }

    /// Whether a robot is off the ground.
    pub(super) fn any(&self) -> bool {
        self.flights.borrow().values().any(|flight| *flight != Flight::Grounded)
    }

    /// Whether a robot is at its height.
    pub(super) fn flies(&self, robot: RobotId) -> bool {
        self.flights.borrow().get(&robot) == Some(&Flight::Flying)
    }
}
