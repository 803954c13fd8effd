//! Estimate of a Crazyflie about itself: position, velocity and heading, from a log block.

use murmurate::messages::geometry::{Deviation, Pose, Twist, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;

use crate::axes;

/// Log variables of the block with the estimate, each with the type in which it is sent: a float.
pub const VARIABLES: [(&str, u8); 6] = [
    ("stateEstimate.x", 7),
    ("stateEstimate.y", 7),
    ("stateEstimate.z", 7),
    ("stateEstimate.vx", 7),
    ("stateEstimate.vy", 7),
    ("stateEstimate.yaw", 7),
];

/// Stamps of log blocks count milliseconds in 24 bits.
const STAMP_BITS: u32 = 24;

/// State of a robot by its own estimate, in the team's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Position in the plane, and height above the ground \[m\].
    pub position: Vec2,
    /// See `position`.
    pub height_m: f32,
    /// Velocity in the plane \[m/s\].
    pub velocity: Vec2,
    /// Heading \[rad\].
    pub heading: f32,
}

impl Estimate {
    /// Decodes the content of a log block; `None` if it is too short or not finite.
    pub fn decode(data: &[u8]) -> Option<Estimate> {
        let mut numbers = data.chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().expect("four bytes")));
        let numbers: [f32; 6] = std::array::from_fn(|_| numbers.next().unwrap_or(f32::NAN));
        let [x, y, height_m, vx, vy, yaw_deg] = numbers;
        numbers.iter().all(|number| number.is_finite()).then(|| Estimate {
            position: Vec2::new(x, y),
            height_m,
            velocity: Vec2::new(vx, vy),
            heading: axes::heading_of(yaw_deg),
        })
    }

    /// Returns the estimate as odometry of `robot`, measured at `stamp_ns` \[ns\] on the robot's clock.
    pub fn reading(&self, robot: RobotId, stamp_ns: u64) -> Reading {
        Reading {
            robot,
            stamp_ns,
            pose: Pose { position: self.position, heading: Some(self.heading) },
            twist: Twist { velocity: self.velocity, yaw_rate: None },
            deviation: Deviation::default(),
        }
    }
}

/// Clock of a robot by the stamps of its log blocks, which begin anew after four hours and a half.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stamps {
    newest_ms: u64,
}

impl Stamps {
    /// Takes a stamp \[ms\]; returns the time of measurement \[ns\]. One that is older by less than half of the range
    /// is late, and stays older.
    pub fn take(&mut self, stamp_ms: u32) -> u64 {
        let range = 1u64 << STAMP_BITS;
        let (turn, stamp) = (self.newest_ms / range, u64::from(stamp_ms) % range);
        let near = [turn.saturating_sub(1), turn, turn + 1].map(|turn| turn * range + stamp);
        let ms = near.into_iter().min_by_key(|ms| ms.abs_diff(self.newest_ms)).unwrap_or(stamp);
        self.newest_ms = self.newest_ms.max(ms);
        ms * 1_000_000
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::requests::floats;

    #[test]
    fn an_estimate_is_in_the_axes_of_the_team_and_one_that_is_none_is_refused() {
        let data = floats(&[1.0, -2.0, 0.5, 0.1, 0.2, 90.0]);
        let estimate = Estimate::decode(&data).expect("it is whole");
        let reading = estimate.reading(RobotId(2), 7);
        assert_eq!((reading.pose.position, estimate.height_m), (Vec2::new(1.0, -2.0), 0.5));
        assert!((reading.pose.heading.expect("it has one") - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
        assert_eq!(Estimate::decode(&data[..23]), None);
        assert_eq!(Estimate::decode(&floats(&[1.0, f32::NAN, 0.5, 0.1, 0.2, 90.0])), None);
    }

    #[test]
    fn stamps_go_on_when_the_robots_counter_begins_anew_and_late_ones_stay_late() {
        let mut stamps = Stamps::default();
        let said = [0xff_fff0, 0xff_fffa, 4, 0xff_fffe, 24].map(|stamp| stamps.take(stamp) / 1_000_000);
        assert_eq!(said, [0xff_fff0, 0xff_fffa, 0x100_0004, 0xff_fffe, 0x100_0018]);
    }
}
