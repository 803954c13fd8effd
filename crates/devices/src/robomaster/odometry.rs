//! Odometry of the robot from the state datagrams that it sends (pushes): positions and headings since power-on, and
//! velocities computed from differences of positions.

use super::protocol::Push;
use murmurate::messages::geometry::{Deviation, Pose, Twist, Vec2, wrapped};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;
use std::collections::VecDeque;

/// Time span of the positions and headings from whose differences velocities are computed \[ns\]: five pushes at 50 Hz.
/// The robot reports no velocity, and arrival times jitter by some milliseconds.
const WINDOW_NS: u64 = 100_000_000;
/// Largest age of a heading, relative to a position, at which both are combined in one reading \[ns\].
const HEADING_NS: u64 = 100_000_000;
/// Number of newest positions, and of headings, that are kept: twice as many as arrive within the time `WINDOW_NS`.
const KEPT: usize = 12;

/// Newest values of one quantity (position or heading), each with its arrival time \[ns\].
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

    /// Returns the rate of change per second over the last `WINDOW_NS`, or since the previous value if that is older.
    /// `None` with fewer than two values, or if they arrived at the same time.
    fn rate(&self) -> Option<[f64; N]> {
        let (stamp, value) = self.newest()?;
        let before = self.0.len().checked_sub(2)?;
        let in_window = self.0.iter().position(|(at, _)| stamp - at <= WINDOW_NS).unwrap_or(before);
        let (then, old) = self.0[in_window.min(before)];
        let seconds = (stamp - then) as f64 * 1e-9;
        (seconds > 0.0).then(|| std::array::from_fn(|axis| (value[axis] - old[axis]) / seconds))
    }
}

/// Odometry of one RoboMaster over one connection: makes readings from the state datagrams that the robot sends.
#[derive(Clone, Debug)]
pub struct Odometry {
    robot: RobotId,
    /// Positions \[m\] in the frame of the pose at power-on: x forward, y left (REP-103).
    positions: Track<2>,
    /// Headings \[rad\], counter-clockwise (REP-103), continuous beyond half a turn.
    headings: Track<1>,
}

impl Odometry {
    /// Makes the odometry of `robot` for a new connection, on which nothing has been received yet.
    pub fn new(robot: RobotId) -> Odometry {
        Odometry { robot, positions: Track::default(), headings: Track::default() }
    }

    /// Handles a state datagram `push` that has arrived at `stamp_ns` \[ns\] on the worker's clock. Returns a reading
    /// in the frame of the robot's pose at power-on; `None` for the first datagram with a position, since it gives no
    /// velocity, for one without a position, and for one older than the last.
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

/// Whether all numbers of the reading are in the ranges that are permitted in messages between hosts.
pub fn is_sound(reading: &Reading) -> bool {
    reading.unfit().is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn push(position: [f64; 2], yaw_deg: f64) -> Push {
        Push { position: Some(position), attitude: Some([0.0, 0.0, yaw_deg]), ..Push::default() }
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
