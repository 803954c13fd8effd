//! Newest scans of the robots' senses, as the page draws them. Pure.

use std::collections::BTreeMap;

use murmurate::messages::geometry::Vec2;
use murmurate::messages::wire::Sensed;
use murmurate::senses::Layout;
use murmurate::time::{Span, Time};
use serde::Serialize;

/// Age from which a scan is no longer drawn.
const AGE: Span = Span::from_millis(1000);
/// Largest number of rays in a snapshot: 40 kB. Robots with larger numbers are left out.
const MAX_RAYS: usize = 20_000;

/// Directions of the rays of a sense, which the page needs to draw scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ScanForm {
    /// Index of the sense among those of the robots.
    pub sense: u8,
    /// Angles of the first and the last ray \[rad\], counter-clockwise from the direction ahead of the robot.
    pub rays_rad: [f64; 2],
    /// Place from which the rays go \[m\]: ahead of the robot's centre and to the left.
    pub mount_m: [f32; 2],
}

impl ScanForm {
    /// Returns the directions of the rays of a sense with this index and layout; `None` if its values are no distances
    /// along rays.
    pub fn of(sense: usize, layout: &Layout) -> Option<ScanForm> {
        let (sense, sweep) = (u8::try_from(sense).ok()?, layout.sweep?);
        let last = sweep.from_rad + sweep.step_rad * layout.floats().saturating_sub(1) as f64;
        Some(ScanForm { sense, rays_rad: [sweep.from_rad, last], mount_m: sweep.mount_m })
    }
}

/// Scan of a robot with the pose that the robot had when it arrived.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanState {
    /// Number of the robot.
    pub robot: u16,
    /// Index of the sense among those of the robot.
    pub sense: u8,
    /// Position of the robot \[m\], world frame: of its centre in a simulation, and of its commanded point in a live
    /// team, which is what robots report.
    pub position: Vec2,
    /// Heading of the robot \[rad\], counter-clockwise from the x axis of the world frame.
    pub heading: f32,
    /// Distances along the rays \[m\]; positive infinity for no echo.
    pub ranges_m: Box<[f32]>,
}

/// Newest scan of each sense of each robot, with its arrival.
#[derive(Clone, Debug, Default)]
pub(super) struct Scans {
    newest: BTreeMap<(u16, u8), (Time, ScanState)>,
}

impl Scans {
    /// Takes the values of a robot's sense, which have arrived at `now` while the robot was at `position` \[m\] with
    /// this heading \[rad\].
    pub fn take(&mut self, now: Time, sensed: &Sensed, (position, heading): (Vec2, f32)) {
        let (robot, sense) = (sensed.robot.0, sensed.sense);
        let scan = ScanState { robot, sense, position, heading, ranges_m: sensed.values.0.iter().copied().collect() };
        self.newest.insert((robot, sense), (now, scan));
    }

    /// Returns the scans that are drawn at the time `now`, in the order of robots and senses.
    pub fn drawn(&self, now: Time) -> Vec<ScanState> {
        let mut left = MAX_RAYS;
        let fresh = self.newest.values().filter(|(at, _)| now.since(*at) <= AGE).map(|(_, scan)| scan);
        let fits = |scan: &&ScanState| {
            let fits = scan.ranges_m.len() <= left;
            left = if fits { left - scan.ranges_m.len() } else { 0 };
            fits
        };
        fresh.take_while(fits).cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use murmurate::messages::ids::RobotId;
    use murmurate::messages::wire::Features;

    use super::*;

    #[test]
    fn the_newest_scan_of_each_sense_is_drawn_while_it_is_fresh_and_there_is_room() {
        let mut scans = Scans::default();
        let mut take = |robot, sense, at: u64, rays| {
            let values = Features(vec![1.5; rays].into());
            let of = u16::try_from(rays).expect("few");
            let sensed = Sensed { robot: RobotId(robot), sense, stamp_ns: 0, first: 0, of, values };
            scans.take(Time::ZERO + Span::from_millis(at), &sensed, (Vec2::new(f32::from(robot), 0.0), 0.5));
        };
        take(1, 0, 0, 2);
        take(0, 1, 500, 3);
        take(0, 1, 600, 4);
        take(2, 0, 700, MAX_RAYS);
        let drawn = |ms| {
            let all = scans.drawn(Time::ZERO + Span::from_millis(ms));
            all.iter().map(|scan| (scan.robot, scan.sense, scan.ranges_m.len())).collect::<Vec<_>>()
        };
        assert_eq!(drawn(1000), [(0, 1, 4), (1, 0, 2)], "there is no room for the third");
        assert_eq!(drawn(1601), [(2, 0, MAX_RAYS)]);
        assert_eq!(drawn(1701), []);
    }
}
