//! Body: one robot's actuator and sensor. It lives where the actuator is: on the robot, or beside the World
//! that simulates it. What its sensor is like is in `world`; its noise, rate and latency come about here.
//!
//! A Body stops its motors when the last command's validity lapses, whichever actor has died upstream, and follows the
//! emergency stop by itself: a command that is released late drives nobody. Nothing bypasses it.

use std::collections::VecDeque;

use crate::actor::Core;
use crate::messages::geometry::{Pose, Twist, Vec2};
use crate::messages::ids::{HostId, RobotId};
use crate::messages::latch::{Latch, LatchFollower};
use crate::messages::local::{Drive, Sample};
use crate::messages::wire::{MotorCommand, Reading, Stop};
use crate::random::Stream;
use crate::time::{Span, Time};
use crate::world::Sensor;

/// How often a Body tells a state server that knows less of the emergency stop than it does.
const CORRECTION_PERIOD: Span = Span::from_millis(200);

/// What a Body accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// What its motors are to do.
    MotorCommand(MotorCommand),
    /// Its true state.
    Sample(Sample),
    /// The emergency stop, engaged or taken back.
    Stop(Stop),
    /// The latch as the state server repeats it.
    Latch(Latch),
    /// Its host is told to end.
    Leave,
}

/// What a Body says.
#[derive(Clone, Debug)]
pub enum Out {
    /// To its World.
    Drive(Drive),
    /// To its Cache.
    Reading(Reading),
    /// To the host's Status: the latch that it follows.
    Follows(Latch),
    /// To everyone: the state server has forgotten a stop.
    Stop(Stop),
}

/// One robot's body.
#[derive(Debug)]
pub struct Body {
    robot: RobotId,
    /// The host that it lives on.
    host: HostId,
    sensor: Sensor,
    stream: Stream,
    /// When the sensor has measured, and when it does next, at the earliest.
    measured: Option<Time>,
    ready: Time,
    /// What was measured and is not told yet.
    pending: VecDeque<(Time, Reading)>,
    /// When the command in force lapses.
    lapses: Option<Time>,
    latch: LatchFollower,
    /// When a state server was last corrected.
    corrected: Option<Time>,
    /// Whether its host is about to end.
    leaves: bool,
}

impl Body {
    /// A body at rest, measured by this sensor; draws its noise from `stream`.
    pub fn new((host, robot): (HostId, RobotId), sensor: Sensor, stream: Stream) -> Body {
        Body {
            robot,
            host,
            sensor,
            stream,
            measured: None,
            ready: Time::ZERO,
            pending: VecDeque::new(),
            lapses: None,
            latch: LatchFollower::default(),
            corrected: None,
            leaves: false,
        }
    }

    /// Whether its motors may turn: the state server was heard, no stop is engaged or held, and its host stays.
    fn may_move(&self) -> bool {
        self.latch.is_informed() && self.latch.latch().is_clear() && !self.leaves
    }

    fn obey(&mut self, now: Time, command: &MotorCommand, out: &mut Vec<Out>) {
        let velocity = if self.may_move() { command.velocity } else { Vec2::zeros() };
        let until = now + command.valid_for;
        self.lapses = Some(until);
        out.push(Out::Drive(Drive { robot: self.robot, velocity, until }));
    }

    fn stand(&mut self, now: Time, out: &mut Vec<Out>) {
        self.lapses = None;
        out.push(Out::Drive(Drive { robot: self.robot, velocity: Vec2::zeros(), until: now }));
    }

    fn latched(&mut self, now: Time, changed: bool, out: &mut Vec<Out>) {
        if changed && !self.may_move() {
            self.stand(now, out);
        }
    }

    /// A state server that was started afresh may know less than this body; a hold that only bodies remember holds.
    fn correct(&mut self, now: Time, said: Latch, out: &mut Vec<Out>) {
        let own = self.latch.latch();
        let due = self.corrected.is_none_or(|at| now.since(at) >= CORRECTION_PERIOD);
        if !own.is_clear() && own > said && due {
            self.corrected = Some(now);
            out.push(Out::Stop(Stop { by: self.host, latch: own }));
        }
    }

    fn measure(&mut self, now: Time, sample: &Sample, out: &mut Vec<Out>) {
        // Who is placed is sampled twice at one instant, at two places: the second is where it is.
        if sample.time < self.ready && self.measured != Some(sample.time) {
            return;
        }
        (self.measured, self.ready) = (Some(sample.time), sample.time + self.sensor.period);
        let motion = self.sensor.measure(&sample.motion, &mut self.stream);
        let reading = Reading {
            robot: self.robot,
            stamp_ns: sample.time.as_nanos(),
            pose: Pose { position: motion.position, heading: Some(sample.heading) },
            twist: Twist { velocity: motion.velocity, yaw_rate: Some(sample.yaw_rate) },
            deviation: self.sensor.deviation(),
        };
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
            In::MotorCommand(command) => self.obey(now, &command, out),
            In::Sample(sample) => self.measure(now, &sample, out),
            In::Stop(stop) => {
                let changed = self.latch.told(stop.latch);
                self.latched(now, changed, out);
                out.push(Out::Follows(self.latch.latch()));
            }
            In::Latch(said) => {
                let changed = self.latch.learned(said);
                self.latched(now, changed, out);
                self.correct(now, said, out);
                if changed {
                    out.push(Out::Follows(self.latch.latch()));
                }
            }
            In::Leave => {
                self.leaves = true;
                self.stand(now, out);
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        let told = self.pending.front().map(|(due, _)| *due);
        [self.lapses, told].into_iter().flatten().min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.lapses.is_some_and(|lapses| lapses <= now) {
            self.stand(now, out);
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
        let mut body = Body::new((HostId(3), RobotId(0)), sensor, Seed::of_run(0).stream("sensor"));
        body.handle(Time::ZERO, In::Latch(Latch::default()), &mut Vec::new());
        body
    }

    fn command(x: f32) -> In {
        let velocity = Vec2::new(x, 0.0);
        In::MotorCommand(MotorCommand { robot: RobotId(0), velocity, valid_for: Span::from_millis(200) })
    }

    fn handle(body: &mut Body, ms: u64, input: In) -> Vec<Out> {
        let mut out = Vec::new();
        body.handle(Time::ZERO + Span::from_millis(ms), input, &mut out);
        out
    }

    /// How fast it is driven by a command of 1 m/s.
    fn driven(body: &mut Body, ms: u64) -> f32 {
        let out = handle(body, ms, command(1.0));
        let [Out::Drive(drive)] = &out[..] else { panic!("{out:?}") };
        drive.velocity.x
    }

    #[test]
    fn a_command_that_is_released_after_a_stop_drives_nobody_until_a_resume() {
        let mut body = body(Sensor::EXACT);
        assert_eq!(driven(&mut body, 0), 1.0);
        let out = handle(&mut body, 10, In::Stop(Stop::engage(HostId(9), Latch::default())));
        assert!(matches!(&out[0], Out::Drive(drive) if drive.velocity == Vec2::zeros()), "at once");
        assert!(matches!(&out[1], Out::Follows(latch) if latch.is_engaged()));
        assert_eq!(driven(&mut body, 45_000), 0.0);
        handle(&mut body, 45_010, In::Stop(Stop::rearm(HostId(9), Latch::engaged(1))));
        assert_eq!(driven(&mut body, 45_020), 0.0, "held");
        handle(&mut body, 45_030, In::Latch(Latch::clear(3)));
        assert_eq!(driven(&mut body, 45_040), 1.0);
    }

    #[test]
    fn a_fresh_body_moves_nothing_before_the_state_server_is_heard() {
        let mut body = Body::new((HostId(3), RobotId(0)), Sensor::EXACT, Seed::of_run(0).stream("sensor"));
        assert_eq!(driven(&mut body, 0), 0.0);
        handle(&mut body, 10, In::Latch(Latch::default()));
        assert_eq!(driven(&mut body, 20), 1.0);
        handle(&mut body, 30, In::Leave);
        assert_eq!(driven(&mut body, 40), 0.0, "its host is about to end");
    }

    #[test]
    fn a_state_server_that_has_forgotten_a_hold_is_told() {
        let mut body = body(Sensor::EXACT);
        handle(&mut body, 0, In::Latch(Latch::held(2)));
        let told = |out: &[Out]| out.iter().any(|said| matches!(said, Out::Stop(s) if s.latch == Latch::held(2)));
        assert!(told(&handle(&mut body, 100, In::Latch(Latch::default()))));
        assert!(!told(&handle(&mut body, 200, In::Latch(Latch::default()))), "not with every instruction");
        assert!(told(&handle(&mut body, 300, In::Latch(Latch::default()))));
        assert!(!told(&handle(&mut body, 600, In::Latch(Latch::held(2)))), "it knows");
    }

    fn sample(ms: u64) -> In {
        let (motion, time) = (Motion::at_rest(Vec2::new(1.0, 2.0)), Time::ZERO + Span::from_millis(ms));
        In::Sample(Sample {
            robot: RobotId(0),
            time,
            motion,
            heading: 0.0,
            yaw_rate: 0.0,
            command: Vec2::zeros(),
            contacts: Contacts::default(),
        })
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
        assert_eq!(readings(&out)[0].motion(), Motion::at_rest(Vec2::new(1.0, 2.0)));
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
        let off = (told[0].motion().position - Vec2::new(1.0, 2.0)).norm();
        assert!(off > 0.0 && off < 2e-3 && told[0].motion().velocity != Vec2::zeros(), "{off}");
        assert_eq!(told.len(), out.len(), "and nothing else");
    }

    #[test]
    fn the_motors_stop_when_the_command_lapses() {
        let mut body = body(Sensor::EXACT);
        let mut out = Vec::new();
        body.handle(Time::ZERO, command(1.0), &mut out);
        body.handle(Time::ZERO + Span::from_millis(50), command(0.5), &mut out);
        let lapse = Time::ZERO + Span::from_millis(250);
        assert_eq!(body.wake_at(), Some(lapse), "the newest command counts");
        body.wake(lapse, &mut out);
        assert!(matches!(out[2], Out::Drive(drive) if drive.velocity == Vec2::zeros()));
        assert_eq!(body.wake_at(), None);
    }
}
