//! Records of runs as MCAP files: the events of a host or a simulation, for people and other programs, and exact enough
//! for a replay.
//!
//! The thread that runs the actors puts [`Event`]s into a bounded queue ([`queue`]), and never waits for a disk. The
//! writer thread ([`writer`]) converts the events to the messages of the record's topics ([`topics`]) and writes them
//! to files ([`series`], [`mod@file`]). A replay makes the same messages and compares them with the file ([`compare`]).
//! docs/record.md lists the topics.
//!
//! [`chosen`] selects the usable ones of existing records, [`info`] describes a record, [`tables`] converts it to rows,
//! [`repair`] and [`share`] copy it, and [`mod@merge`] merges those of a team's hosts on a common clock ([`clocks`]).

#![deny(clippy::print_stdout, clippy::print_stderr)]

mod drawing;
mod foxglove;
mod parts;
mod schemas;

pub mod actions;
pub mod chosen;
pub mod clocks;
pub mod compare;
pub mod digest;
pub mod file;
pub mod health;
pub mod identity;
pub mod info;
pub mod keys;
pub mod merge;
pub mod queue;
pub mod read_error;
pub mod reader;
pub mod reading;
pub mod receipt;
pub mod repair;
pub mod series;
pub mod share;
pub mod stage;
pub mod tables;
pub mod tape;
pub mod topic;
pub mod topics;
pub mod truth;
pub mod writer;

pub use self::foxglove::Severity;
use murmurate::actors::recorder;
use murmurate::graph::event;
use murmurate::graph::inputs::Input;
use murmurate::messages::hardware::Hardware;
use murmurate::messages::ids::{HostId, LinkId, RobotId};
use murmurate::messages::local::{Remembered, Truth};
use murmurate::messages::wire::Wire;
use murmurate::net::protocol::codec::Frame;
use murmurate::net::protocol::link::{LinkCounts, Refusal};
use murmurate::net::protocol::sender::Peer;
use murmurate::net::protocol::ways::Ways;
use murmurate::results::episode::Episode;
use murmurate::safety::guard::SafetyCounts;
use murmurate::time::Time;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Event of a run that is stored in its record.
#[derive(Clone, Debug)]
pub enum Event {
    /// A message that an actor of this host has published, as a datagram without an authentication tag.
    Published(HostId, Frame),
    /// A datagram that the host has sent on this link. Only in records of hosts.
    Sent(LinkId, Frame),
    /// An input of a host from outside its actors: a datagram, a packet of a device's worker, or an order. Only in
    /// records of hosts.
    Input(Input),
    /// A datagram among the inputs that was refused for this cause, without any effect but its count. Only in records
    /// of hosts, which keep the number of these and not their bytes.
    Refused(LinkId, Refusal, Frame),
    /// A message that was delivered to actors of the host. Only in records of hosts and operators.
    Delivered(Wire),
    /// True states of the simulated robots at one instant.
    Truth(Truth),
    /// Result of an episode, such as success or collision.
    Episode(Episode),
    /// Numbers of stops and reduced velocities of this robot by its guard, by cause.
    Guard(RobotId, SafetyCounts),
    /// Digest of what the policy of a robot remembers after a step.
    Remembered(Remembered),
    /// Condition of this real robot's hardware: health, battery, temperature.
    Hardware(RobotId, Box<Hardware>),
    /// Numbers of datagrams that this host has sent, accepted and refused on its links, since its Network was started.
    Counts(HostId, Box<LinkCounts>),
    /// State of the links between this host and the other hosts, as its link layer measures it: age, delay, loss; and
    /// by which ways it hears others over hops and sends.
    Peers(HostId, Vec<Peer>, Box<Ways>),
    /// A line that the program has logged. Only in records of runs in real time.
    Logged(Logged),
    /// State of one of the host's Wi-Fi cards: load of its channel, and the stations that it hears (`docs/record.md`).
    /// Only in records of hosts.
    Wifi(Box<serde_json::Value>),
    /// Request to keep the events of the last seconds, in a record that keeps events only around such requests.
    Keep,
    /// Number of events before this one that were dropped because the record's queue was full.
    Dropped(u64),
    /// End of a turn of the event loop (one pass over all pending inputs), at this time since the start of the run.
    Turn(Time),
}

/// Line that the program has logged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Logged {
    /// Severity of the line.
    pub severity: Severity,
    /// Name of the actor or thread that has logged the line.
    pub from: String,
    /// Text of the line.
    pub text: String,
}

/// Kind of run that is recorded. It determines which events are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// One host in real time: all its inputs, so that a replay can run this host again alone.
    Host,
    /// A simulation of the whole team. Inputs are not stored, because a replay repeats it from its seed.
    Simulation,
    /// An operator, which has no robots: the messages that it receives.
    Operator,
}

impl Event {
    /// Converts an event that the process of `host` has reported to an event of a record; `None` if records of the kind
    /// `scope` do not store it.
    pub fn of(scope: Scope, host: HostId, event: event::Event) -> Option<Event> {
        let of_host = scope == Scope::Host;
        if scope == Scope::Operator {
            return match event {
                event::Event::Message(message) => Some(Event::Delivered(message.clone())),
                event::Event::Peers(peers, ways) => Some(Event::Peers(host, peers.to_vec(), Box::new(ways.clone()))),
                event::Event::Counts(counts) => Some(Event::Counts(host, Box::new(*counts))),
                _ => None,
            };
        }
        Some(match event {
            event::Event::Published(frame) => Event::Published(host, Frame::clone(frame)),
            event::Event::Sent(link, frame) if of_host => Event::Sent(link, Frame::clone(frame)),
            event::Event::Input(input) if of_host => Event::Input(input.clone()),
            event::Event::Refused(link, cause, frame) if of_host => Event::Refused(link, cause, Frame::clone(frame)),
            event::Event::Message(message @ (Wire::Reading(_) | Wire::Sensed(_) | Wire::Latent(_) | Wire::Mode(_)))
                if of_host =>
            {
                Event::Delivered(message.clone())
            }
            event::Event::Truth(truth) => Event::Truth(truth.clone()),
            event::Event::Recorded(recorder::Out::Episode(episode, _)) => Event::Episode(*episode),
            event::Event::Safety(robot, counts) => Event::Guard(robot, counts),
            event::Event::Remembered(said) => Event::Remembered(said),
            event::Event::Hardware(robot, hardware) => Event::Hardware(robot, Box::new(hardware.clone())),
            event::Event::Counts(counts) => Event::Counts(host, Box::new(*counts)),
            event::Event::Peers(peers, ways) => Event::Peers(host, peers.to_vec(), Box::new(ways.clone())),
            event::Event::Sent(..)
            | event::Event::Arrived(..)
            | event::Event::Input(_)
            | event::Event::Refused(..)
            | event::Event::Message(_)
            | event::Event::Recorded(_)
            | event::Event::Perceived(..)
            | event::Event::Radio(..)
            | event::Event::Aborted(..)
            | event::Event::Link(..)
            | event::Event::Roster(..)
            | event::Event::Members(_)
            | event::Event::Duplicate(_) => return None,
        })
    }
}
