//! Results of a run beside its episodes: states of the team at each step, counts, and the trace.

use super::listening::Listening;
use super::sensing::Sensing;
use crate::messages::ids::RobotId;
use crate::messages::local::Sample;
use crate::messages::wire::{KINDS, Phase};
use crate::net::media::radio::RadioCounts;
use crate::net::protocol::link::LinkCounts;
use crate::safety::guard::SafetyCounts;
use crate::time::{Span, Time};

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
    /// Newest values of the robots' senses; empty unless the trial was set to keep what robots hear.
    pub sensed: Vec<Sensing>,
}

/// Whether the report of a trial contains its steps: the true states of all robots after each step of the World.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Steps {
    /// The report contains the steps, but not the messages that robots use.
    Reported,
    /// The report contains the steps and, for each step, which robot uses the messages of which others, their ages, and
    /// the newest values of the robots' senses. It takes several times the memory of `Reported`; it is for pictures.
    WithHearing,
    /// The report does not contain the steps, but how many messages between robots arrived, and how old they were.
    Followed,
    /// The report contains neither; episodes are judged by the steps all the same.
    Discarded,
}

impl Steps {
    /// Whether the report contains the steps, with or without the neighbours' messages that robots use in them.
    pub(crate) fn kept(self) -> bool {
        matches!(self, Steps::Reported | Steps::WithHearing)
    }

    /// Whether each message between robots is followed to the control steps that use it, which takes time.
    pub(crate) fn follow_messages(self) -> bool {
        self != Steps::Discarded
    }
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
    pub published: [Published; KINDS.len()],
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

/// Number and size of published messages of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Published {
    /// Number of messages, including those that stayed on their host.
    pub messages: u64,
    /// Total size of the messages \[bytes\]: that of their datagrams without authentication tags, as if each message
    /// had a datagram of its own.
    pub bytes: u64,
}
