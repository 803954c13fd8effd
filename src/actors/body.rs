//! Body: one robot's actuator and sensor. It lives where the actuator is: on the robot, or beside the World
//! that simulates it. What its sensor is like is in `world`; its noise, rate and latency come about here.
//!
//! A Body stops its motors when the last command's validity lapses, whoever died upstream. Nothing
//! bypasses it.

use std::collections::VecDeque;

use super::Core;
use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::messages::local::{Drive, Sample};
use crate::messages::wire::{MotorCommand, Reading};
use crate::random::Stream;
use crate::time::{Span, Time};
use crate::world::Sensor;

/// What a Body accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// What its motors are to do.
    MotorCommand(MotorCommand),
    /// Its true state.
    Sample(Sample),
}

/// What a Body says.
#[derive(Clone, Debug)]
pub enum Out {
    /// To its World.
    Drive(Drive),
    /// To its Cache.
    Reading(Reading),
}

/// One robot's body.
#[derive(Debug)]
pub struct Body {
    robot: RobotId,
    sensor: Sensor,
    stream: Stream,
    /// When the sensor has measured, and when it does next, at the earliest.
    measured: Option<Time>,
    ready: Time,
    /// What was measured and is not told yet.
    pending: VecDeque<(Time, Reading)>,
    /// When the command in force lapses.
    lapses: Option<Time>,
}

impl Body {
    /// A body at rest, measured by this sensor; draws its noise from `stream`.
    pub fn new(robot: RobotId, sensor: Sensor, stream: Stream) -> Body {
        let (measured, ready, pending) = (None, Time::ZERO, VecDeque::new());
        Body { robot, sensor, stream, measured, ready, pending, lapses: None }
    }

    fn measure(&mut self, now: Time, sample: &Sample, out: &mut Vec<Out>) {
        // Who is placed is sampled twice at one instant, at two places: the second is where it is.
        if sample.time < self.ready && self.measured != Some(sample.time) {
            return;
        }
        (self.measured, self.ready) = (Some(sample.time), sample.time + self.sensor.period);
        let motion = self.sensor.measure(&sample.motion, &mut self.stream);
        let reading = Reading { robot: self.robot, stamp_ns: sample.time.as_nanos(), motion };
        if self.sensor.latency == Span::ZERO {
            out.push(Out::Reading(reading));
        } else {
            self.pending.push_back((now + self.sensor.latency, reading));
        }
    }
}

impl Core for Body {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::MotorCommand(command) => {
                let until = now + command.valid_for;
                self.lapses = Some(until);
                out.push(Out::Drive(Drive { robot: self.robot, velocity: command.velocity, until }));
            }
            In::Sample(sample) => self.measure(now, &sample, out),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        let told = self.pending.front().map(|(due, _)| *due);
        [self.lapses, told].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.lapses.is_some_and(|lapses| lapses <= now) {
            self.lapses = None;
            out.push(Out::Drive(Drive { robot: self.robot, velocity: Vec2::zeros(), until: now }));
        }
        while self.pending.front().is_some_and(|(due, _)| *due <= now) {
            out.extend(self.pending.pop_front().map(|(_, reading)| Out::Reading(reading)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::messages::local::Contacts;
    use crate::random::Seed;

    fn body(sensor: Sensor) -> Body {
        Body::new(RobotId(0), sensor, Seed::of_run(0).stream("sensor"))
    }

    fn sample(ms: u64) -> In {
        let (motion, time) = (Motion::at_rest(Vec2::new(1.0, 2.0)), Time::ZERO + Span::from_millis(ms));
        In::Sample(Sample { robot: RobotId(0), time, motion, command: Vec2::zeros(), contacts: Contacts::default() })
    }

    fn readings(out: &[Out]) -> Vec<Reading> {
        out.iter()
            .filter_map(|said| if let Out::Reading(reading) = said { Some(reading.clone()) } else { None })
            .collect()
    }

    #[test]
    fn an_exact_sensor_tells_the_truth_at_once() {
        let (mut body, mut out) = (body(Sensor::EXACT), Vec::new());
        body.handle(Time::ZERO, sample(0), &mut out);
        assert_eq!(readings(&out)[0].motion, Motion::at_rest(Vec2::new(1.0, 2.0)));
        assert_eq!(body.wake_at(), None);
    }

    #[test]
    fn readings_come_late_with_noise_and_no_faster_than_the_sensor_measures() {
        let at_ms = |ms| Time::ZERO + Span::from_millis(ms);
        let slow = Sensor { period: Span::from_millis(100), ..Sensor::MOTION_CAPTURE };
        let (mut body, mut out) = (body(slow), Vec::new());
        for ms in [0, 50, 100] {
            body.handle(at_ms(ms), sample(ms), &mut out);
            assert_eq!(body.wake_at(), (ms != 50).then(|| at_ms(ms + 10)), "late, and one of two");
            body.wake(at_ms(ms + 10), &mut out);
        }
        let told = readings(&out);
        assert_eq!(told.iter().map(|reading| reading.stamp_ns).collect::<Vec<_>>(), [0, 100_000_000]);
        let off = (told[0].motion.position - Vec2::new(1.0, 2.0)).norm();
        assert!(off > 0.0 && off < 2e-3 && told[0].motion.velocity != Vec2::zeros(), "{off}");
        assert_eq!(told.len(), out.len(), "and nothing else");
    }

    #[test]
    fn the_motors_stop_when_the_command_lapses() {
        let mut body = body(Sensor::EXACT);
        let mut out = Vec::new();
        let command = |x| {
            let velocity = Vec2::new(x, 0.0);
            In::MotorCommand(MotorCommand { robot: RobotId(0), velocity, valid_for: Span::from_millis(200) })
        };
        body.handle(Time::ZERO, command(1.0), &mut out);
        body.handle(Time::ZERO + Span::from_millis(50), command(0.5), &mut out);
        let lapse = Time::ZERO + Span::from_millis(250);
        assert_eq!(body.wake_at(), Some(lapse), "the newest command counts");
        body.wake(lapse, &mut out);
        assert!(matches!(out[2], Out::Drive(drive) if drive.velocity == Vec2::zeros()));
        assert_eq!(body.wake_at(), None);
    }
}
