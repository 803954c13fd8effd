//! Report of one trial: results of its episodes, totals, and, if kept, the states of the team at each step. It is built
//! from the outputs of a Recorder and the counts of a team's processes.

use super::episode::Episode;
use super::event::Counted;
use super::hardware::RobotHardware;
use super::listening::Listening;
use crate::messages::ids::RobotId;
use crate::messages::local::Sample;
use crate::messages::wire::{KINDS, Phase};
use crate::net::media::radio::RadioCounts;
use crate::net::protocol::link::LinkCounts;
use crate::safety::guard::SafetyCounts;
use crate::scenario::judge::Verdict;
use crate::time::{Span, Time};

/// Number and size of published messages of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublishedCount {
    /// Number of messages, including those that stayed on their host.
    pub messages: u64,
    /// Total size of the messages \[bytes\]: that of their datagrams without authentication tags, as if each message
    /// had a datagram of its own.
    pub(crate) bytes: u64,
}

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

/// Output of a Recorder, the actor that reports a trial.
#[derive(Clone, Debug)]
pub enum RecorderOutput {
    /// Result of an episode, and the totals so far.
    Episode(Episode, Totals),
    /// State of the whole team at one instant.
    Step(Step),
    /// All episodes of the trial have ended; with the totals of the trial.
    Finished(Totals),
    /// The run has ended, perhaps before all episodes have; with the totals so far.
    Closed(Totals),
}

impl TrialReport {
    /// Adds an output of a Recorder to the report: an episode or a step is appended, totals replace earlier totals.
    pub fn note(&mut self, event: RecorderOutput) {
        match event {
            RecorderOutput::Episode(episode, totals) => {
                self.episodes.push(episode);
                self.totals = totals;
            }
            RecorderOutput::Step(step) => self.steps.push(step),
            RecorderOutput::Finished(totals) => (self.totals, self.finished) = (totals, true),
            RecorderOutput::Closed(totals) => self.totals = totals,
        }
    }

    /// Returns the report with its counts, which cover only the host whose Recorder made it, replaced by the sums over
    /// all processes of the team. `incarnations` has the counts of each process; a restarted host has several.
    pub fn counted<'a>(self, incarnations: impl Iterator<Item = &'a Counted> + Clone) -> TrialReport {
        let sum = |of: fn(&Counted) -> u64| incarnations.clone().map(of).sum();
        let oldest = incarnations.clone().filter_map(|counted| counted.oldest_command_s).reduce(f64::max);
        TrialReport {
            totals: Totals {
                messages: sum(|counted| counted.messages),
                oldest_command: oldest.map(Span::from_secs),
                links: incarnations.clone().map(|counted| *counted.links).sum(),
                safety: incarnations.clone().flat_map(|counted| &counted.safety).map(|robot| robot.counts).sum(),
                ..self.totals
            },
            refused: sum(|counted| counted.refused),
            lost: sum(|counted| counted.lost),
            hardware: RobotHardware::joined(incarnations.flat_map(|counted| &counted.hardware)),
            ..self
        }
    }

    /// Returns the number of successful episodes.
    pub fn successes(&self) -> usize {
        self.episodes.iter().filter(|episode| episode.verdict == Verdict::Success).count()
    }
}

/// State of the whole team at one instant of an episode.
#[derive(Clone, Debug)]
pub struct Step {
    /// Index of the episode, from 0.
    pub episode: u32,
    /// Phase in which the team is, such as running.
    pub phase: Phase,
    /// True state of each robot, in the order of robot ids.
    pub samples: Vec<Sample>,
    /// Messages of other robots that robots use at this instant, grouped by the receiving robot. Empty while no episode
    /// runs, and always if the trial was not set to keep them.
    pub hearing: Vec<Hearing>,
}

/// Message of another robot that a robot used in its last control step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hearing {
    /// Robot that used the message.
    pub robot: RobotId,
    /// Robot that published the message.
    pub of: RobotId,
    /// Age of the message since its publication.
    pub age: Span,
}

/// Totals of a trial: its counts, its statistics, its end and its trace.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Number of messages that actors published.
    pub messages: u64,
    /// Number and size of the published messages of each kind, in the order of [`KINDS`].
    pub said: [PublishedCount; KINDS.len()],
    /// Time up to which the totals count, such as the end of an episode.
    pub end: Time,
    /// Trace: digest of all messages and all true states of robots, each with its time.
    pub trace: u128,
    /// Largest age, since its publication, that a velocity command had while it still moved a robot; `None` if the true
    /// state of a robot was never reported.
    pub oldest_command: Option<Span>,
    /// Datagrams of all hosts on all links, sent, accepted, and refused by cause, up to the last full second.
    pub links: LinkCounts,
    /// Frames, airtime and losses on all emulated radio channels, up to the last full second; zero without a radio.
    pub radio: RadioCounts,
    /// Stops and reduced velocities of all robots by their guards, by cause, up to the robots' last heartbeats.
    pub safety: SafetyCounts,
    /// Statistics of messages between robots while episodes ran: arrivals, delays and ages; zero unless the trial keeps
    /// steps.
    pub listening: Listening,
}
