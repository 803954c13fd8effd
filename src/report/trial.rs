//! Report of one trial: its episodes, its totals, and its steps if they were kept. It is built from the outputs of a
//! Recorder and the counts of a team's processes.

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
pub struct Said {
    /// Number of messages, including those that stayed on their host.
    pub messages: u64,
    /// Size of the messages \[bytes\]: datagrams without tags, as if each message had its own.
    pub bytes: u64,
}

/// Report of a trial.
#[derive(Clone, Debug, Default)]
pub struct TrialReport {
    /// Episodes with a verdict, in order.
    pub episodes: Vec<Episode>,
    /// Simulated time of the trial.
    pub simulated: Span,
    /// Counts, trace and checks, up to the last result.
    pub totals: Totals,
    /// Whether every episode has a verdict.
    pub finished: bool,
    /// Number of messages that full mailboxes refused.
    pub refused: u64,
    /// Number of messages that were lost in crashes of actors.
    pub lost: u64,
    /// Steps of the team; empty unless the trial keeps steps.
    pub steps: Vec<Step>,
    /// Hardware of real robots, in the order of robot ids.
    pub hardware: Vec<RobotHardware>,
}

/// Output of a Recorder.
#[derive(Clone, Debug)]
pub enum Told {
    /// Result of an episode, and the totals so far.
    Episode(Episode, Totals),
    /// Step of the whole team.
    Step(Step),
    /// All episodes have ended; with the totals.
    Finished(Totals),
    /// The run has ended; with the totals.
    Closed(Totals),
}

impl TrialReport {
    /// Adds an output of a Recorder.
    pub fn note(&mut self, event: Told) {
        match event {
            Told::Episode(episode, totals) => {
                self.episodes.push(episode);
                self.totals = totals;
            }
            Told::Step(step) => self.steps.push(step),
            Told::Finished(totals) => (self.totals, self.finished) = (totals, true),
            Told::Closed(totals) => self.totals = totals,
        }
    }

    /// Replaces the counts of the judging host by the sums over all processes of the team, including restarted ones.
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
    /// Phase of the team.
    pub phase: Phase,
    /// True state of each robot, in the order of robot ids.
    pub samples: Vec<Sample>,
    /// Messages that robots use at this instant, by receiving robot; empty unless the trial keeps them.
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

/// Totals of a trial.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Number of messages published.
    pub messages: u64,
    /// Number and size of the messages of each kind, in the order of `KINDS`.
    pub said: [Said; KINDS.len()],
    /// Time at which the last episode ended.
    pub end: Time,
    /// Trace: digest of all messages and all true states, each with its time.
    pub trace: u128,
    /// Largest age since its publication of a command that still drove a robot; `None` if the true state of a robot was
    /// never reported.
    pub oldest_command: Option<Span>,
    /// Counts of all hosts on all links, up to the last full second.
    pub links: LinkCounts,
    /// Counts of all radio channels, up to the last full second; zero without a radio.
    pub radio: RadioCounts,
    /// Counts of the robots' guards, up to their last heartbeats.
    pub safety: SafetyCounts,
    /// Statistics of messages between robots while episodes ran; empty unless the trial keeps steps.
    pub listening: Listening,
}
