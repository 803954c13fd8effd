//! Values of the senses of robots, as arrays of numbers.

use serde::{Deserialize, Serialize};

use super::body::{Body, Unfit};
use super::floats::Features;
use super::floats::MAX_FEATURE;
use super::ids::RobotId;

/// Largest number of values of one sense.
pub const MAX_SENSED: usize = 16_384;
/// Largest number of values in one message, which fits into one datagram.
pub const MAX_VALUES: usize = 256;

/// Values of one sense of a robot, such as a scan of its lidar, from the host of the robot's Body to its Agent. A
/// measurement of more than 256 values is in several messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensed {
    /// Number of the robot that has perceived it.
    pub robot: RobotId,
    /// Index of the sense among those of the team, in the order of their names.
    pub sense: u8,
    /// Time of measurement \[ns\] on the sensor's clock, whose offset from other clocks is unknown.
    pub stamp_ns: u64,
    /// Index of the first value of this message within the measurement; a multiple of 256.
    pub first: u16,
    /// Number of values of the whole measurement.
    pub of: u16,
    /// Values in the unit of the sense; positive infinity stands for no echo.
    pub values: Features,
}

impl Sensed {
    /// Returns the messages of a measurement with these values: one for each 256 of them. Returns `None` if it has no
    /// values, more than can be sent, or one that is no number.
    pub fn split(robot: RobotId, sense: u8, stamp_ns: u64, values: &[f32]) -> Option<Vec<Sensed>> {
        let of = u16::try_from(values.len()).ok().filter(|of| (1..=MAX_SENSED).contains(&usize::from(*of)))?;
        let message = |(index, values): (usize, &[f32])| Sensed {
            robot,
            sense,
            stamp_ns,
            first: u16::try_from(index * MAX_VALUES).expect("a measurement has at most 16 384 values"),
            of,
            values: Features(values.into()),
        };
        let all: Vec<Sensed> = values.chunks(MAX_VALUES).enumerate().map(message).collect();
        all.iter().all(|message| message.check().is_ok()).then_some(all)
    }

    /// Returns whether the message has all values of its measurement.
    pub fn is_whole(&self) -> bool {
        self.values.0.len() == usize::from(self.of)
    }
}

impl Body for Sensed {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        let (first, of, values) = (usize::from(self.first), usize::from(self.of), &self.values.0);
        let fits = of <= MAX_SENSED && first < of && first.is_multiple_of(MAX_VALUES);
        if !fits || values.len() != (of - first).min(MAX_VALUES) {
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

    fn message(first: u16, of: u16, values: Vec<f32>) -> Sensed {
        Sensed { robot: RobotId(1), sense: 0, stamp_ns: 5, first, of, values: Features(values.into()) }
    }

    #[test]
    fn no_echo_is_a_value_and_what_is_no_number_is_none() {
        assert_eq!(message(0, 3, vec![1.0, f32::INFINITY, -1e6]).check(), Ok(()));
        for wrong in [f32::NAN, f32::NEG_INFINITY, 1.1e6] {
            assert_eq!(message(0, 2, vec![0.0, wrong]).check(), Err(Unfit::Number), "{wrong}");
            assert_eq!(Sensed::split(RobotId(1), 0, 5, &[0.0, wrong]), None, "{wrong}");
        }
    }

    #[test]
    fn a_message_has_the_values_that_its_place_says() {
        for (first, of, values, fits) in [
            (0, 1, 1, true),
            (0, 256, 256, true),
            (0, 257, 256, true),
            (256, 257, 1, true),
            (16_128, 16_384, 256, true),
            (0, 0, 0, false),
            (0, 2, 1, false),
            (0, 257, 257, false),
            (256, 257, 2, false),
            (257, 258, 1, false),
            (256, 256, 0, false),
            (512, 257, 1, false),
            (0, 16_385, 256, false),
            (65_280, u16::MAX, 255, false),
        ] {
            let expected = if fits { Ok(()) } else { Err(Unfit::Length) };
            assert_eq!(message(first, of, vec![0.0; values]).check(), expected, "{first} {of} {values}");
        }
    }

    #[test]
    fn the_messages_of_a_measurement_have_all_of_its_values_once() {
        for number in [1, 255, 256, 257, 600, MAX_SENSED] {
            let values: Vec<f32> = (0..number).map(|at| at as f32).collect();
            let all = Sensed::split(RobotId(1), 2, 7, &values).expect("they can be sent");
            let joined: Vec<f32> = all.iter().flat_map(|message| message.values.0.iter().copied()).collect();
            assert_eq!((joined, all.len()), (values, number.div_ceil(MAX_VALUES)), "{number}");
            assert_eq!(all[0].is_whole(), number <= MAX_VALUES);
        }
        assert_eq!(Sensed::split(RobotId(1), 2, 7, &[]), None);
        assert_eq!(Sensed::split(RobotId(1), 2, 7, &vec![0.0; MAX_SENSED + 1]), None);
    }
}
