//! What came of one trial: its episodes, its totals, and its steps if they were kept. Whatever a recorder tells, or the
//! processes of a team count, becomes a report here and nowhere else.

use super::episode::Episode;
use super::event::Counted;
use super::listening::Listening;
use crate::messages::ids::RobotId;
use crate::messages::local::Sample;
use crate::messages::wire::{KINDS, Phase};
use crate::net::media::radio::RadioCounts;
use crate::net::protocol::link::LinkCounts;
use crate::safety::guard::SafetyCounts;
use crate::scenario::judge::Verdict;
use crate::time::{Span, Time};

/// How much of one kind of message was said.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Said {
    /// Messages published, whether or not they have left their host.
    pub messages: u64,
    /// Their datagrams, one message in each and without a tag \[bytes\].
    pub bytes: u64,
}

/// What came of a trial.
#[derive(Clone, Debug, Default)]
pub struct TrialReport {
    /// The episodes that have a result, in order.
    pub episodes: Vec<Episode>,
    /// How much time was simulated.
    pub simulated: Span,
    /// Messages, trace and checks, up to the last result.
    pub totals: Totals,
    /// Whether every episode has a result.
    pub finished: bool,
    /// Messages that full mailboxes refused.
    pub refused: u64,
    /// Messages that were lost in crashes.
    pub lost: u64,
    /// Every step, if the trial was to keep them.
    pub steps: Vec<Step>,
}

/// What a recorder tells of a trial, as it happens.
#[derive(Clone, Debug)]
pub enum Told {
    /// An episode is over; and what the trial comes to so far.
    Episode(Episode, Totals),
    /// The whole team has been seen.
    Step(Step),
    /// All episodes are over.
    Finished(Totals),
    /// The run ends here.
    Closed(Totals),
}

impl TrialReport {
    /// Takes down what a recorder tells.
    pub fn note(&mut self, told: Told) {
        match told {
            Told::Episode(episode, totals) => {
                self.episodes.push(episode);
                self.totals = totals;
            }
            Told::Step(step) => self.steps.push(step),
            Told::Finished(totals) => (self.totals, self.finished) = (totals, true),
            Told::Closed(totals) => self.totals = totals,
        }
    }

    /// The same trial with what processes of its team have counted, each in all of its lives, in place of what one
    /// recorder has heard.
    pub fn counted<'a>(self, lives: impl Iterator<Item = &'a Counted> + Clone) -> TrialReport {
        let sum = |of: fn(&Counted) -> u64| lives.clone().map(of).sum();
        let oldest = lives.clone().filter_map(|counted| counted.oldest_command_s).reduce(f64::max);
        TrialReport {
            totals: Totals {
                messages: sum(|counted| counted.messages),
                oldest_command: oldest.map(Span::from_secs),
                links: lives.clone().map(|counted| *counted.links).sum(),
                safety: lives.clone().flat_map(|counted| &counted.safety).map(|robot| robot.counts).sum(),
                ..self.totals
            },
            refused: sum(|counted| counted.refused),
            lost: sum(|counted| counted.lost),
            ..self
        }
    }

    /// How many episodes succeeded.
    pub fn successes(&self) -> usize {
        self.episodes.iter().filter(|episode| episode.verdict == Verdict::Success).count()
    }
}

/// The whole team at one instant of an episode.
#[derive(Clone, Debug)]
pub struct Step {
    /// The episode.
    pub episode: u32,
    /// What the team is doing.
    pub phase: Phase,
    /// By robot id.
    pub samples: Vec<Sample>,
    /// Who hears whom while an episode runs, by the hearing robot; empty unless it was to be kept.
    pub hearing: Vec<Hearing>,
}

/// A robot that has a message of another robot in its last control step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hearing {
    /// The robot that hears.
    pub robot: RobotId,
    /// Whom it hears.
    pub of: RobotId,
    /// Since the message was published.
    pub age: Span,
}

/// What a whole trial comes to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Messages published.
    pub messages: u64,
    /// The same by kind, in the order of `KINDS`, with their bytes.
    pub said: [Said; KINDS.len()],
    /// When the last episode ended.
    pub end: Time,
    /// A digest of every message and every true state, with its time.
    pub trace: u128,
    /// The oldest command that any robot was still driven by, since it was published; none where the true state of some
    /// robot was never told.
    pub oldest_command: Option<Span>,
    /// What the Networks counted on all links, up to the last full second.
    pub links: LinkCounts,
    /// What happened on all radio channels, up to the last full second; nothing without a radio.
    pub radio: RadioCounts,
    /// What the robots' guards counted, up to their last heartbeats.
    pub safety: SafetyCounts,
    /// What robots heard of each other while episodes ran; empty unless steps are kept.
    pub listening: Listening,
}
