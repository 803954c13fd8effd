//! Records of runs, as MCAP files: what a host or a simulation did, for people, for programs of others, and to the bit
//! for a replay.
//!
//! The thread that runs the actors puts [`Event`]s into a bounded queue ([`queue`]); it never waits for a disk. A
//! writer's thread makes the messages of the record's topics of them ([`topics`]) and writes the file ([`mod@file`]). A
//! replay makes the same messages and compares them with the file ([`compare`]). docs/record.md lists the topics.

mod drawing;
mod foxglove;
mod protobuf;
mod schemas;

pub mod actions;
pub mod compare;
pub mod file;
pub mod identity;
pub mod merge;
pub mod protobuf_reader;
pub mod queue;
pub mod reader;
pub mod repair;
pub mod share;
pub mod tape;
pub mod topics;

use crate::actors::recorder;
use crate::graph::inputs::Input;
use crate::graph::process::ProcessEvent;
use crate::messages::hardware::Hardware;
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::local::Truth;
use crate::messages::wire::Wire;
use crate::net::protocol::codec::Frame;
use crate::net::protocol::link::LinkCounts;
use crate::net::protocol::sender::Peer;
use crate::report::episode::Episode;
use crate::safety::guard::SafetyCounts;
use crate::time::Time;

/// Event of a run, as it is put into a record.
#[derive(Clone, Debug)]
pub enum Event {
    /// Message that an actor of a host has published: its datagram, without a tag.
    Published(HostId, Frame),
    /// Datagram that left the host on a link. Only records of hosts have these.
    Sent(LinkId, Frame),
    /// Input from outside the graph. Only records of hosts have these.
    Input(Input),
    /// Message that reached actors of the host. Only records of hosts have these.
    Delivered(Wire),
    /// True states of simulated robots.
    Truth(Truth),
    /// Result of an episode.
    Episode(Episode),
    /// Number of times that a robot's guard has stopped or slowed it.
    Guard(RobotId, SafetyCounts),
    /// Condition of a real robot's hardware.
    Hardware(RobotId, Box<Hardware>),
    /// Counts of a host's links since its Network was started.
    Counts(HostId, Box<LinkCounts>),
    /// Summaries of the other hosts as a host sees them.
    Peers(HostId, Vec<Peer>),
    /// Number of events before this one that the queue had no room for.
    Dropped(u64),
    /// End of the events of an instant: a turn of the event loop.
    Turn(Time),
}

/// Which events of a run a record takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Those of one host in real time: enough to run this host again alone.
    Host,
    /// Those of a simulation of the whole team, which runs again from its seed.
    Simulation,
}

impl Event {
    /// Makes the event of a record from an event of a process; `None` if a record of this scope does not have it.
    pub fn of(scope: Scope, host: HostId, event: ProcessEvent) -> Option<Event> {
        let of_host = scope == Scope::Host;
        Some(match event {
            ProcessEvent::Published(frame) => Event::Published(host, Frame::clone(frame)),
            ProcessEvent::Sent(link, frame) if of_host => Event::Sent(link, Frame::clone(frame)),
            ProcessEvent::Input(input) if of_host => Event::Input(input.clone()),
            ProcessEvent::Message(message @ (Wire::Reading(_) | Wire::Latent(_) | Wire::Mode(_))) if of_host => {
                Event::Delivered(message.clone())
            }
            ProcessEvent::Truth(truth) => Event::Truth(truth.clone()),
            ProcessEvent::Recorded(recorder::Out::Episode(episode, _)) => Event::Episode(*episode),
            ProcessEvent::Safety(robot, counts) => Event::Guard(robot, counts),
            ProcessEvent::Hardware(robot, hardware) => Event::Hardware(robot, Box::new(hardware.clone())),
            ProcessEvent::Counts(counts) => Event::Counts(host, Box::new(*counts)),
            ProcessEvent::Peers(peers) => Event::Peers(host, peers.to_vec()),
            ProcessEvent::Sent(..)
            | ProcessEvent::Arrived(..)
            | ProcessEvent::Input(_)
            | ProcessEvent::Message(_)
            | ProcessEvent::Recorded(_)
            | ProcessEvent::Duplicate(_) => return None,
        })
    }
}
