//! Events of a process, on their way to the log, the record, the page and the table, and to the Recorder.

use std::rc::Rc;

use super::inputs::Input;
use crate::actors::recorder;
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::local::{Remembered, Truth};
use crate::messages::wire::{Hardware, Kind, Wire};
use crate::net::media::radio::RadioCounts;
use crate::net::protocol::codec::Frame;
use crate::net::protocol::link::{DuplicateId, LinkCounts, Refusal};
use crate::net::protocol::roster::Roster;
use crate::net::protocol::sender::Peer;
use crate::net::protocol::ways::Ways;
use crate::net::transport::Renewed;
use crate::results::episode::AbortReason;
use crate::runtime::shell::Mailbox;
use crate::safety::guard::SafetyCounts;
use crate::time::Span;
use crate::trial::Trial;

/// Event in a process, for its Recorder and for the code that has started it.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// An actor of this process has published a message: the datagram, without its authentication tag.
    Published(&'a Frame),
    /// A datagram is sent on a link, with its authentication tag if the team has a key.
    Sent(LinkId, &'a Frame),
    /// A datagram arrives over an emulated link.
    Arrived(LinkId, &'a Frame),
    /// Input from outside the actors, such as a datagram. Does not occur if all hosts run in one process with emulated
    /// links.
    Input(&'a Input),
    /// A datagram that had arrived was refused for this cause, without any effect but its count.
    Refused(LinkId, Refusal, &'a Frame),
    /// True states of simulated robots after a step of their World.
    Truth(&'a Truth),
    /// Robots whose messages a robot uses in its next control step, with the ages of the messages. Occurs only if the
    /// trial keeps steps.
    Perceived(RobotId, &'a [(RobotId, Span)]),
    /// Output of the Recorder: the result of an episode, a step, or the end of the run.
    Recorded(&'a recorder::Out),
    /// Message that is delivered to actors of this process.
    Message(&'a Wire),
    /// State of the other hosts on links with link reports, such as delay and loss, and the ways by which the host
    /// hears others over hops and sends.
    Peers(&'a [Peer], &'a Ways),
    /// Numbers of datagrams sent, received and refused on the links of a host since its Network was started.
    Counts(&'a LinkCounts),
    /// Counts of the emulated radio channel of a link since the start of the run.
    Radio(LinkId, &'a RadioCounts),
    /// Another running host uses the id of this host and was started earlier.
    Duplicate(DuplicateId),
    /// The state server of this process has aborted the episode with this index, from 0, for this reason.
    Aborted(u32, AbortReason),
    /// Numbers of times that a robot's guard has stopped or slowed it since the robot's Controller was started.
    Safety(RobotId, SafetyCounts),
    /// Digest of what the policy of a robot remembers after a step. Occurs only for policies with a state.
    Remembered(Remembered),
    /// Condition of the hardware of a real robot, as its driver reports it.
    Hardware(RobotId, &'a Hardware),
    /// The sockets of a link were closed or opened again, because a network interface or its address has changed.
    Link(LinkId, &'a Renewed),
    /// A roster with this number has arrived. It is in force once it is on disk and the Network was told so
    /// ([`Graph::roster_kept`](super::process::Graph::roster_kept)).
    Roster(u32, &'a Frame),
    /// Roster that is in force, once a second; not that of the key files.
    Members(&'a Roster),
}

/// Function that is called with each event of a process, and with the host at which the event happened.
pub type Report = Rc<dyn Fn(HostId, Event)>;

/// Sink of all events of a process: the caller's function, and the Recorder where one runs.
pub(super) struct Events {
    report: Report,
    recorder: Option<Mailbox<recorder::In>>,
    /// Whether other hosts are processes of their own, so that the Recorder learns their messages by receiving them.
    alone: bool,
    /// Host whose readings are judged; `None` if true states are.
    judge_of_readings: Option<HostId>,
    /// For each link: whether the Recorder follows the datagrams that arrive on it.
    followed: Vec<bool>,
}

impl Events {
    /// Makes the sink of the events of a process: the caller's function `report`, and the mailbox of the Recorder.
    /// `emulated` is whether the process runs all hosts of the trial, over emulated links.
    pub(super) fn new(
        trial: &Trial,
        emulated: bool,
        (report, recorder): (&Report, Option<&Mailbox<recorder::In>>),
    ) -> Events {
        let links = trial.deployment.links.iter();
        Events {
            report: Rc::clone(report),
            recorder: recorder.cloned(),
            alone: !emulated,
            judge_of_readings: trial.deployment.judge_of_readings(),
            followed: links.map(|link| trial.steps.follow_messages() && link.carries.contains(&Kind::Latent)).collect(),
        }
    }

    /// Takes an event that has happened at `host`.
    pub(super) fn emit(&self, host: HostId, event: Event) {
        (self.report)(host, event);
        if let Some(recorder) = &self.recorder
            && let Some(input) = self.recorded(host, event)
        {
            recorder.send(input);
        }
    }

    /// Returns the input of the Recorder that an event makes; `None` if it makes none.
    fn recorded(&self, host: HostId, event: Event) -> Option<recorder::In> {
        Some(match event {
            Event::Published(frame) => recorder::In::Tap(Frame::clone(frame)),
            // The Recorder gets no other copy of messages from other processes.
            Event::Message(message @ (Wire::Mode(_) | Wire::MotorCommand(_))) if self.alone => {
                recorder::In::Received(message.clone())
            }
            Event::Message(Wire::Reading(reading)) if self.judge_of_readings == Some(host) => {
                recorder::In::Reading(reading.clone())
            }
            Event::Truth(truth) => recorder::In::Truth(truth.clone()),
            Event::Counts(counts) => recorder::In::Counts(host, Box::new(*counts)),
            Event::Radio(link, counts) => recorder::In::Radio(link, Box::new(*counts)),
            Event::Safety(robot, counts) => recorder::In::Safety(robot, counts),
            Event::Aborted(episode, reason) => recorder::In::Aborted(episode, reason),
            Event::Arrived(link, frame) if self.followed[usize::from(link.0)] => {
                recorder::In::Arrived(host, Frame::clone(frame))
            }
            Event::Perceived(robot, heard) => recorder::In::Perceived(host, robot, heard.into()),
            Event::Arrived(..)
            | Event::Message(_)
            | Event::Sent(..)
            | Event::Input(_)
            | Event::Refused(..)
            | Event::Recorded(_)
            | Event::Peers(..)
            | Event::Duplicate(_)
            | Event::Hardware(..)
            | Event::Remembered(_)
            | Event::Roster(..)
            | Event::Members(_)
            | Event::Link(..) => return None,
        })
    }
}
