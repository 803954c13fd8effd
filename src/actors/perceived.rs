//! Newest values of one sense of a robot, joined from the messages of a measurement. Part of the robot's Cache.

use crate::messages::local::Sensation;
use crate::messages::wire::{Features, MAX_VALUES, Sensed};
use crate::time::Time;

/// Newest measurement of a sense, and one whose messages have not all arrived.
#[derive(Debug, Default)]
pub(super) struct Perceived {
    newest: Option<Measurement>,
    /// Measurement that arrives in several messages.
    joining: Option<Joining>,
}

#[derive(Debug)]
struct Measurement {
    /// Time of the arrival of its last message.
    arrived: Time,
    stamp_ns: u64,
    values: Features,
}

#[derive(Debug)]
struct Joining {
    stamp_ns: u64,
    values: Vec<f32>,
    /// Bit for each message of the measurement, that of the first one lowest: whether it has arrived.
    has: u64,
}

impl Perceived {
    /// Takes a message of the sense. A repeated stamp is the same measurement and does not make the values newer. A
    /// measurement of which a message is missing when the next one begins is dropped.
    pub fn take(&mut self, now: Time, sensed: Sensed) {
        let stamp_ns = sensed.stamp_ns;
        let Some(values) = (if sensed.is_whole() { Some(sensed.values) } else { self.join(&sensed) }) else { return };
        let known = self.newest.as_ref().filter(|before| before.stamp_ns == stamp_ns);
        let arrived = known.map_or(now, |before| before.arrived);
        self.newest = Some(Measurement { arrived, stamp_ns, values });
    }

    /// Returns the newest values and their age at `now`; `None` before the first.
    pub fn at(&self, now: Time) -> Option<Sensation> {
        let Measurement { arrived, values, .. } = self.newest.as_ref()?;
        Some(Sensation { values: values.clone(), age: now.since(*arrived) })
    }

    /// Adds a message to the measurement that it belongs to, and returns the values once that has all of them.
    fn join(&mut self, part: &Sensed) -> Option<Features> {
        let of = usize::from(part.of);
        let joins = |joining: &Joining| joining.stamp_ns == part.stamp_ns && joining.values.len() == of;
        if !self.joining.as_ref().is_some_and(joins) {
            self.joining = Some(Joining { stamp_ns: part.stamp_ns, values: vec![0.0; of], has: 0 });
        }
        let joining = self.joining.as_mut()?;
        let first = usize::from(part.first);
        joining.values[first..first + part.values.0.len()].copy_from_slice(&part.values.0);
        joining.has |= 1 << (first / MAX_VALUES);
        if joining.has.count_ones() as usize != of.div_ceil(MAX_VALUES) {
            return None;
        }
        self.joining.take().map(|joining| Features(joining.values.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::ids::RobotId;
    use crate::time::Span;

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn measurement(stamp_ns: u64, number: usize, value: f32) -> Vec<Sensed> {
        Sensed::split(RobotId(0), 0, stamp_ns, &vec![value; number]).expect("they can be sent")
    }

    fn seen(perceived: &Perceived, ms: u64) -> Option<(f32, usize, Span)> {
        let Sensation { values, age } = perceived.at(at_ms(ms))?;
        assert!(values.0.iter().all(|value| *value == values.0[0]), "of one measurement");
        Some((values.0[0], values.0.len(), age))
    }

    #[test]
    fn the_newest_values_age_from_their_arrival() {
        let mut perceived = Perceived::default();
        assert_eq!(seen(&perceived, 0), None);
        for (ms, stamp_ns, value) in [(10, 5, 1.0), (20, 6, 2.0), (30, 6, 2.5)] {
            measurement(stamp_ns, 3, value).into_iter().for_each(|sensed| perceived.take(at_ms(ms), sensed));
        }
        assert_eq!(seen(&perceived, 50), Some((2.5, 3, Span::from_millis(30))));
    }

    #[test]
    fn a_measurement_in_several_messages_counts_when_all_have_come_in_any_order() {
        let mut perceived = Perceived::default();
        let all = measurement(1, 600, 1.0);
        for (ms, at) in [(1, 2), (2, 0), (3, 0)] {
            perceived.take(at_ms(ms), all[at].clone());
            assert_eq!(seen(&perceived, ms), None);
        }
        perceived.take(at_ms(4), all[1].clone());
        assert_eq!(seen(&perceived, 6), Some((1.0, 600, Span::from_millis(2))));
        // One of the second measurement is lost, so the first one holds until the third.
        let (second, third) = (measurement(2, 600, 2.0), measurement(3, 600, 3.0));
        second[..2].iter().for_each(|sensed| perceived.take(at_ms(10), sensed.clone()));
        third[..2].iter().for_each(|sensed| perceived.take(at_ms(20), sensed.clone()));
        assert_eq!(seen(&perceived, 24), Some((1.0, 600, Span::from_millis(20))));
        perceived.take(at_ms(25), third[2].clone());
        assert_eq!(seen(&perceived, 25), Some((3.0, 600, Span::ZERO)));
    }

    #[test]
    fn messages_that_contradict_each_other_make_no_measurement() {
        let mut perceived = Perceived::default();
        let (long, short) = (measurement(1, 600, 1.0), measurement(1, 300, 2.0));
        perceived.take(at_ms(1), long[0].clone());
        perceived.take(at_ms(2), short[1].clone());
        perceived.take(at_ms(3), long[2].clone());
        assert_eq!(seen(&perceived, 3), None);
    }
}
