//! Log of the steps of a robot's policy that count as none.

use crate::messages::ids::RobotId;

/// Steps of a robot's policy that count as none: the log has the reason at the beginning of a series of them.
#[derive(Clone, Copy, Debug)]
pub struct Failures {
    robot: RobotId,
    /// Whether the last step counts as none.
    fails: bool,
    /// Number of times that steps have begun to count as none.
    series: u64,
}

impl Failures {
    /// Begins the log of a robot's policy.
    pub fn new(robot: RobotId) -> Failures {
        Failures { robot, fails: false, series: 0 }
    }

    /// Notes that a step counts as none, for the reason `why`. `policy` is the name of the policy.
    pub fn fail(&mut self, policy: &str, why: &str) {
        let robot = self.robot;
        tracing::debug!(why, "a step of {robot} counts as none");
        if std::mem::replace(&mut self.fails, true) {
            return;
        }
        self.series += 1;
        // What comes and goes is said at the times 1, 2, 4, 8, ...
        if self.series.is_power_of_two() {
            let times = self.series;
            tracing::error!(policy, why, times, "a step of the policy failed; {robot} stands until one succeeds");
        }
    }

    /// Notes a step that succeeded.
    pub fn succeed(&mut self) {
        self.fails = false;
    }
}
