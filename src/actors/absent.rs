//! Hosts of a team that have announced their shutdown and are not back yet, as a state server knows them.

use std::collections::BTreeSet;

use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Status;

/// Hosts that have left the team; those without robots do not count.
#[derive(Debug)]
pub(super) struct Absent {
    /// For each host, by its id: its robots.
    hosts: Vec<Vec<RobotId>>,
    left: BTreeSet<HostId>,
}

impl Absent {
    /// Returns the state before any host has left. `hosts` has the robots of each host, by its id.
    pub(super) fn new(hosts: Vec<Vec<RobotId>>) -> Absent {
        Absent { hosts, left: BTreeSet::new() }
    }

    fn robots_of(&self, host: HostId) -> &[RobotId] {
        self.hosts.get(usize::from(host.0)).map_or(&[], Vec::as_slice)
    }

    /// Takes what a host says of itself, and logs if it leaves or is back.
    pub(super) fn take(&mut self, status: &Status) {
        let Status { host, leaves, .. } = *status;
        if self.robots_of(host).is_empty() {
            return;
        }
        if leaves && self.left.insert(host) {
            let robots: Vec<String> = self.robots_of(host).iter().map(RobotId::to_string).collect();
            tracing::warn!("host {} has left; the team stands and waits for {}", host.0, robots.join(", "));
        } else if !leaves && self.left.remove(&host) {
            tracing::warn!("host {} is back", host.0);
        }
    }

    /// Returns whether a host has left.
    pub(super) fn any(&self) -> bool {
        !self.left.is_empty()
    }

    /// Returns the number of hosts that have left.
    #[cfg(test)]
    pub(super) fn count(&self) -> usize {
        self.left.len()
    }

    /// Returns whether a host of the robot has left.
    pub(super) fn has(&self, robot: RobotId) -> bool {
        self.left.iter().any(|&host| self.robots_of(host).contains(&robot))
    }
}
