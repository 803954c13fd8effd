//! Conversion of readings, which arrive at irregular times, into steps for the judge of an episode.
//!
//! A reading is a measurement of one robot's position; a robot is seen when a new reading of it arrives. A step ends
//! once every robot has been seen in it, or before a robot would be seen in it a second time. The judge then processes
//! all robots of the step at once, at the time of the last arrival. So no robot is in one step twice. Where readings
//! are lost, the robots that were seen are still judged with each other.
//!
//! A verdict that is found in this way is only as accurate as the readings. The robots of one step were measured at
//! times up to one period of the fastest source apart, by clocks that are not synchronized. Their readings are late by
//! the delay of their links. A robot at speed v, measured at rate r, moves by v / r between two readings: 5 cm at 1 m/s
//! and 20 Hz. By so much two robots can come nearer to each other, or to a wall, without being seen there. A makespan
//! is too long by up to 1 / r and the delay of the link. Noise makes the smallest distance of a pair smaller than it
//! was. With a standard deviation s along each axis, the distance in one step is off by about sqrt(2) s, and the
//! smallest distance of many steps by several times that.

use std::cmp::Ordering;

use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::messages::wire::Reading;
use crate::time::{Span, Time};

/// Longest time (1 s) for which readings of a robot may be missing in an episode judged from readings; after a longer
/// time the episode fails as unseen. A robot that does not receive its own readings is stopped much earlier by its
/// guard. Random loss alone hardly ever removes all 20 readings of a second.
pub const SIGHT: Span = Span::from_millis(1000);

/// Largest distance \[m\] from its start at which a robot that the simulated world has put at its start counts as seen
/// there. A reading from farther away is one from before.
const PLACED_M: f32 = 0.25;

/// One step for the judge of an episode: the robots of which a reading arrived in it, with their measured positions.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sighting {
    /// Time at which the last reading of the step arrived.
    pub(crate) at: Time,
    /// Measured positions of the robots that were seen in the step, in the order of their ids.
    pub(crate) robots: Vec<(RobotId, Spot)>,
    /// True if some robot of the team has been without a reading for longer than `SIGHT` in this episode.
    pub(crate) lapsed: bool,
}

/// Measured position and velocity of one robot in one step, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Spot {
    /// Position of the centre of the robot's hull \[m\].
    pub(crate) centre: Vec2,
    /// Position \[m\] of the point that the robot's policy commands, as the reading states it. The point is the centre,
    /// unless the drive is differential.
    pub(crate) point: Vec2,
    /// Measured velocity of the point \[m/s\].
    pub(crate) velocity: Vec2,
}

/// State of one robot in [`Sightings`]: its newest reading, when it was last seen, and its position in the unfinished
/// step.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    /// Arrival time, stamp \[ns\] and measured position \[m\] of the robot's newest reading; `None` before the first.
    newest: Option<(Time, u64, Vec2)>,
    /// Time at which the robot was last seen in this episode; at first, the start of the episode.
    since: Time,
    /// Start at which the simulated world has put the robot for this episode \[m\], world frame; `None` once it has
    /// been seen there, or if it drove to its start.
    start: Option<Vec2>,
    /// Position of the robot in the unfinished step; `None` if it was not seen in it.
    here: Option<Spot>,
}

/// Collector of the readings of a team, in the order of their arrival, which groups them into steps for the judge.
#[derive(Clone, Debug)]
pub(crate) struct Sightings {
    /// State of each robot, by robot id.
    team: Vec<Known>,
    /// Number of robots that were seen in the unfinished step.
    here: usize,
    /// Arrival time of the last reading in the unfinished step.
    at: Time,
    /// Whether a robot has been without a reading for longer than `SIGHT` in this episode.
    lapsed: bool,
}

impl Sightings {
    /// Makes a collector for a team of `robots` robots that has received no reading yet.
    pub(crate) fn new(robots: usize) -> Sightings {
        Sightings { team: vec![Known::default(); robots], here: 0, at: Time::ZERO, lapsed: false }
    }

    /// Begins an episode at time `now`: readings that arrived before it do not count. `placed` has the start of each
    /// robot \[m\], world frame, by robot id, if the simulated world has put the robots there. A robot then counts as
    /// seen only from its first reading near its start, because older readings may still be under way. `None` means
    /// that the robots drove to their starts.
    pub(crate) fn begin(&mut self, now: Time, placed: Option<&[Vec2]>) {
        (self.here, self.lapsed) = (0, false);
        for (at, known) in self.team.iter_mut().enumerate() {
            (known.since, known.here, known.start) = (now, None, placed.map(|starts| starts[at]));
        }
    }

    /// Returns true if, by the time `now`, some robot has been without a reading for longer than `SIGHT` in this
    /// episode.
    pub(crate) fn lapsed(&self, now: Time) -> bool {
        self.lapsed || self.team.iter().any(|known| now.since(known.since) > SIGHT)
    }

    /// Processes a `reading` that has arrived at time `now` from a robot whose centre is at `centre` \[m\], world
    /// frame. Returns the step that ends with this arrival; `None` if no step ends, or if the reading is old or
    /// repeated.
    pub(crate) fn see(&mut self, now: Time, reading: &Reading, centre: Vec2) -> Option<Sighting> {
        let (at, position, velocity) = (reading.robot.index(), reading.pose.position, reading.twist.velocity);
        let known = &mut self.team[at];
        if !known.is_news(now, reading) {
            return None;
        }
        let again = known.newest.is_some_and(|(_, stamp_ns, _)| stamp_ns == reading.stamp_ns);
        known.newest = Some((now, reading.stamp_ns, position));
        if known.start.is_some_and(|start| (start - centre).norm() > PLACED_M) {
            return None;
        }
        known.start = None;
        // A robot that is put somewhere is measured twice at one instant, and is at the second place.
        let over = if known.here.is_some() && !again { self.close() } else { None };
        let known = &mut self.team[at];
        self.lapsed |= now.since(known.since) > SIGHT;
        (known.since, self.at) = (now, now);
        self.here += usize::from(known.here.replace(Spot { centre, point: position, velocity }).is_none());
        // A robot that is seen again begins a new step alone. In a team of one, every step is complete at once.
        over.or_else(|| if self.here == self.team.len() { self.close() } else { None })
    }

    /// Ends the unfinished step and returns it with the robots that were seen in it.
    fn close(&mut self) -> Option<Sighting> {
        let lapsed = self.lapsed(self.at);
        self.here = 0;
        let ids = RobotId::team(self.team.len());
        let here = ids.zip(&mut self.team).filter_map(|(robot, known)| Some((robot, known.here.take()?)));
        Some(Sighting { at: self.at, robots: here.collect(), lapsed })
    }
}

impl Known {
    /// Whether a reading is newer than the robot's newest one, or is from the same time but another position. An older
    /// stamp counts as newer if the newest reading arrived more than `SIGHT` ago: the source's clock was set back.
    fn is_news(&self, now: Time, reading: &Reading) -> bool {
        let Some((arrived, stamp_ns, position)) = self.newest else { return true };
        match reading.stamp_ns.cmp(&stamp_ns) {
            Ordering::Greater => true,
            // A repeated measurement has no new information about the robot's position.
            Ordering::Equal => reading.pose.position != position,
            Ordering::Less => now.since(arrived) > SIGHT,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// A reading arrives that was measured at a place; both times in ms.
    fn see(sightings: &mut Sightings, arrives: u64, robot: u16, measured: u64, x: f32) -> Option<Sighting> {
        let reading = Reading::of_point(RobotId(robot), measured * 1_000_000, Motion::at_rest(Vec2::new(x, 0.0)));
        sightings.see(at_ms(arrives), &reading, reading.pose.position)
    }

    fn step(ms: u64, robots: &[(u16, f32)]) -> Option<Sighting> {
        let spot = |x: f32| Spot { centre: Vec2::new(x, 0.0), point: Vec2::new(x, 0.0), velocity: Vec2::zeros() };
        let robots = robots.iter().map(|&(robot, x)| (RobotId(robot), spot(x))).collect();
        Some(Sighting { at: at_ms(ms), robots, lapsed: false })
    }

    #[test]
    fn a_step_has_everyone_once_or_those_that_were_seen() {
        let mut team = Sightings::new(3);
        team.begin(at_ms(0), None);
        assert_eq!(see(&mut team, 50, 2, 7050, 2.0), None, "clocks of two sources are compared with no other");
        assert_eq!(see(&mut team, 52, 0, 50, 0.0), None);
        assert_eq!(see(&mut team, 55, 1, 50, 1.0), step(55, &[(0, 0.0), (1, 1.0), (2, 2.0)]));
        assert_eq!(see(&mut team, 100, 2, 7100, 2.1), None);
        assert_eq!(see(&mut team, 102, 0, 100, 0.1), None);
        // Robot 1 is not heard of: the others are judged with each other, when the next step begins.
        assert_eq!(see(&mut team, 150, 2, 7150, 2.2), step(102, &[(0, 0.1), (2, 2.1)]));
    }

    #[test]
    fn time_does_not_go_back_and_a_repeated_reading_shows_nothing() {
        let mut team = Sightings::new(2);
        team.begin(at_ms(0), None);
        see(&mut team, 50, 0, 50, 0.0);
        see(&mut team, 50, 1, 50, 1.0);
        see(&mut team, 150, 0, 150, 0.2);
        assert_eq!(see(&mut team, 151, 0, 100, 0.1), None, "it is late");
        assert_eq!(see(&mut team, 160, 0, 150, 0.2), None, "it is known");
        assert_eq!(see(&mut team, 161, 0, 150, 0.5), None, "the robot was put elsewhere, in the same step");
        assert_eq!(see(&mut team, 162, 1, 150, 1.0), step(162, &[(0, 0.5), (1, 1.0)]));
    }

    #[test]
    fn who_is_out_of_sight_for_long_is_missed_even_if_it_comes_back() {
        let mut team = Sightings::new(2);
        team.begin(at_ms(0), None);
        for ms in (50..=1050).step_by(50) {
            see(&mut team, ms, 0, ms, 0.0);
        }
        assert!(team.lapsed(at_ms(1001)) && !team.lapsed(at_ms(1000)));
        see(&mut team, 1100, 1, 1100, 1.0);
        assert!(team.lapsed(at_ms(1100)), "nobody knows what it did");
        team.begin(at_ms(1200), None);
        assert!(!team.lapsed(at_ms(1200)), "another episode");
        // Its source has begun anew, and so has its clock.
        assert_eq!(see(&mut team, 1250, 1, 10, 1.0), None);
        see(&mut team, 2300, 1, 60, 1.1);
        see(&mut team, 2350, 1, 110, 1.2);
        assert_eq!(see(&mut team, 2350, 0, 2350, 0.0).map(|seen| seen.robots.len()), Some(2));
    }

    #[test]
    fn robots_that_are_placed_are_seen_once_they_are_seen_there() {
        let mut team = Sightings::new(1);
        team.begin(at_ms(100), Some(&[Vec2::new(3.0, 0.0)]));
        assert_eq!(see(&mut team, 110, 0, 95, -3.0), None, "it was measured before");
        assert_eq!(see(&mut team, 160, 0, 150, 3.05), step(160, &[(0, 3.05)]));
        assert_eq!(see(&mut team, 210, 0, 200, 2.0), step(210, &[(0, 2.0)]), "a team of one is seen in each");
    }
}
