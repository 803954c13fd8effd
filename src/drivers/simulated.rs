//! Driver of simulated robots, whose commands go to their World.

use super::{Command, Driver, Limits, Out};
use crate::time::Time;

/// Driver of a simulated robot: passes each command on to the World that simulates the robot.
pub struct Simulated;

impl Driver for Simulated {
    fn limits(&self) -> Limits {
        Limits { speed_m_s: f32::INFINITY }
    }

    fn drive(&mut self, _: Time, command: &Command, out: &mut Vec<Out>) {
        out.push(Out::Drive(command.drive));
    }

    fn receive(&mut self, _: Time, _: &[u8], out: &mut Vec<Out>) {
        out.push(Out::Refused("a simulated robot has no worker"));
    }
}
