//! Values of the senses of robots, as arrays of numbers.

use serde::{Deserialize, Serialize};

use super::body::{Body, Unfit};
use super::floats::Features;
use super::floats::MAX_FEATURE;
use super::ids::RobotId;

/// Largest number of values of one sense. The encoded message still fits into one datagram.
pub const MAX_SENSED: usize = 256;

/// Values of one sense of a robot, such as a scan of its lidar, from the host of the robot's Body to its Agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensed {
    /// Number of the robot that has perceived it.
    pub robot: RobotId,
    /// Index of the sense among those of the team, in the order of their names.
    pub sense: u8,
    /// Time of measurement \[ns\] on the sensor's clock, whose offset from other clocks is unknown.
    pub stamp_ns: u64,
    /// Values in the unit of the sense; positive infinity stands for no echo.
    pub values: Features,
}

impl Sensed {
    /// Returns whether the message has values, no more than can be sent, and each is a number.
    pub(crate) fn is_sound(&self) -> bool {
        self.check().is_ok()
    }
}

impl Body for Sensed {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        let values = &self.values.0;
        if values.is_empty() || values.len() > MAX_SENSED {
            return Err(Unfit::Length);
        }
        // Without an early return, so that the compiler looks at several at once.
        let sound = |all: bool, value: &f32| all & ((value.abs() <= MAX_FEATURE) | (*value == f32::INFINITY));
        values.iter().fold(true, sound).then_some(()).ok_or(Unfit::Number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_echo_is_a_value_and_what_is_no_number_is_none() {
        let check = |values: Vec<f32>| {
            Sensed { robot: RobotId(1), sense: 0, stamp_ns: 5, values: Features(values.into()) }.check()
        };
        assert_eq!(check(vec![1.0, f32::INFINITY, -1e6]), Ok(()));
        for wrong in [f32::NAN, f32::NEG_INFINITY, 1.1e6] {
            assert_eq!(check(vec![0.0, wrong]), Err(Unfit::Number), "{wrong}");
        }
        assert_eq!((check(Vec::new()), check(vec![0.0; 257])), (Err(Unfit::Length), Err(Unfit::Length)));
    }
}
