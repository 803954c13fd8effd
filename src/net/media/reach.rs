//! Range of an emulated link: the true positions of its hosts, in a uniform grid for radius queries.
//!
//! The range is a property of the link. The communication range of a policy is another one: `hearing::CommRange`.

use crate::cells::Cells;
use crate::messages::geometry::Vec2;
use crate::messages::ids::HostId;
use crate::messages::local::Truth;

/// Hosts of an emulated link with a limited transmission range, and their true positions.
#[derive(Debug)]
pub struct Reach {
    range_m: f32,
    /// Hosts that are at the position of each robot, by number of the robot; an entry is empty if no host is there.
    hosts_of_robot: Vec<Vec<HostId>>,
    /// Position of each host \[m\], world frame, by number of the host. `None` before the host's robot was first
    /// located, and for a host that is on no robot.
    positions: Vec<Option<Vec2>>,
    /// Uniform grid over the positions of the hosts, for radius queries. `None` after a robot has moved, until the next
    /// query rebuilds it.
    grid: Option<Cells>,
    /// Numbers of the hosts without a known position, which are within range of all others; updated with the grid.
    unlocated: Vec<usize>,
    near: Vec<usize>,
}

impl Reach {
    /// Returns the hosts of a link with the range `range_m` \[m\]. `robots_of` has one entry per host: the first robot
    /// whose agent the host runs, or `None` for a host without robots. A host is at the position of that robot. A host
    /// without robots is within range of all, and so is one whose robot was not located yet.
    pub fn new(range_m: f32, robots_of: &[Option<u16>]) -> Reach {
        let hosts = u16::try_from(robots_of.len()).expect("hosts are counted in u16");
        let robots = robots_of.iter().flatten().max().map_or(0, |&last| usize::from(last) + 1);
        let mut hosts_of_robot = vec![Vec::new(); robots];
        for (host, robot) in (0..hosts).map(HostId).zip(robots_of) {
            robot.iter().for_each(|&robot| hosts_of_robot[usize::from(robot)].push(host));
        }
        let positions = vec![None; robots_of.len()];
        Reach { range_m, hosts_of_robot, positions, grid: None, unlocated: Vec::new(), near: Vec::new() }
    }

    /// Updates the hosts' positions from the true positions of their robots, which a simulated world sends after each
    /// step.
    pub fn locate(&mut self, truth: &Truth) {
        for sample in truth.samples.iter() {
            for host in self.hosts_of_robot.get(sample.robot.index()).into_iter().flatten() {
                self.positions[usize::from(host.0)] = Some(sample.motion.position);
            }
        }
        self.grid = None;
    }

    /// Returns true if the hosts `from` and `to` are within range of each other, or if one of them has no position.
    pub fn covers(&self, from: HostId, to: HostId) -> bool {
        let position = |host: HostId| self.positions[usize::from(host.0)];
        match (position(from), position(to)) {
            (Some(from), Some(to)) => (from - to).norm_squared() <= self.range_m * self.range_m,
            _ => true,
        }
    }

    /// Replaces the content of `found` by the hosts among `listeners` that are within range of the host `from`, without
    /// `from` itself. `listeners` must be sorted.
    pub fn listeners(&mut self, from: HostId, listeners: &[u16], found: &mut Vec<HostId>) {
        found.clear();
        let mut candidates = std::mem::take(&mut self.near);
        self.candidates(from, &mut candidates);
        let hosts = candidates.iter().map(|&host| host as u16).filter(|host| listeners.binary_search(host).is_ok());
        found.extend(hosts.map(HostId).filter(|&to| to != from && self.covers(from, to)));
        self.near = candidates;
    }

    fn candidates(&mut self, from: HostId, found: &mut Vec<usize>) {
        let hosts = 0..self.positions.len();
        let Some(at) = self.positions[usize::from(from.0)] else {
            found.clear();
            return found.extend(hosts);
        };
        let positions = &self.positions;
        let grid = self.grid.get_or_insert_with(|| {
            self.unlocated = hosts.filter(|&host| positions[host].is_none()).collect();
            let nowhere = Vec2::repeat(f32::NAN);
            Cells::new(self.range_m, positions.iter().map(|position| position.unwrap_or(nowhere)))
                .expect("a checked range")
        });
        grid.near(at, found);
        found.extend(&self.unlocated);
        found.sort_unstable();
        found.dedup();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::messages::ids::RobotId;
    use crate::messages::local::{Contacts, Sample};
    use crate::time::Time;

    #[test]
    fn a_frame_reaches_hosts_within_range_and_hosts_without_a_position() {
        // Robot r carries host r; host 4 is on no robot.
        let mut reach = Reach::new(4.0, &[Some(0), Some(1), Some(2), Some(3), None]);
        let mut found = Vec::new();
        let mut listeners = |reach: &mut Reach, from: u16, listening: &[u16]| {
            reach.listeners(HostId(from), listening, &mut found);
            found.iter().map(|host| host.0).collect::<Vec<u16>>()
        };
        assert_eq!(listeners(&mut reach, 1, &[0, 1, 2, 3, 4]), [0, 2, 3, 4], "no robot was located yet");
        let see = |robots: &[(u16, f32)]| Truth {
            time: Time::ZERO,
            samples: robots
                .iter()
                .map(|&(robot, x)| Sample {
                    robot: RobotId(robot),
                    time: Time::ZERO,
                    motion: Motion::at_rest(Vec2::new(x, 0.0)),
                    heading: 0.0,
                    yaw_rate: 0.0,
                    command: Vec2::zeros(),
                    contacts: Contacts::default(),
                })
                .collect(),
        };
        reach.locate(&see(&[(0, 0.0), (1, 4.0), (2, 8.01)]));
        assert_eq!(listeners(&mut reach, 1, &[0, 1, 2, 3, 4]), [0, 3, 4], "robot 3 was not located yet");
        assert_eq!(listeners(&mut reach, 1, &[0, 2]), [0]);
        assert_eq!(listeners(&mut reach, 4, &[0, 1, 2, 3, 4]), [0, 1, 2, 3]);
        reach.locate(&see(&[(2, 7.9), (3, 100.0)]));
        assert_eq!(listeners(&mut reach, 1, &[0, 1, 2, 3, 4]), [0, 2, 4]);
        assert!(reach.covers(HostId(0), HostId(1)) && !reach.covers(HostId(0), HostId(2)));
    }
}
