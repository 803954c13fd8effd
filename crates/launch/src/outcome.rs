//! Outcome of a run of supervised processes.

/// Outcome of a run of supervised processes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All processes have ended by themselves with exit code 0.
    Done,
    /// All processes did their work and ended by themselves, but some could not write all of their output; the text
    /// names these and the causes.
    Incomplete(String),
    /// A stop was requested by Ctrl-C or SIGTERM, and all processes have ended.
    Interrupted,
    /// A process has refused its flags or files (exit code 2). The text names the process and gives its last line on
    /// stderr.
    Refused(String),
    /// A process has failed for good, has ended before the others were done, or had to be killed. The text names the
    /// process and the cause.
    Failed(String),
}

impl Outcome {
    /// Adds that a process could not write all of its output, for the reason `why`. A failure counts more.
    pub fn lose(&mut self, why: String) {
        match self {
            Outcome::Done => *self = Outcome::Incomplete(why),
            Outcome::Incomplete(all) => *all = format!("{all}; {why}"),
            Outcome::Interrupted | Outcome::Refused(_) | Outcome::Failed(_) => {}
        }
    }

    /// Sets the outcome of a failure, unless there was one before: the first failure is the cause of later ones.
    pub fn fail(&mut self, outcome: Outcome) {
        if matches!(self, Outcome::Done | Outcome::Incomplete(_)) {
            *self = outcome;
        }
    }
}
