//! Hosts of a team that have announced their shutdown and are not back yet, or that its roster does not name, as a
//! state server knows them.

use std::collections::BTreeSet;

use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::Status;
use crate::results::episode::AbortCause;

/// Hosts and operators of the roster in force.
pub(crate) type Members = BTreeSet<HostId>;

/// Hosts that have left the team or were revoked; those without robots do not count.
#[derive(Debug)]
pub(super) struct Absent {
    /// For each host, by its id: its robots.
    hosts: Vec<Vec<RobotId>>,
    left: BTreeSet<HostId>,
    /// Hosts that the team's roster does not name: nothing is heard of them, and what their robots do is unknown.
    revoked: BTreeSet<HostId>,
}

impl Absent {
    /// Returns the state before any host has left. `hosts` has the robots of each host, by its id.
    pub(super) fn new(hosts: Vec<Vec<RobotId>>) -> Absent {
        Absent { hosts, left: BTreeSet::new(), revoked: BTreeSet::new() }
    }

    fn robots_of(&self, host: HostId) -> &[RobotId] {
        self.hosts.get(usize::from(host.0)).map_or(&[], Vec::as_slice)
    }

    fn names_of(&self, host: HostId) -> String {
        self.robots_of(host).iter().map(RobotId::to_string).collect::<Vec<String>>().join(", ")
    }

    /// Takes what a host says of itself, and logs if it leaves or is back.
    pub(super) fn take(&mut self, status: &Status) {
        let Status { host, leaves, .. } = *status;
        if self.robots_of(host).is_empty() {
            return;
        }
        if leaves && self.left.insert(host) {
            tracing::warn!("host {} has left; the team stands and waits for {}", host.0, self.names_of(host));
        } else if !leaves && self.left.remove(&host) {
            tracing::warn!("host {} is back", host.0);
        }
    }

    /// Takes the members of the roster in force, and logs which hosts it no longer names, or names again.
    pub(super) fn take_members(&mut self, members: &Members) {
        let all = (0..=u16::MAX).map(HostId).take(self.hosts.len());
        let revoked: BTreeSet<HostId> =
            all.filter(|host| !members.contains(host) && !self.robots_of(*host).is_empty()).collect();
        for host in revoked.difference(&self.revoked) {
            tracing::error!(
                "host {} was revoked; the team stands. {} may move uncontrolled: switch it off; the team goes on when \
                 it has a new key",
                host.0,
                self.names_of(*host)
            );
        }
        for host in self.revoked.difference(&revoked) {
            tracing::warn!("host {} is in the roster again", host.0);
        }
        self.revoked = revoked;
    }

    /// Returns whether a host has left.
    pub(super) fn any(&self) -> bool {
        !self.left.is_empty()
    }

    /// Returns the robots of revoked hosts as causes of the end of an episode.
    pub(super) fn causes(&self) -> Vec<(RobotId, AbortCause)> {
        let robots: BTreeSet<RobotId> = self.revoked.iter().flat_map(|host| self.robots_of(*host)).copied().collect();
        robots.into_iter().map(|robot| (robot, AbortCause::Revoked)).collect()
    }

    /// Returns the number of hosts that have left.
    #[cfg(test)]
    pub(super) fn count(&self) -> usize {
        self.left.len()
    }

    /// Returns whether a host of the robot has left or was revoked.
    pub(super) fn has(&self, robot: RobotId) -> bool {
        self.left.iter().chain(&self.revoked).any(|&host| self.robots_of(host).contains(&robot))
    }
}
