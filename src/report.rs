//! Report of one trial: results of its episodes, totals, and, if kept, the states of the team at each step. It is built
//! from the outputs of a Recorder.

use crate::actors::recorder::Out;
use crate::results::episode::Episode;
use crate::results::hardware::RobotHardware;
use crate::results::totals::{Step, Totals};
use crate::scenario::judge::Verdict;
use crate::time::Span;

/// Report of a trial: episodes, totals, undelivered messages, steps and hardware.
#[derive(Clone, Debug, Default)]
pub struct TrialReport {
    /// Results of the episodes that have ended with a verdict, in order.
    pub episodes: Vec<Episode>,
    /// Length of the trial in the time of its clock, which is simulated time in a simulation.
    pub simulated: Span,
    /// Counts and trace of the trial, up to the last output of its Recorder that had totals.
    pub totals: Totals,
    /// Whether every episode has a verdict.
    pub finished: bool,
    /// Number of messages that were dropped because the mailbox of the receiving actor was full.
    pub refused: u64,
    /// Number of messages that were lost in crashes of actors.
    pub lost: u64,
    /// States of the whole team at successive instants; empty unless the trial was set to keep steps.
    pub steps: Vec<Step>,
    /// Battery, temperature and hardware faults of real robots, in the order of robot ids.
    pub hardware: Vec<RobotHardware>,
}

impl TrialReport {
    /// Adds an output of a Recorder to the report: an episode or a step is appended, totals replace earlier totals.
    pub fn note(&mut self, output: Out) {
        match output {
            Out::Episode(episode, totals) => {
                self.episodes.push(episode);
                self.totals = totals;
            }
            Out::Step(step) => self.steps.push(step),
            Out::Finished(totals) => (self.totals, self.finished) = (totals, true),
            Out::Closed(totals) => self.totals = totals,
        }
    }

    /// Returns the number of successful episodes.
    pub fn successes(&self) -> usize {
        self.episodes.iter().filter(|episode| episode.verdict == Verdict::Success).count()
    }
}
