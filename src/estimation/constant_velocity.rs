//! Estimator that extrapolates the last reading by its velocity, over the time since its arrival.
//!
//! The time from measurement to arrival of the reading is unknown and counts as zero.

use super::{Estimator, Settings};
use crate::messages::geometry::Motion;
use crate::messages::wire::Reading;
use crate::time::{Span, Time};

/// Longest time over which a reading is extrapolated, so that a robot without readings is not estimated to go through a
/// wall.
const LONGEST: Span = Span::from_millis(200);

#[derive(Debug, Default)]
struct ConstantVelocity(Option<(Time, Motion)>);

/// Makes a constant-velocity estimator that has received no reading yet. It has no settings.
pub fn make(_: &Settings) -> Box<dyn Estimator> {
    Box::<ConstantVelocity>::default()
}

impl Estimator for ConstantVelocity {
    fn take(&mut self, now: Time, reading: &Reading) {
        self.0 = Some((now, reading.motion()));
    }

    fn at(&self, now: Time) -> Option<Motion> {
        let (arrived, motion) = self.0?;
        let since_s = now.since(arrived).min(LONGEST).as_secs() as f32;
        Some(Motion { position: motion.position + motion.velocity * since_s, ..motion })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Vec2;
    use crate::messages::ids::RobotId;

    #[test]
    fn a_robot_goes_on_as_it_moved_and_not_for_ever() {
        let mut estimator = make(&Settings::default());
        let at_ms = |ms: u64| Time::ZERO + Span::from_millis(ms);
        assert_eq!(estimator.at(at_ms(0)), None);
        let motion = Motion { position: Vec2::new(1.0, 2.0), velocity: Vec2::new(0.5, -1.0) };
        estimator.take(at_ms(100), &Reading::of_point(RobotId(0), 7, motion));
        assert_eq!(estimator.at(at_ms(100)), Some(motion));
        assert_eq!(estimator.at(at_ms(200)).unwrap().position, Vec2::new(1.05, 1.9));
        assert_eq!(estimator.at(at_ms(9000)).unwrap().position, Vec2::new(1.1, 1.8), "for 200 ms");
    }
}
