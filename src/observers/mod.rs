//! Observers: what a host passes on of its team's messages to programs of others, such as `rviz2`. An observer controls
//! no robot. This crate has none; others add theirs to the registry.

use crate::config::ConfigError;
use crate::edge::{Packet, Settings, Worker};
use crate::messages::ids::RobotId;
use crate::messages::wire::Wire;
use crate::time::Time;

/// Part of an observer that does no I/O: turns messages that reach its host into packets for its worker.
pub trait Observer {
    /// Handles a message that has reached the host at `now`, and appends packets for the worker to `out`. Packets that
    /// do not fit into the worker's queue are dropped.
    fn receive(&mut self, now: Time, message: &Wire, out: &mut Vec<Packet>);
}

/// The two parts of an observer, made from its settings.
pub struct Parts {
    /// Part without I/O.
    pub observer: Box<dyn Observer>,
    /// Worker that does the observer's I/O. Its packets to the host are discarded.
    pub worker: Box<dyn Worker>,
}

/// Entry of a kind of observer in the registry: its name, its description, and the function that makes it.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name by which a deployment selects the observer.
    pub name: &'static str,
    /// Description of the observer in one line, for the program's help text.
    pub about: &'static str,
    /// Makes the observer of a team of these robots from its settings; an error names the wrong setting.
    pub make: fn(&Settings, &[RobotId]) -> Result<Parts, ConfigError>,
}
