//! Privileged information: what the critic observes beside the policy's observation.

use murmurate::scenario::Progress;

/// Number of inputs of the critic per robot in addition to the policy's observation.
pub const PRIVILEGED: usize = 8;

/// Privileged information about a robot and its episode. It is an input of the critic only.
#[derive(Clone, Copy, Debug)]
pub struct Privileged {
    /// Stage of the robot's progress, which the scenario's reward uses.
    pub stage: Progress,
    /// Whether the robot has arrived at its goal.
    pub arrived: bool,
    /// Fraction of the episode's longest duration that has passed, 0 to 1.
    pub passed: f32,
    /// Length of the robot's remaining path \[m\].
    pub to_go_m: f32,
    /// Time constant of the drivetrain lag \[s\]; 0 for the physics of the paper's environment, without lag.
    pub lag_s: f32,
    /// Mean delay of the team's messages \[s\].
    pub delay_s: f32,
    /// Mean loss probability of the team's messages, 0 to 1.
    pub loss: f32,
    /// Whether a contact makes the episode fail but does not block the move.
    pub judged: bool,
}

impl Privileged {
    /// Writes the information to `to` as [`PRIVILEGED`] floats, each scaled to about one.
    pub fn write(&self, to: &mut [f32]) {
        let indicator = |value: bool| if value { 1.0 } else { 0.0 };
        to.copy_from_slice(&[
            f32::from(self.stage.0) * 0.25,
            indicator(self.arrived),
            self.passed,
            self.to_go_m * 0.2,
            self.lag_s,
            self.delay_s * 10.0,
            self.loss,
            indicator(self.judged),
        ]);
    }
}
