//! The radio channel under an emulated link. Its stations are the hosts of the link, at the true positions of their
//! robots.

use std::sync::Arc;

use crate::messages::ids::HostId;
use crate::messages::local::Truth;
use crate::messages::wire::Kind;
use crate::net::media::radio::{Channel, Delivery, Destination, Radio, RadioCounts};
use crate::net::protocol::codec::Frame;
use crate::net::protocol::router::Audience;
use crate::net::transport::Transmit;
use crate::random::Seed;
use crate::time::{Span, Time};

/// Period of the reports of radio counts.
const COUNTS_PERIOD: Span = Span::from_millis(1000);

/// A frame offered to the channel, with the kind of its first message.
#[derive(Clone, Debug)]
pub struct Sent {
    /// Kind of its first message, by which the link emulator impairs it.
    pub kind: Kind,
    /// Its bytes.
    pub frame: Frame,
}

/// The radio channel of one link.
#[derive(Debug)]
pub struct RadioLink {
    channel: Channel<Sent>,
    /// By robot: the hosts that it carries.
    hosts_of_robot: Vec<Vec<HostId>>,
    next_counts: Time,
}

impl RadioLink {
    /// Returns a channel with one station per host. A host is at the position of the first robot whose agent it runs; a
    /// host without robots is within range of all.
    pub fn new(radio: Radio, robots_of: &[Option<u16>], seed: &Seed) -> RadioLink {
        let hosts = u16::try_from(robots_of.len()).expect("hosts are counted in u16");
        let robots = robots_of.iter().flatten().max().map_or(0, |&last| usize::from(last) + 1);
        let mut hosts_of_robot = vec![Vec::new(); robots];
        for (host, robot) in (0..hosts).map(HostId).zip(robots_of) {
            robot.iter().for_each(|&robot| hosts_of_robot[usize::from(robot)].push(host));
        }
        RadioLink { channel: Channel::new(radio, hosts, seed), hosts_of_robot, next_counts: Time::ZERO }
    }

    /// Queues a frame at its host; a frame for all goes to `listeners`.
    pub fn offer(&mut self, now: Time, transmit: &Transmit, kind: Kind, listeners: &Arc<[u16]>) {
        let to = match transmit.audience {
            Audience::Host(to) => Destination::One(to.0),
            Audience::All => Destination::Many(Arc::clone(listeners)),
        };
        let frame = transmit.frame.clone();
        self.channel.offer(now, transmit.from.0, to, frame.len(), Sent { kind, frame });
    }

    /// Updates the hosts' positions from the true positions of their robots.
    pub fn locate(&mut self, truth: &Truth) {
        for sample in truth.samples.iter() {
            for host in self.hosts_of_robot.get(sample.robot.index()).into_iter().flatten() {
                self.channel.place(host.0, sample.motion.position);
            }
        }
    }

    /// Returns when it next has to be woken.
    pub fn wake_at(&self) -> Time {
        self.channel.wake_at().map_or(self.next_counts, |due| due.min(self.next_counts))
    }

    /// Runs the channel up to `now`; returns its counts once every `COUNTS_PERIOD`.
    pub fn wake(&mut self, now: Time, deliveries: &mut Vec<Delivery<Sent>>) -> Option<RadioCounts> {
        self.channel.wake(now, deliveries);
        (self.next_counts <= now).then(|| {
            self.next_counts = now.next_on_grid(Span::ZERO, COUNTS_PERIOD);
            self.channel.counts(now)
        })
    }
}
