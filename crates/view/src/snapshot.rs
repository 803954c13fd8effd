//! Snapshot of a team at one time, and its binary encoding for the page.
//!
//! All numbers are little-endian. The header has 16 bytes: version (1 byte), a zero byte, number of robots (2), time of
//! the run \[ms\] (4), number of links (2), number of omitted links (2), number of scans (2), number of moving
//! obstacles (2).
//!
//! Then follow 9 bytes for each robot: x (2) and y (2) in units of the scene's `scale_m`, heading (2) in 1e-4 rad,
//! phase (1), age (1) in 20 ms, flags (1). Then 6 bytes for each link: the two robots (2, 2), age (1) in 10 ms, loss
//! (1) in %. Then 4 bytes for each moving obstacle: x (2) and y (2) of the point that follows its path. Then each scan:
//! robot (2), index of the sense (1), a zero byte, x (2), y (2) and heading (2) of the robot when the scan arrived, as
//! above, number of rays (2), and the distance along each ray (2) in mm, 65535 for no echo.

use super::scans::ScanState;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::wire::Phase;
use murmurate::time::{Span, Time};

/// Version of the binary encoding of a team's snapshots (states of robots and links) for the live page.
pub const VERSION: u8 = 1;
/// Length of the header of an encoded snapshot of a team \[bytes\].
pub const HEADER_BYTES: usize = 16;
/// Length of one robot's entry in an encoded snapshot of a team \[bytes\].
pub const ROBOT_BYTES: usize = 9;
/// Length of one link's entry in an encoded snapshot of a team \[bytes\].
pub const LINK_BYTES: usize = 6;
/// Length of one moving obstacle's entry in an encoded snapshot of a team \[bytes\].
const MOVER_BYTES: usize = 4;
/// Largest number of links in an encoded snapshot of a team: 36 kB, or 360 kB/s at ten snapshots a second.
pub const MAX_LINKS: usize = 6000;

/// Length of a scan in an encoded snapshot of a team without its distances, and that of a distance \[bytes\].
pub const SCAN_BYTES: [usize; 2] = [12, 2];
/// Code of a ray without an echo, and of one that is longer than can be encoded.
const NO_ECHO: u16 = u16::MAX;

/// Largest encoded coordinate: number of steps from the origin to the edge of the scene.
const STEPS: f32 = 32_000.0;
/// Code of an unknown position or heading.
const NO_NUMBER: i16 = i16::MIN;
/// Code of an unknown age, phase or loss.
const NO_BYTE: u8 = 255;
/// Largest encoded age, in units of `ROBOT_AGE` or the unit of a link's age. A larger age is encoded as this one.
const OLDEST: u64 = 250;
/// Unit of a robot's encoded age.
const ROBOT_AGE: Span = Span::from_millis(20);
/// Unit of a link's encoded age.
const LINK_AGE: Span = Span::from_millis(10);

/// State of one robot in a snapshot of the team. A field is `None` if it is unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotState {
    /// Position of the robot's centre \[m\], world frame.
    pub position: Option<Vec2>,
    /// Heading \[rad\], counter-clockwise from the x axis of the world frame.
    pub heading: Option<f32>,
    /// Phase of the episode in which the robot is.
    pub phase: Option<Phase>,
    /// Time since this process last received a message about the robot.
    pub age: Option<Span>,
    /// Whether the robot touches another robot or a wall; always false for a real robot.
    pub touches: bool,
    /// Whether the robot stands because of an emergency stop or a hold.
    pub latched: bool,
}

/// Link between two robots within communication range, in a snapshot of the team.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkState {
    /// Id of the first robot.
    pub one: u16,
    /// Id of the second robot, larger than the first.
    pub other: u16,
    /// Time since a message last arrived from one of the two robots at the other's host, in the direction in which it
    /// is longer; `None` until a message has arrived in both directions.
    pub age: Option<Span>,
    /// Share of recent messages between the two robots that were lost \[%\], in the worse direction; `None` before the
    /// first arrival.
    pub loss: Option<u8>,
}

/// State of a team at one time, as the page shows it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Time since the start of the run.
    pub now: Time,
    /// States of the robots, in the order of robot ids.
    pub robots: Vec<RobotState>,
    /// Links between robots within communication range, at most `MAX_LINKS` (6000).
    pub links: Vec<LinkState>,
    /// Number of links that are left out because there are more than `MAX_LINKS` (6000).
    pub left_out: usize,
    /// Newest scans of the robots' senses.
    pub scans: Vec<ScanState>,
    /// For each moving obstacle where the point is that follows its path \[m\], world frame; empty between episodes.
    pub movers: Vec<Vec2>,
}

/// Returns the unit of encoded coordinates \[m\] with which positions up to `reach_m` \[m\] from the origin can be
/// encoded.
pub fn scale_m(reach_m: f32) -> f32 {
    reach_m / STEPS
}

impl Snapshot {
    /// Encodes the snapshot in the binary form for the live page. `scale_m` is the unit of encoded coordinates \[m\].
    pub fn encode(&self, scale_m: f32) -> Vec<u8> {
        let small = |number: usize| u16::try_from(number).unwrap_or(u16::MAX).to_le_bytes();
        let [scan, ray] = SCAN_BYTES;
        let scans: usize = self.scans.iter().map(|one| scan + ray * one.ranges_m.len()).sum();
        let robots = ROBOT_BYTES * self.robots.len();
        let others = LINK_BYTES * self.links.len() + MOVER_BYTES * self.movers.len();
        let mut bytes = Vec::with_capacity(HEADER_BYTES + robots + others + scans);
        bytes.extend([VERSION, 0]);
        bytes.extend(small(self.robots.len()));
        let ms = self.now.since(Time::ZERO).as_nanos() / 1_000_000;
        bytes.extend(u32::try_from(ms).unwrap_or(u32::MAX).to_le_bytes());
        bytes.extend(small(self.links.len()));
        bytes.extend(small(self.left_out));
        bytes.extend(small(self.scans.len()));
        bytes.extend(small(self.movers.len()));
        for robot in &self.robots {
            let place = |number: Option<f32>| number.map_or(NO_NUMBER, |number| step(number / scale_m));
            bytes.extend(place(robot.position.map(|at| at.x)).to_le_bytes());
            bytes.extend(place(robot.position.map(|at| at.y)).to_le_bytes());
            bytes.extend(robot.heading.map_or(NO_NUMBER, |heading| step(heading * 1e4)).to_le_bytes());
            bytes.push(robot.phase.map_or(NO_BYTE, u8::from));
            bytes.push(aged(robot.age, ROBOT_AGE));
            bytes.push(u8::from(robot.touches) | u8::from(robot.latched) << 1);
        }
        for link in &self.links {
            bytes.extend(link.one.to_le_bytes());
            bytes.extend(link.other.to_le_bytes());
            bytes.push(aged(link.age, LINK_AGE));
            bytes.push(link.loss.map_or(NO_BYTE, |loss| loss.min(100)));
        }
        for coordinate in self.movers.iter().flat_map(|at| [at.x, at.y]) {
            bytes.extend(step(coordinate / scale_m).to_le_bytes());
        }
        for scan in &self.scans {
            bytes.extend(scan.robot.to_le_bytes());
            bytes.extend([scan.sense, 0]);
            let numbers = [scan.position.x / scale_m, scan.position.y / scale_m, scan.heading * 1e4];
            numbers.into_iter().for_each(|number| bytes.extend(step(number).to_le_bytes()));
            bytes.extend(small(scan.ranges_m.len()));
            // An infinite one is the largest number.
            let mm = |range: &f32| (range * 1000.0).round().clamp(0.0, NO_ECHO.into()) as u16;
            scan.ranges_m.iter().for_each(|range| bytes.extend(mm(range).to_le_bytes()));
        }
        bytes
    }
}

/// Rounds a coordinate in encoded units to an integer, limited to the encoded range.
/// Robot of an encoded snapshot of the team: what programs other than the page draw of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drawn {
    /// Position of the robot's centre \[m\], world frame.
    pub position: Option<[f32; 2]>,
    /// Heading \[rad\], counter-clockwise from the x axis of the world frame.
    pub heading: Option<f32>,
    /// Whether the robot stands because of an emergency stop or a hold.
    pub latched: bool,
}

/// Returns the robots of an encoded snapshot, in the order of robot ids. `scale_m` is the unit of encoded coordinates
/// \[m\].
pub fn robots(bytes: &[u8], scale_m: f32) -> impl Iterator<Item = Drawn> {
    let count = bytes.get(2..4).map_or(0, |count| usize::from(u16::from_le_bytes([count[0], count[1]])));
    let all = bytes.get(HEADER_BYTES..).unwrap_or_default().chunks_exact(ROBOT_BYTES).take(count);
    all.map(move |robot| {
        let number = |at: usize| Some(i16::from_le_bytes([robot[at], robot[at + 1]])).filter(|code| *code != NO_NUMBER);
        let place = |at| number(at).map(|steps| f32::from(steps) * scale_m);
        Drawn {
            position: place(0).zip(place(2)).map(|(x, y)| [x, y]),
            heading: number(4).map(|code| f32::from(code) * 1e-4),
            latched: robot[8] & 2 != 0,
        }
    })
}

/// Returns where the points are that follow the paths of moving obstacles \[m\], world frame, in an encoded snapshot.
/// `scale_m` is the unit of encoded coordinates \[m\].
pub fn movers(bytes: &[u8], scale_m: f32) -> impl Iterator<Item = [f32; 2]> {
    let count = |at: usize| bytes.get(at..at + 2).map_or(0, |of| usize::from(u16::from_le_bytes([of[0], of[1]])));
    let begin = HEADER_BYTES + ROBOT_BYTES * count(2) + LINK_BYTES * count(8);
    let all = bytes.get(begin..).unwrap_or_default().chunks_exact(MOVER_BYTES).take(count(14));
    let place = move |code: [u8; 2]| f32::from(i16::from_le_bytes(code)) * scale_m;
    all.map(move |of| [place([of[0], of[1]]), place([of[2], of[3]])])
}

fn step(number: f32) -> i16 {
    number.round().clamp(-STEPS, STEPS) as i16
}

fn aged(age: Option<Span>, unit: Span) -> u8 {
    age.map_or(NO_BYTE, |age| (age.as_nanos() / unit.as_nanos()).min(OLDEST) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_snapshot_is_encoded_as_its_description_says() {
        let robot = RobotState {
            position: Some(Vec2::new(1.0, -2.0)),
            heading: Some(-0.5),
            phase: Some(Phase::Running),
            age: Some(Span::from_millis(45)),
            touches: false,
            latched: true,
        };
        let link = LinkState { one: 0, other: 1, age: Some(Span::from_millis(120)), loss: Some(7) };
        let now = Time::ZERO + Span::from_millis(1234);
        let scan = ScanState {
            robot: 1,
            sense: 2,
            position: Vec2::new(1.0, -2.0),
            heading: -0.5,
            ranges_m: [1.2345, f32::INFINITY, 70.0].into(),
        };
        let (robots, movers) = (vec![robot, RobotState::default()], vec![Vec2::new(-1.5, 0.5)]);
        let snapshot = Snapshot { now, robots, links: vec![link], left_out: 3, scans: vec![scan], movers };
        let bytes = snapshot.encode(scale_m(32.0));
        assert_eq!(bytes.len(), 16 + 2 * 9 + 6 + 4 + 12 + 3 * 2);
        assert_eq!(bytes[..16], [1, 0, 2, 0, 0xd2, 4, 0, 0, 1, 0, 3, 0, 1, 0, 1, 0]);
        let number = |at: usize| i16::from_le_bytes([bytes[at], bytes[at + 1]]);
        assert_eq!([number(16), number(18), number(20)], [1000, -2000, -5000]);
        assert_eq!(bytes[22..25], [3, 2, 2]);
        assert_eq!([number(25), number(27), number(29)], [i16::MIN; 3], "nothing is made up");
        assert_eq!(bytes[31..34], [255, 255, 0]);
        assert_eq!(bytes[34..40], [0, 0, 1, 0, 12, 7]);
        assert_eq!([number(40), number(42)], [-1500, 500]);
        let read: Vec<[i32; 2]> =
            super::movers(&bytes, scale_m(32.0)).map(|at| at.map(|float| (1000.0 * float).round() as i32)).collect();
        assert_eq!(read, [[-1500, 500]]);
        assert_eq!(bytes[44..48], [1, 0, 2, 0]);
        assert_eq!([number(48), number(50), number(52)], [1000, -2000, -5000]);
        assert_eq!(bytes[54..], [3, 0, 0xd3, 4, 255, 255, 255, 255], "1235 mm, and nothing seen");
    }

    #[test]
    fn numbers_beyond_the_scene_stay_at_its_edge() {
        let robot = RobotState { position: Some(Vec2::new(1e9, -1e9)), ..RobotState::default() };
        let age = Some(Span::from_secs(1e6));
        let link = LinkState { one: 0, other: 1, age, loss: None };
        let bytes = Snapshot { robots: vec![robot], links: vec![link], ..Snapshot::default() }.encode(scale_m(5.0));
        assert_eq!(bytes[16..20], [0, 125, 0, 131], "32000 and -32000");
        assert_eq!(bytes[29..31], [250, 255]);
    }
}
