//! Report of one trial: its episodes, its totals, and its steps if they were kept. It is built here alone, from the
//! events of a recorder and the counts of a team's processes.

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

/// Messages of one kind that were published.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Said {
    /// Messages published, including those that stayed on their host.
    pub messages: u64,
    /// Size of the messages' datagrams, as if each message had its own, without tags \[bytes\].
    pub bytes: u64,
}

/// Report of a trial.
#[derive(Clone, Debug, Default)]
pub struct TrialReport {
    /// Episodes that have a result, in order.
    pub episodes: Vec<Episode>,
    /// Simulated time.
    pub simulated: Span,
    /// Messages, trace and checks, up to the last result.
    pub totals: Totals,
    /// Whether every episode has a result.
    pub finished: bool,
    /// Messages refused by full mailboxes.
    pub refused: u64,
    /// Messages lost in crashes.
    pub lost: u64,
    /// Every step of the team; empty unless the trial keeps steps.
    pub steps: Vec<Step>,
    /// Hardware of real robots, by their ids.
    pub hardware: Vec<RobotHardware>,
}

/// Event of a recorder.
#[derive(Clone, Debug)]
pub enum Told {
    /// An episode is over; with the totals so far.
    Episode(Episode, Totals),
    /// A step of the whole team.
    Step(Step),
    /// All episodes are over.
    Finished(Totals),
    /// The run ends here.
    Closed(Totals),
}

impl TrialReport {
    /// Adds an event of a recorder.
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

    /// Replaces the counts of the host that judges by the sums over all processes of the team, restarted ones included.
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

/// The whole team at one instant of an episode.
#[derive(Clone, Debug)]
pub struct Step {
    /// The episode.
    pub episode: u32,
    /// Phase of the episode.
    pub phase: Phase,
    /// States by robot id.
    pub samples: Vec<Sample>,
    /// Messages that robots used while an episode runs, by receiving robot; empty unless the trial keeps them.
    pub hearing: Vec<Hearing>,
}

/// Message of another robot that a robot had in its last control step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hearing {
    /// The receiving robot.
    pub robot: RobotId,
    /// The robot that published the message.
    pub of: RobotId,
    /// Age of the message since its publication.
    pub age: Span,
}

/// Totals of a trial.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Messages published.
    pub messages: u64,
    /// Messages by kind, in the order of `KINDS`, with their bytes.
    pub said: [Said; KINDS.len()],
    /// Time at which the last episode ended.
    pub end: Time,
    /// Trace: digest of every message and every true state, each with its time.
    pub trace: u128,
    /// Largest age since publication of a command that still drove a robot; `None` if the true state of some robot was
    /// never reported.
    pub oldest_command: Option<Span>,
    /// Counts of the Networks on all links, up to the last full second.
    pub links: LinkCounts,
    /// Counts of all radio channels, up to the last full second; zero without a radio.
    pub radio: RadioCounts,
    /// Counts of the robots' guards, up to their last heartbeats.
    pub safety: SafetyCounts,
    /// Statistics of messages between robots while episodes ran; empty unless steps are kept.
    pub listening: Listening,
}
