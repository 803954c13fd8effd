//! The air under an ether: a radio channel whose stations are the hosts of the link, and where their robots truly are.

use std::sync::Arc;

use crate::messages::ids::HostId;
use crate::messages::local::Truth;
use crate::messages::wire::Kind;
use crate::net::media::radio::{Channel, Delivery, Radio, RadioCounts, To};
use crate::net::protocol::codec::Frame;
use crate::net::protocol::router::Audience;
use crate::net::transport::Transmit;
use crate::random::Seed;
use crate::time::{Span, Time};

/// How often what was counted is told.
const COUNTS_PERIOD: Span = Span::from_millis(1000);

/// A frame on the air, and what of message it begins with.
#[derive(Clone, Debug)]
pub struct Sent {
    /// The kind that the medium takes it for.
    pub kind: Kind,
    /// The bytes.
    pub frame: Frame,
}

/// The radio channel of one link.
#[derive(Debug)]
pub struct Air {
    channel: Channel<Sent>,
    /// By robot: the hosts that are where it is.
    carried: Vec<Vec<HostId>>,
    next_counts: Time,
}

impl Air {
    /// A channel of which every host is a station. A host is where the first of the robots is whose agents it runs; one
    /// without is in everybody's reach.
    pub fn new(radio: Radio, robots_of: &[Option<u16>], seed: &Seed) -> Air {
        let hosts = u16::try_from(robots_of.len()).expect("hosts are counted in u16");
        let robots = robots_of.iter().flatten().max().map_or(0, |&last| usize::from(last) + 1);
        let mut carried = vec![Vec::new(); robots];
        for (host, robot) in (0..hosts).map(HostId).zip(robots_of) {
            robot.iter().for_each(|&robot| carried[usize::from(robot)].push(host));
        }
        Air { channel: Channel::new(radio, hosts, seed), carried, next_counts: Time::ZERO }
    }

    /// A host sends a frame; `listeners` are those that a frame for all is for.
    pub fn offer(&mut self, now: Time, transmit: &Transmit, kind: Kind, listeners: &Arc<[u16]>) {
        let to = match transmit.audience {
            Audience::Host(to) => To::One(to.0),
            Audience::All => To::Many(Arc::clone(listeners)),
        };
        let frame = transmit.frame.clone();
        self.channel.offer(now, transmit.from.0, to, frame.len(), Sent { kind, frame });
    }

    /// The robots of a world are there.
    pub fn locate(&mut self, truth: &Truth) {
        for sample in truth.samples.iter() {
            for host in self.carried.get(sample.robot.index()).into_iter().flatten() {
                self.channel.place(host.0, sample.motion.position);
            }
        }
    }

    /// When anything is next due.
    pub fn wake_at(&self) -> Time {
        self.channel.wake_at().map_or(self.next_counts, |due| due.min(self.next_counts))
    }

    /// Does what is due; gives what was counted, if it is time to.
    pub fn wake(&mut self, now: Time, deliveries: &mut Vec<Delivery<Sent>>) -> Option<RadioCounts> {
        self.channel.wake(now, deliveries);
        (self.next_counts <= now).then(|| {
            self.next_counts = now.next_on_grid(Span::ZERO, COUNTS_PERIOD);
            self.channel.counts(now)
        })
    }
}
