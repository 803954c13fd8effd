//! Who is within the range of an emulated link: where its hosts truly are, and a grid to find those that are near.
//!
//! This is what the medium does. What a robot makes of whom it hears is decided by `range`.

use crate::cells::Cells;
use crate::messages::geometry::Vec2;
use crate::messages::ids::HostId;
use crate::messages::local::Truth;

/// The hosts of a link with a range.
#[derive(Debug)]
pub struct Reach {
    range_m: f32,
    /// By robot: the hosts that are where it is.
    carried: Vec<Vec<HostId>>,
    /// By host: where it is \[m\], if it is on a robot that was seen.
    places: Vec<Option<Vec2>>,
    /// Made anew when somebody asks after a robot was seen.
    grid: Option<Cells>,
    /// Hosts without a place: in everybody's reach.
    anywhere: Vec<usize>,
    near: Vec<usize>,
}

impl Reach {
    /// A link that reaches `range_m` \[m\]. A host is where the first of the robots is whose agents it runs; one
    /// without is in everybody's reach, and so is one whose robot nobody has seen yet.
    pub fn new(range_m: f32, robots_of: &[Option<u16>]) -> Reach {
        let hosts = u16::try_from(robots_of.len()).expect("hosts are counted in u16");
        let robots = robots_of.iter().flatten().max().map_or(0, |&last| usize::from(last) + 1);
        let mut carried = vec![Vec::new(); robots];
        for (host, robot) in (0..hosts).map(HostId).zip(robots_of) {
            robot.iter().for_each(|&robot| carried[usize::from(robot)].push(host));
        }
        let places = vec![None; robots_of.len()];
        Reach { range_m, carried, places, grid: None, anywhere: Vec::new(), near: Vec::new() }
    }

    /// The robots of a world are there.
    pub fn locate(&mut self, truth: &Truth) {
        for sample in truth.samples.iter() {
            for host in self.carried.get(sample.robot.index()).into_iter().flatten() {
                self.places[usize::from(host.0)] = Some(sample.motion.position);
            }
        }
        self.grid = None;
    }

    /// Whether a frame of one host gets to another.
    pub fn covers(&self, from: HostId, to: HostId) -> bool {
        let place = |host: HostId| self.places[usize::from(host.0)];
        match (place(from), place(to)) {
            (Some(from), Some(to)) => (from - to).norm_squared() <= self.range_m * self.range_m,
            _ => true,
        }
    }

    /// Puts those of `listeners`, which are in order, into `found` whom a frame of `from` gets to; not itself.
    pub fn listeners(&mut self, from: HostId, listeners: &[u16], found: &mut Vec<HostId>) {
        found.clear();
        let mut candidates = std::mem::take(&mut self.near);
        self.candidates(from, &mut candidates);
        let hosts = candidates.iter().map(|&host| host as u16).filter(|host| listeners.binary_search(host).is_ok());
        found.extend(hosts.map(HostId).filter(|&to| to != from && self.covers(from, to)));
        self.near = candidates;
    }

    fn candidates(&mut self, from: HostId, found: &mut Vec<usize>) {
        let hosts = 0..self.places.len();
        let Some(at) = self.places[usize::from(from.0)] else {
            found.clear();
            return found.extend(hosts);
        };
        let places = &self.places;
        let grid = self.grid.get_or_insert_with(|| {
            self.anywhere = hosts.filter(|&host| places[host].is_none()).collect();
            let nowhere = Vec2::repeat(f32::NAN);
            Cells::new(self.range_m, places.iter().map(|place| place.unwrap_or(nowhere))).expect("a checked range")
        });
        grid.near(at, found);
        found.extend(&self.anywhere);
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
    fn a_frame_gets_to_whoever_is_near_and_to_hosts_without_a_place() {
        // Robot r lives on host r; host 4 carries none.
        let mut reach = Reach::new(4.0, &[Some(0), Some(1), Some(2), Some(3), None]);
        let mut found = Vec::new();
        let mut listeners = |reach: &mut Reach, from: u16, listening: &[u16]| {
            reach.listeners(HostId(from), listening, &mut found);
            found.iter().map(|host| host.0).collect::<Vec<u16>>()
        };
        assert_eq!(listeners(&mut reach, 1, &[0, 1, 2, 3, 4]), [0, 2, 3, 4], "nobody was seen yet");
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
        assert_eq!(listeners(&mut reach, 1, &[0, 1, 2, 3, 4]), [0, 3, 4], "robot 3 was not seen yet");
        assert_eq!(listeners(&mut reach, 1, &[0, 2]), [0]);
        assert_eq!(listeners(&mut reach, 4, &[0, 1, 2, 3, 4]), [0, 1, 2, 3]);
        reach.locate(&see(&[(2, 7.9), (3, 100.0)]));
        assert_eq!(listeners(&mut reach, 1, &[0, 1, 2, 3, 4]), [0, 2, 4]);
        assert!(reach.covers(HostId(0), HostId(1)) && !reach.covers(HostId(0), HostId(2)));
    }
}
