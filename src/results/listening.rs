//! Statistics of messages between robots: delivery, delay and use, as an observer of all hosts measures them.

use serde::{Deserialize, Serialize};

use super::ages::Ages;

/// Statistics of messages between robots: their arrival over links, and their use in control steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listening {
    /// Number of expected arrivals: each message counts once for every other host that runs agents.
    pub due: u64,
    /// Number of arrivals, without duplicates.
    pub arrived: u64,
    /// Histogram of the messages' delays, from publication to arrival.
    pub delay: Ages,
    /// Number of control steps of robots that receive messages over a link.
    pub steps: u64,
    /// Number of neighbours' messages that had crossed a link and that robots used, summed over all control steps.
    pub heard: u64,
    /// Histogram of the ages of the messages counted in `heard`, from publication to the control step.
    pub age: Ages,
}

impl Listening {
    /// Adds the statistics of another trial to these.
    pub fn merge(&mut self, other: &Listening) {
        self.due += other.due;
        self.arrived += other.arrived;
        self.steps += other.steps;
        self.heard += other.heard;
        self.delay.merge(&other.delay);
        self.age.merge(&other.age);
    }

    /// Returns the largest of all its counts.
    pub fn most(&self) -> u64 {
        let Listening { due, arrived, delay, steps, heard, age } = self;
        [*due, *arrived, *steps, *heard, delay.most(), age.most()].into_iter().max().unwrap_or(0)
    }

    /// Returns the share of messages that arrived, 0 to 1; `None` if no message had to cross a link.
    pub fn delivered(&self) -> Option<f64> {
        (self.due > 0).then(|| self.arrived as f64 / self.due as f64)
    }

    /// Returns the mean number of neighbours whose messages, received over a link, a control step used; `None` without
    /// control steps.
    pub fn neighbours(&self) -> Option<f64> {
        (self.steps > 0).then(|| self.heard as f64 / self.steps as f64)
    }
}
