//! Body: one robot's actuator and sensor. It lives where the actuator is: on the robot, or beside the World
//! that simulates it.
//!
//! A Body stops its motors when the last command's validity lapses, whoever died upstream. Nothing
//! bypasses it.

use super::Core;
use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::messages::local::{Drive, Sample};
use crate::messages::wire::{MotorCommand, Reading};
use crate::time::Time;

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
    /// When the command in force lapses.
    lapses: Option<Time>,
}

impl Body {
    /// A body at rest.
    pub fn new(robot: RobotId) -> Body {
        Body { robot, lapses: None }
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
            In::Sample(sample) => out.push(Out::Reading(Reading {
                robot: self.robot,
                stamp_ns: sample.time.as_nanos(),
                motion: sample.motion,
            })),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        self.lapses
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        self.lapses = None;
        out.push(Out::Drive(Drive { robot: self.robot, velocity: Vec2::zeros(), until: now }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Span;

    #[test]
    fn the_motors_stop_when_the_command_lapses() {
        let mut body = Body::new(RobotId(0));
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
