//! Odometry of the robot, from its pushes: positions and headings since power-on, and velocities by differences.

use super::protocol::Push;
use crate::messages::geometry::{Deviation, Pose, Twist, Vec2, wrapped};
use crate::messages::ids::RobotId;
use crate::messages::wire::Reading;
use std::collections::VecDeque;

/// Time over which velocities are taken \[ns\]: five pushes at 50 Hz. The robot pushes no velocity, and arrivals jitter
/// by some milliseconds.
const WINDOW_NS: u64 = 100_000_000;
/// Age up to which a heading belongs to a position \[ns\]: the limit for headings in this project.
const HEADING_NS: u64 = 100_000_000;
/// Values that are kept: as many as arrive within the window, twice.
const KEPT: usize = 12;

/// Newest values of one kind, with their arrival \[ns\].
#[derive(Clone, Debug, Default)]
struct Track<const N: usize>(VecDeque<(u64, [f64; N])>);

impl<const N: usize> Track<N> {
    fn push(&mut self, stamp_ns: u64, value: [f64; N]) {
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        self.0.push_back((stamp_ns, value));
    }

    fn newest(&self) -> Option<(u64, [f64; N])> {
        self.0.back().copied()
    }

    /// Returns the rate of change \[1/s\] over the window, or since the value before if there is none in the window.
    fn rate(&self) -> Option<[f64; N]> {
        let (stamp, value) = self.newest()?;
        let before = self.0.len().checked_sub(2)?;
        let in_window = self.0.iter().position(|(at, _)| stamp - at <= WINDOW_NS).unwrap_or(before);
        let (then, old) = self.0[in_window.min(before)];
        let seconds = (stamp - then) as f64 * 1e-9;
        (seconds > 0.0).then(|| std::array::from_fn(|axis| (value[axis] - old[axis]) / seconds))
    }
}

/// Odometry of one robot over one connection.
#[derive(Clone, Debug)]
pub struct Odometry {
    robot: RobotId,
    /// Position \[m\] in REP-103.
    positions: Track<2>,
    /// Heading \[rad\] in REP-103, continuous over turns.
    headings: Track<1>,
}

impl Odometry {
    /// Makes an odometry that has received nothing yet.
    pub fn new(robot: RobotId) -> Odometry {
        Odometry { robot, positions: Track::default(), headings: Track::default() }
    }

    /// Takes a push that has arrived at `stamp_ns`. Returns a reading in the frame of the robot's pose at power-on.
    /// Returns `None` for the first push and for one without a position.
    pub fn take(&mut self, stamp_ns: u64, push: &Push) -> Option<Reading> {
        let newest =
            self.positions.newest().map_or(0, |(at, _)| at).max(self.headings.newest().map_or(0, |(at, _)| at));
        if stamp_ns < newest {
            return None;
        }
        if let Some([_, _, yaw_deg]) = push.attitude {
            let heading = -yaw_deg.to_radians();
            let heading = match self.headings.newest() {
                Some((_, [before])) => before + wrapped(heading - before),
                None => wrapped(heading),
            };
            self.headings.push(stamp_ns, [heading]);
        }
        let [forward, right] = push.position?;
        self.positions.push(stamp_ns, [forward, -right]);
        let [vx, vy] = self.positions.rate()?;
        let fresh = self.headings.newest().filter(|(at, _)| stamp_ns - at <= HEADING_NS);
        let yaw_rate = fresh.and_then(|_| self.headings.rate()).map(|[rate]| rate as f32);
        Some(Reading {
            robot: self.robot,
            stamp_ns,
            pose: Pose {
                position: Vec2::new(forward as f32, -right as f32),
                heading: fresh.map(|(_, [heading])| wrapped(heading) as f32),
            },
            twist: Twist { velocity: Vec2::new(vx as f32, vy as f32), yaw_rate },
            deviation: Deviation::default(),
        })
    }
}

/// Whether the reading's numbers are in the range of messages.
pub fn is_sound(reading: &Reading) -> bool {
    reading.unfit().is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn push(position: [f64; 2], yaw_deg: f64) -> Push {
        Push { position: Some(position), attitude: Some([0.0, 0.0, yaw_deg]), rolled_over: None }
    }

    #[test]
    fn right_becomes_negative_left_and_clockwise_becomes_negative_yaw() {
        let mut odometry = Odometry::new(RobotId(3));
        assert_eq!(odometry.take(0, &push([1.0, 2.0], 30.0)), None, "no velocity yet");
        let reading = odometry.take(20_000_000, &push([1.01, 2.02], 31.0)).unwrap();
        assert_eq!(reading.pose.position, Vec2::new(1.01, -2.02));
        assert!((reading.pose.heading.unwrap() + 31f32.to_radians()).abs() < 1e-6);
        assert!((reading.twist.velocity - Vec2::new(0.5, -1.0)).norm() < 1e-5, "{:?}", reading.twist);
        assert!((reading.twist.yaw_rate.unwrap() + 50f32.to_radians()).abs() < 1e-4);
    }

    #[test]
    fn the_heading_crosses_half_a_turn_without_a_jump_of_the_yaw_rate() {
        let mut odometry = Odometry::new(RobotId(0));
        odometry.take(0, &push([0.0, 0.0], 179.0));
        let reading = odometry.take(20_000_000, &push([0.0, 0.0], -179.0)).unwrap();
        assert!((reading.twist.yaw_rate.unwrap() + 100f32.to_radians()).abs() < 1e-3, "{:?}", reading.twist);
        assert!((reading.pose.heading.unwrap() - 179f32.to_radians()).abs() < 1e-6);
    }

    #[test]
    fn velocities_are_those_of_the_last_tenth_of_a_second() {
        let mut odometry = Odometry::new(RobotId(0));
        for k in 0..20u64 {
            let x = if k < 10 { 0.02 * k as f64 } else { 0.2 };
            let reading = odometry.take(20_000_000 * k, &push([x, 0.0], 0.0));
            let speed = reading.map_or(0.0, |reading| reading.twist.velocity.x);
            if (1..10).contains(&k) {
                assert!((speed - 1.0).abs() < 1e-5);
            }
            assert!(k < 15 || speed == 0.0, "{k}: {speed}");
        }
    }

    #[test]
    fn an_old_heading_and_a_late_push_are_left_out() {
        let mut odometry = Odometry::new(RobotId(0));
        odometry.take(0, &push([0.0, 0.0], 10.0));
        let only = |x| Push { position: Some([x, 0.0]), ..Push::default() };
        assert!(odometry.take(90_000_000, &only(0.1)).unwrap().pose.heading.is_some());
        assert!(odometry.take(120_000_000, &only(0.1)).unwrap().pose.heading.is_none());
        assert_eq!(odometry.take(110_000_000, &only(0.1)), None);
    }
}
