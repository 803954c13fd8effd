//! What the networks see: the policy of itself and of an edge, as its file will say, and the critic of everything.

use crate::messages::geometry::{Motion, Task};
use crate::policy::manifest::Field;
use crate::scenario::{Scenario, Stage};

/// How many floats the critic sees beyond the policy's observation.
pub const PRIVILEGED: usize = 8;

/// Writes an observation, two floats a field.
pub fn own(fields: &[Field], scenario: &dyn Scenario, task: &Task, estimate: &Motion, to: &mut [f32]) {
    let seen = scenario.observe(task, estimate);
    for (two, field) in to.chunks_exact_mut(2).zip(fields) {
        two.copy_from_slice(&field.of(&seen).to_array());
    }
}

/// What the critic knows of a robot and its episode, beyond the true observation. Each is of the order of one.
#[derive(Clone, Copy, Debug)]
pub struct Privileged {
    /// How far it has come.
    pub stage: Stage,
    /// Whether it has arrived.
    pub arrived: bool,
    /// Share of the episode's time that has passed.
    pub passed: f32,
    /// How far it has to go \[m\].
    pub to_go_m: f32,
    /// Drivetrain lag \[s\].
    pub lag_s: f32,
    /// Delay of messages \[s\].
    pub delay_s: f32,
    /// Share of messages lost.
    pub loss: f32,
    /// Whether contacts are judged and block nothing.
    pub judged: bool,
}

impl Privileged {
    /// Writes all of it, `PRIVILEGED` floats.
    pub fn write(&self, to: &mut [f32]) {
        let truth = |known: bool| if known { 1.0 } else { 0.0 };
        to.copy_from_slice(&[
            f32::from(self.stage.0) * 0.25,
            truth(self.arrived),
            self.passed,
            self.to_go_m * 0.2,
            self.lag_s,
            self.delay_s * 10.0,
            self.loss,
            truth(self.judged),
        ]);
    }
}
