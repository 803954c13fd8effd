//! Source of readings of a simulated robot: a sensor with noise, rate and latency, which measures the true states of
//! the robot that the World sends.

use std::collections::VecDeque;

use super::{In, Out, Source};
use crate::messages::geometry::{Pose, Twist};
use crate::messages::local::Sample;
use crate::messages::wire::Reading;
use crate::random::Stream;
use crate::time::{Span, Time};
use crate::world::Sensor;

/// Simulated sensor of one robot: measures the robot's true state with noise, at a limited rate and with latency.
#[derive(Debug)]
pub struct Simulated {
    sensor: Sensor,
    stream: Stream,
    /// Time of the last measurement; `None` before the first.
    measured: Option<Time>,
    /// Earliest time of the next measurement.
    ready: Time,
    /// Readings that are not yet put out because of the latency, each with the time at which it is due.
    pending: VecDeque<(Time, Reading)>,
}

impl Simulated {
    /// Makes a sensor with the properties `sensor`, which draws its noise from the random stream `stream`.
    pub fn new(sensor: Sensor, stream: Stream) -> Simulated {
        Simulated { sensor, stream, measured: None, ready: Time::ZERO, pending: VecDeque::new() }
    }

    fn measure(&mut self, sample: &Sample) -> Reading {
        let motion = self.sensor.measure(&sample.motion, &mut self.stream);
        Reading {
            robot: sample.robot,
            stamp_ns: sample.time.as_nanos(),
            pose: Pose { position: motion.position, heading: Some(sample.heading) },
            twist: Twist { velocity: motion.velocity, yaw_rate: Some(sample.yaw_rate) },
            deviation: self.sensor.deviation(),
        }
    }
}

impl Source for Simulated {
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        let In::Sample(sample) = input else { return };
        // A robot that is placed is sampled twice at one instant, at two places; the second is valid.
        if sample.time < self.ready && self.measured != Some(sample.time) {
            return;
        }
        (self.measured, self.ready) = (Some(sample.time), sample.time + self.sensor.period);
        let reading = self.measure(sample);
        if self.sensor.latency == Span::ZERO {
            out.push(Out::Reading(reading));
        } else {
            self.pending.push_back((now + self.sensor.latency, reading));
        }
    }

    fn wake_at(&self) -> Option<Time> {
        self.pending.front().map(|(due, _)| *due)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        while self.pending.front().is_some_and(|(due, _)| *due <= now) {
            out.extend(self.pending.pop_front().map(|(_, reading)| Out::Reading(reading)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::{Motion, Vec2};
    use crate::messages::ids::RobotId;
    use crate::messages::local::Contacts;
    use crate::random::Seed;

    fn source(sensor: Sensor) -> Simulated {
        Simulated::new(sensor, Seed::of_run(0).stream("sensor"))
    }

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn sample(ms: u64) -> Sample {
        Sample {
            robot: RobotId(0),
            time: at_ms(ms),
            motion: Motion::at_rest(Vec2::new(1.0, 2.0)),
            heading: 0.5,
            yaw_rate: 0.0,
            command: Vec2::zeros(),
            contacts: Contacts::default(),
        }
    }

    fn readings(out: Vec<Out>) -> Vec<Reading> {
        let reading = |said| match said {
            Out::Reading(reading) => reading,
            other => panic!("{other:?}"),
        };
        out.into_iter().map(reading).collect()
    }

    #[test]
    fn an_exact_sensor_tells_the_truth_at_once() {
        let (mut source, mut out) = (source(Sensor::EXACT), Vec::new());
        source.take(Time::ZERO, In::Sample(&sample(0)), &mut out);
        let told = readings(out);
        assert_eq!((told[0].motion(), told[0].pose.heading), (Motion::at_rest(Vec2::new(1.0, 2.0)), Some(0.5)));
        assert_eq!(source.wake_at(), None);
    }

    #[test]
    fn readings_come_late_with_noise_and_no_faster_than_the_sensor_measures() {
        let slow = Sensor { period: Span::from_millis(100), ..Sensor::MOTION_CAPTURE };
        let (mut source, mut out) = (source(slow), Vec::new());
        for ms in [0, 50, 100] {
            source.take(at_ms(ms), In::Sample(&sample(ms)), &mut out);
            assert_eq!(source.wake_at(), (ms != 50).then(|| at_ms(ms + 10)), "late, and one of two");
            source.wake(at_ms(ms + 10), &mut out);
        }
        let told = readings(out);
        assert_eq!(told.iter().map(|reading| reading.stamp_ns).collect::<Vec<_>>(), [0, 100_000_000]);
        let off = (told[0].motion().position - Vec2::new(1.0, 2.0)).norm();
        assert!(off > 0.0 && off < 2e-3 && told[0].motion().velocity != Vec2::zeros(), "{off}");
        assert_eq!(told[0].deviation.position_m, Some(2e-4));
    }
}
